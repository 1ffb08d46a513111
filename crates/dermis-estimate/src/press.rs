//! A press, and the interface for fitting presses to frames.

use dermis_tomo::mesh::{Point, distance};

/// A press with its posterior.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Press {
    /// Centre in the skin's frame, metres.
    pub position_m: Point,
    /// Radius, metres; its exact meaning depends on the response.
    pub radius_m: f64,
    /// Change of the skin at the centre, in the response's unit. Negative for a press that is part of the baseline
    /// and has ended.
    pub load: f64,
    /// Covariance of x, y (metres), load and the logarithm of the radius.
    pub covariance: [[f64; 4]; 4],
}

impl Press {
    /// Load times the square of the radius. Frames determine it far better than either factor.
    pub fn strength(&self) -> f64 {
        self.load * self.radius_m * self.radius_m
    }

    /// Standard deviation of the position, both coordinates combined, metres.
    pub fn place_sigma_m(&self) -> f64 {
        (self.covariance[0][0] + self.covariance[1][1]).sqrt()
    }

    /// Distance from another press, metres.
    pub fn distance_m(&self, other: &Self) -> f64 {
        distance(self.position_m, other.position_m)
    }

    /// Ratio of the strength to its standard deviation.
    pub fn significance(&self) -> f64 {
        let c = &self.covariance;
        // ln |strength| = ln |load| + 2 ln radius.
        let of_load = c[2][2] / (self.load * self.load);
        let of_both = 4.0 * c[2][3] / self.load;
        let variance = of_load + of_both + 4.0 * c[3][3];
        if variance > 0.0 { variance.sqrt().recip() } else { 0.0 }
    }
}

/// Errors at one press of a skin that is not as drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BuiltVariance {
    /// Variance of the channels' relative response.
    pub gain: f64,
    /// Variance of the layer's relative change under a given pressure.
    pub law: f64,
}

/// Footprint of a press.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Footprint {
    /// Radius of the spot, or of the contact, metres.
    pub radius_m: f64,
    /// Force and its standard deviation, newtons, if the model's own law of contact tells them.
    pub force_n: Option<[f64; 2]>,
}

/// Residual of a fit, and the numbers to judge it by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Sum of squares of the whitened residual, including the priors.
    pub residual: f64,
    /// Sum of squares of the whole whitened frame.
    pub energy: f64,
    /// Degrees of freedom: independent whitened readings.
    pub freedom: f64,
    /// Energy beyond the noise that the model of presses is known to leave in such a frame; 0 without presses.
    pub model_error: f64,
}

/// Largest mean square of a residual that counts as noise. The noise level, from 32 frames at rest, is only known to
/// a third.
pub const MOST_NOISE: f64 = 1.5;

/// Largest multiple of the model's usual error that one press or a set of presses leaves.
pub(crate) const MOST_MODEL_ERROR: f64 = 4.0;

/// Mean square above which the residual of a weak frame counts as more than noise.
const UNEXPLAINED_BY_NOISE: f64 = 2.0;

impl Cost {
    /// True if the residual is consistent with noise.
    pub fn is_noise(&self) -> bool {
        self.residual <= MOST_NOISE * self.freedom
    }

    /// True if the residual is consistent with noise and a few times the known error of the model.
    pub fn is_explained(&self) -> bool {
        self.residual <= MOST_NOISE * self.freedom + MOST_MODEL_ERROR * self.model_error
    }

    /// Share of the frame's energy above the noise that is left unexplained, 0 to 1; 0 if the residual may be noise.
    pub fn unexplained(&self) -> f64 {
        if self.residual <= UNEXPLAINED_BY_NOISE * self.freedom {
            return 0.0;
        }
        self.left()
    }

    /// As [`Cost::unexplained`], also for residuals that may be noise.
    pub fn left(&self) -> f64 {
        let beyond = |value: f64| (value - self.freedom).max(0.0);
        match beyond(self.energy) {
            0.0 => 0.0,
            energy => (beyond(self.residual) / energy).min(1.0),
        }
    }
}

/// How thoroughly presses are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// With a linear response, for comparing explanations (see [`PressFit::linearise_about`]).
    Quick,
    /// With the full model.
    Full,
}

/// Fits presses to the frames of one skin, with its own working memory.
pub trait PressFit: std::fmt::Debug + Send + Sync {
    /// Takes a frame (model volts, all finite) and fits only the nuisances. `None` if the frame cannot be fitted: the
    /// wrong length, or values that are not finite.
    fn take_frame(&mut self, frame: &[f64]) -> Option<Cost>;

    /// Fits presses from these starts to the last frame taken. `None` if they cannot be fitted.
    fn fit(&mut self, starts: &[Press], effort: Effort) -> Option<Cost>;

    /// Residual of the last frame taken under the full model with these presses, which stay as they are. Not bounded by
    /// the number of operations. `None` if a fit costs no more, or if the model is linear.
    fn left_by(&mut self, _presses: &[Press]) -> Option<Cost> {
        None
    }

    /// Linearises quick fits of this frame about these presses: the nonlinear part of the response stays what it is for
    /// them. Without presses, and after some full fits, quick fits are linear about the skin at rest.
    fn linearise_about(&mut self, _presses: &[Press]) {}

    /// Fits only the loads of presses, at fixed positions and radii.
    fn fit_loads(&mut self, starts: &[Press]) -> Option<Cost>;

    /// Fits presses with the full model, some of them at fixed positions and radii. Covariances are those without fixed
    /// parameters. Also returns the amount by which a further step of all parameters would lower the residual.
    fn fit_fixed(&mut self, starts: &[Press], fixed: &[bool]) -> Option<(Cost, f64)>;

    /// Ratio of responses to presses in the last full fit to those on an unchanged skin: a sheet that has warmed up
    /// conducts better, and the same press then changes its voltages less.
    fn gain(&self) -> f64 {
        1.0
    }

    /// True if [`Effort::Quick`] and [`Effort::Full`] differ.
    fn has_quick_fit(&self) -> bool;

    /// The presses of the last fit, in the order of their starts.
    fn presses(&self) -> Vec<Press>;

    /// Returns to the frame as taken, without presses.
    fn fit_nothing(&mut self) -> Option<Cost>;

    /// Presses that would explain most of the last fit's residual, the best first; of either sign if `negative` is
    /// set.
    fn seek(&self, negative: bool) -> Vec<Press>;

    /// Presses that explain most of the last fit's residual together, strongest first.
    fn seek_together(&self) -> Vec<Press> {
        Vec::new()
    }

    /// Bounds the operations from now on, and from each next frame on. Fits beyond the bound fail.
    fn set_most_work(&mut self, _operations: f64) {}

    /// Operations spent since the bound was set or the frame was taken. Fits that are quick count none.
    fn work(&self) -> f64 {
        0.0
    }

    /// A copy with the same weights, for a search in the background. `None` if fits are too quick to need one.
    fn copy(&self) -> Option<Box<dyn PressFit>> {
        None
    }

    /// True if presses act together in a way that their single responses do not show: linear images join them.
    fn is_joint(&self) -> bool {
        false
    }

    /// Best set of presses for the last frame taken: one press if `is_first`, one more with each further call. With
    /// `have_ended`, they have a negative load. `None` if there is no larger set, or unless [`PressFit::is_joint`].
    fn next_joint_set(&mut self, _is_first: bool, _have_ended: bool) -> Option<Vec<Press>> {
        None
    }

    /// These presses with the common radius from which a fit to the last frame taken should start.
    fn resized(&mut self, presses: Vec<Press>) -> Vec<Press> {
        presses
    }

    /// Gain of the best of these proposals, without listing them.
    fn most_gain(&self, negative: bool) -> f64;

    /// True if a position is on the skin.
    fn is_inside(&self, position_m: Point) -> bool;

    /// Radius of a typical press, metres.
    fn typical_radius_m(&self) -> f64;

    /// Largest number of presses that can be fitted together.
    fn most_presses(&self) -> usize;

    /// Sets the share of a frame's energy that the model leaves unexplained in addition to its usual error: the skin
    /// is not as drawn.
    fn set_error_beyond(&mut self, share: f64);

    /// Change of the channels by these presses, volts.
    fn channels_of(&mut self, presses: &[Press], volts: &mut Vec<f64>);

    /// Factor on the covariances of positions by errors of the model, besides those in the covariances themselves, for
    /// an explanation with this cost.
    fn place_scale(&self, _cost: &Cost) -> f64 {
        1.0
    }

    /// Footprints of the presses that explain the frame taken, and the errors at each of a skin that is not as drawn.
    fn footprints(&mut self, presses: &[Press], _built: &[BuiltVariance]) -> Vec<Footprint> {
        presses.iter().map(|press| Footprint { radius_m: press.radius_m, force_n: None }).collect()
    }

    /// Largest change of the skin per unit of load under a press like this one.
    fn largest_change(&mut self, _press: &Press) -> f64 {
        1.0
    }
}
