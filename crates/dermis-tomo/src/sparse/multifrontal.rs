//! Multifrontal Cholesky factorisation (Duff and Reid, ACM Trans. Math. Softw. 9, 1983; Liu, SIAM Rev. 34, 1992) over
//! the supernodes found by `faer`. Each supernode's columns are factored as one dense block; their update of later
//! columns is computed as one dense product and passed to the parent. Small blocks, which dominate in the mesh of a
//! sheet, are handled by loops here, large ones by `faer`.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::{self as dense, LltRegularization};
use faer::linalg::matmul::triangular::{self, BlockStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::sparse::SymbolicSparseColMat;
use faer::sparse::linalg::cholesky::supernodal::SymbolicSupernodalCholesky;
use faer::sparse::linalg::cholesky::{SymbolicCholesky, SymbolicCholeskyRaw};
use faer::{Accum, MatMut, Par};

/// Destinations of all values, known before the values themselves.
#[derive(Debug)]
pub(super) struct Fronts {
    /// Position in the factor of each value of the matrix's lower triangle.
    targets: Vec<u32>,
    /// Children of each supernode, from `child_starts[s]` to `child_starts[s + 1]`.
    children: Vec<u32>,
    child_starts: Vec<u32>,
    /// Row in the parent's front of each row of each supernode's pattern, from `place_starts[s]` on.
    places: Vec<u32>,
    place_starts: Vec<u32>,
    /// Scratch size that `faer` needs to factor the widest block.
    widest: usize,
}

/// Blocks with fewer columns are factored by loops.
const FEW_COLUMNS: usize = 24;
/// Products with fewer multiplications are computed by loops.
const FEW_PRODUCTS: usize = 12_000;

impl Fronts {
    /// `None` if the factorisation is not supernodal or too large for 32-bit positions.
    pub(super) fn new(pattern: &SymbolicSparseColMat<u32>, symbolic: &SymbolicCholesky<u32>) -> Option<Self> {
        let SymbolicCholeskyRaw::Supernodal(supernodal) = symbolic.raw() else { return None };
        u32::try_from(supernodal.len_val()).ok()?;
        let (begins, ends) = (supernodal.supernode_begin(), supernodal.supernode_end());
        let count = begins.len();
        let mut supernode_of = vec![0_u32; supernodal.nrows()];
        for supernode in 0..count {
            supernode_of[begins[supernode] as usize..ends[supernode] as usize].fill(supernode as u32);
        }
        // Row of a front: the supernode's own columns come first, then its sorted pattern.
        let row_in = |supernode: usize, row: u32| -> Option<u32> {
            let (begin, end) = (begins[supernode], ends[supernode]);
            if row < end {
                return row.checked_sub(begin);
            }
            let found = supernodal.supernode(supernode).pattern().binary_search(&row).ok()?;
            Some(end - begin + found as u32)
        };
        let mut parents = Vec::with_capacity(count);
        let (mut places, mut place_starts) = (Vec::new(), vec![0_u32]);
        for supernode in 0..count {
            let rows = supernodal.supernode(supernode).pattern();
            let parent = rows.first().map(|&row| supernode_of[row as usize]);
            parents.push(parent);
            for &row in rows {
                places.push(row_in(parent? as usize, row)?);
            }
            place_starts.push(places.len() as u32);
        }
        let (children, child_starts) = children_of(&parents);
        let identity: Vec<u32> = (0..supernodal.nrows() as u32).collect();
        let new_of_old = symbolic.perm().map_or(&identity[..], |order| order.arrays().1);
        let mut targets = Vec::with_capacity(pattern.row_idx().len());
        for column in 0..supernodal.nrows() {
            let range = pattern.col_ptr()[column] as usize..pattern.col_ptr()[column + 1] as usize;
            for &row in &pattern.row_idx()[range] {
                let (a, b) = (new_of_old[column], new_of_old[row as usize]);
                let (column, row) = (a.min(b), a.max(b));
                let supernode = supernode_of[column as usize] as usize;
                let rows = supernodal.supernode(supernode).pattern().len() as u32 + ends[supernode] - begins[supernode];
                let place = (column - begins[supernode]) * rows + row_in(supernode, row)?;
                targets.push(supernodal.col_ptr_for_val()[supernode] + place);
            }
        }
        let widest = (0..count).map(|supernode| (ends[supernode] - begins[supernode]) as usize).max().unwrap_or(0);
        Some(Self { targets, children, child_starts, places, place_starts, widest })
    }

    /// Peak number of values in fronts waiting for their parents.
    pub(super) fn working_len(&self, symbolic: &SymbolicCholesky<u32>) -> usize {
        let SymbolicCholeskyRaw::Supernodal(symbolic) = symbolic.raw() else { return 0 };
        let square = |supernode: usize| symbolic.supernode(supernode).pattern().len().pow(2);
        let (mut now, mut most) = (0, 0);
        for supernode in 0..symbolic.n_supernodes() {
            now += square(supernode);
            most = most.max(now);
            let range = self.child_starts[supernode] as usize..self.child_starts[supernode + 1] as usize;
            now -= self.children[range].iter().map(|&child| square(child as usize)).sum::<usize>();
        }
        most
    }

    /// Factors the matrix with these values into `factor`. The error is the pivot that was not positive.
    pub(super) fn factor(
        &self,
        symbolic: &SymbolicSupernodalCholesky<u32>,
        values: &[f64],
        factor: &mut [f64],
    ) -> Result<(), usize> {
        pulp::Arch::new().dispatch(Factorisation { fronts: self, symbolic, values, factor })
    }
}

fn children_of(parents: &[Option<u32>]) -> (Vec<u32>, Vec<u32>) {
    let mut starts = vec![0_u32; parents.len() + 1];
    parents.iter().flatten().for_each(|&parent| starts[parent as usize + 1] += 1);
    for supernode in 0..parents.len() {
        starts[supernode + 1] += starts[supernode];
    }
    let mut next = starts.clone();
    let mut children = vec![0_u32; starts[parents.len()] as usize];
    for (child, parent) in parents.iter().enumerate() {
        if let Some(parent) = parent {
            children[next[*parent as usize] as usize] = child as u32;
            next[*parent as usize] += 1;
        }
    }
    (children, starts)
}

struct Factorisation<'a> {
    fronts: &'a Fronts,
    symbolic: &'a SymbolicSupernodalCholesky<u32>,
    values: &'a [f64],
    factor: &'a mut [f64],
}

impl pulp::NullaryFnOnce for Factorisation<'_> {
    type Output = Result<(), usize>;

    #[inline(always)]
    fn call(self) -> Result<(), usize> {
        let Self { fronts, symbolic, values, factor } = self;
        factor.fill(0.0);
        for (&target, value) in fronts.targets.iter().zip(values) {
            factor[target as usize] += value;
        }
        let scratch = dense::cholesky_in_place_scratch::<f64>(fronts.widest, Par::Seq, Default::default());
        let mut buffer = MemBuffer::new(scratch);
        let count = symbolic.n_supernodes();
        let mut updates: Vec<Vec<f64>> = vec![Vec::new(); count];
        let mut spare: Vec<Vec<f64>> = Vec::new();
        for supernode in 0..count {
            let node = symbolic.supernode(supernode);
            let columns = (symbolic.supernode_end()[supernode] - symbolic.supernode_begin()[supernode]) as usize;
            let below = node.pattern().len();
            let at = symbolic.col_ptr_for_val();
            let block = &mut factor[at[supernode] as usize..at[supernode + 1] as usize];
            let mut update = spare.pop().unwrap_or_default();
            update.clear();
            update.resize(below * below, 0.0);
            let range = fronts.child_starts[supernode] as usize..fronts.child_starts[supernode + 1] as usize;
            for &child in &fronts.children[range] {
                let child = child as usize;
                let handed = std::mem::take(&mut updates[child]);
                let places = fronts.place_starts[child] as usize..fronts.place_starts[child + 1] as usize;
                extend_add(&handed, &fronts.places[places], columns, below, block, &mut update);
                spare.push(handed);
            }
            factor_block(block, columns, below, MemStack::new(&mut buffer)).map_err(|column| node.start() + column)?;
            subtract_product(&block[..], columns, below, &mut update);
            updates[supernode] = update;
        }
        Ok(())
    }
}

/// Adds a child's update (square, lower triangle, column-major) to its parent's columns and to the parent's own update.
#[inline(always)]
fn extend_add(from: &[f64], places: &[u32], columns: usize, below: usize, block: &mut [f64], update: &mut [f64]) {
    let (size, rows) = (places.len(), columns + below);
    for (column, &place) in places.iter().enumerate() {
        let source = &from[column * size + column..(column + 1) * size];
        let place = place as usize;
        // Rows of the update are counted from the end of the parent's own columns.
        let (target, shift) = if place < columns {
            (&mut block[place * rows..(place + 1) * rows], 0)
        } else {
            (&mut update[(place - columns) * below..(place - columns + 1) * below], columns)
        };
        for (&row, value) in places[column..].iter().zip(source) {
            target[row as usize - shift] += value;
        }
    }
}

/// Cholesky factorisation of a block (rows = columns + below, column-major) in place. The error is the column that
/// failed.
#[inline(always)]
fn factor_block(block: &mut [f64], columns: usize, below: usize, stack: &mut MemStack) -> Result<(), usize> {
    let rows = columns + below;
    if columns >= FEW_COLUMNS {
        let (mut top, bottom) = MatMut::from_column_major_slice_mut(block, rows, columns).split_at_row_mut(columns);
        let outcome =
            dense::cholesky_in_place(top.as_mut(), LltRegularization::default(), Par::Seq, stack, Default::default());
        outcome.map_err(|dense::LltError::NonPositivePivot { index }| index)?;
        solve_lower_triangular_in_place(top.as_ref(), bottom.transpose_mut(), Par::Seq);
        return Ok(());
    }
    for column in 0..columns {
        let (done, rest) = block.split_at_mut((column + 1) * rows);
        let pivot = &mut done[column * rows + column..];
        // NaN fails too.
        if pivot[0] <= 0.0 || pivot[0].is_nan() {
            return Err(column);
        }
        let scale = 1.0 / pivot[0].sqrt();
        pivot.iter_mut().for_each(|value| *value *= scale);
        for (later, target) in rest.chunks_exact_mut(rows).enumerate() {
            let source = &pivot[later + 1..];
            let factor = source[0];
            let target = &mut target[column + 1 + later..];
            target.iter_mut().zip(source).for_each(|(to, from)| *to -= factor * from);
        }
    }
    Ok(())
}

/// `update -= B B'`, lower triangle, where B holds the lower rows of a factored block.
#[inline(always)]
fn subtract_product(block: &[f64], columns: usize, below: usize, update: &mut [f64]) {
    let rows = columns + below;
    if columns * below * below >= FEW_PRODUCTS {
        let whole = faer::MatRef::from_column_major_slice(block, rows, columns);
        let bottom = whole.subrows(columns, below);
        let target = MatMut::from_column_major_slice_mut(update, below, below);
        let (lower, full) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
        triangular::matmul(target, lower, Accum::Add, bottom, full, bottom.transpose(), full, -1.0, Par::Seq);
        return;
    }
    let column = |k: usize| &block[k * rows + columns..(k + 1) * rows];
    for (j, target) in update.chunks_exact_mut(below.max(1)).enumerate() {
        let target = &mut target[j..];
        let mut k = 0;
        while k + 4 <= columns {
            let (a, b, c, d) = (&column(k)[j..], &column(k + 1)[j..], &column(k + 2)[j..], &column(k + 3)[j..]);
            let (fa, fb, fc, fd) = (a[0], b[0], c[0], d[0]);
            for (i, value) in target.iter_mut().enumerate() {
                *value -= (fa * a[i] + fb * b[i]) + (fc * c[i] + fd * d[i]);
            }
            k += 4;
        }
        for k in k..columns {
            let source = &column(k)[j..];
            let factor = source[0];
            target.iter_mut().zip(source).for_each(|(to, from)| *to -= factor * from);
        }
    }
}
