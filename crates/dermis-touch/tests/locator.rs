//! The calibrated locator on a synthetic skin: a disc whose true signatures differ from the physics by channel gains
//! and by a distortion of position, poked at random, with noise.

use dermis_touch::locator::{
    Examples, Hyperparameters, Located, Locator, LocatorError, LocatorOptions, Selection, SignatureMap,
};

const RADIUS_M: f64 = 0.08;
const ELECTRODES: usize = 8;
/// Noise of a channel over the RMS of a frame of load 1.
const NOISE: f64 = 0.03;

/// Uniform numbers in [0, 1) from a linear congruential generator.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Standard normal, by Box and Muller.
    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    fn position(&mut self) -> [f64; 2] {
        let (r, angle) = (0.068 * self.uniform().sqrt(), std::f64::consts::TAU * self.uniform());
        [r * angle.cos(), r * angle.sin()]
    }
}

/// grad u_drive . grad u_measure of point electrodes on a disc, opposite drive, adjacent measurement.
fn physics(p: [f64; 2]) -> Vec<f64> {
    let pull = |k: usize| {
        let angle = std::f64::consts::TAU * (k % ELECTRODES) as f64 / ELECTRODES as f64;
        let d = [p[0] / RADIUS_M - angle.cos(), p[1] / RADIUS_M - angle.sin()];
        let square = d[0] * d[0] + d[1] * d[1];
        [d[0] / square, d[1] / square]
    };
    let difference = |a: usize, b: usize| {
        let (a, b) = (pull(a), pull(b));
        [a[0] - b[0], a[1] - b[1]]
    };
    let mut frame = Vec::new();
    for drive in 0..ELECTRODES {
        let driven = difference(drive, drive + ELECTRODES / 2);
        for plus in (1..ELECTRODES - 1).filter(|k| *k != ELECTRODES / 2 && *k + 1 != ELECTRODES / 2) {
            let measured = difference(drive + plus, drive + plus + 1);
            frame.push(driven[0] * measured[0] + driven[1] * measured[1]);
        }
    }
    frame
}

/// Measurements of the synthetic skin: gains between 0.6 and 1.4 and a squeezed, shifted position.
fn truth(p: [f64; 2], load: f64) -> Vec<f64> {
    let warped = [0.93 * p[0] + 0.004, 0.95 * p[1] - 0.003];
    let gain = |k: usize| 1.0 + 0.4 * (1.7 * k as f64).sin();
    physics(warped).iter().enumerate().map(|(k, v)| load * gain(k) * v).collect()
}

fn noisy(p: [f64; 2], load: f64, random: &mut Random) -> Vec<f64> {
    let mut frame = truth(p, load);
    frame.iter_mut().for_each(|v| *v += NOISE * random.normal());
    frame
}

fn map_positions() -> Vec<[f64; 2]> {
    let grid =
        (-19..=19).flat_map(|row| (-19..=19).map(move |column| [0.004 * f64::from(column), 0.004 * f64::from(row)]));
    grid.filter(|p| p[0].hypot(p[1]) <= 0.076).collect()
}

fn physics_map() -> SignatureMap {
    let positions = map_positions();
    let signatures: Vec<f64> = positions.iter().flat_map(|p| physics(*p)).collect();
    SignatureMap::new(channels(), positions, signatures).expect("a map")
}

fn channels() -> usize {
    physics([0.0, 0.0]).len()
}

struct Pokes {
    frames: Vec<Vec<f64>>,
    positions_m: Vec<[f64; 2]>,
    loads: Vec<f64>,
}

fn poke(count: usize, seed: u64) -> Pokes {
    let mut random = Random(seed);
    let positions_m: Vec<[f64; 2]> = (0..count).map(|_| random.position()).collect();
    let loads: Vec<f64> = (0..count).map(|_| 0.5 + random.uniform()).collect();
    let frames = positions_m.iter().zip(&loads).map(|(p, load)| noisy(*p, *load, &mut random)).collect();
    Pokes { frames, positions_m, loads }
}

impl Pokes {
    fn examples(&self) -> Examples {
        let examples = Examples::new(channels(), self.frames.concat(), self.positions_m.clone()).expect("examples");
        examples.with_loads(self.loads.clone()).expect("loads")
    }

    fn fit(&self) -> Locator {
        Locator::fit(&self.examples(), &physics_map(), &LocatorOptions::default()).expect("a locator")
    }
}

fn error_mm(found: &Located, at: [f64; 2]) -> f64 {
    1e3 * (found.x_m - at[0]).hypot(found.y_m - at[1])
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn median_error_mm(locator: &Locator, test: &Pokes) -> f64 {
    let located = test.frames.iter().zip(&test.positions_m);
    median(located.map(|(frame, at)| error_mm(&locator.predict(frame).expect("located"), *at)).collect())
}

#[test]
fn sigma_is_calibrated_and_the_load_is_found() {
    let (train, test) = (poke(120, 1), poke(400, 2));
    let locator = train.fit();
    let mut within = [0.0; 2];
    let mut load_errors = Vec::new();
    for ((frame, at), load) in test.frames.iter().zip(&test.positions_m).zip(&test.loads) {
        let found = locator.predict(frame).expect("located");
        within[0] += f64::from((found.x_m - at[0]).abs() <= found.sigma_x_m) / 400.0;
        within[1] += f64::from((found.y_m - at[1]).abs() <= found.sigma_y_m) / 400.0;
        load_errors.push((found.load.expect("loads were given").value / load - 1.0).abs());
    }
    // The binomial error of a share of 0.68 among 400 is 0.023; the factor itself is based on 120 examples (0.04).
    assert!(within.iter().all(|w| (0.56..=0.80).contains(w)), "one sigma covers {within:?}");
    let error = median_error_mm(&locator, &test);
    assert!(error < 3.0, "median error {error} mm on a map of 4 mm spacing");
    assert!(median(load_errors.clone()) < 0.06, "median load error {}", median(load_errors));
}

#[test]
fn the_report_predicts_the_error_on_new_pokes() {
    let locator = poke(120, 3).fit();
    let foretold = 1e3 * locator.leave_one_out().median_error_m;
    let seen = median_error_mm(&locator, &poke(400, 4));
    // Medians of 120 and 400 errors scatter by about 12 % together.
    assert!((foretold / seen - 1.0).abs() < 0.4, "foretold {foretold} mm, seen {seen} mm");
}

#[test]
fn physics_carries_few_pokes() {
    let test = poke(200, 5);
    let mut with = Vec::new();
    let mut without = Vec::new();
    for seed in 0..5 {
        let train = poke(8, 60 + seed);
        let blind = SignatureMap::without_physics(channels(), map_positions()).expect("a map");
        let blind = Locator::fit(&train.examples(), &blind, &LocatorOptions::default()).expect("a locator");
        with.push(median_error_mm(&train.fit(), &test));
        without.push(median_error_mm(&blind, &test));
    }
    let (with, without) = (median(with), median(without));
    assert!(with < 0.75 * without, "{with} mm with physics, {without} mm without");
}

#[test]
fn physics_of_the_opposite_sign_serves_as_well() {
    let (train, test) = (poke(30, 7), poke(100, 8));
    let positions = map_positions();
    let signatures: Vec<f64> = positions.iter().flat_map(|p| physics(*p)).map(|v| -3.0 * v).collect();
    let map = SignatureMap::new(channels(), positions, signatures).expect("a map");
    let locator = Locator::fit(&train.examples(), &map, &LocatorOptions::default()).expect("a locator");
    assert!(locator.leave_one_out().physics_cosine < -0.5);
    let (turned, straight) = (median_error_mm(&locator, &test), median_error_mm(&train.fit(), &test));
    assert!((turned - straight).abs() < 1e-3, "{turned} mm against {straight} mm: only rounding differs");
}

#[test]
fn missing_channels_cost_little() {
    let (train, mut test) = (poke(120, 9), poke(200, 10));
    let locator = train.fit();
    let complete = median_error_mm(&locator, &test);
    for frame in &mut test.frames {
        for k in [0, 5, 6, 17, 28] {
            frame[k] = f64::NAN;
        }
    }
    let missing = median_error_mm(&locator, &test);
    assert!(missing < 1.6 * complete, "{missing} mm with 5 of {} channels missing, {complete} mm complete", channels());
}

#[test]
fn examples_may_lack_channels() {
    let (mut train, test) = (poke(120, 11), poke(200, 12));
    let complete = median_error_mm(&train.fit(), &test);
    let mut random = Random(13);
    for frame in &mut train.frames {
        frame[3] = f64::NAN;
        frame.iter_mut().for_each(|v| *v = if random.uniform() < 0.05 { f64::NAN } else { *v });
    }
    let gaps = median_error_mm(&train.fit(), &test);
    assert!(gaps < 1.5 * complete, "{gaps} mm with gaps in the examples, {complete} mm without");
}

#[test]
fn scratch_forgets_channels_that_came_back() {
    let (train, test) = (poke(40, 14), poke(2, 15));
    let locator = train.fit();
    let mut scratch = locator.scratch();
    let fresh = locator.predict_into(&test.frames[0], &mut scratch).expect("located");
    let mut broken = test.frames[1].clone();
    broken[4] = f64::NAN;
    locator.predict_into(&broken, &mut scratch).expect("located");
    assert_eq!(locator.predict_into(&test.frames[0], &mut scratch).expect("located"), fresh);
    let other = poke(40, 16).fit();
    let expected = other.predict(&test.frames[0]).expect("located");
    assert_eq!(other.predict_into(&test.frames[0], &mut scratch).expect("located"), expected);
}

#[test]
fn locating_allocates_nothing() {
    let (train, test) = (poke(40, 17), poke(1, 18));
    let locator = train.fit();
    let mut scratch = locator.scratch();
    let mut broken = test.frames[0].clone();
    broken[2] = f64::NAN;
    for frame in [&test.frames[0], &broken] {
        locator.predict_into(frame, &mut scratch).expect("located");
        let counted = allocation_counter::measure(|| {
            locator.predict_into(frame, &mut scratch).expect("located");
        });
        assert_eq!(counted.count_total, 0);
    }
    let total: f64 = scratch.posterior().iter().sum();
    assert!((total - 1.0).abs() < 1e-12, "posterior sums to {total}");
}

#[test]
fn two_touches_are_novel() {
    let locator = poke(120, 19).fit();
    let mut random = Random(20);
    let single = median(
        (0..50)
            .map(|_| locator.predict(&noisy(random.position(), 1.0, &mut random)).expect("located").novelty)
            .collect(),
    );
    let double = |random: &mut Random| {
        let angle = std::f64::consts::TAU * random.uniform();
        let p = [0.045 * angle.cos(), 0.045 * angle.sin()];
        let both: Vec<f64> = noisy(p, 1.0, random).iter().zip(truth([-p[0], -p[1]], 1.0)).map(|(a, b)| a + b).collect();
        locator.predict(&both).expect("located").novelty
    };
    let double = median((0..50).map(|_| double(&mut random)).collect());
    assert!(single < 1.0 && double > 2.0, "novelty {single} of one touch, {double} of two");
}

#[test]
fn pokes_are_suggested_at_places_without_any() {
    let mut train = poke(120, 21);
    let left: Vec<usize> = (0..120).filter(|i| train.positions_m[*i][0] < -0.01).collect();
    train.frames = left.iter().map(|&i| train.frames[i].clone()).collect();
    train.positions_m = left.iter().map(|&i| train.positions_m[i]).collect();
    train.loads = left.iter().map(|&i| train.loads[i]).collect();
    let locator = train.fit();
    let suggested = locator.suggest_pokes(4).expect("suggestions");
    assert_eq!(suggested.len(), 4);
    assert!(suggested.iter().all(|s| s.position_m[0] > 0.0), "{suggested:?}");
    for (i, a) in suggested.iter().enumerate() {
        for b in &suggested[..i] {
            let apart = (a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]);
            assert!(apart > 0.01, "suggestions {apart} m apart");
        }
    }
    let expected = locator.expected_sigma_m();
    assert_eq!(expected.len(), locator.positions_m().len());
    assert!(expected.iter().all(|s| s.is_finite() && *s > 0.0));
}

#[test]
fn many_channels_are_projected() {
    let (train, test) = (poke(60, 22), poke(100, 23));
    let options = LocatorOptions { max_rank: 16, ..LocatorOptions::default() };
    let locator = Locator::fit(&train.examples(), &physics_map(), &options).expect("a locator");
    let (projected, full) = (median_error_mm(&locator, &test), median_error_mm(&train.fit(), &test));
    assert!(projected < 1.5 * full, "{projected} mm in 16 of {} directions, {full} mm in all", channels());
}

#[test]
fn a_stored_locator_gives_the_same_answers() {
    let (train, test) = (poke(30, 24), poke(5, 25));
    let locator = train.fit();
    let text = serde_json::to_string(&locator).expect("stored");
    let back: Locator = serde_json::from_str(&text).expect("read back");
    for frame in &test.frames {
        let (a, b) = (locator.predict(frame).expect("located"), back.predict(frame).expect("located"));
        // Decimal text may change the last bit of a stored number.
        assert!((a.x_m - b.x_m).abs() < 1e-9 && (a.sigma_y_m - b.sigma_y_m).abs() < 1e-9, "{a:?} against {b:?}");
    }
}

#[test]
fn a_damaged_store_is_refused() {
    let stored = serde_json::to_value(poke(20, 26).fit()).expect("stored");
    let damage: [(&str, serde_json::Value, &str); 5] = [
        ("version", 99.into(), "version 99"),
        ("rank", 3.into(), "transform: expected"),
        ("temperature", (-1.0).into(), "temperature"),
        ("variance", serde_json::json!([0.5]), "variance: expected"),
        ("surprise", 1.into(), "unknown field `surprise`"),
    ];
    for (field, value, expected) in damage {
        let mut damaged = stored.clone();
        damaged[field] = value;
        let message = serde_json::from_value::<Locator>(damaged).expect_err(field).to_string();
        assert!(message.contains(expected), "{field}: {message}");
    }
}

#[test]
fn wrong_input_is_named() {
    let c = channels();
    let at = vec![[0.0, 0.0]; 6];
    let few = Examples::new(c, vec![1.0; 4 * c], vec![[0.0, 0.0]; 4]);
    assert!(matches!(few, Err(LocatorError::Count { field: "examples", got: 4, .. })));
    let short = Examples::new(c, vec![1.0; 6 * c - 1], at.clone());
    assert!(matches!(short, Err(LocatorError::Length { field: "frames", .. })));
    let mut frames = vec![1.0; 6 * c];
    frames[c + 2] = f64::INFINITY;
    let infinite = Examples::new(c, frames, at.clone());
    assert!(matches!(infinite, Err(LocatorError::Value { field: "frames", index, .. }) if index == c + 2));
    let mut lost = at.clone();
    lost[3][1] = f64::NAN;
    let lost = Examples::new(c, vec![1.0; 6 * c], lost);
    assert!(matches!(lost, Err(LocatorError::Value { field: "positions_m", index: 3, .. })));
    let examples = Examples::new(c, vec![1.0; 6 * c], at.clone()).expect("examples");
    assert!(matches!(examples.clone().with_loads(vec![-1.0; 6]), Err(LocatorError::Value { field: "loads", .. })));
    assert!(examples.with_channel_noise(vec![0.0; c]).is_err());
    let zero = Examples::new(c, vec![0.0; 6 * c], at).expect("examples");
    let fitted = Locator::fit(&zero, &physics_map(), &LocatorOptions::default());
    assert!(matches!(fitted, Err(LocatorError::EmptyFrame { frame: 0 })));
}

#[test]
fn frames_and_options_are_checked() {
    let train = poke(20, 27);
    let locator = train.fit();
    assert!(matches!(locator.predict(&[1.0]), Err(LocatorError::Length { field: "frame", got: 1, .. })));
    assert!(matches!(locator.predict(&vec![0.0; channels()]), Err(LocatorError::EmptyFrame { .. })));
    assert!(matches!(locator.predict(&vec![f64::NAN; channels()]), Err(LocatorError::TooFewChannels { got: 0, .. })));
    let hyper = Hyperparameters { length_m: 0.03, noise: 0.04, shrinkage: 0.0 };
    let options = LocatorOptions { selection: Selection::Fixed(hyper), ..LocatorOptions::default() };
    let refused = Locator::fit(&train.examples(), &physics_map(), &options);
    assert!(matches!(refused, Err(LocatorError::Value { field: "shrinkage", .. })));
}
