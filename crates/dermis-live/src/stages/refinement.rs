//! Improves the contacts of the image with the forward model: as patches of contact on a sandwich, as spots of
//! conductivity on other layers, or not at all.

use dermis_touch::Contact;

use crate::Error;
use crate::calibration::Calibration;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::stages::drift::Drift;
use crate::stages::gone::Gone;
use crate::stages::press_model::PressModel;
use crate::stages::sandwich_contacts::{PatchStage, SheetCut, is_sandwich};
use crate::stages::spot_model::assumed_deviations;
use crate::stages::touch_refinement::SpotStage;
use crate::stages::workshop_error::BuiltError;

/// Refines the contacts of one skin.
#[derive(Debug)]
pub struct Refinement {
    by: By,
    takes_time: bool,
}

#[derive(Debug)]
enum By {
    /// Contacts stay as found in the image.
    Nothing,
    Spots {
        model: PressModel,
        /// Fits with the channels and noise in use; `None` until the noise is known.
        stage: Option<Box<SpotStage>>,
        /// Noise of the channels in model volts, and the channels left out.
        noise: Vec<f64>,
        left_out: Vec<u32>,
        drift: Box<Drift>,
        /// Share of a press's energy that the model leaves because the skin is not as drawn.
        built_share: f64,
    },
    Patches(Box<PatchStage>),
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

    /// True if contacts are fitted as spots, with amplitudes from the image.
    pub(crate) fn fits_spots(&self) -> bool {
        matches!(self.by, By::Spots { .. })
    }

    /// Takes into account how far the skin is from its file.
    pub(crate) fn set_built(&mut self, built: Option<&BuiltError>) {
        if let By::Spots { stage, built_share, .. } = &mut self.by {
            *built_share = built.map_or(0.0, BuiltError::unexplained);
            stage.iter_mut().for_each(|stage| stage.set_built_share(*built_share));
        }
    }

    /// A refinement for this noise of the channels (model volts).
    ///
    /// # Errors
    /// A membrane that cannot be solved; no positive noise; a mesh that cannot be made.
    pub fn new(prepared: &Prepared, noise: &[f64]) -> Result<Self, Error> {
        if is_sandwich(prepared) {
            return Ok(Self::by(By::Patches(Box::new(PatchStage::new(prepared, noise)?))));
        }
        let model = PressModel::new(prepared, noise)?;
        let drift = Box::new(Drift::new(prepared));
        let fit = model.fit(noise, &[], &drift)?;
        let stage = Some(Box::new(SpotStage::new(prepared, fit, model.membrane_pa())));
        let (noise, left_out) = (noise.to_vec(), Vec::new());
        Ok(Self::by(By::Spots { model, stage, noise, left_out, drift, built_share: 0.0 }))
    }

    /// A refinement before any noise is known: refines nothing until [`Refinement::leave_out`] is called with the
    /// noise.
    pub(crate) fn without_noise(prepared: &Prepared) -> Result<Self, Error> {
        if is_sandwich(prepared) {
            return Self::new(prepared, &vec![0.0; prepared.channels()]);
        }
        let (noise, left_out, drift) = (Vec::new(), Vec::new(), Box::new(Drift::new(prepared)));
        let model = PressModel::new(prepared, &assumed_deviations(prepared))?;
        Ok(Self::by(By::Spots { model, stage: None, noise, left_out, drift, built_share: 0.0 }))
    }

    /// From now on, finishes the search for touches in each frame, however long it takes: for offline frames, where
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
        match &mut self.by {
            By::Patches(patches) if self.takes_time => patches.take_time(),
            By::Spots { stage: Some(spots), .. } if self.takes_time => spots.take_time(),
            By::Patches(_) | By::Spots { .. } | By::Nothing => {}
        }
    }

    /// Replaces the noise of the channels (model volts) for fits of patches.
    pub(crate) fn set_noise(&mut self, noise: &[f64]) {
        if let By::Patches(patches) = &mut self.by {
            patches.set_noise(noise);
        }
    }

    /// Continues without these channels, with this noise of the others (model volts). An empty list restores all
    /// channels.
    ///
    /// # Errors
    /// The wrong number of channels, or none left: see
    /// [`SpotModel::without`](dermis_tomo::inverse::SpotModel::without).
    pub fn leave_out(&mut self, prepared: &Prepared, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        match &mut self.by {
            By::Nothing => {}
            By::Patches(patches) => patches.leave_out(channels),
            By::Spots { model, stage, noise: kept, left_out, drift, built_share } => {
                (*kept, *left_out) = (noise.to_vec(), channels.to_vec());
                drift.forget();
                drift.age_s = 0.0;
                let fit = model.fit(noise, channels, drift)?;
                let mut fresh = SpotStage::new(prepared, fit, model.membrane_pa());
                fresh.set_built_share(*built_share);
                *stage = Some(Box::new(fresh));
            }
        }
        self.tell_pace();
        Ok(())
    }

    /// Resets to the initial state with this noise of the channels (model volts), for another skin of the same kind:
    /// all channels count, and nothing is remembered.
    ///
    /// # Errors
    /// As [`Refinement::leave_out`].
    pub fn renew(&mut self, prepared: &Prepared, noise: &[f64]) -> Result<(), Error> {
        if let By::Patches(patches) = &mut self.by {
            patches.renew(noise);
            return Ok(());
        }
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
        let difference = imager.filled();
        match &mut self.by {
            By::Patches(patches) => {
                let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::min);
                patches.refine(time_ns, difference, f64::from(lowest), contacts)?;
            }
            By::Spots { model, stage: Some(spots), noise, left_out, drift, .. } => {
                spots.refine(time_ns, difference, imager, contacts);
                if drift.observe(time_ns, spots.is_touched()) {
                    spots.set_fit(model.fit(noise, left_out, drift)?, drift.age_s > 0.0);
                }
            }
            By::Spots { stage: None, .. } | By::Nothing => {}
        }
        Ok(())
    }

    /// Presses that are part of the baseline but have ended, once that is certain.
    pub(crate) fn gone(&mut self) -> Option<Gone<'_>> {
        match &mut self.by {
            By::Spots { stage: Some(spots), .. } => spots.gone(),
            By::Patches(patches) => patches.take_gone().then_some(Gone::Alone),
            By::Spots { stage: None, .. } | By::Nothing => None,
        }
    }

    /// The part of the last frame explained by the fitted contacts of a sandwich (model volts); `None` if no fit is
    /// accepted.
    pub(crate) fn explained(&self) -> Option<&[f64]> {
        self.patches().and_then(PatchStage::explained)
    }

    /// Number of frames that had to wait for the sheets that touches are fitted on.
    pub(crate) fn waits(&self) -> u64 {
        self.patches().map_or(0, PatchStage::waits)
    }

    /// True while a search for touches is in progress.
    pub(crate) fn is_seeking(&self) -> bool {
        matches!(&self.by, By::Patches(patches) if patches.is_seeking())
    }

    /// Frames are missing before the next: restart the search for touches, but keep the age of the baseline.
    pub(crate) fn interrupt(&mut self) {
        match &mut self.by {
            By::Patches(patches) => patches.let_go(),
            By::Spots { .. } | By::Nothing => self.forget(),
        }
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub(crate) fn forget(&mut self) {
        match &mut self.by {
            By::Patches(patches) => patches.forget(),
            By::Spots { stage: Some(spots), .. } => spots.forget(),
            By::Spots { stage: None, .. } | By::Nothing => {}
        }
    }

    /// Fits touches to the sheet with these cuts, if they are fitted to a sheet that can be cut.
    pub(crate) fn set_cuts(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        if let By::Patches(patches) = &mut self.by {
            patches.set_cuts(time_ns, cuts);
        }
    }

    /// The fit of patches, if it is in use.
    pub(crate) fn patches(&self) -> Option<&PatchStage> {
        match &self.by {
            By::Patches(patches) => Some(patches),
            By::Spots { .. } | By::Nothing => None,
        }
    }
}
