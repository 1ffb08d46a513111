//! Finds the effect of a readout on the potentials (loads of its lines, composition of a reading) from frames of
//! unknown touches. For each circuit, the scale, sign and weight of each channel are fitted ([`SelfCalibration`]).
//! Circuits are then ranked by the likelihood of the frames as single touches at their best positions, without using
//! labels. The reported score of a circuit is the median correlation of frames with the best of its touch templates.
//!
//! With currents I and readings K of a channel's effective patterns, its Jacobian is bilinear,
//! `J = sum_ab I_a K_b J_ab`, with J_ab for a unit current from electrode 0 to a, read between 0 and b. The J_ab are
//! computed once, and every circuit costs one matrix product.

use dermis_skin::{Circuit, CircuitChoice, Polarity};
use dermis_tomo::eit::{ForwardModel, Pattern, Protocol, Solution};
use dermis_tomo::inverse::{
    CalibrationOptions, LEAST_CALIBRATION_FRAMES, SelfCalibration, TouchEffect, TouchTemplates,
};
use dermis_tomo::mesh::Point;
use faer::Mat;

use super::circuit_fit::{CircuitFit, RunnerUp};
use super::self_calibrated::{RIM_SIZES, places_off_the_rim};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, are_pairs, check_frames};

/// Minimum gain in log-likelihood over the skin file's circuit to replace it, nats per reading.
const LEAST_GAIN: f64 = 0.005;
/// Maximum number of frames used in the search. All frames judge its result.
const SEARCH_FRAMES: usize = 150;
/// Maximum number of channels and electrodes for a search, since it stores the products of electrodes for every
/// position.
const MOST_CHANNELS: usize = 2048;
const MOST_ELECTRODES: usize = 64;
/// Maximum number of positions.
const MOST_PLACES: usize = 700;
/// Initial readings: weights of the positive, the negative and the sink line.
const READINGS: [[f64; 3]; 8] = [
    [1.0, -1.0, 0.0],
    [-0.5, 1.0, -0.5],
    [1.0, -0.5, -0.5],
    [0.5, 0.5, -1.0],
    [1.0, 0.0, -1.0],
    [0.0, 1.0, -1.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
];
/// Initial loads of connected and idle lines.
const LOADS: [[f64; 2]; 5] = [[0.1, 0.03], [0.5, 0.15], [2.0, 0.5], [0.5, 0.01], [0.1, 0.1]];
/// Number of initial circuits that are improved. Steps are in the logarithm of the loads and the direction of the
/// readings, halved `HALVINGS` times.
const IMPROVED: usize = 3;
const LOAD_STEP: f64 = 0.8;
const READING_STEP: f64 = 0.3;
const HALVINGS: usize = 3;
/// Frames that change by less than this share of the larger changes show no touch.
const LEAST_CHANGE: f64 = 0.1;
/// Bounds on the loads.
const LOAD_BOUNDS: [f64; 2] = [1e-3, 1e2];

/// Relative changes `(v - v_0) / mean(v_0)` of frames against their own baselines (if equally many) or the mean of
/// all. Without frames, the changes between successive baselines.
///
/// # Errors
/// Frames of the wrong length, or too few of them.
pub fn relative_changes(
    prepared: &Prepared,
    baselines: &[Vec<f64>],
    frames: &[Vec<f64>],
) -> Result<Vec<Vec<f64>>, Error> {
    let reference = Reference::of(prepared, baselines)?;
    let divided = |difference: Vec<f64>| -> Vec<f64> {
        difference.iter().zip(&reference.baseline).map(|(d, b)| if *b == 0.0 { f64::NAN } else { d / b }).collect()
    };
    if frames.is_empty() {
        return Ok(reference.successive.iter().cloned().map(divided).collect());
    }
    check_frames("pressed", frames, prepared.channels())?;
    let paired = are_pairs(baselines, frames);
    let change = |(i, frame): (usize, &Vec<f64>)| {
        let rest = if paired { &baselines[i] } else { &reference.baseline };
        divided(frame.iter().zip(rest).map(|(f, b)| f - b).collect())
    };
    Ok(frames.iter().enumerate().map(change).collect())
}

/// Frames with a change large enough for a touch, relative to the larger changes.
fn touched(frames: &[Vec<f64>]) -> Vec<&Vec<f64>> {
    let size = |frame: &Vec<f64>| {
        let finite: Vec<f64> = frame.iter().copied().filter(|v| v.is_finite()).map(f64::abs).collect();
        finite.iter().sum::<f64>() / finite.len().max(1) as f64
    };
    let sizes: Vec<f64> = frames.iter().map(size).collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f64::total_cmp);
    let large = sorted.get(sorted.len() * 9 / 10).copied().unwrap_or(0.0);
    frames.iter().zip(&sizes).filter(|(_, size)| **size > LEAST_CHANGE * large).map(|(frame, _)| frame).collect()
}

/// Searches for the circuit under which the frames (relative changes, see [`relative_changes`]) look most like single
/// touches. `progress` receives the number of circuits tried.
///
/// # Errors
/// A skin without electrodes in pairs, with too many of them, or too few frames.
pub fn find_circuit(
    prepared: &Prepared,
    frames: &[Vec<f64>],
    mut progress: impl FnMut(usize),
) -> Result<CircuitFit, Error> {
    check_searchable(prepared)?;
    let frames: Vec<Vec<f64>> = touched(frames).into_iter().cloned().collect();
    let fit = find_circuit_while(prepared, &frames, |tried| {
        progress(tried);
        true
    })?;
    fit.ok_or_else(|| too_few(frames.len()))
}

/// Rejects a skin whose circuit cannot be searched for.
///
/// # Errors
/// A skin with coils, unknown wiring, or too many channels or electrodes.
pub(crate) fn check_searchable(prepared: &Prepared) -> Result<(), Error> {
    let refuse = |expected: String, got: String| {
        let what = format!("finding the circuit of skin {}", prepared.skin.name);
        Err(Error::Frames { what, expected, got })
    };
    let (electrodes, channels) = (prepared.protocol.electrode_count(), prepared.channels());
    if prepared.skin.frontend.coils.is_some() || !prepared.skin.backend.wiring.is_known() {
        return refuse("electrodes of known wiring".into(), "coils, or wiring that is unknown".into());
    }
    if electrodes > MOST_ELECTRODES || channels > MOST_CHANNELS {
        let expected = format!("at most {MOST_ELECTRODES} electrodes and {MOST_CHANNELS} channels");
        return refuse(expected, format!("{electrodes} and {channels}"));
    }
    Ok(())
}

fn too_few(got: usize) -> Error {
    let expected = format!("at least {LEAST_CALIBRATION_FRAMES}, of touches at different places");
    Error::Frames { what: "frames to find the circuit from".into(), expected, got: got.to_string() }
}

/// As [`find_circuit`], for frames that are all touches. `None` if `go_on`, which receives the number of circuits
/// tried, ended the search.
///
/// # Errors
/// Too few frames.
pub(crate) fn find_circuit_while(
    prepared: &Prepared,
    frames: &[Vec<f64>],
    mut go_on: impl FnMut(usize) -> bool,
) -> Result<Option<CircuitFit>, Error> {
    if frames.len() < LEAST_CALIBRATION_FRAMES {
        return Err(too_few(frames.len()));
    }
    let model = ForwardModel::new(prepared.body.mesh.clone(), prepared.protocol.clone())?;
    let sigma = vec![prepared.skin.sheet_conductance_s(); prepared.body.mesh.mesh.element_count()];
    let solution = model.solve(&sigma)?;
    let count = frames.len().min(SEARCH_FRAMES);
    let some: Vec<Vec<f64>> = (0..count).map(|i| frames[i * frames.len() / count].clone()).collect();
    let mut judge = Judge { prepared, solution: &solution, products: Products::new(prepared, &sigma)?, tried: 0 };
    let mut is_wanted = true;
    let mut likelihood = |circuit: Option<&Circuit>| {
        if !is_wanted {
            return Judged::NOTHING.likelihood;
        }
        let judged = judge.judge(circuit, &some);
        is_wanted = go_on(judge.tried);
        judged.likelihood
    };
    let mut begun: Vec<(f64, Trial)> = Vec::new();
    for reading in READINGS {
        let tries = LOADS.map(|[load, idle]| Trial { load, idle, reading: unit(reading) });
        let ranked = tries.map(|point| (likelihood(Some(&point.circuit())), point));
        // Keep only the best of each kind of reading, so that the search starts from different points.
        begun.extend(ranked.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)));
    }
    begun.sort_by(|a, b| b.0.total_cmp(&a.0));
    begun.truncate(IMPROVED);
    let mut improved: Vec<(f64, Trial)> = begun.iter().map(|start| climb(*start, &mut likelihood)).collect();
    if !is_wanted {
        return Ok(None);
    }
    improved.sort_by(|a, b| b.0.total_cmp(&a.0));
    let Some(&(_, best)) = improved.first() else { return Ok(None) };
    let other = improved.iter().skip(1).find(|(_, point)| dot(point.reading, best.reading).abs() < 0.9);
    let own = match &prepared.skin.backend.circuit {
        Some(CircuitChoice::Known(circuit)) => Some(*circuit),
        _ => None,
    };
    let before = judge.judge(own.as_ref(), frames);
    let ideal = if own.is_some() { judge.judge(None, frames) } else { before };
    let found = judge.judge(Some(&best.circuit()), frames);
    let runner_up = other.map(|(_, point)| {
        let judged = judge.judge(Some(&point.circuit()), frames);
        let behind = found.likelihood - judged.likelihood;
        RunnerUp { circuit: point.circuit(), score: judged.score, behind }
    });
    let candidates = [(own, before), (None, ideal), (Some(best.circuit()), found)];
    // Keep the skin file's circuit unless another one is more likely and also scores higher.
    let beats =
        |next: &Judged, least: &Judged| next.likelihood > least.likelihood + LEAST_GAIN && next.score > least.score;
    let winner = candidates.iter().fold(candidates[0], |best, next| if beats(&next.1, &best.1) { *next } else { best });
    let Judged { score, likelihood } = winner.1;
    let (frames, tried) = (frames.len(), judge.tried);
    let gain = likelihood - before.likelihood;
    Ok(Some(CircuitFit { circuit: winner.0, score, score_before: before.score, gain, runner_up, frames, tried }))
}

/// A circuit during the search.
#[derive(Clone, Copy, Debug)]
struct Trial {
    load: f64,
    idle: f64,
    /// Normalised to unit length.
    reading: [f64; 3],
}

impl Trial {
    /// Rounded to three digits, as in a file; the largest weight is 1.
    fn circuit(self) -> Circuit {
        let round = |v: f64| if v == 0.0 { 0.0 } else { format!("{v:.2e}").parse().unwrap_or(v) };
        let largest = self.reading.iter().fold(0.0, |most: f64, w| if w.abs() > most.abs() { *w } else { most });
        let reading = self.reading.map(|w| (1e3 * w / largest).round() / 1e3);
        Circuit { load: round(self.load), idle: round(self.idle), reading }
    }

    /// Its neighbours at a share of the initial steps.
    fn neighbours(self, share: f64) -> Vec<Self> {
        let mut all = Vec::with_capacity(10);
        for sign in [1.0, -1.0] {
            let factor = (sign * share * LOAD_STEP).exp();
            let bounded = |v: f64| v.clamp(LOAD_BOUNDS[0], LOAD_BOUNDS[1]);
            all.push(Self { load: bounded(factor * self.load), ..self });
            all.push(Self { idle: bounded(factor * self.idle), ..self });
            for axis in 0..3 {
                let mut reading = self.reading;
                reading[axis] += sign * share * READING_STEP;
                if dot(reading, reading) > 1e-6 {
                    all.push(Self { reading: unit(reading), ..self });
                }
            }
        }
        all
    }
}

/// Moves to better neighbours while there are any, in ever smaller steps.
fn climb(start: (f64, Trial), likelihood: &mut impl FnMut(Option<&Circuit>) -> f64) -> (f64, Trial) {
    let mut best = start;
    for halving in 0..=HALVINGS {
        let share = 0.5_f64.powi(halving as i32);
        for _ in 0..3 {
            let before = best.0;
            for next in best.1.neighbours(share) {
                let reached = likelihood(Some(&next.circuit()));
                if reached > best.0 {
                    best = (reached, next);
                }
            }
            if best.0 <= before {
                break;
            }
        }
    }
    best
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = dot(v, v).sqrt();
    v.map(|w| w / length)
}

/// Scores circuits.
struct Judge<'a> {
    prepared: &'a Prepared,
    solution: &'a Solution<'a>,
    products: Products,
    tried: usize,
}

/// How well a circuit explains frames.
#[derive(Clone, Copy, Debug)]
struct Judged {
    score: f64,
    /// In nats per reading.
    likelihood: f64,
}

impl Judged {
    /// Result for an impossible circuit.
    const NOTHING: Self = Self { score: -1.0, likelihood: -1e3 };
}

impl Judge<'_> {
    /// Measures how well a circuit explains frames; `None` is an ideal voltmeter.
    fn judge(&mut self, circuit: Option<&Circuit>, frames: &[Vec<f64>]) -> Judged {
        self.tried += 1;
        self.calibrate(circuit, frames).map_or(Judged::NOTHING, |calibration| Judged {
            score: calibration.score(),
            likelihood: calibration.log_likelihood(),
        })
    }

    fn calibrate(&self, circuit: Option<&Circuit>, frames: &[Vec<f64>]) -> Result<SelfCalibration, Error> {
        let conductance = self.prepared.skin.sheet_conductance_s();
        let (voltages, templates) = match circuit {
            None => (self.solution.voltages(), self.products.templates(&self.prepared.protocol)?),
            Some(circuit) => {
                let response = circuit.readout().response(self.solution, conductance)?;
                (response.voltages, self.products.templates(&response.effective)?)
            }
        };
        let options = CalibrationOptions { effect: touch_effect(self.prepared), ..CalibrationOptions::default() };
        Ok(SelfCalibration::fit(&templates, &voltages, frames, options)?)
    }
}

/// The effect of a touch on this skin.
pub(super) fn touch_effect(prepared: &Prepared) -> TouchEffect {
    match prepared.skin.imaging.polarity {
        Polarity::LowersConductivity => TouchEffect::LowersConductivity,
        Polarity::RaisesConductivity => TouchEffect::RaisesConductivity,
    }
}

/// Templates for unit currents from electrode 0 to a, read between 0 and b. Every circuit's templates are sums of
/// these.
struct Products {
    electrodes: usize,
    /// (electrodes - 1)^2 rows, a-major, by positions.
    rows: Mat<f64>,
    places_m: Vec<Point>,
}

impl Products {
    fn new(prepared: &Prepared, sigma: &[f64]) -> Result<Self, Error> {
        let electrodes = prepared.protocol.electrode_count();
        let others = 1..electrodes as u32;
        let stimulations: Vec<Pattern> = others.clone().map(|a| Pattern::pair(a, 0, 1.0)).collect();
        let channels = (0..stimulations.len())
            .flat_map(|stimulation| others.clone().map(move |b| (Pattern::pair(b, 0, 1.0), stimulation)))
            .collect();
        let protocol = Protocol::from_patterns(electrodes, stimulations, channels)
            .map_err(|source| Error::Protocol { skin: prepared.skin.name.clone(), source })?;
        let model = ForwardModel::new(prepared.body.mesh.clone(), protocol)?;
        let jacobian = model.solve(sigma)?.jacobian_to_pixels(&prepared.map);
        let size = prepared.skin.touch.relative_size * prepared.half_width_m();
        let places = places_off_the_rim(prepared, RIM_SIZES * size);
        let step = places.len().div_ceil(MOST_PLACES).max(1);
        let places_m: Vec<Point> = places.into_iter().step_by(step).collect();
        let pixels = prepared.map.inside_centres_m();
        let templates = TouchTemplates::blurred(jacobian.as_mat(), &pixels, &places_m, size)?;
        Ok(Self { electrodes, rows: templates.matrix().to_owned(), places_m })
    }

    /// The templates of a protocol's channels.
    fn templates(&self, protocol: &Protocol) -> Result<TouchTemplates, Error> {
        let others = self.electrodes - 1;
        let mut shares = Mat::<f64>::zeros(protocol.channel_count(), others * others);
        for channel in 0..protocol.channel_count() {
            for &(a, current) in protocol.stimulation_of(channel).entries().iter().filter(|entry| entry.0 > 0) {
                for &(b, weight) in protocol.pattern_of(channel).entries().iter().filter(|entry| entry.0 > 0) {
                    shares[(channel, (a as usize - 1) * others + b as usize - 1)] += current * weight;
                }
            }
        }
        Ok(TouchTemplates::new(&shares * &self.rows, self.places_m.clone())?)
    }
}
