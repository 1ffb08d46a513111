//! The fused locator on a synthetic skin: smooth signatures unknown to any model, noise, and a nuisance that changes
//! from touch to touch.

use dermis_touch::locator::{Examples, FusedLocator, FusedOptions, LocatorError, SessionDrift, SignatureMap};

const CHANNELS: usize = 24;

/// Numbers from 0 to 1, the same in every run.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.next()).sum::<f64>() - 6.0
    }
}

/// Reading of a touch of unit load in channel `k`.
fn signature(p: [f64; 2], k: usize) -> f64 {
    let angle = std::f64::consts::TAU * k as f64 / CHANNELS as f64;
    let electrode = [0.06 * angle.cos(), 0.06 * angle.sin()];
    let distance = (p[0] - electrode[0]).hypot(p[1] - electrode[1]);
    (-distance / 0.02).exp() * (1.0 + 0.3 * (40.0 * p[0] + k as f64).sin())
}

struct Pokes {
    frames: Vec<f64>,
    positions_m: Vec<[f64; 2]>,
    loads: Vec<f64>,
}

fn pokes(count: usize, seed: u64, gain: impl Fn(usize) -> f64) -> Pokes {
    let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ (seed + 1));
    let mut made = Pokes { frames: Vec::new(), positions_m: Vec::new(), loads: Vec::new() };
    for _ in 0..count {
        let p = [0, 1].map(|_| 0.08 * random.next() - 0.04);
        let load = 0.5 + random.next();
        made.frames.extend((0..CHANNELS).map(|k| load * gain(k) * signature(p, k) + 0.004 * random.normal()));
        made.positions_m.push(p);
        made.loads.push(load);
    }
    made
}

fn plain(_: usize) -> f64 {
    1.0
}

impl Pokes {
    fn examples(&self) -> Examples {
        Examples::new(CHANNELS, self.frames.clone(), self.positions_m.clone()).expect("valid pokes")
    }

    /// Median distance, and shares within one sigma, on these pokes.
    fn test(&self, locator: &FusedLocator) -> (f64, [f64; 2]) {
        let mut scratch = locator.scratch();
        let (mut errors, mut within) = (Vec::new(), [0.0; 2]);
        for (frame, p) in self.frames.chunks_exact(CHANNELS).zip(&self.positions_m) {
            let found = locator.predict_into(frame, &mut scratch).expect("a place");
            errors.push((found.x_m - p[0]).hypot(found.y_m - p[1]));
            within[0] += f64::from(u8::from((found.x_m - p[0]).abs() <= found.sigma_x_m));
            within[1] += f64::from(u8::from((found.y_m - p[1]).abs() <= found.sigma_y_m));
        }
        errors.sort_by(f64::total_cmp);
        (errors[errors.len() / 2], within.map(|w| w / errors.len() as f64))
    }
}

fn map() -> Vec<[f64; 2]> {
    (0..25 * 25)
        .map(|p| [0, 1].map(|axis| 0.004 * f64::from(if axis == 0 { p % 25 } else { p / 25 }) - 0.048))
        .collect()
}

fn no_physics() -> SignatureMap {
    SignatureMap::without_physics(CHANNELS, map()).expect("a map")
}

fn fit(examples: &Examples) -> FusedLocator {
    FusedLocator::fit(examples, &no_physics(), &FusedOptions::default()).expect("a locator")
}

#[test]
fn more_pokes_reduce_the_error_and_sigma_stays_calibrated() {
    let held_out = pokes(300, 99, plain);
    let mut before = f64::INFINITY;
    for count in [20, 80, 320] {
        let locator = fit(&pokes(count, 1, plain).examples());
        let (error, within) = held_out.test(&locator);
        assert!(error < before, "{count} pokes: {error} m after {before} m");
        for share in within {
            assert!((0.55..=0.85).contains(&share), "{count} pokes: {share} within one sigma");
        }
        before = error;
    }
    assert!(before < 0.8e-3, "{before} m");
}

#[test]
fn both_experts_together_are_no_worse_than_either_alone() {
    let report = fit(&pokes(200, 2, plain).examples()).report().clone();
    let best = report.forward.median_m.min(report.inverse.median_m);
    assert!(report.fused.median_m <= 1.1 * best, "{report:?}");
}

#[test]
fn physics_is_used_only_if_it_helps() {
    let made = pokes(30, 3, plain);
    let right: Vec<f64> = map().iter().flat_map(|p| (0..CHANNELS).map(|k| signature(*p, k))).collect();
    let mut random = Random(77);
    let wrong: Vec<f64> = right.iter().map(|_| random.normal()).collect();
    for (signatures, helps) in [(right, true), (wrong, false)] {
        let physics = SignatureMap::new(CHANNELS, map(), signatures).expect("a map");
        let locator = FusedLocator::fit(&made.examples(), &physics, &FusedOptions::default()).expect("a locator");
        let physics = locator.report().physics.expect("physics was given");
        assert_eq!(physics.used, helps, "gain {}", physics.gain);
    }
    assert_eq!(fit(&made.examples()).report().physics, None);
}

#[test]
fn ten_pokes_and_a_sister_are_worth_more_than_ten_pokes() {
    let sister = fit(&pokes(400, 4, |k| 1.0 + 0.2 * (k as f64).sin()).examples());
    let (few, held_out) = (pokes(10, 5, plain), pokes(300, 98, plain));
    let (alone, _) = held_out.test(&fit(&few.examples()));
    let options = FusedOptions::default();
    let helped = FusedLocator::fit_with_prior(&few.examples(), &no_physics(), &options, &sister).expect("a locator");
    let (with_sister, _) = held_out.test(&helped);
    let lent = helped.report().sister_map.expect("a sister");
    assert!(lent.used, "gain {}", lent.gain);
    assert!(with_sister < alone, "{with_sister} m with a sister, {alone} m without");
}

#[test]
fn loads_are_estimated_with_their_sigma() {
    let made = pokes(150, 6, plain);
    let examples = made.examples().with_loads(made.loads.clone()).expect("loads");
    let (locator, held_out) = (fit(&examples), pokes(300, 97, plain));
    let mut within = 0;
    for (frame, load) in held_out.frames.chunks_exact(CHANNELS).zip(&held_out.loads) {
        let found = locator.predict(frame).expect("a place").load.expect("a load");
        within += usize::from((found.value - load).abs() <= found.sigma);
    }
    assert!((150..=270).contains(&within), "{within} of 300 within one sigma");
}

#[test]
fn many_pokes_are_fitted_by_landmarks() {
    let options = FusedOptions { exact_examples: 200, landmarks: 150, ..FusedOptions::default() };
    let (made, held_out) = (pokes(600, 7, plain), pokes(300, 96, plain));
    let sparse = FusedLocator::fit(&made.examples(), &no_physics(), &options).expect("a locator");
    let (error, within) = held_out.test(&sparse);
    assert!(error < 0.8e-3, "{error} m");
    for share in within {
        assert!((0.55..=0.85).contains(&share), "{share} within one sigma");
    }
}

/// One poke more than can be solved exactly must not make positions worse or sigma wrong. The median of 300 errors
/// scatters by about 6 %, hence the tolerance.
#[test]
fn slightly_more_pokes_than_are_solved_exactly_do_no_harm() {
    let held_out = pokes(300, 95, plain);
    let exact = FusedOptions { exact_examples: 400, landmarks: 400, ..FusedOptions::default() };
    let fit = |count: usize, options: &FusedOptions| {
        FusedLocator::fit(&pokes(count, 8, plain).examples(), &no_physics(), options).expect("a locator")
    };
    let (before, _) = held_out.test(&fit(400, &exact));
    for count in [401, 480, 800] {
        let (error, within) = held_out.test(&fit(count, &exact));
        assert!(error < 1.1 * before, "{count} pokes: {error} m after {before} m");
        for share in within {
            assert!((0.58..=0.8).contains(&share), "{count} pokes: {share} within one sigma");
        }
    }
}

#[test]
fn stored_data_are_read_back_unchanged() {
    let locator = fit(&pokes(40, 8, plain).examples());
    let text = serde_json::to_string(&locator).expect("JSON");
    let back: FusedLocator = serde_json::from_str(&text).expect("a locator");
    let frame = &pokes(1, 95, plain).frames;
    let (before, after) = (locator.predict(frame).expect("a place"), back.predict(frame).expect("a place"));
    assert!((before.x_m - after.x_m).abs() < 1e-9 && (before.sigma_y_m - after.sigma_y_m).abs() < 1e-9);
    let broken = text.replacen("\"version\":1", "\"version\":9", 1);
    assert!(serde_json::from_str::<FusedLocator>(&broken).is_err());
}

#[test]
fn dead_constant_and_missing_channels_are_tolerated() {
    let mut made = pokes(120, 9, plain);
    for (i, frame) in made.frames.chunks_exact_mut(CHANNELS).enumerate() {
        frame[3] = 0.0;
        frame[5] = f64::NAN;
        if i % 7 == 0 {
            frame[8] = f64::NAN;
        }
    }
    let locator = fit(&made.examples());
    let mut held_out = pokes(200, 94, plain);
    for (i, frame) in held_out.frames.chunks_exact_mut(CHANNELS).enumerate() {
        frame[3] = 0.0;
        if i % 2 == 0 {
            frame[10] = f64::INFINITY;
        }
    }
    let (error, within) = held_out.test(&locator);
    assert!(error < 2.5e-3, "{error} m");
    assert!(within.iter().all(|w| *w > 0.5), "{within:?}");
}

#[test]
fn contradictory_pokes_are_found_and_duplicates_tolerated() {
    let mut made = pokes(100, 10, plain);
    for i in 0..10 {
        made.positions_m.push(made.positions_m[i]);
        let frame = made.frames[i * CHANNELS..(i + 1) * CHANNELS].to_vec();
        made.frames.extend(frame);
    }
    made.positions_m[40] = made.positions_m[40].map(|v| -v);
    let locator = fit(&made.examples());
    let report = locator.report();
    assert!(report.doubtful.contains(&40) && report.doubtful.len() <= 3, "{:?}", report.doubtful);
    assert!(report.doubtful_left_out);
}

#[test]
fn errors_state_the_cause() {
    let made = pokes(4, 11, plain);
    let few = Examples::new(CHANNELS, made.frames, made.positions_m).expect_err("four pokes are too few");
    assert!(few.to_string().contains("at least 5"), "{few}");
    let made = pokes(10, 11, plain);
    let mut flat = made.frames.clone();
    flat[CHANNELS..2 * CHANNELS].fill(0.0);
    let flat = Examples::new(CHANNELS, flat, made.positions_m.clone()).expect("finite");
    let refused = FusedLocator::fit(&flat, &no_physics(), &FusedOptions::default());
    assert_eq!(refused.expect_err("a frame of zeros"), LocatorError::EmptyFrame { frame: 1 });
    let alike = Examples::new(CHANNELS, made.frames[..CHANNELS].repeat(10), made.positions_m.clone()).expect("finite");
    let refused = FusedLocator::fit(&alike, &no_physics(), &FusedOptions::default());
    assert!(matches!(refused, Err(LocatorError::Singular { .. })), "{refused:?}");
    let locator = fit(&made.examples());
    assert!(locator.predict(&[0.0; CHANNELS]).is_err());
    assert!(locator.predict(&[f64::NAN; CHANNELS]).is_err());
    assert!(locator.predict(&[1.0; 3]).is_err());
}

#[test]
fn drift_is_distinguished_from_its_absence() {
    let made = pokes(200, 12, plain);
    let steady = SessionDrift::measure(&made.examples()).expect("a statistic");
    assert!(steady.z.abs() < 3.0, "{steady:?}");
    let mut drifting = pokes(200, 12, plain);
    for (i, frame) in drifting.frames.chunks_exact_mut(CHANNELS).enumerate() {
        frame.iter_mut().enumerate().for_each(|(k, v)| *v += 0.15 * i as f64 / 200.0 * (k as f64).cos());
    }
    let drifts = SessionDrift::measure(&drifting.examples()).expect("a statistic");
    assert!(drifts.z > 3.0 && drifts.ratio > 1.2, "{drifts:?}");
}

/// With many channels and few pokes, directions made for the pokes must not mistake the noise of another frame for a
/// position.
#[test]
fn few_pokes_of_many_noisy_channels_predict_the_error_on_others() {
    const MANY: usize = 600;
    const NOISE: f64 = 0.05;
    let made = |count: usize, seed: u64| -> (Vec<f64>, Vec<[f64; 2]>) {
        let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ (seed + 1));
        let (mut frames, mut places) = (Vec::new(), Vec::new());
        for _ in 0..count {
            let p = [0, 1].map(|_| 0.08 * random.next() - 0.04);
            frames.extend((0..MANY).map(|k| signature(p, k) + NOISE * random.normal()));
            places.push(p);
        }
        (frames, places)
    };
    // The physics knows the signatures except for a tenth.
    let known =
        map().into_iter().flat_map(|p| (0..MANY).map(move |k| signature(p, k) * (1.0 + 0.1 * (k as f64).sin())));
    let physics = SignatureMap::new(MANY, map(), known.collect()).expect("a map");
    let (frames, places) = made(40, 1);
    let examples = Examples::new(MANY, frames, places).expect("valid pokes");
    let examples = examples.with_channel_noise(vec![NOISE; MANY]).expect("noise of every channel");
    let locator = FusedLocator::fit(&examples, &physics, &FusedOptions::default()).expect("a locator");
    let mut scratch = locator.scratch();
    let (others, at) = made(200, 2);
    let mut errors: Vec<f64> = Vec::new();
    for (frame, p) in others.chunks_exact(MANY).zip(&at) {
        let found = locator.predict_into(frame, &mut scratch).expect("a place");
        errors.push((found.x_m - p[0]).hypot(found.y_m - p[1]));
    }
    errors.sort_by(f64::total_cmp);
    let (median_m, told_m) = (errors[errors.len() / 2], locator.report().fused.median_m);
    assert!(median_m < 2.0 * told_m && median_m < 2e-3, "{median_m} m, where {told_m} m were told");
    let tenth_m = errors[errors.len() * 9 / 10];
    assert!(tenth_m < 5e-3, "every tenth press is off by {tenth_m} m");
}

/// A skin whose electrodes are around the rim and that looks the same from each: number of drives, and of channels
/// measured per drive.
const DRIVES: usize = 12;
const KINDS: usize = 6;

/// A skin with its electrodes numbered in either direction and an individual appearance.
struct Ring {
    sense: f64,
    look: f64,
}

impl Ring {
    /// Reading of a touch, drive by drive: a channel of the same kind is at the same distance from its drive.
    fn frame(&self, p: [f64; 2]) -> Vec<f64> {
        let value = |k: usize| {
            let (drive, kind) = ((k / KINDS) as f64, (k % KINDS) as f64);
            let angle = self.sense * std::f64::consts::TAU * drive / DRIVES as f64;
            let x = angle.cos() * p[0] + angle.sin() * p[1];
            let y = angle.cos() * p[1] - angle.sin() * p[0];
            let centre = [0.03 * (self.look + 1.1 * kind).cos(), 0.03 * (self.look + 1.7 * kind).sin()];
            let distance2 = (x - centre[0]).powi(2) + (y - self.sense * centre[1]).powi(2);
            let own = 1.0 + 0.2 * (3.0 * drive + kind + self.look).sin();
            own * ((-distance2 / 0.0004).exp() - 0.3 * (x / 0.04))
        };
        (0..DRIVES * KINDS).map(value).collect()
    }

    fn pokes(&self, count: usize, seed: u64) -> (Vec<Vec<f64>>, Vec<[f64; 2]>) {
        let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ (seed + 1));
        let places: Vec<[f64; 2]> = (0..count).map(|_| [0, 1].map(|_| 0.08 * random.next() - 0.04)).collect();
        let noisy = |p: &[f64; 2], random: &mut Random| {
            self.frame(*p).into_iter().map(|v| v + 0.02 * random.normal()).collect::<Vec<f64>>()
        };
        (places.iter().map(|p| noisy(p, &mut random)).collect(), places)
    }
}

/// The sister's map is useless, because it looks different and is numbered in the opposite direction. But it shows
/// that the skin looks the same from each of its electrodes, which makes ten pokes worth many more.
#[test]
fn ten_pokes_are_turned_as_a_sister_shows() {
    let channels = DRIVES * KINDS;
    let examples = |(frames, places): (Vec<Vec<f64>>, Vec<[f64; 2]>)| {
        Examples::new(channels, frames.concat(), places).expect("valid pokes")
    };
    let (skin, other) = (Ring { sense: -1.0, look: 2.0 }, Ring { sense: 1.0, look: 0.0 });
    let map = SignatureMap::without_physics(channels, map()).expect("a map");
    let options = FusedOptions::default();
    let sister = FusedLocator::fit(&examples(other.pokes(400, 6)), &map, &options).expect("a locator");
    let few = examples(skin.pokes(10, 7));
    let alone = FusedLocator::fit(&few, &map, &options).expect("a locator");
    let helped = FusedLocator::fit_with_prior(&few, &map, &options, &sister).expect("a locator");
    let turned = helped.report().sister_turn.expect("a sister that looks the same from each electrode");
    assert!(turned.used, "{turned:?}");
    assert!(alone.report().sister_turn.is_none());
    let (frames, places) = skin.pokes(300, 97);
    let error = |locator: &FusedLocator| {
        let mut errors: Vec<f64> = frames
            .iter()
            .zip(&places)
            .map(|(frame, p)| locator.predict(frame).map(|found| (found.x_m - p[0]).hypot(found.y_m - p[1])))
            .collect::<Result<_, _>>()
            .expect("places");
        errors.sort_by(f64::total_cmp);
        errors[errors.len() / 2]
    };
    let (before, after) = (error(&alone), error(&helped));
    assert!(after < 0.7 * before, "{after} m with a sister, {before} m without");
}
