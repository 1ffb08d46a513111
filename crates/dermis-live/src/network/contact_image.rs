//! The touches that the forward model fits to a frame, drawn as discs, and the image of what they leave: what a network
//! is shown of a sandwich, whose touches are joined by the copper, so that the linear image of two of them is one bar,
//! and whose cuts are faint beside them.

use dermis_tomo::mesh::PixelGrid;
use dermis_touch::Contact;

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::stages::refinement::Refinement;
use crate::stages::touches::TouchStage;

/// Frames have nothing to do with each other: so far apart, nanoseconds.
const APART_NS: u64 = 1_000_000_000;

/// What the forward model has fitted to a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FittedTouches {
    /// Centres and radii of the touches, metres; none where none is believed.
    pub discs: Vec<([f64; 2], f64)>,
    /// What they leave of the frame, model volts, `NaN` where missing: all of it where none is believed.
    pub left: Vec<f64>,
}

impl FittedTouches {
    /// Of a frame (model volts, `NaN` where missing) with these contacts, of which so much is `explained`.
    pub(crate) fn set(&mut self, frame: &[f64], contacts: &[Contact], explained: Option<&[f64]>) {
        self.discs.clear();
        self.left.clear();
        self.left.extend_from_slice(frame);
        if let Some(explained) = explained {
            self.discs.extend(contacts.iter().filter_map(|contact| Some((contact.centroid_m, contact.radius_m?))));
            self.left.iter_mut().zip(explained).for_each(|(left, explained)| *left -= explained);
        }
    }
}

/// Fits touches to frames that have nothing to do with each other.
#[derive(Debug)]
pub(super) struct ContactFitter {
    imager: Imager,
    touches: TouchStage,
    refinement: Refinement,
    image: Vec<f32>,
    time_ns: u64,
}

impl ContactFitter {
    /// Of a skin whose file refines touches. The noise is what the skin file assumes, whatever the instrument's is, so
    /// that a network sees of a recording what it was trained on.
    ///
    /// # Errors
    /// Operators that cannot be made.
    pub(super) fn new(prepared: &Prepared) -> Result<Self, Error> {
        let reference = Reference::of(prepared, std::slice::from_ref(&prepared.voltages))?;
        let imager = Imager::new(prepared, &reference, &[])?;
        Ok(Self {
            touches: TouchStage::new(prepared, imager.noise_image())?,
            refinement: Refinement::new(prepared, &reference.noise)?.taking_time(),
            image: vec![f32::NAN; prepared.map.grid().len()],
            time_ns: 0,
            imager,
        })
    }

    /// Fits the touches of a frame.
    ///
    /// # Errors
    /// As [`Imager::image`].
    pub(super) fn fit(&mut self, difference: &[f64], fitted: &mut FittedTouches) -> Result<(), Error> {
        self.time_ns += APART_NS;
        self.imager.image(difference, &mut self.image)?;
        self.touches.find_contacts(&self.image, None)?;
        self.refinement.forget();
        let contacts = self.touches.contacts_mut();
        self.refinement.refine(self.time_ns, &self.imager, &self.image, contacts)?;
        fitted.set(difference, contacts, self.refinement.explained());
        Ok(())
    }
}

/// The share of each of these pixels that lies in any of the discs (centre, radius; metres).
pub fn draw_discs(grid: &PixelGrid, inside: &[u32], discs: &[([f64; 2], f64)], image: &mut [f32]) {
    /// Points a pixel's side.
    const POINTS: usize = 8;
    let step = |k: usize| (k as f64 + 0.5) / POINTS as f64;
    for &pixel in inside {
        let [x, y] = grid.centre_m(pixel as usize);
        let reach_m = grid.pixel_m;
        let near = |at: &[f64; 2], radius_m: f64| (x - at[0]).hypot(y - at[1]) <= radius_m + reach_m;
        if !discs.iter().any(|(at, radius_m)| near(at, *radius_m)) {
            image[pixel as usize] = 0.0;
            continue;
        }
        let covered = |r: usize, c: usize| {
            let [x, y] = [x + (step(c) - 0.5) * grid.pixel_m, y + (0.5 - step(r)) * grid.pixel_m];
            discs.iter().any(|(at, radius_m)| (x - at[0]).hypot(y - at[1]) <= *radius_m)
        };
        let hits = (0..POINTS * POINTS).filter(|point| covered(point / POINTS, point % POINTS)).count();
        image[pixel as usize] = hits as f32 / (POINTS * POINTS) as f32;
    }
}
