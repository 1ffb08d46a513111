//! Gauss-Legendre quadrature on [-1, 1] with any number of points.

use std::f64::consts::PI;

/// Nodes in ascending order with their weights, which sum to 2; exact to degree `2 count - 1`. Newton's iteration on
/// the Legendre polynomial, starting from Tricomi's estimate of its roots.
pub(crate) fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    let node = |k: usize| {
        let mut x = -(PI * (k as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..100 {
            let (mut before, mut value) = (1.0, x);
            for l in 2..=count {
                let l = l as f64;
                (before, value) = (value, ((2.0 * l - 1.0) * x * value - (l - 1.0) * before) / l);
            }
            if count == 1 {
                (before, value) = (1.0, x);
            }
            slope = n * (x * value - before) / (x * x - 1.0);
            let step = value / slope;
            x -= step;
            if step.abs() < 1e-16 {
                break;
            }
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(node).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_are_exact_to_their_degree() {
        for count in [1, 2, 3, 5, 8, 16, 24] {
            let rule = gauss_legendre(count);
            for power in 0..2 * count as i32 {
                let exact = if power % 2 == 0 { 2.0 / f64::from(power + 1) } else { 0.0 };
                let found: f64 = rule.iter().map(|(x, w)| w * x.powi(power)).sum();
                assert!((found - exact).abs() < 1e-14, "{count} points, degree {power}: {found}");
            }
            assert!(rule.windows(2).all(|pair| pair[0].0 < pair[1].0));
        }
    }
}
