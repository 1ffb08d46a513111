//! Sums over combinations of channels, in single precision.

/// `C'C` and `C'r`; the columns are stored one after the other.
pub(super) fn products(columns: &[f32], r: &[f32], length: usize, count: usize, normal: &mut [f64], right: &mut [f64]) {
    let column = |k: usize| &columns[k * length..(k + 1) * length];
    for a in 0..count {
        for b in 0..=a {
            let product = dot(column(a), column(b));
            normal[a * count + b] = product;
            normal[b * count + a] = product;
        }
        right[a] = dot(column(a), r);
    }
}

/// Sums in eight separate lanes, so that additions need not wait for each other.
fn dot(a: &[f32], b: &[f32]) -> f64 {
    let mut lanes = [0.0_f32; 8];
    let (whole, rest) = (a.chunks_exact(8), a.len() / 8 * 8);
    for (p, q) in whole.zip(b.chunks_exact(8)) {
        for lane in 0..8 {
            lanes[lane] += p[lane] * q[lane];
        }
    }
    let tail: f32 = a[rest..].iter().zip(&b[rest..]).map(|(p, q)| p * q).sum();
    lanes.iter().map(|v| f64::from(*v)).sum::<f64>() + f64::from(tail)
}
