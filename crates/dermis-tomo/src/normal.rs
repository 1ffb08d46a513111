//! The normal distribution, exactly and from a table.

use std::f64::consts::{FRAC_1_SQRT_2, TAU};
use std::sync::LazyLock;

/// The table ends this many standard deviations from the mean, where the distribution is 3e-7.
pub const REACH: f64 = 5.0;

/// Steps of the table. Straight lines between them are off by at most 3e-6.
const STEPS: usize = 1024;

static TABLE: LazyLock<[[f64; 2]; STEPS + 1]> = LazyLock::new(|| std::array::from_fn(|k| normal_exactly(deviate(k))));

fn deviate(step: usize) -> f64 {
    REACH * (2.0 * step as f64 / STEPS as f64 - 1.0)
}

/// The normal distribution and its density.
pub fn normal_exactly(u: f64) -> [f64; 2] {
    [0.5 * libm::erfc(-u * FRAC_1_SQRT_2), (-0.5 * u * u).exp() / TAU.sqrt()]
}

/// The normal distribution and its density, from the table. Beyond [`REACH`], their values there.
#[inline]
pub fn normal(u: f64) -> [f64; 2] {
    const SCALE: f64 = 0.5 * STEPS as f64 / REACH;
    let at = (SCALE * (u + REACH)).clamp(0.0, STEPS as f64);
    let k = (at as usize).min(STEPS - 1);
    let share = at - k as f64;
    let ([below, density], [next_below, next_density]) = (TABLE[k], TABLE[k + 1]);
    [below + share * (next_below - below), density + share * (next_density - density)]
}

/// A deviate of which less than this share is below, at most a step of the table too low.
pub fn deviate_below(share: f64) -> f64 {
    deviate(TABLE.partition_point(|[below, _]| *below < share).saturating_sub(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_the_normal_distribution() {
        // Abramowitz and Stegun, table 26.1: P(x) and Z(x) at 0.5, 1 and 2.
        let table = [
            (0.5, 0.691_462_461, 0.352_065_327),
            (1.0, 0.841_344_746, 0.241_970_725),
            (2.0, 0.977_249_868, 0.053_990_967),
        ];
        for (u, below, density) in table {
            let [p, z] = normal(u);
            assert!((p - below).abs() < 4e-6 && (z - density).abs() < 4e-6, "{u}: {p} {z}");
            assert!((normal(-u)[0] - 1.0 + below).abs() < 4e-6);
            assert!((deviate_below(below) - u).abs() < 0.02);
        }
    }
}
