//! From images to touches with identities: contact finding and tracking, set up from a skin file.

use dermis_touch::{
    Contact, ContactFinder, ContactParams, ContactSigns, ImageGeometry, PixelNoise, Touch, TouchEvent, Tracker,
    TrackerParams,
};

use crate::Error;
use crate::prepare::Prepared;

/// Where a touch lies according to a calibration, in place of the image's own position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
}

/// Contact finder and tracker of a skin, with their memory.
#[derive(Debug)]
pub struct TouchStage {
    finder: ContactFinder,
    tracker: Tracker,
    contacts: Vec<Contact>,
    events: Vec<TouchEvent>,
    noise: Vec<f32>,
}

impl TouchStage {
    /// Sets up both from the skin file; `noise` is the image noise of each pixel (row-major, NaN outside).
    ///
    /// # Errors
    /// Thresholds out of range.
    pub fn new(prepared: &Prepared, noise: Vec<f32>) -> Result<Self, Error> {
        let settings = &prepared.skin.touch;
        let grid = prepared.map.grid();
        let geometry = ImageGeometry {
            columns: grid.columns,
            rows: grid.rows,
            pixel_m: grid.pixel_m,
            left_m: grid.left_m,
            top_m: grid.top_m,
        };
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
            noise,
        })
    }

    /// Replaces the image noise (after a new baseline or hyperparameter).
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
    }

    /// Follows the touches of one image. A `placement` is where a calibration puts the only touch of the frame: it takes
    /// the place of the image's contacts, whose strongest lends its amplitude and area.
    ///
    /// # Errors
    /// An image of another size, or a time before the last one.
    pub fn process(&mut self, time_ns: u64, image: &[f32], placement: Option<Placement>) -> Result<(), Error> {
        self.finder.find(image, PixelNoise::PerPixel(&self.noise), &mut self.contacts)?;
        if let (Some(placement), Some(strongest)) = (placement, self.contacts.first_mut()) {
            strongest.centroid_m = placement.position_m;
            strongest.covariance_m2 = placement.covariance_m2;
            self.contacts.truncate(1);
        }
        self.tracker.update(time_ns, &self.contacts, &mut self.events)?;
        Ok(())
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

    /// True while anything lies on the skin, contacts not yet confirmed included.
    pub fn is_loaded(&self) -> bool {
        self.tracker.is_following()
    }

    /// Ends all touches: the next frame has nothing to do with this one.
    pub fn forget(&mut self, time_ns: u64) {
        self.tracker.end_all(time_ns, &mut self.events);
    }
}
