//! Sparse symmetric positive definite systems with one structure and many values: the symbolic factorisation is made
//! once, each set of values costs a numeric one (supernodal Cholesky by `faer`, sequential inside: parallelism belongs
//! to the samples around it).

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{self as dense, LltRegularization};
use faer::perm::PermRef;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, LltRef, SymbolicCholesky, SymbolicCholeskyRaw, SymmetricOrdering,
    factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, Mat, MatMut, Par, Side};
use thiserror::Error;

/// Why a system could not be factored.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum SparseError {
    /// A pivot was zero, negative or NaN.
    #[error("the system is singular or not positive definite (pivot {pivot} of {size})")]
    NotPositiveDefinite {
        /// Which pivot, in elimination order.
        pivot: usize,
        /// Size of the system.
        size: usize,
    },
    /// The structure itself was refused.
    #[error("the system's structure was refused: {reason}")]
    Structure {
        /// Why.
        reason: String,
    },
}

/// The fill-reducing order of elimination.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Ordering<'a> {
    /// Approximate minimum degree.
    MinimumDegree,
    /// Nested dissection by coordinates: halve the widest extent, eliminate the separator last.
    Dissection(&'a [[f64; 3]]),
    /// The same, but the listed unknowns come last of all, in their order: those whose columns of the inverse
    /// [`SpdStructure::inverse_columns`] is to give.
    DissectionWithLast(&'a [[f64; 3]], &'a [u32]),
}

/// The structure of a symmetric matrix and its symbolic Cholesky factorisation.
#[derive(Debug)]
pub struct SpdStructure {
    pattern: SymbolicSparseColMat<u32>,
    symbolic: SymbolicCholesky<u32>,
}

/// Numeric factor; see [`SpdStructure::factor`].
#[derive(Debug)]
pub struct SpdFactor {
    values: Vec<f64>,
}

impl SpdStructure {
    /// From the positions of the lower triangle, repetitions allowed; the upper positions are folded down. Every
    /// diagonal position is added. The second value tells for each given position the slot of the values array that
    /// it adds to.
    ///
    /// # Errors
    /// Positions outside the matrix, or a structure too large for 32-bit indices.
    pub fn new(size: usize, positions: &[(u32, u32)], ordering: Ordering<'_>) -> Result<(Self, Vec<u32>), SparseError> {
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
                // The key is present: it was put there from the same list above.
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
        Ok((Self { pattern, symbolic }, slots))
    }

    /// Rows of the matrix.
    pub fn size(&self) -> usize {
        self.pattern.nrows()
    }

    /// Length of the values array.
    pub fn value_count(&self) -> usize {
        self.pattern.row_idx().len()
    }

    /// Nonzeros of the factor: a measure of cost.
    pub fn factor_len(&self) -> usize {
        self.symbolic.len_val()
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

    /// Adds one value to every diagonal entry.
    pub fn add_to_diagonal(&self, values: &mut [f64], amount: f64) {
        // The diagonal comes first in each column: the lower triangle is sorted by row.
        for &start in &self.pattern.col_ptr()[..self.size()] {
            values[start as usize] += amount;
        }
    }

    /// Factors the matrix whose lower triangle holds `values`, in the slots that [`SpdStructure::new`] told.
    ///
    /// # Errors
    /// [`SparseError::NotPositiveDefinite`].
    pub fn factor(&self, values: &[f64]) -> Result<SpdFactor, SparseError> {
        let mut factor = SpdFactor { values: vec![0.0; self.symbolic.len_val()] };
        self.refactor(values, &mut factor)?;
        Ok(factor)
    }

    /// As [`SpdStructure::factor`], into the memory of an earlier factor of the same structure.
    ///
    /// # Errors
    /// [`SparseError::NotPositiveDefinite`].
    pub fn refactor(&self, values: &[f64], factor: &mut SpdFactor) -> Result<(), SparseError> {
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
            .map_err(|dense::LltError::NonPositivePivot { index }| SparseError::NotPositiveDefinite {
                pivot: index,
                size: self.size(),
            })?;
        Ok(())
    }

    /// Columns of the inverse that belong to the given unknowns (size x unknowns): the fields of unit sources there.
    /// Quick where [`Ordering::DissectionWithLast`] put them last, correct for any.
    pub fn inverse_columns(&self, factor: &SpdFactor, unknowns: &[usize]) -> Mat<f64> {
        self.inverse_part(factor, unknowns, Rows::All)
    }

    /// The rows of [`SpdStructure::inverse_columns`] for the same unknowns (unknowns x unknowns), without the others.
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
}

/// Which rows of columns of the inverse are wanted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rows {
    All,
    Same,
}

/// Right-hand sides handled together: their values at one unknown fill a few vector registers.
const WIDTH: usize = 16;

/// A numeric factor, for sources at unknowns from `first` on (in the order of elimination).
struct Supernodal<'a> {
    factor: SupernodalLltRef<'a, u32, f64>,
    first: usize,
}

impl Supernodal<'_> {
    /// Forward substitution where the sources are, backward substitution to the rows wanted.
    fn solve(&self, x: &mut [[f64; WIDTH]], rows: Rows) {
        pulp::Arch::new().dispatch(Substitution { factor: self, x, rows });
    }

    /// Entries of one column of a supernode: first those of its square block (the part above the diagonal has no
    /// meaning), then those of its pattern.
    #[inline(always)]
    fn column(&self, supernode: usize, column: usize) -> &[f64] {
        let begin = self.factor.symbolic().col_ptr_for_val()[supernode] as usize;
        let rows = self.factor.supernode(supernode).val().nrows();
        &self.factor.values()[begin + column * rows..][..rows]
    }

    #[inline(always)]
    fn forward(&self, supernode: usize, x: &mut [[f64; WIDTH]]) {
        let node = self.factor.supernode(supernode);
        let (start, columns) = (node.start(), node.val().ncols());
        for column in 0..columns {
            let entries = self.column(supernode, column);
            let value = x[start + column].map(|value| value / entries[column]);
            x[start + column] = value;
            for (row, &entry) in entries[..columns].iter().enumerate().skip(column + 1) {
                subtract(&mut x[start + row], entry, &value);
            }
            for (&row, &entry) in node.pattern().iter().zip(&entries[columns..]) {
                subtract(&mut x[row as usize], entry, &value);
            }
        }
    }

    #[inline(always)]
    fn backward(&self, supernode: usize, x: &mut [[f64; WIDTH]], below: &mut Vec<[f64; WIDTH]>) {
        let node = self.factor.supernode(supernode);
        let (start, columns) = (node.start(), node.val().ncols());
        below.clear();
        below.extend(node.pattern().iter().map(|&row| x[row as usize]));
        for column in (0..columns).rev() {
            let entries = self.column(supernode, column);
            let mut value = x[start + column];
            for (known, &entry) in below.iter().zip(&entries[columns..]) {
                subtract(&mut value, entry, known);
            }
            for (known, &entry) in x[start + column + 1..start + columns].iter().zip(&entries[column + 1..columns]) {
                subtract(&mut value, entry, known);
            }
            x[start + column] = value.map(|value| value / entries[column]);
        }
    }
}

/// The loops of a solve, compiled for the vector instructions of the machine.
struct Substitution<'a> {
    factor: &'a Supernodal<'a>,
    x: &'a mut [[f64; WIDTH]],
    rows: Rows,
}

impl pulp::NullaryFnOnce for Substitution<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let begins = self.factor.factor.symbolic().supernode_begin();
        let first = begins.partition_point(|&begin| begin as usize <= self.factor.first).saturating_sub(1);
        let last = match self.rows {
            Rows::All => 0,
            Rows::Same => first,
        };
        for supernode in first..begins.len() {
            self.factor.forward(supernode, self.x);
        }
        let mut below = Vec::new();
        for supernode in (last..begins.len()).rev() {
            self.factor.backward(supernode, self.x, &mut below);
        }
    }
}

#[inline(always)]
fn subtract(from: &mut [f64; WIDTH], entry: f64, value: &[f64; WIDTH]) {
    for lane in 0..WIDTH {
        from[lane] -= entry * value[lane];
    }
}

const LEAF: usize = 48;

/// Nested dissection: forward and inverse permutation (new to old, old to new).
fn dissect(coordinates: &[[f64; 3]], last: &[u32], column_start: &[u32], rows: &[u32]) -> (Vec<u32>, Vec<u32>) {
    let size = coordinates.len();
    let adjacency = Adjacency::new(size, column_start, rows);
    let mut side = vec![0_u8; size];
    let mut order = Vec::with_capacity(size);
    let mut is_last = vec![false; size];
    last.iter().for_each(|&unknown| is_last[unknown as usize] = true);
    let mut nodes: Vec<u32> = (0..size as u32).filter(|&node| !is_last[node as usize]).collect();
    split(&mut nodes, coordinates, &adjacency, &mut side, &mut order);
    for &unknown in last {
        if std::mem::take(&mut is_last[unknown as usize]) {
            order.push(unknown);
        }
    }
    let mut inverse = vec![0_u32; size];
    for (new, &old) in order.iter().enumerate() {
        inverse[old as usize] = new as u32;
    }
    (order, inverse)
}

struct Adjacency {
    start: Vec<u32>,
    others: Vec<u32>,
}

impl Adjacency {
    fn new(size: usize, column_start: &[u32], rows: &[u32]) -> Self {
        let pairs = || {
            (0..size).flat_map(|column| {
                let range = column_start[column] as usize..column_start[column + 1] as usize;
                rows[range].iter().map(move |&row| (column as u32, row)).filter(|pair| pair.0 != pair.1)
            })
        };
        let mut start = vec![0_u32; size + 1];
        for (a, b) in pairs() {
            start[a as usize + 1] += 1;
            start[b as usize + 1] += 1;
        }
        for node in 0..size {
            start[node + 1] += start[node];
        }
        let mut fill = start.clone();
        let mut others = vec![0_u32; start[size] as usize];
        for (a, b) in pairs() {
            for (from, to) in [(a, b), (b, a)] {
                others[fill[from as usize] as usize] = to;
                fill[from as usize] += 1;
            }
        }
        Self { start, others }
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.others[self.start[node as usize] as usize..self.start[node as usize + 1] as usize]
    }
}

fn split(nodes: &mut [u32], xyz: &[[f64; 3]], adjacency: &Adjacency, side: &mut [u8], order: &mut Vec<u32>) {
    if nodes.len() <= LEAF {
        order.extend_from_slice(nodes);
        return;
    }
    let extent = |axis: usize| {
        let values = nodes.iter().map(|&node| xyz[node as usize][axis]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        high - low
    };
    let extents = [extent(0), extent(1), extent(2)];
    let axis = (0..3).max_by(|&a, &b| extents[a].total_cmp(&extents[b])).unwrap_or(0);
    let middle = nodes.len() / 2;
    nodes.select_nth_unstable_by(middle, |&a, &b| {
        xyz[a as usize][axis].total_cmp(&xyz[b as usize][axis]).then(a.cmp(&b))
    });
    for (position, &node) in nodes.iter().enumerate() {
        side[node as usize] = if position < middle { 1 } else { 2 };
    }
    // The separator: nodes of the left half that touch the right one.
    let mut left = Vec::with_capacity(middle);
    let mut separator = Vec::new();
    for &node in &nodes[..middle] {
        if adjacency.of(node).iter().any(|&other| side[other as usize] == 2) {
            separator.push(node);
        } else {
            left.push(node);
        }
    }
    let mut right = nodes[middle..].to_vec();
    for &node in nodes.iter() {
        side[node as usize] = 0;
    }
    if left.is_empty() {
        order.extend_from_slice(&right);
        order.extend_from_slice(&separator);
        return;
    }
    split(&mut left, xyz, adjacency, side, order);
    split(&mut right, xyz, adjacency, side, order);
    order.extend_from_slice(&separator);
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

    #[test]
    fn both_orderings_solve_the_grid_laplacian() {
        let n = 20;
        let (coordinates, edges) = grid(n);
        for ordering in [Ordering::MinimumDegree, Ordering::Dissection(&coordinates)] {
            let mut positions = edges.clone();
            positions.extend(edges.iter().flat_map(|&(a, b)| [(a, a), (b, b)]));
            positions.push((0, 0));
            let (structure, slots) = SpdStructure::new(n * n, &positions, ordering).unwrap();
            let mut values = vec![0.0; structure.value_count()];
            for (k, &slot) in slots.iter().enumerate() {
                values[slot as usize] += if k < edges.len() { -1.0 } else { 1.0 };
            }
            let factor = structure.factor(&values).unwrap();
            let mut x = Mat::from_fn(n * n, 2, |i, j| ((i * 7 + j) % 5) as f64);
            let rhs = x.clone();
            structure.solve_in_place(&factor, x.as_mut());
            for column in 0..2 {
                let solution: Vec<f64> = (0..n * n).map(|i| x[(i, column)]).collect();
                let mut back = vec![0.0; n * n];
                structure.multiply(&values, &solution, &mut back);
                // Residual relative to |A||x| (about 4e4 here): rounding only.
                assert!((0..n * n).all(|i| (back[i] - rhs[(i, column)]).abs() < 1e-8));
            }
        }
    }

    #[test]
    fn columns_of_the_inverse_solve_for_unit_sources() {
        let n = 12;
        let (coordinates, edges) = grid(n);
        let mut positions = edges.clone();
        positions.extend(edges.iter().flat_map(|&(a, b)| [(a, a), (b, b)]));
        positions.push((0, 0));
        // More sources than are handled together, at the end of the elimination and scattered.
        let sources: Vec<u32> = (0..20).map(|k| (k * 37 + 5) % (n * n) as u32).collect();
        for ordering in [
            Ordering::MinimumDegree,
            Ordering::Dissection(&coordinates),
            Ordering::DissectionWithLast(&coordinates, &sources),
        ] {
            let (structure, slots) = SpdStructure::new(n * n, &positions, ordering).unwrap();
            let mut values = vec![0.0; structure.value_count()];
            for (k, &slot) in slots.iter().enumerate() {
                values[slot as usize] += if k < edges.len() { -1.0 } else { 1.0 };
            }
            let factor = structure.factor(&values).unwrap();
            let unknowns: Vec<usize> = sources.iter().map(|&source| source as usize).collect();
            let mut expected = Mat::zeros(n * n, unknowns.len());
            unknowns.iter().enumerate().for_each(|(column, &unknown)| expected[(unknown, column)] = 1.0);
            structure.solve_in_place(&factor, expected.as_mut());
            let columns = structure.inverse_columns(&factor, &unknowns);
            let block = structure.inverse_block(&factor, &unknowns);
            for column in 0..unknowns.len() {
                // Values up to about 150 (the grid is grounded at a corner): rounding only.
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
