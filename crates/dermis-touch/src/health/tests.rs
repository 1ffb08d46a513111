//! Tests on a synthetic instrument with eight electrodes: adjacent drives, adjacent readings, reciprocal by
//! construction.

use super::*;

const ELECTRODES: u32 = 8;
const SIGMA: f64 = 1e-3;

/// Drive and measuring pair of every channel: pairs without a common electrode.
fn pairs() -> Vec<[u32; 2]> {
    let apart = |a: u32, b: u32| (a + ELECTRODES - b) % ELECTRODES;
    let all = (0..ELECTRODES).flat_map(|drive| (0..ELECTRODES).map(move |read| [drive, read]));
    all.filter(|[drive, read]| (2..=6).contains(&apart(*drive, *read))).collect()
}

fn wiring() -> Wiring {
    let pair = |k: u32| vec![k, (k + 1) % ELECTRODES];
    let all: Vec<Vec<u32>> = (0..ELECTRODES).map(pair).collect();
    let channels = pairs();
    let partner = |c: &[u32; 2]| channels.iter().position(|other| *other == [c[1], c[0]]).map(|k| (k as u32, 1.0));
    let partners = channels.iter().map(partner).collect();
    Wiring::new(ELECTRODES as usize, all.clone(), all, channels, partners).unwrap()
}

/// Resting value of a channel, unchanged when drive and reading are swapped.
fn rest(channel: [u32; 2]) -> f64 {
    let [low, high] = [channel[0].min(channel[1]), channel[0].max(channel[1])];
    1.0 + 0.1 * f64::from(low) + 0.01 * f64::from(high)
}

/// Standard normal numbers from a fixed sequence.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

struct Bench {
    monitor: HealthMonitor,
    channels: Vec<[u32; 2]>,
    noise: Noise,
    frame: u64,
    /// Reference of the differences. Channels acquitted are set to their reading at that time.
    baseline: Vec<f64>,
    is_touched: bool,
    /// Presses explain all frames.
    is_explained: bool,
}

impl Bench {
    /// A bench with a baseline.
    fn new() -> Self {
        let channels = pairs();
        let mut monitor = HealthMonitor::new(wiring(), HealthParams::default());
        let rest: Vec<f64> = channels.iter().map(|c| rest(*c)).collect();
        let deviation = vec![SIGMA; rest.len()];
        let (readings, readings_deviation) = (&rest[..], &deviation[..]);
        let reference =
            HealthReference { rest: &rest, deviation: &deviation, readings, readings_deviation, unexplained: None };
        monitor.begin(&reference).unwrap();
        let (is_touched, is_explained) = (false, false);
        Self { monitor, channels, noise: Noise(7), frame: 0, baseline: rest, is_touched, is_explained }
    }

    /// Runs a frame whose readings `change` may alter, given channel, reading and a random number.
    fn step(&mut self, change: impl Fn([u32; 2], f64, f64) -> f64) {
        let readings: Vec<f64> = (0..self.channels.len())
            .map(|k| {
                let (normal, uniform) = (self.noise.normal(), 2.0 * self.noise.uniform() - 1.0);
                change(self.channels[k], rest(self.channels[k]) + SIGMA * normal, uniform)
            })
            .collect();
        let difference: Vec<f64> = readings.iter().zip(&self.baseline).map(|(v, b)| v - b).collect();
        self.monitor.read(&readings).unwrap();
        let at = (self.frame * 10, self.frame);
        let frame = JudgedFrame { at, difference: &difference, unexplained: None, is_touched: self.is_touched };
        self.monitor.judge(&frame, || self.is_explained).unwrap();
        for &channel in self.monitor.recovered() {
            self.baseline[channel as usize] = readings[channel as usize];
        }
        self.frame += 1;
    }

    fn sound(&mut self, frames: usize) {
        (0..frames).for_each(|_| self.step(|_, v, _| v));
    }

    /// Frames until `known` is true, at most the ten of the window.
    fn until(&mut self, change: impl Fn([u32; 2], f64, f64) -> f64, known: impl Fn(Health<'_>) -> bool) -> usize {
        for frames in 1..=HEALTH_WINDOW {
            self.step(&change);
            if known(self.monitor.health()) {
                return frames;
            }
        }
        panic!("not known after {HEALTH_WINDOW} frames: {:?}", self.monitor.health());
    }

    fn index(&self, channel: [u32; 2]) -> u32 {
        self.channels.iter().position(|c| *c == channel).unwrap() as u32
    }
}

/// An open electrode as the twins simulate it: readings float, drives carry no current.
fn open(lost: u32) -> impl Fn([u32; 2], f64, f64) -> f64 {
    let uses = move |pair: u32| pair == lost || (pair + 1) % ELECTRODES == lost;
    move |[drive, read], value, uniform| {
        if uses(read) {
            3.0 * uniform
        } else if uses(drive) {
            value - rest([drive, read])
        } else {
            value
        }
    }
}

fn lost(health: Health<'_>) -> Vec<u32> {
    let lost = |fault: &&ElectrodeFault| fault.kind == ElectrodeFaultKind::Lost;
    health.electrodes.iter().filter(lost).map(|fault| fault.electrode).collect()
}

#[test]
fn noise_and_touches_of_any_size_are_no_faults() {
    let mut bench = Bench::new();
    for frame in 0..4000 {
        // Reciprocal changes of up to half of the resting value, arriving within one frame.
        let size = if frame / 13 % 2 == 0 { 0.0 } else { 0.5 * f64::from(frame % 7) / 6.0 };
        bench.step(|c, v, _| v - size * rest(c) * f64::from((c[0] + c[1]) % 3));
        assert!(bench.monitor.health().is_sound(), "{frame}: {:?}", bench.monitor.health());
    }
}

#[test]
fn reciprocal_channels_read_at_different_moments_of_a_press_are_no_faults() {
    let mut bench = Bench::new();
    for frame in 0..600 {
        // Three taps in sixteen frames; each channel samples its own moment of the frame.
        let size = |c: [u32; 2]| {
            let moment = f64::from(frame) + f64::from(c[0] * 8 + c[1]) / 64.0;
            0.3 * (1.0 - (std::f64::consts::TAU * moment * 3.0 / 16.0).cos())
        };
        bench.step(|c, v, _| v - size(c) * rest(c));
        assert!(bench.monitor.health().is_sound(), "{frame}: {:?}", bench.monitor.health());
    }
}

#[test]
fn a_noisy_channel_is_distinguished_from_its_partner_within_ten_frames() {
    let mut bench = Bench::new();
    bench.sound(50);
    let noisy = [2, 5];
    let change = |c, v, uniform| if c == noisy { v + 30.0 * SIGMA * uniform } else { v };
    bench.until(change, |health| !health.is_sound());
    let fault = bench.monitor.health().channels[0];
    assert_eq!((fault.channel, fault.kind), (bench.index(noisy), ChannelFaultKind::Noisy));
    assert!(fault.since_sequence >= 50 && bench.monitor.health().channels.len() == 1);
}

#[test]
fn open_electrodes_are_blamed_but_not_the_good_one_between_them() {
    let mut bench = Bench::new();
    bench.sound(50);
    bench.until(open(3), |health| lost(health) == [3]);
    let wiring = wiring();
    let listed: Vec<u32> = bench.monitor.health().channels.iter().map(|fault| fault.channel).collect();
    assert_eq!(listed, wiring.channels_of(3));
    assert!(bench.monitor.health().channels.iter().all(|fault| fault.kind == ChannelFaultKind::Electrode));
    let (three, five) = (open(3), open(5));
    let both = |c, v, uniform| {
        let first = three(c, v, uniform);
        if first == v { five(c, v, uniform) } else { first }
    };
    bench.until(both, |health| lost(health) == [3, 5]);
    (0..30).for_each(|_| bench.step(both));
    assert_eq!(lost(bench.monitor.health()), [3, 5]);
}

#[test]
fn a_short_is_recognised_by_driving_and_reading_across_it() {
    let mut bench = Bench::new();
    bench.sound(50);
    let across = |c: [u32; 2], v: f64, _| if c.contains(&6) { v - rest(c) } else { v };
    bench.until(across, |health| health.electrodes.len() == 2);
    let faults: Vec<_> = bench.monitor.health().electrodes.iter().map(|f| (f.electrode, f.kind)).collect();
    let shorted = |with| ElectrodeFaultKind::Shorted { with };
    assert_eq!(faults, [(6, shorted(7)), (7, shorted(6))]);
}

#[test]
fn a_press_that_shorts_two_electrodes_is_no_fault() {
    let vanishes = |[drive, read]: [u32; 2], v: f64, _: f64| if drive == 2 || read == 2 { 0.01 * v } else { v };
    let mut bench = Bench::new();
    bench.is_explained = true;
    for _ in 0..30 {
        bench.step(vanishes);
        assert!(bench.monitor.health().channels.is_empty() && !bench.monitor.is_doubtful());
    }
    // The same without a press that explains it is one.
    bench.is_explained = false;
    (0..HEALTH_WINDOW).for_each(|_| bench.step(vanishes));
    assert!(!bench.monitor.health().channels.is_empty());
}

#[test]
fn channels_at_a_new_level_are_acquitted_only_at_rest() {
    let moved = |c: [u32; 2], v: f64, _: f64| if c == [0, 3] { 1.2 * v } else { v };
    let mut bench = Bench::new();
    bench.until(moved, |health| !health.is_sound());
    bench.is_touched = true;
    (0..150).for_each(|_| bench.step(moved));
    assert!(!bench.monitor.health().is_sound());
    // Back at its old level, it is, and at the new one as soon as nothing touches the skin.
    let held = bench.monitor.clone();
    (0..100).for_each(|_| bench.step(|_, v, _| v));
    assert!(bench.monitor.health().is_sound());
    bench.monitor = held;
    bench.is_touched = false;
    bench.step(moved);
    assert!(bench.monitor.health().is_sound());
}

#[test]
fn a_frozen_channel_is_stuck_but_a_frozen_frame_is_no_channel_fault() {
    let mut bench = Bench::new();
    bench.sound(200);
    let last = std::cell::RefCell::new(vec![f64::NAN; 40]);
    let all = bench.channels.clone();
    let freeze = |c: [u32; 2], v: f64, _: f64| {
        let slot = &mut last.borrow_mut()[all.iter().position(|other| *other == c).unwrap()];
        if slot.is_nan() {
            *slot = v;
        }
        *slot
    };
    // The first frame is repeated from the second on.
    (0..5).for_each(|_| bench.step(freeze));
    let fault = bench.monitor.health().frame.unwrap();
    assert_eq!((fault.kind, fault.since_sequence), (FrameFaultKind::Frozen, 204));
    (0..50).for_each(|_| bench.step(freeze));
    assert!(bench.monitor.health().channels.is_empty(), "{:?}", bench.monitor.health());
    let value = rest([1, 4]);
    bench.sound(2);
    assert!(bench.monitor.health().frame.is_some(), "two frames are not believed yet");
    bench.sound(1);
    assert!(bench.monitor.health().is_sound(), "{:?}", bench.monitor.health());
    bench.until(|c, v, _| if c == [1, 4] { value } else { v }, |health| !health.is_sound());
    let fault = bench.monitor.health().channels[0];
    assert_eq!((fault.channel, fault.kind), (bench.index([1, 4]), ChannelFaultKind::Stuck));
}

/// The verdict on whole frames, which must come within five frames.
fn verdict(bench: &mut Bench, change: impl Fn([u32; 2], f64, f64) -> f64) -> FrameFaultKind {
    for _ in 0..5 {
        bench.step(&change);
        assert!(bench.monitor.is_frame_suspect());
        if let Some(fault) = bench.monitor.health().frame {
            return fault.kind;
        }
    }
    panic!("not known after five frames: {:?}", bench.monitor.health());
}

/// Alters a reading, given its channel, its value and a uniform random number.
type Spoil<'a> = &'a dyn Fn([u32; 2], f64, f64) -> f64;

#[test]
fn frame_faults_are_recognised_within_five_frames_and_blame_no_channel() {
    let sign = |uniform: f64| if uniform < 0.0 { -1.0 } else { 1.0 };
    let mut bench = Bench::new();
    bench.sound(50);
    for round in 0..20 {
        let gain = 10_f64.powi(2 + round % 11);
        let cases: [(FrameFaultKind, Spoil); 7] = [
            (FrameFaultKind::Saturated, &|_, _, uniform| 10.0 * sign(uniform)),
            (FrameFaultKind::Saturated, &|_, _, uniform| -2.5 + 1e-4 * uniform),
            (FrameFaultKind::Flipped, &|_, v, _| -v),
            (FrameFaultKind::Flipped, &|c, v, _| 0.4 * rest(c) * f64::from((c[0] + c[1]) % 2) - v),
            (FrameFaultKind::OutOfRange, &|_, v, _| 2.0 * gain * v),
            (FrameFaultKind::Blank, &|_, v, _| v / gain),
            (FrameFaultKind::Blank, &|c, v, _| v - rest(c)),
        ];
        for (kind, change) in cases {
            assert_eq!(verdict(&mut bench, change), kind);
            bench.sound(3);
            assert!(bench.monitor.health().is_sound(), "{kind:?}: {:?}", bench.monitor.health());
        }
    }
}

#[test]
fn one_odd_frame_is_suspect_and_no_verdict() {
    let mut bench = Bench::new();
    bench.sound(50);
    for _ in 0..20 {
        bench.step(|_, v, _| -v);
        assert!(bench.monitor.is_frame_suspect() && bench.monitor.health().is_sound());
        bench.sound(1);
        assert!(!bench.monitor.is_frame_suspect() && bench.monitor.health().is_sound());
    }
}

#[test]
fn instruments_that_repeat_frames_or_have_no_noise_are_not_frozen() {
    // Every frame comes three times.
    let channels = pairs();
    let resting: Vec<f64> = channels.iter().map(|c| rest(*c)).collect();
    let deviation = vec![SIGMA; resting.len()];
    let reference = HealthReference {
        rest: &resting,
        deviation: &deviation,
        readings: &resting,
        readings_deviation: &deviation,
        unexplained: None,
    };
    for (repeated, noise_of) in [(3, SIGMA), (1, 0.0)] {
        let mut monitor = HealthMonitor::new(wiring(), HealthParams::default());
        let mut noise = Noise(11);
        for frame in 0..300_u64 {
            if frame == 10 {
                monitor.begin(&reference).unwrap();
            }
            let readings: Vec<f64> = resting.iter().map(|v| v + noise_of * noise.normal()).collect();
            let difference: Vec<f64> = readings.iter().zip(&resting).map(|(v, b)| v - b).collect();
            for _ in 0..repeated {
                monitor.read(&readings).unwrap();
                let at = (frame, frame);
                let judged = JudgedFrame { at, difference: &difference, unexplained: None, is_touched: false };
                monitor.judge(&judged, || false).unwrap();
                assert!(monitor.health().frame.is_none(), "{repeated}: {frame}: {:?}", monitor.health());
            }
        }
    }
}

#[test]
fn missing_and_saturated_channels_are_known_at_once_and_taken_back_when_good_for_long() {
    let mut bench = Bench::new();
    bench.monitor.params.full_scale = Some(5.0);
    bench.sound(50);
    let broken = |c: [u32; 2], v: f64, _| match c {
        [0, 3] => f64::NAN,
        [4, 7] => -5.0,
        _ => v,
    };
    assert!(bench.until(broken, |health| health.channels.len() == 2) <= 4);
    let kinds: Vec<_> = bench.monitor.health().channels.iter().map(|fault| fault.kind).collect();
    assert_eq!(kinds, [ChannelFaultKind::Missing, ChannelFaultKind::Saturated]);
    bench.sound(49);
    assert_eq!(bench.monitor.health().channels.len(), 2);
    bench.sound(2);
    assert!(bench.monitor.health().is_sound(), "{:?}", bench.monitor.health());
}

#[test]
fn a_channel_that_settles_at_a_new_level_is_readmitted() {
    let mut bench = Bench::new();
    bench.sound(50);
    let moved = |c: [u32; 2], v: f64, _| if c == [0, 3] { 1.2 * v } else { v };
    bench.until(moved, |health| !health.is_sound());
    (0..150).for_each(|_| bench.step(moved));
    assert!(bench.monitor.health().is_sound(), "{:?}", bench.monitor.health());
}

#[test]
fn initial_faults_are_found_in_the_baseline() {
    let channels = pairs();
    let mut monitor = HealthMonitor::new(wiring(), HealthParams::default());
    let mut noise = Noise(3);
    let fault = open(2);
    let frames: Vec<Vec<f64>> = (0..32)
        .map(|_| {
            let reading = |c: &[u32; 2]| {
                let (normal, uniform) = (noise.normal(), 2.0 * noise.uniform() - 1.0);
                // The instrument's gain is seven times the model's.
                7.0 * fault(*c, rest(*c) + SIGMA * normal, uniform)
            };
            channels.iter().map(reading).collect::<Vec<f64>>()
        })
        .collect();
    frames.iter().for_each(|frame| monitor.read(frame).unwrap());
    let mean = |c: usize| frames.iter().map(|f| f[c]).sum::<f64>() / 32.0;
    let deviation = |c: usize| (frames.iter().map(|f| (f[c] - mean(c)).powi(2)).sum::<f64>() / 32.0).sqrt();
    let (baseline, sigma): (Vec<f64>, Vec<f64>) = (0..channels.len()).map(|c| (mean(c), deviation(c))).unzip();
    let expected: Vec<f64> = channels.iter().map(|c| rest(*c)).collect();
    monitor.check_start((0, 31), &baseline, &sigma, &expected).unwrap();
    assert_eq!(lost(monitor.health()), [2], "{:?}", monitor.health());
    assert_eq!(monitor.health().channels.len(), wiring().channels_of(2).len());
}

#[test]
fn frames_of_another_length_are_refused() {
    let mut monitor = HealthMonitor::new(wiring(), HealthParams::default());
    assert!(monitor.read(&[0.0]).is_err());
    let frame = JudgedFrame { at: (0, 0), difference: &[0.0], unexplained: None, is_touched: false };
    assert!(monitor.judge(&frame, || false).is_err());
    assert!(Wiring::new(2, vec![vec![0, 2]], vec![], vec![], vec![]).is_err());
}
