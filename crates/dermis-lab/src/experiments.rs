//! The experiments of the published skins, replayed on their twins. Each shows the presses, the paper's result and
//! the result here next to each other. Twins, noise and repeats are seeded, so a replay always gives the same result.

pub mod em;
pub mod healing;
pub mod ionic;
mod methods;
pub mod piezo;

pub use methods::{METHODS, Method};

pub use crate::report::{Curve, Experiment, Figure, ImagePanel, Kind, Look, Report, Row};
pub use crate::twin_bench::{Rig, grams_n};

/// The papers that can be replayed, by their letters.
pub const PAPERS: [(&str, &str, &[Experiment]); 4] = [
    ("E", "EM-skin: magnetic induction tomography", &em::EXPERIMENTS),
    ("H", "self-healing sandwich: touch told from damage", &healing::EXPERIMENTS),
    ("I", "ionic liquid skin with fringing-field EIT", &ionic::EXPERIMENTS),
    ("P", "piezoresistive skins of several shapes on one backend", &piezo::EXPERIMENTS),
];
