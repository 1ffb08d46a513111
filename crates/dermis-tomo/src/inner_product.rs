//! Inner products in vector registers.

use std::ops::{Add, Mul};

/// Running sums, so that additions need not wait for each other.
const LANES: usize = 8;

/// Inner product of `a` with as many values of `b`. The sum is taken in eight interleaved parts, so it can differ from
/// one taken in order by rounding.
///
/// # Panics
/// If `b` is shorter than `a`.
#[inline]
pub fn inner_product<T: Copy + Default + Add<Output = T> + Mul<Output = T>>(a: &[T], b: &[T]) -> T {
    let (a, a_rest) = a.as_chunks::<LANES>();
    let (b, b_rest) = b[..LANES * a.len() + a_rest.len()].as_chunks::<LANES>();
    let mut sums = [T::default(); LANES];
    for (a, b) in a.iter().zip(b) {
        (0..LANES).for_each(|k| sums[k] = sums[k] + a[k] * b[k]);
    }
    let rest = a_rest.iter().zip(b_rest).fold(T::default(), |sum, (a, b)| sum + *a * *b);
    sums.into_iter().fold(rest, |sum, lane| sum + lane)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn squares_add_up_at_every_length() {
        for n in 0..40_u32 {
            let values: Vec<f64> = (0..n).map(f64::from).collect();
            let longer: Vec<f64> = (0..n + 3).map(f64::from).collect();
            // Sum of the first n - 1 squares, exact in double precision.
            let expected = f64::from(n) * (f64::from(n) - 1.0) * (2.0 * f64::from(n) - 1.0) / 6.0;
            assert_eq!(inner_product(&values, &longer), expected, "{n} values");
        }
    }
}
