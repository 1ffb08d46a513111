//! Difference data to images: the skin's operator for a reference, with missing channels filled in and the noise that
//! reaches each pixel.

mod elements;
mod refine;

use std::sync::Arc;

use dermis_tomo::inverse::{
    Hyperparameter, LinearProblem, LiveOperator, MissingChannels, Operator, PriorMatrix, Weighting,
};
use dermis_tomo::mit::HeightsFit;
use faer::MatRef;

use crate::Error;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::skin::{HyperparameterChoice, Solve, WeightChoice};
use elements::ElementImager;
pub use refine::Refiner;

/// The live inverse of a skin: difference data in, image out.
#[derive(Debug)]
pub struct Imager {
    problem: Arc<LinearProblem>,
    operator: Operator,
    live: LiveOperator,
    polarity: f64,
    /// Standard deviation of each inside pixel caused by the reference's noise.
    pixel_noise: Vec<f32>,
    inside: Vec<u32>,
    grid_len: usize,
    missing: Option<MissingChannels>,
    /// Solves for elements in place of the operator, where the skin file says so.
    elements: Option<ElementImager>,
    /// Channels that are left out of every frame.
    left_out: Option<MissingChannels>,
    scratch: Scratch,
}

#[derive(Debug, Default)]
struct Scratch {
    filled: Vec<f64>,
    single: Vec<f32>,
    image: Vec<f32>,
    absent: Vec<u32>,
}

/// Most frames that a data-driven hyperparameter looks at.
const MOST_FRAMES: usize = 16;

impl Prepared {
    /// Builds the operator for a reference. `data` (difference frames in model volts) is looked at only by
    /// hyperparameter rules that need it.
    ///
    /// # Errors
    /// Weights that the reference cannot give, or a hyperparameter that cannot be found.
    pub fn imager(&self, reference: &Reference, data: &[Vec<f64>]) -> Result<Imager, Error> {
        let problem = self.problem(self.weights_need_no_baseline(), || {
            let weighting = self.weighting(reference)?;
            let prior = self.prior_matrix(&weighting)?;
            Ok(LinearProblem::new(self.jacobian.as_mat(), weighting, prior)?)
        })?;
        let rule = match &self.skin.imaging.hyperparameter {
            HyperparameterChoice::Number(value) => Hyperparameter::Number(*value),
            HyperparameterChoice::Relative(factor) => Hyperparameter::Relative(*factor),
            HyperparameterChoice::LCurve => Hyperparameter::LCurve,
            HyperparameterChoice::Gcv => Hyperparameter::Gcv,
            HyperparameterChoice::KnownNoise(factor) => Hyperparameter::KnownNoise { factor: *factor },
            HyperparameterChoice::NoiseFigure(target) => {
                Hyperparameter::NoiseFigure { target: *target, signal: self.central_touch() }
            }
        };
        let lambda = problem.choose(&rule, &informative(data))?;
        let mut imager = self.imager_from(problem, lambda, &reference.noise, self.skin.imaging.polarity.sign())?;
        if self.skin.imaging.solve == Solve::Heights {
            imager.elements = Some(self.element_imager(&reference.noise)?);
            imager.set_noise(&reference.noise)?;
        }
        Ok(imager)
    }

    /// As [`Prepared::imager`], from a problem made elsewhere (a calibrated one) at a given lambda; `polarity` is the sign
    /// that its unknowns get in images.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn imager_from(
        &self,
        problem: impl Into<Arc<LinearProblem>>,
        lambda: f64,
        noise: &[f64],
        polarity: f64,
    ) -> Result<Imager, Error> {
        let problem = problem.into();
        let operator = problem.operator(lambda)?;
        let live = LiveOperator::new(&operator, polarity);
        let pixel_noise = pixel_noise(&operator, noise);
        Ok(Imager {
            live,
            polarity,
            pixel_noise,
            inside: self.map.inside_pixels().to_vec(),
            grid_len: self.map.grid().len(),
            missing: None,
            elements: None,
            left_out: None,
            scratch: Scratch::default(),
            problem,
            operator,
        })
    }

    /// True where neither weights nor hyperparameter are taken from measurements, so that the operator can be built before
    /// there are any.
    pub(crate) fn operator_needs_no_baseline(&self) -> bool {
        let rule = matches!(
            self.skin.imaging.hyperparameter,
            HyperparameterChoice::Number(_) | HyperparameterChoice::Relative(_) | HyperparameterChoice::NoiseFigure(_)
        );
        self.weights_need_no_baseline() && rule && self.skin.backend.circuit.is_none()
    }

    /// True where weights, and with them the whole problem but for its hyperparameter, follow from the skin file.
    fn weights_need_no_baseline(&self) -> bool {
        matches!(self.skin.imaging.weights, WeightChoice::Identity | WeightChoice::FloorAndShare { .. })
    }

    pub(crate) fn weighting(&self, reference: &Reference) -> Result<Weighting, Error> {
        let largest = self.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
        let from_variances = |variances: Vec<f64>| Weighting::Diagonal(variances.iter().map(|v| 1.0 / v).collect());
        Ok(match &self.skin.imaging.weights {
            WeightChoice::Identity => Weighting::Identity,
            WeightChoice::FloorAndShare { floor, share } => {
                let variance = |v: &f64| (floor * largest).powi(2) + (share * v).powi(2);
                from_variances(self.voltages.iter().map(variance).collect())
            }
            WeightChoice::Measured { floor } => {
                let variance = |sigma: &f64| sigma * sigma + (floor * largest).powi(2);
                from_variances(reference.noise.iter().map(variance).collect())
            }
            WeightChoice::MeasuredFull => match &reference.covariance {
                Some(matrix) => {
                    let size = self.channels();
                    Weighting::from_covariance(MatRef::from_row_major_slice(matrix, size, size))?
                }
                None => {
                    return Err(Error::Frames {
                        what: "baseline for imaging.weights = \"measured-full\"".into(),
                        expected: "at least 16 frames without missing values".into(),
                        got: "fewer, or some values missing".into(),
                    });
                }
            },
            WeightChoice::Reciprocity { floor } => {
                let volts: Vec<f64> = reference.baseline.iter().zip(&reference.scale).map(|(b, s)| b * s).collect();
                Weighting::from_reciprocity(&volts, &self.protocol.reciprocal_channels(), floor * largest)?
            }
        })
    }

    /// The prior of the skin file. Priors that look at the sensitivity of pixels are shown that of a small spot: the pixel
    /// and those beside it, per area. A single pixel may be cut by the rim or lie under an electrode, where no channel
    /// sees anything; it must not be allowed larger values for that.
    pub(crate) fn prior_matrix(&self, weighting: &Weighting) -> Result<PriorMatrix, Error> {
        let (jacobian, areas) = (self.jacobian.as_mat(), self.map.pixel_measures());
        let (mut spots, mut spot_areas) = (jacobian.to_owned(), areas.to_vec());
        for &[a, b] in &self.basis.neighbours {
            for (pixel, beside) in [(a as usize, b as usize), (b as usize, a as usize)] {
                spot_areas[pixel] += areas[beside];
                spots.col_mut(pixel).iter_mut().zip(jacobian.col(beside).iter()).for_each(|(sum, j)| *sum += j);
            }
        }
        let pixel_area = self.map.grid().pixel_m.powi(2);
        for (spot, area) in spots.col_iter_mut().zip(&spot_areas) {
            spot.iter_mut().for_each(|value| *value *= pixel_area / area);
        }
        Ok(self.prior().matrix(spots.as_ref(), weighting, &self.basis)?)
    }

    /// Difference data of a small touch in the middle of the skin, for the noise figure.
    fn central_touch(&self) -> Vec<f64> {
        let (low, high) = self.body.outline.bounds_m();
        let middle = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
        let radius = 0.05 * (high[0] - low[0]).min(high[1] - low[1]);
        let touched: Vec<bool> =
            self.basis.positions.iter().map(|p| (p[0] - middle[0]).hypot(p[1] - middle[1]) <= radius).collect();
        (0..self.channels())
            .map(|c| self.jacobian.row(c).iter().zip(&touched).map(|(j, t)| if *t { 0.1 * j } else { 0.0 }).sum())
            .collect()
    }
}

impl Imager {
    /// The operator with all channels.
    pub fn operator(&self) -> &Operator {
        &self.operator
    }

    /// lambda.
    pub fn hyperparameter(&self) -> f64 {
        self.operator.hyperparameter
    }

    /// Rebuilds the operator at another lambda.
    ///
    /// # Errors
    /// A lambda that is not positive and finite.
    pub fn set_hyperparameter(&mut self, lambda: f64, noise: &[f64]) -> Result<(), Error> {
        self.operator = self.problem.operator(lambda)?;
        self.live = LiveOperator::new(&self.operator, self.polarity);
        self.missing = None;
        let left_out = self.left_out.take().map(|missing| missing.channels().to_vec()).unwrap_or_default();
        self.leave_out(&left_out, noise)
    }

    /// Replaces the channel noise that the image noise is worked out from.
    ///
    /// # Errors
    /// Noise that is not positive, where elements are solved for.
    pub fn set_noise(&mut self, noise: &[f64]) -> Result<(), Error> {
        self.pixel_noise = match (&mut self.elements, &self.left_out) {
            (Some(elements), _) => {
                elements.set_noise(noise);
                elements.noise_of_pixels()?
            }
            (None, Some(missing)) => {
                missing.noise_deviation(&self.operator, noise).into_iter().map(|sigma| sigma as f32).collect()
            }
            (None, None) => pixel_noise(&self.operator, noise),
        };
        Ok(())
    }

    /// Travel of the elements in the last frame, where these are solved for.
    pub fn heights(&self) -> Option<&HeightsFit> {
        self.elements.as_ref().and_then(ElementImager::fit)
    }

    /// Goes on without these channels: a low-rank update of the operator, see [`MissingChannels`], and the image noise that
    /// goes with it. Frames are to have `NaN` there. An empty list takes all channels back.
    ///
    /// # Errors
    /// A channel that does not exist, or all of them.
    pub fn leave_out(&mut self, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        self.left_out = if channels.is_empty() { None } else { Some(MissingChannels::new(&self.operator, channels)?) };
        self.set_noise(noise)
    }

    /// Image noise of each pixel of the grid (row-major, `NaN` outside), for noise of these standard deviations on the
    /// channels.
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

    /// The last frame imaged, missing channels filled in with what the others let expect.
    pub fn filled(&self) -> &[f64] {
        &self.scratch.filled
    }

    /// Images one frame of difference data (model volts, `NaN` where missing) into a row-major image, `NaN` outside.
    /// Allocates only when the set of missing channels changes, and where elements are solved for.
    ///
    /// # Errors
    /// All channels missing, or lengths that do not fit.
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

    /// Fills in the missing channels of difference data (model volts, `NaN` where missing) with what the others let expect.
    /// Allocates only when the set of missing channels changes.
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

/// The largest complete frames: those that say most about the hyperparameter.
fn informative(data: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let energy = |frame: &Vec<f64>| frame.iter().map(|v| v * v).sum::<f64>();
    let mut frames: Vec<&Vec<f64>> = data.iter().filter(|frame| frame.iter().all(|v| v.is_finite())).collect();
    frames.sort_by(|a, b| energy(b).total_cmp(&energy(a)));
    frames.into_iter().take(MOST_FRAMES).cloned().collect()
}
