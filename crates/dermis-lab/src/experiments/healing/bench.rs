//! The sandwich's twin on the bench, and the images of its frames.

use dermis_learn::scene::{LOWERED, RAISED};
use dermis_tomo::mesh::{PixelGrid, Point};
use dermis_tomo::quality::{SsimOptions, icc, rie, ssim};
use dermis_touch::Contact;
use dermis_twin::mechanics::{Indenter, Load, Shape};

use crate::Error;
use crate::report::{Kind, Row};
use crate::twin_bench::Rig;
use dermis_live::network::{Classes, Classifier, built_in, draw_discs};

pub(super) const SKIN: &str = "healing-square";
/// Pressure of every touch, pascals.
pub(super) const PRESSURE_PA: f64 = 80e3;

pub(super) fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}

pub(super) fn indenter(centre_mm: Point, diameter_mm: f64) -> Indenter {
    Indenter {
        centre_m: centre_mm.map(|v| 1e-3 * v),
        shape: Shape::Disc { radius_m: 0.5e-3 * diameter_mm },
        load: Load::PressurePa(PRESSURE_PA),
    }
}

/// Method of making an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Step {
    /// The linear image divided by its own peak.
    First,
    /// Probability of compressed minus that of damaged, from the network.
    Network,
    /// The network's most likely class of each pixel: 1 compressed, -1 damaged.
    Classes,
    /// Discs with the positions and radii fitted by the forward model.
    Fit,
}

impl Step {
    pub(super) const ALL: [Self; 4] = [Self::First, Self::Network, Self::Classes, Self::Fit];

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::First => "first step",
            Self::Network => "U-Net",
            Self::Classes => "U-Net's classes",
            Self::Fit => "fitted discs",
        }
    }
}

/// Images of one frame, row-major, with 1 for compressed.
pub(super) struct Seen {
    /// In the order of [`Step::ALL`].
    pub(super) images: [Vec<f64>; Step::ALL.len()],
    pub(super) contacts: Vec<Contact>,
}

/// The twin on the bench, with everything needed to image its frames.
pub(super) struct Bench {
    pub(super) rig: Rig,
    classifier: Option<Classifier>,
    classes: Classes,
}

impl Bench {
    pub(super) fn new() -> Result<Self, Error> {
        let rig = Rig::new(SKIN)?;
        let prepared = rig.prepared();
        let model = built_in(SKIN)?;
        let classifier =
            model.map(|model| Classifier::with_reference(prepared, rig.reference(), &model)).transpose()?;
        let grid = prepared.map.grid();
        Ok(Self { classifier, classes: Classes::new(grid.rows, grid.columns), rig })
    }

    pub(super) fn grid(&self) -> &PixelGrid {
        self.rig.prepared().map.grid()
    }

    /// One frame under these indenters, after frames at rest and one for the mechanics to settle.
    fn frame(&mut self, indenters: &[Indenter]) -> Result<Vec<f64>, Error> {
        self.rig.frames(&[], 2)?;
        self.rig.frames(indenters, 1)?;
        self.rig.mean_frame(indenters, 1)
    }

    pub(super) fn see(&mut self, indenters: &[Indenter]) -> Result<Seen, Error> {
        let frame = self.frame(indenters)?;
        let image = self.rig.image(&frame)?;
        let contacts = self.rig.touches(&image)?;
        let peak = image.iter().copied().filter(|value| value.is_finite()).fold(f32::MIN_POSITIVE, f32::max);
        let first = image.iter().map(|value| f64::from(value / peak)).collect();
        let discs: Vec<([f64; 2], f64)> =
            contacts.iter().map(|contact| (contact.centroid_m, radius_m(contact))).collect();
        let fit = self.discs(&discs);
        let [network, classes] = self.classified(&frame, &image)?;
        Ok(Seen { images: [first, network, classes, fit], contacts })
    }

    /// Probability of compressed minus that of damaged, and the same for the most likely class; NaN outside the skin.
    /// Blank if no network ships with the skin.
    fn classified(&mut self, frame: &[f64], image: &[f32]) -> Result<[Vec<f64>; 2], Error> {
        if let Some(classifier) = &mut self.classifier {
            classifier.classify(&self.rig.reference().difference(frame, None), &mut self.classes)?;
        }
        let pixels = image.len();
        let probability =
            |class: u8, pixel: usize| f64::from(self.classes.probabilities[class as usize * pixels + pixel]);
        let is_class = |class: u8, pixel: usize| f64::from(u8::from(self.classes.labels[pixel] == class));
        let image_of = |share: &dyn Fn(u8, usize) -> f64| {
            let value = |(pixel, seen): (usize, &f32)| {
                if seen.is_finite() { share(RAISED, pixel) - share(LOWERED, pixel) } else { f64::NAN }
            };
            image.iter().enumerate().map(value).collect()
        };
        Ok([image_of(&probability), image_of(&is_class)])
    }

    /// Share of each pixel covered by any of these discs (centre, radius); NaN outside the skin.
    fn discs(&self, discs: &[([f64; 2], f64)]) -> Vec<f64> {
        let mut covered = vec![f32::NAN; self.grid().len()];
        draw_discs(self.grid(), self.rig.prepared().map.inside_pixels(), discs, &mut covered);
        covered.into_iter().map(f64::from).collect()
    }

    /// The area covered by the indenters.
    pub(super) fn truth(&self, indenters: &[Indenter]) -> Vec<f64> {
        let discs: Vec<([f64; 2], f64)> = indenters
            .iter()
            .filter_map(|indenter| match indenter.shape {
                Shape::Disc { radius_m } => Some((indenter.centre_m, radius_m)),
                _ => None,
            })
            .collect();
        self.discs(&discs)
    }

    /// ICC, RIE and SSIM (equations 6 to 8) of an image with values from 0 to 1.
    pub(super) fn scores(&self, truth: &[f64], image: &[f64]) -> Result<[f64; 3], Error> {
        let similarity = ssim(truth, image, self.grid().columns, &SsimOptions::new(1.0))?;
        Ok([icc(truth, image)?, rie(truth, image)?, similarity])
    }
}

/// A contact's fitted radius, or the radius of a disc with its area.
pub(super) fn radius_m(contact: &Contact) -> f64 {
    contact.radius_m.unwrap_or_else(|| (contact.area_m2 / std::f64::consts::PI).sqrt())
}

pub(super) fn mean(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, count) = values.into_iter().fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    sum / count
}
