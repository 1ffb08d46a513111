//! `hydrogel`: the round gelatin skin of Hardman, Thuruthel and Iida, pressed 500 times by a robot.

use dermis_skin::{CircuitChoice, LearnCircuit, Skin};

use super::bench::{Bench, Row, Stop};
use super::finding::Comparison;
use super::place_errors::{PlaceErrors, Presses, shuffled};
use crate::Error;

/// Presses to judge after a calibration.
const JUDGED: usize = 100;
const NONE_PUBLISHED: &str = "none known";

/// Reads the presses in a folder, for the built-in skin `hydrogel-disc`.
///
/// # Errors
/// The files cannot be read or don't match.
pub fn presses(folder: &std::path::Path) -> Result<Presses, Error> {
    let [before, pressed, places] = FILES.map(|name| folder.join(name));
    Presses::read(Skin::open("hydrogel-disc")?, Some(&before), &pressed, &places)
}

const FILES: [&str; 3] = ["ohmc16_before.csv", "ohmc16_pressed.csv", "ohmc16_positions.csv"];

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    for name in FILES {
        bench.need(name)?;
    }
    let presses = presses(bench.folder())?;
    let (count, skin) = (presses.count(), Skin::open("hydrogel-disc")?);
    let all: Vec<usize> = (0..count).collect();
    bench.say("without labels");
    let mut textbook = skin.clone();
    textbook.backend.circuit = None;
    let figures = |errors: PlaceErrors| PlaceErrors::without_sigmas(&[errors]);
    let mut plain = figures(presses.with_skin(textbook).judge(&all, None)?);
    plain.extend(figures(presses.judge_middle()).into_iter().take(1).map(|mut figure| {
        figure.name = "guessing the middle, median".into();
        figure
    }));
    bench.add(Row {
        measured: &format!("positions of {count} presses, without labels"),
        known: "the skin file with the board's circuit; channels are calibrated on the untouched frames",
        here: figures(presses.judge(&all, None)?),
        plain: Comparison::computed("the same without the circuit (textbook model)", plain),
        published: Comparison::said(NONE_PUBLISHED),
    });
    if !bench.is_quick() {
        bench.say("circuit learnt from unlabelled frames");
        let mut ignorant = skin;
        ignorant.backend.circuit = Some(CircuitChoice::ToLearn(LearnCircuit::Learn));
        bench.add(Row {
            measured: &format!("positions of {count} presses, without labels or circuit"),
            known: "the skin file without the circuit, which is found from the same unlabelled frames",
            here: figures(presses.with_skin(ignorant).judge(&all, None)?),
            plain: Comparison::said("as above"),
            published: Comparison::said(NONE_PUBLISHED),
        });
    }
    let seeds = if bench.is_quick() { 1..=1 } else { 1..=5 };
    for taught in [50, 400] {
        if count < taught + JUDGED {
            continue;
        }
        let (mut here, mut plain) = (Vec::new(), Vec::new());
        for seed in seeds.clone() {
            bench.say(&format!("{taught} pokes, draw {seed} of {}", seeds.end()));
            let order = shuffled(count, seed);
            let (taught, judged) = (&order[..taught], &order[count - JUDGED..]);
            here.push(presses.judge(judged, Some(&presses.calibrate(taught)?))?);
            plain.push(presses.judge_plain(taught, judged));
        }
        bench.add(Row {
            measured: &format!("positions of {JUDGED} presses after {taught} pokes; mean of {} draws", here.len()),
            known: "the skin file and these pokes, without the judged presses",
            here: PlaceErrors::figures(&here),
            plain: Comparison::computed("kernel ridge regression", PlaceErrors::without_sigmas(&plain)),
            published: Comparison::said(NONE_PUBLISHED),
        });
    }
    Ok(())
}
