//! Skin files, cases, calibrations and tables of pokes made of arbitrary bytes, and damaged real ones: they are
//! refused or read, but never cause a panic. `PROPTEST_CASES` sets the number of attempts.

use std::path::Path;

use dermis_lab::case::Case;
use dermis_live::calibration::{Calibration, read_pokes};
use dermis_live::forces::parse_forces;
use dermis_skin::{BUILTIN_NAMES, PriorChoice, Skin, builtin_text};
use dermis_tomo::inverse::{ImageBasis, Prior, Weighting};
use proptest::prelude::*;

const CASE: &str = r#"{"nodes": [[0,0],[1,0],[1,1],[0,1],[0.5,0.5]], "elems": [[0,1,4],[1,2,4],[2,3,4],[3,0,4]],
"electrodes": [{"type": "CEM", "z_contact": 0.1, "faces": [[0,1]]}, {"type": "CEM", "z_contact": 0.1, "faces": [[2,3]]},
{"type": "PEM", "node": 4}], "stim": [[1,-1,0]], "meas": [[0,1,-1]], "meas_stim": [0], "sigma_hom": [1,1,1,1]}"#;

/// A text with some bytes changed, some removed, and possibly without its end.
fn damaged(text: &'static str) -> impl Strategy<Value = Vec<u8>> {
    let length = text.len();
    let edits = proptest::collection::vec((0..length, any::<u8>(), any::<bool>()), 0..6);
    (edits, 0..=length).prop_map(move |(edits, end)| {
        let mut bytes = text.as_bytes()[..end.max(length / 2)].to_vec();
        for (at, byte, remove) in edits {
            if at < bytes.len() && remove {
                bytes.remove(at);
            } else if at < bytes.len() {
                bytes[at] = byte;
            }
        }
        bytes
    })
}

fn skin(bytes: &[u8]) {
    if let Ok(skin) = Skin::parse(&String::from_utf8_lossy(bytes), "fuzzed.toml") {
        // A skin that parses must also be able to report its protocol. Meshing is not tried, as it could take
        // arbitrarily long.
        let _ = skin.protocol();
        assert!(Skin::parse(&skin.to_toml(), "written.toml").is_ok());
    }
}

fn with_file(bytes: &[u8], read: impl Fn(&Path)) {
    let file = tempfile::NamedTempFile::new().unwrap();
    std::fs::write(file.path(), bytes).unwrap();
    read(file.path());
}

proptest! {
    #[test]
    fn damaged_skin_files(which in 0..BUILTIN_NAMES.len(), bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        skin(&bytes);
        let text = builtin_text(BUILTIN_NAMES[which]).unwrap();
        prop_assert!(Skin::parse(text, "built-in").is_ok());
    }

    #[test]
    fn damaged_built_in_skin_files(bytes in damaged(builtin_text("golfball-tank").unwrap())) {
        skin(&bytes);
    }

    #[test]
    fn damaged_cases(bytes in damaged(CASE)) {
        let _ = Case::parse(&bytes, Path::new("fuzzed.json"));
    }

    #[test]
    fn damaged_calibrations(bytes in damaged(r#"{"version":1,"skin":"x","channels":3,"load":null,"frames":[],"positions_m":[],"loads":null,"locator":{}}"#)) {
        with_file(&bytes, |path| assert!(Calibration::load(path).is_err()));
    }

    #[test]
    fn damaged_pokes(bytes in damaged("x_m,y_m,depth_m\n0.01,0.02,0.01\n-0.01,0.03,0.02\n")) {
        with_file(&bytes, |path| {
            let _ = read_pokes(path);
        });
    }
}

/// Text nested far deeper than any stack allows: brackets, braces, and each format's own kind of nesting.
fn nested(inner: &str, open: &str, close: &str) -> String {
    const DEEP: usize = 100_000;
    format!("{}{inner}{}", open.repeat(DEEP), close.repeat(DEEP))
}

/// A skin file with another prior.
fn with_prior(text: &str, prior: &str) -> Result<Skin, dermis_skin::Error> {
    let kept: Vec<&str> = text.lines().filter(|line| !line.starts_with("prior = ")).collect();
    Skin::parse(&kept.join("\n").replacen("[imaging]", &format!("[imaging]\nprior = {prior}"), 1), "nested.toml")
}

#[test]
fn deep_nesting_is_refused_before_the_stack_overflows() {
    let json = [
        nested("0", "[", "]"),
        nested("0", "{\"a\":", "}"),
        nested("0", "{\"locator\":", "}"),
        nested("0", "[{\"scope\":", "}]"),
        "[".repeat(1_000_000),
    ];
    for text in &json {
        let bytes = text.as_bytes();
        let skin = Skin::open("healing-square").unwrap();
        assert!(Calibration::parse(bytes, Path::new("nested.json")).is_err());
        assert!(parse_forces(bytes, Path::new("nested.json"), &skin).is_err());
        assert!(Case::parse(bytes, Path::new("nested.json")).is_err());
        assert!(dermis_page::protocol::parse::<dermis_page::Command>(text).is_err());
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("model.json");
        std::fs::write(&file, text).unwrap();
        assert!(dermis_learn::Model::load(&file).is_err());
    }
    let base = builtin_text("healing-square").unwrap();
    let part = ("{ mixture = [{ weight = 1.0, prior = ", " }] }");
    for deep in [5, 20, 200, 100_000] {
        let prior = format!("{}\"laplace\"{}", part.0.repeat(deep), part.1.repeat(deep));
        assert!(prior.parse::<PriorChoice>().is_err(), "{deep} deep");
        assert!(with_prior(base, &prior).is_err(), "{deep} deep");
    }
    with_prior(base, &format!("{}\"laplace\"{}", part.0.repeat(3), part.1.repeat(3))).unwrap();
    for text in
        [nested("0", "a = [", "]"), nested("", "[a.", "]"), nested("b = 1", "a.", ""), nested("0", "{ a = ", " }")]
    {
        assert!(Skin::parse(&text, "nested.toml").is_err());
        assert!(Skin::parse(&format!("{base}\n[[twin.faults]]\nfrom_s = {text}"), "nested.toml").is_err());
    }
}

#[test]
fn mixtures_of_priors_built_by_hand_are_bounded() {
    let mut prior = Prior::Laplace;
    for _ in 0..200 {
        prior = Prior::Mixture(vec![(1.0, prior)]);
    }
    let jacobian = faer::Mat::<f64>::identity(3, 3);
    let basis = ImageBasis { positions: vec![[0.0; 3]; 3], neighbours: vec![[0, 1], [1, 2]] };
    let error = prior.matrix(jacobian.as_ref(), &Weighting::Identity, &basis).unwrap_err().to_string();
    assert!(error.contains("nested deeper than 16"), "{error}");
}

#[test]
fn the_case_that_is_damaged_is_sound() {
    Case::parse(CASE.as_bytes(), Path::new("case.json")).unwrap();
}
