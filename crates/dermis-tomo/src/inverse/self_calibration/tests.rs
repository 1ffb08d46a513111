use std::sync::OnceLock;

use super::*;
use crate::eit::{ForwardModel, Pattern, Protocol, ReadoutCircuit};
use crate::mesh::{Direction, ElectrodedMesh, Outline, PixelGrid, PixelMap, Point, SheetSpec};

const RADIUS_M: f64 = 0.05;
const ELECTRODES: usize = 16;
const FRAMES: usize = 40;

fn body(element_size_m: f64) -> ElectrodedMesh {
    let electrodes = Outline::rim_arcs(ELECTRODES, 0.004, 0.0, Direction::CounterClockwise);
    SheetSpec::new(Outline::Disc { radius_m: RADIUS_M }, electrodes, element_size_m).build(&[1e-3]).unwrap().0
}

/// Opposite drives, adjacent measurements: 192 channels.
fn protocol() -> Protocol {
    let count = ELECTRODES as u32;
    let mut channels = Vec::new();
    for source in 0..count {
        for plus in 0..count {
            let (sink, minus) = ((source + count / 2) % count, (plus + 1) % count);
            if ![source, sink].contains(&plus) && ![source, sink].contains(&minus) {
                channels.push((Pattern::pair(plus, minus, 1.0), source as usize));
            }
        }
    }
    let stimulations = (0..count).map(|k| Pattern::pair(k, (k + count / 2) % count, 1.0)).collect();
    Protocol::from_patterns(ELECTRODES, stimulations, channels).unwrap()
}

/// Templates and modelled voltages, and touches simulated on a different mesh with 30 % conductivity loss.
struct Skin {
    templates: TouchTemplates,
    voltages: Vec<f64>,
    frames: Vec<Vec<f64>>,
    touches_m: Vec<Point>,
}

fn skin() -> &'static Skin {
    static SKIN: OnceLock<Skin> = OnceLock::new();
    SKIN.get_or_init(|| {
        let (templates, voltages) = model();
        let (frames, touches_m) = simulate();
        Skin { templates, voltages, frames, touches_m }
    })
}

fn model() -> (TouchTemplates, Vec<f64>) {
    let body = body(0.005);
    let uniform = vec![1.0; body.mesh.element_count()];
    let nominal = ForwardModel::new(body.clone(), protocol()).unwrap();
    let response = ReadoutCircuit::HYDROGEL_BOARD.response(&nominal.solve(&uniform).unwrap(), 1.0).unwrap();
    let map = PixelMap::new(PixelGrid::over_mesh(&body.mesh, 24).unwrap(), &body.mesh).unwrap();
    let effective = ForwardModel::new(body, response.effective).unwrap();
    let jacobian = effective.solve(&uniform).unwrap().jacobian_to_pixels(&map);
    let pixels = map.inside_centres_m();
    let places: Vec<Point> = pixels.iter().copied().filter(|p| p[0].hypot(p[1]) < 0.043).collect();
    (TouchTemplates::blurred(jacobian.as_mat(), &pixels, &places, 0.005).unwrap(), response.voltages)
}

fn simulate() -> (Vec<Vec<f64>>, Vec<[f64; 2]>) {
    let body = body(0.006);
    let model = ForwardModel::new(body.clone(), protocol()).unwrap();
    let read = |touch: Option<[f64; 2]>| {
        let at = |element: usize| {
            let centre = body.mesh.centroid(element);
            let loss =
                touch.map_or(0.0, |t| (-square_distance([centre[0], centre[1]], t) / (2.0 * 0.005f64.powi(2))).exp());
            1.0 - 0.3 * loss
        };
        let sigma: Vec<f64> = (0..body.mesh.element_count()).map(at).collect();
        ReadoutCircuit::HYDROGEL_BOARD.response(&model.solve(&sigma).unwrap(), 1.0).unwrap().voltages
    };
    let baseline = read(None);
    // A sunflower pattern of touches covers the disc evenly.
    let touch = |k: usize| {
        let (radius, angle) = (0.04 * ((k as f64 + 0.5) / FRAMES as f64).sqrt(), 2.399_963 * k as f64);
        [radius * angle.cos(), radius * angle.sin()]
    };
    let touches_m: Vec<Point> = (0..FRAMES).map(touch).collect();
    let change = |v: f64, v0: f64| (v - v0) / v0;
    let frames =
        touches_m.iter().map(|&t| read(Some(t)).iter().zip(&baseline).map(|(&v, &v0)| change(v, v0)).collect());
    (frames.collect(), touches_m)
}

/// Deterministic pseudorandom numbers in 0..1.
fn noise(k: usize) -> f64 {
    let mut state = (k as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    state ^= state >> 29;
    state = state.wrapping_mul(0xBF58_476D_1CE4_E5B9);
    state ^= state >> 32;
    (state >> 11) as f64 / (1u64 << 53) as f64
}

fn worst_error_m(calibration: &SelfCalibration, frames: &[Vec<f64>]) -> f64 {
    let touches = frames.iter().map(|frame| calibration.locate(frame).unwrap().unwrap().position_m);
    touches.zip(&skin().touches_m).map(|(found, truth)| square_distance(found, *truth).sqrt()).fold(0.0, f64::max)
}

#[test]
fn signs_and_gains_are_recovered_and_touches_located() {
    let skin = skin();
    let mut sorted: Vec<f64> = skin.voltages.iter().map(|v| v.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    let flips: Vec<f64> = (0..skin.voltages.len())
        .map(|c| if skin.voltages[c].abs() < sorted[120] && noise(c) < 0.6 { -1.0 } else { 1.0 })
        .collect();
    assert!(flips.iter().filter(|flip| **flip < 0.0).count() > 50);
    let gains: Vec<f64> = (0..flips.len()).map(|c| flips[c] * (0.2 + 5.0 * noise(1000 + c))).collect();
    let distorted: Vec<Vec<f64>> =
        skin.frames.iter().map(|frame| frame.iter().zip(&gains).map(|(d, gain)| d * gain).collect()).collect();
    let fit = |frames: &[Vec<f64>]| {
        SelfCalibration::fit(&skin.templates, &skin.voltages, frames, CalibrationOptions::default()).unwrap()
    };
    let (plain, found) = (fit(&skin.frames), fit(&distorted));
    assert!(plain.signs().iter().all(|sign| *sign == 1.0));
    assert_eq!(found.signs(), flips);
    for channel in 0..gains.len() {
        let ratio = found.data_scale()[channel] / plain.data_scale()[channel];
        assert!((ratio / gains[channel].abs() - 1.0).abs() < 1e-12);
    }
    assert!(found.score() > 0.95, "{}", found.score());
    // Almost nothing is left unexplained: at most the floor, -1/2 ln 0.02.
    assert!(found.log_likelihood() > 1.0 && found.log_likelihood() < 1.96, "{}", found.log_likelihood());
    // Pixels of 4.2 mm, touches of 5 mm (standard deviation).
    let worst = worst_error_m(&found, &distorted);
    assert!(worst < 0.003, "{worst}");
}

#[test]
fn a_noisy_channel_loses_weight_and_a_dead_one_all_of_it() {
    let skin = skin();
    let mut frames = skin.frames.clone();
    for (k, frame) in frames.iter_mut().enumerate() {
        frame[7] = noise(k) - 0.5;
        frame[11] = 0.0;
        frame[12] = f64::NAN;
        frame[20 + k] = f64::NAN;
    }
    let options = CalibrationOptions::default();
    let calibration = SelfCalibration::fit(&skin.templates, &skin.voltages, &frames, options).unwrap();
    let weights = calibration.weights();
    let mut sorted = weights.to_vec();
    sorted.sort_by(f64::total_cmp);
    assert!(weights[7] < 0.3 * sorted[sorted.len() / 2], "{} {}", weights[7], sorted[sorted.len() / 2]);
    assert_eq!((weights[11], weights[12]), (0.0, 0.0));
    assert!(worst_error_m(&calibration, &frames) < 0.003);
    let rows = calibration.calibrated_rows(skin.templates.matrix()).unwrap();
    assert!(rows.row(12).iter().all(|value| *value == 0.0));
    assert!(calibration.scaled(&frames[0]).unwrap()[20].is_nan());
}

#[test]
fn amplitude_is_proportional_and_its_sign_follows_the_touch() {
    let skin = skin();
    let lower = CalibrationOptions::default();
    let fit = |frames: &[Vec<f64>], options| SelfCalibration::fit(&skin.templates, &skin.voltages, frames, options);
    let calibration = fit(&skin.frames, lower).unwrap();
    let one = calibration.locate(&skin.frames[3]).unwrap().unwrap();
    let twice: Vec<f64> = skin.frames[3].iter().map(|d| 2.0 * d).collect();
    let two = calibration.locate(&twice).unwrap().unwrap();
    assert!((two.amplitude / one.amplitude - 2.0).abs() < 1e-9 && one.peak == two.peak);
    assert!((calibration.scores(&twice).unwrap()[two.peak] - two.score).abs() < 1e-12);
    // The same skin with rising conductivity: all frames and the effect change sign.
    let negative: Vec<Vec<f64>> = skin.frames.iter().map(|f| f.iter().map(|d| -d).collect()).collect();
    let raise = CalibrationOptions { effect: TouchEffect::RaisesConductivity, ..lower };
    assert!(worst_error_m(&fit(&negative, raise).unwrap(), &negative) < 0.003);
    assert_eq!(calibration.locate(&vec![0.0; skin.voltages.len()]).unwrap(), None);
}

#[test]
fn frames_of_two_touches_weigh_the_channels_once_they_are_known_to_be() {
    let skin = skin();
    let apart_m = 0.03;
    let sum = |a: usize, b: usize| -> Vec<f64> {
        skin.frames[a].iter().zip(&skin.frames[b]).map(|(one, other)| one + other).collect()
    };
    let pairs = (0..FRAMES).flat_map(|a| (0..a).map(move |b| (a, b)));
    let far =
        |(a, b): &(usize, usize)| square_distance(skin.touches_m[*a], skin.touches_m[*b]) > 1.4 * apart_m * apart_m;
    let frames: Vec<Vec<f64>> = pairs.filter(far).step_by(7).take(60).map(|(a, b)| sum(a, b)).collect();
    let options = CalibrationOptions::default();
    let are_two = |one: f64, two: f64, alike: f64| two <= 0.6 * one && alike >= 0.4;
    let left = |calibration: &SelfCalibration| -> f64 {
        let search = calibration.pair_search(apart_m);
        let of = |frame: &Vec<f64>| calibration.locate_pair(frame, &search).unwrap().unwrap().left;
        frames.iter().map(of).sum::<f64>() / frames.len() as f64
    };
    let mut calibration = SelfCalibration::fit(&skin.templates, &skin.voltages, &frames, options).unwrap();
    let (before, score) = (left(&calibration), calibration.score());
    calibration.weigh_with_pairs(&skin.templates, &frames, apart_m, are_two);
    let after = left(&calibration);
    assert!(after < 0.85 * before && calibration.score() > score, "{before} {after}, {score} {}", calibration.score());
    // Frames with one touch each are left unchanged.
    let of_one = SelfCalibration::fit(&skin.templates, &skin.voltages, &skin.frames, options).unwrap();
    let mut again = of_one.clone();
    again.weigh_with_pairs(&skin.templates, &skin.frames, apart_m, are_two);
    assert_eq!((again.weights(), again.score()), (of_one.weights(), of_one.score()));
}

#[test]
fn refusals_state_the_expectation() {
    let skin = skin();
    let options = CalibrationOptions::default();
    let fit = |frames: &[Vec<f64>]| SelfCalibration::fit(&skin.templates, &skin.voltages, frames, options).unwrap_err();
    let mut few = skin.frames[..19].to_vec();
    few.push(vec![0.0; skin.voltages.len()]);
    assert_eq!(fit(&few), InverseError::TooFewFrames { needed: 20, useful: 19, given: 20 });
    let mut bad = skin.frames.clone();
    bad[5][3] = f64::INFINITY;
    assert!(fit(&bad).to_string().contains("channel 3"));
    bad[5].pop();
    assert!(matches!(fit(&bad), InverseError::Size { expected: 192, got: 191, .. }));
    let calibration = SelfCalibration::fit(&skin.templates, &skin.voltages, &skin.frames, options).unwrap();
    let missing = vec![f64::NAN; skin.voltages.len()];
    assert_eq!(calibration.locate(&missing).unwrap_err(), InverseError::NoChannels { channels: 192 });
    let error = TouchTemplates::blurred(skin.templates.matrix(), skin.templates.places_m(), &[[0.0; 2]], 0.0);
    assert!(error.unwrap_err().to_string().contains("touch_sigma_m: 0"));
}
