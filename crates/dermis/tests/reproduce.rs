//! The published experiments, replayed: what the tables of `dermis reproduce` must show.

use dermis::experiments::{PAPERS, Report};

fn replay(id: &str) -> Report {
    let find = |paper: &(&str, &str, &'static [dermis::experiments::Experiment])| paper.2.iter().find(|e| e.id == id);
    let experiment = PAPERS.iter().find_map(find).unwrap_or_else(|| panic!("no experiment {id}"));
    experiment.run().unwrap()
}

fn value(report: &Report, quantity: &str) -> f64 {
    let row = report.rows.iter().find(|row| row.quantity == quantity);
    row.unwrap_or_else(|| panic!("{}: no row {quantity}", report.id)).here
}

#[test]
fn two_to_six_touches_of_the_liquid_skin_are_told_apart() {
    let report = replay("I1");
    for count in 2..=6 {
        assert_eq!(value(&report, &format!("touches found of {count}")), f64::from(count));
        // Half the indenter's radius: each touch belongs to its weight beyond doubt.
        assert!(value(&report, &format!("worst position of {count}")) < 5.0, "{:?}", report.rows);
    }
}

#[test]
fn the_smallest_weight_is_seen_everywhere_and_replays_are_identical() {
    let report = replay("I3");
    for row in &report.rows {
        // A touch begins at five standard deviations.
        assert!(row.here > 5.0, "{row:?}");
    }
    // Images hold NaN outside the skin, so they are compared by their text.
    assert_eq!(format!("{report:?}"), format!("{:?}", replay("I3")));
}

#[test]
fn a_ring_is_closed_has_a_hole_and_a_touch_inside_is_found_from_every_reference() {
    let report = replay("I4");
    assert!(value(&report, "ring: weakest place over its mean") > 0.8, "{:?}", report.rows);
    assert!(value(&report, "ring: hole over its mean") < 0.5, "{:?}", report.rows);
    for name in ["rest", "the light ring", "the pressed ring"] {
        // The published bound for single touches.
        assert!(value(&report, &format!("touch inside, from {name}: nearest contact")) < 6.0, "{:?}", report.rows);
    }
}

#[test]
fn noise_is_the_paper_s_and_tapping_has_its_frequency_up_to_the_nyquist_limit() {
    for row in replay("I-SNR").rows {
        // The mean of 208 channels' decibels over 100 frames scatters by less than 0.1 dB.
        assert!((row.here - 59.7).abs() < 0.2, "{row:?}");
    }
    let report = replay("I10");
    for frequency in [1.0, 2.5, 5.0, 7.5] {
        let found = value(&report, &format!("tapped at {frequency} Hz: largest peak"));
        // A line of the 16 s spectrum is 0.0625 Hz wide.
        assert!((found - frequency).abs() < 0.0625, "{found} for {frequency}");
    }
}

#[test]
fn every_element_of_the_em_skin_is_located_and_its_force_curve_is_a_quadratic() {
    let report = replay("E1");
    assert_eq!(value(&report, "elements whose image peaks nearest to them"), 25.0, "{:?}", report.rows);
    // None is missed; the linear image of elements that travel far has a side lobe here and there.
    assert!((25.0..=28.0).contains(&value(&report, "touches found in 25 images")), "{:?}", report.rows);
    let report = replay("E10");
    for name in ["L1", "L2", "L3"] {
        assert_eq!(
            value(&report, &format!("{name}: steps at which the curve does not rise")),
            0.0,
            "{:?}",
            report.rows
        );
        assert!(value(&report, &format!("{name}: R^2 of a quadratic")) > 0.97, "{:?}", report.rows);
    }
}
