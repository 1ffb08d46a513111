//! Every fault leads to `stop` or `stale` within its limit, and nothing leads to a false `ok`.

use proptest::prelude::*;

use super::{Guard, GuardFrame, GuardLimits, GuardReason, GuardReport, GuardVerdict, LagMeter};
use crate::force::ForceReading;
use crate::health::{ChannelFault, ChannelFaultKind, FrameFault, FrameFaultKind, Health};
use crate::{ContactSign, LoadQuantity, Observation, Touch, TouchLoad, TouchPhase};

const MS: u64 = 1_000_000;
const PERIOD_NS: u64 = 10 * MS;
const LIMITS: GuardLimits = GuardLimits {
    force_n: Some(5.0),
    pressure_pa: None,
    any_touch: false,
    damage: false,
    stale_after_ns: 50 * MS,
    hold_ns: 20 * MS,
    most_left_out: 0.0,
};

fn touch(force: Option<ForceReading>) -> Touch {
    Touch {
        id: 1,
        phase: TouchPhase::Move,
        observation: Observation::Measured,
        sign: ContactSign::Positive,
        position_m: [0.0; 2],
        covariance_m2: [[0.0; 2]; 2],
        filtered_position_m: [0.0; 2],
        velocity_m_per_s: [0.0; 2],
        amplitude: 0.5,
        area_m2: 1e-4,
        force,
        radius_m: None,
        load: None,
        other_place: None,
        age_frames: 1,
        begin_time_ns: 0,
        time_ns: 0,
    }
}

/// A sound frame without touches, 1 ms after its arrival.
fn sound(frame_ns: u64) -> GuardFrame<'static> {
    GuardFrame {
        now_ns: frame_ns + MS,
        frame_ns,
        device_ns: Some(frame_ns),
        is_clock_odd: false,
        has_baseline: true,
        is_baseline_trusted: true,
        is_seen: true,
        health: Health::default(),
        readings: &[1e-3; 208],
        touches: &[],
        is_damaged: false,
    }
}

/// A guard after ten sound frames, and the time of the next one.
fn running(limits: GuardLimits) -> (Guard, u64) {
    let mut guard = Guard::new(limits);
    for k in 0..10 {
        assert_eq!(guard.judge(&sound(k * PERIOD_NS)).verdict, GuardVerdict::Ok, "frame {k}");
    }
    (guard, 10 * PERIOD_NS)
}

fn judged(limits: GuardLimits, change: impl FnOnce(&mut GuardFrame<'static>)) -> GuardReport {
    let (mut guard, next_ns) = running(limits);
    let mut frame = sound(next_ns);
    change(&mut frame);
    guard.judge(&frame)
}

fn of_touch(limits: GuardLimits, touch: Touch) -> GuardReport {
    let (mut guard, next_ns) = running(limits);
    guard.judge(&GuardFrame { touches: &[touch], ..sound(next_ns) })
}

fn assert_is(report: GuardReport, verdict: GuardVerdict, reason: GuardReason) {
    assert!(report.verdict == verdict && report.reasons.contains(reason), "{report:?}, not {verdict:?} {reason:?}");
}

#[test]
fn only_forces_known_to_be_below_the_limit_are_ok() {
    use ForceReading::{AboveRange, BelowRange, FromLaw, NotFinite, Saturated, Valid};
    let (force, unknown) = (Some(GuardReason::Force), Some(GuardReason::ForceUnknown));
    let table = [
        (Some(Valid { force_n: 4.9, sigma_n: 0.1 }), None),
        (Some(Valid { force_n: 5.0, sigma_n: 0.1 }), force),
        (Some(FromLaw { force_n: 4.9, sigma_n: 1.0 }), None),
        (Some(FromLaw { force_n: 5.1, sigma_n: 1.0 }), force),
        (Some(BelowRange { least_n: 0.5 }), None),
        (Some(BelowRange { least_n: 6.0 }), force),
        (Some(AboveRange { most_n: 2.0 }), unknown),
        (Some(Saturated { from_n: 2.0 }), unknown),
        (Some(NotFinite), unknown),
        (Some(Valid { force_n: f64::NAN, sigma_n: 0.1 }), unknown),
        (None, unknown),
    ];
    for (reading, expected) in table {
        let report = of_touch(LIMITS, touch(reading));
        match expected {
            None => assert_eq!(report.verdict, GuardVerdict::Ok, "{reading:?}"),
            Some(reason) => assert_is(report, GuardVerdict::Stop, reason),
        }
    }
    let poked = |quantity, value| {
        let load = Some(TouchLoad { quantity, value, sigma: 0.1 });
        of_touch(LIMITS, Touch { load, ..touch(None) })
    };
    assert_eq!(poked(LoadQuantity::ForceN, 4.0).verdict, GuardVerdict::Ok);
    assert_is(poked(LoadQuantity::ForceN, 5.5), GuardVerdict::Stop, GuardReason::Force);
    assert_is(poked(LoadQuantity::DepthM, 1e-3), GuardVerdict::Stop, GuardReason::ForceUnknown);
}

#[test]
fn pressures_need_a_force_and_a_fitted_radius() {
    let limits = GuardLimits { force_n: None, pressure_pa: Some(10e3), ..LIMITS };
    let of = |force_n, radius_m| {
        let force = Some(ForceReading::Valid { force_n, sigma_n: 0.1 });
        of_touch(limits, Touch { radius_m, ..touch(force) })
    };
    // 1 N on a disc of 5 mm radius is 12.7 kPa.
    assert_is(of(1.0, Some(5e-3)), GuardVerdict::Stop, GuardReason::Pressure);
    assert_eq!(of(0.7, Some(5e-3)).verdict, GuardVerdict::Ok);
    assert_is(of(0.7, None), GuardVerdict::Stop, GuardReason::PressureUnknown);
    assert_is(of(0.7, Some(0.0)), GuardVerdict::Stop, GuardReason::PressureUnknown);
}

#[test]
fn any_touch_and_damage_stop_if_asked_for() {
    let gentle = touch(Some(ForceReading::Valid { force_n: 0.1, sigma_n: 0.1 }));
    assert_eq!(of_touch(LIMITS, gentle).verdict, GuardVerdict::Ok);
    assert_is(of_touch(GuardLimits { any_touch: true, ..LIMITS }, gentle), GuardVerdict::Stop, GuardReason::Touch);
    assert_eq!(judged(LIMITS, |frame| frame.is_damaged = true).verdict, GuardVerdict::Ok);
    let limits = GuardLimits { damage: true, ..LIMITS };
    assert_is(judged(limits, |frame| frame.is_damaged = true), GuardVerdict::Stop, GuardReason::Damage);
}

#[test]
fn faults_of_whole_frames_are_stale() {
    use FrameFaultKind::{Blank, Flipped, Frozen, OutOfRange, Saturated};
    for kind in [Frozen, Saturated, Flipped, OutOfRange, Blank] {
        let fault = Some(FrameFault { kind, since_ns: 0, since_sequence: 0 });
        let report = judged(LIMITS, |frame| frame.health.frame = fault);
        assert_is(report, GuardVerdict::Stale, GuardReason::FrameFault);
    }
}

#[test]
fn channels_left_out_are_stale_above_the_allowed_share() {
    let fault = |channel: u32| ChannelFault {
        channel: 8 * channel,
        kind: ChannelFaultKind::Electrode,
        since_ns: 0,
        since_sequence: 0,
    };
    let faults: Vec<ChannelFault> = (0..26).map(fault).collect();
    let with = |most_left_out, count: usize| {
        let (mut guard, next_ns) = running(GuardLimits { most_left_out, ..LIMITS });
        let health = Health { channels: (&faults[..count]).into(), ..Health::default() };
        guard.judge(&GuardFrame { health, ..sound(next_ns) })
    };
    assert_is(with(0.0, 1), GuardVerdict::Stale, GuardReason::ChannelsLeftOut);
    assert_eq!(with(0.125, 26).verdict, GuardVerdict::Ok);
    assert_is(with(0.12, 26), GuardVerdict::Stale, GuardReason::ChannelsLeftOut);
    assert_is(judged(LIMITS, |frame| frame.readings = &[]), GuardVerdict::Stale, GuardReason::ChannelsLeftOut);
}

#[test]
fn missing_readings_count_before_they_are_left_out() {
    let mut readings = [1e-3; 208];
    readings[7] = f64::NAN;
    let with = |most_left_out| {
        let (mut guard, next_ns) = running(GuardLimits { most_left_out, ..LIMITS });
        guard.judge(&GuardFrame { readings: &readings, ..sound(next_ns) })
    };
    assert_is(with(0.0), GuardVerdict::Stale, GuardReason::ChannelsLeftOut);
    assert_eq!(with(0.01).verdict, GuardVerdict::Ok);
}

#[test]
fn baselines_that_are_missing_or_untrusted_are_stale() {
    assert_is(judged(LIMITS, |frame| frame.has_baseline = false), GuardVerdict::Stale, GuardReason::NoBaseline);
    let untrusted = judged(LIMITS, |frame| frame.is_baseline_trusted = false);
    assert_is(untrusted, GuardVerdict::Stale, GuardReason::BaselineUntrusted);
}

#[test]
fn late_frames_are_stale() {
    assert_is(judged(LIMITS, |frame| frame.now_ns += 60 * MS), GuardVerdict::Stale, GuardReason::Late);
    // A pause: the next frame is fresh, but what happened before it is unknown.
    let paused = judged(LIMITS, |frame| {
        frame.frame_ns += 100 * MS;
        frame.now_ns += 100 * MS;
        frame.device_ns = Some(frame.frame_ns);
    });
    assert_is(paused, GuardVerdict::Stale, GuardReason::Gap);
    assert_is(judged(LIMITS, |frame| frame.is_clock_odd = true), GuardVerdict::Stale, GuardReason::Clock);
}

#[test]
fn frames_that_queued_up_on_the_way_are_stale_until_the_queue_is_empty() {
    let (mut guard, next_ns) = running(LIMITS);
    // The host was suspended for 1 s: 100 frames arrive within 10 ms and look fresh.
    let resumed_ns = next_ns + 1_000 * MS;
    for k in 0..100 {
        let frame_ns = resumed_ns + k * MS / 10;
        let device_ns = next_ns + k * PERIOD_NS;
        let report = guard.judge(&GuardFrame { device_ns: Some(device_ns), ..sound(frame_ns) });
        let lag_ns = frame_ns - device_ns;
        assert!(lag_ns <= LIMITS.stale_after_ns || report.verdict == GuardVerdict::Stale, "{k}: {report:?}");
    }
    // It is ok again after the hold time, when frames arrive on time.
    let caught_up = (0..5).map(|k| guard.judge(&sound(resumed_ns + (1 + k) * PERIOD_NS)).verdict);
    assert_eq!(caught_up.last(), Some(GuardVerdict::Ok));
}

#[test]
fn clocks_that_drift_apart_are_no_lag() {
    for ppm in [-5_000_i64, -50, 50, 5_000] {
        let mut meter = LagMeter::default();
        for k in 0..100_000_u64 {
            let host_ns = k * PERIOD_NS;
            let device_ns = host_ns.saturating_add_signed(host_ns as i64 / 1_000_000 * ppm);
            assert!(meter.lag_ns(device_ns, host_ns) < MS, "{ppm} ppm, frame {k}");
        }
    }
}

#[test]
fn an_image_that_is_repeated_is_stale_after_the_limit() {
    let (mut guard, mut time_ns) = running(LIMITS);
    let begun_ns = time_ns - PERIOD_NS;
    for _ in 0..10 {
        let report = guard.judge(&GuardFrame { is_seen: false, ..sound(time_ns) });
        let is_old = time_ns + MS - begun_ns > LIMITS.stale_after_ns;
        assert_eq!(report.reasons.contains(GuardReason::InDoubt), is_old, "{report:?}");
        time_ns += PERIOD_NS;
    }
}

#[test]
fn a_stop_lasts_for_the_hold_time_and_through_faults_that_follow() {
    let strong = [touch(Some(ForceReading::Valid { force_n: 9.0, sigma_n: 0.1 }))];
    let (mut guard, time_ns) = running(LIMITS);
    guard.judge(&GuardFrame { touches: &strong, ..sound(time_ns) });
    let after = |guard: &mut Guard, k: u64| guard.judge(&sound(time_ns + k * PERIOD_NS));
    let held = after(&mut guard, 1);
    assert_is(held, GuardVerdict::Stop, GuardReason::Held);
    assert!(held.reasons.contains(GuardReason::Force));
    let fault = GuardFrame { is_baseline_trusted: false, ..sound(time_ns + PERIOD_NS) };
    assert_is(guard.judge(&fault), GuardVerdict::Stop, GuardReason::BaselineUntrusted);
    assert_eq!(after(&mut guard, 2).verdict, GuardVerdict::Stop);
    assert_eq!(after(&mut guard, 3).verdict, GuardVerdict::Ok);
}

#[test]
fn a_report_ages() {
    let (mut guard, time_ns) = running(LIMITS);
    let report = guard.judge(&sound(time_ns));
    assert_eq!(report.at(time_ns + LIMITS.stale_after_ns).verdict, GuardVerdict::Ok);
    assert_is(report.at(time_ns + LIMITS.stale_after_ns + 1), GuardVerdict::Stale, GuardReason::NoFrames);
    assert_is(report.ended(), GuardVerdict::Stop, GuardReason::Ended);
    assert_eq!(GuardReport::before_frames(0, 1).verdict, GuardVerdict::Stale);
}

/// A frame drawn at random: what went wrong with it.
#[derive(Clone, Copy, Debug)]
struct Drawn {
    pause_ns: u64,
    wait_ns: u64,
    device_late_ns: Option<u64>,
    flags: [bool; 5],
    force: Option<f64>,
    left_out: usize,
    missing: usize,
}

fn drawn() -> impl Strategy<Value = Drawn> {
    let rare = || proptest::bool::weighted(0.1);
    (
        prop_oneof![8 => Just(PERIOD_NS), 1 => 0..200 * MS],
        prop_oneof![8 => 0..2 * MS, 1 => 0..100 * MS],
        proptest::option::of(prop_oneof![8 => Just(0), 1 => 0..200 * MS]),
        [rare(), rare(), rare(), rare(), rare()],
        proptest::option::weighted(0.2, prop_oneof![4 => 0.0..10.0, 1 => Just(f64::NAN)]),
        prop_oneof![9 => Just(0_usize), 1 => 1_usize..20],
        prop_oneof![9 => Just(0_usize), 1 => 1_usize..208],
    )
        .prop_map(|(pause_ns, wait_ns, device_late_ns, flags, force, left_out, missing)| Drawn {
            pause_ns,
            wait_ns,
            device_late_ns,
            flags,
            force,
            left_out,
            missing,
        })
}

proptest! {
    /// An independent statement of the contract: `ok` only if nothing is wrong now or was within the hold time.
    #[test]
    fn no_sequence_gives_a_false_ok(frames in proptest::collection::vec(drawn(), 1..200)) {
        let fault = |channel| ChannelFault { channel, kind: ChannelFaultKind::Stuck, since_ns: 0, since_sequence: 0 };
        let faults: Vec<ChannelFault> = (0..20).map(fault).collect();
        let mut guard = Guard::new(LIMITS);
        let (mut frame_ns, mut now_ns, mut wrong_ns) = (1_000 * MS, 0, None::<u64>);
        let mut seen_ns = None;
        for (number, drawn) in frames.into_iter().enumerate() {
            let [clock, no_baseline, untrusted, unseen, frame_fault] = drawn.flags;
            frame_ns += drawn.pause_ns;
            // Frames are judged one after another.
            now_ns = (frame_ns + drawn.wait_ns).max(now_ns);
            let touches: Vec<Touch> =
                drawn.force.map(|force_n| touch(Some(ForceReading::Valid { force_n, sigma_n: 0.1 }))).into_iter().collect();
            let kind = FrameFaultKind::Flipped;
            let fault = frame_fault.then_some(FrameFault { kind, since_ns: 0, since_sequence: 0 });
            let mut readings = [1e-3; 208];
            readings[..drawn.missing].fill(f64::NAN);
            let health = Health { frame: fault, channels: (&faults[..drawn.left_out]).into(), electrodes: (&[]).into() };
            let report = guard.judge(&GuardFrame {
                now_ns,
                frame_ns,
                device_ns: drawn.device_late_ns.map(|late_ns| frame_ns - late_ns),
                is_clock_odd: clock,
                has_baseline: !no_baseline,
                is_baseline_trusted: !untrusted,
                is_seen: !unseen,
                health,
                readings: &readings,
                touches: &touches,
                is_damaged: false,
            });
            if !unseen && !no_baseline {
                seen_ns = Some(frame_ns);
            }
            let is_wrong = clock || no_baseline || untrusted || frame_fault || drawn.left_out + drawn.missing > 0
                || now_ns - frame_ns > LIMITS.stale_after_ns
                || (number > 0 && drawn.pause_ns > LIMITS.stale_after_ns)
                || drawn.force.is_some_and(|force_n| force_n.is_nan() || force_n >= 5.0)
                || seen_ns.is_none_or(|seen_ns| now_ns - seen_ns > LIMITS.stale_after_ns);
            if is_wrong {
                wrong_ns = Some(now_ns);
            }
            let is_held = wrong_ns.is_some_and(|wrong_ns| now_ns < wrong_ns + LIMITS.hold_ns);
            if is_wrong || is_held {
                prop_assert_ne!(report.verdict, GuardVerdict::Ok, "frame {}: {:?}", number, report);
            }
            prop_assert_eq!(report.verdict == GuardVerdict::Ok, report.reasons.is_empty());
            // Whatever the verdict, it is not ok once the frame is too old.
            prop_assert_ne!(report.at(frame_ns + LIMITS.stale_after_ns + 1).verdict, GuardVerdict::Ok);
        }
    }
}
