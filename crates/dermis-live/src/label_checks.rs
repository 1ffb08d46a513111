//! Checks whether the positions of pokes belong to their frames. Labels may lag by a row, axes may be mirrored or
//! rotated, and tables may be unrelated. All three occur in published data.
//!
//! There are two measures. *Neighbours*: similar frames should come from pokes close together. Each poke's position
//! is predicted from the pokes whose difference data, scaled to unit length, are nearest to its own. The median error
//! is compared with that of shuffled labels (a permutation test). This needs no model, but cannot distinguish a
//! mirrored table from the right one. *Signatures*: the cosine between a frame's difference and the model's
//! prediction for a press at its label. This identifies mirrored and rotated axes if the model is roughly right.

use dermis_tomo::mesh::{Point, distance};
use rayon::prelude::*;

use crate::Error;
use crate::calibration::{PokeFrames, Pokes, differences_of};
use crate::prepare::Prepared;

/// Minimum number of pokes for a permutation test: with fewer neighbours, chance does as well.
const FEWEST: usize = 12;
/// Maximum number of pokes compared, evenly drawn, since every pair is compared.
const MOST: usize = 600;
/// Number of neighbours that predict a position.
const NEIGHBOURS: usize = 3;
/// Number of shuffles of the labels; p-values down to 1/200.
const SHUFFLES: usize = 199;
/// Largest p-value at which labels still count as belonging to their frames.
const LARGEST_P: f64 = 0.05;
/// Accept a shift of the labels if it lowers the median error to this share.
const SHIFT_GAIN: f64 = 0.7;
/// Numbers of rows by which labels may lag or lead.
const SHIFTS: [i64; 4] = [1, -1, 2, -2];
/// Accept a mirrored or rotated table if it raises the mean cosine by this much.
const TURN_GAIN: f64 = 0.2;
/// Minimum mean cosine for the model to count as roughly right.
const TURN_LEAST: f64 = 0.4;

/// Findings about the labels of pokes.
#[derive(Debug, Clone, PartialEq)]
pub struct LabelFindings {
    /// Share of shuffled labels that fit the frames as well; `None` for fewer than 12 pokes.
    pub p_value: Option<f64>,
    /// Median error of positions predicted from similar frames, metres.
    pub neighbour_error_m: f64,
    /// Number of rows by which the labels lag behind the frames, if shifted labels fit far better; negative if they
    /// lead.
    pub lag_rows: Option<i64>,
    /// Mirroring or rotation of the axes, if that fits the model far better.
    pub turned: Option<Turn>,
}

impl LabelFindings {
    /// True if positions and frames are unrelated, even when shifted by a row.
    pub fn is_unrelated(&self) -> bool {
        self.lag_rows.is_none() && self.p_value.is_some_and(|p| p > LARGEST_P)
    }
}

/// A symmetry of the axes about the centre of the skin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Turn {
    /// Description, such as `y looks mirrored`.
    pub words: &'static str,
    matrix: [[i8; 2]; 2],
}

impl Turn {
    const ALL: [Self; 7] = [
        Self { words: "y looks mirrored", matrix: [[1, 0], [0, -1]] },
        Self { words: "x looks mirrored", matrix: [[-1, 0], [0, 1]] },
        Self { words: "positions look rotated by 180 degrees", matrix: [[-1, 0], [0, -1]] },
        Self { words: "x and y look swapped", matrix: [[0, 1], [1, 0]] },
        Self { words: "positions look rotated by 90 degrees counter-clockwise", matrix: [[0, 1], [-1, 0]] },
        Self { words: "positions look rotated by 90 degrees clockwise", matrix: [[0, -1], [1, 0]] },
        Self { words: "x and y look swapped and mirrored", matrix: [[0, -1], [-1, 0]] },
    ];

    /// The position of a label with this symmetry undone.
    pub fn undone(self, [x, y]: Point) -> Point {
        self.matrix.map(|[a, b]| f64::from(a) * x + f64::from(b) * y)
    }
}

/// Checks the labels of pokes.
///
/// # Errors
/// Frames that do not match the skin.
pub fn check_labels(prepared: &Prepared, measured: PokeFrames<'_>, pokes: &Pokes) -> Result<LabelFindings, Error> {
    let (_, differences) = differences_of(prepared, measured)?;
    let step = differences.len().div_ceil(MOST).max(1);
    let count = differences.len().min(pokes.positions_m.len());
    let unit: Vec<Vec<f64>> = (0..count).map(|poke| to_unit(&differences[poke])).collect();
    // Shifts need consecutive rows, so the first of many pokes are compared instead of every nth.
    let first = count.min(MOST);
    let (error_m, p_value) = permutation_test(&unit[..first], &pokes.positions_m[..first]);
    let lag_rows = lag(&unit[..first], &pokes.positions_m[..first], error_m);
    let turned = turn(prepared, &unit, &pokes.positions_m[..count], step);
    Ok(LabelFindings { p_value, neighbour_error_m: error_m, lag_rows, turned })
}

/// Scaled to unit length, with missing channels as zero.
fn to_unit(difference: &[f64]) -> Vec<f64> {
    let finite = |value: &f64| if value.is_finite() { *value } else { 0.0 };
    let length = difference.iter().map(finite).map(|value| value * value).sum::<f64>().sqrt();
    difference.iter().map(|value| finite(value) / length.max(f64::MIN_POSITIVE)).collect()
}

fn cosine(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// For each poke, the pokes with the most similar frames.
fn neighbours(unit: &[Vec<f64>]) -> Vec<Vec<usize>> {
    (0..unit.len())
        .into_par_iter()
        .map(|poke| {
            let mut others: Vec<(f64, usize)> = (0..unit.len())
                .filter(|other| *other != poke)
                .map(|other| (cosine(&unit[poke], &unit[other]), other))
                .collect();
            if others.len() > NEIGHBOURS {
                others.select_nth_unstable_by(NEIGHBOURS, |a, b| b.0.total_cmp(&a.0));
            }
            others.into_iter().take(NEIGHBOURS).map(|(_, other)| other).collect()
        })
        .collect()
}

/// Median distance between labels and their prediction from the neighbours' labels.
fn error_m(neighbours: &[Vec<usize>], labels_m: &[Point]) -> f64 {
    let mut errors: Vec<f64> = neighbours
        .iter()
        .enumerate()
        .filter(|(_, near)| !near.is_empty())
        .map(|(poke, near)| {
            let mean = |axis: usize| near.iter().map(|other| labels_m[*other][axis]).sum::<f64>() / near.len() as f64;
            distance([0, 1].map(mean), labels_m[poke])
        })
        .collect();
    if errors.is_empty() {
        return f64::NAN;
    }
    let middle = errors.len() / 2;
    *errors.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn permutation_test(unit: &[Vec<f64>], labels_m: &[Point]) -> (f64, Option<f64>) {
    let near = neighbours(unit);
    let found = error_m(&near, labels_m);
    if unit.len() < FEWEST {
        return (found, None);
    }
    let mut random = 1;
    let mut shuffled = labels_m.to_vec();
    let as_good = (0..SHUFFLES)
        .filter(|_| {
            shuffle(&mut shuffled, &mut random);
            error_m(&near, &shuffled) <= found
        })
        .count();
    (found, Some((as_good + 1) as f64 / (SHUFFLES + 1) as f64))
}

/// Fisher-Yates shuffle with SplitMix64 numbers; the modulus is biased towards small ones by less than one part in
/// 10^16.
fn shuffle(labels: &mut [[f64; 2]], state: &mut u64) {
    for last in (1..labels.len()).rev() {
        *state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = *state;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^= bits >> 31;
        labels.swap(last, (bits % (last as u64 + 1)) as usize);
    }
}

/// Number of rows by which labels lag, if shifted ones fit far better and the shifted table passes the permutation
/// test.
fn lag(unit: &[Vec<f64>], labels_m: &[Point], found_m: f64) -> Option<i64> {
    if unit.len() < FEWEST + 2 {
        return None;
    }
    let shifted = |rows: i64| {
        // The label of frame k is in row k + rows.
        let ahead = rows.unsigned_abs() as usize;
        if rows > 0 {
            (&unit[..unit.len() - ahead], &labels_m[ahead..])
        } else {
            (&unit[ahead..], &labels_m[..labels_m.len() - ahead])
        }
    };
    let error_of = |rows: i64| {
        let (unit, labels_m) = shifted(rows);
        error_m(&neighbours(unit), labels_m)
    };
    let (error_m, rows) = SHIFTS.into_iter().map(|rows| (error_of(rows), rows)).min_by(|a, b| a.0.total_cmp(&b.0))?;
    let better = (error_m < SHIFT_GAIN * found_m).then(|| shifted(rows));
    let (_, p_value) = better.map(|(unit, labels_m)| permutation_test(unit, labels_m))?;
    p_value.filter(|p_value| *p_value <= LARGEST_P).map(|_| rows)
}

/// The symmetry of the axes that fits the model far better than the labels as they are.
fn turn(prepared: &Prepared, unit: &[Vec<f64>], labels_m: &[Point], step: usize) -> Option<Turn> {
    if !prepared.skin.backend.wiring.is_known() || unit.len() < 5 {
        return None;
    }
    let taken: Vec<usize> = (0..unit.len()).step_by(step).collect();
    let outline = prepared.skin.outline();
    let fit = |undone: &dyn Fn(Point) -> Point| {
        let places: Vec<Point> = taken.iter().map(|poke| undone(labels_m[*poke])).collect();
        if places.iter().any(|place| !outline.contains(*place)) {
            return f64::NEG_INFINITY;
        }
        let signatures = prepared.signatures(&places);
        let channels = prepared.voltages.len();
        let cosines = signatures
            .chunks_exact(channels)
            .zip(&taken)
            .map(|(signature, poke)| cosine(&to_unit(signature), &unit[*poke]));
        cosines.sum::<f64>() / taken.len() as f64
    };
    let as_is = fit(&|label| label);
    let best = Turn::ALL
        .into_iter()
        .map(|turn| (fit(&|label| turn.undone(label)), turn))
        .max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 > TURN_LEAST && best.0 > as_is + TURN_GAIN).then_some(best.1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    /// Frames predicted by the model for presses at these positions.
    fn pressed(prepared: &Prepared, positions_m: &[Point]) -> Vec<Vec<f64>> {
        let rest = &prepared.voltages;
        let add = |signature: &[f64]| rest.iter().zip(signature).map(|(v, s)| v + 0.1 * s).collect();
        prepared.signatures(positions_m).chunks_exact(rest.len()).map(add).collect()
    }

    #[test]
    fn mirrored_shifted_and_unrelated_labels_are_distinguished() {
        let prepared = Prepared::new(Skin::open("ionic-disc").unwrap()).unwrap();
        // In random order: neighbours in the table are not neighbours on the skin.
        let place = |k: usize| [1e-3 * ((k * 37 % 83) as f64 - 40.0), 1e-3 * ((k * 53 % 71) as f64 - 30.0) * 0.8];
        let places: Vec<Point> = (0..60).map(place).collect();
        let frames = pressed(&prepared, &places);
        let rest = prepared.voltages.clone();
        let check = |positions_m: Vec<Point>| {
            let measured = PokeFrames::Readings { baselines: std::slice::from_ref(&rest), frames: &frames };
            check_labels(&prepared, measured, &Pokes { positions_m, further_m: Vec::new(), loads: None }).unwrap()
        };
        let right = check(places.clone());
        assert!(right.p_value.unwrap() <= 0.01 && right.lag_rows.is_none() && right.turned.is_none(), "{right:?}");
        let mirrored = check(places.iter().map(|[x, y]| [*x, -y]).collect());
        assert_eq!(mirrored.turned.unwrap().words, "y looks mirrored");
        let turned = check(places.iter().map(|[x, y]| [-y, *x]).collect());
        assert_eq!(turned.turned.unwrap().words, "positions look rotated by 90 degrees counter-clockwise");
        let mut lagging = places.clone();
        lagging.rotate_right(1);
        assert_eq!(check(lagging).lag_rows, Some(1));
        let unrelated: Vec<[f64; 2]> = (0..60).map(|k| place(k * 11 + 7)).collect();
        assert!(check(unrelated).is_unrelated());
        assert!(!right.is_unrelated());
    }
}
