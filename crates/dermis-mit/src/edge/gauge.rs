//! Removes the part of a source's potential that does no work: the gradient of a polynomial, by least squares over
//! the bodies.
//!
//! Only the circulation of a potential drives currents, yet far from a coil its potential is mostly a gradient, which
//! elements with curved edges cancel only to their own order. Removing it first leaves the currents unchanged, since
//! they are free of divergence and do not leave the body, and leaves only the error of the remainder.

use super::source::Samples;
use crate::vector::{Vector, add, dot, scaled};

/// Length of a gradient, relative to its original length, below which it counts as dependent on the earlier ones.
const DEPENDENT: f64 = 1e-9;

/// Orthonormal gradients over a body's quadrature points.
#[derive(Debug)]
pub(super) struct Gauge {
    /// Volume weight of each point.
    volumes: Vec<f64>,
    gradients: Vec<Vec<Vector>>,
}

impl Gauge {
    /// Builds gradients of the monomials up to a degree, for points with volumes. Given a set of odd axes (bits),
    /// uses only monomials that are odd in these and even in the others.
    pub(super) fn new(points_m: &[Vector], volumes: Vec<f64>, degree: i32, odd: Option<u8>) -> Self {
        let reach = points_m.iter().flatten().fold(0.0, |most: f64, x| most.max(x.abs()));
        let mut gauge = Self { volumes, gradients: Vec::new() };
        for powers in monomials(degree) {
            let fits = |odd: u8| (0..3).all(|axis| powers[axis] % 2 == i32::from(odd >> axis & 1));
            if !odd.is_none_or(fits) {
                continue;
            }
            let mut gradient: Vec<Vector> = points_m.iter().map(|p| slope(scaled(*p, 1.0 / reach), powers)).collect();
            let before = gauge.product(&gradient, &gradient).sqrt();
            // Two passes are enough (Parlett, The Symmetric Eigenvalue Problem, 6.9).
            (0..2).for_each(|_| gauge.subtract_from(&mut gradient));
            let after = gauge.product(&gradient, &gradient).sqrt();
            if after > DEPENDENT * before {
                gradient.iter_mut().for_each(|v| *v = scaled(*v, 1.0 / after));
                gauge.gradients.push(gradient);
            }
        }
        gauge
    }

    fn product(&self, a: &[Vector], b: &[Vector]) -> f64 {
        a.iter().zip(b).zip(&self.volumes).map(|((a, b), volume)| volume * dot(*a, *b)).sum()
    }

    fn subtract_from(&self, field: &mut [Vector]) {
        for gradient in &self.gradients {
            let share = self.product(field, gradient);
            field.iter_mut().zip(gradient).for_each(|(to, from)| *to = add(*to, scaled(*from, -share)));
        }
    }

    /// Removes the gradients from the potentials.
    pub(super) fn apply(&self, samples: &mut Samples) {
        let mut field: Vec<Vector> = samples.iter().map(|(a, _)| *a).collect();
        self.subtract_from(&mut field);
        samples.iter_mut().zip(field).for_each(|(sample, a)| sample.0 = a);
    }
}

/// Powers of x, y and z of all monomials from degree 1 to `degree`.
fn monomials(degree: i32) -> Vec<[i32; 3]> {
    let of = |n: i32| (0..=n).flat_map(move |i| (0..=n - i).map(move |j| [i, j, n - i - j]));
    (1..=degree).flat_map(of).collect()
}

fn slope(p: Vector, powers: [i32; 3]) -> Vector {
    [0, 1, 2].map(|axis| {
        let factor = |k: usize| {
            let n = powers[k];
            if k != axis {
                return p[k].powi(n);
            }
            if n == 0 { 0.0 } else { f64::from(n) * p[k].powi(n - 1) }
        };
        factor(0) * factor(1) * factor(2)
    })
}
