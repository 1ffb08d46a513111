//! Rigid transforms. `a_from_b` transforms coordinates in frame b to coordinates in frame a, so
//! `a_from_c = a_from_b * b_from_c`.

use std::ops::Mul;

/// A vector or a point; points are in metres.
pub type Vector = [f64; 3];

/// A 3 x 3 matrix, row by row.
pub type Matrix = [[f64; 3]; 3];

/// A rotation followed by a translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform {
    /// Rotation matrix, row by row.
    pub rotation: Matrix,
    /// Origin of the inner frame in the outer one, metres.
    pub translation_m: Vector,
}

impl Transform {
    /// The transform between identical frames.
    pub const IDENTITY: Self =
        Self { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], translation_m: [0.0; 3] };

    /// A transform from a translation in metres and roll, pitch and yaw in radians, with URDF's convention: rotations
    /// about the fixed axes x, y and z in this order, `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub fn from_xyz_rpy(translation_m: Vector, [roll, pitch, yaw]: Vector) -> Self {
        let ((sr, cr), (sp, cp), (sy, cy)) = (roll.sin_cos(), pitch.sin_cos(), yaw.sin_cos());
        let rotation = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ];
        Self { rotation, translation_m }
    }

    /// A transform from a translation in metres and a unit quaternion `x y z w`.
    pub fn from_quaternion(translation_m: Vector, [x, y, z, w]: [f64; 4]) -> Self {
        let rotation = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
            [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
            [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
        ];
        Self { rotation, translation_m }
    }

    /// A rotation by an angle in radians about a unit axis (Rodrigues' formula).
    pub fn turn([x, y, z]: Vector, angle_rad: f64) -> Self {
        let (s, c) = angle_rad.sin_cos();
        let d = 1.0 - c;
        let rotation = [
            [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
            [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
            [d * x * z - s * y, d * y * z + s * x, c + d * z * z],
        ];
        Self { rotation, translation_m: [0.0; 3] }
    }

    /// A translation, metres.
    pub fn shift(translation_m: Vector) -> Self {
        Self { translation_m, ..Self::IDENTITY }
    }

    /// Returns `b_from_a` for `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = transposed(&self.rotation);
        Self { rotation, translation_m: times(&rotation, self.translation_m).map(|v| -v) }
    }

    /// Transforms a point from the inner frame to the outer one.
    #[must_use]
    pub fn point_m(&self, point_m: Vector) -> Vector {
        add(times(&self.rotation, point_m), self.translation_m)
    }

    /// Transforms a direction or a force from the inner frame to the outer one: rotated but not shifted.
    #[must_use]
    pub fn vector(&self, vector: Vector) -> Vector {
        times(&self.rotation, vector)
    }

    /// Transforms a covariance from the inner frame to the outer one: `R C R^T`.
    #[must_use]
    pub fn covariance(&self, covariance: &Matrix) -> Matrix {
        product(&product(&self.rotation, covariance), &transposed(&self.rotation))
    }

    /// The rotation as a unit quaternion `x y z w` with `w >= 0`.
    #[must_use]
    pub fn quaternion(&self) -> [f64; 4] {
        let r = &self.rotation;
        // Divide by the largest component, which loses no digits.
        let squares = [
            1.0 + r[0][0] - r[1][1] - r[2][2],
            1.0 - r[0][0] + r[1][1] - r[2][2],
            1.0 - r[0][0] - r[1][1] + r[2][2],
            1.0 + r[0][0] + r[1][1] + r[2][2],
        ];
        let largest = (0..4).max_by(|&a, &b| squares[a].total_cmp(&squares[b])).unwrap_or(3);
        let s = 2.0 * squares[largest].max(0.0).sqrt();
        let q = match largest {
            0 => [0.25 * s, (r[0][1] + r[1][0]) / s, (r[0][2] + r[2][0]) / s, (r[2][1] - r[1][2]) / s],
            1 => [(r[0][1] + r[1][0]) / s, 0.25 * s, (r[1][2] + r[2][1]) / s, (r[0][2] - r[2][0]) / s],
            2 => [(r[0][2] + r[2][0]) / s, (r[1][2] + r[2][1]) / s, 0.25 * s, (r[1][0] - r[0][1]) / s],
            _ => [(r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s, 0.25 * s],
        };
        if q[3] < 0.0 { q.map(|v| -v) } else { q }
    }
}

impl Mul for Transform {
    type Output = Self;

    fn mul(self, inner: Self) -> Self {
        Self { rotation: product(&self.rotation, &inner.rotation), translation_m: self.point_m(inner.translation_m) }
    }
}

/// Sum of two vectors.
pub(crate) fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference of two vectors.
pub(crate) fn subtract(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Cross product.
pub(crate) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Dot product.
pub(crate) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Length of a vector.
pub(crate) fn length(v: Vector) -> f64 {
    dot(v, v).sqrt()
}

/// A vector times a number.
pub(crate) fn scaled(v: Vector, factor: f64) -> Vector {
    v.map(|component| factor * component)
}

fn times(m: &Matrix, v: Vector) -> Vector {
    [dot(m[0], v), dot(m[1], v), dot(m[2], v)]
}

fn transposed(m: &Matrix) -> Matrix {
    [[m[0][0], m[1][0], m[2][0]], [m[0][1], m[1][1], m[2][1]], [m[0][2], m[1][2], m[2][2]]]
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    let columns = transposed(b);
    a.map(|row| columns.map(|column| dot(row, column)))
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    fn close(a: &Transform, b: &Transform) -> bool {
        let numbers = |t: &Transform| t.rotation.into_iter().flatten().chain(t.translation_m).collect::<Vec<_>>();
        numbers(a).iter().zip(numbers(b)).all(|(x, y)| (x - y).abs() < 1e-14)
    }

    #[test]
    fn roll_pitch_and_yaw_are_turns_about_fixed_axes() {
        let rpy = Transform::from_xyz_rpy([1.0, 2.0, 3.0], [0.3, -0.7, 2.1]);
        let turns = Transform::turn([0.0, 0.0, 1.0], 2.1)
            * Transform::turn([0.0, 1.0, 0.0], -0.7)
            * Transform::turn([1.0, 0.0, 0.0], 0.3);
        assert!(close(&rpy, &(Transform::shift([1.0, 2.0, 3.0]) * turns)));
        // A quarter turn of roll brings y up.
        let quarter = Transform::from_xyz_rpy([0.0; 3], [FRAC_PI_2, 0.0, 0.0]);
        assert!(length(subtract(quarter.vector([0.0, 1.0, 0.0]), [0.0, 0.0, 1.0])) < 1e-15);
    }

    #[test]
    fn an_inverse_undoes_its_transform() {
        let transform = Transform::from_xyz_rpy([0.1, -0.2, 0.3], [1.0, 0.5, -2.0]);
        assert!(close(&(transform * transform.inverse()), &Transform::IDENTITY));
        assert!(close(&(transform.inverse() * transform), &Transform::IDENTITY));
    }

    #[test]
    fn quaternions_are_recovered_for_any_largest_part() {
        let turns = [[0.2, 0.1, -0.3], [3.1, 0.0, 0.0], [0.0, 1.5, 3.0], [0.0, 0.0, 3.1], [3.0, -1.2, 2.9]];
        for rpy in turns {
            let transform = Transform::from_xyz_rpy([0.0, 1.0, 0.0], rpy);
            let [x, y, z, w] = transform.quaternion();
            assert!((x * x + y * y + z * z + w * w - 1.0).abs() < 1e-14 && w >= 0.0);
            assert!(close(&transform, &Transform::from_quaternion([0.0, 1.0, 0.0], [x, y, z, w])), "{rpy:?}");
        }
    }
}
