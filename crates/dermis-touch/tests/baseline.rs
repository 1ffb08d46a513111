//! The baseline starts robustly, can be tared, follows drift, and never absorbs a held touch.

mod common;

use common::Noise;
use dermis_touch::{
    Baseline, BaselineChange, BaselineParams, BaselineState, DriftCompensation, Load, ReferenceOrigin, TareGuard,
    TouchError,
};

const SECOND: u64 = 1_000_000_000;

fn params(startup_frames: usize) -> BaselineParams {
    let drift = DriftCompensation::Exponential { time_constant_s: 60.0, settle_s: 2.0 };
    BaselineParams { startup_frames, drift }
}

/// A baseline of two channels at 1 and 2, at time 0.
fn ready() -> Baseline {
    let mut baseline = Baseline::new(2, params(1)).unwrap();
    baseline.observe(0, &[1.0, 2.0]).unwrap();
    assert_eq!(baseline.learn(Load::Free), BaselineChange::Started);
    baseline
}

fn run(baseline: &mut Baseline, seconds: std::ops::Range<u64>, raw: impl Fn(u64) -> [f64; 2], load: Load) {
    for second in seconds {
        baseline.observe(second * SECOND, &raw(second)).unwrap();
        baseline.learn(load);
    }
}

#[test]
fn startup_shrugs_off_outliers_and_measures_the_noise() {
    let mut baseline = Baseline::new(3, params(200)).unwrap();
    let mut noise = Noise::new(1);
    for frame in 0..200u64 {
        let touch = if (50..80).contains(&frame) { 5.0 } else { 0.0 };
        let raw = [10.0 + 0.1 * noise.normal() + touch, f64::NAN, -3.0];
        assert_eq!(baseline.observe(frame, &raw).unwrap(), BaselineState::Starting { have: frame as usize, want: 200 });
        assert!(baseline.compensated()[0].is_nan());
        let change = baseline.learn(Load::Free);
        assert_eq!(change == BaselineChange::Started, frame == 199);
    }
    assert_eq!(baseline.state(), BaselineState::Ready);
    // The mean of 170 values has a standard error of 0.008. A touch in 15 % of the frames increases the deviation by
    // a fifth.
    assert!((baseline.baseline()[0] - 10.0).abs() < 0.03, "{}", baseline.baseline()[0]);
    assert!((0.08..0.15).contains(&baseline.noise_std()[0]), "{}", baseline.noise_std()[0]);
    assert!(baseline.baseline()[1].is_nan() && baseline.noise_std()[1].is_nan());
    assert_eq!((baseline.baseline()[2], baseline.noise_std()[2]), (-3.0, 0.0));
    assert_eq!(baseline.records()[0].origin, ReferenceOrigin::Startup);
}

#[test]
fn a_ten_minute_press_keeps_its_value() {
    let mut baseline = ready();
    run(&mut baseline, 1..601, |_| [1.5, 2.0], Load::Touched);
    assert_eq!(baseline.compensated(), [0.5, 0.0]);
    assert_eq!(baseline.baseline(), [1.0, 2.0]);
    assert_eq!(baseline.raw(), [1.5, 2.0]);
    // Frozen for two more seconds after release, while the material settles.
    run(&mut baseline, 601..602, |_| [1.2, 2.0], Load::Free);
    assert_eq!(baseline.baseline(), [1.0, 2.0]);
    run(&mut baseline, 602..610, |_| [1.2, 2.0], Load::Free);
    assert!(baseline.baseline()[0] > 1.0);
}

#[test]
fn drift_is_followed_with_the_stated_time_constant() {
    let mut baseline = ready();
    run(&mut baseline, 1..61, |_| [2.0, 2.0], Load::Free);
    // A step of 1 has decayed to 1/e after 60 s, exactly for an exponential mean.
    assert!((baseline.baseline()[0] - (2.0 - (-1.0f64).exp())).abs() < 1e-12);
    let before = baseline.baseline()[0];
    baseline.set_drift(DriftCompensation::Off).unwrap();
    run(&mut baseline, 61..200, |_| [2.0, 2.0], Load::Free);
    assert_eq!(baseline.baseline()[0], before);
}

#[test]
fn a_dead_channel_stays_alone() {
    let mut baseline = ready();
    run(&mut baseline, 1..20, |_| [f64::NAN, 3.0], Load::Free);
    assert!(baseline.raw()[0].is_nan() && baseline.compensated()[0].is_nan());
    assert_eq!(baseline.baseline()[0], 1.0);
    assert!(baseline.baseline()[1] > 2.0);
}

#[test]
fn a_tare_is_the_mean_of_its_frames_and_is_recorded() {
    let mut baseline = ready();
    baseline.tare(4, TareGuard::RefuseUnderLoad, "before the run").unwrap();
    for (second, value) in [(1u64, 3.0), (2, 4.0), (3, 5.0), (4, 8.0)] {
        let state = baseline.observe(second * SECOND, &[value, f64::NAN]).unwrap();
        assert_eq!(state, BaselineState::Taring { have: second as usize - 1, want: 4 });
        let change = baseline.learn(Load::Free);
        assert_eq!(change == BaselineChange::Tared, second == 4);
    }
    assert_eq!(baseline.baseline()[0], 5.0);
    assert!(baseline.baseline()[1].is_nan());
    let record = baseline.records().last().unwrap();
    assert_eq!((record.origin, record.frames, record.time_ns), (ReferenceOrigin::Tare, 4, 4 * SECOND));
    assert_eq!(record.reason, "before the run");
}

#[test]
fn a_tare_under_load_is_refused_unless_forced() {
    let mut baseline = ready();
    run(&mut baseline, 1..3, |_| [1.5, 2.0], Load::Touched);
    assert_eq!(baseline.tare(2, TareGuard::RefuseUnderLoad, ""), Err(TouchError::TareUnderLoad));
    baseline.tare(2, TareGuard::Force, "a cup stands on it").unwrap();
    run(&mut baseline, 3..5, |_| [1.5, 2.0], Load::Touched);
    assert_eq!(baseline.baseline(), [1.5, 2.0]);
    assert_eq!(baseline.records().last().unwrap().origin, ReferenceOrigin::ForcedTare);
}

#[test]
fn a_change_calls_off_a_tare_of_a_skin_at_rest() {
    for (change, expected) in [(0.0, [5.0, 6.0]), (5.0, [1.0, 2.0])] {
        let mut baseline = Baseline::new(2, params(4)).unwrap();
        let noisy = |second: u64, at: [f64; 2]| at.map(|value| value + 0.01 * (-1.0_f64).powi(second as i32));
        run(&mut baseline, 0..4, |second| noisy(second, [1.0, 2.0]), Load::Free);
        baseline.tare(4, TareGuard::Still, "a press has ended").unwrap();
        run(&mut baseline, 4..6, |second| noisy(second, [5.0, 6.0]), Load::Touched);
        run(&mut baseline, 6..8, |second| noisy(second, [5.0, 6.0 + change]), Load::Touched);
        let is_near = |(value, expected): (&f64, f64)| (value - expected).abs() < 0.02;
        assert!(baseline.baseline().iter().zip(expected).all(is_near), "{change}: {:?}", baseline.baseline());
        assert_eq!(baseline.state(), BaselineState::Ready);
    }
}

#[test]
fn a_touch_calls_a_tare_off() {
    let mut baseline = ready();
    baseline.tare(10, TareGuard::RefuseUnderLoad, "").unwrap();
    run(&mut baseline, 1..3, |_| [1.0, 2.0], Load::Free);
    baseline.observe(3 * SECOND, &[1.5, 2.0]).unwrap();
    assert_eq!(baseline.learn(Load::Touched), BaselineChange::TareCancelled);
    assert_eq!((baseline.state(), baseline.records().len()), (BaselineState::Ready, 1));
}

#[test]
fn a_reference_can_be_given() {
    let mut baseline = Baseline::new(2, params(100)).unwrap();
    baseline.set_baseline(7, &[1.0, 1.0], "rest frame").unwrap();
    baseline.observe(8, &[1.5, 0.5]).unwrap();
    assert_eq!(baseline.compensated(), [0.5, -0.5]);
    assert_eq!(baseline.records()[0].origin, ReferenceOrigin::Given);
}

#[test]
fn bad_input_is_named() {
    let mut baseline = ready();
    assert_eq!(baseline.observe(1, &[1.0]).unwrap_err().to_string(), "frame: expected 2 values, got 1");
    baseline.observe(9, &[1.0, 1.0]).unwrap();
    assert!(matches!(baseline.observe(8, &[1.0, 1.0]), Err(TouchError::TimeReversed { .. })));
    assert!(baseline.tare(0, TareGuard::Force, "").is_err());
    assert!(baseline.set_drift(DriftCompensation::Exponential { time_constant_s: 0.0, settle_s: 0.0 }).is_err());
    assert!(Baseline::new(2, params(0)).is_err());
}

/// A ready baseline of four channels, with uniform compensation of 10 s.
fn uniform() -> Baseline {
    let drift = DriftCompensation::Uniform { time_constant_s: 10.0, settle_s: 0.0 };
    let mut baseline = Baseline::new(4, BaselineParams { startup_frames: 8, drift }).unwrap();
    for frame in 0..8_u64 {
        // Noise of one part in a thousand, so that the noise is measured.
        let wobble = if frame % 2 == 0 { 1e-3 } else { -1e-3 };
        let values = REST.map(|rest| rest + wobble);
        baseline.observe(frame * 100_000_000, &values).unwrap();
        baseline.learn(Load::Free);
    }
    baseline
}

const REST: [f64; 4] = [1.0, -2.0, 0.5, 3.0];

#[test]
fn uniform_compensation_follows_only_uniform_changes() {
    let follow = |values: [f64; 4]| {
        let mut baseline = uniform();
        for frame in 8..1008_u64 {
            baseline.observe(frame * 100_000_000, &values).unwrap();
            baseline.learn(Load::Free);
        }
        baseline
    };
    // 2 % everywhere: 100 s, ten time constants, leave e^-10 of it.
    let warm = follow(REST.map(|rest| 1.02 * rest));
    assert!(warm.baseline().iter().zip(REST).all(|(b, rest)| (b / rest - 1.02).abs() < 2e-3), "{:?}", warm.baseline());
    assert!((warm.drift_factor() - 1.02).abs() < 2e-3, "{}", warm.drift_factor());
    // One channel: a touch, however slow.
    let touched = follow([1.0, -2.0, 0.5, 3.3]);
    assert!((touched.compensated()[3] - 0.3).abs() < 2e-3 && touched.drift_factor() == 1.0, "{touched:?}");
    // With drift held, nothing is followed; with `follow_rest`, everything.
    let mut held = uniform();
    held.hold_drift(true);
    let mut healing = uniform();
    healing.follow_rest(true);
    for frame in 8..1008_u64 {
        for (baseline, values) in [(&mut held, REST.map(|rest| 1.02 * rest)), (&mut healing, [1.0, -2.0, 0.5, 3.3])] {
            baseline.observe(frame * 100_000_000, &values).unwrap();
            baseline.learn(Load::Free);
        }
    }
    assert!((held.compensated()[3] - 0.06).abs() < 2e-3);
    assert!(healing.compensated()[3].abs() < 2e-3, "{:?}", healing.compensated());
}

#[test]
fn baselines_are_kept_and_can_be_taken_up_again() {
    let mut baseline = uniform();
    let first = baseline.baseline().to_vec();
    baseline.adopt(900_000_000, &[1.1, -2.1, 0.6, 3.1], 10, "includes damage 1").unwrap();
    assert_eq!((baseline.kept(0), baseline.kept(1)), (Some(&first[..]), Some(&[1.1, -2.1, 0.6, 3.1][..])));
    assert_eq!(baseline.records()[1].origin, ReferenceOrigin::Damage);
    baseline.reuse(950_000_000, 0, "the damage was none").unwrap();
    assert_eq!(baseline.baseline(), first);
    assert_eq!(baseline.records().len(), 3);
    let error = baseline.reuse(960_000_000, 7, "").unwrap_err().to_string();
    assert!(error.contains("baseline = 7"), "{error}");
    // The first and the last 64 keep their values.
    for _ in 0..80 {
        baseline.adopt(970_000_000, &first, 1, "again").unwrap();
    }
    let kept = (0..baseline.records().len()).filter(|record| baseline.kept(*record).is_some()).count();
    assert_eq!((kept, baseline.kept(0).is_some(), baseline.kept(1).is_some()), (65, true, false));
}
