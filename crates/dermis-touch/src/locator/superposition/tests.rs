use super::*;
use crate::plane::squared_distance;

const CHANNELS: usize = 40;
const SIDE_M: f64 = 0.1;

/// A channel's change by a touch: a smooth bump about the channel's own place, which is on a grid.
fn signature(place_m: [f64; 2]) -> Vec<f64> {
    let sensor = |k: usize| [0.02 * (k % 8) as f64 - 0.02, 0.025 * (k / 8) as f64];
    (0..CHANNELS).map(|k| (-squared_distance(sensor(k), place_m) / (2.0 * 0.02_f64.powi(2))).exp()).collect()
}

/// A number from -1 to 1 that looks random.
fn dither(seed: usize) -> f64 {
    let mixed = (seed as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xD1B5_4A32_D192_ED03);
    (mixed >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

fn place(number: usize) -> [f64; 2] {
    [0, 1].map(|axis| 0.5 * SIDE_M * (1.0 + dither(2 * number + axis)))
}

fn frame(touches: &[([f64; 2], f64)], seed: usize) -> Vec<f64> {
    let mut frame: Vec<f64> = (0..CHANNELS).map(|k| 0.02 * dither(9_000_000 + seed * CHANNELS + k)).collect();
    for (place_m, strength) in touches {
        frame.iter_mut().zip(signature(*place_m)).for_each(|(value, change)| *value += strength * change);
    }
    frame
}

fn learned() -> Superposition {
    learned_from(|_| 1.0)
}

/// The map of 200 pokes of these strengths.
fn learned_from(strength: impl Fn(usize) -> f64) -> Superposition {
    let places: Vec<[f64; 2]> = (0..200).map(place).collect();
    let frames: Vec<Vec<f64>> = places.iter().enumerate().map(|(i, p)| frame(&[(*p, strength(i))], i)).collect();
    let touches = places.iter().map(std::slice::from_ref);
    let labelled: Vec<LabelledFrame<'_>> =
        frames.iter().zip(touches).map(|(frame, touches_m)| LabelledFrame { frame, touches_m }).collect();
    Superposition::fit(&labelled, &[true; CHANNELS]).unwrap().unwrap()
}

#[test]
fn one_touch_is_one_and_two_or_three_apart_are_counted_and_placed() {
    let (map, mut scratch) = (learned(), SuperpositionScratch::default());
    let mut right = [0; 4];
    for number in 0..200 {
        let touches: Vec<([f64; 2], f64)> =
            (0..3).map(|touch| (place(5_000 + 3 * number + touch), 0.8 + 0.2 * touch as f64)).collect();
        let are_apart = (0..3).all(|a| (0..a).all(|b| squared_distance(touches[a].0, touches[b].0).sqrt() > 0.05));
        for count in 1..=if are_apart { 3 } else { 1 } {
            let parts = map.explain(&frame(&touches[..count], 50_000 + 4 * number + count), &mut scratch).unwrap();
            let is_near =
                |place_m: [f64; 2]| parts.iter().any(|part| squared_distance(part.position_m, place_m).sqrt() < 0.012);
            let is_right = parts.len() == count && touches[..count].iter().all(|(place_m, _)| is_near(*place_m));
            right[count] += usize::from(is_right);
            right[0] += usize::from(count == 3);
        }
    }
    let [triples, single, double, triple] = right;
    assert!(triples >= 20 && single >= 194, "{right:?}");
    assert!(10 * double >= 9 * triples && 10 * triple >= 8 * triples, "{right:?}");
}

#[test]
fn removing_the_other_touch_leaves_the_frame_of_one() {
    let (map, mut scratch) = (learned(), SuperpositionScratch::default());
    let both = frame(&[([0.02, 0.03], 1.0), ([0.08, 0.07], 1.0)], 77_777);
    let parts = map.explain(&both, &mut scratch).unwrap().to_vec();
    assert_eq!(parts.len(), 2, "{parts:?}");
    let kept = usize::from(parts[0].position_m[0] > 0.05);
    let mut alone = Vec::new();
    map.without_others(&both, &parts, kept, &mut scratch, &mut alone);
    let expected = signature([0.02, 0.03]);
    let product: f64 = alone.iter().zip(&expected).map(|(a, b)| a * b).sum();
    let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    assert!(product / (length(&alone) * length(&expected)) > 0.97, "{alone:?}");
}

#[test]
fn labelled_pairs_and_single_touches_train_together() {
    let touches: Vec<Vec<[f64; 2]>> =
        (0..300).map(|i| (0..1 + i % 2).map(|touch| place(2 * i + touch)).collect()).collect();
    let pressed = |touches: &Vec<[f64; 2]>| touches.iter().map(|place_m| (*place_m, 1.0)).collect::<Vec<_>>();
    let frames: Vec<Vec<f64>> = touches.iter().enumerate().map(|(i, t)| frame(&pressed(t), i)).collect();
    let labelled: Vec<LabelledFrame<'_>> =
        frames.iter().zip(&touches).map(|(frame, touches_m)| LabelledFrame { frame, touches_m }).collect();
    let map = Superposition::fit(&labelled, &[true; CHANNELS]).unwrap().unwrap();
    let mut scratch = SuperpositionScratch::default();
    let (mut pairs, mut right) = (0, 0);
    for number in 0..100 {
        let [a, b] = [place(7_000 + 2 * number), place(7_001 + 2 * number)];
        if squared_distance(a, b).sqrt() > 0.05 {
            let parts = map.explain(&frame(&[(a, 1.0), (b, 1.0)], 60_000 + number), &mut scratch).unwrap();
            pairs += 1;
            right += usize::from(parts.len() == 2);
        }
    }
    assert!(pairs > 15 && 10 * right >= 8 * pairs, "{right} of {pairs}");
}

#[test]
fn few_frames_frames_of_other_lengths_and_frames_without_touches_are_refused() {
    let frame = vec![1.0; CHANNELS];
    let one = [[0.0, 0.0]];
    let labelled = vec![LabelledFrame { frame: &frame, touches_m: &one }; FEWEST - 1];
    assert!(Superposition::fit(&labelled, &[true; CHANNELS]).unwrap().is_none());
    let labelled = vec![LabelledFrame { frame: &frame, touches_m: &one }; FEWEST];
    assert!(matches!(Superposition::fit(&labelled, &[true; 3]), Err(LocatorError::Length { .. })));
    let labelled = vec![LabelledFrame { frame: &frame, touches_m: &[] }; FEWEST];
    assert!(matches!(Superposition::fit(&labelled, &[true; CHANNELS]), Err(LocatorError::Count { .. })));
    let mut scratch = SuperpositionScratch::default();
    assert!(learned().explain(&[f64::NAN; CHANNELS], &mut scratch).is_err());
}

/// Numbers of 200 single touches of this strength that count as one, of pairs apart, and of those that count as two.
fn counted(map: &Superposition, strength: f64, seed: usize) -> [usize; 3] {
    let mut scratch = SuperpositionScratch::default();
    let (mut single, mut pairs, mut double) = (0, 0, 0);
    for number in 0..200 {
        let [a, b] = [0, 1].map(|touch| place(seed + 2 * number + touch));
        let count = |touches: &[([f64; 2], f64)], scratch: &mut SuperpositionScratch| {
            map.explain(&frame(touches, seed + 40_000 + number), scratch).unwrap().len()
        };
        single += usize::from(count(&[(a, strength)], &mut scratch) == 1);
        if squared_distance(a, b).sqrt() > 0.05 {
            pairs += 1;
            double += usize::from(count(&[(a, strength), (b, strength)], &mut scratch) == 2);
        }
    }
    [single, pairs, double]
}

#[test]
fn a_touch_much_stronger_than_the_pokes_is_one_and_two_are_two() {
    // The map's errors grow with the touch: without that, 158 single touches and 30 of 46 pairs are counted right.
    let [single, pairs, double] = counted(&learned(), 8.0, 30_000);
    assert!(single >= 180 && 10 * double >= 8 * pairs, "{single} of 200, {double} of {pairs}");
}

#[test]
fn two_touches_lighter_than_the_pokes_are_two() {
    // The map's errors fall with the frame. At a quarter of the usual strength, 14 of 55 pairs are counted right.
    let map = learned_from(|poke| 1.0 + 0.5 * dither(90_000 + poke));
    let [single, pairs, double] = counted(&map, 0.25, 40_000);
    assert!(single >= 195 && 10 * double >= 2 * pairs, "{single} of 200, {double} of {pairs}");
}
