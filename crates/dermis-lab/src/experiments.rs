//! The experiments of the published skins, replayed on their twins: what was pressed where, what the paper read off,
//! and what comes out here, side by side. Twins, noise and repeats are seeded, so that a replay is the same every time.

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
