//! Difference data to touches: image, contacts, refinement, tracks. Used for live and for recorded frames.

use dermis_touch::ContactStrength;
use dermis_touch::force::ForceCalibration;

use crate::Error;
use crate::calibration::{Calibration, PlacementFinder};
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::stages::classes::FittedFrame;
use crate::stages::element_contacts::ElementContacts;
use crate::stages::element_presses::ElementPresses;
use crate::stages::placement::Placement;
use crate::stages::refinement::Refinement;
use crate::stages::touches::TouchStage;
use crate::stages::workshop_ensemble::{built_error, must_draw};

/// Turns difference data into images and images into touches.
#[derive(Debug)]
pub struct Reconstructor {
    /// Difference data to images.
    pub imager: Imager,
    /// Locates single touches on a calibrated skin.
    pub placement: Option<PlacementFinder>,
    /// Locates contacts by the forward model.
    pub refinement: Refinement,
    /// Merges the contacts of elements moved by one press, if images are solved for elements.
    elements: Option<ElementContacts>,
    /// Locates these by presses that explain the readings.
    presses: Option<ElementPresses>,
    /// Images to touches.
    pub touches: TouchStage,
    /// The last image showed something strong enough to begin a touch, but none was reported.
    is_unexplained: bool,
}

impl Reconstructor {
    /// A reconstructor for a prepared skin, with the imager and the refinement of its touches.
    ///
    /// # Errors
    /// Thresholds in the skin file that are out of range.
    pub fn new(
        prepared: &Prepared,
        imager: Imager,
        placement: Option<PlacementFinder>,
        refinement: Refinement,
    ) -> Result<Self, Error> {
        let mut touches = TouchStage::new(prepared, imager.noise_image())?;
        if refinement.takes_time() {
            touches.keep_single_alone();
        }
        let elements = ElementContacts::new(prepared);
        let presses = if elements.is_some() { ElementPresses::new(prepared)? } else { None };
        Ok(Self { imager, placement, refinement, elements, presses, touches, is_unexplained: false })
    }

    /// True if [`Reconstructor::take_reference`] takes the time of many frames.
    pub(crate) fn takes_long(&self, prepared: &Prepared, reference: &Reference) -> bool {
        self.refinement.refines() && must_draw(prepared, reference.misfit)
    }

    /// Accounts for the deviation of the skin that gave this reference from its file.
    pub fn take_reference(&mut self, prepared: &Prepared, reference: &Reference) {
        // A calibration that places touches by itself needs no model of errors.
        let built = self.refinement.refines().then(|| built_error(prepared, reference.misfit)).flatten();
        self.refinement.set_built(built.as_ref());
        self.touches.set_built(built);
    }

    /// Images one frame of difference data: see [`Imager::image`].
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub fn image(&mut self, difference: &[f64], image: &mut [f32]) -> Result<(), Error> {
        self.imager.image(difference, image)
    }

    /// Locates the single touch of a frame of difference data by the calibration.
    ///
    /// # Errors
    /// As [`PlacementFinder::place`].
    pub fn place(&mut self, time_ns: u64, difference: &[f64]) -> Result<Option<Placement>, Error> {
        self.placement.as_mut().map_or(Ok(None), |finder| finder.place(time_ns, difference))
    }

    /// A reconstructor of unrelated frames: whatever a calibration leaves to the model is refined as long as it takes.
    ///
    /// # Errors
    /// As [`Reconstructor::new`] and [`Refinement::new`].
    pub fn offline(
        prepared: &Prepared,
        noise: &[f64],
        imager: Imager,
        placement: Option<PlacementFinder>,
        calibration: Option<&Calibration>,
    ) -> Result<Self, Error> {
        let refinement = match Refinement::is_wanted(prepared, calibration) {
            true => Refinement::new(prepared, noise)?.taking_time(),
            false => Refinement::none(),
        };
        let mut reconstructor = Self::new(prepared, imager, placement, refinement)?;
        // Fits of presses on elements are complete in every frame, so a contact of one press is one touch.
        if reconstructor.presses.is_some() {
            reconstructor.touches.keep_single_alone();
        }
        Ok(reconstructor)
    }

    /// Estimates forces by a calibration from now on, or no longer.
    ///
    /// # Errors
    /// Channels without noise.
    pub fn set_forces(&mut self, forces: Option<ForceCalibration>) -> Result<(), Error> {
        self.set_indenter(forces.as_ref().and_then(ForceCalibration::indenter_m))?;
        self.touches.set_forces(forces);
        Ok(())
    }

    /// Estimates forces by the layer's law for a round indenter of this radius (metres) from now on, or for any.
    ///
    /// # Errors
    /// As [`Reconstructor::set_forces`].
    pub fn set_indenter(&mut self, radius_m: Option<f64>) -> Result<(), Error> {
        self.refinement.set_indenter(radius_m)
    }

    /// Tracks the touches in an image of the last frame. If a calibration leaves locating to the model, `placement`
    /// provides the load of a single touch and the position of one that the model does not see. The calibration's
    /// correction of model errors is applied to all others.
    ///
    /// # Errors
    /// An image of the wrong size, a time before the last one, or a sheet with new cuts that cannot be solved.
    pub fn follow_touches(&mut self, time_ns: u64, image: &[f32], placement: Option<Placement>) -> Result<(), Error> {
        let correction = self.placement.as_ref().and_then(PlacementFinder::correction);
        let imposed = placement.filter(|_| correction.is_none());
        self.touches.find_contacts(image, imposed)?;
        let is_strong = self.touches.contacts().iter().any(|contact| contact.strength == ContactStrength::Strong);
        if let (None, Some(elements), Some(fit)) = (imposed, &mut self.elements, self.imager.heights()) {
            elements.place(fit, self.touches.contacts_mut());
        }
        if let (None, Some(presses)) = (imposed, &mut self.presses) {
            if self.touches.contacts().is_empty() {
                presses.forget();
            } else if let Some(frame) = self.imager.element_frame()? {
                presses.place(frame, self.touches.contacts_mut())?;
            }
        }
        if imposed.is_none() {
            self.refinement.refine(time_ns, &self.imager, image, self.touches.contacts_mut())?;
            if self.refinement.refines() {
                self.touches.drop_weak(!self.refinement.is_joint());
            }
        }
        match (correction, placement) {
            (Some(_), Some(placement)) if !placement.vague && self.touches.sees_nothing() => {
                self.touches.place_unseen(placement, image)
            }
            (Some(correction), placement) => {
                self.touches.correct_contacts(correction, placement.and_then(|placement| placement.load));
            }
            (None, _) => {}
        }
        self.touches.track_contacts(time_ns)?;
        self.is_unexplained = is_strong && !self.touches.contacts().is_empty() && self.touches.touches().is_empty();
        Ok(())
    }

    /// The current frame (model volts, `NaN` where missing) with its fit.
    pub(crate) fn fitted<'a>(&'a mut self, difference: &'a [f64]) -> FittedFrame<'a> {
        FittedFrame { difference, contacts: self.touches.contacts(), explained: self.refinement.explained() }
    }

    /// Excludes these channels, at this noise of the others (model volts). An empty list restores all channels.
    ///
    /// # Errors
    /// A channel that does not exist, or all of them.
    pub fn leave_out(&mut self, prepared: &Prepared, channels: &[u32], noise: &[f64]) -> Result<(), Error> {
        self.imager.leave_out(channels, noise)?;
        self.touches.set_noise(self.imager.noise_image());
        self.refinement.leave_out(prepared, channels, noise)
    }

    /// True while anything lies on the skin, including unconfirmed contacts.
    pub fn is_loaded(&self) -> bool {
        self.touches.is_loaded()
    }

    /// True if the last image showed something strong enough to begin a touch, but no touch was reported: its search is
    /// not finished, or nothing explains it.
    pub fn is_unexplained(&self) -> bool {
        self.is_unexplained
    }

    /// Reports that the stream was interrupted before the next frame: see [`TouchStage::interrupt`].
    pub fn interrupt(&mut self, time_ns: u64) {
        self.forget_places();
        self.refinement.forget();
        self.touches.interrupt(time_ns);
    }

    /// Ends all touches: the next frame is unrelated.
    pub fn forget(&mut self, time_ns: u64) {
        self.forget_places();
        self.refinement.forget();
        self.touches.forget(time_ns);
    }

    fn forget_places(&mut self) {
        if let Some(presses) = &mut self.presses {
            presses.forget();
        }
        if let Some(finder) = &mut self.placement {
            finder.forget();
        }
    }
}
