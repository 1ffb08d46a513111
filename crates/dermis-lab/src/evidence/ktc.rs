//! `ktc`: the water tank of the Kuopio Tomography Challenge 2023, with four training phantoms and their photographed
//! ground truth.

use std::path::Path;

use dermis_learn::Model;
use dermis_live::network::built_in;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::Skin;
use dermis_tomo::eit;

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use super::imaged::{Images, chosen, imaged};
use crate::Error;
use crate::learning::challenge_score;
use crate::learning::segment::Segmenter;

/// Pixels per side of the ground truth.
const SIDE: usize = 256;
/// Number of training phantoms.
pub const PHANTOMS: usize = 4;
/// Number of levels in the challenge. Level k drops the first 2 (k - 1) electrodes.
pub const LEVELS: u32 = 7;
const TRUTHS: [&str; PHANTOMS] = ["truth_train1.csv", "truth_train2.csv", "truth_train3.csv", "truth_train4.csv"];
const VOLTAGES: &str = "voltages.csv";

/// Photographed labels of a phantom from 1 to 4: 0 background, 1 resistive, 2 conductive; row 0 at the top.
///
/// # Errors
/// The file is not an image of 256 x 256 labels.
pub fn truth(folder: &Path, phantom: usize) -> Result<Vec<u8>, Error> {
    let file = folder.join(TRUTHS[(phantom - 1).min(PHANTOMS - 1)]);
    let table = dermis_device::instruments::csv::read_numbers(&file)?;
    let values: Vec<f64> = (0..table.rows()).filter_map(|row| table.row(row)).flatten().copied().collect();
    let refuse = |field: &str, reason: String| {
        Error::Live(dermis_live::Error::Content { file: file.clone(), field: field.into(), reason })
    };
    if values.len() != SIDE * SIDE {
        return Err(refuse("size", format!("{} labels, expected {SIDE} x {SIDE}", values.len())));
    }
    match values.iter().find(|value| ![0.0, 1.0, 2.0].contains(value)) {
        Some(value) => Err(refuse("labels", format!("{value}, expected 0, 1 or 2"))),
        None => Ok(values.into_iter().map(|value| value as u8).collect()),
    }
}

/// Correlation of an image with the ground truth (resistive -1, conductive +1) over the truth's pixels inside the
/// tank.
pub fn correlation(images: &Images, frame: usize, truth: &[u8]) -> f64 {
    let centre = |k: usize| (2.0 * k as f64 + 1.0) / SIDE as f64 - 1.0;
    let (mut found, mut expected) = (Vec::new(), Vec::new());
    for (index, label) in truth.iter().enumerate() {
        let (x, y) = (centre(index % SIDE), -centre(index / SIDE));
        if x.hypot(y) < 1.0 {
            found.push(images.at(frame, x, y));
            expected.push([0.0, -1.0, 1.0][usize::from(*label).min(2)]);
        }
    }
    eit::correlation(&found, &expected)
}

/// Correlations of all phantoms' images with the ground truth, using the skin file's iterated images or linear ones.
///
/// # Errors
/// The files cannot be read or don't fit.
pub fn correlations(folder: &Path, is_refined: bool) -> Result<Vec<f64>, Error> {
    let mut skin = Skin::open("ktc-tank")?;
    if !is_refined {
        skin.imaging.refinement = None;
    }
    let file = folder.join(VOLTAGES);
    let found = imaged(skin, Some(chosen(&file, "ref")?), chosen(&file, "train1,train2,train3,train4")?, None)?;
    (1..=PHANTOMS).map(|phantom| Ok(correlation(&found.images, phantom - 1, &truth(folder, phantom)?))).collect()
}

/// The challenge's scores of all phantoms at a level from 1 to 7, as labelled by `dermis segment`: by a network, by
/// thresholds on iterated images, or by thresholds on linear ones.
///
/// # Errors
/// The files cannot be read or don't fit.
pub fn scores(folder: &Path, level: u32, model: Option<&Model>, is_refined: bool) -> Result<Vec<f64>, Error> {
    let mut skin = Skin::open("ktc-tank")?;
    if !is_refined {
        skin.imaging.refinement = None;
    }
    let prepared = Prepared::new(skin)?;
    let file = folder.join(VOLTAGES);
    let table = dermis_device::read(&chosen(&file, "ref,train1,train2,train3,train4")?, None)?;
    let lost = |channel: usize| (0..2 * (level - 1)).any(|e| prepared.protocol.channel_touches(channel, e));
    let frames: Vec<Vec<f64>> = table
        .rows()
        .map(|row| {
            let values = row.iter().enumerate();
            values.map(|(channel, value)| if lost(channel) { f64::NAN } else { *value }).collect()
        })
        .collect();
    if frames.iter().any(|frame| frame.len() != prepared.channels()) {
        let (what, expected) = (format!("frames of {}", file.display()), format!("{} channels", prepared.channels()));
        return Err(Error::Live(dermis_live::Error::Frames { what, expected, got: frames[0].len().to_string() }));
    }
    let reference = Reference::of(&prepared, &frames[..1])?;
    let differences: Vec<Vec<f64>> = frames[1..].iter().map(|frame| reference.difference(frame, None)).collect();
    let labelled = Segmenter::new(&prepared, &reference, model, SIDE)?.label(&differences, |_, _| {})?;
    (1..=PHANTOMS)
        .zip(&labelled)
        .map(|(phantom, frame)| {
            let truth = truth(folder, phantom)?;
            challenge_score(&truth, &frame.labels, SIDE).ok_or_else(|| {
                Error::Live(dermis_live::Error::Frames {
                    what: "labels of the tank".into(),
                    expected: format!("{SIDE} x {SIDE} pixels"),
                    got: frame.labels.len().to_string(),
                })
            })
        })
        .collect()
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    for name in TRUTHS.into_iter().chain([VOLTAGES]) {
        bench.need(name)?;
    }
    let folder = bench.folder().to_path_buf();
    bench.say("images");
    let over = |values: &[f64]| vec![Figure::over("mean", values, "")];
    let linear = correlations(&folder, false)?;
    bench.add(Row {
        measured: "correlation of images with the photographed truth",
        known: "diameter, electrodes, protocol, one frame of the empty tank",
        here: over(&correlations(&folder, true)?),
        plain: Comparison::computed("one linear step (the same prior)", over(&linear)),
        published: Comparison::said("not published in this measure"),
    });
    let model = built_in("ktc-tank")?;
    let nothing = vec![0; SIDE * SIDE];
    let empty: Vec<f64> = (1..=PHANTOMS)
        .map(|phantom| Ok(challenge_score(&truth(&folder, phantom)?, &nothing, SIDE).unwrap_or(f64::NAN)))
        .collect::<Result<_, Error>>()?;
    let empty = empty.iter().sum::<f64>() / PHANTOMS as f64;
    let levels = if bench.is_quick() { 1..=1 } else { 1..=LEVELS };
    for level in levels {
        bench.say(&format!("labels, level {level} of {LEVELS}"));
        let mut plain = over(&scores(&folder, level, None, false)?);
        if level == 1 {
            plain.push(Figure::new("empty labels", empty, ""));
        }
        bench.add(Row {
            measured: &format!("the challenge's score at level {level}, {} of 32 electrodes lost", 2 * (level - 1)),
            known: "the same; a network trained on simulated frames",
            here: over(&scores(&folder, level, model.as_ref(), true)?),
            plain: Comparison::computed("thresholds on linear images", plain),
            published: Comparison::said("15.24 of 21 (0.73 per frame), on the challenge's 21 harder evaluation frames"),
        });
    }
    Ok(())
}
