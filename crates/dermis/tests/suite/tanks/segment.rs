//! The Kuopio tank, segmented: labels against the photographed truth by the challenge's own score, with as many
//! electrodes lost as at the challenge's hardest level.

use dermis::live::reference::Reference;
use std::path::Path;

use dermis::lab::learning::challenge_score;
use dermis::lab::learning::segment::Segmenter;
use dermis::live::network::built_in;
use dermis::live::prepare::Prepared;
use dermis::skin::Skin;
use dermis_learn::Model;

use super::{chosen, measured};

fn truth(directory: &Path, phantom: usize) -> Vec<u8> {
    let text = std::fs::read_to_string(directory.join(format!("truth_train{phantom}.csv"))).unwrap();
    text.lines().flat_map(|line| line.split(',').map(|cell| cell.trim().parse::<f64>().unwrap() as u8)).collect()
}

/// Scores of the four training phantoms at a level of the challenge, which loses the first 2 (level - 1) electrodes.
fn scores(directory: &Path, level: u32, model: Option<&Model>) -> Vec<f64> {
    let prepared = Prepared::new(Skin::open("ktc-tank").unwrap()).unwrap();
    let table = dermis_device::read(&chosen(&directory.join("voltages.csv"), ""), None).unwrap();
    let lost = |channel: usize| (0..2 * (level - 1)).any(|e| prepared.protocol.channel_touches(channel, e));
    let frame = |k: usize| -> Vec<f64> {
        let values = table.row(k).unwrap().iter().enumerate();
        values.map(|(channel, value)| if lost(channel) { f64::NAN } else { *value }).collect()
    };
    let reference = Reference::of(&prepared, &[frame(0)]).unwrap();
    let differences: Vec<Vec<f64>> = (1..5).map(|k| reference.difference(&frame(k), None)).collect();
    let mut segmenter = Segmenter::new(&prepared, &reference, model, 256).unwrap();
    let found = segmenter.label(&differences, |_, _| {}).unwrap();
    (1..5)
        .zip(&found)
        .map(|(phantom, frame)| challenge_score(&truth(directory, phantom), &frame.labels, 256).unwrap())
        .collect()
}

// Measured: 0.661, 0.772, 0.882, 0.832; all levels are in the chapter on learning.
#[test]
fn thresholds_segment_the_phantoms_without_twelve_electrodes() {
    let Some(directory) = measured("ktc", "") else { return };
    let found = scores(&directory, 7, None);
    let mean = found.iter().sum::<f64>() / 4.0;
    println!("ktc level 7: {found:.3?} mean {mean:.3}");
    assert!(mean > 0.74, "{found:.3?}");
}

// Measured: 0.935, 0.935, 0.971, 0.857 with all electrodes, 0.722, 0.844, 0.910, 0.847 without twelve. The network was
// trained on simulations alone.
#[test]
fn the_network_segments_the_phantoms_with_all_electrodes_and_without_twelve() {
    let Some(directory) = measured("ktc", "") else { return };
    let model = built_in("ktc-tank").unwrap().unwrap();
    for (level, least) in [(1, 0.90), (7, 0.78)] {
        let found = scores(&directory, level, Some(&model));
        let mean = found.iter().sum::<f64>() / 4.0;
        println!("ktc level {level}, network: {found:.3?} mean {mean:.3}");
        assert!(mean > least, "level {level}: {found:.3?}");
    }
}
