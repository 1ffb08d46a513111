//! Columns that are multiples of each other. Reciprocal channels (drive and measurement swapped) have the same
//! sensitivities, so in most protocols half of the columns repeat the other half; common columns are multiplied only
//! once.

use faer::{Mat, MatRef};

/// Maximum difference between two unit columns that counts as rounding.
const TOLERANCE: f64 = 1e-11;

/// The groups of columns that are multiples of each other: `a_c = share[c] m_group[c]`. The shares of a group have
/// unit norm, so `m` and its orthogonal complement in the group form an orthonormal change of channels.
#[derive(Clone, Debug)]
pub(super) struct ReciprocalColumns {
    /// Group of each column.
    pub(super) group: Vec<usize>,
    /// Share of each column in its group.
    pub(super) share: Vec<f64>,
    /// The longest column of each group, and the factor that turns it into `m`.
    representatives: Vec<(usize, f64)>,
}

impl ReciprocalColumns {
    /// Groups the columns of `matrix`.
    pub(super) fn of_columns(matrix: MatRef<'_, f64>) -> Self {
        Self::of_scaled_columns(matrix, |_| 1.0)
    }

    /// Groups the columns of `matrix`, each multiplied by its own scale.
    pub(super) fn of_scaled_columns(matrix: MatRef<'_, f64>, scale: impl Fn(usize) -> f64) -> Self {
        let probe = Mat::from_fn(matrix.nrows(), 1, |k, _| probe(k));
        // Proportional columns have the same direction cosine with any fixed vector, except for the sign.
        let cosines = matrix.transpose() * &probe;
        let norms: Vec<f64> = (0..matrix.ncols()).map(|column| sum_of_squares(matrix, column).sqrt()).collect();
        let cosine = |column: usize| if norms[column] > 0.0 { cosines[(column, 0)] / norms[column] } else { 0.0 };
        let mut order: Vec<(f64, usize)> = (0..matrix.ncols()).map(|column| (cosine(column).abs(), column)).collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));

        let mut members: Vec<Vec<usize>> = Vec::new();
        for (_, column) in order {
            match members.last_mut() {
                Some(others) if is_multiple(matrix, others[0], column, &norms) => others.push(column),
                _ => members.push(vec![column]),
            }
        }
        // Keep the order of the columns, so that channels adjacent in time stay together.
        members.iter_mut().for_each(|columns| columns.sort_unstable());
        members.sort_by_key(|columns| columns[0]);
        let (mut group, mut share) = (vec![0; matrix.ncols()], vec![0.0; matrix.ncols()]);
        let mut representatives = Vec::with_capacity(members.len());
        for (index, columns) in members.iter().enumerate() {
            let signed = |column: usize| cosine(column).signum() * norms[column] * scale(column);
            let length = columns.iter().map(|&column| signed(column).powi(2)).sum::<f64>().sqrt();
            let longest = columns.iter().copied().max_by(|&a, &b| signed(a).abs().total_cmp(&signed(b).abs()));
            for &column in columns {
                group[column] = index;
                // Columns that are all zero: any unit vector will do.
                share[column] =
                    if length > 0.0 { signed(column) / length } else { (columns.len() as f64).sqrt().recip() };
            }
            let longest = longest.unwrap_or(columns[0]);
            representatives.push((longest, scale(longest) / share[longest]));
        }
        Self { group, share, representatives }
    }

    /// Number of groups.
    pub(super) fn count(&self) -> usize {
        self.representatives.len()
    }

    /// Number of columns.
    pub(super) fn columns(&self) -> usize {
        self.group.len()
    }

    /// `m`: one column per group.
    pub(super) fn merged(&self, matrix: MatRef<'_, f64>) -> Mat<f64> {
        let columns: Vec<_> = self.representatives.iter().map(|&(column, scale)| (matrix.col(column), scale)).collect();
        Mat::from_fn(matrix.nrows(), self.count(), |row, group| columns[group].1 * columns[group].0[row])
    }

    /// Expands one column per group to one column per channel: `a_c = share[c] m_group[c]`.
    pub(super) fn expanded(&self, merged: MatRef<'_, f64>) -> Mat<f64> {
        Mat::from_fn(merged.nrows(), self.columns(), |row, column| {
            self.share[column] * merged[(row, self.group[column])]
        })
    }

    /// Expands a matrix over groups (rows and columns) to one over columns, with `outside` on the diagonal of the
    /// complement orthogonal to the groups.
    pub(super) fn expanded_square(&self, merged: MatRef<'_, f64>, outside: f64) -> Mat<f64> {
        let count = self.group.len();
        Mat::from_fn(count, count, |row, column| {
            let (a, b) = (self.group[row], self.group[column]);
            let product = self.share[row] * self.share[column];
            let rest = if a == b { outside * (f64::from(u8::from(row == column)) - product) } else { 0.0 };
            product * merged[(a, b)] + rest
        })
    }
}

fn sum_of_squares(matrix: MatRef<'_, f64>, column: usize) -> f64 {
    let column = matrix.col(column);
    column.transpose() * column
}

/// True if two columns point in the same or opposite directions.
fn is_multiple(matrix: MatRef<'_, f64>, first: usize, second: usize, norms: &[f64]) -> bool {
    let (a, b) = (matrix.col(first), matrix.col(second));
    let usable = |norm: f64| norm > 0.0 && norm.is_finite();
    if !(usable(norms[first]) && usable(norms[second])) {
        return false;
    }
    let (p, q) = (norms[first].recip(), (a.transpose() * b).signum() * norms[second].recip());
    a.iter().zip(b.iter()).all(|(a, b)| (a * p - b * q).abs() <= TOLERANCE)
}

/// A fixed vector without symmetry: fractional parts of multiples of the golden ratio.
fn probe(k: usize) -> f64 {
    (k as f64 * 0.618_033_988_749_894_9 + 0.25).fract() + 0.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn multiples_are_found_with_their_signs_and_lengths() {
        let columns = [[1.0, 2.0, 2.0], [0.0, 1.0, 0.0], [-4.0, -8.0, -8.0], [0.0, 0.0, 0.0], [1.0, 2.0, 2.000001]];
        let matrix = Mat::from_fn(3, columns.len(), |row, column| columns[column][row]);
        let found = ReciprocalColumns::of_columns(matrix.as_ref());
        assert_eq!(found.group, [0, 1, 0, 2, 3]);
        assert_eq!(found.count(), 4);
        let back = found.expanded(found.merged(matrix.as_ref()).as_ref());
        assert!((&back - &matrix).norm_max() < 1e-14);
        assert!((found.share[0].powi(2) + found.share[2].powi(2) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn scales_are_part_of_the_columns() {
        let columns = [[1.0, 2.0], [3.0, -1.0], [2.0, 4.0], [1.0, 2.0]];
        let scales = [0.5, 2.0, 3.0, 0.0];
        let matrix = Mat::from_fn(2, 4, |row, column| columns[column][row]);
        let scaled = Mat::from_fn(2, 4, |row, column| columns[column][row] * scales[column]);
        let found = ReciprocalColumns::of_scaled_columns(matrix.as_ref(), |column| scales[column]);
        assert_eq!(found.group, [0, 1, 0, 0]);
        assert!((found.expanded(found.merged(matrix.as_ref()).as_ref()) - scaled).norm_max() < 1e-14);
    }

    #[test]
    fn a_square_matrix_expands_to_the_one_it_stands_for() {
        let columns = [[1.0, 2.0], [3.0, -1.0], [2.0, 4.0]];
        let matrix = Mat::from_fn(2, 3, |row, column| columns[column][row]);
        let found = ReciprocalColumns::of_columns(matrix.as_ref());
        let merged = found.merged(matrix.as_ref());
        let gram = found.expanded_square((merged.transpose() * &merged).as_ref(), 0.0);
        assert!((&gram - matrix.transpose() * &matrix).norm_max() < 1e-12);
    }
}
