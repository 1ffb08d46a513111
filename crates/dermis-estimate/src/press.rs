//! A press, and what fits presses to frames.

/// A press with its posterior.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Press {
    /// Its middle in the skin's frame, metres.
    pub position_m: [f64; 2],
    /// Its radius, metres; what a radius is of depends on the response.
    pub radius_m: f64,
    /// How much it changes the skin at its middle, in the response's unit; negative for a press that the baseline holds
    /// and that has gone.
    pub load: f64,
    /// Covariance of x, y (metres), load and logarithm of the radius.
    pub covariance: [[f64; 4]; 4],
}

impl Press {
    /// Load times the square of the radius, which frames determine far better than either.
    pub fn strength(&self) -> f64 {
        self.load * self.radius_m * self.radius_m
    }

    /// Standard deviation of the place, both coordinates together, metres.
    pub fn place_sigma_m(&self) -> f64 {
        (self.covariance[0][0] + self.covariance[1][1]).sqrt()
    }

    /// Distance from another press, metres.
    pub fn distance_m(&self, other: &Self) -> f64 {
        (self.position_m[0] - other.position_m[0]).hypot(self.position_m[1] - other.position_m[1])
    }

    /// The strength over its standard deviation.
    pub fn significance(&self) -> f64 {
        let c = &self.covariance;
        // ln |strength| = ln |load| + 2 ln radius.
        let of_load = c[2][2] / (self.load * self.load);
        let of_both = 4.0 * c[2][3] / self.load;
        let variance = of_load + of_both + 4.0 * c[3][3];
        if variance > 0.0 { variance.sqrt().recip() } else { 0.0 }
    }
}

/// What a fit leaves of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cost {
    /// Sum of squares of the whitened residual, with the priors.
    pub residual: f64,
    /// The same of the whole frame.
    pub energy: f64,
    /// Degrees of freedom: independent whitened readings.
    pub freedom: f64,
    /// What the model of the presses is known to leave of such a frame beyond the noise; 0 without presses.
    pub model_error: f64,
}

/// Mean square of what noise alone leaves, at most: it is known to a third from 32 frames at rest.
const MOST_NOISE: f64 = 1.5;

/// Mean square from which what is left of a weak frame is more than noise.
const UNEXPLAINED_BY_NOISE: f64 = 2.0;

impl Cost {
    /// Whether noise explains what is left.
    pub fn is_noise(&self) -> bool {
        self.residual <= MOST_NOISE * self.freedom
    }

    /// Share of the frame's energy beyond the noise that is left beyond the noise, 0 to 1; 0 where what is left may be
    /// noise.
    pub fn unexplained(&self) -> f64 {
        if self.residual <= UNEXPLAINED_BY_NOISE * self.freedom {
            return 0.0;
        }
        let beyond = |value: f64| (value - self.freedom).max(0.0);
        match beyond(self.energy) {
            0.0 => 0.0,
            energy => (beyond(self.residual) / energy).min(1.0),
        }
    }
}

/// Where one more press would help.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// A start for its fit.
    pub press: Press,
    /// By how much it lowers the residual while the others stay as they are.
    pub gain: f64,
}

/// How exactly presses are fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// As if channels changed in proportion to loads: while explanations are compared with each other.
    Quick,
    /// By the whole model.
    Full,
}

/// Fits presses to the frames of one skin, in memory of its own.
pub trait PressFit {
    /// Takes up a frame (volts of the model, all finite), and fits the nuisances alone. `None` where the frame cannot be
    /// fitted: another length, or values that are not finite.
    fn take_frame(&mut self, frame: &[f64]) -> Option<Cost>;

    /// Fits presses from these starts to the frame taken up last. `None` where they cannot be fitted.
    fn fit(&mut self, starts: &[Press], effort: Effort) -> Option<Cost>;

    /// Fits the loads of presses that stay where they are, each with its radius.
    fn fit_loads(&mut self, starts: &[Press]) -> Option<Cost>;

    /// Whether [`Effort::Quick`] and [`Effort::Full`] differ.
    fn has_quick_fit(&self) -> bool;

    /// The presses of the last fit, in the order of its starts.
    fn presses(&self) -> Vec<Press>;

    /// Goes back to the frame as it was taken up, without presses.
    fn fit_nothing(&mut self) -> Option<Cost>;

    /// Places where one more press explains most of what the last fit has left, the best first; of either sign where
    /// `negative` is set.
    fn seek(&self, negative: bool) -> Vec<Proposal>;

    /// By how much the best of these lowers the residual, without making a list of them.
    fn most_gain(&self, negative: bool) -> f64;

    /// Whether a place is on the skin.
    fn is_inside(&self, position_m: [f64; 2]) -> bool;

    /// Largest standard deviation of the place of a press, metres.
    fn most_sigma_m(&self) -> f64;

    /// Most presses that can be fitted together.
    fn most_presses(&self) -> usize;
}
