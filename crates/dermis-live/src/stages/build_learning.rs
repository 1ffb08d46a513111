//! Learns in the background how a skin was built, from its baseline.

use std::sync::Arc;

use crate::Error;
use crate::as_built::{from_rest, is_off, learns_from_rest};
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
pub(crate) struct BuildLearning {
    /// The skin as drawn.
    drawn: Arc<Prepared>,
    coming: Beside<Result<Option<Box<Learned>>, Error>>,
    is_learning: bool,
    /// The result, until a sound frame comes.
    ready: Option<Box<Learned>>,
}

/// The model of the skin as built, with the parts that image and refine by it.
#[derive(Debug)]
pub(crate) struct Learned {
    pub prepared: Prepared,
    pub imager: Imager,
    pub refinement: Refinement,
}

impl BuildLearning {
    /// `None` for a skin whose baseline does not show how it was built.
    pub fn of(drawn: &Arc<Prepared>) -> Option<Self> {
        let learning = || Self { drawn: drawn.clone(), coming: Beside::patient(), is_learning: false, ready: None };
        learns_from_rest(drawn).then(learning)
    }

    /// States whether frames come from an instrument, which doesn't wait.
    pub fn set_live(&mut self, is_live: bool) {
        self.coming.set_live(is_live);
    }

    /// Number of frames that waited for the result.
    pub fn waits(&self) -> u64 {
        self.coming.waits()
    }

    /// Learns from this baseline, without these channels.
    pub fn begin(&mut self, time_ns: u64, reference: &Reference, left_out: &[u32]) {
        if self.is_learning || !is_off(&self.drawn, reference.misfit) {
            return;
        }
        let (drawn, mut reference) = (self.drawn.clone(), reference.clone());
        for &channel in left_out {
            reference.baseline[channel as usize] = f64::NAN;
        }
        self.is_learning = true;
        self.coming.begin(time_ns.saturating_add(DUE_NS), move |_| Some(learned(&drawn, &reference)));
    }

    /// The result, if it is due and the last frame was sound.
    pub fn take(&mut self, time_ns: u64, is_sound: bool) -> Option<Box<Learned>> {
        if let Some(found) = self.coming.take(time_ns) {
            self.is_learning = false;
            self.ready = found.unwrap_or_else(|error| {
                tracing::warn!("how the skin was built cannot be learned from its baseline: {error}");
                None
            });
        }
        self.ready.take_if(|_| is_sound)
    }
}

fn learned(drawn: &Prepared, reference: &Reference) -> Result<Option<Box<Learned>>, Error> {
    // Twins in a page are as drawn, and there are no threads to work beside the frames.
    if cfg!(target_family = "wasm") {
        return Ok(None);
    }
    let Some(prepared) = from_rest(drawn, reference)? else { return Ok(None) };
    let reference = Reference {
        noise: reference.noise.clone(),
        ..Reference::of(&prepared, std::slice::from_ref(&reference.baseline))?
    };
    let refinement = Refinement::new(&prepared, &reference.noise)?;
    let CalibratedImager { imager, .. } = CalibratedImager::new(&prepared, None, reference, &[])?;
    Ok(Some(Box::new(Learned { prepared, imager, refinement })))
}
