//! The second step of imaging: what a network is shown of a frame ([`FirstStep`]), the classes of live frames ([`Classifier`]), training sets simulated from a skin
//! file ([`train_set`]), and labels for recorded frames, with a network or without ([`segment`]).

mod built_in;
mod classifier;
mod first_step;
mod jitter;
mod masks;
mod score;
pub mod segment;
mod solver;
pub mod train_set;

pub use built_in::built_in;
pub use classifier::{Classes, Classifier, UNLIKE};
pub use first_step::{FirstStep, InputImage};
pub use masks::{MaskRule, PRESENCE, PresenceRule, enlarge, masks_of_image};
pub use score::challenge_score;

use crate::skin::Skin;

/// Names of the classes, in the order of the labels.
pub const CLASSES: [&str; 3] = ["background", "lowered", "raised"];

impl Skin {
    /// SHA-256 of what images depend on: modality, frontend, backend and imaging. A network fits skins of the same
    /// fingerprint.
    pub fn imaging_sha256(&self) -> String {
        let parts = (self.modality, &self.frontend, &self.backend, &self.imaging);
        dermis_learn::sha256(&serde_json::to_vec(&parts).unwrap_or_default())
    }
}
