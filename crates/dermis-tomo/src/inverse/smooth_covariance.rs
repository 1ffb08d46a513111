//! Covariances of smooth images: scaled Gaussian correlations between places. On a lattice (pixels) they are the
//! product of one correlation along x and one along y, so no pixels x pixels matrix is stored or multiplied.

use faer::linalg::matmul::matmul;
use faer::reborrow::Reborrow;
use faer::{Accum, Mat, MatRef, Par};

use super::InverseError;
use super::error::positive;
use crate::mesh::{dot, subtract};

/// Exponent beyond which (6 lengths) correlations are below 2e-8 and are stored as zero in the explicit form.
const LEAST_EXPONENT: f64 = -18.0;
/// Maximum number of lattice sites per unknown.
const MOST_SITES: usize = 8;
/// Coordinates that differ by less than this share of the correlation length are considered equal.
const SAME: f64 = 1e-6;

/// `C_ij = s_i s_j exp(-d_ij^2 / 2 l^2)` for places at distance d, with correlation length l and a scale s for each
/// place.
#[derive(Clone, Debug)]
pub struct SmoothCovariance {
    scale: Vec<f64>,
    correlations: Correlations,
}

#[derive(Clone, Debug)]
enum Correlations {
    /// Column and row of each place, the correlations between columns, and those between rows.
    Lattice { sites: Vec<[u32; 2]>, between_columns: Mat<f64>, between_rows: Mat<f64> },
    /// Correlations between all places.
    All(Mat<f64>),
}

impl SmoothCovariance {
    /// Covariance over `positions`, metres, with the given scale of each place, or 1 for all.
    ///
    /// # Errors
    /// A length that is not positive and finite.
    pub fn new(positions: &[[f64; 3]], length_m: f64, scale: Option<Vec<f64>>) -> Result<Self, InverseError> {
        positive("correlation length (m)", length_m)?;
        let scale = scale.unwrap_or_else(|| vec![1.0; positions.len()]);
        let correlations = Correlations::on_lattice(positions, length_m)
            .unwrap_or_else(|| Correlations::All(all_correlations(positions, length_m)));
        Ok(Self { scale, correlations })
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.scale.len()
    }

    /// True if there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.scale.is_empty()
    }

    /// Variance of an unknown.
    pub fn variance(&self, unknown: usize) -> f64 {
        self.scale[unknown] * self.scale[unknown]
    }

    /// Covariances of an unknown with all unknowns.
    pub fn column(&self, unknown: usize) -> Vec<f64> {
        let scaled = |k: usize, correlation: f64| self.scale[unknown] * self.scale[k] * correlation;
        match &self.correlations {
            Correlations::Lattice { sites, between_columns, between_rows } => {
                let [x, y] = sites[unknown].map(|at| at as usize);
                let correlation =
                    |site: &[u32; 2]| between_columns[(site[0] as usize, x)] * between_rows[(site[1] as usize, y)];
                sites.iter().enumerate().map(|(k, site)| scaled(k, correlation(site))).collect()
            }
            Correlations::All(matrix) => (0..self.len()).map(|k| scaled(k, matrix[(k, unknown)])).collect(),
        }
    }

    /// The dense matrix.
    pub fn dense(&self) -> Mat<f64> {
        let mut matrix = Mat::zeros(self.len(), self.len());
        for (unknown, column) in matrix.col_iter_mut().enumerate() {
            column.iter_mut().zip(self.column(unknown)).for_each(|(entry, value)| *entry = value);
        }
        matrix
    }

    /// `C B` for B with one row per unknown.
    pub fn times(&self, b: MatRef<'_, f64>) -> Mat<f64> {
        let scaled = |mut matrix: Mat<f64>| {
            for column in matrix.col_iter_mut() {
                column.iter_mut().zip(&self.scale).for_each(|(entry, scale)| *entry *= scale);
            }
            matrix
        };
        let b = scaled(b.to_owned());
        match &self.correlations {
            Correlations::Lattice { sites, between_columns, between_rows } => {
                scaled(on_lattice(sites, between_columns, between_rows, b))
            }
            Correlations::All(matrix) => scaled(matrix * b),
        }
    }
}

/// Transforms each column of B on the lattice, along x and then along y.
fn on_lattice(sites: &[[u32; 2]], between_columns: &Mat<f64>, between_rows: &Mat<f64>, mut b: Mat<f64>) -> Mat<f64> {
    let (columns, rows) = (between_columns.nrows(), between_rows.nrows());
    let (mut lattice, mut along_x) = (Mat::zeros(columns, rows), Mat::zeros(columns, rows));
    for column in b.col_iter_mut() {
        lattice.fill(0.0);
        for (site, value) in sites.iter().zip(column.rb().iter()) {
            lattice[(site[0] as usize, site[1] as usize)] += value;
        }
        matmul(along_x.as_mut(), Accum::Replace, between_columns, &lattice, 1.0, Par::Seq);
        matmul(lattice.as_mut(), Accum::Replace, &along_x, between_rows, 1.0, Par::Seq);
        for (site, value) in sites.iter().zip(column.iter_mut()) {
            *value = lattice[(site[0] as usize, site[1] as usize)];
        }
    }
    b
}

impl Correlations {
    /// `Some` if the places lie in one plane of equal z, on the crossings of not too many columns and rows.
    fn on_lattice(positions: &[[f64; 3]], length_m: f64) -> Option<Self> {
        let same = SAME * length_m;
        let first = positions.first()?;
        if positions.iter().any(|p| (p[2] - first[2]).abs() > same) {
            return None;
        }
        let most = MOST_SITES.checked_mul(positions.len())?;
        let [x, y] = [0, 1].map(|axis| distinct(positions.iter().map(|p| p[axis]).collect(), same));
        if x.len().checked_mul(y.len())? > most {
            return None;
        }
        let index = |values: &[f64], at: f64| values.partition_point(|v| *v < at - same) as u32;
        let sites = positions.iter().map(|p| [index(&x, p[0]), index(&y, p[1])]).collect();
        let between = |values: &[f64]| {
            Mat::from_fn(values.len(), values.len(), |i, j| (-0.5 * ((values[i] - values[j]) / length_m).powi(2)).exp())
        };
        Some(Self::Lattice { sites, between_columns: between(&x), between_rows: between(&y) })
    }
}

/// Sorted values, without those within `same` of their predecessor.
fn distinct(mut values: Vec<f64>, same: f64) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values.dedup_by(|next, kept| *next - *kept <= same);
    values
}

fn all_correlations(positions: &[[f64; 3]], length_m: f64) -> Mat<f64> {
    let factor = -0.5 / (length_m * length_m);
    let mut matrix = Mat::zeros(positions.len(), positions.len());
    for column in 0..positions.len() {
        for row in column..positions.len() {
            let offset = subtract(positions[row], positions[column]);
            let exponent = factor * dot(offset, offset);
            let value = if exponent > LEAST_EXPONENT { exponent.exp() } else { 0.0 };
            matrix[(row, column)] = value;
            matrix[(column, row)] = value;
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels of a disc on a grid of 0.7 mm by 0.5 mm, in scrambled order.
    fn disc() -> Vec<[f64; 3]> {
        let all = (0..400_usize).map(|i| (i * 147) % 400);
        let place = |i: usize| [7e-4 * ((i % 20) as f64 - 9.5), 5e-4 * ((i / 20) as f64 - 9.5), 2e-3];
        all.map(place).filter(|p| p[0].hypot(p[1]) < 5e-3).collect()
    }

    fn close(a: MatRef<'_, f64>, b: MatRef<'_, f64>, tolerance: f64) {
        assert_eq!((a.nrows(), a.ncols()), (b.nrows(), b.ncols()));
        for (i, j) in (0..a.nrows()).flat_map(|i| (0..a.ncols()).map(move |j| (i, j))) {
            assert!((a[(i, j)] - b[(i, j)]).abs() <= tolerance, "{} and {} at {i}, {j}", a[(i, j)], b[(i, j)]);
        }
    }

    #[test]
    fn a_lattice_gives_the_same_result_as_all_pairs() {
        let positions = disc();
        let scale: Vec<f64> = (0..positions.len()).map(|k| 1.0 + 0.1 * (k % 7) as f64).collect();
        let lattice = SmoothCovariance::new(&positions, 1.3e-3, Some(scale.clone())).unwrap();
        assert!(matches!(lattice.correlations, Correlations::Lattice { .. }));
        let correlations = Correlations::All(all_correlations(&positions, 1.3e-3));
        let pairs = SmoothCovariance { scale, correlations };
        // The explicit form drops correlations below 2e-8.
        close(lattice.dense().as_ref(), pairs.dense().as_ref(), 1e-7);
        let b = Mat::from_fn(positions.len(), 3, |i, j| ((i * 31 + j * 17) % 13) as f64 - 6.0);
        close(lattice.times(b.as_ref()).as_ref(), (lattice.dense() * &b).as_ref(), 1e-10);
        close(pairs.times(b.as_ref()).as_ref(), (pairs.dense() * &b).as_ref(), 1e-10);
        assert!((lattice.variance(5) - pairs.dense()[(5, 5)]).abs() < 1e-12);
    }

    #[test]
    fn places_anywhere_are_taken_in_pairs() {
        let scattered: Vec<[f64; 3]> =
            (0..60).map(|i| [0, 1, 2].map(|k| (f64::from(i * 7 + k) * 12.9898).sin() * 0.01)).collect();
        let covariance = SmoothCovariance::new(&scattered, 2e-3, None).unwrap();
        assert!(matches!(covariance.correlations, Correlations::All(_)));
        let flat: Vec<[f64; 3]> = scattered.iter().map(|p| [p[0], p[1], 0.0]).collect();
        let covariance = SmoothCovariance::new(&flat, 2e-3, None).unwrap();
        assert!(matches!(covariance.correlations, Correlations::All(_)));
        let expected = |i: usize, j: usize| {
            let d2 = (flat[i][0] - flat[j][0]).powi(2) + (flat[i][1] - flat[j][1]).powi(2);
            (-0.5 * d2 / 4e-6).exp()
        };
        close(covariance.dense().as_ref(), Mat::from_fn(60, 60, expected).as_ref(), 1e-7);
    }

    #[test]
    fn a_length_of_zero_is_refused() {
        for length in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(SmoothCovariance::new(&disc(), length, None).is_err(), "{length}");
        }
    }
}
