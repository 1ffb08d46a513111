//! Experiments E1 to E11 of the EM-skins (paper E: magnetic induction tomography) on the twins of eight and sixteen coils,
//! and two that the paper could not do: which frequency is best, and metal nearby. The paper shows images and gives few
//! numbers; its elements are "either at rest or displaced proximal to the coils", which a hard press does here.

mod extensions;
mod force;
mod spectrum;
mod touches;

use dermis_twin::mechanics::Indenter;

use crate::Error;
use crate::report::{Experiment, Kind, Row};
use crate::twin_bench::Rig;
use crate::twin_bench::{disc, distance_mm};
use dermis_live::magnetic_model::MagneticModel;
use dermis_skin::{Skin, Solve};
use dermis_twin::TwinKit;

/// All of them.
pub(super) const EXPERIMENTS: [Experiment; 13] = [
    Experiment { id: "E1", title: "single touch at every element, eight and sixteen coils", run: touches::single },
    Experiment { id: "E2", title: "two adjacent elements", run: touches::adjacent },
    Experiment { id: "E3", title: "three and four touches", run: touches::several },
    Experiment { id: "E4", title: "circular against square coils", run: touches::coils },
    Experiment { id: "E5", title: "a line and a ring", run: touches::shapes },
    Experiment { id: "E6", title: "one element held for 100 frames", run: spectrum::stability },
    Experiment { id: "E7", title: "cyclic touch at 3 Hz", run: spectrum::cyclic },
    Experiment { id: "E8", title: "two elements at 0.5 and 2 Hz at once", run: spectrum::two_rhythms },
    Experiment {
        id: "E10",
        title: "force ramps at three elements and their quadratic calibration (E9, E10)",
        run: force::ramps,
    },
    Experiment { id: "E11", title: "smallest force: 120 mN on one element", run: force::smallest },
    Experiment { id: "E12", title: "which frequency is best, 1 to 100 kHz", run: extensions::sweep },
    Experiment { id: "E13", title: "metal under and beside the array", run: extensions::metal },
    Experiment { id: "E14", title: "a copper foil in place of the elements", run: extensions::foil },
];

/// The skins that are compared.
const EIGHT: Array = Array { skin: "em-8", name: "8 coils", press_n: 2.0, elements: 25, frames: 1 };
const CIRCULAR: Array = Array { skin: "em-16-circular", name: "16 circular", press_n: 20.0, elements: 64, frames: 10 };
const SQUARE: Array = Array { skin: "em-16-square", name: "16 square", press_n: 20.0, elements: 64, frames: 10 };

/// A skin and how it is pressed: on the sixteen coils nearly to the end of the travel, as the paper does, whose 50 dB show
/// little else in single frames.
#[derive(Clone, Copy)]
struct Array {
    skin: &'static str,
    name: &'static str,
    press_n: f64,
    elements: usize,
    /// Frames that are averaged where several elements are told apart.
    frames: usize,
}

/// A twin on the bench with the places of its elements.
struct Bench {
    rig: Rig,
    places: Vec<[f64; 2]>,
    per_side: usize,
    press_n: f64,
    element_mm: f64,
    frames: usize,
}

impl Array {
    fn bench(self, solve: Solve) -> Result<Bench, Error> {
        let mut skin = Skin::open(self.skin)?;
        skin.imaging.solve = solve;
        // The paper tells neighbouring elements apart; every element that moves is a touch.
        skin.touch.join_cells = 0.0;
        let (frontend, instrument, _) = TwinKit::of(&skin)?.twin.into_parts();
        self.bench_from(Rig::from_parts(skin, frontend, instrument)?)
    }

    fn bench_from(self, rig: Rig) -> Result<Bench, Error> {
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
    fn press(&self, element: usize, force_n: f64) -> Indenter {
        disc(self.places[element], self.element_mm, force_n)
    }

    /// The mean of so many frames with these elements pressed, after four at rest and three in which the mechanics settle.
    fn settled(&mut self, pressed: &[usize], frames: usize) -> Result<Vec<f64>, Error> {
        self.rig.frames(&[], 4)?;
        let indenters: Vec<Indenter> = pressed.iter().map(|k| self.press(*k, self.press_n)).collect();
        self.rig.frames(&indenters, 3)?;
        self.rig.mean_frame(&indenters, frames)
    }

    /// The element whose place is nearest.
    fn nearest(&self, at: [f64; 2]) -> usize {
        let distance = |k: &usize| distance_mm(self.places[*k], at);
        (0..self.places.len()).min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(0)
    }

    /// Image of a frame and whether its touches are one for each of these elements, nearest to it.
    fn finds(&mut self, frame: &[f64], pressed: &[usize]) -> Result<(Vec<f32>, bool), Error> {
        let image = self.rig.image(frame)?;
        let touches = self.rig.touches(&image)?;
        let mut found: Vec<usize> = touches.iter().map(|touch| self.nearest(touch.centroid_m)).collect();
        found.sort_unstable();
        let mut wanted = pressed.to_vec();
        wanted.sort_unstable();
        Ok((image, found == wanted))
    }

    fn at(&self, elements: &[usize]) -> Vec<[f64; 2]> {
        elements.iter().map(|k| self.places[*k]).collect()
    }
}

fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}

fn solve_name(solve: Solve) -> &'static str {
    match solve {
        Solve::Pixels => "image",
        Solve::LiftOff => "heights",
    }
}
