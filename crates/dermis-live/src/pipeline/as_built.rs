//! Switches to the model of the skin as built, once it is learned. Touches keep their identities; their positions move
//! by the errors of the model so far.

use std::sync::Arc;

use super::state::{Running, State};
use super::{Operators, Pipeline};
use crate::Error;
use crate::stages::build_learning::Learned;

impl Pipeline {
    /// Starts to learn how the skin was built from a new baseline, unless the skin is damaged.
    pub(super) fn learn_build(&mut self, time_ns: u64) {
        if !self.damage().damages.is_empty() {
            return;
        }
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        if let (Some(learning), State::Running(running)) = (&mut self.building, &self.state) {
            learning.begin(time_ns, &running.reference, left_out);
        }
    }

    /// Switches to the skin as built, if that is due.
    pub(super) fn take_up_build(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let is_sound = self.is_seen && self.health().is_sound();
        let learned = self.building.as_mut().and_then(|learning| learning.take(time_ns, is_sound));
        let Some(learned) = learned else { return Ok(()) };
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Learned { prepared, imager, refinement } = *learned;
        let Running { reconstructor, .. } = &mut **running;
        // Keep a requested lambda at the same multiple of the rule's value.
        let times = imager.rule_hyperparameter() / reconstructor.imager.rule_hyperparameter();
        self.choices.hyperparameter = self.choices.hyperparameter.map(|lambda| times * lambda);
        self.prepared = Arc::new(prepared);
        (reconstructor.imager, reconstructor.refinement) = (imager, refinement);
        self.operators = Operators::after(self.operators.waits());
        self.pass_on_live();
        self.match_baseline(at)?;
        let State::Running(running) = &mut self.state else { return Ok(()) };
        running.reconstructor.leave_out(&self.prepared, &[], &running.reference.noise)?;
        self.see_damage_anew()?;
        if let Some(lambda) = self.choices.hyperparameter {
            self.make_operator(lambda);
        }
        tracing::debug!("touches are located on the skin as built, by its baseline");
        Ok(())
    }
}
