//! Behaviour of the whole system, from skin files to touches, with twins and measured data.

mod allocation;
mod any_skin;
mod bench;
mod channel_search;
mod circuit;
mod damage;
mod design;
mod doctor;
mod eit_kit;
mod em;
mod examples;
mod five_skins;
mod forces;
mod frame_noise;
mod fuzz;
mod gel_damage;
mod guard;
mod healing_square;
mod health;
mod hostile;
mod hydrogel;
mod ionic;
mod learning;
mod mesh_files;
#[allow(dead_code, reason = "the tests of streams use the rest of it")]
#[path = "../../../dermis-device/tests/own_clock/mod.rs"]
mod own_clock;
mod piezo;
mod protocol_lists;
mod public_api;
mod random_skins;
mod recording;
mod reliability;
mod reproduce;
mod rerun;
mod served_twin;
mod session;
mod sigmas;
mod spots;
mod tanks;
mod teaching;
mod twin_faults;

/// A skin file's text with these lines added to its `[twin]` table.
fn with_twin(text: &str, lines: &str) -> String {
    if text.contains("[twin]\n") {
        text.replacen("[twin]\n", &format!("[twin]\n{lines}\n"), 1)
    } else {
        format!("{text}\n[twin]\n{lines}\n")
    }
}
