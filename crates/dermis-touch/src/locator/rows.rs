//! Loops over many rows in single precision, compiled for the vector instructions of the machine.

use pulp::{Arch, Simd, WithSimd};

/// Inner product of each row of `width` values with `v`.
pub(super) fn products(rows: &[f32], width: usize, v: &[f32], out: &mut [f32]) {
    Arch::new().dispatch(Products { rows, width, v, out });
}

struct Products<'a> {
    rows: &'a [f32],
    width: usize,
    v: &'a [f32],
    out: &'a mut [f32],
}

impl WithSimd for Products<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (v, v_rest) = S::as_simd_f32s(self.v);
        for (value, row) in self.out.iter_mut().zip(self.rows.chunks_exact(self.width)) {
            let (r, r_rest) = S::as_simd_f32s(row);
            let mut sums = [simd.splat_f32s(0.0); 4];
            let (by_four, single) = pulp::as_arrays::<4, _>(r);
            let (v_by_four, v_single) = pulp::as_arrays::<4, _>(v);
            for (x, y) in by_four.iter().zip(v_by_four) {
                for i in 0..4 {
                    sums[i] = simd.mul_add_e_f32s(x[i], y[i], sums[i]);
                }
            }
            for (x, y) in single.iter().zip(v_single) {
                sums[0] = simd.mul_add_e_f32s(*x, *y, sums[0]);
            }
            let pair = simd.add_f32s(simd.add_f32s(sums[0], sums[1]), simd.add_f32s(sums[2], sums[3]));
            *value = simd.reduce_sum_f32s(pair) + r_rest.iter().zip(v_rest).map(|(x, y)| x * y).sum::<f32>();
        }
    }
}

/// Applies `f` to all values, compiled for wide vectors.
struct Each<'a, F>(&'a mut [f32], F);

impl<F: Fn(f32) -> f32> WithSimd for Each<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) {
        for value in self.0.iter_mut() {
            *value = (self.1)(*value);
        }
    }
}

/// Replaces squared distances by Matern 5/2 correlations.
pub(super) fn matern52(squared: &mut [f32], inverse_length: f32) {
    Arch::new().dispatch(Each(
        squared,
        #[inline(always)]
        move |d2| matern52_of(d2, inverse_length),
    ));
}

/// Replaces each s, zero or above, by exp(-s).
pub(super) fn exponentials(values: &mut [f32]) {
    Arch::new().dispatch(Each(
        values,
        // A function pointer would not be inlined into the vector code.
        #[allow(clippy::redundant_closure)]
        #[inline(always)]
        |s| exp_minus(s),
    ));
}

/// Replaces values above zero by their natural logarithms.
pub(super) fn logarithms(values: &mut [f32]) {
    Arch::new().dispatch(Each(
        values,
        #[allow(clippy::redundant_closure)]
        #[inline(always)]
        |v| logarithm(v),
    ));
}

/// Sums over positions weighted by their likelihoods.
#[derive(Debug, Clone, Copy)]
pub(super) struct TemperedSums {
    /// Sum of the weights.
    pub total: f64,
    /// Sums of weights times x, and times y.
    pub firsts: [f64; 2],
    /// Sums of weights times x squared, and times y squared.
    pub seconds: [f64; 2],
}

/// Sums over positions x, y with the weights exp(-temperature * below); `below` is not negative.
pub(super) fn tempered_sums(below: &[f32], x: &[f32], y: &[f32], temperature: f32) -> TemperedSums {
    Arch::new().dispatch(Tempered { below, x, y, temperature })
}

struct Tempered<'a> {
    below: &'a [f32],
    x: &'a [f32],
    y: &'a [f32],
    temperature: f32,
}

impl WithSimd for Tempered<'_> {
    type Output = TemperedSums;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _simd: S) -> TemperedSums {
        const LANES: usize = 16;
        let mut lanes = [[0.0_f32; LANES]; 5];
        let (whole_s, rest_s) = self.below.as_chunks::<LANES>();
        let (whole_x, rest_x) = self.x.as_chunks::<LANES>();
        let (whole_y, rest_y) = self.y.as_chunks::<LANES>();
        for ((s, x), y) in whole_s.iter().zip(whole_x).zip(whole_y) {
            for i in 0..LANES {
                let w = exp_minus(self.temperature * s[i]);
                let (wx, wy) = (w * x[i], w * y[i]);
                lanes[0][i] += w;
                lanes[1][i] += wx;
                lanes[2][i] += wy;
                lanes[3][i] += wx * x[i];
                lanes[4][i] += wy * y[i];
            }
        }
        let mut sums = lanes.map(|lane| lane.iter().map(|v| f64::from(*v)).sum::<f64>());
        for ((s, x), y) in rest_s.iter().zip(rest_x).zip(rest_y) {
            let w = f64::from(exp_minus(self.temperature * s));
            let (x, y) = (f64::from(*x), f64::from(*y));
            let terms = [w, w * x, w * y, w * x * x, w * y * y];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let [total, sx, sy, sxx, syy] = sums;
        TemperedSums { total, firsts: [sx, sy], seconds: [sxx, syy] }
    }
}

/// Inner product in sixteen running sums, which the compiler keeps in vector registers.
#[inline(always)]
pub(super) fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0_f32; 16];
    let (whole_a, whole_b) = (a.chunks_exact(16), b.chunks_exact(16));
    let rest: f32 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(x, y)| x * y).sum();
    for (x, y) in whole_a.zip(whole_b) {
        for lane in 0..16 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    // In pairs, which vector registers add at once.
    for half in [8, 4, 2, 1] {
        for lane in 0..half {
            sums[lane] += sums[lane + half];
        }
    }
    sums[0] + rest
}

/// Matern 5/2 correlation for a squared distance, in single precision. Branch-free, so that loops over it vectorise.
#[inline(always)]
pub(super) fn matern52_of(d2: f32, inverse_length: f32) -> f32 {
    let s = (5.0 * d2).sqrt() * inverse_length;
    (1.0 + s + s * s * (1.0 / 3.0)) * exp_minus(s)
}

/// exp(-s) for s from 0 up, to a relative 4e-6; practically zero above 80. Computed as 2^n times a Taylor series.
#[inline(always)]
fn exp_minus(s: f32) -> f32 {
    const ROUND: f32 = 12_582_912.0;
    let x = -s.min(80.0) * std::f32::consts::LOG2_E;
    // Adding and subtracting 1.5 * 2^23 rounds to the nearest whole number.
    let shifted = x + ROUND;
    let rest = (x - (shifted - ROUND)) * std::f32::consts::LN_2;
    let series = 1.0 + rest * (1.0 + rest * (0.5 + rest * (1.0 / 6.0 + rest * (1.0 / 24.0 + rest * (1.0 / 120.0)))));
    let whole = shifted.to_bits().wrapping_sub(ROUND.to_bits());
    series * f32::from_bits(whole.wrapping_add(127) << 23)
}

/// ln v of a normal number above zero: v = m 2^e with m near 1, and the series of ln m = 2 artanh((m - 1) / (m + 1)).
#[inline(always)]
fn logarithm(v: f32) -> f32 {
    // Subtracting the bits of 0.7 splits v so that m is between 0.7 and 1.4.
    let shifted = v.to_bits().wrapping_sub(0x3f33_3333) as i32;
    let exponent = shifted >> 23;
    let m = f32::from_bits(v.to_bits().wrapping_sub((exponent << 23) as u32));
    let t = (m - 1.0) / (m + 1.0);
    let t2 = t * t;
    let series = 1.0 + t2 * (1.0 / 3.0 + t2 * (1.0 / 5.0 + t2 * (1.0 / 7.0 + t2 * (1.0 / 9.0))));
    exponent as f32 * std::f32::consts::LN_2 + 2.0 * t * series
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in 0..8000 {
            let s = step as f32 * 0.01;
            assert!((exp_minus(s) / (-s).exp() - 1.0).abs() < 1e-5, "exp(-{s}) is {}", exp_minus(s));
        }
        assert!(exp_minus(1e9) < 1e-30);
    }

    #[test]
    fn the_logarithm_is_that_of_the_library() {
        for step in 1..8000 {
            let v = (step as f32 * 0.01 - 40.0).exp();
            assert!((logarithm(v) - v.ln()).abs() < 4e-6, "ln {v} is {}", logarithm(v));
        }
    }

    #[test]
    fn tempered_sums_of_every_length_are_right() {
        for n in 0..70_usize {
            let value = |i: usize, k: usize| ((i * 37 + k * 101) % 29) as f32 / 29.0;
            let below: Vec<f32> = (0..n).map(|i| 9.0 * value(i, 0)).collect();
            let x: Vec<f32> = (0..n).map(|i| value(i, 1) - 0.5).collect();
            let y: Vec<f32> = (0..n).map(|i| value(i, 2) - 0.5).collect();
            let sums = tempered_sums(&below, &x, &y, 0.7);
            let expected = |term: &dyn Fn(f64, f64) -> f64| {
                let weighed = |i: usize| (-0.7 * f64::from(below[i])).exp() * term(f64::from(x[i]), f64::from(y[i]));
                (0..n).map(weighed).sum::<f64>()
            };
            let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-5 * n.max(1) as f64, "{a} and {b} of {n}");
            close(sums.total, expected(&|_, _| 1.0));
            close(sums.firsts[0], expected(&|x, _| x));
            close(sums.firsts[1], expected(&|_, y| y));
            close(sums.seconds[0], expected(&|x, _| x * x));
            close(sums.seconds[1], expected(&|_, y| y * y));
        }
    }

    #[test]
    fn the_inner_product_of_every_length_is_right() {
        for n in 0..70 {
            let values: Vec<f32> = (0..n).map(|i| i as f32).collect();
            let expected: usize = (0..n).map(|i| i * i).sum();
            assert_eq!(dot(&values, &values), expected as f32);
        }
    }
}
