//! Files with unknown channel order: the search finds any rearrangement, on any skin, and the lines that it prints read
//! the file correctly. The readings come from a twin whose mesh differs from the search's.

use std::path::Path;

use dermis::Skin;
use dermis_device::{FrameTable, Layout};
use dermis_lab::channel_search::{FoundOrder, find_order};
use dermis_lab::twin_sample::{random_presses, sample_tables};
use dermis_live::prepare::Prepared;
use dermis_skin::{DrivePattern, Electrodes, MeasurePattern, ReadingOrder, Reads};
use dermis_twin::from_skin::press_range;

/// A baseline of a skin's twin.
fn baseline(skin: &Skin) -> FrameTable {
    let presses = random_presses(&skin.outline(), &press_range(skin), 1, 1).unwrap();
    let [baseline, _] = sample_tables(skin, &presses, Some(1), |_, _| {}).unwrap();
    baseline
}

fn changed(table: &FrameTable, change: impl Fn(&mut Vec<f64>)) -> FrameTable {
    let mut rows: Vec<Vec<f64>> = table.rows().map(<[f64]>::to_vec).collect();
    rows.iter_mut().for_each(&change);
    FrameTable::new(Layout::Channels { count: rows[0].len() }, rows.concat(), "changed").unwrap()
}

/// Asserts that the skin with the printed lines fits the baseline in its stated order.
fn assert_lines_read(skin: &Skin, table: &FrameTable, found: &FoundOrder) {
    let best = &found.candidates[0];
    let prepared = Prepared::new(best.on(skin)).unwrap();
    let mean = table.row(0).unwrap();
    let report = prepared.diagnose(mean);
    assert!((report.correlation - best.correlation).abs() < 0.01, "{} {best:?}", report.correlation);
    assert!(report.correlation > 0.98 && report.better.is_none(), "{}: {report:?}", found.verdict());
    // The lines themselves are valid TOML.
    let text = format!("[backend]\n{}", best.lines());
    assert!(text.parse::<toml::Table>().is_ok(), "{text}");
}

#[test]
fn a_baseline_in_the_stated_order_is_found_to_be() {
    for name in ["healing-square", "ionic-disc"] {
        let skin = Skin::open(name).unwrap();
        let table = baseline(&skin);
        let found = find_order(&table, Some(&skin)).unwrap();
        assert!(found.candidates[0].correlation > 0.98, "{name}: {}", found.verdict());
        assert_lines_read(&skin, &table, &found);
    }
}

#[test]
fn orders_signs_and_magnitudes_are_named() {
    let skin = Skin::open("healing-square").unwrap();
    let mut rotating = skin.clone();
    rotating.backend.order = ReadingOrder::Rotating;
    let table = baseline(&rotating);
    let found = find_order(&table, Some(&skin)).unwrap();
    assert!(found.is_clear, "{}", found.verdict());
    assert_eq!(found.candidates[0].order, ReadingOrder::Rotating);
    assert_lines_read(&skin, &table, &found);

    let table = changed(&baseline(&skin), |row| row.iter_mut().for_each(|value| *value = -*value));
    let found = find_order(&table, Some(&skin)).unwrap();
    assert!(found.candidates[0].description.contains("sign reversed"), "{}", found.verdict());
    assert_lines_read(&skin, &table, &found);

    let table = changed(&baseline(&skin), |row| row.iter_mut().for_each(|value| *value = value.abs()));
    let found = find_order(&table, Some(&skin)).unwrap();
    let reads = found.candidates[0].reads;
    let has_both_signs = baseline(&skin).row(0).unwrap().iter().any(|value| *value < 0.0);
    assert_eq!(reads == Reads::Magnitude, has_both_signs, "{}", found.verdict());
}

#[test]
fn other_patterns_than_the_file_s_are_found() {
    let skin = Skin::open("ionic-disc").unwrap();
    let mut other = skin.clone();
    (other.backend.drive, other.backend.measure) = (DrivePattern::Skip(2), MeasurePattern::Skip(1));
    let table = baseline(&other);
    let found = find_order(&table, Some(&skin)).unwrap();
    let best = &found.candidates[0];
    assert!(found.is_clear, "{}", found.verdict());
    assert_eq!((&best.drive, &best.measure), (&DrivePattern::Skip(2), &MeasurePattern::Skip(1)));
}

/// On a long pad the readings show where the electrode count starts, except for half a turn. The pad is its own
/// mirror image, so counting in the other direction looks like some other start.
#[test]
fn a_shifted_electrode_numbering_is_detected_on_a_long_pad() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../skins/examples/gel-pad.toml");
    let skin = Skin::open(file.to_str().unwrap()).unwrap();
    let Electrodes::Rim { count, width_mm, .. } = skin.frontend.electrodes else { panic!() };
    for (start_deg, clockwise) in [(Some(9.0 + 3.0 * 18.0), false), (Some(9.0 + 5.0 * 18.0), true)] {
        let mut other = skin.clone();
        other.frontend.electrodes = Electrodes::Rim { count, width_mm, start_deg, clockwise };
        let table = baseline(&other);
        let found = find_order(&table, Some(&skin)).unwrap();
        let description = &found.candidates[0].description;
        assert!(description.contains("electrodes counted"), "{description}");
        assert_lines_read(&skin, &table, &found);
    }
}

#[test]
fn without_a_skin_the_number_of_electrodes_is_found() {
    let skin = Skin::open("ionic-disc").unwrap();
    let mut other = skin.clone();
    (other.backend.drive, other.backend.measure) = (DrivePattern::Adjacent, MeasurePattern::Adjacent);
    let found = find_order(&baseline(&other), None).unwrap();
    assert_eq!(found.candidates[0].electrodes, other.electrode_shapes().len(), "{}", found.verdict());
    assert!(found.candidates[0].correlation > 0.95, "{}", found.verdict());
}

#[test]
fn invalid_baselines_are_refused_or_fit_no_order() {
    let skin = Skin::open("healing-square").unwrap();
    let table = |values: Vec<f64>| FrameTable::new(Layout::Channels { count: values.len() }, values, "made").unwrap();
    let found = find_order(&table((0..208).map(|k| f64::from(k * 7919 % 211)).collect()), Some(&skin)).unwrap();
    assert!(!found.is_clear && found.verdict().starts_with("nothing fits"), "{}", found.verdict());
    let found = find_order(&table((0..207).map(f64::from).collect()), Some(&skin)).unwrap();
    assert!(found.candidates.is_empty() && found.verdict().contains("207 readings"), "{}", found.verdict());
    assert!(find_order(&table(vec![1.0; 208]), Some(&skin)).unwrap_err().to_string().contains("readings that differ"));
    let loaded = find_order(&table((0..192).map(f64::from).collect()), Some(&Skin::open("hydrogel-disc").unwrap()));
    assert!(loaded.unwrap_err().to_string().contains("backend.circuit"));
    let coils = find_order(&table((0..28).map(f64::from).collect()), Some(&Skin::open("em-8").unwrap()));
    assert!(coils.unwrap_err().to_string().contains("coils"));
}
