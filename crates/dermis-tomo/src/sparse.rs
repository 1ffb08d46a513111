//! Sparse symmetric positive definite systems with one structure and many sets of values. The symbolic factorisation
//! is computed once (by `faer`); each set of values costs a numeric one (multifrontal, sequential inside: parallelism
//! is over samples).

mod dissection;
mod lanes;
mod local;
mod multifrontal;
mod substitution;

use dissection::dissect;
use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{self as dense, LltRegularization};
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::linalg::{SupernodalThreshold, SymbolicSupernodalParams};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Mat, MatMut, Par, Side};
pub use local::LocalMemory;
use multifrontal::Fronts;
use substitution::{Rows, Supernodal, WIDTH};
use thiserror::Error;

use crate::memory::{self, OutOfMemory};

/// Reasons why a system cannot be factored.
#[derive(Clone, Debug, Error, PartialEq)]
#[non_exhaustive]
pub enum SparseError {
    /// A pivot was zero, negative or NaN.
    #[error("the system is singular or not positive definite (pivot {pivot} of {size})")]
    NotPositiveDefinite {
        /// Index of the pivot, in elimination order.
        pivot: usize,
        /// Size of the system.
        size: usize,
    },
    /// The factor would need more memory than allowed.
    #[error(transparent)]
    OutOfMemory(#[from] OutOfMemory),
    /// The structure itself is invalid.
    #[error("the system's structure was refused: {reason}")]
    Structure {
        /// The problem.
        reason: String,
    },
}

/// Fill-reducing elimination order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ordering<'a> {
    /// Approximate minimum degree.
    MinimumDegree,
    /// Nested dissection by coordinates: halve the largest extent, eliminate the separator last.
    Dissection(&'a [[f64; 3]]),
    /// The same, but with the listed unknowns last of all, in their order: those for which
    /// [`SpdStructure::inverse_columns`] will return columns of the inverse.
    DissectionWithLast(&'a [[f64; 3]], &'a [u32]),
}

/// Supernodes are merged if together they have at most this many columns and less than this share of zeros. Larger
/// blocks than `faer`'s default, since fronts with few columns spend more time on moving data than on arithmetic.
const RELAXATION: [(usize, f64); 4] = [(16, 1.0), (48, 0.5), (96, 0.2), (usize::MAX, 0.1)];

/// Bytes per position while the structure is built: keys, their order, slots, and the same in `faer`.
const POSITION_BYTES: f64 = 40.0;

/// The structure of a symmetric matrix and its symbolic Cholesky factorisation.
#[derive(Debug)]
pub struct SpdStructure {
    pattern: SymbolicSparseColMat<u32>,
    symbolic: SymbolicCholesky<u32>,
    fronts: Option<Fronts>,
}

/// Numeric factor; see [`SpdStructure::factor`].
#[derive(Debug)]
pub struct SpdFactor {
    values: Vec<f64>,
}

impl SpdStructure {
    /// Builds the structure from positions in the lower triangle, with repetitions allowed; upper positions are
    /// mirrored down. Every diagonal position is added. The second value maps each given position to the slot of the
    /// values array that it adds to.
    ///
    /// # Errors
    /// Positions outside the matrix, a structure too large for 32-bit indices, or a factor that needs more memory
    /// than allowed ([`memory::limit`]).
    pub fn new(size: usize, positions: &[(u32, u32)], ordering: Ordering<'_>) -> Result<(Self, Vec<u32>), SparseError> {
        let what = || format!("a system of {size} unknowns");
        memory::check(POSITION_BYTES * (positions.len() + size) as f64, what)?;
        let fold = |&(row, column): &(u32, u32)| (row.min(column), row.max(column));
        let mut keys: Vec<(u32, u32)> = positions.iter().map(fold).collect();
        if let Some(key) = keys.iter().find(|key| key.1 as usize >= size) {
            return Err(SparseError::Structure { reason: format!("position {key:?} lies outside size {size}") });
        }
        keys.extend((0..size as u32).map(|i| (i, i)));
        keys.sort_unstable();
        keys.dedup();
        let mut column_start = vec![0_u32; size + 1];
        for key in &keys {
            column_start[key.0 as usize + 1] += 1;
        }
        for column in 0..size {
            column_start[column + 1] += column_start[column];
        }
        let rows: Vec<u32> = keys.iter().map(|key| key.1).collect();
        let slots = positions
            .iter()
            .map(|position| {
                let key = fold(position);
                let (from, to) = (column_start[key.0 as usize] as usize, column_start[key.0 as usize + 1] as usize);
                // The key is present: it was inserted from the same list above.
                (from + rows[from..to].partition_point(|&row| row < key.1)) as u32
            })
            .collect();
        let order = match ordering {
            Ordering::MinimumDegree => None,
            Ordering::Dissection(coordinates) => Some(dissect(coordinates, &[], &column_start, &rows)),
            Ordering::DissectionWithLast(coordinates, last) => Some(dissect(coordinates, last, &column_start, &rows)),
        };
        let pattern = SymbolicSparseColMat::new_checked(size, size, column_start, None, rows);
        let parameters = CholeskySymbolicParams {
            supernodal_params: SymbolicSupernodalParams { relax: Some(&RELAXATION) },
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..Default::default()
        };
        let refuse = |error: faer::sparse::FaerError| SparseError::Structure { reason: format!("{error:?}") };
        let symbolic = match &order {
            None => factorize_symbolic_cholesky(pattern.as_ref(), Side::Lower, SymmetricOrdering::Amd, parameters),
            Some((forward, inverse)) => factorize_symbolic_cholesky(
                pattern.as_ref(),
                Side::Lower,
                SymmetricOrdering::Custom(PermRef::new_checked(forward, inverse, size)),
                parameters,
            ),
        }
        .map_err(refuse)?;
        let fronts = Fronts::new(&pattern, &symbolic);
        let working = fronts.as_ref().map_or(0, |fronts| fronts.working_len(&symbolic));
        memory::check(8.0 * (symbolic.len_val() + working) as f64, what)?;
        Ok((Self { pattern, symbolic, fronts }, slots))
    }

    /// Number of rows.
    pub fn size(&self) -> usize {
        self.pattern.nrows()
    }

    /// Length of the values array.
    pub fn value_count(&self) -> usize {
        self.pattern.row_idx().len()
    }

    /// Number of nonzeros in the factor, a measure of cost.
    pub fn factor_len(&self) -> usize {
        self.symbolic.len_val()
    }

    /// Multiplications of a factorisation: for each supernode of c columns and r rows, `c r^2`, which is up to three
    /// times the exact number. 0 if the factorisation is not supernodal.
    pub fn factor_operations(&self) -> f64 {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = self.symbolic.raw() else { return 0.0 };
        let of = |supernode: usize| {
            let columns = symbolic.supernode_end()[supernode] - symbolic.supernode_begin()[supernode];
            let rows = columns as usize + symbolic.supernode(supernode).pattern().len();
            f64::from(columns) * (rows as f64).powi(2)
        };
        (0..symbolic.n_supernodes()).map(of).sum()
    }

    /// Product of the symmetric matrix with a vector, for residuals.
    pub fn multiply(&self, values: &[f64], x: &[f64], y: &mut [f64]) {
        y.fill(0.0);
        let (starts, rows) = (self.pattern.col_ptr(), self.pattern.row_idx());
        for column in 0..self.size() {
            for slot in starts[column] as usize..starts[column + 1] as usize {
                let row = rows[slot] as usize;
                y[row] += values[slot] * x[column];
                if row != column {
                    y[column] += values[slot] * x[row];
                }
            }
        }
    }

    /// Adds a value to every diagonal entry.
    pub fn add_to_diagonal(&self, values: &mut [f64], amount: f64) {
        // The diagonal comes first in each column, since the lower triangle is sorted by row.
        for &start in &self.pattern.col_ptr()[..self.size()] {
            values[start as usize] += amount;
        }
    }

    /// Factors the matrix whose lower triangle is in `values`, in the slots assigned by [`SpdStructure::new`].
    ///
    /// # Errors
    /// [`SparseError::NotPositiveDefinite`], [`SparseError::OutOfMemory`].
    pub fn factor(&self, values: &[f64]) -> Result<SpdFactor, SparseError> {
        let what = || format!("the factor of a system of {} unknowns", self.size());
        let mut factor = SpdFactor { values: memory::zeros(self.symbolic.len_val(), what)? };
        self.refactor(values, &mut factor)?;
        Ok(factor)
    }

    /// As [`SpdStructure::factor`], but reuses the memory of an earlier factor of the same structure.
    ///
    /// # Errors
    /// [`SparseError::NotPositiveDefinite`].
    pub fn refactor(&self, values: &[f64], factor: &mut SpdFactor) -> Result<(), SparseError> {
        let refuse = |pivot: usize| SparseError::NotPositiveDefinite { pivot, size: self.size() };
        if let (Some(fronts), SymbolicCholeskyRaw::Supernodal(symbolic)) = (&self.fronts, self.symbolic.raw()) {
            return fronts.factor(symbolic, values, &mut factor.values).map_err(refuse);
        }
        let scratch = self.symbolic.factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let mut buffer = MemBuffer::new(scratch);
        self.symbolic
            .factorize_numeric_llt(
                &mut factor.values,
                SparseColMatRef::new(self.pattern.as_ref(), values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                MemStack::new(&mut buffer),
                Default::default(),
            )
            .map_err(|dense::LltError::NonPositivePivot { index }| refuse(index))?;
        Ok(())
    }

    /// Columns of the inverse for the given unknowns (size x unknowns): the fields of unit sources there. Fast if
    /// [`Ordering::DissectionWithLast`] put them last, correct for any.
    pub fn inverse_columns(&self, factor: &SpdFactor, unknowns: &[usize]) -> Mat<f64> {
        self.inverse_part(factor, unknowns, Rows::All)
    }

    /// Only the rows of [`SpdStructure::inverse_columns`] for the same unknowns (unknowns x unknowns).
    pub fn inverse_block(&self, factor: &SpdFactor, unknowns: &[usize]) -> Mat<f64> {
        self.inverse_part(factor, unknowns, Rows::Same)
    }

    fn inverse_part(&self, factor: &SpdFactor, unknowns: &[usize], rows: Rows) -> Mat<f64> {
        let size = self.size();
        let pick = |columns: &Mat<f64>| match rows {
            Rows::All => columns.clone(),
            Rows::Same => Mat::from_fn(unknowns.len(), unknowns.len(), |row, column| columns[(unknowns[row], column)]),
        };
        let (SymbolicCholeskyRaw::Supernodal(symbolic), Some(order)) = (self.symbolic.raw(), self.symbolic.perm())
        else {
            let mut columns = Mat::zeros(size, unknowns.len());
            unknowns.iter().enumerate().for_each(|(column, &unknown)| columns[(unknown, column)] = 1.0);
            self.solve_in_place(factor, columns.as_mut());
            return pick(&columns);
        };
        let (_, new_of_old) = order.arrays();
        let place = |unknown: usize| new_of_old[unknown] as usize;
        let first = unknowns.iter().map(|&unknown| place(unknown)).min().unwrap_or(size);
        let supernodal = Supernodal { factor: SupernodalLltRef::new(symbolic, &factor.values), first };
        let mut result = match rows {
            Rows::All => Mat::zeros(size, unknowns.len()),
            Rows::Same => Mat::zeros(unknowns.len(), unknowns.len()),
        };
        let mut x = vec![[0.0; WIDTH]; size];
        for (chunk, sources) in unknowns.chunks(WIDTH).enumerate() {
            x.fill([0.0; WIDTH]);
            sources.iter().enumerate().for_each(|(column, &unknown)| x[place(unknown)][column] = 1.0);
            supernodal.solve(&mut x, rows);
            for column in 0..sources.len() {
                let target = result.col_mut(chunk * WIDTH + column);
                match rows {
                    Rows::All => target.iter_mut().zip(new_of_old).for_each(|(to, &new)| *to = x[new as usize][column]),
                    Rows::Same => target.iter_mut().zip(unknowns).for_each(|(to, &old)| *to = x[place(old)][column]),
                }
            }
        }
        result
    }

    /// The inverse between these unknowns: its lower triangle in single precision, column by column (n, n - 1, ...
    /// values). It has its own order, which is returned first, as indices into `unknowns`. In elimination order,
    /// neither substitution looks at earlier unknowns, and no part is computed twice.
    pub fn inverse_triangle(&self, factor: &SpdFactor, unknowns: &[usize]) -> (Vec<usize>, Vec<f32>) {
        let count = unknowns.len();
        let mut order: Vec<usize> = (0..count).collect();
        let mut triangle = Vec::with_capacity(count * (count + 1) / 2);
        let (SymbolicCholeskyRaw::Supernodal(symbolic), Some(elimination)) =
            (self.symbolic.raw(), self.symbolic.perm())
        else {
            for (chunk, sources) in unknowns.chunks(WIDTH).enumerate() {
                let mut columns = Mat::zeros(self.size(), sources.len());
                sources.iter().enumerate().for_each(|(column, &unknown)| columns[(unknown, column)] = 1.0);
                self.solve_in_place(factor, columns.as_mut());
                for column in 0..sources.len() {
                    let rows = unknowns[chunk * WIDTH + column..].iter();
                    triangle.extend(rows.map(|&row| columns[(row, column)] as f32));
                }
            }
            return (order, triangle);
        };
        let (_, new_of_old) = elimination.arrays();
        order.sort_by_key(|&k| new_of_old[unknowns[k]]);
        let places: Vec<usize> = order.iter().map(|&k| new_of_old[unknowns[k]] as usize).collect();
        let mut x = vec![[0.0; WIDTH]; self.size()];
        for (chunk, sources) in places.chunks(WIDTH).enumerate() {
            x.fill([0.0; WIDTH]);
            sources.iter().enumerate().for_each(|(column, &place)| x[place][column] = 1.0);
            let factor = SupernodalLltRef::new(symbolic, &factor.values);
            Supernodal { factor, first: sources[0] }.solve(&mut x, Rows::Same);
            for column in 0..sources.len() {
                triangle.extend(places[chunk * WIDTH + column..].iter().map(|&place| x[place][column] as f32));
            }
        }
        (order, triangle)
    }

    /// Solves in place for every column of `rhs` (size x n).
    pub fn solve_in_place(&self, factor: &SpdFactor, rhs: MatMut<'_, f64>) {
        let mut buffer = MemBuffer::new(self.symbolic.solve_in_place_scratch::<f64>(rhs.ncols(), Par::Seq));
        LltRef::new(&self.symbolic, &factor.values).solve_in_place_with_conj(
            Conj::No,
            rhs,
            Par::Seq,
            MemStack::new(&mut buffer),
        );
    }

    /// Solves for every column of `rhs` (size x n), which must be zero except in the rows of these unknowns. The
    /// solution is only given in the same rows; the others stay zero.
    pub fn solve_at(&self, factor: &SpdFactor, unknowns: &[u32], mut rhs: MatMut<'_, f64>, memory: &mut LocalMemory) {
        let (SymbolicCholeskyRaw::Supernodal(symbolic), Some(order)) = (self.symbolic.raw(), self.symbolic.perm())
        else {
            self.solve_in_place(factor, rhs.as_mut());
            let mut is_wanted = vec![false; self.size()];
            unknowns.iter().for_each(|&unknown| is_wanted[unknown as usize] = true);
            let others = is_wanted.iter().enumerate().filter(|(_, is_wanted)| !**is_wanted);
            return others.for_each(|(row, _)| rhs.as_mut().row_mut(row).fill(0.0));
        };
        memory.solve(SupernodalLltRef::new(symbolic, &factor.values), order, unknowns, rhs);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;

    fn grid(n: usize) -> (Vec<[f64; 3]>, Vec<(u32, u32)>) {
        let index = |i: usize, j: usize| (i * n + j) as u32;
        let mut positions = Vec::new();
        let mut coordinates = Vec::new();
        for i in 0..n {
            for j in 0..n {
                coordinates.push([i as f64, j as f64, 0.0]);
                if i + 1 < n {
                    positions.push((index(i + 1, j), index(i, j)));
                }
                if j + 1 < n {
                    positions.push((index(i, j), index(i, j + 1)));
                }
            }
        }
        (coordinates, positions)
    }

    /// The Laplacian of a grid, grounded at its first node: structure and values.
    fn grounded_grid(n: usize, ordering: Ordering<'_>) -> (SpdStructure, Vec<f64>) {
        let (_, edges) = grid(n);
        let mut positions = edges.clone();
        positions.extend(edges.iter().flat_map(|&(a, b)| [(a, a), (b, b)]));
        positions.push((0, 0));
        let (structure, slots) = SpdStructure::new(n * n, &positions, ordering).unwrap();
        let mut values = vec![0.0; structure.value_count()];
        for (k, &slot) in slots.iter().enumerate() {
            values[slot as usize] += if k < edges.len() { -1.0 } else { 1.0 };
        }
        (structure, values)
    }

    #[test]
    fn solutions_at_a_few_unknowns_equal_those_of_the_whole_system() {
        let n = 12;
        let (structure, values) = grounded_grid(n, Ordering::Dissection(&grid(n).0));
        let factor = structure.factor(&values).unwrap();
        let (mut memory, columns) = (LocalMemory::default(), WIDTH + 3);
        for unknowns in [&[0_u32][..], &[7, 60, 61, 143], &[100]] {
            let mut whole = Mat::zeros(n * n, columns);
            for (k, &unknown) in unknowns.iter().enumerate() {
                (0..columns).for_each(|column| whole[(unknown as usize, column)] = (k + 2 * column + 1) as f64);
            }
            let mut local = whole.clone();
            structure.solve_in_place(&factor, whole.as_mut());
            structure.solve_at(&factor, unknowns, local.as_mut(), &mut memory);
            for &unknown in unknowns {
                for column in 0..columns {
                    let (a, b) = (whole[(unknown as usize, column)], local[(unknown as usize, column)]);
                    assert!((a - b).abs() < 1e-9 * a.abs(), "{unknown} {column}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn triangles_of_the_inverse_are_parts_of_its_columns() {
        let n = 9;
        let (structure, values) = grounded_grid(n, Ordering::Dissection(&grid(n).0));
        let factor = structure.factor(&values).unwrap();
        let unknowns: Vec<usize> = (0..n * n).rev().filter(|k| k % 5 != 2).collect();
        let columns = structure.inverse_columns(&factor, &unknowns);
        let (order, triangle) = structure.inverse_triangle(&factor, &unknowns);
        let mut left = triangle.iter();
        for (at, &column) in order.iter().enumerate() {
            for &row in &order[at..] {
                let (expected, got) = (columns[(unknowns[row], column)], f64::from(*left.next().unwrap()));
                // Single-precision rounding.
                assert!((got / expected - 1.0).abs() < 1e-6, "{row} {column}: {got} {expected}");
            }
        }
        assert!(left.next().is_none());
        let mut numbers = order;
        numbers.sort_unstable();
        assert!(numbers.into_iter().eq(0..unknowns.len()));
    }

    #[test]
    fn both_orderings_solve_the_grid_laplacian() {
        let n = 20;
        for ordering in [Ordering::MinimumDegree, Ordering::Dissection(&grid(n).0)] {
            let (structure, values) = grounded_grid(n, ordering);
            let factor = structure.factor(&values).unwrap();
            let mut x = Mat::from_fn(n * n, 2, |i, j| ((i * 7 + j) % 5) as f64);
            let rhs = x.clone();
            structure.solve_in_place(&factor, x.as_mut());
            for column in 0..2 {
                let solution: Vec<f64> = (0..n * n).map(|i| x[(i, column)]).collect();
                let mut back = vec![0.0; n * n];
                structure.multiply(&values, &solution, &mut back);
                // Residual relative to |A||x| (about 4e4 here): only rounding.
                assert!((0..n * n).all(|i| (back[i] - rhs[(i, column)]).abs() < 1e-8));
            }
        }
    }

    #[test]
    fn columns_of_the_inverse_solve_for_unit_sources() {
        let n = 12;
        let (coordinates, _) = grid(n);
        // More sources than are processed together, both at the end of the elimination and scattered.
        let sources: Vec<u32> = (0..20).map(|k| (k * 37 + 5) % (n * n) as u32).collect();
        for ordering in [
            Ordering::MinimumDegree,
            Ordering::Dissection(&coordinates),
            Ordering::DissectionWithLast(&coordinates, &sources),
        ] {
            let (structure, values) = grounded_grid(n, ordering);
            let factor = structure.factor(&values).unwrap();
            let unknowns: Vec<usize> = sources.iter().map(|&source| source as usize).collect();
            let mut expected = Mat::zeros(n * n, unknowns.len());
            unknowns.iter().enumerate().for_each(|(column, &unknown)| expected[(unknown, column)] = 1.0);
            structure.solve_in_place(&factor, expected.as_mut());
            let columns = structure.inverse_columns(&factor, &unknowns);
            let block = structure.inverse_block(&factor, &unknowns);
            for column in 0..unknowns.len() {
                // Values up to about 150 (the grid is grounded at a corner): only rounding.
                assert!((0..n * n).all(|row| (columns[(row, column)] - expected[(row, column)]).abs() < 1e-9));
                let same = |row: usize| (block[(row, column)] - expected[(unknowns[row], column)]).abs() < 1e-9;
                assert!((0..unknowns.len()).all(same));
            }
        }
    }

    #[test]
    fn singular_systems_are_named() {
        let (structure, _) = SpdStructure::new(2, &[(0, 1)], Ordering::MinimumDegree).unwrap();
        let error = structure.factor(&[1.0, 1.0, -5.0]).unwrap_err();
        assert!(matches!(error, SparseError::NotPositiveDefinite { size: 2, .. }), "{error}");
    }
}
