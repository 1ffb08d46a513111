//! The touches that the forward model fits to a frame, drawn as discs, and the image of the residual. A network uses
//! these for a sandwich skin. There the copper connects touches, so that the linear image of two touches is a single
//! bar, and cuts are faint next to them.

use dermis_tomo::mesh::{PixelGrid, distance};
use dermis_touch::Contact;

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::reference::Reference;
use crate::stages::refinement::Refinement;
use crate::stages::touches::TouchStage;

/// Time between unrelated frames, nanoseconds.
const APART_NS: u64 = 1_000_000_000;

/// Result of the forward model's fit to a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FittedTouches {
    /// Centres and radii of the touches, metres; empty if no fit was accepted.
    pub discs: Vec<([f64; 2], f64)>,
    /// Residual of the frame, model volts, `NaN` where missing: the whole frame if no fit was accepted.
    pub left: Vec<f64>,
}

impl FittedTouches {
    /// Sets the result for a frame (model volts, `NaN` where missing) with these contacts. `explained` is their part
    /// of the frame.
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

/// Fits touches to unrelated frames.
#[derive(Debug)]
pub(super) struct ContactFitter {
    imager: Imager,
    touches: TouchStage,
    refinement: Refinement,
    image: Vec<f32>,
    time_ns: u64,
}

impl ContactFitter {
    /// A fitter for a skin whose file refines touches. It uses the noise assumed in the skin file, whatever the
    /// instrument's, so that a recording looks to the network like its training data.
    ///
    /// # Errors
    /// Operators that cannot be built.
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

/// Draws discs (centre, radius; metres): each of these pixels gets the share of its area within any disc.
pub fn draw_discs(grid: &PixelGrid, inside: &[u32], discs: &[([f64; 2], f64)], image: &mut [f32]) {
    /// Sampling points per side of a pixel.
    const POINTS: usize = 8;
    let step = |k: usize| (k as f64 + 0.5) / POINTS as f64;
    for &pixel in inside {
        let [x, y] = grid.centre_m(pixel as usize);
        if !discs.iter().any(|(at, radius_m)| distance([x, y], *at) <= radius_m + grid.pixel_m) {
            image[pixel as usize] = 0.0;
            continue;
        }
        let covered = |r: usize, c: usize| {
            let point = [x + (step(c) - 0.5) * grid.pixel_m, y + (0.5 - step(r)) * grid.pixel_m];
            discs.iter().any(|(at, radius_m)| distance(point, *at) <= *radius_m)
        };
        let hits = (0..POINTS * POINTS).filter(|point| covered(point / POINTS, point % POINTS)).count();
        image[pixel as usize] = hits as f32 / (POINTS * POINTS) as f32;
    }
}
