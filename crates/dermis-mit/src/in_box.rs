//! Quadratic functions in a box: minimises `t'Ht/2 - b't` over `0 <= t <= limit` with positive definite H. Each
//! unknown is free or on a bound. All unknowns on the wrong side change over at once, or one at a time if that makes
//! no progress (block principal pivoting: Judice and Pires, Computers and Operations Research 21, 1994, 587). Under a
//! touch few unknowns are free, and few changes lead from the last frame's set to the current one.

use faer::linalg::solvers::Llt;
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::prelude::Solve;
use faer::{Mat, Par, Side};

/// Violations of the box or of the sign of a slope on a bound below this share of the limit are rounding errors.
const ROUNDING: f64 = 1e-10;
/// Number of consecutive changes of all unknowns without progress before switching to one at a time.
const PATIENCE: usize = 3;
/// Maximum number of sweeps of coordinate descent, the fallback if pivoting does not terminate.
const MOST_SWEEPS: usize = 2000;
/// Coordinate descent ends if no unknown moves by more than this share of the limit.
const SETTLED: f64 = 1e-9;

/// Position of an unknown.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Place {
    Lower,
    Free,
    Upper,
}

/// The minimum; H is row-major with both triangles. `start` should be close to it.
pub(crate) fn in_box(normal: &[f64], b: &[f64], start: &[f64], limit: f64) -> Vec<f64> {
    by_pivoting(normal, b, start, limit).unwrap_or_else(|| by_descent(normal, b, start, limit))
}

fn by_pivoting(normal: &[f64], b: &[f64], start: &[f64], limit: f64) -> Option<Vec<f64>> {
    let count = b.len();
    let place = |t: &f64| match *t {
        t if t <= 0.0 => Place::Lower,
        t if t >= limit => Place::Upper,
        _ => Place::Free,
    };
    let mut places: Vec<Place> = start.iter().map(place).collect();
    let (mut fewest, mut patience) = (count + 1, PATIENCE);
    for _ in 0..10 * (count + 1) {
        let t = minimum_of(normal, b, &places, limit)?;
        let slope =
            |k: usize| normal[k * count..(k + 1) * count].iter().zip(&t).map(|(h, t)| h * t).sum::<f64>() - b[k];
        let wanted = |k: usize| {
            let (rounding, diagonal) = (ROUNDING * limit, normal[k * count + k]);
            match places[k] {
                Place::Free if t[k] < -rounding => Place::Lower,
                Place::Free if t[k] > limit + rounding => Place::Upper,
                Place::Lower if slope(k) < -rounding * diagonal => Place::Free,
                Place::Upper if slope(k) > rounding * diagonal => Place::Free,
                stays => stays,
            }
        };
        let changes: Vec<(usize, Place)> =
            (0..count).map(|k| (k, wanted(k))).filter(|(k, place)| *place != places[*k]).collect();
        let Some(last) = changes.last().copied() else {
            return Some(t.iter().map(|t| t.clamp(0.0, limit)).collect());
        };
        let is_better = changes.len() < fewest;
        if is_better || patience > 0 {
            patience = if is_better { PATIENCE } else { patience - 1 };
            fewest = fewest.min(changes.len());
            changes.iter().for_each(|&(k, place)| places[k] = place);
        } else {
            places[last.0] = last.1;
        }
    }
    None
}

/// The minimum over the free unknowns with the others on their bounds; `None` if H is not positive definite.
fn minimum_of(normal: &[f64], b: &[f64], places: &[Place], limit: f64) -> Option<Vec<f64>> {
    let count = b.len();
    let of = |place: Place| -> Vec<usize> { (0..count).filter(|&k| places[k] == place).collect() };
    let (free, upper) = (of(Place::Free), of(Place::Upper));
    let mut t = vec![0.0; count];
    upper.iter().for_each(|&k| t[k] = limit);
    if free.is_empty() {
        return Some(t);
    }
    let matrix = Mat::from_fn(free.len(), free.len(), |i, j| normal[free[i] * count + free[j]]);
    let right = Mat::from_fn(free.len(), 1, |i, _| {
        b[free[i]] - limit * upper.iter().map(|&k| normal[free[i] * count + k]).sum::<f64>()
    });
    let solution = Llt::new(matrix.as_ref(), Side::Lower).ok()?.solve(right);
    free.iter().enumerate().for_each(|(i, &k)| t[k] = solution[(i, 0)]);
    Some(t)
}

/// Minimises by coordinate descent (Franc, Hlavac and Navara 2005).
fn by_descent(normal: &[f64], b: &[f64], start: &[f64], limit: f64) -> Vec<f64> {
    let count = b.len();
    let mut t = start.to_vec();
    for _ in 0..MOST_SWEEPS {
        let mut moved: f64 = 0.0;
        for (i, row) in normal.chunks_exact(count).enumerate() {
            let slope = row.iter().zip(&t).map(|(h, t)| h * t).sum::<f64>() - b[i];
            let next = (t[i] - slope / row[i]).clamp(0.0, limit);
            moved = moved.max((next - t[i]).abs());
            t[i] = next;
        }
        if moved <= SETTLED * limit {
            break;
        }
    }
    t
}

/// Standard deviations: square roots of the diagonal of the inverse over the bodies that moved; for each other body,
/// over those and itself.
pub(crate) fn deviations(normal: &[f64], travel: &[f64]) -> Vec<f64> {
    let count = travel.len();
    let free: Vec<usize> = (0..count).filter(|&k| travel[k] > 0.0).collect();
    let deviation = |variance: f64| variance.max(f64::MIN_POSITIVE).sqrt();
    let matrix = Mat::from_fn(free.len(), free.len(), |i, j| normal[free[i] * count + free[j]]);
    // Let L be the factor over the free unknowns. Their variances are the squared columns of its inverse; for the
    // others, subtract the squares of L^-1 h_k from h_kk.
    let mut columns = Mat::from_fn(free.len(), count, |i, k| {
        if travel[k] > 0.0 { f64::from(u8::from(free[i] == k)) } else { normal[free[i] * count + k] }
    });
    if !free.is_empty() {
        let Ok(factor) = Llt::new(matrix.as_ref(), Side::Lower) else { return vec![f64::INFINITY; count] };
        solve_lower_triangular_in_place(factor.L(), columns.as_mut(), Par::Seq);
    }
    let squares = |k: usize| columns.col(k).iter().map(|value| value * value).sum::<f64>();
    let variance = |k: usize| {
        if travel[k] > 0.0 { squares(k) } else { 1.0 / (normal[k * count + k] - squares(k)).max(f64::MIN_POSITIVE) }
    };
    (0..count).map(|k| deviation(variance(k))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A well-conditioned matrix `A'A + I/10` and a right-hand side, from a deterministic sequence.
    fn problem(count: usize, seed: u64) -> (Vec<f64>, Vec<f64>) {
        let mut state = seed;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
        };
        let a: Vec<f64> = (0..count * count).map(|_| next()).collect();
        let entry = |i: usize, j: usize| (0..count).map(|k| a[k * count + i] * a[k * count + j]).sum::<f64>();
        let mut normal: Vec<f64> = (0..count * count).map(|k| entry(k / count, k % count)).collect();
        (0..count).for_each(|k| normal[k * count + k] += 0.1);
        let b = (0..count).map(|_| 3.0 * next()).collect();
        (normal, b)
    }

    #[test]
    fn pivoting_ends_at_the_minimum_wherever_it_starts() {
        let limit = 0.4;
        for (count, seed) in [(1, 1), (2, 2), (7, 3), (30, 4), (64, 5)] {
            let (normal, b) = problem(count, seed);
            for start in [0.0, 0.1, limit] {
                let t = by_pivoting(&normal, &b, &vec![start; count], limit).unwrap();
                for (k, row) in normal.chunks_exact(count).enumerate() {
                    // The Karush-Kuhn-Tucker conditions, up to rounding of sums of several dozen entries of order 10.
                    let slope = row.iter().zip(&t).map(|(h, t)| h * t).sum::<f64>() - b[k];
                    assert!((0.0..=limit).contains(&t[k]));
                    assert!(t[k] == 0.0 || slope < 1e-8, "{count} {k}: {slope}");
                    assert!(t[k] == limit || slope > -1e-8, "{count} {k}: {slope}");
                }
            }
        }
    }

    #[test]
    fn descent_ends_there_too() {
        let (normal, b) = problem(6, 7);
        let (t, other) = (in_box(&normal, &b, &[0.0; 6], 0.4), by_descent(&normal, &b, &[0.0; 6], 0.4));
        // Steps end below 1e-9 of the limit, times the condition number of the matrix.
        t.iter().zip(&other).for_each(|(a, b)| assert!((a - b).abs() < 1e-6, "{t:?} {other:?}"));
    }

    #[test]
    fn deviations_agree_with_the_inverse() {
        let (normal, _) = problem(5, 9);
        let travel = [0.1, 0.0, 0.2, 0.0, 0.1];
        let found = deviations(&normal, &travel);
        for k in 0..5 {
            let over: Vec<usize> = (0..5).filter(|&i| travel[i] > 0.0 || i == k).collect();
            let part = Mat::from_fn(over.len(), over.len(), |i, j| normal[over[i] * 5 + over[j]]);
            let unit = Mat::from_fn(over.len(), 1, |i, _| f64::from(u8::from(over[i] == k)));
            let column = part.partial_piv_lu().solve(unit);
            let at = over.iter().position(|&i| i == k).unwrap();
            assert!((found[k] / column[(at, 0)].sqrt() - 1.0).abs() < 1e-9, "{k}");
        }
    }
}
