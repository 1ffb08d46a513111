//! The built-in skins: the files of `skins/`, embedded.

/// Default skin if none is named.
pub const DEFAULT_NAME: &str = "healing-square";

/// Names of the built-in skins.
pub const BUILTIN_NAMES: [&str; 14] = [
    "healing-square",
    "ionic-disc",
    "ionic-square",
    "piezo-square",
    "piezo-disc",
    "piezo-cylinder",
    "em-8",
    "em-16-circular",
    "em-16-square",
    "hydrogel-disc",
    "ktc-tank",
    "golfball-tank",
    "sciospec-tank",
    "pyeidors-tank",
];

/// The file of a built-in skin, as text.
pub fn builtin_text(name: &str) -> Option<&'static str> {
    Some(match name {
        "healing-square" => include_str!("../skins/healing-square.toml"),
        "ionic-disc" => include_str!("../skins/ionic-disc.toml"),
        "ionic-square" => include_str!("../skins/ionic-square.toml"),
        "em-8" => include_str!("../skins/em-8.toml"),
        "em-16-circular" => include_str!("../skins/em-16-circular.toml"),
        "em-16-square" => include_str!("../skins/em-16-square.toml"),
        "hydrogel-disc" => include_str!("../skins/hydrogel-disc.toml"),
        "ktc-tank" => include_str!("../skins/ktc-tank.toml"),
        "golfball-tank" => include_str!("../skins/golfball-tank.toml"),
        "sciospec-tank" => include_str!("../skins/sciospec-tank.toml"),
        "pyeidors-tank" => include_str!("../skins/pyeidors-tank.toml"),
        "piezo-square" => include_str!("../skins/piezo-square.toml"),
        "piezo-disc" => include_str!("../skins/piezo-disc.toml"),
        "piezo-cylinder" => include_str!("../skins/piezo-cylinder.toml"),
        _ => return None,
    })
}

/// A file shared by built-in skins, by the path that they give.
pub(super) fn builtin_part(path: &str) -> Option<&'static str> {
    match path {
        "backends/mit-16.toml" => Some(include_str!("../skins/backends/mit-16.toml")),
        "backends/mux-64.toml" => Some(include_str!("../skins/backends/mux-64.toml")),
        _ => None,
    }
}
