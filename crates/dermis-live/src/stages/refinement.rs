//! Contacts of the image placed better by the forward model: as patches of contact on a sandwich, as spots of
//! conductivity elsewhere, or not at all.

use dermis_tomo::inverse::SpotModel;
use dermis_touch::Contact;

use crate::Error;
use crate::calibration::Calibration;
use crate::prepare::Prepared;
use crate::stages::sandwich_contacts::{PatchStage, SheetCut, is_sandwich};
use crate::stages::touch_refinement::{SpotStage, assumed_spot_model, spot_model};

/// What refines the contacts of one skin.
#[derive(Debug)]
pub struct Refinement {
    by: By,
    takes_time: bool,
}

#[derive(Debug)]
enum By {
    /// Contacts stay as the image has them.
    Nothing,
    Spots {
        /// Responses with all channels.
        whole: Box<SpotModel>,
        /// With the channels and the noise in use, once the noise is known.
        stage: Option<Box<SpotStage>>,
    },
    Patches(Box<PatchStage>),
}

impl Refinement {
    fn by(by: By) -> Self {
        Self { by, takes_time: false }
    }

    /// Leaves contacts as the image has them.
    pub fn none() -> Self {
        Self::by(By::Nothing)
    }

    /// Whether touches of a skin are refined: [`dermis_skin::Skin::refines_touches`], and no calibration places them.
    pub fn is_wanted(prepared: &Prepared, calibration: Option<&Calibration>) -> bool {
        let by_pokes = calibration.is_some_and(|calibration| calibration.correction().is_none());
        prepared.skin.refines_touches() && !by_pokes
    }

    /// Whether contacts are refined at all.
    pub fn refines(&self) -> bool {
        !matches!(self.by, By::Nothing)
    }

    /// At this noise of the channels (model volts).
    ///
    /// # Errors
    /// See [`spot_model`]; a mesh that cannot be made.
    pub fn new(prepared: &Prepared, noise: &[f64]) -> Result<Self, Error> {
        if is_sandwich(prepared) {
            return Ok(Self::by(By::Patches(Box::new(PatchStage::new(prepared, noise)?))));
        }
        let whole = Box::new(spot_model(prepared, noise)?);
        let stage = Some(Box::new(SpotStage::new(prepared, (*whole).clone())));
        Ok(Self::by(By::Spots { whole, stage }))
    }

    /// Before any noise is known: refines nothing until [`Refinement::leave_out`] says what it is.
    pub(crate) fn without_noise(prepared: &Prepared) -> Result<Self, Error> {
        if is_sandwich(prepared) {
            return Self::new(prepared, &vec![0.0; prepared.channels()]);
        }
        Ok(Self::by(By::Spots { whole: Box::new(assumed_spot_model(prepared)?), stage: None }))
    }

    /// From now on each frame waits for as much work as finding its touches takes: for frames at a desk, where those
    /// before may be of other presses.
    #[must_use]
    pub fn taking_time(mut self) -> Self {
        self.takes_time = true;
        self.tell_pace();
        self
    }

    fn tell_pace(&mut self) {
        match &mut self.by {
            By::Patches(patches) if self.takes_time => patches.take_time(),
            By::Spots { stage: Some(spots), .. } if self.takes_time => spots.take_time(),
            By::Patches(_) | By::Spots { .. } | By::Nothing => {}
        }
    }

    /// Replaces the noise of the channels (model volts) that patches are judged by.
    pub(crate) fn set_noise(&mut self, noise: &[f64]) {
        if let By::Patches(patches) = &mut self.by {
            patches.set_noise(noise);
        }
    }

    /// Goes on without these channels, at this noise of the others (model volts); with an empty list with all channels.
    ///
    /// # Errors
    /// Another number of channels, or none left: see [`SpotModel::without`].
    pub fn leave_out(&mut self, prepared: &Prepared, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        match &mut self.by {
            By::Nothing => {}
            By::Patches(patches) => patches.leave_out(channels),
            By::Spots { whole, stage } => {
                let model =
                    if channels.is_empty() { whole.reweighted(noise)? } else { whole.without(channels, noise)? };
                *stage = Some(Box::new(SpotStage::new(prepared, model)));
            }
        }
        self.tell_pace();
        Ok(())
    }

    /// As new at this noise of the channels (model volts), for another skin of the same kind: all channels count, and
    /// nothing that was seen is remembered.
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

    /// Places the contacts of an image by the frame that it was made of (model volts, missing channels filled in).
    ///
    /// # Errors
    /// A sheet with new cuts that cannot be meshed or solved.
    pub fn refine(
        &mut self,
        time_ns: u64,
        difference: &[f64],
        image: &[f32],
        contacts: &mut Vec<Contact>,
    ) -> Result<(), Error> {
        match &mut self.by {
            By::Patches(patches) => {
                let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::min);
                patches.refine(time_ns, difference, f64::from(lowest), contacts)?;
            }
            By::Spots { stage: Some(spots), .. } => spots.refine(difference, contacts),
            By::Spots { stage: None, .. } | By::Nothing => {}
        }
        Ok(())
    }

    /// What fitted contacts of a sandwich explain of the last frame (model volts); `None` where none are believed.
    pub(crate) fn explained(&self) -> Option<&[f64]> {
        self.patches().and_then(PatchStage::explained)
    }

    /// Frames that have waited for what touches are fitted on.
    pub(crate) fn waits(&self) -> u64 {
        self.patches().map_or(0, PatchStage::waits)
    }

    /// True while it is being worked out what touches the skin.
    pub(crate) fn is_seeking(&self) -> bool {
        matches!(&self.by, By::Patches(patches) if patches.is_seeking())
    }

    /// Frames are missing before the next: what touches the skin is sought anew, and the baseline is as old as it was.
    pub(crate) fn interrupt(&mut self) {
        match &mut self.by {
            By::Patches(patches) => patches.let_go(),
            By::Spots { .. } | By::Nothing => self.forget(),
        }
    }

    /// The next frame has nothing to do with the last.
    pub(crate) fn forget(&mut self) {
        match &mut self.by {
            By::Patches(patches) => patches.forget(),
            By::Spots { stage: Some(spots), .. } => spots.forget(),
            By::Spots { stage: None, .. } | By::Nothing => {}
        }
    }

    /// Fits touches to the sheet with these cuts, where they are fitted to one.
    pub(crate) fn set_cuts(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        if let By::Patches(patches) = &mut self.by {
            patches.set_cuts(time_ns, cuts);
        }
    }

    /// What fits patches, where that refines.
    pub(crate) fn patches(&self) -> Option<&PatchStage> {
        match &self.by {
            By::Patches(patches) => Some(patches),
            By::Spots { .. } | By::Nothing => None,
        }
    }
}
