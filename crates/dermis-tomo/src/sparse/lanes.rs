//! Several right-hand sides at once, with their values at one unknown adjacent in memory: products with a complex
//! symmetric matrix and solutions with a real factor, as needed by preconditioned iterations.

use faer::Mat;
use faer::sparse::linalg::cholesky::SymbolicCholeskyRaw;
use faer::sparse::linalg::cholesky::supernodal::SupernodalLltRef;

use super::substitution::{Rows, Supernodal};
use super::{SpdFactor, SpdStructure};

impl SpdStructure {
    /// Solves in place for W right-hand sides (2, 4, 8 and 16 suit vector registers).
    pub fn solve_lanes<const W: usize>(&self, factor: &SpdFactor, x: &mut [[f64; W]]) {
        let (SymbolicCholeskyRaw::Supernodal(symbolic), Some(order)) = (self.symbolic.raw(), self.symbolic.perm())
        else {
            let mut columns = Mat::from_fn(x.len(), W, |row, lane| x[row][lane]);
            self.solve_in_place(factor, columns.as_mut());
            x.iter_mut().enumerate().for_each(|(row, x)| *x = std::array::from_fn(|lane| columns[(row, lane)]));
            return;
        };
        let (old_of_new, _) = order.arrays();
        let mut ordered: Vec<[f64; W]> = old_of_new.iter().map(|&old| x[old as usize]).collect();
        Supernodal { factor: SupernodalLltRef::new(symbolic, &factor.values), first: 0 }.solve(&mut ordered, Rows::All);
        ordered.iter().zip(old_of_new).for_each(|(value, &old)| x[old as usize] = *value);
    }

    /// Product of the complex symmetric matrix `real + j imaginary` (both in this structure) with W/2 complex
    /// vectors. The real parts are in the first half of the lanes, the imaginary parts in the second.
    pub fn multiply_complex_lanes<const W: usize>(
        &self,
        real: &[f64],
        imaginary: &[f64],
        x: &[[f64; W]],
        y: &mut [[f64; W]],
    ) {
        pulp::Arch::new().dispatch(Product { structure: self, real, imaginary, x, y });
    }
}

/// The loops of a product, compiled for the vector instructions of the machine.
struct Product<'a, const W: usize> {
    structure: &'a SpdStructure,
    real: &'a [f64],
    imaginary: &'a [f64],
    x: &'a [[f64; W]],
    y: &'a mut [[f64; W]],
}

impl<const W: usize> pulp::NullaryFnOnce for Product<'_, W> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { structure, real, imaginary, x, y } = self;
        y.fill([0.0; W]);
        let (starts, rows) = (structure.pattern.col_ptr(), structure.pattern.row_idx());
        for column in 0..structure.size() {
            let own = x[column];
            let mut sum = [0.0; W];
            for slot in starts[column] as usize..starts[column + 1] as usize {
                let row = rows[slot] as usize;
                add_product(&mut sum, real[slot], imaginary[slot], &x[row]);
                if row != column {
                    add_product(&mut y[row], real[slot], imaginary[slot], &own);
                }
            }
            y[column].iter_mut().zip(sum).for_each(|(to, from)| *to += from);
        }
    }
}

#[inline(always)]
fn add_product<const W: usize>(to: &mut [f64; W], real: f64, imaginary: f64, x: &[f64; W]) {
    let half = W / 2;
    for lane in 0..half {
        let (re, im) = (x[lane], x[lane + half]);
        to[lane] += real * re - imaginary * im;
        to[lane + half] += real * im + imaginary * re;
    }
}
