//! `dermis skins`: invalid skin files are refused with the place of the fault, and skins are listed, shown and drawn.

use std::fs;

use super::{Desk, SKIN};

#[test]
fn bad_skin_files_are_refused_with_their_place() {
    let table: [(&str, &str, &[&str]); 9] = [
        ("name = \"test\"", "name = \"test\"\ncolour = \"red\"", &["colour", "unknown field", "3 |"]),
        ("current_ma = 1.0", "current_a = 1.0", &["current_a", "unknown field"]),
        ("current_ma = 1.0", "current_ma = nan", &["backend.current_ma", "NaN", "1e-9 to 1e6"]),
        ("elements = 300", "elements = 3", &["imaging.elements", "= 3", "50 to 500000"]),
        ("[20.0, 0.0]", "[70.0, 0.0]", &["mesh of test", "electrode 1"]),
        ("[20.0, 0.0]", "[-15.0, 0.0]", &["mesh of test", "electrode"]),
        ("diameter_mm = 100.0", "diameter_mm = -1.0", &["frontend.shape.disc.diameter_mm", "-1", "1 to 10000"]),
        ("drive = \"adjacent\"", "drive = \"sideways\"", &["sideways", "adjacent"]),
        ("elements = 300\n", "elements = [", &["test.toml", "line 23", "unclosed array"]),
    ];
    for (from, to, fragments) in table {
        assert!(SKIN.contains(from), "{from}");
        let desk = Desk::with(&[("test.toml", &SKIN.replacen(from, to, 1))]);
        let message = desk.refused(&["skins", "draw", "test.toml", "--out", "skin.svg"], 2);
        for fragment in fragments {
            assert!(message.contains(fragment), "{to}: no {fragment:?} in {message}");
        }
    }
    let message = Desk::with(&[]).refused(&["skins", "show", "nothing"], 2);
    assert!(message.contains("\"nothing\"") && message.contains("healing-square"), "{message}");
}

#[test]
fn skins_are_listed_shown_and_drawn() {
    let desk = Desk::with(&[("skin.toml", SKIN)]);
    let list = desk.done(&["skins", "list"]);
    for name in list.lines().map(|line| line.split_whitespace().next().expect("a name")) {
        let shown = desk.done(&["skins", "show", name]);
        let (first, _) = shown.split_once('\n').expect("lines");
        assert!(first.starts_with("# ") && (first.contains(" electrodes, ") || first.contains(" coils, ")), "{shown}");
        fs::write(desk.path("shown.toml"), &shown).expect("a file");
        assert_eq!(desk.done(&["skins", "show", "shown.toml"]), shown, "{name} does not survive being shown");
    }
    assert!(list.contains("healing-square"), "{list}");

    let out = desk.done(&["skins", "draw", "skin.toml", "--out", "skin.svg"]);
    assert!(out.starts_with("1000 x ") && out.ends_with("pixels to skin.svg\n"), "{out}");
    let svg = fs::read_to_string(desk.path("skin.svg")).expect("a picture");
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    for (class, count) in [("mesh", 1), ("outline", 1), ("electrodes", 1), ("number", 4), ("scale-bar", 1), ("axes", 1)]
    {
        assert_eq!(svg.matches(&format!("class=\"{class}\"")).count(), count, "{class}");
    }
    desk.done(&["skins", "draw", "skin.toml", "--out", "bare.svg", "--no-mesh"]);
    assert!(!fs::read_to_string(desk.path("bare.svg")).expect("a picture").contains("class=\"mesh\""));

    desk.done(&["skins", "draw", "skin.toml", "--out", "skin.PNG", "--width-px", "320"]);
    let png = fs::read(desk.path("skin.PNG")).expect("a picture");
    assert!(png.starts_with(b"\x89PNG\r\n\x1a\n"));
    assert_eq!(u32::from_be_bytes(png[16..20].try_into().expect("4 bytes")), 320, "width in the header");
}
