//! Baselines in a wrong order or of the wrong sign are noticed, and what would fit is named.

use dermis::live::prepare::Prepared;
use dermis::skin::{ReadingOrder, Skin};
use dermis_tomo::eit::OrderReport;

use super::{chosen, measured, run_with, write_frames};

/// Channels of a baseline in the protocol's order, as the skin reads them.
fn baseline(skin: &Skin, path: &str, select: &str) -> Option<Vec<f64>> {
    let file = measured(path)?;
    let table = dermis_device::read(&chosen(&file, select), None).unwrap();
    let protocol = skin.protocol().unwrap();
    let mut reader =
        dermis::live::channels::ChannelReader::new(table.layout(), &protocol, skin.backend.reads, path).unwrap();
    Some(reader.read_table(&table).unwrap().swap_remove(0))
}

fn report(skin: &Skin, frame: Vec<f64>) -> OrderReport {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("b.csv");
    write_frames(&file, &[frame]);
    let mut skin = skin.clone();
    skin.imaging.refinement = None;
    run_with(skin, chosen(&file, ""), chosen(&file, "")).report.order
}

/// The hint must name the change, fit as the right order does, and stand out from the stated order.
fn assert_hint(report: &OrderReport, says: &str) {
    let better = report.better.as_ref().unwrap_or_else(|| panic!("no hint at {}", report.correlation));
    println!("order {says:?}: {:.4}, {:?} {:.4}", report.correlation, better.description, better.correlation);
    assert!(better.description.contains(says), "{:?}", better.description);
    assert!(better.correlation > 0.95 && report.correlation < 0.9, "{report:?}");
}

const SOURCES: [(&str, &str, &str); 4] = [
    ("golfball-tank", "golfball/phantom_A.csv", "ref"),
    ("pyeidors-tank", "pyeidors-tank/electrode01_metal/2026-03-14-21-38-31_1_10.00_55uA_1000Hz.csv", "reference"),
    ("sciospec-tank", "sciospec/run1/setup", "0"),
    ("ktc-tank", "ktc/voltages.csv", "ref"),
];

#[test]
fn reversed_signs_are_named() {
    for (name, path, select) in &SOURCES[1..] {
        let skin = Skin::open(name).unwrap();
        let Some(frame) = baseline(&skin, path, select) else { return };
        let negative: Vec<f64> = frame.iter().map(|v| -v).collect();
        assert_hint(&Prepared::new(skin).unwrap().diagnose(&negative), "sign reversed");
    }
}

#[test]
fn rotated_lists_are_named() {
    for (name, path, select) in SOURCES {
        let skin = Skin::open(name).unwrap();
        let Some(frame) = baseline(&skin, path, select) else { return };
        let per_drive = frame.len() / skin.protocol().unwrap().stimulations().len();
        let mut late = frame.clone();
        late.rotate_left(per_drive);
        // In rotating order around a round tank every drive's list is the same: there is nothing to notice.
        if skin.backend.order == ReadingOrder::Absolute {
            assert_hint(&report(&skin, late), "drive list rotated by 1");
        }
        let shifted: Vec<f64> = frame
            .chunks(per_drive)
            .flat_map(|drive| drive[1..].iter().chain(&drive[..1]).copied().collect::<Vec<_>>())
            .collect();
        assert_hint(&report(&skin, shifted), "measurement list rotated by 1");
    }
}

#[test]
fn the_other_customary_order_is_named() {
    for (name, path, select, says) in
        [(SOURCES[0].0, SOURCES[0].1, SOURCES[0].2, "rotating"), (SOURCES[1].0, SOURCES[1].1, SOURCES[1].2, "absolute")]
    {
        let skin = Skin::open(name).unwrap();
        let Some(frame) = baseline(&skin, path, select) else { return };
        assert_hint(&report(&skin, resorted(&skin, &frame)), says);
    }
}

/// The channels of each drive in the order that the skin does not have: absolute for rotating and the other way round.
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
