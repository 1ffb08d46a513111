//! Real solid harmonics, for expanding fields near a body and around it.
//!
//! Schmidt semi-normalisation: `h_1 = z, x, y`; the mean square of a harmonic of degree l over the unit sphere is
//! `1 / (2l + 1)`. Order: by degree, and within a degree `m = 0`, then cosine and sine of 1, 2, ... l. With
//! `C_m + j S_m = (x + j y)^m`, a harmonic is `N P_l^m C_m` or `N P_l^m S_m`, where `N = sqrt(2 (l - m)!/(l + m)!)`
//! (1 for m = 0), `P_m^m = (2m - 1)!!` and `(l - m) P_l^m = (2l - 1) z P_(l-1)^m - (l + m - 1) r^2 P_(l-2)^m`. The
//! derivatives of `P_l^m` are `(l + m) P_(l-1)^m` with respect to z and `-x P_(l-1)^(m+1)` with respect to x.

use std::sync::LazyLock;

use crate::constants::MU0;
use crate::vector::{Vector, add, dot, norm, scaled};

/// Maximum degree.
pub const MOST_DEGREE: usize = 5;
/// Number of harmonics of degree 1 to [`MOST_DEGREE`].
pub const HARMONICS: usize = (MOST_DEGREE + 1) * (MOST_DEGREE + 1) - 1;

/// Degree of each harmonic.
pub(crate) const DEGREES: [usize; HARMONICS] = degrees();

const fn degrees() -> [usize; HARMONICS] {
    let mut degrees = [0; HARMONICS];
    let (mut i, mut l) = (0, 1);
    while i < HARMONICS {
        if i == (l + 1) * (l + 1) - 1 {
            l += 1;
        }
        degrees[i] = l;
        i += 1;
    }
    degrees
}

/// Index of a harmonic of order m: the cosine (the only one for m = 0), with the sine right after it.
pub(crate) fn index(degree: usize, order: usize) -> usize {
    degree * degree - 1 + if order == 0 { 0 } else { 2 * order - 1 }
}

/// One more than the maximum degree.
const SIZE: usize = MOST_DEGREE + 1;

/// P, C and S at a point.
struct Parts {
    p: [[f64; SIZE]; SIZE],
    cosine: [f64; SIZE],
    sine: [f64; SIZE],
}

impl Parts {
    /// Computes them up to a degree.
    fn new([x, y, z]: Vector, degree: usize) -> Self {
        let squared = x * x + y * y + z * z;
        let (mut p, mut cosine, mut sine) = ([[0.0; SIZE]; SIZE], [0.0; SIZE], [0.0; SIZE]);
        (p[0][0], cosine[0]) = (1.0, 1.0);
        for m in 1..=degree {
            p[m][m] = p[m - 1][m - 1] * (2 * m - 1) as f64;
            cosine[m] = x * cosine[m - 1] - y * sine[m - 1];
            sine[m] = x * sine[m - 1] + y * cosine[m - 1];
        }
        for l in 1..=degree {
            for m in 0..l {
                let before = if l >= m + 2 { (l + m - 1) as f64 * squared * p[l - 2][m] } else { 0.0 };
                p[l][m] = ((2 * l - 1) as f64 * z * p[l - 1][m] - before) / (l - m) as f64;
            }
        }
        Self { p, cosine, sine }
    }
}

/// N by degree and order.
static NORMALISATION: LazyLock<[[f64; SIZE]; SIZE]> = LazyLock::new(|| {
    let ratio = |l: usize, m: usize| (l - m + 1..=l + m).map(|k| k as f64).product::<f64>();
    let of = |l: usize, m: usize| if m == 0 { 1.0 } else { (2.0 / ratio(l, m)).sqrt() };
    std::array::from_fn(|l| std::array::from_fn(|m| if m <= l { of(l, m) } else { 0.0 }))
});

/// Values of the regular harmonics at a point relative to their centre.
pub fn regular(point_m: Vector) -> [f64; HARMONICS] {
    regular_to(point_m, MOST_DEGREE)
}

/// The same up to a degree; zero above it.
fn regular_to(point_m: Vector, degree: usize) -> [f64; HARMONICS] {
    let (parts, norms) = (Parts::new(point_m, degree), &*NORMALISATION);
    let mut values = [0.0; HARMONICS];
    for l in 1..=degree {
        for m in 0..=l {
            let (at, scale) = (index(l, m), norms[l][m] * parts.p[l][m]);
            values[at] = scale * parts.cosine[m];
            if m > 0 {
                values[at + 1] = scale * parts.sine[m];
            }
        }
    }
    values
}

/// Gradients of the regular harmonics.
pub fn regular_gradients(point_m: Vector) -> [Vector; HARMONICS] {
    let (parts, norms, [x, y, _]) = (Parts::new(point_m, MOST_DEGREE), &*NORMALISATION, point_m);
    let mut gradients = [[0.0; 3]; HARMONICS];
    for l in 1..SIZE {
        for m in 0..=l {
            let (at, scale) = (index(l, m), norms[l][m]);
            let (c, s, p) = (parts.cosine[m], parts.sine[m], parts.p[l][m]);
            let next = if m + 1 < l { parts.p[l - 1][m + 1] } else { 0.0 };
            let up = if m < l { (l + m) as f64 * parts.p[l - 1][m] } else { 0.0 };
            let turn = |of: &[f64; SIZE]| if m > 0 { m as f64 * p * of[m - 1] } else { 0.0 };
            let (dc, ds) = (turn(&parts.cosine), turn(&parts.sine));
            gradients[at] = scaled([dc - x * next * c, -ds - y * next * c, up * c], scale);
            if m > 0 {
                gradients[at + 1] = scaled([ds - x * next * s, dc - y * next * s, up * s], scale);
            }
        }
    }
    gradients
}

/// Nodes (as cosines) and weights of 6-point Gauss-Legendre quadrature on [-1, 1].
const GAUSS: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691_05),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_35),
];
/// Number of quadrature points per circle.
const AROUND: usize = 12;

/// Points of [`sphere_points`] with their harmonics.
static SPHERE: LazyLock<Vec<(Vector, f64, [f64; HARMONICS])>> =
    LazyLock::new(|| sphere_points().map(|(direction, weight)| (direction, weight, regular(direction))).collect());

/// Points on the unit sphere with weights that sum to 1, exact to degree 11.
fn sphere_points() -> impl Iterator<Item = (Vector, f64)> {
    GAUSS.into_iter().flat_map(|(cosine, weight)| [(cosine, weight), (-cosine, weight)]).flat_map(|(cosine, weight)| {
        (0..AROUND).map(move |k| {
            let sine = (1.0 - cosine * cosine).sqrt();
            let (s, c) = (std::f64::consts::TAU * k as f64 / AROUND as f64).sin_cos();
            ([sine * c, sine * s, cosine], 0.5 * weight / AROUND as f64)
        })
    })
}

/// Coefficients c of the scalar potential `h = sum c_i h_i` with `B = -mu0 grad h` around a centre, from the flux
/// density (tesla) on a sphere of this radius, metres: by degree, `c = -(2l + 1) <B_r Y> / (mu0 l r^(l-1))`. The
/// quadrature aliases degrees of 12 - l and above, with a share `(r/d)^(12-2l)` of the field, where d is the distance
/// of the nearest wire. A radius of a fiftieth of d leaves 1e-10 for degrees up to 3, 2e-7 for degree 4 and 4e-4 for
/// degree 5, whose share is small; the rounding error is smaller.
pub fn expansion(centre_m: Vector, radius_m: f64, flux_density: impl Fn(Vector) -> Vector) -> [f64; HARMONICS] {
    let mut sums = [0.0; HARMONICS];
    for (direction, weight, harmonics) in SPHERE.iter() {
        let radial = dot(flux_density(add(centre_m, scaled(*direction, radius_m))), *direction);
        sums.iter_mut().zip(harmonics).for_each(|(sum, y)| *sum += weight * radial * y);
    }
    std::array::from_fn(|i| {
        let l = DEGREES[i] as f64;
        -(2.0 * l + 1.0) * sums[i] / (MU0 * l * radius_m.powi(DEGREES[i] as i32 - 1))
    })
}

/// Irregular harmonics at a point: the regular ones divided by `r^(2l+1)`.
#[cfg(test)]
pub(crate) fn irregular(point_m: Vector) -> [f64; HARMONICS] {
    let (values, r) = (regular(point_m), norm(point_m));
    std::array::from_fn(|i| values[i] / r.powi(2 * DEGREES[i] as i32 + 1))
}

/// Matrix S up to a degree, row by row (row: regular harmonic about a new centre, column: irregular harmonic about
/// the old one), of the re-expansion `Y_j(p)/r^(l+1) = sum_i S_ij h_i(p - shift)`. Valid for points closer to the new
/// centre than the old centre is. Computed by projection on a small sphere around the new centre, as in
/// [`expansion`], from values instead of radial derivatives.
pub(crate) fn translation(shift_m: Vector, degree: usize) -> Vec<f64> {
    if degree == 1 {
        return dipole_translation(shift_m).to_vec();
    }
    let count = (degree + 1) * (degree + 1) - 1;
    let radius = 0.03 * norm(shift_m);
    let mut sums = vec![0.0; count * count];
    for (direction, weight, harmonics) in SPHERE.iter() {
        let at = add(shift_m, scaled(*direction, radius));
        let mut values = regular_to(at, degree);
        let squared = dot(at, at);
        let mut scale = weight / squared.sqrt();
        for l in 1..=degree {
            scale /= squared;
            values[l * l - 1..(l + 1) * (l + 1) - 1].iter_mut().for_each(|value| *value *= scale);
        }
        for (row, y) in sums.chunks_exact_mut(count).zip(harmonics) {
            row.iter_mut().zip(&values).for_each(|(sum, value)| *sum += value * y);
        }
    }
    for (row, l) in sums.chunks_exact_mut(count).zip(DEGREES) {
        let scale = (2 * l + 1) as f64 / radius.powi(l as i32);
        row.iter_mut().for_each(|s| *s *= scale);
    }
    sums
}

/// The same for degree 1 in closed form, since every frame needs it: the gradients of z/r^3, x/r^3 and y/r^3, which
/// are `delta_ij/r^3 - 3 r_i r_j/r^5`.
fn dipole_translation([x, y, z]: Vector) -> [f64; 9] {
    let (at, square) = ([z, x, y], x * x + y * y + z * z);
    let cubed = 1.0 / (square * square.sqrt());
    let along = 3.0 * cubed / square;
    std::array::from_fn(|k| {
        let (i, j) = (k / 3, k % 3);
        let own = if i == j { cubed } else { 0.0 };
        own - along * at[i] * at[j]
    })
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
    fn dipoles_are_re_expanded_in_closed_form_as_by_projection() {
        for shift in [[0.02, -0.013, 0.004], [0.035, 0.0, 0.0], [-0.001, 0.05, -0.012]] {
            let (closed, projected) = (translation(shift, 1), translation(shift, MOST_DEGREE));
            let size = norm(shift).powi(-3);
            for (i, j) in (0..3).flat_map(|i| (0..3).map(move |j| (i, j))) {
                // The projection's rounding error, on a sphere of 3 % of the distance.
                assert!((closed[i * 3 + j] - projected[i * HARMONICS + j]).abs() < 1e-12 * size, "{i} {j}");
            }
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
            // The monopole of each series is not in the matrix, so compare relative to the centre.
            let centre = irregular(shift)[j];
            let found: f64 = centre + (0..HARMONICS).map(|i| s[i * HARMONICS + j] * h[i]).sum::<f64>();
            // Degree 6 and above: (1.2/24)^6 of the value, times a factor that grows with the degree.
            assert!((found - exact[j]).abs() < 2e-4 * exact[j].abs().max(centre.abs()), "{j}: {found} {}", exact[j]);
        }
    }
}
