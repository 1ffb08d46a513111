//! Net force and torque of touches, with their covariance to first order in the errors of position and force.

use dermis_tomo::mesh::{Point, Surface};
use dermis_touch::{Observation, Touch};

use crate::space::{ForceEstimate, SurfacePoint};
use crate::transform::{Transform, Vector, add, cross, scaled, subtract};

/// A 6 x 6 matrix, row by row: three force components, then three torque components.
pub type Matrix6 = [[f64; 6]; 6];

/// Force and torque on a body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wrench {
    /// Force on the sensor, newtons.
    pub force_n: Vector,
    /// Torque about `about_m`, newton metres.
    pub torque_nm: Vector,
    /// The reference point of the torque, metres, in the same frame as all other values.
    pub about_m: Vector,
    /// Covariance of force (N) and torque (N m), in this order: N^2, N^2 m, N^2 m^2.
    pub covariance: Matrix6,
}

/// A press on a surface: position on the flattened sheet with its uncertainty, and force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Press {
    /// Position on the flattened sheet, metres.
    pub position_m: Point,
    /// Its covariance, m^2.
    pub covariance_m2: [[f64; 2]; 2],
    /// The force.
    pub force: ForceEstimate,
}

/// The presses of a frame's touches, and the touches whose force is unknown. Touches that share a contact each report
/// its whole force, and make one press.
pub fn presses(touches: &[Touch], force: impl Fn(&Touch) -> Option<ForceEstimate>) -> (Vec<Press>, Vec<&Touch>) {
    let (mut presses, mut unknown): (Vec<Press>, _) = (Vec::new(), Vec::new());
    for touch in touches {
        let Some(force) = force(touch) else {
            unknown.push(touch);
            continue;
        };
        let press = Press { position_m: touch.position_m, covariance_m2: touch.covariance_m2, force };
        let shares = |other: &Press| other.position_m == press.position_m;
        if touch.observation != Observation::Merged || !presses.iter().any(shares) {
            presses.push(press);
        }
    }
    (presses, unknown)
}

impl Wrench {
    /// The wrench without any press.
    pub fn none_about(about_m: Vector) -> Self {
        Self { force_n: [0.0; 3], torque_nm: [0.0; 3], about_m, covariance: [[0.0; 6]; 6] }
    }

    /// The wrench of a press, about a point of the frame that the skin lies in. Errors of position and force count as
    /// independent. On a curved skin an error of position also rotates the force.
    pub fn of(press: &Press, surface: &Surface, frame_from_patch: &Transform, about_m: Vector) -> Self {
        let point = SurfacePoint::at(surface, press.position_m);
        let turned = |vector: Vector| frame_from_patch.vector(vector);
        let normal = turned(point.normal);
        let arm = subtract(frame_from_patch.point_m(point.position_m), about_m);
        let force_n = scaled(normal, -press.force.force_n);
        // Derivatives of force and torque by x, y and the force's magnitude.
        let derivative = |force_change: Vector, arm_change: Vector| -> [f64; 6] {
            let torque_change = add(cross(arm_change, force_n), cross(arm, force_change));
            let ([a, b, c], [d, e, f]) = (force_change, torque_change);
            [a, b, c, d, e, f]
        };
        let along = [0, 1].map(|axis| {
            let force_change = scaled(turned(point.normal_along[axis]), -press.force.force_n);
            derivative(force_change, turned(point.along[axis]))
        });
        let by_force = derivative(scaled(normal, -1.0), [0.0; 3]);
        let variance_n2 = press.force.sigma_n.powi(2);
        let mut covariance = [[0.0; 6]; 6];
        for row in 0..6 {
            for column in 0..6 {
                covariance[row][column] = variance_n2 * by_force[row] * by_force[column];
                for i in 0..2 {
                    for j in 0..2 {
                        covariance[row][column] += along[i][row] * press.covariance_m2[i][j] * along[j][column];
                    }
                }
            }
        }
        Self { force_n, torque_nm: cross(arm, force_n), about_m, covariance }
    }

    /// Adds another wrench about the same point of the same frame, with independent errors.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        let mut covariance = self.covariance;
        for (sum, row) in covariance.iter_mut().zip(&other.covariance) {
            sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        Self {
            force_n: add(self.force_n, other.force_n),
            torque_nm: add(self.torque_nm, other.torque_nm),
            about_m: self.about_m,
            covariance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard normal numbers from a small generator, by the Box-Muller method.
    struct Normals(u64);

    impl Normals {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        }

        fn next(&mut self) -> f64 {
            let (a, b) = (self.uniform(), self.uniform());
            (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
        }
    }

    #[test]
    fn the_covariance_is_that_of_many_draws() {
        let surface = Surface::Cylinder { radius_m: 0.06 };
        let frame = Transform::from_xyz_rpy([0.3, -0.1, 0.4], [0.4, 1.1, -0.6]);
        let about_m = [0.05, 0.02, -0.1];
        // Correlated position errors of 0.8 mm and 0.5 mm.
        let (sx, sy, correlation) = (0.8e-3, 0.5e-3, 0.6);
        let covariance_m2 = [[sx * sx, correlation * sx * sy], [correlation * sx * sy, sy * sy]];
        let force = ForceEstimate { force_n: 4.0, sigma_n: 0.1 };
        let press = Press { position_m: [0.03, -0.02], covariance_m2, force };
        let expected = Wrench::of(&press, &surface, &frame, about_m);
        let mut normals = Normals(7);
        let draws = 40_000;
        let mut sums = [[0.0; 6]; 6];
        for _ in 0..draws {
            let (a, b, c) = (normals.next(), normals.next(), normals.next());
            let shift = [sx * a, sy * (correlation * a + (1.0 - correlation * correlation).sqrt() * b)];
            let drawn = Press {
                position_m: [press.position_m[0] + shift[0], press.position_m[1] + shift[1]],
                force: ForceEstimate { force_n: 4.0 + 0.1 * c, sigma_n: 0.0 },
                covariance_m2: [[0.0; 2]; 2],
            };
            let wrench = Wrench::of(&drawn, &surface, &frame, about_m);
            let parts = |w: &Wrench| [w.force_n, w.torque_nm].concat();
            let error: Vec<f64> = parts(&wrench).iter().zip(parts(&expected)).map(|(x, y)| x - y).collect();
            for row in 0..6 {
                for column in 0..6 {
                    sums[row][column] += error[row] * error[column] / f64::from(draws);
                }
            }
        }
        for row in 0..6 {
            for column in 0..6 {
                let scale = (expected.covariance[row][row] * expected.covariance[column][column]).sqrt();
                let error = (sums[row][column] - expected.covariance[row][column]).abs() / scale;
                assert!(error < 0.03, "{row}, {column}: {} {}", sums[row][column], expected.covariance[row][column]);
            }
        }
    }

    #[test]
    fn a_press_pushes_against_the_normal() {
        let press = Press {
            position_m: [0.1, 0.0],
            covariance_m2: [[0.0; 2]; 2],
            force: ForceEstimate { force_n: 2.0, sigma_n: 0.0 },
        };
        let wrench = Wrench::of(&press, &Surface::Flat, &Transform::IDENTITY, [0.0; 3]);
        assert_eq!(wrench.force_n, [0.0, 0.0, -2.0]);
        // x cross -z is +y.
        assert_eq!(wrench.torque_nm, [0.0, 0.2, 0.0]);
        assert_eq!(wrench.plus(&wrench).force_n, [0.0, 0.0, -4.0]);
    }
}
