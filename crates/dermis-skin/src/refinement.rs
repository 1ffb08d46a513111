//! Settings in a skin file for images of large contrasts: `imaging.refinement`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::check::Checker;
use crate::error::Error;

/// Maximum number of steps; more are a typing error.
const MOST_STEPS: usize = 50;

/// Gauss-Newton steps in `y = log(sigma / sigma at rest)`, for contrasts too large for one linear step (tanks with
/// metal and plastic). Refined images show y instead of the relative change of conductivity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Refinement {
    /// Number of steps; the first is the linear image.
    pub steps: usize,
    /// Maximum change of any pixel (in y) in one step; a larger step is shortened as a whole.
    #[serde(default = "Refinement::default_largest_step")]
    pub largest_step: f64,
    /// Pixels are clamped to plus and minus this y.
    #[serde(default = "Refinement::default_limit")]
    pub limit: f64,
    /// With a threshold t, images are written as `sign(y) clip(|y| - t, 0, 1)`: 0 in the background, 1 in strong
    /// inclusions. Touches are still found on y.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub soft_threshold: Option<f64>,
}

impl Refinement {
    fn default_largest_step() -> f64 {
        1.5
    }

    fn default_limit() -> f64 {
        3.0
    }

    /// Applies `sign(y) clip(|y| - t, 0, 1)` with the file's threshold t, if it has one.
    pub fn threshold(&self, image: &mut [f32]) {
        if let Some(threshold) = self.soft_threshold {
            for value in image.iter_mut() {
                *value = value.signum() * (value.abs() - threshold as f32).clamp(0.0, 1.0);
            }
        }
    }

    /// Checks the table. `circuit`: the skin has a readout circuit.
    pub(crate) fn check(&self, circuit: bool, checker: &Checker<'_>) -> Result<(), Error> {
        if !(1..=MOST_STEPS).contains(&self.steps) {
            return Err(checker.refused("imaging.refinement.steps", self.steps, format!("1 to {MOST_STEPS}")));
        }
        checker.within("imaging.refinement.largest_step", self.largest_step, 1e-6, 1e6)?;
        checker.within("imaging.refinement.limit", self.limit, 1e-6, 1e3)?;
        checker.within("imaging.refinement.soft_threshold", self.soft_threshold.unwrap_or(1.0), 1e-9, 1e3)?;
        if circuit {
            let expected = "no refinement with backend.circuit: its model is linearised about the resting skin";
            return Err(checker.refused("imaging.refinement.steps", self.steps, expected));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Skin;

    fn skin(refinement: &str) -> Result<Skin, Error> {
        let text = crate::builtin_text("golfball-tank").unwrap();
        let with_it = text.replace("[imaging]\n", &format!("[imaging]\nrefinement = {refinement}\n"));
        Skin::parse(&with_it, "made.toml")
    }

    #[test]
    fn values_are_read_defaulted_and_checked() {
        let read = skin("{ steps = 2 }").unwrap().imaging.refinement.unwrap();
        assert_eq!(read, Refinement { steps: 2, largest_step: 1.5, limit: 3.0, soft_threshold: None });
        for (text, says) in [
            ("{ steps = 0 }", "made.toml: imaging.refinement.steps = 0: expected 1 to 50"),
            ("{ steps = 2, limit = -1.0 }", "made.toml: imaging.refinement.limit = -1: expected 1e-6 to 1000"),
        ] {
            assert_eq!(skin(text).unwrap_err().to_string(), says);
        }
        assert!(skin("{ steps = 2, step = 1 }").is_err());
    }

    #[test]
    fn the_threshold_clears_the_background_and_saturates() {
        let mut image = [0.4, -0.75, 3.0, -2.0, f32::NAN];
        Refinement { steps: 1, largest_step: 1.5, limit: 3.0, soft_threshold: Some(0.5) }.threshold(&mut image);
        assert_eq!(image[..4], [0.0, -0.25, 1.0, -1.0]);
        assert!(image[4].is_nan());
    }
}
