//! Messages of pages, to the server of a real skin and to that of a twin.
#![no_main]

use dermis_page::protocol::{PageMessage, parse};
use dermis_page::{Command, Scene};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    for is_twin in [false, true] {
        let scene = Scene { is_twin, is_treatable: is_twin, ..Scene::default() };
        if let Ok(PageMessage::Ask(_, command)) = parse::<Command>(text) {
            let _ = command.check(&scene);
        }
    }
});
