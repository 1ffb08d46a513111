//! Alternative positions of a touch, for frames that presses at two distant places explain about equally well.
//!
//! A watershed from the peaks splits probabilities over places into modes. Modes are merged if their saddle is more
//! than half as high as the lower peak, if they are closer than a separation, or if they overlap. The odds between
//! the two heaviest modes are tracked over a press. Their logarithm is averaged, first over all frames so far and
//! later over the last half second. It is averaged rather than added, since the model's error at a place repeats in
//! every frame of a press.

use serde::{Deserialize, Serialize};

use crate::plane::distance;
use crate::statistics::spacing;

/// Places less probable than this share of the peak belong to no mode.
const LEAST_LIKELY: f64 = 1e-3;
/// Merge peaks if the saddle between them is higher than this share of the lower peak.
const SADDLE: f64 = 0.5;
/// Radius of the neighbourhood of a place, in spacings. On a lattice it holds eight neighbours.
const NEIGHBOURHOOD: f64 = 1.6;
/// Merge modes closer than this times the sum of their RMS radii: they overlap.
const RESOLVED: f64 = 1.0;
/// Minimum probability, relative to the first mode, for a frame's second mode to count.
const LEAST_PROBABILITY: f64 = 0.05;
/// Minimum probability, over the frames of the press, for the second place to be reported.
const TOLD_PROBABILITY: f64 = 0.1;
/// The touch moves to the other place when the probability of that place exceeds this.
const SWITCH_PROBABILITY: f64 = 0.65;
/// Averaging time of the odds, seconds.
const MEMORY_S: f64 = 0.5;

/// A possible position of a touch.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceHypothesis {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Covariance of the position if the touch is here, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// Probability, 0 to 1, that the touch is here rather than at the other place.
    pub probability: f64,
}

/// Finds the modes of probabilities over fixed places.
#[derive(Debug, Clone)]
pub struct PlaceModes {
    places_m: Vec<[f64; 2]>,
    /// Neighbours of place i: `neighbours[starts[i]..starts[i + 1]]`.
    starts: Vec<u32>,
    neighbours: Vec<u32>,
    spacing_m: f64,
    separation_m: f64,
    likely: Vec<u32>,
    /// Mode of each place, [`UNLABELLED`] for most.
    labels: Vec<u32>,
    found: Vec<Mode>,
}

const UNLABELLED: u32 = u32::MAX;

/// Sums over a mode.
#[derive(Debug, Clone, Copy)]
struct Mode {
    /// The mode that this one was merged into; itself if none.
    parent: u32,
    peak: u32,
    mass: f64,
    first: [f64; 2],
    second: [[f64; 2]; 2],
}

impl Mode {
    fn mean(&self) -> [f64; 2] {
        self.first.map(|sum| sum / self.mass)
    }

    /// RMS distance from the mean.
    fn spread(&self) -> f64 {
        let mean = self.mean();
        let variance = |a: usize| (self.second[a][a] / self.mass - mean[a] * mean[a]).max(0.0);
        (variance(0) + variance(1)).sqrt()
    }

    fn join(&mut self, other: &Mode) {
        self.mass += other.mass;
        for a in 0..2 {
            self.first[a] += other.first[a];
            for b in 0..2 {
                self.second[a][b] += other.second[a][b];
            }
        }
    }
}

impl PlaceModes {
    /// Prepares to find modes over these places, metres, ideally on a lattice. Modes closer than `separation_m` are
    /// merged.
    pub fn new(places_m: &[[f64; 2]], separation_m: f64) -> Self {
        // A single place has no neighbour.
        let spacing_m = Some(spacing(places_m)).filter(|step| step.is_finite()).unwrap_or(0.0);
        let reach = NEIGHBOURHOOD * spacing_m;
        // Sort along x, so that each place is compared only with those of a narrow strip.
        let mut along: Vec<u32> = (0..places_m.len() as u32).collect();
        along.sort_by(|&a, &b| places_m[a as usize][0].total_cmp(&places_m[b as usize][0]));
        let mut lists: Vec<Vec<u32>> = vec![Vec::new(); places_m.len()];
        for (rank, &a) in along.iter().enumerate() {
            for &b in &along[rank + 1..] {
                let [dx, dy] = [0, 1].map(|axis| places_m[b as usize][axis] - places_m[a as usize][axis]);
                if dx > reach {
                    break;
                }
                if dx.hypot(dy) <= reach {
                    lists[a as usize].push(b);
                    lists[b as usize].push(a);
                }
            }
        }
        let ends = lists.iter().scan(0, |end, list| {
            *end += list.len() as u32;
            Some(*end)
        });
        Self {
            starts: std::iter::once(0).chain(ends).collect(),
            neighbours: lists.concat(),
            places_m: places_m.to_vec(),
            spacing_m,
            separation_m,
            likely: Vec::new(),
            labels: vec![UNLABELLED; places_m.len()],
            found: Vec::new(),
        }
    }

    /// The heaviest mode and the second, if any, with their shares of the total. `None` if the number of
    /// probabilities does not match, or if none is above zero.
    pub fn find(&mut self, probability: &[f64]) -> Option<(PlaceHypothesis, Option<PlaceHypothesis>)> {
        if probability.len() != self.places_m.len() {
            return None;
        }
        let top = probability.iter().copied().fold(0.0, f64::max);
        if !(top > 0.0 && top.is_finite()) {
            return None;
        }
        self.likely.clear();
        self.likely.extend((0..probability.len() as u32).filter(|&i| probability[i as usize] >= LEAST_LIKELY * top));
        self.likely
            .sort_unstable_by(|&a, &b| probability[b as usize].total_cmp(&probability[a as usize]).then(a.cmp(&b)));
        self.found.clear();
        for k in 0..self.likely.len() {
            self.label(self.likely[k], probability);
        }
        self.gather(probability);
        for &place in &self.likely {
            self.labels[place as usize] = UNLABELLED;
        }
        let total: f64 = self.found.iter().map(|mode| mode.mass).sum();
        let told = |mode: &Mode| self.hypothesis(mode, total);
        Some((told(self.found.first()?), self.found.get(1).map(told)))
    }

    fn root(&self, mut mode: u32) -> u32 {
        while self.found[mode as usize].parent != mode {
            mode = self.found[mode as usize].parent;
        }
        mode
    }

    /// Assigns a place to the highest mode among its neighbours. All more probable places have been assigned already.
    fn label(&mut self, place: u32, probability: &[f64]) {
        let range = self.starts[place as usize] as usize..self.starts[place as usize + 1] as usize;
        let height = |mode: &Mode| probability[mode.peak as usize];
        let mut own = UNLABELLED;
        for k in range {
            let label = self.labels[self.neighbours[k] as usize];
            if label == UNLABELLED {
                continue;
            }
            let other = self.root(label);
            if own == UNLABELLED || own == other {
                own = other;
                continue;
            }
            let is_higher = height(&self.found[own as usize]) >= height(&self.found[other as usize]);
            let (high, low) = if is_higher { (own, other) } else { (other, own) };
            if probability[place as usize] > SADDLE * height(&self.found[low as usize]) {
                self.found[low as usize].parent = high;
            }
            own = high;
        }
        if own == UNLABELLED {
            own = self.found.len() as u32;
            self.found.push(Mode { parent: own, peak: place, mass: 0.0, first: [0.0; 2], second: [[0.0; 2]; 2] });
        }
        self.labels[place as usize] = own;
    }

    /// Sums up the modes and merges those that are close, heaviest first.
    fn gather(&mut self, probability: &[f64]) {
        for &place in &self.likely {
            let root = self.root(self.labels[place as usize]);
            let (weight, at) = (probability[place as usize], self.places_m[place as usize]);
            let mode = &mut self.found[root as usize];
            mode.join(&Mode {
                mass: weight,
                first: at.map(|v| weight * v),
                second: [0, 1].map(|a| [0, 1].map(|b| weight * at[a] * at[b])),
                ..*mode
            });
        }
        let modes = &mut self.found;
        modes.retain(|mode| mode.mass > 0.0);
        modes.sort_by(|a, b| b.mass.total_cmp(&a.mass));
        let mut next = 1;
        while next < modes.len() {
            let lone = modes[next];
            let near = |mode: &Mode| {
                let apart_m = distance(mode.mean(), lone.mean());
                apart_m < self.separation_m || apart_m < RESOLVED * (mode.spread() + lone.spread())
            };
            match (0..next).find(|&heavier| near(&modes[heavier])) {
                Some(heavier) => {
                    modes[heavier].join(&lone);
                    modes.remove(next);
                }
                None => next += 1,
            }
        }
        modes.sort_by(|a, b| b.mass.total_cmp(&a.mass));
    }

    fn hypothesis(&self, mode: &Mode, total: f64) -> PlaceHypothesis {
        let mean = mode.mean();
        let grain = self.spacing_m * self.spacing_m / 12.0;
        let covariance = |a: usize, b: usize| mode.second[a][b] / mode.mass - mean[a] * mean[b];
        let variance = |a: usize| covariance(a, a).max(0.0) + grain;
        let across = covariance(0, 1);
        PlaceHypothesis {
            position_m: mean,
            covariance_m2: [[variance(0), across], [across, variance(1)]],
            probability: mode.mass / total,
        }
    }
}

/// The two possible places of a touch, followed over the frames of a press.
#[derive(Debug, Clone)]
pub struct PlaceHypotheses {
    modes: PlaceModes,
    held: Option<Held>,
}

/// State of a press.
#[derive(Debug, Clone, Copy)]
struct Held {
    /// The reported place of the touch, and the other.
    places_m: [Option<[f64; 2]>; 2],
    /// Log odds of the first place.
    log_odds: f64,
    frames: u32,
    time_ns: u64,
}

/// The conclusion about the place of a touch after a frame and those before it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacesTold {
    /// The most plausible place of the touch.
    pub leading: PlaceHypothesis,
    /// The alternative place; `None` if it is improbable.
    pub other: Option<PlaceHypothesis>,
}

impl PlaceHypotheses {
    /// Starts without a press. `modes` finds the modes of each frame.
    pub fn new(modes: PlaceModes) -> Self {
        Self { modes, held: None }
    }

    /// True if two places are too close together to be separate explanations.
    pub fn are_one(&self, place_m: [f64; 2], other_m: [f64; 2]) -> bool {
        distance(place_m, other_m) < self.modes.separation_m
    }

    /// Forgets the current press: the next frame is unrelated.
    pub fn forget(&mut self) {
        self.held = None;
    }

    /// Takes the probabilities of all places in a frame. `None` if [`PlaceModes::find`] finds nothing.
    pub fn follow(&mut self, time_ns: u64, probability: &[f64]) -> Option<PlacesTold> {
        let (first, second) = self.modes.find(probability)?;
        let mut now = [Some(first), second];
        let both = first.probability + second.map_or(0.0, |mode| mode.probability);
        now.iter_mut().flatten().for_each(|mode| mode.probability /= both);
        now[1] = now[1].filter(|mode| mode.probability >= LEAST_PROBABILITY);
        let (held, swapped) = self.recalled(&now);
        if swapped {
            now.swap(0, 1);
        }
        let most = ((1.0 - LEAST_PROBABILITY) / LEAST_PROBABILITY).ln();
        let log_odds = match now {
            [Some(one), Some(other)] => (one.probability / other.probability).ln().clamp(-most, most),
            [Some(_), None] => most,
            _ => -most,
        };
        let mut held = match held {
            None => Held { places_m: [None; 2], log_odds, frames: 1, time_ns },
            Some(held) => {
                let since_s = 1e-9 * time_ns.saturating_sub(held.time_ns) as f64;
                let share = (1.0 / f64::from(held.frames + 1)).max(1.0 - (-since_s / MEMORY_S).exp());
                let log_odds = held.log_odds + share * (log_odds - held.log_odds);
                Held { log_odds, frames: held.frames.saturating_add(1), time_ns, ..held }
            }
        };
        // Leave a place at once if it has no probability left in this frame.
        let switch = (SWITCH_PROBABILITY / (1.0 - SWITCH_PROBABILITY)).ln();
        if now[0].is_none() || (now[1].is_some() && held.log_odds < -switch) {
            now.swap(0, 1);
            held.places_m.swap(0, 1);
            held.log_odds = -held.log_odds;
        }
        for (place, mode) in held.places_m.iter_mut().zip(&now) {
            *place = mode.map(|mode| mode.position_m).or(*place);
        }
        self.held = Some(held);
        let probability = 1.0 / (1.0 + (-held.log_odds).exp());
        let with = |mode: PlaceHypothesis, probability: f64| PlaceHypothesis { probability, ..mode };
        let other =
            now[1].map(|mode| with(mode, 1.0 - probability)).filter(|mode| mode.probability >= TOLD_PROBABILITY);
        let leading = now[0].map(|mode| with(mode, if other.is_some() { probability } else { 1.0 }))?;
        Some(PlacesTold { leading, other })
    }

    /// The held state, if this frame belongs to the same press, and whether the frame's modes are in the opposite
    /// order. A frame with no mode at a held place begins a new press.
    fn recalled(&self, now: &[Option<PlaceHypothesis>; 2]) -> (Option<Held>, bool) {
        let Some(held) = self.held else { return (None, false) };
        let is_at = |mode: usize, place: usize| match (now[mode], held.places_m[place]) {
            (Some(mode), Some(place_m)) => distance(mode.position_m, place_m) < self.modes.separation_m,
            _ => false,
        };
        let (same, swapped) = (is_at(0, 0) || is_at(1, 1), is_at(0, 1) || is_at(1, 0));
        match (same, swapped) {
            (true, _) => (Some(held), false),
            (false, true) => (Some(held), true),
            (false, false) => (None, false),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_M: f64 = 2e-3;
    const FRAME_NS: u64 = 20_000_000;

    /// Places on a lattice of 2 mm over a square of 120 mm.
    fn lattice() -> Vec<[f64; 2]> {
        let at = |k: i32| f64::from(k) * STEP_M;
        (-30..=30).flat_map(|row| (-30..=30).map(move |column| [at(column), at(row)])).collect()
    }

    /// Gaussians with these weights and sigmas (metres), normalised to a sum of 1.
    fn bells(places: &[[f64; 2]], bells: &[([f64; 2], f64, f64)]) -> Vec<f64> {
        let value = |at: &[f64; 2]| {
            let bell = |(middle, weight, sigma): &([f64; 2], f64, f64)| {
                weight * (-0.5 * (distance(*at, *middle) / sigma).powi(2)).exp() / sigma.powi(2)
            };
            bells.iter().map(bell).sum::<f64>()
        };
        let mut values: Vec<f64> = places.iter().map(value).collect();
        let total: f64 = values.iter().sum();
        values.iter_mut().for_each(|v| *v /= total);
        values
    }

    fn follower() -> (Vec<[f64; 2]>, PlaceHypotheses) {
        let places = lattice();
        let hypotheses = PlaceHypotheses::new(PlaceModes::new(&places, 0.02));
        (places, hypotheses)
    }

    #[test]
    fn modes_have_the_weights_means_and_spreads_of_the_bells_that_they_are() {
        let places = lattice();
        let mut modes = PlaceModes::new(&places, 0.02);
        let (one, other) = ([0.021, 0.013], [-0.03, -0.011]);
        let (first, second) = modes.find(&bells(&places, &[(other, 0.3, 0.005), (one, 0.7, 0.004)])).unwrap();
        let second = second.unwrap();
        // Values below a thousandth of the higher peak belong to neither mode. This cuts 0.4 % of the weight and
        // 2.4 % of the variance off the lower Gaussian.
        assert!((first.probability - 0.7).abs() < 2e-3 && (second.probability - 0.3).abs() < 2e-3, "{first:?}");
        assert!(distance(first.position_m, one) < 1e-4 && distance(second.position_m, other) < 1e-4, "{second:?}");
        let expected = [0.004_f64, 0.005].map(|sigma| sigma.powi(2) + STEP_M.powi(2) / 12.0);
        for (mode, expected) in [first, second].iter().zip(expected) {
            let [[xx, xy], [yx, yy]] = mode.covariance_m2;
            assert!((xx / expected - 1.0).abs() < 0.03 && (yy / expected - 1.0).abs() < 0.03, "{mode:?}");
            assert!(xy == yx && xy.abs() < 0.01 * xx, "{mode:?}");
        }
    }

    #[test]
    fn bumps_of_one_hill_and_near_peaks_are_one_mode() {
        let places = lattice();
        let mut modes = PlaceModes::new(&places, 0.02);
        let mut rough = bells(&places, &[([0.0, 0.0], 1.0, 0.01)]);
        rough.iter_mut().enumerate().for_each(|(k, p)| *p *= 1.0 + 0.3 * (k as f64 * 12.9898).sin());
        assert!(modes.find(&rough).unwrap().1.is_none());
        let near = bells(&places, &[([-0.009, 0.0], 0.5, 0.003), ([0.009, 0.0], 0.5, 0.003)]);
        let (only, second) = modes.find(&near).unwrap();
        assert!(second.is_none() && only.position_m[0].abs() < 1e-6, "{only:?}");
        assert!(only.covariance_m2[0][0] > 0.0085_f64.powi(2), "the spread holds both: {only:?}");
    }

    #[test]
    fn equal_peaks_that_noise_exchanges_stay_one_touch_at_one_place() {
        let (places, mut hypotheses) = follower();
        let (one, other) = ([0.03, 0.0], [-0.03, 0.0]);
        let mut before: Option<[f64; 2]> = None;
        let mut jumps = 0;
        for frame in 0..200_u64 {
            let share = 0.5 + 0.3 * (frame as f64 * 78.233).sin();
            let drawn = bells(&places, &[(one, share, 0.004), (other, 1.0 - share, 0.004)]);
            let told = hypotheses.follow(frame * FRAME_NS, &drawn).unwrap();
            let apart = told.other.expect("both are told").probability;
            assert!((told.leading.probability + apart - 1.0).abs() < 1e-12);
            assert!(frame < 20 || (apart - 0.5).abs() < 0.16, "frame {frame}: {apart}");
            jumps += usize::from(before.is_some_and(|at| distance(at, told.leading.position_m) > 0.02));
            before = Some(told.leading.position_m);
        }
        assert!(jumps <= 1, "{jumps} jumps");
    }

    #[test]
    fn evidence_that_lasts_moves_the_touch_once_and_ends_the_doubt() {
        let (places, mut hypotheses) = follower();
        let (one, other) = ([0.03, 0.0], [-0.03, 0.0]);
        let both = |share: f64| bells(&places, &[(one, share, 0.004), (other, 1.0 - share, 0.004)]);
        let mut frames = 0..;
        let mut next = |share: f64| hypotheses.follow(frames.next().unwrap() * FRAME_NS, &both(share)).unwrap();
        for _ in 0..20 {
            assert!(next(0.7).leading.position_m[0] > 0.0);
        }
        // Two odd frames change nothing; half a second of them does.
        for _ in 0..2 {
            assert!(next(0.1).leading.position_m[0] > 0.0);
        }
        let told: Vec<PlacesTold> = (0..100).map(|_| next(0.06)).collect();
        let moved = told.iter().position(|told| told.leading.position_m[0] < 0.0).expect("it moves");
        assert!((3..60).contains(&moved), "after {moved} frames");
        assert!(told[moved..].iter().all(|told| told.leading.position_m[0] < 0.0));
        assert!(told[99].other.is_none() && told[99].leading.probability == 1.0, "{:?}", told[99]);
    }

    #[test]
    fn another_press_starts_over_at_once() {
        let (places, mut hypotheses) = follower();
        let at = |place: [f64; 2]| bells(&places, &[(place, 1.0, 0.004)]);
        for frame in 0..50 {
            hypotheses.follow(frame * FRAME_NS, &at([0.03, 0.0])).unwrap();
        }
        let told = hypotheses.follow(50 * FRAME_NS, &at([-0.03, 0.01])).unwrap();
        assert!(told.other.is_none() && distance(told.leading.position_m, [-0.03, 0.01]) < 1e-3, "{told:?}");
    }

    #[test]
    fn a_touch_that_slides_is_followed_at_both_places() {
        let (places, mut hypotheses) = follower();
        for frame in 0..100_u64 {
            let x = 0.03 - 5e-4 * frame as f64;
            // At the centre, the mirror image of the touch is the touch itself.
            let share = 0.5 + 0.25 * (frame as f64 * 7.77).sin();
            let drawn = bells(&places, &[([x, 0.02], share, 0.004), ([-x, -0.02], 1.0 - share, 0.004)]);
            let told = hypotheses.follow(frame * FRAME_NS, &drawn).unwrap();
            let side = told.leading.position_m[1].signum();
            let expected = [side * x, side * 0.02];
            assert!(distance(told.leading.position_m, expected) < 1e-3, "frame {frame}: {told:?}");
            let other = told.other.expect("the other side").position_m;
            assert!(distance(other, expected.map(|v| -v)) < 1e-3, "frame {frame}: {told:?}");
        }
    }

    #[test]
    fn candidates_without_probability_carry_no_information() {
        let (places, mut hypotheses) = follower();
        for odd in [vec![0.0; places.len()], vec![f64::NAN; places.len()], vec![1.0; 3]] {
            assert!(hypotheses.follow(0, &odd).is_none());
        }
        assert!(PlaceHypotheses::new(PlaceModes::new(&[], 0.02)).follow(0, &[]).is_none());
        let mut one = PlaceHypotheses::new(PlaceModes::new(&[[0.01, 0.02]], 0.02));
        assert_eq!(one.follow(0, &[1.0]).unwrap().leading.position_m, [0.01, 0.02]);
    }
}
