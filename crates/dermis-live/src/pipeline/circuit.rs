//! Goes on with the readout's circuit that was found beside the stream. Until one explains the presses better, images
//! are those of an ideal voltmeter.

use super::state::State;
use super::{DamageStage, LevelStage, Operators, Pipeline};
use crate::Error;
use crate::calibration::{PlacementFinder, SelfCalibrated};

impl Pipeline {
    /// Lets the frame just seen be gathered.
    pub(super) fn gather_presses(&mut self, time_ns: u64, is_believed: bool) {
        let (Some(circuit), State::Running(running)) = (&mut self.circuit, &self.state) else { return };
        if is_believed {
            let (difference, noise) = (&self.buffers.difference, &running.reference.noise);
            circuit.gather(time_ns, &self.prepared, &self.baseline, difference, noise);
        } else {
            circuit.forget();
        }
    }

    /// Takes up the circuit that a search has found, if its time has come. Touches end and begin anew: they were seen
    /// elsewhere.
    pub(super) fn take_up_circuit(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let Some((prepared, calibrated)) = self.circuit.as_mut().and_then(|circuit| circuit.take(time_ns)) else {
            return Ok(());
        };
        let State::Running(running) = &mut self.state else { return Ok(()) };
        self.prepared = prepared;
        let SelfCalibrated { imager, finder, .. } = calibrated;
        // Channels are weighed otherwise now: a lambda that was asked for stays as many times what the rule gives.
        let times = imager.rule_hyperparameter() / running.reconstructor.imager.rule_hyperparameter();
        self.choices.hyperparameter = self.choices.hyperparameter.map(|lambda| times * lambda);
        running.reconstructor.imager = imager;
        running.reconstructor.placement = Some(PlacementFinder::Matched(Box::new(finder)));
        running.reconstructor.interrupt(time_ns);
        self.operators = Operators::after(self.operators.waits());
        if self.damage.is_some() {
            self.damage = Some(DamageStage::new(&self.prepared)?);
        }
        if self.levels.is_some() {
            self.levels = Some(LevelStage::new(&self.prepared)?);
        }
        self.use_baseline(at)?;
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        let State::Running(running) = &mut self.state else { return Ok(()) };
        if !left_out.is_empty() && left_out.len() < running.reference.noise.len() {
            running.reconstructor.leave_out(&self.prepared, left_out, &running.reference.noise)?;
        }
        if let Some(lambda) = self.choices.hyperparameter {
            self.make_operator(lambda);
        }
        Ok(())
    }
}
