//! Examples of an earlier session count as much as the skin still resembles the earlier one. The synthetic skin's
//! signatures are smooth bumps; in the later session a share of each is that of another skin.

use dermis_touch::locator::{Examples, FusedLocator, FusedOptions, SignatureMap};

const CHANNELS: usize = 48;
const SIDE_M: f64 = 0.1;
const OLD: usize = 160;
const NEW: usize = 24;
const JUDGED: usize = 150;

/// A number from -1 to 1 that looks random.
fn dither(seed: usize) -> f64 {
    let mixed = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xD1B5_4A32_D192_ED03);
    (mixed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

fn place(number: usize) -> [f64; 2] {
    [0, 1].map(|axis| 0.5 * SIDE_M * dither(2 * number + axis))
}

/// The frame of a press. `changed` is the share of the signature that is another skin's.
fn frame(place_m: [f64; 2], changed: f64, seed: usize) -> Vec<f64> {
    let bump = |skin: usize, k: usize| {
        let centre = place(700_000 * (skin + 1) + k);
        let square: f64 = (0..2).map(|axis| (place_m[axis] - centre[axis]).powi(2)).sum();
        (if k.is_multiple_of(3) { -1.0 } else { 1.0 }) * (-square / (2.0 * 0.022_f64.powi(2))).exp()
    };
    (0..CHANNELS)
        .map(|k| (1.0 - changed) * bump(0, k) + changed * bump(1, k) + 0.03 * dither(3_000_000 + seed * CHANNELS + k))
        .collect()
}

fn examples(numbers: std::ops::Range<usize>, changed: f64) -> Examples {
    let places: Vec<[f64; 2]> = numbers.clone().map(place).collect();
    let frames = numbers.zip(&places).flat_map(|(number, p)| frame(*p, changed, number)).collect();
    Examples::new(CHANNELS, frames, places).unwrap()
}

fn map() -> SignatureMap {
    let at = |k: usize| SIDE_M * (k as f64 / 24.0 - 0.5);
    let places = (0..25).flat_map(|row| (0..25).map(move |column| [at(column), at(row)])).collect();
    SignatureMap::without_physics(CHANNELS, places).unwrap()
}

/// Errors of presses of the later session, metres, sorted, and the share of coordinates within one sigma.
fn judge(locator: &FusedLocator, changed: f64) -> (Vec<f64>, f64) {
    let (mut errors, mut within) = (Vec::new(), 0);
    for number in 50_000..50_000 + JUDGED {
        let place_m = place(number);
        let found = locator.predict(&frame(place_m, changed, number)).unwrap();
        let [x, y] = [found.x_m - place_m[0], found.y_m - place_m[1]];
        within += usize::from(x.abs() <= found.sigma_x_m) + usize::from(y.abs() <= found.sigma_y_m);
        errors.push(x.hypot(y));
    }
    errors.sort_by(f64::total_cmp);
    (errors, within as f64 / (2 * JUDGED) as f64)
}

#[test]
fn an_earlier_session_is_weighted_by_its_similarity() {
    let old = examples(0..OLD, 0.0);
    let fit = |examples: &Examples| FusedLocator::fit(examples, &map(), &FusedOptions::default()).unwrap();
    let unchanged = fit(&old);
    let mut resemblances = Vec::new();
    for changed in [0.0, 0.25, 1.0] {
        let new = examples(10_000..10_000 + NEW, changed);
        let shared = fit(&new.clone().with_earlier(&old).unwrap());
        let median = |locator: &FusedLocator| 1e3 * judge(locator, changed).0[JUDGED / 2];
        let (alone, before, together) = (median(&fit(&new)), median(&unchanged), median(&shared));
        let within = judge(&shared, changed).1;
        let resemblance = shared.report().resemblance.unwrap();
        println!(
            "changed {changed}: resemblance {resemblance}, alone {alone:.2} mm, before {before:.2} mm, together {together:.2} mm, within {within:.2}"
        );
        // Pokes that have nothing in common with the new ones still choose hyperparameters: such skins aren't pooled.
        let most = if changed < 1.0 { 1.15 } else { 2.0 };
        assert!(together <= most * alone.min(before), "{changed}: {together} mm, {alone} mm alone, {before} mm before");
        assert!((0.5..0.9).contains(&within), "{changed}: {within}");
        resemblances.push(resemblance);
    }
    assert!(resemblances[0] >= 0.97 && resemblances[2] <= 0.5, "{resemblances:?}");
    assert!(resemblances[0] > resemblances[1] && resemblances[1] > resemblances[2], "{resemblances:?}");
}

#[test]
fn earlier_examples_of_another_skin_size_are_refused() {
    let few = Examples::new(4, vec![0.5; 4 * 6], (0..6).map(place).collect()).unwrap();
    let error = examples(0..8, 0.0).with_earlier(&few).unwrap_err();
    assert!(error.to_string().contains("channels of the earlier examples"), "{error}");
}
