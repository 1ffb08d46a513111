use super::*;

fn scope() -> CalibrationScope {
    CalibrationScope { skin: "ionic-disc".into(), indenter_area_m2: 3.14e-4, date: "2026-01-31".into() }
}

fn read(calibration: &ForceCalibration, position_m: [f64; 2], signal: f64) -> ForceReading {
    calibration.read(position_m, signal, None).unwrap()
}

fn samples(signal: impl Fn(f64) -> f64) -> Vec<ForceSample> {
    let at = |k: i32| f64::from(k) * 0.1;
    (1..=10)
        .map(|k| ForceSample { position_m: [0.0; 2], force_n: at(k), signal: signal(at(k)), by_law: None })
        .collect()
}

#[test]
fn polynomials_are_recovered() {
    let linear = ForceCalibration::fit(CurveKind::Linear, &samples(|f| 1e-3 * (f + 0.2)), None, scope()).unwrap();
    assert!(linear.residual_n < 1e-14);
    let force = read(&linear, [0.0; 2], 0.65e-3).valid_n().unwrap();
    assert!((force - 0.45).abs() < 1e-12);
    // F = s + 0.5 s^2, and the signal is the root of that quadratic.
    let signal = |f: f64| -1.0 + (1.0 + 2.0 * f).sqrt();
    let quadratic = ForceCalibration::fit(CurveKind::Quadratic, &samples(signal), None, scope()).unwrap();
    let Some(SignalCurve { curve: Curve::Polynomial(c), .. }) = &quadratic.signal else {
        panic!("a polynomial was asked for")
    };
    assert!(c[0].abs() < 1e-12 && (c[1] - 1.0).abs() < 1e-11 && (c[2] - 0.5).abs() < 1e-11, "{c:?}");
}

#[test]
fn a_saturating_skin_is_followed_up_to_its_stated_limit() {
    // The signal is tanh(4 F), calibrated from 0.380 to 0.9993. The lower half spans a signal of 0.310 for 0.112 N. A
    // twentieth of that slope is reached where 4 (1 - s^2) = 0.138, F = 0.59.
    let monotone = ForceCalibration::fit(CurveKind::Monotone, &samples(|f| (4.0 * f).tanh()), None, scope()).unwrap();
    let force = read(&monotone, [0.0; 2], (4.0_f64 * 0.3).tanh()).valid_n().unwrap();
    assert!((force - 0.3).abs() < 1e-12);
    let ForceReading::Saturated { from_n } = read(&monotone, [0.0; 2], 0.999) else { panic!("saturated") };
    // The cubic pieces are 0.1 N apart there.
    assert!((0.54..0.64).contains(&from_n), "{from_n}");
    assert_eq!(read(&monotone, [0.0; 2], 0.01), ForceReading::BelowRange { least_n: 0.1 });
    assert_eq!(read(&monotone, [0.0; 2], f64::NAN), ForceReading::NotFinite);
    let linear = ForceCalibration::fit(CurveKind::Linear, &samples(|f| 2.0 * f), None, scope()).unwrap();
    assert!(linear.signal.as_ref().is_some_and(|curve| curve.saturation_signal.is_none()));
    assert!(
        matches!(read(&linear, [0.0; 2], 2.5), ForceReading::AboveRange { most_n } if (most_n - 1.0).abs() < 1e-12)
    );
}

#[test]
fn location_is_compensated() {
    let places: Vec<[f64; 2]> = (0..9).map(|k| [f64::from(k % 3 - 1) * 0.05, f64::from(k / 3 - 1) * 0.05]).collect();
    let truth = |p: [f64; 2]| (0.3 - 120.0 * (p[0] * p[0] + p[1] * p[1]) + 2.0 * p[0]).exp();
    let gains: Vec<f64> = places.iter().map(|&p| truth(p)).collect();
    let smooth = GainMap::quadratic(&places, &gains).unwrap();
    let (a, b) = ([0.021, -0.033], [-0.04, 0.01]);
    // The truth has the same form as the map, so ratios are exact.
    assert!((smooth.gain_at(a) / smooth.gain_at(b) - truth(a) / truth(b)).abs() < 1e-11);
    let presses: Vec<ForceSample> = places
        .iter()
        .flat_map(|&p| {
            [0.2, 0.6].map(|f| ForceSample { position_m: p, force_n: f, signal: f * truth(p), by_law: None })
        })
        .collect();
    let plain = ForceCalibration::fit(CurveKind::Linear, &presses, None, scope()).unwrap();
    let compensated = ForceCalibration::fit(CurveKind::Linear, &presses, Some(smooth), scope()).unwrap();
    assert!(compensated.residual_n < 1e-12 && plain.residual_n > 0.03, "{}", plain.residual_n);
    assert!((read(&compensated, a, 0.4 * truth(a)).valid_n().unwrap() - 0.4).abs() < 1e-11);
    let known = GainMap::inverse_distance(&places, &gains).unwrap();
    assert!((known.gain_at(places[4]) / known.gain_at(places[0]) - gains[4] / gains[0]).abs() < 1e-13);
    assert!(GainMap::quadratic(&[[0.01, 0.02]; 8], &[1.0; 8]).is_err());
    assert!(GainMap::inverse_distance(&places, &[0.0; 9]).is_err());
}

#[test]
fn another_skins_calibration_is_refused_and_saved_ones_are_restored() {
    let fitted = ForceCalibration::fit(CurveKind::Monotone, &samples(f64::sqrt), None, scope()).unwrap();
    let loaded: ForceCalibration = serde_json::from_str(&serde_json::to_string(&fitted).unwrap()).unwrap();
    assert_eq!(loaded, fitted);
    loaded.check("ionic-disc").unwrap();
    let error = loaded.check("piezo-disc").unwrap_err();
    assert_eq!(error.to_string(), "calibration of skin \"ionic-disc\" refused: expected one of \"piezo-disc\"");
}

#[test]
fn bad_samples_are_named() {
    let fit = |samples: &[ForceSample], kind| ForceCalibration::fit(kind, samples, None, scope());
    assert!(fit(&[], CurveKind::Monotone).is_err());
    assert!(fit(&samples(|_| 1.0), CurveKind::Linear).is_err());
    assert!(fit(&samples(|f| -f), CurveKind::Linear).is_err());
    assert!(fit(&samples(|f| f)[..2], CurveKind::Quadratic).is_err());
    assert!(fit(&samples(|_| f64::NAN), CurveKind::Linear).is_err());
}
