//! Measured skins of which only outline and channels are known, calibrated by pokes on differences, and with the
//! help of a sister skin's calibration. Data: DSHardman/Variable-Sensitivity-E-Skins.

use dermis_lab::evidence::five_skins;
use dermis_lab::evidence::place_errors::Presses;
use dermis_live::calibration::Calibration;

/// Draws of ten pokes to compare.
const DRAWS: usize = 6;

fn load(name: &str) -> Option<Presses> {
    Some(five_skins::presses(&dermis_testdata::set("five-skins")?.join(name)).unwrap())
}

/// Median and 90th percentile of the error on the held-out presses, mm, and the share within one standard deviation
/// in x and y.
fn test(presses: &Presses, calibration: &Calibration, least_found: f64) -> ([f64; 2], [f64; 2]) {
    let found = presses.judge(&held_out(), Some(calibration)).unwrap();
    assert!(found.errors_mm.len() as f64 >= least_found * found.presses as f64, "{} found", found.errors_mm.len());
    // Beyond 40 pokes several touches are looked for, at the price of a press in a hundred that looks like two.
    assert!(50 * found.extra <= found.presses, "one touch a press: {} too many", found.extra);
    ([0.5, 0.9].map(|share| found.quantile_mm(share)), found.within)
}

/// Scattered rows from the calibration part. The same 500 rows are always used for testing.
fn drawn(count: usize) -> Vec<usize> {
    (0..count).map(|k| (k * 1229) % 2000).collect()
}

fn held_out() -> Vec<usize> {
    (2000..2500).collect()
}

/// The limits are the requirements plus a quarter, to allow for a single draw of pokes.
#[test]
fn pokes_alone_teach_a_skin_of_unknown_wiring() {
    for (name, median_mm, p90_mm) in [("plain", 1.7, 3.8), ("circles", 2.7, 5.5)] {
        let Some(data) = load(name) else { return };
        let calibration = data.calibrate(&drawn(400)).unwrap();
        // A press that leaves no trace is missed: a few per cent at most.
        let (error, within) = test(&data, &calibration, 0.96);
        println!("{name}, 400 pokes: {error:.2?} mm, within one sigma {within:.2?}");
        assert!(error[0] <= 1.25 * median_mm && error[1] <= 1.25 * p90_mm, "{error:?}");
        // 60 to 76 % are required over many draws. 500 tests scatter by 2 %, and the choice of pokes adds more.
        assert!(within.iter().all(|share| (0.55..0.82).contains(share)), "{within:?}");
        // All presses were equally deep within a tenth of a millimetre, so nothing can be learnt about depth, and
        // none is reported.
        assert!(calibration.load_quantity().is_none() && calibration.has_silent_loads());
    }
}

/// The maps of these two skins have little in common, and their electrodes are numbered in opposite directions. One
/// learns from the other that a skin looks the same from each of its electrodes.
#[test]
fn ten_pokes_are_worth_more_with_a_sister() {
    let (Some(plain), Some(circles)) = (load("plain"), load("circles")) else { return };
    let pokes = drawn(10 * DRAWS);
    // 5 and 13 mm are required on the plain skin. Without the sister the errors are about 5.4 and 13 mm, and 14 and
    // 36 mm on the other skin. Results scatter by half between draws of ten pokes, and by a fifth for the mean of
    // these draws.
    for (name, skin, sister, most_mm) in
        [("plain", &plain, &circles, [5.0, 13.0]), ("circles", &circles, &plain, [10.0, 35.0])]
    {
        let sister = sister.calibrate(&drawn(1000)).unwrap();
        let over_draws = |start: &[Calibration]| -> [f64; 2] {
            // If even the weakest of ten pokes is strong, one press in seven is missed.
            let errors =
                pokes.chunks_exact(10).map(|draw| test(skin, &skin.calibrate_from(draw, start).unwrap(), 0.75).0);
            errors.fold([0.0; 2], |sum, error| [0, 1].map(|k| sum[k] + error[k] / DRAWS as f64))
        };
        let (alone, started) = (over_draws(&[]), over_draws(std::slice::from_ref(&sister)));
        println!("{name}, {DRAWS} times 10 pokes: alone {alone:.2?} mm, with the sister {started:.2?} mm");
        assert!((0..2).all(|k| started[k] <= 0.95 * alone[k] && started[k] <= most_mm[k]), "{started:?} {alone:?}");
    }
}
