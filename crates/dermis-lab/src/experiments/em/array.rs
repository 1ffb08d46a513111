//! The skins to compare, and their twins on the bench.

use dermis_tomo::mesh::Point;
use dermis_twin::mechanics::Indenter;

use crate::Error;
use crate::report::{Kind, Row};
use crate::twin_bench::Rig;
use crate::twin_bench::{disc, distance_mm};
use dermis_live::magnetic_model::MagneticModel;
use dermis_skin::{Skin, Solve};
use dermis_twin::TwinKit;

/// The skins to compare.
pub(super) const EIGHT: Array = Array { skin: "em-8", name: "8 coils", press_n: 2.0, elements: 25, frames: 1 };
pub(super) const CIRCULAR: Array =
    Array { skin: "em-16-circular", name: "16 circular", press_n: 20.0, elements: 64, frames: 10 };
pub(super) const SQUARE: Array =
    Array { skin: "em-16-square", name: "16 square", press_n: 20.0, elements: 64, frames: 10 };

/// A skin and its press. The sixteen coils are pressed nearly to the end of the travel, as in the paper; at their 50
/// dB a single frame shows little else.
#[derive(Clone, Copy)]
pub(super) struct Array {
    pub(super) skin: &'static str,
    pub(super) name: &'static str,
    pub(super) press_n: f64,
    pub(super) elements: usize,
    /// Frames to average when several elements must be distinguished.
    frames: usize,
}

/// A twin on the bench, with the places of its elements.
pub(super) struct Bench {
    pub(super) rig: Rig,
    pub(super) places: Vec<Point>,
    pub(super) per_side: usize,
    pub(super) press_n: f64,
    element_mm: f64,
    pub(super) frames: usize,
}

impl Array {
    pub(super) fn bench(self, solve: Solve) -> Result<Bench, Error> {
        let mut skin = Skin::open(self.skin)?;
        skin.imaging.solve = solve;
        // The paper distinguishes neighbouring elements, so every element that moves counts as a touch.
        skin.touch.join_cells = 0.0;
        let (frontend, instrument, _) = TwinKit::of(&skin)?.twin.into_parts();
        self.bench_from(Rig::from_parts(skin, frontend, instrument)?)
    }

    pub(super) fn bench_from(self, rig: Rig) -> Result<Bench, Error> {
        let elements = MagneticModel::of(&rig.prepared().skin)?.elements;
        Ok(Bench {
            per_side: (elements.count() as f64).sqrt() as usize,
            places: elements.places_m(),
            press_n: self.press_n,
            frames: self.frames,
            element_mm: 2e3 * elements.shape.volume_radius_m(),
            rig,
        })
    }
}

impl Bench {
    pub(super) fn press(&self, element: usize, force_n: f64) -> Indenter {
        disc(self.places[element], self.element_mm, force_n)
    }

    /// The mean of several frames with these elements pressed, after four frames at rest and three for the mechanics
    /// to settle.
    pub(super) fn settled(&mut self, pressed: &[usize], frames: usize) -> Result<Vec<f64>, Error> {
        self.rig.frames(&[], 4)?;
        let indenters: Vec<Indenter> = pressed.iter().map(|k| self.press(*k, self.press_n)).collect();
        self.rig.frames(&indenters, 3)?;
        self.rig.mean_frame(&indenters, frames)
    }

    /// The element nearest to a position.
    pub(super) fn nearest(&self, at: Point) -> usize {
        let distance = |k: &usize| distance_mm(self.places[*k], at);
        (0..self.places.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// The image of a frame, and whether it has exactly one touch at each of these elements.
    pub(super) fn finds(&mut self, frame: &[f64], pressed: &[usize]) -> Result<(Vec<f32>, bool), Error> {
        let image = self.rig.image(frame)?;
        let touches = self.rig.touches(&image)?;
        let mut found: Vec<usize> = touches.iter().map(|touch| self.nearest(touch.centroid_m)).collect();
        found.sort_unstable();
        let mut wanted = pressed.to_vec();
        wanted.sort_unstable();
        Ok((image, found == wanted))
    }

    pub(super) fn at(&self, elements: &[usize]) -> Vec<Point> {
        elements.iter().map(|k| self.places[*k]).collect()
    }
}

pub(super) fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}

pub(super) fn solve_name(solve: Solve) -> &'static str {
    match solve {
        Solve::Pixels => "image",
        Solve::LiftOff => "heights",
    }
}
