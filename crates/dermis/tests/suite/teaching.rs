//! The teaching examples run, stay short, and do what they say.

#[path = "../../examples/first_touch.rs"]
mod first_touch;
#[path = "../../examples/offline_images.rs"]
mod offline_images;
#[path = "../../examples/own_instrument.rs"]
mod own_instrument;
#[path = "../../examples/own_skin.rs"]
mod own_skin;
#[path = "../../examples/train_and_use.rs"]
mod train_and_use;

#[test]
fn a_first_touch_is_seen() {
    first_touch::main().unwrap();
}

#[test]
fn a_skin_made_in_code_finds_its_presses() {
    own_skin::main().unwrap();
}

#[test]
fn a_custom_instrument_is_read() {
    own_instrument::main().unwrap();
}

#[test]
fn files_become_images() {
    offline_images::main().unwrap();
}

#[test]
fn a_network_is_trained_and_used() {
    train_and_use::main().unwrap();
}

#[test]
fn teaching_examples_are_short() {
    for name in ["first_touch", "own_skin", "own_instrument", "offline_images", "train_and_use"] {
        let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("examples/{name}.rs"));
        let lines = std::fs::read_to_string(file).unwrap().lines().count();
        assert!(lines < 60, "{name}: {lines} lines");
    }
}
