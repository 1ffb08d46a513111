//! Improves the contacts of the image with the forward model: as contacts with the plates above a sheet, as spots of
//! conductivity on other layers, or not at all.

use std::sync::{Arc, Mutex, PoisonError};

use dermis_estimate::{Estimator, Evidence, MOST_NOISE, PressFit};
use dermis_touch::Contact;

use crate::Error;
use crate::beside::Beside;
use crate::calibration::Calibration;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::stages::drift::Drift;
use crate::stages::ended_presses::Gone;
use crate::stages::plates::{Plates, SheetCut};
use crate::stages::press_model::PressModel;
use crate::stages::spot_model::assumed_deviations;
use crate::stages::touch_refinement::SpotStage;
use crate::stages::workshop_error::BuiltError;

/// Refines the contacts of one skin.
#[derive(Debug)]
pub struct Refinement {
    by: By,
    takes_time: bool,
}

/// Delay after which a model made in the background takes effect, nanoseconds: several times the time to make one with
/// new cuts on one slow core, or new weights for sixteen skins.
const READY_NS: u64 = 3_000_000_000;

#[derive(Debug)]
enum By {
    /// Contacts stay as found in the image.
    Nothing,
    Presses(Box<Presses>),
}

/// Presses fitted to each frame.
#[derive(Debug)]
struct Presses {
    model: Arc<PressModel>,
    /// Fits with the channels and noise in use; `None` until the noise is known.
    stage: Option<Box<SpotStage>>,
    /// Noise of the channels in model volts, and the channels left out.
    noise: Vec<f64>,
    left_out: Vec<u32>,
    drift: Drift,
    /// The fit under changed weights, made in the background: it takes tens of milliseconds on a large skin.
    coming: Beside<Result<AgedFit, Error>>,
    /// Errors of the model because the skin differs from its file.
    built: Option<BuiltError>,
    evidence: Evidence,
    /// Radius of the indenter, if it is known, metres.
    indenter_m: Option<f64>,
    /// The sheet and its cuts, if presses are fitted to a sheet that can be cut.
    cut: Option<CutModels>,
}

/// A fit, and whether it allows for drift.
type AgedFit = (Box<dyn PressFit>, bool);

/// Held while a fit is made in the background. The skins of a body age together, and would otherwise all use the
/// processors and memory at once.
static TURN: Mutex<()> = Mutex::new(());

/// The models of a sheet that is being cut. New ones take up to a second and are computed in the background.
#[derive(Debug)]
struct CutModels {
    plates: Arc<Plates>,
    /// The cuts of the model requested last.
    cuts: Vec<SheetCut>,
    coming: Beside<Result<PressModel, Error>>,
}

impl Presses {
    fn new(prepared: &Prepared, model: PressModel, noise: Vec<f64>) -> Self {
        let touch = &prepared.skin.touch;
        let plates = Plates::of(prepared).filter(Plates::is_one).map(Arc::new);
        Self {
            model: Arc::new(model),
            stage: None,
            noise,
            left_out: Vec::new(),
            drift: Drift::new(prepared),
            coming: Beside::patient(),
            built: None,
            indenter_m: None,
            evidence: Evidence { begin: touch.begin_sigma, hold: touch.hold_sigma },
            cut: plates.map(|plates| CutModels { plates, cuts: Vec::new(), coming: Beside::patient() }),
        }
    }

    /// Restarts with the channels and noise in use.
    fn restart(&mut self, prepared: &Prepared) -> Result<(), Error> {
        self.drift.forget();
        let (fit, _) = self.fit()?;
        let mut fresh = SpotStage::new(prepared, fit, self.model.membrane_pa());
        fresh.set_built(self.built.clone());
        fresh.set_live(self.coming.is_live());
        self.stage = Some(Box::new(fresh));
        Ok(())
    }

    /// Makes a fit under the current weights. A fit that is being made is dropped.
    fn fit(&mut self) -> Result<AgedFit, Error> {
        self.coming.cancel();
        let fit = self.model.fit(self.drift.weights(&self.noise), &self.left_out, self.indenter_m)?;
        Ok((fit, self.drift.is_aged()))
    }

    /// Uses the current weights at once.
    fn reweigh(&mut self) -> Result<(), Error> {
        let (fit, is_aged) = self.fit()?;
        if let Some(stage) = &mut self.stage {
            stage.set_fit(fit, is_aged);
        }
        Ok(())
    }

    /// Requests a fit under the current weights, in the background.
    fn reweigh_soon(&mut self, time_ns: u64) {
        let (model, left_out, indenter_m) = (self.model.clone(), self.left_out.clone(), self.indenter_m);
        let (weights, is_aged) = (self.drift.weights(&self.noise), self.drift.is_aged());
        self.coming.begin(time_ns.saturating_add(READY_NS), move |wanted| {
            let _turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
            wanted.go_on()?;
            Some(model.fit(weights, &left_out, indenter_m).map(|fit| (fit, is_aged)))
        });
    }

    /// Uses the requested model or fit when it is due.
    fn take_up(&mut self, time_ns: u64) -> Result<(), Error> {
        if let Some(model) = self.cut.as_mut().and_then(|cut| cut.coming.take(time_ns)) {
            self.model = Arc::new(model?);
            if let Some(stage) = &mut self.stage {
                stage.forget();
                self.reweigh()?;
            }
        }
        if let (Some(fit), Some(stage)) = (self.coming.take(time_ns), &mut self.stage) {
            let (fit, is_aged) = fit?;
            stage.set_fit(fit, is_aged);
        }
        Ok(())
    }
}

/// True if a difference frame is no more than this noise (both model volts), without the channels left out.
fn is_noise(difference: &[f64], noise: &[f64], left_out: &[u32]) -> bool {
    let (mut square, mut count) = (0.0, 0.0);
    for (channel, (value, noise)) in (0..).zip(difference.iter().zip(noise)) {
        if *noise > 0.0 && noise.is_finite() && !left_out.contains(&channel) {
            square += (value / noise).powi(2);
            count += 1.0;
        }
    }
    square <= MOST_NOISE * count
}

impl Refinement {
    fn by(by: By) -> Self {
        Self { by, takes_time: false }
    }

    /// Leaves contacts as found in the image.
    pub fn none() -> Self {
        Self::by(By::Nothing)
    }

    /// True if touches of a skin are refined: [`dermis_skin::Skin::fits_touches`] holds and no calibration places
    /// them.
    pub fn is_wanted(prepared: &Prepared, calibration: Option<&Calibration>) -> bool {
        let by_pokes = calibration.is_some_and(|calibration| calibration.correction().is_none());
        prepared.skin.fits_touches() && !by_pokes
    }

    /// True if contacts are refined at all.
    pub fn refines(&self) -> bool {
        !matches!(self.by, By::Nothing)
    }

    /// True if presses act together, so that the amplitude of one alone cannot be compared with the image.
    pub(crate) fn is_joint(&self) -> bool {
        matches!(&self.by, By::Presses(presses) if presses.cut.is_some())
    }

    /// Accounts for the skin's deviation from its file.
    pub(crate) fn set_built(&mut self, built: Option<&BuiltError>) {
        if let By::Presses(presses) = &mut self.by {
            presses.built = built.cloned();
            presses.stage.iter_mut().for_each(|stage| stage.set_built(built.cloned()));
        }
    }

    /// A refinement for this noise of the channels (model volts).
    ///
    /// # Errors
    /// A membrane that cannot be solved; no positive noise; a mesh that cannot be made.
    pub fn new(prepared: &Prepared, noise: &[f64]) -> Result<Self, Error> {
        let mut presses = Presses::new(prepared, PressModel::new(prepared, noise)?, noise.to_vec());
        presses.restart(prepared)?;
        Ok(Self::by(By::Presses(Box::new(presses))))
    }

    /// A refinement before any noise is known: refines nothing until [`Refinement::leave_out`] is called with the
    /// noise.
    pub(crate) fn without_noise(prepared: &Prepared) -> Result<Self, Error> {
        let model = PressModel::new(prepared, &assumed_deviations(prepared))?;
        Ok(Self::by(By::Presses(Box::new(Presses::new(prepared, model, Vec::new())))))
    }

    /// From now on, searches every frame in full, within the usual bound on operations: for offline frames, where
    /// neighbouring frames may show different presses.
    #[must_use]
    pub fn taking_time(mut self) -> Self {
        self.takes_time = true;
        self.tell_pace();
        self
    }

    /// True if the search for touches is finished in each frame.
    pub(crate) fn takes_time(&self) -> bool {
        self.takes_time
    }

    fn tell_pace(&mut self) {
        if let (true, Some(stage)) = (self.takes_time, self.stage()) {
            stage.take_time();
        }
    }

    fn stage(&mut self) -> Option<&mut SpotStage> {
        match &mut self.by {
            By::Presses(presses) => presses.stage.as_deref_mut(),
            By::Nothing => None,
        }
    }

    /// Replaces the noise of the channels (model volts).
    ///
    /// # Errors
    /// No positive noise.
    pub(crate) fn set_noise(&mut self, noise: &[f64]) -> Result<(), Error> {
        let By::Presses(presses) = &mut self.by else { return Ok(()) };
        if presses.stage.is_none() {
            return Ok(());
        }
        presses.noise = noise.to_vec();
        presses.reweigh()
    }

    /// Estimates forces for an indenter of this radius (metres) from now on.
    ///
    /// # Errors
    /// No positive noise.
    pub(crate) fn set_indenter(&mut self, radius_m: Option<f64>) -> Result<(), Error> {
        let By::Presses(presses) = &mut self.by else { return Ok(()) };
        if std::mem::replace(&mut presses.indenter_m, radius_m) == radius_m || presses.stage.is_none() {
            return Ok(());
        }
        presses.reweigh()
    }

    /// Continues without these channels, with this noise of the others (model volts). An empty list restores all
    /// channels.
    ///
    /// # Errors
    /// The wrong number of channels, or none left: see
    /// [`SpotModel::without`](dermis_tomo::inverse::SpotModel::without).
    pub fn leave_out(&mut self, prepared: &Prepared, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        if let By::Presses(presses) = &mut self.by {
            (presses.noise, presses.left_out) = (noise.to_vec(), channels.to_vec());
            presses.restart(prepared)?;
        }
        self.tell_pace();
        Ok(())
    }

    /// See [`SpotStage::postpone`].
    pub(crate) fn postpone(&mut self) {
        self.stage().into_iter().for_each(SpotStage::postpone);
    }

    /// Resets to the initial state with this noise of the channels (model volts), for another skin of the same kind:
    /// all channels count, and nothing is remembered.
    ///
    /// # Errors
    /// As [`Refinement::leave_out`].
    pub fn renew(&mut self, prepared: &Prepared, noise: &[f64]) -> Result<(), Error> {
        self.leave_out(prepared, &[], noise)
    }

    /// Refines the contacts of an image, using the frame from which the imager made it.
    ///
    /// # Errors
    /// A sheet with new cuts that cannot be meshed or solved.
    pub fn refine(
        &mut self,
        time_ns: u64,
        imager: &Imager,
        image: &[f32],
        contacts: &mut Vec<Contact>,
    ) -> Result<(), Error> {
        let By::Presses(presses) = &mut self.by else { return Ok(()) };
        presses.take_up(time_ns)?;
        let Some(stage) = &mut presses.stage else { return Ok(()) };
        let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::min);
        stage.refine(time_ns, imager.filled(), &presses.noise, imager, f64::from(lowest), contacts);
        let is_touched = stage.is_touched();
        let (noise, left_out) = (&presses.noise, &presses.left_out);
        if presses.drift.observe(time_ns, is_touched, || is_noise(imager.filled(), noise, left_out)) {
            presses.reweigh_soon(time_ns);
        }
        Ok(())
    }

    /// True while presses do not explain the last frames.
    pub(crate) fn is_unsure(&self) -> bool {
        match &self.by {
            By::Presses(presses) => presses.stage.as_ref().is_some_and(|stage| stage.is_unsure()),
            By::Nothing => false,
        }
    }

    /// True if presses explain a frame (model volts, finite) for the most part.
    pub(crate) fn explains(&mut self, time_ns: u64, difference: &[f64]) -> bool {
        self.stage().is_some_and(|stage| stage.explains(time_ns, difference))
    }

    /// Presses that are part of the baseline but have ended, once that is certain.
    pub(crate) fn gone(&mut self) -> Option<Gone<'_>> {
        self.stage().and_then(SpotStage::gone)
    }

    /// The part of the last frame explained by the presses reported (model volts); `None` without any.
    pub(crate) fn explained(&mut self) -> Option<&[f64]> {
        self.stage().and_then(SpotStage::explained)
    }

    /// States whether frames come from an instrument, which doesn't wait for models, weights or searches.
    pub(crate) fn set_live(&mut self, is_live: bool) {
        let By::Presses(presses) = &mut self.by else { return };
        presses.coming.set_live(is_live);
        if let Some(cut) = &mut presses.cut {
            cut.coming.set_live(is_live);
        }
        if let Some(stage) = &mut presses.stage {
            stage.set_live(is_live);
        }
    }

    /// Number of frames that had to wait for a model or weights.
    pub(crate) fn waits(&self) -> u64 {
        match &self.by {
            By::Presses(presses) => {
                let by_cuts = presses.cut.as_ref().map_or(0, |cut| cut.coming.waits());
                let by_searches = presses.stage.as_ref().map_or(0, |stage| stage.waits());
                presses.coming.waits() + by_cuts + by_searches
            }
            By::Nothing => 0,
        }
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub(crate) fn forget(&mut self) {
        if let Some(stage) = self.stage() {
            stage.forget();
        }
    }

    /// Fits touches to the sheet with these cuts, if they are fitted to a sheet that can be cut. The cuts take effect
    /// after three seconds of frame time. Does nothing if the sheet has the same cuts already.
    pub(crate) fn set_cuts(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        let By::Presses(presses) = &mut self.by else { return };
        let Some(cut) = presses.cut.as_mut().filter(|cut| cut.cuts != cuts) else { return };
        cut.cuts = cuts.to_vec();
        let (plates, cuts) = (cut.plates.clone(), cuts.to_vec());
        cut.coming.begin(time_ns.saturating_add(READY_NS), move |wanted| {
            PressModel::of_plates(&plates, &cuts, || wanted.go_on().is_some()).transpose()
        });
    }

    /// True if [`Refinement::share_of_release`] has an answer.
    pub(crate) fn knows_releases(&self) -> bool {
        self.is_joint() && matches!(&self.by, By::Presses(presses) if presses.stage.is_some())
    }

    /// Share of the energy of a change of the untouched skin (model volts, NaN where missing) that the end of presses
    /// explains. `None` if that cannot be tested.
    pub(crate) fn share_of_release(&self, change: &[f64]) -> Option<f64> {
        let By::Presses(presses) = &self.by else { return None };
        let missing = |(channel, value): (u32, &f64)| !value.is_finite() && !presses.left_out.contains(&channel);
        if !self.knows_releases() || (0..).zip(change).any(missing) {
            return None;
        }
        let fit = presses.model.fit(presses.drift.weights(&presses.noise), &presses.left_out, None).ok()?;
        let mut estimator = Estimator::new(fit, presses.evidence, false);
        if self.takes_time {
            estimator.take_time();
        }
        // Channels that are left out are ignored.
        let opposite: Vec<f64> = change.iter().map(|value| if value.is_finite() { -value } else { 0.0 }).collect();
        let estimate = estimator.explain(&opposite, &[])?;
        (!estimate.presses.is_empty()).then_some(1.0 - estimate.unexplained)
    }
}
