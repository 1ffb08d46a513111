//! A demonstration without hardware: an arm of primitives with four skins, each played by its twin.

/// The files of the demonstration: name and text. They belong in one folder.
pub const DEMO_FILES: [(&str, &str); 2] =
    [("arm.toml", include_str!("../demo/arm.toml")), ("arm.urdf", include_str!("../demo/arm.urdf"))];
