//! From images to touches with identities: contact finding and tracking, set up from a skin file.

use dermis_tomo::mesh::Point;
use dermis_touch::force::{ForceCalibration, ForceReading};
use dermis_touch::locator::PlaceCorrection;
use dermis_touch::{
    Contact, ContactFinder, ContactParams, ContactSigns, ContactStrength, PixelNoise, Touch, TouchLoad, Tracker,
    TrackerParams,
};

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::model_error::ModelError;
use crate::stages::placement::Placement;
use crate::stages::workshop_error::BuiltError;

/// After a gap in the frames this long, nanoseconds, a touch cannot be distinguished from another at the same
/// position.
const INTERRUPTION_NS: u64 = 250_000_000;

/// A touch that is not seen for this long has ended, seconds.
const GONE_S: f64 = 0.06;

/// Contact finder and tracker of a skin, with their memory.
#[derive(Debug)]
pub struct TouchStage {
    finder: ContactFinder,
    tracker: Tracker,
    contacts: Vec<Contact>,
    ended: Vec<Touch>,
    /// Touches ended by an interruption of the stream, held until the next frame.
    interrupted: Vec<Touch>,
    noise: Vec<f32>,
    forces: Option<ForceCalibration>,
    /// Contacts of a smaller amplitude in the next image are ignored.
    floor: f64,
    model_error: ModelError,
    /// Errors of a skin that is not as drawn.
    built: Option<BuiltError>,
    /// A calibration has located the contacts of this frame, and their sigmas include the model error.
    is_placed: bool,
    /// The current touch is visible only to the calibration.
    follows_unseen: bool,
}

impl TouchStage {
    /// Sets up both from the skin file. `noise` is the image noise of each pixel (row-major, NaN outside).
    ///
    /// # Errors
    /// Thresholds out of range.
    pub fn new(prepared: &Prepared, noise: Vec<f32>) -> Result<Self, Error> {
        let settings = &prepared.skin.touch;
        let cells = prepared.image_cells();
        let half_width = prepared.half_width_m();
        let contact = ContactParams {
            k_on: settings.begin_sigma,
            k_off: settings.hold_sigma,
            relative_on: settings.side_lobe_share,
            relative_off: 0.6 * settings.side_lobe_share,
            min_amplitude: settings.smallest_amplitude,
            correlation_length_m: 0.1 * half_width,
            min_separation_m: 0.1 * half_width,
            signs: if settings.both_signs { ContactSigns::Both } else { ContactSigns::Positive },
            ..ContactParams::default()
        };
        let tracking = TrackerParams {
            min_age_frames: settings.least_frames,
            position_floor_m: settings.position_floor_mm * 1e-3,
            gate_max_m: 0.5 * half_width,
            max_missed_frames: match prepared.skin.fits_touches() {
                true => missed_frames(prepared.skin.backend.frame_rate_hz()),
                // Touches located by the image alone flicker.
                false => TrackerParams::default().max_missed_frames,
            },
            ..TrackerParams::default()
        };
        Ok(Self {
            finder: ContactFinder::new(cells, contact)?,
            tracker: Tracker::new(tracking)?,
            contacts: Vec::new(),
            ended: Vec::new(),
            interrupted: Vec::new(),
            noise,
            forces: None,
            floor: 0.0,
            is_placed: false,
            follows_unseen: false,
            model_error: ModelError::of(prepared),
            built: None,
        })
    }

    /// Sets the calibration that estimates the force of every contact.
    pub fn set_forces(&mut self, forces: Option<ForceCalibration>) {
        self.forces = forces;
    }

    /// Sets the amplitude below which contacts in the next image are side lobes.
    pub fn set_floor(&mut self, amplitude: f64) {
        self.floor = amplitude;
    }

    /// Takes into account how far the skin is from its file.
    pub fn set_built(&mut self, built: Option<BuiltError>) {
        self.built = built;
    }

    /// From now on, no touch merges into a contact that is known to be a single touch. Call this if the search for
    /// touches is finished in each frame: a touch that is not found has then ended.
    pub(crate) fn keep_single_alone(&mut self) {
        self.tracker.keep_single_alone();
    }

    /// Replaces the image noise (after a new baseline or hyperparameter).
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
    }

    /// Tracks the touches of one image, with its contacts as found.
    ///
    /// # Errors
    /// An image of the wrong size, or a time before the last one.
    pub fn process(&mut self, time_ns: u64, image: &[f32], placement: Option<Placement>) -> Result<(), Error> {
        self.find_contacts(image, placement)?;
        self.track_contacts(time_ns)
    }

    /// Finds the contacts of an image. A `placement` is a calibration's positions of the frame's touches, with
    /// their strengths if known. It replaces the image's contacts. The strongest of these provides its area
    /// and, if the strength is unknown, its amplitude.
    ///
    /// # Errors
    /// An image of the wrong size.
    pub fn find_contacts(&mut self, image: &[f32], placement: Option<Placement>) -> Result<(), Error> {
        self.finder.find(image, PixelNoise::PerPixel(&self.noise), &mut self.contacts)?;
        self.contacts.retain(|contact| contact.amplitude >= self.floor);
        let several = self.contacts.len() > 1;
        self.is_placed = false;
        if let Some(placement) = placement.filter(|placement| !(placement.doubtful && several)) {
            self.place_only(placement, image);
        }
        Ok(())
    }

    /// Replaces the contacts found by a placement: the only touch of the frame, or all of them.
    fn place_only(&mut self, placement: Placement, image: &[f32]) {
        self.contacts.truncate(1);
        if self.contacts.is_empty() {
            self.contacts.extend(self.contact_at(placement.position_m, image));
        }
        let Some(only) = self.contacts.first_mut() else { return };
        only.centroid_m = placement.position_m;
        only.covariance_m2 = placement.covariance_m2;
        only.model_variance_m2 = 0.0;
        only.load = placement.load;
        only.other_place = placement.other_place;
        if let Some(amplitude) = placement.amplitude {
            only.volume *= amplitude / only.amplitude;
            only.amplitude = amplitude;
        }
        self.is_placed = true;
        // The calibration has judged the whole frame, so the image's threshold does not apply.
        only.strength = ContactStrength::Strong;
        let strongest = *only;
        self.contacts.extend(placement.further.iter().flatten().map(|touch| Contact {
            covariance_m2: touch.covariance_m2,
            load: touch.load,
            ..strongest.share_at(touch.position_m, touch.share)
        }));
    }

    /// Drops contacts that a fit has found weaker than the skin file allows, or `by_frame` than the frame's side lobes.
    pub(crate) fn drop_weak(&mut self, by_frame: bool) {
        let floor = if by_frame { self.floor } else { 0.0 };
        let least = floor.max(self.finder.params().min_amplitude);
        self.contacts.retain(|contact| contact.amplitude >= least);
    }

    /// True if the contacts just found begin no touch, and no touch seen by the model is being tracked.
    pub fn sees_nothing(&self) -> bool {
        let is_unseen = self.follows_unseen || !self.is_loaded();
        is_unseen && self.contacts.iter().all(|contact| contact.strength == ContactStrength::Weak)
    }

    /// Adds a touch that the calibration locates but the model does not see ([`TouchStage::sees_nothing`]).
    pub fn place_unseen(&mut self, placement: Placement, image: &[f32]) {
        self.place_only(placement, image);
        self.follows_unseen = true;
    }

    /// The contacts just found, for a refinement to locate better.
    pub fn contacts_mut(&mut self) -> &mut Vec<Contact> {
        &mut self.contacts
    }

    /// Corrects the positions of the contacts just found, which the model located, and expresses their amplitudes in
    /// typical pokes. A single contact gets the load of the frame.
    pub fn correct_contacts(&mut self, correction: &PlaceCorrection, load: Option<TouchLoad>) {
        self.follows_unseen = false;
        let is_single = self.contacts.len() == 1;
        for contact in &mut self.contacts {
            let typical = correction.typical_amplitude(contact.centroid_m);
            contact.amplitude /= typical;
            contact.volume /= typical;
            contact.centroid_m = correction.corrected(contact.centroid_m);
            if correction.shifts() {
                contact.model_variance_m2 = correction.sigma_m().powi(2);
            }
            contact.load = load.filter(|_| is_single);
        }
        self.is_placed = correction.shifts();
    }

    /// Estimates the forces of the contacts just found and tracks them as touches.
    ///
    /// # Errors
    /// A time before the last one.
    pub fn track_contacts(&mut self, time_ns: u64) -> Result<(), Error> {
        if let Some(forces) = &self.forces {
            self.contacts.iter_mut().for_each(|contact| {
                let by_law = contact.force.and_then(ForceReading::by_law);
                let saturated = contact.force.filter(|force| matches!(force, ForceReading::Saturated { .. }));
                contact.force = forces.read(contact.centroid_m, contact.peak_value, by_law).or(saturated);
            });
        }
        if !self.is_placed {
            let model_error = &self.model_error;
            self.contacts.iter_mut().for_each(|contact| contact.model_variance_m2 += model_error.variance_m2(contact));
            if let Some(built) = &self.built {
                self.contacts.iter_mut().for_each(|contact| widen(contact, built));
            }
        }
        self.track(time_ns)
    }

    /// Tracks the touches of a frame without information: assumes that the contacts of the last image are still
    /// there, unless an interruption has ended them.
    ///
    /// # Errors
    /// A time before the last one.
    pub fn repeat(&mut self, time_ns: u64) -> Result<(), Error> {
        self.track(time_ns)
    }

    /// Tracks the contacts as they are. Those ended by an interruption come first among the ended.
    fn track(&mut self, time_ns: u64) -> Result<(), Error> {
        self.tracker.update(time_ns, &self.contacts, &mut self.ended)?;
        self.ended.splice(0..0, self.interrupted.drain(..));
        Ok(())
    }

    /// A contact for a touch that only the calibration sees because the image is below its threshold: one cell, with
    /// the image's value there.
    fn contact_at(&self, position_m: Point, image: &[f32]) -> Option<Contact> {
        let cells = self.finder.cells();
        let cell = cells.cell_at(position_m)?;
        let value = image.get(cell).copied().filter(|value| value.is_finite() && *value != 0.0)?;
        let amplitude = f64::from(value.abs());
        Some(Contact {
            significance: amplitude / f64::from(self.noise[cell]),
            ..Contact::even(position_m, amplitude, cells.area_m2(cell))
        })
    }

    /// The contacts of the last image, strongest first.
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Current touches on the skin.
    pub fn touches(&self) -> &[Touch] {
        self.tracker.touches()
    }

    /// Touches that ended in the last frame.
    pub fn ended(&self) -> &[Touch] {
        &self.ended
    }

    /// True while anything lies on the skin, including unconfirmed contacts.
    pub fn is_loaded(&self) -> bool {
        self.tracker.is_following()
    }

    /// Reports that the stream was interrupted before the next frame, too long to know what happened. All touches
    /// end, and the touches in that frame are new. Its ended touches include them.
    pub fn interrupt(&mut self, time_ns: u64) {
        // A second interruption before the next frame finds nothing left to end.
        if self.interrupted.is_empty() {
            self.tracker.end_all(time_ns, &mut self.interrupted);
        }
        self.contacts.clear();
    }

    /// True if this many consecutive missing frames, over this time, are an interruption: more than a touch may be
    /// missed, and longer than a fingertip takes to tap.
    pub fn is_interruption(&self, frames: u64, lasted_ns: u64) -> bool {
        frames > u64::from(self.tracker.params().max_missed_frames) && lasted_ns > INTERRUPTION_NS
    }

    /// Ends all touches: the next frame is unrelated.
    pub fn forget(&mut self, time_ns: u64) {
        self.tracker.end_all(time_ns, &mut self.ended);
        self.ended.splice(0..0, self.interrupted.drain(..));
        self.contacts.clear();
    }
}

/// Number of frames a touch may be missed before it ends: within [`GONE_S`], or two frames.
fn missed_frames(frames_per_s: f64) -> u32 {
    ((GONE_S * frames_per_s).floor() as u32).saturating_sub(1).clamp(1, 3)
}

/// Adds the errors of a skin as built to a contact's place.
fn widen(contact: &mut Contact, built: &BuiltError) {
    let covariance = built.covariance_m2(contact.centroid_m);
    for (row, added) in contact.covariance_m2.iter_mut().zip(covariance) {
        row.iter_mut().zip(added).for_each(|(value, added)| *value += added);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    const FRAME_NS: u64 = 10_000_000;

    /// A stage that tracks one touch, and its time.
    fn touched() -> (TouchStage, u64) {
        let prepared = Prepared::new(Skin::open("healing-square").unwrap()).unwrap();
        let grid = prepared.map.grid().len();
        let mut stage = TouchStage::new(&prepared, vec![0.01; grid]).unwrap();
        let image: Vec<f32> = (0..prepared.map.grid().rows)
            .flat_map(|row| (0..prepared.map.grid().columns).map(move |column| (row, column)))
            .map(|(row, column)| {
                let [x, y] = [column as f32 - 20.0, row as f32 - 20.0];
                (-(x * x + y * y) / 18.0).exp()
            })
            .collect();
        for frame in 1..=10 {
            stage.process(frame * FRAME_NS, &image, None).unwrap();
        }
        assert_eq!(stage.touches().len(), 1);
        (stage, 10 * FRAME_NS)
    }

    fn ends(stage: &TouchStage) -> usize {
        stage.ended().len()
    }

    #[test]
    fn a_frame_that_says_nothing_after_an_interruption_ends_touches_and_begins_none() {
        let (mut stage, mut time_ns) = touched();
        time_ns += 30 * FRAME_NS;
        stage.interrupt(time_ns);
        stage.repeat(time_ns).unwrap();
        assert_eq!((ends(&stage), stage.touches().len()), (1, 0), "{:?}", stage.ended());
        for _ in 0..10 {
            time_ns += FRAME_NS;
            stage.repeat(time_ns).unwrap();
            assert!(stage.ended().is_empty() && !stage.is_loaded(), "a touch that nobody sees: {:?}", stage.ended());
        }
    }

    #[test]
    fn a_blind_frame_after_an_interruption_has_its_ends_and_leaves_nothing_behind() {
        let (mut stage, mut time_ns) = touched();
        stage.interrupt(time_ns);
        stage.forget(time_ns);
        assert_eq!((ends(&stage), stage.touches().len()), (1, 0));
        for _ in 0..10 {
            time_ns += FRAME_NS;
            stage.repeat(time_ns).unwrap();
            assert!(stage.ended().is_empty() && !stage.is_loaded(), "{:?}", stage.ended());
        }
    }
}
