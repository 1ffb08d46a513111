//! Difference data to images: the skin's operator for a reference, with missing channels filled in, and the resulting
//! noise of each pixel.

mod elements;
mod refine;
mod refine_about;
mod weighting;

use std::ops::Range;
use std::sync::Arc;

use dermis_mit::LiftOffFit;
use dermis_skin::{HyperparameterChoice, Solve};
use dermis_tomo::inverse::{
    Hyperparameter, LinearProblem, MissingChannels, Operator, QuantisedOperator as LiveOperator,
};

use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;
pub(crate) use elements::{ElementFrame, ElementImager};
pub use refine::Refiner;
pub(crate) use refine_about::GuessRefiner;
pub use weighting::operator_needs_no_baseline;
use weighting::{central_touch, weights_need_no_baseline};
pub(crate) use weighting::{prior_matrix, weighting};

/// The live inverse of a skin: difference data in, image out.
#[derive(Clone, Debug)]
pub struct Imager {
    problem: Arc<LinearProblem>,
    operator: Operator,
    live: LiveOperator,
    /// lambda from the skin file's rule or a calibration.
    rule_hyperparameter: f64,
    polarity: f64,
    /// Standard deviation of each inside pixel caused by the reference's noise.
    pixel_noise: Vec<f32>,
    inside: Vec<u32>,
    grid_len: usize,
    missing: Option<MissingChannels>,
    /// Solves for elements instead of using the operator, if the skin file says so.
    elements: Option<ElementImager>,
    /// Channels excluded from every frame.
    left_out: Option<MissingChannels>,
    scratch: Scratch,
}

/// An operator computed separately from its imager: [`Imager::work_out`].
#[derive(Debug)]
pub(crate) struct NewOperator {
    operator: Operator,
    live: LiveOperator,
}

#[derive(Clone, Debug, Default)]
struct Scratch {
    filled: Vec<f64>,
    single: Vec<f32>,
    image: Vec<f32>,
    absent: Vec<u32>,
}

/// Working memory of [`Imager::part`].
#[derive(Clone, Debug, Default)]
pub(crate) struct PartScratch {
    single: Vec<f32>,
    merged: Vec<f32>,
    image: Vec<f32>,
}

/// Maximum number of frames used by a data-driven hyperparameter.
const MOST_FRAMES: usize = 16;

impl Imager {
    /// Builds the operator for a reference. `data` (difference frames in model volts) is used only by hyperparameter
    /// rules that need it.
    ///
    /// # Errors
    /// Weights that the reference cannot provide, or a hyperparameter that cannot be found.
    pub fn new(prepared: &Prepared, reference: &Reference, data: &[Vec<f64>]) -> Result<Self, Error> {
        let problem = prepared.problem(weights_need_no_baseline(prepared), || {
            let weighting = weighting(prepared, reference)?;
            let prior = prior_matrix(prepared, &weighting)?;
            Ok(LinearProblem::new(prepared.jacobian.as_mat(), weighting, prior)?)
        })?;
        let rule = match &prepared.skin.imaging.hyperparameter {
            HyperparameterChoice::Number(value) => Hyperparameter::Number(*value),
            HyperparameterChoice::Relative(factor) => Hyperparameter::Relative(*factor),
            HyperparameterChoice::LCurve => Hyperparameter::LCurve,
            HyperparameterChoice::Gcv => Hyperparameter::Gcv,
            HyperparameterChoice::KnownNoise(factor) => Hyperparameter::KnownNoise { factor: *factor },
            HyperparameterChoice::NoiseFigure(target) => {
                Hyperparameter::NoiseFigure { target: *target, signal: central_touch(prepared) }
            }
        };
        let lambda = problem.choose(&rule, &informative(data))?;
        let mut imager =
            Self::from_problem(prepared, problem, lambda, &reference.noise, prepared.skin.imaging.polarity.sign())?;
        if prepared.skin.imaging.solve == Solve::LiftOff {
            imager.elements = Some(ElementImager::new(prepared, &reference.noise)?);
            imager.set_noise(&reference.noise)?;
        }
        Ok(imager)
    }

    /// As [`Imager::new`], from a given problem (such as a calibrated one) at a given lambda. `polarity` is its
    /// unknowns' sign in images.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn from_problem(
        prepared: &Prepared,
        problem: impl Into<Arc<LinearProblem>>,
        lambda: f64,
        noise: &[f64],
        polarity: f64,
    ) -> Result<Self, Error> {
        let problem = problem.into();
        let operator = problem.operator(lambda)?;
        let live = LiveOperator::new(&operator, polarity);
        let pixel_noise = pixel_noise(&operator, noise);
        Ok(Self {
            live,
            rule_hyperparameter: lambda,
            polarity,
            pixel_noise,
            inside: prepared.map.inside_pixels().to_vec(),
            grid_len: prepared.map.grid().len(),
            missing: None,
            elements: None,
            left_out: None,
            scratch: Scratch::default(),
            problem,
            operator,
        })
    }

    /// The operator with all channels.
    pub fn operator(&self) -> &Operator {
        &self.operator
    }

    /// Current lambda.
    pub fn hyperparameter(&self) -> f64 {
        self.operator.hyperparameter
    }

    /// lambda from the skin file's rule or a calibration, whatever the current value.
    pub fn rule_hyperparameter(&self) -> f64 {
        self.rule_hyperparameter
    }

    /// Rebuilds the operator at another lambda. After an error the imager is unchanged.
    ///
    /// # Errors
    /// A lambda that is not positive and finite, or too small for the system to be solved.
    pub fn set_hyperparameter(&mut self, lambda: f64, noise: &[f64]) -> Result<(), Error> {
        let new = self.work_out(lambda)()?;
        self.replace_operator(new, noise)
    }

    /// The computation of the operator at another lambda. It takes longer than a frame and can run elsewhere.
    pub(crate) fn work_out(&self, lambda: f64) -> impl FnOnce() -> Result<NewOperator, Error> + Send + 'static {
        let (problem, polarity) = (self.problem.clone(), self.polarity);
        move || {
            let operator = problem.operator(lambda)?;
            Ok(NewOperator { live: LiveOperator::new(&operator, polarity), operator })
        }
    }

    /// Switches to another operator of the same problem. After an error the imager is unchanged.
    ///
    /// # Errors
    /// An operator that cannot do without the excluded channels, or noise that is not positive when solving for
    /// elements.
    pub(crate) fn replace_operator(&mut self, new: NewOperator, noise: &[f64]) -> Result<(), Error> {
        let NewOperator { operator, live } = new;
        let left_out = match &self.left_out {
            Some(missing) => Some(MissingChannels::new(&operator, missing.channels())?),
            None => None,
        };
        (self.live, self.operator) = (live, operator);
        self.left_out = left_out;
        self.missing = None;
        self.set_noise(noise)
    }

    /// Replaces the channel noise from which the image noise is computed.
    ///
    /// # Errors
    /// Noise that is not positive when solving for elements.
    pub fn set_noise(&mut self, noise: &[f64]) -> Result<(), Error> {
        self.pixel_noise = match (&mut self.elements, &self.left_out) {
            (Some(elements), _) => {
                elements.set_noise(noise);
                elements.noise_of_pixels()?
            }
            (None, Some(missing)) => missing.noise_deviation(&self.operator, noise),
            (None, None) => pixel_noise(&self.operator, noise),
        };
        Ok(())
    }

    /// Travel of the elements in the last frame, if these are solved for.
    pub fn heights(&self) -> Option<&LiftOffFit> {
        self.elements.as_ref().and_then(ElementImager::fit)
    }

    /// The last frame as changes of the coils' readings, if elements are solved for and there has been a frame.
    pub(crate) fn element_frame(&mut self) -> Result<Option<ElementFrame<'_>>, Error> {
        match &mut self.elements {
            Some(elements) if elements.fit().is_some() => elements.frame().map(Some),
            _ => Ok(None),
        }
    }

    /// Excludes these channels by a low-rank update of the operator, see [`MissingChannels`], and updates the image
    /// noise. Frames must have `NaN` there. An empty list restores all channels.
    ///
    /// # Errors
    /// A channel that does not exist, or all of them.
    pub fn leave_out(&mut self, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        self.left_out = if channels.is_empty() { None } else { Some(MissingChannels::new(&self.operator, channels)?) };
        self.set_noise(noise)
    }

    /// Image noise of each pixel of the grid (row-major, `NaN` outside), for channel noise with these standard
    /// deviations.
    pub fn noise_image(&self) -> Vec<f32> {
        let mut image = vec![f32::NAN; self.grid_len];
        self.scatter(&self.pixel_noise, &mut image);
        image
    }

    /// Posterior standard deviation of each pixel of the grid, relative conductivity change.
    ///
    /// # Errors
    /// See [`LinearProblem::posterior_deviation`].
    pub fn posterior_image(&self) -> Result<Vec<f32>, Error> {
        let inside: Vec<f32> =
            self.problem.posterior_deviation(self.operator.hyperparameter)?.iter().map(|v| *v as f32).collect();
        let mut image = vec![f32::NAN; self.grid_len];
        self.scatter(&inside, &mut image);
        Ok(image)
    }

    /// The last frame imaged, with missing channels replaced by their expectation from the others.
    pub fn filled(&self) -> &[f64] {
        &self.scratch.filled
    }

    /// Images one frame of difference data (model volts, `NaN` where missing) into a row-major image, `NaN` outside.
    /// Allocates only if the set of missing channels changes, or when solving for elements.
    ///
    /// # Errors
    /// All channels missing, or lengths that do not match.
    pub fn image(&mut self, difference: &[f64], image: &mut [f32]) -> Result<(), Error> {
        if difference.len() != self.live.channels() || image.len() != self.grid_len {
            return Err(Error::Frames {
                what: "difference data and image".into(),
                expected: format!("{} channels and {} pixels", self.live.channels(), self.grid_len),
                got: format!("{} and {}", difference.len(), image.len()),
            });
        }
        self.fill_in(difference)?;
        let Scratch { filled, single, image: inside, absent } = &mut self.scratch;
        inside.resize(self.live.unknowns(), 0.0);
        if let Some(elements) = &mut self.elements {
            elements.image(filled, absent, inside)?;
        } else {
            single.clear();
            single.extend(filled.iter().map(|v| *v as f32));
            self.live.apply(single, inside);
        }
        image.fill(f32::NAN);
        self.scatter(&self.scratch.image, image);
        Ok(())
    }

    /// Replaces missing channels of difference data (model volts, `NaN` where missing) by their expectation from the
    /// others. Allocates only if the set of missing channels changes.
    ///
    /// # Errors
    /// All channels missing.
    pub fn fill_in(&mut self, difference: &[f64]) -> Result<&[f64], Error> {
        let Scratch { filled, absent, .. } = &mut self.scratch;
        absent.clear();
        absent.extend((0..).zip(difference).filter(|(_, v)| !v.is_finite()).map(|(channel, _): (u32, _)| channel));
        filled.clear();
        filled.extend_from_slice(difference);
        if !absent.is_empty() {
            let left_out = self.left_out.as_ref().filter(|missing| missing.channels() == absent.as_slice());
            if left_out.is_none() && self.missing.as_ref().is_none_or(|missing| missing.channels() != absent) {
                self.missing = Some(MissingChannels::new(&self.operator, absent)?);
            }
            if let Some(missing) = left_out.or(self.missing.as_ref()) {
                missing.fill_in(filled);
            }
        }
        Ok(filled)
    }

    /// These unknowns of the image of a frame (model volts, all channels).
    pub(crate) fn part<'a>(&self, unknowns: Range<usize>, volts: &[f64], scratch: &'a mut PartScratch) -> &'a [f32] {
        let PartScratch { single, merged, image } = scratch;
        single.clear();
        single.extend(volts.iter().map(|volt| *volt as f32));
        image.resize(self.live.unknowns(), 0.0);
        self.live.apply_near(single, unknowns.clone(), merged, image);
        &image[unknowns]
    }

    /// Fills in the channels that are excluded from every frame, as is done for frames.
    pub(crate) fn fill_in_left_out(&self, volts: &mut [f64]) {
        if let Some(missing) = &self.left_out {
            missing.fill_in(volts);
        }
    }

    fn scatter(&self, inside: &[f32], image: &mut [f32]) {
        for (&pixel, &value) in self.inside.iter().zip(inside) {
            image[pixel as usize] = value;
        }
    }
}

fn pixel_noise(operator: &Operator, noise: &[f64]) -> Vec<f32> {
    let mut variance = vec![0.0; operator.matrix.nrows()];
    for (column, sigma) in operator.matrix.col_iter().zip(noise) {
        variance.iter_mut().zip(column.iter()).for_each(|(sum, value)| *sum += (value * sigma).powi(2));
    }
    variance.into_iter().map(|v| v.sqrt() as f32).collect()
}

/// The largest complete frames, which carry most information about the hyperparameter.
fn informative(data: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let energy = |frame: &Vec<f64>| frame.iter().map(|v| v * v).sum::<f64>();
    let mut frames: Vec<&Vec<f64>> = data.iter().filter(|frame| frame.iter().all(|v| v.is_finite())).collect();
    frames.sort_by(|a, b| energy(b).total_cmp(&energy(a)));
    frames.into_iter().take(MOST_FRAMES).cloned().collect()
}
