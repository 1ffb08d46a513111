//! From images to touches with identities: contact finding and tracking, set up from a skin file.

use dermis_tomo::inverse::SpotModel;
use dermis_touch::force::ForceCalibration;
use dermis_touch::{
    Contact, ContactFinder, ContactParams, ContactSign, ContactSigns, ContactStrength, ImageGeometry, PixelNoise,
    Touch, TouchEvent, Tracker, TrackerParams,
};

use crate::Error;
use crate::patches::PatchStage;
use crate::prepare::Prepared;
use crate::spots::SpotStage;

/// Where a touch lies according to a calibration, in place of the image's own position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// The frame is unlike any single touch that was learnt: where the image shows several contacts, they are believed.
    pub doubtful: bool,
}

/// Without frames for so long, nanoseconds, a touch cannot be told from another at the same place.
const INTERRUPTION_NS: u64 = 250_000_000;

/// Contact finder and tracker of a skin, with their memory.
#[derive(Debug)]
pub struct TouchStage {
    finder: ContactFinder,
    tracker: Tracker,
    contacts: Vec<Contact>,
    events: Vec<TouchEvent>,
    /// Ends of touches that an interruption of the stream has ended, until the next frame.
    ended: Vec<TouchEvent>,
    noise: Vec<f32>,
    forces: Option<ForceCalibration>,
    spots: Option<SpotStage>,
    patches: Option<PatchStage>,
    /// Contacts of a smaller amplitude in the next image are none.
    floor: f64,
}

impl Prepared {
    /// Where the pixels of images are.
    pub(crate) fn image_geometry(&self) -> ImageGeometry {
        let grid = self.map.grid();
        ImageGeometry {
            columns: grid.columns,
            rows: grid.rows,
            pixel_m: grid.pixel_m,
            left_m: grid.left_m,
            top_m: grid.top_m,
        }
    }
}

impl TouchStage {
    /// Sets up both from the skin file; `noise` is the image noise of each pixel (row-major, NaN outside).
    ///
    /// # Errors
    /// Thresholds out of range.
    pub fn new(prepared: &Prepared, noise: Vec<f32>) -> Result<Self, Error> {
        let settings = &prepared.skin.touch;
        let geometry = prepared.image_geometry();
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
            ..TrackerParams::default()
        };
        Ok(Self {
            finder: ContactFinder::new(geometry, contact)?,
            tracker: Tracker::new(tracking)?,
            contacts: Vec::new(),
            events: Vec::new(),
            ended: Vec::new(),
            noise,
            forces: None,
            spots: None,
            patches: None,
            floor: 0.0,
        })
    }

    /// Reads the force of every contact by a calibration from now on.
    pub fn set_forces(&mut self, forces: Option<ForceCalibration>) {
        self.forces = forces;
    }

    /// Contacts of a smaller amplitude in the next image are lobes of something else.
    pub fn set_floor(&mut self, amplitude: f64) {
        self.floor = amplitude;
    }

    /// Replaces the image noise (after a new baseline or hyperparameter).
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
    }

    /// Refines contacts by the forward model from now on, at this noise of the channels (model volts): by patches of contact
    /// on a sandwich, by spots of conductivity elsewhere.
    ///
    /// # Errors
    /// See [`Prepared::spot_model`]; a mesh that cannot be made.
    pub fn refine_by(&mut self, prepared: &Prepared, noise: &[f64]) -> Result<(), Error> {
        if prepared.is_sandwich() {
            self.patches = Some(prepared.patch_stage(noise)?);
            return Ok(());
        }
        self.spots = Some(SpotStage::new(prepared, prepared.spot_model(noise)?));
        Ok(())
    }

    /// Refines contacts without these channels from now on, at this noise of the others (model volts); with an empty list with
    /// all channels. `spots` are the responses with all channels ([`Prepared::spot_model`]) where contacts are refined by
    /// spots; where that is by patches, or not at all, they do not matter.
    ///
    /// # Errors
    /// Another number of channels, or none left: see [`SpotModel::without`].
    pub fn leave_out(
        &mut self,
        prepared: &Prepared,
        spots: Option<&SpotModel>,
        channels: &[u32],
        noise: &[f64],
    ) -> Result<(), Error> {
        if let Some(patches) = &mut self.patches {
            patches.leave_out(channels);
        } else if let Some(model) = spots {
            let model = if channels.is_empty() { model.reweighted(noise)? } else { model.without(channels, noise)? };
            self.spots = Some(SpotStage::new(prepared, model));
        }
        Ok(())
    }

    pub(crate) fn set_patches(&mut self, patches: Option<PatchStage>) {
        self.patches = patches;
    }

    /// Touches and contacts of the last image, and what fits them.
    pub(crate) fn parts(&mut self) -> (&[Touch], &[Contact], Option<&mut PatchStage>) {
        (self.tracker.touches(), &self.contacts, self.patches.as_mut())
    }

    pub(crate) fn patches_mut(&mut self) -> Option<&mut PatchStage> {
        self.patches.as_mut()
    }

    /// Follows the touches of one image. `difference` is the frame that it was made of (model volts, missing channels filled
    /// in), by which contacts are refined where that is set up. A `placement` is where a calibration puts the only touch of the frame: it takes
    /// the place of the image's contacts, whose strongest lends its amplitude and area.
    ///
    /// # Errors
    /// An image of another size, or a time before the last one.
    pub fn process(
        &mut self,
        time_ns: u64,
        image: &[f32],
        difference: &[f64],
        placement: Option<Placement>,
    ) -> Result<(), Error> {
        self.finder.find(image, PixelNoise::PerPixel(&self.noise), &mut self.contacts)?;
        self.contacts.retain(|contact| contact.amplitude >= self.floor);
        let several = self.contacts.len() > 1;
        if let Some(placement) = placement.filter(|placement| !(placement.doubtful && several)) {
            self.contacts.truncate(1);
            if self.contacts.is_empty() {
                self.contacts.extend(self.contact_at(placement.position_m, image));
            }
            if let Some(only) = self.contacts.first_mut() {
                only.centroid_m = placement.position_m;
                only.covariance_m2 = placement.covariance_m2;
                // The calibration has judged the whole frame; the image's threshold has nothing to add.
                only.strength = ContactStrength::Strong;
            }
        }
        if placement.is_none() {
            if let Some(patches) = &mut self.patches {
                let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0, f32::min);
                patches.refine(time_ns, difference, f64::from(lowest), &mut self.contacts)?;
            } else if let Some(spots) = &mut self.spots {
                spots.refine(difference, &mut self.contacts);
            }
        }
        if let Some(forces) = &self.forces {
            self.contacts.iter_mut().for_each(|contact| {
                contact.force = Some(forces.read(contact.centroid_m, contact.peak_value));
            });
        }
        self.track(time_ns)
    }

    /// Follows the touches of a frame that says nothing: the contacts of the last image are taken to be there still, unless
    /// an interruption has made an end of them.
    ///
    /// # Errors
    /// A time before the last one.
    pub fn repeat(&mut self, time_ns: u64) -> Result<(), Error> {
        self.track(time_ns)
    }

    /// Follows the contacts as they are; the events begin with the ends that an interruption has made.
    fn track(&mut self, time_ns: u64) -> Result<(), Error> {
        self.tracker.update(time_ns, &self.contacts, &mut self.events)?;
        self.events.splice(0..0, self.ended.drain(..));
        Ok(())
    }

    /// A contact where a calibration sees a touch that the image's own threshold passed over: one pixel, with the image's
    /// value there.
    fn contact_at(&self, position_m: [f64; 2], image: &[f32]) -> Option<Contact> {
        let geometry = self.finder.geometry();
        let column = ((position_m[0] - geometry.left_m) / geometry.pixel_m).floor();
        let row = ((geometry.top_m - position_m[1]) / geometry.pixel_m).floor();
        let inside = column >= 0.0 && row >= 0.0 && column < geometry.columns as f64 && row < geometry.rows as f64;
        let pixel = if inside { row as usize * geometry.columns + column as usize } else { return None };
        let value = image.get(pixel).copied().filter(|value| value.is_finite() && *value != 0.0)?;
        let area_m2 = geometry.pixel_m * geometry.pixel_m;
        let amplitude = f64::from(value.abs());
        Some(Contact {
            peak_m: position_m,
            peak_value: amplitude,
            centroid_m: position_m,
            area_m2,
            amplitude,
            volume: amplitude * area_m2,
            covariance_m2: [[0.0; 2]; 2],
            significance: amplitude / f64::from(self.noise[pixel]),
            sign: ContactSign::Positive,
            strength: ContactStrength::Strong,
            force: None,
            radius_m: None,
        })
    }

    /// The contacts of the last image, strongest first.
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Touches on the skin now.
    pub fn touches(&self) -> &[Touch] {
        self.tracker.touches()
    }

    /// What happened in the last frame.
    pub fn events(&self) -> &[TouchEvent] {
        &self.events
    }

    /// True while anything lies on the skin, contacts not yet confirmed and frames not yet explained included.
    pub fn is_loaded(&self) -> bool {
        self.tracker.is_following() || self.patches.as_ref().is_some_and(PatchStage::is_seeking)
    }

    /// The stream was interrupted before the next frame, for so long that nobody knows what happened: all touches end, and what
    /// that frame shows begins anew. The ends are among its events.
    pub fn interrupt(&mut self, time_ns: u64) {
        if let Some(patches) = &mut self.patches {
            patches.forget();
        }
        self.tracker.end_all(time_ns, &mut self.ended);
        self.contacts.clear();
    }

    /// True where so many frames in a row, taking so long, are an interruption: more than a touch may be missed, and longer than
    /// a fingertip takes to tap.
    pub fn is_interruption(&self, frames: u64, lasted_ns: u64) -> bool {
        frames > u64::from(self.tracker.params().max_missed_frames) && lasted_ns > INTERRUPTION_NS
    }

    /// Ends all touches: the next frame has nothing to do with this one.
    pub fn forget(&mut self, time_ns: u64) {
        if let Some(patches) = &mut self.patches {
            patches.forget();
        }
        self.tracker.end_all(time_ns, &mut self.events);
        self.events.splice(0..0, self.ended.drain(..));
        self.contacts.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skin::Skin;

    const FRAME_NS: u64 = 10_000_000;

    /// A stage that follows one touch, and its time.
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
        let difference = vec![0.0; prepared.channels()];
        for frame in 1..=10 {
            stage.process(frame * FRAME_NS, &image, &difference, None).unwrap();
        }
        assert_eq!(stage.touches().len(), 1);
        (stage, 10 * FRAME_NS)
    }

    fn ends(stage: &TouchStage) -> usize {
        stage.events().iter().filter(|event| matches!(event, TouchEvent::End(_))).count()
    }

    #[test]
    fn a_frame_that_says_nothing_after_an_interruption_ends_touches_and_begins_none() {
        let (mut stage, mut time_ns) = touched();
        time_ns += 30 * FRAME_NS;
        stage.interrupt(time_ns);
        stage.repeat(time_ns).unwrap();
        assert_eq!((ends(&stage), stage.touches().len()), (1, 0), "{:?}", stage.events());
        for _ in 0..10 {
            time_ns += FRAME_NS;
            stage.repeat(time_ns).unwrap();
            assert!(stage.events().is_empty() && !stage.is_loaded(), "a touch that nobody sees: {:?}", stage.events());
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
            assert!(stage.events().is_empty() && !stage.is_loaded(), "{:?}", stage.events());
        }
    }
}
