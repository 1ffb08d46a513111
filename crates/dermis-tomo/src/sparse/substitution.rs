//! Forward and backward substitution for sources at a few unknowns, with several right-hand sides at once: their
//! values at one unknown are adjacent in memory.

use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;

/// The rows to compute in columns of the inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Rows {
    All,
    Same,
}

/// Number of right-hand sides processed together: their values at one unknown fill a few vector registers.
pub(super) const WIDTH: usize = 16;

/// A numeric factor for sources at unknowns from `first` on (in elimination order).
pub(super) struct Supernodal<'a> {
    pub(super) factor: SupernodalLltRef<'a, u32, f64>,
    pub(super) first: usize,
}

impl Supernodal<'_> {
    /// Forward substitution from the sources, backward substitution to the required rows.
    pub(super) fn solve<const W: usize>(&self, x: &mut [[f64; W]], rows: Rows) {
        pulp::Arch::new().dispatch(Substitution { factor: self, x, rows });
    }

    /// Entries of one column of a supernode: first those of its square block (meaningless above the diagonal), then
    /// those of its pattern.
    #[inline(always)]
    fn column(&self, supernode: usize, column: usize) -> &[f64] {
        let begin = self.factor.symbolic().col_ptr_for_val()[supernode] as usize;
        let rows = self.factor.supernode(supernode).val().nrows();
        &self.factor.values()[begin + column * rows..][..rows]
    }

    #[inline(always)]
    pub(super) fn forward<const W: usize>(&self, supernode: usize, x: &mut [[f64; W]]) {
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
    pub(super) fn backward<const W: usize>(&self, supernode: usize, x: &mut [[f64; W]], below: &mut Vec<[f64; W]>) {
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
struct Substitution<'a, const W: usize> {
    factor: &'a Supernodal<'a>,
    x: &'a mut [[f64; W]],
    rows: Rows,
}

impl<const W: usize> pulp::NullaryFnOnce for Substitution<'_, W> {
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
fn subtract<const W: usize>(from: &mut [f64; W], entry: f64, value: &[f64; W]) {
    for lane in 0..W {
        from[lane] -= entry * value[lane];
    }
}
