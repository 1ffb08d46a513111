//! Trained networks that ship with dermis, embedded from the crate's `models/`, whose `README.md` has the commands
//! that made them.

use dermis_learn::{LearnError, Model};

/// The network of a built-in skin; `None` if the skin has none. It is valid only while nothing changes that the
/// skin's images depend on ([`Model::check_skin`]).
///
/// # Errors
/// Never for models as committed; damage is reported as for files.
pub fn built_in(skin: &str) -> Result<Option<Model>, LearnError> {
    let (card, weights): (&str, &[u8]) = match skin {
        "healing-square" => (
            include_str!("../../models/healing-square.json"),
            include_bytes!("../../models/healing-square.safetensors"),
        ),
        "ktc-tank" => (include_str!("../../models/ktc-tank.json"), include_bytes!("../../models/ktc-tank.safetensors")),
        _ => return Ok(None),
    };
    Model::from_contents(card, weights, skin).map(Some)
}
