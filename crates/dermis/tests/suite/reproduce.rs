//! The published experiments, replayed: the results that the tables of `dermis reproduce` must show.

use dermis_lab::experiments::{PAPERS, Report};

fn replay(id: &str) -> Report {
    let find =
        |paper: &(&str, &str, &'static [dermis_lab::experiments::Experiment])| paper.2.iter().find(|e| e.id == id);
    let experiment = PAPERS.iter().find_map(find).unwrap_or_else(|| panic!("no experiment {id}"));
    experiment.run().unwrap()
}

fn value(report: &Report, quantity: &str) -> f64 {
    let row = report.rows.iter().find(|row| row.quantity == quantity);
    row.unwrap_or_else(|| panic!("{}: no row {quantity}", report.id)).here
}

#[test]
fn two_to_six_touches_of_the_liquid_skin_are_resolved() {
    let report = replay("I1");
    for count in 2..=6 {
        assert_eq!(value(&report, &format!("touches found of {count}")), f64::from(count));
        // Half the indenter's radius: each touch clearly belongs to its weight.
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
    // Images have NaN outside the skin, so compare their text.
    assert_eq!(format!("{report:?}"), format!("{:?}", replay("I3")));
}

#[test]
fn a_ring_is_closed_has_a_hole_and_a_touch_inside_is_found_from_every_reference() {
    let report = replay("I4");
    assert!(value(&report, "ring: weakest place over its mean") > 0.8, "{:?}", report.rows);
    assert!(value(&report, "ring: hole over its mean") < 0.5, "{:?}", report.rows);
    for name in ["rest", "the light ring", "the pressed ring"] {
        // Measured: 7.2, 7.0 and 0.1 mm. The published bound for single touches is 6 mm, but here a ring is pressed
        // too.
        assert!(value(&report, &format!("touch inside, from {name}: nearest contact")) < 7.5, "{:?}", report.rows);
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
fn every_element_of_the_em_skins_is_located() {
    let report = replay("E1");
    let share = |name: &str| value(&report, &format!("{name}: share whose peak is at the element"));
    assert_eq!(value(&report, "8 coils, image: frames"), 2500.0);
    for name in ["8 coils, image", "8 coils, heights", "16 circular, heights", "16 square, heights"] {
        assert_eq!(share(name), 1.0, "{name}: {:?}", report.rows);
    }
    // All except the element over the empty place of the array, which is weakly seen, and some of its neighbours.
    let alike = value(&report, "8 coils: model's against measured Jacobian, correlation, median of 25");
    assert!(alike > 0.98, "{:?}", report.rows);
    // With heights each element gives one touch; in the linear image elements with a long travel occasionally have a
    // side lobe.
    assert_eq!(value(&report, "8 coils, heights: share with one touch, there"), 1.0, "{:?}", report.rows);
}

#[test]
fn twos_threes_and_fours_on_the_em_skins_are_resolved() {
    let report = replay("E2");
    assert_eq!(value(&report, "8 coils, heights: pairs resolved of 20"), 20.0, "{:?}", report.rows);
    for name in ["circular", "square"] {
        let quantity = format!("16 {name}, heights: pairs resolved of 56");
        assert_eq!(value(&report, &quantity), 56.0, "{:?}", report.rows);
    }
    let report = replay("E3");
    for (array, groups) in
        [("8 coils", "three"), ("8 coils", "four"), ("16 circular", "three"), ("16 circular", "four")]
    {
        let quantity = format!("{array}: sets of {groups} fully found, of 4");
        assert_eq!(value(&report, &quantity), 4.0, "{:?}", report.rows);
    }
    // The requirement on heights under several touches.
    let travel = value(&report, "8 coils: travel of any element, largest error in fours");
    assert!(travel < 0.3, "{travel}");
}

#[test]
fn a_line_and_a_ring_are_recognised_and_square_coils_are_sharper() {
    let report = replay("E5");
    for shape in ["line", "ring"] {
        let quantity = format!("{shape}, heights: correlation of the 25 elements with the truth");
        assert!(value(&report, &quantity) >= 0.9, "{:?}", report.rows);
    }
    let report = replay("E4");
    let width = |name: &str| value(&report, &format!("{name}: spread of an element in the image, median"));
    assert!(width("16 square") < width("16 circular"), "{:?}", report.rows);
}

#[test]
fn a_foil_is_dented_less_locally_than_elements_move() {
    let report = replay("E14");
    let alike = |name: &str| value(&report, &format!("{name}: correlation of neighbours' readings, median"));
    // The paper's observation, and its reason for choosing elements.
    assert!(alike("copper foil") > alike("cylinders") + 0.2, "{:?}", report.rows);
}

#[test]
fn rhythms_of_elements_are_found_within_a_tenth_of_a_hertz() {
    for id in ["E7", "E8"] {
        for row in replay(id).rows {
            assert!((row.here - row.paper.unwrap()).abs() < 0.1, "{row:?}");
        }
    }
}

#[test]
fn force_curves_of_the_em_skins_rise_saturate_and_are_quadratics() {
    for row in replay("E10").rows {
        if row.quantity.ends_with("curve falls") {
            assert_eq!(row.here, 0.0, "{row:?}");
        } else if row.quantity.ends_with("quadratic") {
            assert!(row.here >= 0.99, "{row:?}");
        } else {
            assert!(row.here < 0.9, "{row:?}");
        }
    }
}

#[test]
fn contacts_of_the_sandwich_beat_the_published_network() {
    let report = replay("H1");
    // Published: 0.80, 0.59, 0.92; required here: 0.90, 0.40, 0.95.
    assert!(value(&report, "one touch, fitted discs: mean ICC") > 0.90, "{:?}", report.rows);
    assert!(value(&report, "one touch, fitted discs: mean RIE") < 0.40, "{:?}", report.rows);
    assert!(value(&report, "one touch, fitted discs: mean SSIM") > 0.95, "{:?}", report.rows);
    // The network gets the fitted contacts as input. Published: 0.92, 0.86 and 0.70. Here it reaches 0.95, 0.92 and
    // 0.84 with probabilities, and 0.97, 0.97 and 0.94 with classes, as in the paper.
    assert!(value(&report, "one touch, U-Net: mean SSIM") > 0.94, "{:?}", report.rows);
    assert!(value(&report, "one touch, U-Net's classes: mean SSIM") > 0.95, "{:?}", report.rows);
    assert_eq!(value(&report, "cases (of six) in which the indenter is identified by its size"), 6.0);
    let report = replay("H3");
    for (touches, probabilities, classes) in [("two touches", 0.90, 0.95), ("three touches", 0.80, 0.93)] {
        let ssim = |image: &str| value(&report, &format!("{touches}, {image}: mean SSIM"));
        assert!(ssim("U-Net") > probabilities && ssim("U-Net's classes") > classes, "{:?}", report.rows);
    }
    for (touches, icc, rie, ssim) in [("two touches", 0.90, 0.45, 0.92), ("three touches", 0.85, 0.55, 0.88)] {
        assert!(value(&report, &format!("{touches}, fitted discs: mean ICC")) > icc, "{:?}", report.rows);
        assert!(value(&report, &format!("{touches}, fitted discs: mean RIE")) < rie, "{:?}", report.rows);
        assert!(value(&report, &format!("{touches}, fitted discs: mean SSIM")) > ssim, "{:?}", report.rows);
    }
}

#[test]
fn a_cut_is_found_and_reads_as_compression_while_it_is_pressed() {
    let report = replay("H4");
    // Required: position within 3 mm, length within 4 mm, and errors of touches next to it at most 1.3 times those
    // before.
    assert!(value(&report, "cut: error of its centre") < 0.5, "{:?}", report.rows);
    assert!((value(&report, "cut: length") - 20.0).abs() < 1.0, "{:?}", report.rows);
    let beside = ["intact", "cut"].map(|state| {
        let rows = report.rows.iter().filter(|row| row.quantity.starts_with("mean error of"));
        rows.filter(|row| row.quantity.ends_with(state)).map(|row| row.here).next().unwrap()
    });
    // Below a tenth of a millimetre both are dominated by noise, and so is their ratio.
    assert!(beside[1] <= 1.3 * beside[0].max(0.1), "{beside:?}");
    assert_eq!(value(&report, "touches missed or split, cut"), 0.0);
    let report = replay("H6");
    assert_eq!(value(&report, "touches while the cut is pressed"), 1.0, "{:?}", report.rows);
    assert_eq!(value(&report, "the same damage is seen again after release"), 1.0, "{:?}", report.rows);
}

#[test]
fn a_healed_place_is_as_good_as_before() {
    let report = replay("H5");
    assert_eq!(value(&report, "the damage counts as healed"), 1.0, "{:?}", report.rows);
    assert_eq!(value(&report, "a new baseline is proposed"), 1.0, "{:?}", report.rows);
    // 0.08 mm before the cut, and 2.41 mm in the paper. The limit is what noise and mesh cause elsewhere.
    assert!(value(&report, "error there, healed, new baseline") < 0.25, "{:?}", report.rows);
}
