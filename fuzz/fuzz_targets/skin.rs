//! Skin files. A skin that is read must be the same after writing and reading it.
#![no_main]

use dermis_skin::Skin;
use dermis_skin::budget::Budget;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let Ok(skin) = Skin::parse(text, "fuzzed.toml") else { return };
    let budget = Budget::of_imaging(&skin);
    assert!(budget.bytes.is_finite() && budget.seconds.is_finite());
    let again = Skin::parse(&skin.to_toml(), "written.toml").expect("what was written is read");
    assert_eq!(again, skin);
});
