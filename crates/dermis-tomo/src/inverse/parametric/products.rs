//! Sums over combinations of channels, in single precision.

use pulp::{Arch, NullaryFnOnce};

use crate::inner_product;

/// Values per response: the response itself, and its derivatives by x, y and log r.
pub(super) const KINDS: usize = 4;

/// Columns to be summed, each with one weight per kind of value. Implementations must be inlined to be vectorised.
pub(super) trait WeightedColumns {
    fn count(&self) -> usize;
    fn column(&self, n: usize) -> ([f32; KINDS], &[f32]);
}

/// Replaces `out` by the sums of the columns, one kind after the other, in the machine's widest registers.
pub(super) fn sum_up(columns: impl WeightedColumns, out: &mut [f32]) {
    out.fill(0.0);
    Arch::new().dispatch(Sums { columns, out });
}

struct Sums<'a, C> {
    columns: C,
    out: &'a mut [f32],
}

impl<C: WeightedColumns> NullaryFnOnce for Sums<'_, C> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let length = self.out.len() / KINDS;
        let (value, rest) = self.out.split_at_mut(length);
        let (by_x, rest) = rest.split_at_mut(length);
        let (by_y, rest) = rest.split_at_mut(length);
        let by_r = &mut rest[..length];
        for n in 0..self.columns.count() {
            let ([v, x, y, r], column) = self.columns.column(n);
            let column = &column[..length];
            for k in 0..length {
                value[k] += v * column[k];
                by_x[k] += x * column[k];
                by_y[k] += y * column[k];
                by_r[k] += r * column[k];
            }
        }
    }
}

/// `C'C` and `C'r`; the columns are stored one after the other.
pub(super) fn products(columns: &[f32], r: &[f32], length: usize, count: usize, normal: &mut [f64], right: &mut [f64]) {
    let column = |k: usize| &columns[k * length..(k + 1) * length];
    for a in 0..count {
        for b in 0..=a {
            let product = f64::from(inner_product(column(a), column(b)));
            normal[a * count + b] = product;
            normal[b * count + a] = product;
        }
        right[a] = f64::from(inner_product(column(a), r));
    }
}
