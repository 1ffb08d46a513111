//! Baselines in a wrong order or with the wrong sign are detected, and the change that would fit is named.

use dermis_live::prepare::Prepared;
use dermis_skin::{ReadingOrder, Skin};
use dermis_tomo::eit::OrderReport;

use super::{chosen, measured, run_with, write_frames};

/// A measured baseline and its skin.
struct Case {
    skin: Skin,
    /// Channels in the protocol's order, as the skin reads them.
    frame: Vec<f64>,
}

/// The baseline of a tank: its skin, the set of measured data, and the file and frame in it.
fn case([name, set, path, select]: [&str; 4]) -> Option<Case> {
    let file = measured(set, path)?;
    let skin = Skin::open(name).unwrap();
    let table = dermis_device::read(&chosen(&file, select), None).unwrap();
    let protocol = skin.protocol().unwrap();
    let mut reader =
        dermis_live::channels::ChannelReader::new(table.layout(), &protocol, skin.backend.reads, path).unwrap();
    let frame = reader.read_table(&table).unwrap().swap_remove(0);
    Some(Case { skin, frame })
}

fn report(skin: &Skin, frame: Vec<f64>) -> OrderReport {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("b.csv");
    write_frames(&file, &[frame]);
    let mut skin = skin.clone();
    skin.imaging.refinement = None;
    run_with(skin, chosen(&file, ""), chosen(&file, "")).report.order
}

/// The hint must name the change, fit as well as the right order, and clearly better than the stated order.
fn assert_hint(report: &OrderReport, says: &str) {
    let better = report.better.as_ref().unwrap_or_else(|| panic!("no hint at {}", report.correlation));
    println!("order {says:?}: {:.4}, {:?} {:.4}", report.correlation, better.description, better.correlation);
    assert!(better.description.contains(says), "{:?}", better.description);
    assert!(better.correlation > 0.95 && report.correlation < 0.9, "{report:?}");
}

const GOLFBALL: [&str; 4] = ["golfball-tank", "golfball", "phantom_A.csv", "ref"];
const PYEIDORS: [&str; 4] =
    ["pyeidors-tank", "pyeidors-tank", "electrode01_metal/2026-03-14-21-38-31_1_10.00_55uA_1000Hz.csv", "reference"];
const SCIOSPEC: [&str; 4] = ["sciospec-tank", "sciospec", "run1/setup", "0"];
const KTC: [&str; 4] = ["ktc-tank", "ktc", "voltages.csv", "ref"];

/// A reversed sign is named.
fn check_reversed_sign(Case { skin, frame }: Case) {
    let negative: Vec<f64> = frame.iter().map(|v| -v).collect();
    assert_hint(&Prepared::new(skin).unwrap().diagnose(&negative), "sign reversed");
}

/// Lists of drives and measurements that start elsewhere are named.
fn check_rotated_lists(Case { skin, frame }: Case) {
    let per_drive = frame.len() / skin.protocol().unwrap().stimulations().len();
    let mut late = frame.clone();
    late.rotate_left(per_drive);
    // In rotating order around a round tank every drive has the same list, so a rotation goes unnoticed.
    if skin.backend.order == ReadingOrder::Absolute {
        assert_hint(&report(&skin, late), "drive list rotated by 1");
    }
    let shifted: Vec<f64> = frame
        .chunks(per_drive)
        .flat_map(|drive| drive[1..].iter().chain(&drive[..1]).copied().collect::<Vec<_>>())
        .collect();
    assert_hint(&report(&skin, shifted), "measurement list rotated by 1");
}

/// The order that differs from the skin's is named.
fn check_other_order(Case { skin, frame }: Case, says: &str) {
    assert_hint(&report(&skin, resorted(&skin, &frame)), says);
}

// One test per tank, so that missing data for one doesn't affect the others.
#[test]
fn the_reversed_sign_of_pyeidors_is_named() {
    let Some(case) = case(PYEIDORS) else { return };
    check_reversed_sign(case);
}

#[test]
fn the_reversed_sign_of_sciospec_is_named() {
    let Some(case) = case(SCIOSPEC) else { return };
    check_reversed_sign(case);
}

#[test]
fn the_reversed_sign_of_ktc_is_named() {
    let Some(case) = case(KTC) else { return };
    check_reversed_sign(case);
}

#[test]
fn rotated_lists_of_the_golfball_tank_are_named() {
    let Some(case) = case(GOLFBALL) else { return };
    check_rotated_lists(case);
}

#[test]
fn rotated_lists_of_pyeidors_are_named() {
    let Some(case) = case(PYEIDORS) else { return };
    check_rotated_lists(case);
}

#[test]
fn rotated_lists_of_sciospec_are_named() {
    let Some(case) = case(SCIOSPEC) else { return };
    check_rotated_lists(case);
}

#[test]
fn rotated_lists_of_ktc_are_named() {
    let Some(case) = case(KTC) else { return };
    check_rotated_lists(case);
}

#[test]
fn rotating_for_absolute_order_is_named() {
    let Some(case) = case(GOLFBALL) else { return };
    check_other_order(case, "rotating");
}

#[test]
fn absolute_for_rotating_order_is_named() {
    let Some(case) = case(PYEIDORS) else { return };
    check_other_order(case, "absolute");
}

/// The channels of each drive in the other order: absolute instead of rotating, or the other way round.
fn resorted(skin: &Skin, frame: &[f64]) -> Vec<f64> {
    let mut other = skin.clone();
    other.backend.order = match skin.backend.order {
        ReadingOrder::Absolute => ReadingOrder::Rotating,
        ReadingOrder::Rotating => ReadingOrder::Absolute,
    };
    let (from, to) = (skin.protocol().unwrap(), other.protocol().unwrap());
    (0..to.channel_count())
        .map(|channel| {
            let same = |c: &usize| {
                from.measurements()[*c].stimulation == to.measurements()[channel].stimulation
                    && from.pattern_of(*c) == to.pattern_of(channel)
            };
            frame[(0..from.channel_count()).find(same).unwrap()]
        })
        .collect()
}
