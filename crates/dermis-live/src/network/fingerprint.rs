//! Checks that a network matches a skin.

use dermis_learn::Model;
use dermis_skin::{Backend, Electronics, Skin};

use super::input_image::InputImage;

/// SHA-256 of everything that images depend on: modality, frontend, backend without its electronics, and imaging. A
/// network matches skins with the same fingerprint.
pub fn imaging_sha256(skin: &Skin) -> String {
    let backend = Backend { electronics: Electronics::default(), ..skin.backend.clone() };
    let parts = (skin.modality, &skin.frontend, &backend, &skin.imaging);
    dermis_learn::sha256(&serde_json::to_vec(&parts).unwrap_or_default())
}

/// True if a network was trained for this skin, and its input images can be made from the skin's frames.
pub fn suits(model: &Model, skin: &Skin) -> bool {
    let is_fitted =
        |name: &String| [InputImage::Contacts, InputImage::Left].iter().any(|image| *name == image.to_string());
    let is_trained_for = model.check_skin(&skin.name, &imaging_sha256(skin)).is_ok();
    is_trained_for && (skin.fits_touches() || !model.card.inputs.iter().any(is_fitted))
}
