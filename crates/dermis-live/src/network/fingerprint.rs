//! What tells whether a network fits a skin.

use dermis_skin::{Backend, Electronics, Skin};

/// SHA-256 of what images depend on: modality, frontend, backend without its electronics, and imaging. A network fits
/// skins of the same fingerprint.
pub fn imaging_sha256(skin: &Skin) -> String {
    let backend = Backend { electronics: Electronics::default(), ..skin.backend.clone() };
    let parts = (skin.modality, &skin.frontend, &backend, &skin.imaging);
    dermis_learn::sha256(&serde_json::to_vec(&parts).unwrap_or_default())
}
