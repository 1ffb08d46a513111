use std::path::Path;

use dermis_skin::Skin;

use super::*;

fn extent(samples: usize) -> Extent {
    Extent { samples, presses: 6, pokes: Vec::new(), seed: 3 }
}

fn tried(name: &str, tolerances: &Tolerances, extent: &Extent) -> ToleranceReport {
    run(&Skin::open(name).unwrap(), tolerances, extent, &|_, _| true).unwrap()
}

fn same(a: &ToleranceRow, b: &ToleranceRow) -> bool {
    let name = a.name.clone();
    *a == ToleranceRow { name, ..b.clone() }
}

#[test]
fn without_errors_every_row_is_the_nominal_one() {
    let report = tried("healing-square", &Tolerances::none(), &extent(2));
    for row in report.rows() {
        assert!(same(row, &report.nominal), "{row:?} against {:?}", report.nominal);
    }
    assert_eq!(report.nominal.misses_percent, 0.0, "{:?}", report.nominal);
}

#[test]
fn larger_errors_are_not_better() {
    let large = Tolerances { electrode_place_mm: 3.0, conductivity_percent: 40.0, ..Tolerances::default() };
    let (usual, large) =
        (tried("healing-square", &Tolerances::default(), &extent(6)), tried("healing-square", &large, &extent(6)));
    assert!(usual.together.mean_mm > usual.nominal.mean_mm, "{:?}", usual.together);
    assert!(large.together.mean_mm > usual.together.mean_mm, "{:?} {:?}", large.together, usual.together);
    assert!(large.verdict().contains("costs most"), "{}", large.verdict());
}

/// Samples are located by the model or by the pokes, whichever is more accurate, and each has its own unit of
/// amplitude. A wrong unit causes an error of a hundred per cent, amplitudes read from images although pokes locate the
/// touches about forty, and manufacturing errors seven.
#[test]
fn amplitudes_of_calibrated_samples_count_in_pokes() {
    let report = tried("healing-square", &Tolerances::default(), &Extent { pokes: vec![20], ..extent(2) });
    let [median, _] = report.calibrated[0].amplitude_percent;
    assert!(median < 20.0, "{:?}", report.calibrated);
}

#[test]
fn seeds_decide_and_threads_do_not() {
    let on = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let extent = Extent { seed, ..extent(3) };
        pool.install(|| tried("healing-square", &Tolerances::default(), &extent))
    };
    let (one, three, other) = (on(1, 5), on(3, 5), on(1, 6));
    assert!(one.rows().eq(three.rows()));
    assert_ne!(one.together, other.together);
}

#[test]
fn faults_of_a_file_are_reported_with_key_and_value() {
    let said = |text: &str| Tolerances::parse(text, Path::new("shop.toml")).unwrap_err().to_string();
    let message = said("thickness_percent = 99");
    assert!(
        message.contains("shop.toml") && message.contains("thickness_percent") && message.contains("99"),
        "{message}"
    );
    let message = said("electrode_place = 1.0");
    assert!(message.contains("electrode_place") && message.contains("electrode_place_mm"), "{message}");
    let message = said("bad_electrode = 3");
    assert!(message.contains("bad_electrode = 3"), "{message}");
    let message = said("gain_percent = nan");
    assert!(message.contains("gain_percent") && message.contains("NaN"), "{message}");
    let read = Tolerances::parse("gain_percent = 2.0", Path::new("shop.toml")).unwrap();
    assert_eq!(read, Tolerances { gain_percent: 2.0, ..Tolerances::default() });
}

#[test]
fn superseded_requests_are_not_waited_for() {
    let skin = Skin::open("ionic-disc").unwrap();
    let extent = Extent { samples: 1000, presses: 1, pokes: Vec::new(), seed: 1 };
    let most = std::sync::atomic::AtomicUsize::new(0);
    let stopped = run(&skin, &Tolerances::none(), &extent, &|done, _| {
        most.fetch_max(done, std::sync::atomic::Ordering::Relaxed);
        done < 3
    });
    assert!(matches!(stopped, Err(crate::Error::Interrupted)));
    // Samples already running on other threads are completed.
    let most = most.into_inner();
    assert!((3..100).contains(&most), "{most}");
}

#[test]
fn bad_extents_are_refused() {
    let skin = Skin::open("healing-square").unwrap();
    for extent in
        [extent(0), extent(10_001), Extent { presses: 0, ..extent(1) }, Extent { pokes: vec![2], ..extent(1) }]
    {
        assert!(run(&skin, &Tolerances::none(), &extent, &|_, _| true).is_err(), "{extent:?}");
    }
}

#[test]
fn a_tank_without_membrane_has_no_answer_to_pressure() {
    let causes = |name: &str| causes(&Tolerances::default(), &Skin::open(name).unwrap());
    assert!(!causes("golfball-tank").contains(&Cause::ContactLaw));
    assert!(causes("ionic-disc").contains(&Cause::ContactLaw));
}

/// The reference amplitudes must be read as the instrument reads, without signs; otherwise no touch is detected.
#[test]
fn amplitudes_of_rectified_readings_are_compared() {
    let report = tried("hydrogel-disc", &Tolerances::default(), &extent(1));
    for row in report.rows() {
        assert!(row.amplitude_percent[0] < 50.0, "{row:?}");
    }
}
