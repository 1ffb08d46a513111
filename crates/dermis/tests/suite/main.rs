//! Behaviour of the whole: from skin files to touches, by twins and by measured data.

mod allocation;
mod any_skin;
mod damage;
mod design;
mod doctor;
mod em;
mod examples;
mod forces;
mod healing_square;
mod health;
mod hostile;
mod hydrogel;
mod ionic;
mod learning;
mod piezo;
mod recording;
mod reliability;
mod reproduce;
mod rerun;
mod served_twin;
mod spots;
mod tanks;
mod twin_faults;

/// A skin file's text with these lines in its table of the twin.
fn with_twin(text: &str, lines: &str) -> String {
    if text.contains("[twin]\n") {
        text.replacen("[twin]\n", &format!("[twin]\n{lines}\n"), 1)
    } else {
        format!("{text}\n[twin]\n{lines}\n")
    }
}
