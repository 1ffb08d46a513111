//! Calibrations in use: forces, and the quantities that pokes give.

use dermis_touch::force::ForceCalibration;

use super::Pipeline;
use super::state::State;
use crate::Error;
use crate::calibration::{Calibration, LoadQuantity};
use crate::forces::ForceSource;
use crate::stages::refinement::Refinement;

impl Pipeline {
    /// Estimates forces by a calibration from now on.
    ///
    /// # Errors
    /// A calibration of another skin, or with invalid numbers; a skin whose circuit is still to be found, since that
    /// changes amplitudes.
    pub fn set_forces(&mut self, forces: ForceCalibration) -> Result<(), Error> {
        forces.check(&self.prepared.skin.name)?;
        if self.circuit.is_some() {
            let what = format!("force calibration of skin {}", self.prepared.skin.name);
            let expected = "the circuit itself in the skin file, with which forces were calibrated".into();
            return Err(Error::Frames { what, expected, got: "backend.circuit = \"learn\"".into() });
        }
        if let State::Running(running) = &mut self.state {
            running.reconstructor.set_forces(Some(forces.clone()))?;
        }
        self.choices.forces = Some(forces);
        Ok(())
    }

    /// The calibration that locates touches, if there is one.
    pub fn calibration(&self) -> Option<&Calibration> {
        self.choices.calibration.as_ref()
    }

    /// Quantity of the touches' loads, if a calibration by pokes estimates them.
    pub fn load_quantity(&self) -> Option<LoadQuantity> {
        self.choices.calibration.as_ref().and_then(Calibration::load_quantity)
    }

    /// Source of the touches' forces; `None` if they are unknown.
    pub fn force_source(&self) -> Option<ForceSource> {
        let choices = &self.choices;
        if choices.forces.is_some() {
            return Some(ForceSource::Calibration);
        }
        if self.load_quantity() == Some(LoadQuantity::ForceN) {
            return Some(ForceSource::Pokes);
        }
        let has_law = Refinement::is_wanted(&self.prepared, choices.calibration.as_ref())
            && self.prepared.skin.states_force_law();
        has_law.then_some(ForceSource::Law)
    }

    /// True if a calibration without labels may locate touches, and may report alternative positions.
    pub fn may_tell_other_places(&self) -> bool {
        self.choices.calibration.is_none() && self.prepared.skin.backend.circuit.is_some()
    }
}
