//! Learns in the background how the skin was built, from its baseline, and switches to the model of that skin. Touches
//! keep their identities; their positions move by the errors of the model so far.

use std::sync::Arc;

use super::state::{Running, State};
use super::{Operators, Pipeline};
use crate::Error;
use crate::as_built::{from_rest, learns_from_rest};
use crate::beside::Beside;
use crate::calibration::CalibratedImager;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::stages::refinement::Refinement;

/// Delay until the result counts, nanoseconds of the frames' time: about three times what the work takes on one slow
/// core, so that no frame waits for it.
const DUE_NS: u64 = 10_000_000_000;

/// Work in progress.
#[derive(Debug)]
pub(super) struct BuildLearning {
    /// The skin as drawn.
    drawn: Arc<Prepared>,
    coming: Beside<Result<Option<Box<Learned>>, Error>>,
    is_learning: bool,
}

/// The model of the skin as built, with the parts that image and refine by it.
#[derive(Debug)]
struct Learned {
    prepared: Prepared,
    imager: Imager,
    refinement: Refinement,
}

impl BuildLearning {
    /// `None` for a skin whose baseline does not tell how it was built.
    pub fn of(drawn: &Arc<Prepared>) -> Option<Self> {
        let learning = || Self { drawn: drawn.clone(), coming: Beside::new(), is_learning: false };
        learns_from_rest(drawn).then(learning)
    }

    /// Number of frames that waited for the result.
    pub fn waits(&self) -> u64 {
        self.coming.waits()
    }

    /// Learns from this baseline, without these channels.
    pub fn begin(&mut self, time_ns: u64, mut reference: Reference, left_out: &[u32]) {
        if self.is_learning {
            return;
        }
        for &channel in left_out {
            reference.baseline[channel as usize] = f64::NAN;
        }
        let drawn = self.drawn.clone();
        self.is_learning = true;
        self.coming.begin(time_ns.saturating_add(DUE_NS), move |_| Some(learned(&drawn, &reference)));
    }

    fn take(&mut self, time_ns: u64) -> Option<Box<Learned>> {
        let found = self.coming.take(time_ns)?;
        self.is_learning = false;
        found.unwrap_or_else(|error| {
            tracing::warn!("how the skin was built cannot be learned from its baseline: {error}");
            None
        })
    }
}

fn learned(drawn: &Prepared, reference: &Reference) -> Result<Option<Box<Learned>>, Error> {
    let Some(prepared) = from_rest(drawn, reference)? else { return Ok(None) };
    let reference = Reference {
        noise: reference.noise.clone(),
        ..Reference::of(&prepared, std::slice::from_ref(&reference.baseline))?
    };
    let refinement = Refinement::new(&prepared, &reference.noise)?;
    let CalibratedImager { imager, .. } = CalibratedImager::new(&prepared, None, reference, &[])?;
    Ok(Some(Box::new(Learned { prepared, imager, refinement })))
}

impl Pipeline {
    /// Starts to learn how the skin was built from a new baseline.
    pub(super) fn learn_build(&mut self, time_ns: u64) {
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        if let (Some(learning), State::Running(running)) = (&mut self.building, &self.state) {
            learning.begin(time_ns, running.reference.clone(), left_out);
        }
    }

    /// Switches to the skin as built, if that is due.
    pub(super) fn take_up_build(&mut self, time_ns: u64, at: (u64, u64)) -> Result<(), Error> {
        let Some(learned) = self.building.as_mut().and_then(|learning| learning.take(time_ns)) else { return Ok(()) };
        let State::Running(running) = &mut self.state else { return Ok(()) };
        let Learned { prepared, imager, refinement } = *learned;
        let Running { reconstructor, .. } = &mut **running;
        // Keep a requested lambda at the same multiple of the rule's value.
        let times = imager.rule_hyperparameter() / reconstructor.imager.rule_hyperparameter();
        self.choices.hyperparameter = self.choices.hyperparameter.map(|lambda| times * lambda);
        self.prepared = Arc::new(prepared);
        (reconstructor.imager, reconstructor.refinement) = (imager, refinement);
        self.operators = Operators::after(self.operators.waits());
        self.use_baseline(at)?;
        let left_out = self.health.as_ref().map_or(&[][..], |health| health.left_out());
        let State::Running(running) = &mut self.state else { return Ok(()) };
        if left_out.len() < running.reference.noise.len() {
            running.reconstructor.leave_out(&self.prepared, left_out, &running.reference.noise)?;
        }
        self.see_damage_anew()?;
        if let Some(lambda) = self.choices.hyperparameter {
            self.make_operator(lambda);
        }
        tracing::debug!("touches are located on the skin as built, by its baseline");
        Ok(())
    }
}
