//! Real solid harmonics to degree 4, in which fields near a body and around it are expanded.
//!
//! Schmidt's semi-normalisation: `h_1 = z, x, y`; the mean of the square of a harmonic of degree l over the unit sphere is
//! `1 / (2l + 1)`. Order: degree by degree, in each `m = 0`, then cosine and sine of 1, 2, 3, 4.

use super::{MU0, Vector, add, dot, norm, scaled};

/// Harmonics of degree 1 to [`MOST_DEGREE`].
pub const HARMONICS: usize = 24;
/// Highest degree.
pub const MOST_DEGREE: usize = 4;

/// Degree of each harmonic.
pub(super) const DEGREES: [usize; HARMONICS] = [1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3, 4, 4, 4, 4, 4, 4, 4, 4, 4];

/// Values of the regular harmonics at a point relative to their centre.
pub fn regular([x, y, z]: Vector) -> [f64; HARMONICS] {
    let (s3, s6, s10, s15) = (3.0_f64.sqrt(), 6.0_f64.sqrt(), 10.0_f64.sqrt(), 15.0_f64.sqrt());
    let (s5, s35, s70) = (5.0_f64.sqrt(), 35.0_f64.sqrt(), 70.0_f64.sqrt());
    let flat = x * x + y * y;
    [
        z,
        x,
        y,
        z * z - 0.5 * flat,
        s3 * z * x,
        s3 * z * y,
        0.5 * s3 * (x * x - y * y),
        s3 * x * y,
        z * z * z - 1.5 * z * flat,
        0.25 * s6 * x * (4.0 * z * z - flat),
        0.25 * s6 * y * (4.0 * z * z - flat),
        0.5 * s15 * z * (x * x - y * y),
        s15 * z * x * y,
        0.25 * s10 * x * (x * x - 3.0 * y * y),
        0.25 * s10 * y * (3.0 * x * x - y * y),
        z.powi(4) - 3.0 * z * z * flat + 0.375 * flat * flat,
        0.25 * s10 * z * x * (4.0 * z * z - 3.0 * flat),
        0.25 * s10 * z * y * (4.0 * z * z - 3.0 * flat),
        0.25 * s5 * (x * x - y * y) * (6.0 * z * z - flat),
        0.5 * s5 * x * y * (6.0 * z * z - flat),
        0.25 * s70 * z * x * (x * x - 3.0 * y * y),
        0.25 * s70 * z * y * (3.0 * x * x - y * y),
        0.125 * s35 * (x.powi(4) - 6.0 * x * x * y * y + y.powi(4)),
        0.5 * s35 * x * y * (x * x - y * y),
    ]
}

/// Gradients of the regular harmonics.
pub fn regular_gradients([x, y, z]: Vector) -> [Vector; HARMONICS] {
    let (s3, s6, s10, s15) = (3.0_f64.sqrt(), 6.0_f64.sqrt(), 10.0_f64.sqrt(), 15.0_f64.sqrt());
    let flat = x * x + y * y;
    let (q, h, t) = (0.25 * s6, 0.5 * s15, 0.75 * s10);
    let (a, b, c, d) = (0.25 * s10, 0.25 * 5.0_f64.sqrt(), 0.75 * 70.0_f64.sqrt(), 0.5 * 35.0_f64.sqrt());
    let (cube, square) = (4.0 * z.powi(3), 6.0 * z * z);
    [
        [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [-x, -y, 2.0 * z],
        [s3 * z, 0.0, s3 * x],
        [0.0, s3 * z, s3 * y],
        [s3 * x, -s3 * y, 0.0],
        [s3 * y, s3 * x, 0.0],
        [-3.0 * x * z, -3.0 * y * z, 3.0 * z * z - 1.5 * flat],
        [q * (4.0 * z * z - 3.0 * x * x - y * y), -2.0 * q * x * y, 8.0 * q * x * z],
        [-2.0 * q * x * y, q * (4.0 * z * z - x * x - 3.0 * y * y), 8.0 * q * y * z],
        [2.0 * h * x * z, -2.0 * h * y * z, h * (x * x - y * y)],
        [s15 * y * z, s15 * x * z, s15 * x * y],
        [t * (x * x - y * y), -2.0 * t * x * y, 0.0],
        [2.0 * t * x * y, t * (x * x - y * y), 0.0],
        [x * (1.5 * flat - square), y * (1.5 * flat - square), cube - 6.0 * z * flat],
        [a * (cube - 9.0 * x * x * z - 3.0 * y * y * z), -6.0 * a * x * y * z, a * x * (2.0 * square - 3.0 * flat)],
        [-6.0 * a * x * y * z, a * (cube - 3.0 * x * x * z - 9.0 * y * y * z), a * y * (2.0 * square - 3.0 * flat)],
        [b * x * (2.0 * square - 4.0 * x * x), -b * y * (2.0 * square - 4.0 * y * y), 12.0 * b * z * (x * x - y * y)],
        [
            2.0 * b * y * (square - 3.0 * x * x - y * y),
            2.0 * b * x * (square - x * x - 3.0 * y * y),
            24.0 * b * x * y * z,
        ],
        [c * z * (x * x - y * y), -2.0 * c * x * y * z, c / 3.0 * x * (x * x - 3.0 * y * y)],
        [2.0 * c * x * y * z, c * z * (x * x - y * y), c / 3.0 * y * (3.0 * x * x - y * y)],
        [d * x * (x * x - 3.0 * y * y), d * y * (y * y - 3.0 * x * x), 0.0],
        [d * y * (3.0 * x * x - y * y), d * x * (x * x - 3.0 * y * y), 0.0],
    ]
}

/// Cosines and weights of Gauss and Legendre on [-1, 1], 7 points.
const GAUSS: [(f64, f64); 7] = [
    (0.0, 0.417_959_183_673_469_4),
    (0.405_845_151_377_397_17, 0.381_830_050_505_118_94),
    (-0.405_845_151_377_397_17, 0.381_830_050_505_118_94),
    (0.741_531_185_599_394_4, 0.279_705_391_489_276_7),
    (-0.741_531_185_599_394_4, 0.279_705_391_489_276_7),
    (0.949_107_912_342_758_5, 0.129_484_966_168_869_7),
    (-0.949_107_912_342_758_5, 0.129_484_966_168_869_7),
];
/// Points of a circle of the quadrature.
const AROUND: usize = 14;

/// Points on the unit sphere with weights that sum to 1, exact to degree 13.
fn sphere_points() -> impl Iterator<Item = (Vector, f64)> {
    GAUSS.into_iter().flat_map(|(cosine, weight)| {
        (0..AROUND).map(move |k| {
            let sine = (1.0 - cosine * cosine).sqrt();
            let (s, c) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
            ([sine * c, sine * s, cosine], 0.5 * weight / AROUND as f64)
        })
    })
}

/// Coefficients c of the scalar potential `h = sum c_i h_i` with `B = -mu0 grad h` around a centre, from the flux density
/// (tesla) on a sphere of that radius, metres: degree by degree `c = -(2l + 1) <B_r Y> / (mu0 l r^(l-1))`. What degrees
/// beyond 9 hold is folded in as `(r/d)^(10-l)` of the field's size, d the distance of the nearest wire: a fiftieth of d leaves
/// less than 1e-10; rounding leaves as much, of degree 4.
pub fn expansion(centre_m: Vector, radius_m: f64, flux_density: impl Fn(Vector) -> Vector) -> [f64; HARMONICS] {
    let mut sums = [0.0; HARMONICS];
    for (direction, weight) in sphere_points() {
        let radial = dot(flux_density(add(centre_m, scaled(direction, radius_m))), direction);
        let harmonics = regular(direction);
        sums.iter_mut().zip(harmonics).for_each(|(sum, y)| *sum += weight * radial * y);
    }
    std::array::from_fn(|i| {
        let l = DEGREES[i] as f64;
        -(2.0 * l + 1.0) * sums[i] / (MU0 * l * radius_m.powi(DEGREES[i] as i32 - 1))
    })
}

/// Irregular harmonics at a point: the regular ones over `r^(2l+1)`.
#[cfg(test)]
pub(super) fn irregular(point_m: Vector) -> [f64; HARMONICS] {
    let (values, r) = (regular(point_m), norm(point_m));
    std::array::from_fn(|i| values[i] / r.powi(2 * DEGREES[i] as i32 + 1))
}

/// Matrix S (row: regular harmonic about a new centre, column: irregular harmonic about the old) of the re-expansion
/// `Y_j(p)/r^(l+1) = sum_i S_ij h_i(p - shift)` for points nearer to the new centre than that is to the old. Found
/// by projection on a small sphere around the new centre, as [`expansion`], from values instead of radial derivatives.
pub(super) fn translation(shift_m: Vector, degree: usize) -> [[f64; HARMONICS]; HARMONICS] {
    let count = (degree + 1) * (degree + 1) - 1;
    let radius = 0.03 * norm(shift_m);
    let mut sums = [[0.0; HARMONICS]; HARMONICS];
    for (direction, weight) in sphere_points() {
        let offset = scaled(direction, radius);
        let harmonics = regular(direction);
        let at = add(shift_m, offset);
        let (values, r) = (regular(at), norm(at));
        for j in 0..count {
            let value = weight * values[j] / r.powi(2 * DEGREES[j] as i32 + 1);
            for (i, y) in harmonics.iter().enumerate().take(count) {
                sums[i][j] += value * y;
            }
        }
    }
    for (i, row) in sums.iter_mut().enumerate().take(count) {
        let l = DEGREES[i] as f64;
        row.iter_mut().for_each(|s| *s *= (2.0 * l + 1.0) / radius.powi(DEGREES[i] as i32));
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn harmonics_are_normalised_harmonic_and_their_gradients_their_own() {
        let mut products = [[0.0; HARMONICS]; HARMONICS];
        for (p, weight) in sphere_points() {
            let y = regular(p);
            (0..HARMONICS).for_each(|i| (0..HARMONICS).for_each(|j| products[i][j] += weight * y[i] * y[j]));
        }
        for (i, row) in products.iter().enumerate() {
            for (j, product) in row.iter().enumerate() {
                let expected = if i == j { 1.0 / (2.0 * DEGREES[i] as f64 + 1.0) } else { 0.0 };
                assert!((product - expected).abs() < 1e-14, "{i} {j}: {product}");
            }
        }
        let (p, step) = ([0.3, -0.7, 0.4], 1e-5);
        let gradients = regular_gradients(p);
        for axis in 0..3 {
            let moved = |by: f64| {
                let mut q = p;
                q[axis] += by;
                (regular(q), regular_gradients(q))
            };
            let ((more, _), (less, _)) = (moved(step), moved(-step));
            for i in 0..HARMONICS {
                assert!(((more[i] - less[i]) / (2.0 * step) - gradients[i][axis]).abs() < 1e-9, "{i} {axis}");
            }
        }
        for i in 0..HARMONICS {
            let second = |axis: usize| {
                let moved = |by: f64| {
                    let mut q = p;
                    q[axis] += by;
                    regular_gradients(q)[i][axis]
                };
                (moved(1e-4) - moved(-1e-4)) / 2e-4
            };
            // Central differences over 1e-4 of cubic gradients.
            assert!((0..3).map(second).sum::<f64>().abs() < 2e-7, "{i} is not harmonic");
        }
    }

    #[test]
    fn irregular_harmonics_are_re_expanded() {
        let shift = [0.02, -0.013, 0.004];
        let s = translation(shift, MOST_DEGREE);
        let offset = [0.0009, 0.0004, -0.0007];
        let exact = irregular(add(shift, offset));
        let h = regular(offset);
        for j in 0..HARMONICS {
            // The monopole of each series is not in the matrix: compared against the centre.
            let centre = irregular(shift)[j];
            let found: f64 = centre + (0..HARMONICS).map(|i| s[i][j] * h[i]).sum::<f64>();
            // Degree 5 and beyond: (1.2/24)^5 of the value, times what grows with the degree.
            assert!((found - exact[j]).abs() < 2e-4 * exact[j].abs().max(centre.abs()), "{j}: {found} {}", exact[j]);
        }
    }
}
