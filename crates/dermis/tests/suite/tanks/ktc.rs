//! The Kuopio tank: images compared with the photographed ground truth, with all electrodes and with some missing.

use std::path::Path;

use dermis_lab::evidence::imaged::Imaged;
use dermis_lab::evidence::ktc::{PHANTOMS, correlation, truth};
use dermis_skin::Skin;

use super::{chosen, measured, run_with, write_frames};

const FRAMES: &str = "train1,train2,train3,train4";

/// Correlation of every image with its ground truth, over the truth's pixels inside the tank.
fn correlations(directory: &Path, outcome: &Imaged) -> Vec<f64> {
    (0..PHANTOMS).map(|frame| correlation(&outcome.images, frame, &truth(directory, frame + 1).unwrap())).collect()
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn assert_no_holes(outcome: &Imaged) {
    for frame in 0..outcome.images.frames.len() {
        assert_eq!(outcome.images.holes(frame), 0, "NaN inside the tank in frame {frame}");
    }
}

// Measured: 0.928, 0.943, 0.940, 0.749; mean 0.890.
#[test]
fn refined_images_show_the_phantoms() {
    let Some(directory) = measured("ktc", "") else { return };
    let file = directory.join("voltages.csv");
    let outcome = run_with(Skin::open("ktc-tank").unwrap(), chosen(&file, "ref"), chosen(&file, FRAMES));
    let found = correlations(&directory, &outcome);
    println!("ktc refined {found:.3?} mean {:.4}, order {:.4}", mean(&found), outcome.report.order.correlation);
    assert_no_holes(&outcome);
    assert!(outcome.report.order.correlation > 0.99 && outcome.report.order.better.is_none());
    assert!(mean(&found) >= 0.86, "{found:.3?}");
}

// Measured: 0.827, 0.886, 0.870, 0.767; mean 0.838.
#[test]
fn linear_images_are_good_enough_too() {
    let Some(directory) = measured("ktc", "") else { return };
    let file = directory.join("voltages.csv");
    let mut skin = Skin::open("ktc-tank").unwrap();
    skin.imaging.refinement = None;
    let outcome = run_with(skin, chosen(&file, "ref"), chosen(&file, FRAMES));
    let found = correlations(&directory, &outcome);
    println!("ktc linear {found:.3?} mean {:.4}", mean(&found));
    assert_no_holes(&outcome);
    assert!(mean(&found) >= 0.80, "{found:.3?}");
}

/// As in the challenge, every channel that drives or reads a lost electrode (numbered from 1) is missing.
fn without_electrodes(directory: &Path, lost: &[u32], refined: bool) -> (Vec<f64>, usize) {
    let mut skin = Skin::open("ktc-tank").unwrap();
    if !refined {
        skin.imaging.refinement = None;
    }
    let protocol = skin.protocol().unwrap();
    let table = dermis_device::read(&chosen(&directory.join("voltages.csv"), ""), None).unwrap();
    let gone: Vec<bool> = (0..protocol.channel_count())
        .map(|channel| {
            lost.iter()
                .any(|&e| protocol.channel_touches(channel, e - 1) || protocol.stimulation_of(channel).touches(e - 1))
        })
        .collect();
    let frames: Vec<Vec<f64>> = (0..5)
        .map(|k| table.row(k).unwrap().iter().zip(&gone).map(|(v, gone)| if *gone { f64::NAN } else { *v }).collect())
        .collect();
    let folder = tempfile::tempdir().unwrap();
    let (baseline, rest) = (folder.path().join("b.csv"), folder.path().join("f.csv"));
    write_frames(&baseline, &frames[..1]);
    write_frames(&rest, &frames[1..]);
    let outcome = run_with(skin, chosen(&baseline, ""), chosen(&rest, ""));
    assert_eq!(outcome.report.frames_with_missing, 4);
    assert_no_holes(&outcome);
    (correlations(directory, &outcome), gone.iter().filter(|gone| !**gone).count())
}

// Measured means, refined (linear): level 5 consecutive 0.846 (0.805), scattered 0.883 (0.826); level 7 consecutive
// 0.796 (0.780), scattered 0.866 (0.822).
#[test]
fn lost_electrodes_leave_images() {
    let Some(directory) = measured("ktc", "") else { return };
    let consecutive = |count: u32| (1..=count).collect::<Vec<_>>();
    let scattered_8 = vec![2, 5, 11, 12, 18, 23, 27, 30];
    let scattered_12 = vec![2, 4, 7, 10, 12, 15, 19, 20, 24, 26, 30, 32];
    for (name, lost, refined) in [
        ("level 5, consecutive", consecutive(8), true),
        ("level 5, scattered", scattered_8, true),
        ("level 7, consecutive", consecutive(12), true),
        ("level 7, scattered", scattered_12, true),
        ("level 7, consecutive", consecutive(12), false),
    ] {
        let (found, rows) = without_electrodes(&directory, &lost, refined);
        println!("ktc {name}, refined {refined}, {rows} rows: {found:.3?} mean {:.4}", mean(&found));
        assert!(mean(&found) >= 0.70, "{name}: {found:.3?}");
    }
}
