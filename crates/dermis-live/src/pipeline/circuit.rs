//! Switches to the readout's circuit found in the background. Until a circuit explains the presses better, images are
//! those of an ideal voltmeter.

use super::state::{Running, State};
use super::{Operators, Pipeline};
use crate::Error;
use crate::calibration::{PlacementFinder, SelfCalibrated};

impl Pipeline {
    /// Adds the current frame to the presses.
    pub(super) fn gather_presses(&mut self, time_ns: u64, is_believed: bool) {
        let (Some(circuit), State::Running(running)) = (&mut self.circuit, &self.state) else { return };
        if is_believed {
            let (difference, noise) = (&self.buffers.difference, &running.reference.noise);
            circuit.gather(time_ns, &self.prepared, &self.baseline, difference, noise);
        } else {
            circuit.forget();
        }
    }

    /// Switches to the circuit that a search has found, if it is due. Touches end and begin again, since their
    /// positions change.
    pub(super) fn take_up_circuit(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let Some((prepared, calibrated)) = self.circuit.as_mut().and_then(|circuit| circuit.take(time_ns)) else {
            return Ok(());
        };
        let State::Running(running) = &mut self.state else { return Ok(()) };
        self.prepared = prepared.into();
        let SelfCalibrated { imager, finder, .. } = calibrated;
        // The channel weights have changed. Keep a requested lambda at the same multiple of the rule's value.
        let times = imager.rule_hyperparameter() / running.reconstructor.imager.rule_hyperparameter();
        self.choices.hyperparameter = self.choices.hyperparameter.map(|lambda| times * lambda);
        running.reconstructor.imager = imager;
        running.reconstructor.placement = Some(PlacementFinder::Matched(Box::new(finder)));
        running.reconstructor.interrupt(time_ns);
        self.operators = Operators::after(self.operators.waits());
        self.pass_on_live();
        self.match_baseline(at)?;
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        let State::Running(running) = &mut self.state else { return Ok(()) };
        if !left_out.is_empty() && left_out.len() < running.reference.noise.len() {
            running.reconstructor.leave_out(&self.prepared, left_out, &running.reference.noise)?;
        }
        self.see_damage_anew()?;
        if let Some(lambda) = self.choices.hyperparameter {
            self.make_operator(lambda);
        }
        Ok(())
    }

    /// Switches damage monitoring to the model that now makes the images. Levels, intact skin and damage sites are
    /// kept; the sites move to their positions in the new images.
    pub(super) fn see_damage_anew(&mut self) -> Result<(), Error> {
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Running { reference, reconstructor } = &mut **running;
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        if left_out.len() == reference.noise.len() {
            return Ok(());
        }
        let noise = reconstructor.imager.noise_image();
        if let Some(levels) = &mut self.levels {
            levels.set_noise(noise.clone());
            for index in 0..levels.known_count() {
                let (change, image) = levels.known(index, &reference.scale, left_out);
                reconstructor.image(change, image)?;
                levels.redraw_known(index)?;
            }
        }
        if let Some(damage) = &mut self.damage {
            let (change, image) = damage.see_anew(noise, &self.baseline, &reference.scale, left_out);
            reconstructor.image(change, image)?;
            damage.redraw()?;
        }
        Ok(())
    }
}
