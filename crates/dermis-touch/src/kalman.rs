//! Kalman filter for the position and velocity of one contact in the plane, with a nearly constant velocity model.
//!
//! The acceleration is white noise of spectral density q. Over dt the covariance grows by q [[dt^3/3, dt^2/2],
//! [dt^2/2, dt]] in (position, velocity) of each axis (Bar-Shalom, Li, Kirubarajan, *Estimation with Applications to
//! Tracking and Navigation*, 2001, section 6.2.2).

use crate::plane::{Point, Vec2, add, scale, sub};

pub(crate) type Mat2 = [[f64; 2]; 2];

pub(crate) fn plus_diagonal(m: Mat2, variance: f64) -> Mat2 {
    [[m[0][0] + variance, m[0][1]], [m[1][0], m[1][1] + variance]]
}

fn combine(a: Mat2, b: Mat2, factor: f64) -> Mat2 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][j] + factor * b[i][j]))
}

fn times(a: Mat2, b: Mat2) -> Mat2 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j]))
}

fn apply(a: Mat2, v: Vec2) -> Vec2 {
    [a[0][0] * v[0] + a[0][1] * v[1], a[1][0] * v[0] + a[1][1] * v[1]]
}

fn transpose(a: Mat2) -> Mat2 {
    [[a[0][0], a[1][0]], [a[0][1], a[1][1]]]
}

fn symmetric(a: Mat2) -> Mat2 {
    let off = 0.5 * (a[0][1] + a[1][0]);
    [[a[0][0], off], [off, a[1][1]]]
}

/// Inverse of a symmetric positive definite matrix. The caller adds a positive diagonal first.
fn inverse(a: Mat2) -> Mat2 {
    let determinant = a[0][0] * a[1][1] - a[0][1] * a[1][0];
    [[a[1][1] / determinant, -a[0][1] / determinant], [-a[1][0] / determinant, a[0][0] / determinant]]
}

/// State and covariance in blocks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kalman {
    pub position: Point,
    pub velocity: Vec2,
    /// Covariance of the position, m^2.
    pub position_variance: Mat2,
    /// Covariance of position (rows) with velocity (columns).
    cross: Mat2,
    velocity_variance: Mat2,
}

impl Kalman {
    pub(crate) fn new(position: Point, variance: Mat2, velocity: Vec2, speed_sigma: f64) -> Self {
        Self {
            position,
            velocity,
            position_variance: variance,
            cross: [[0.0; 2]; 2],
            velocity_variance: plus_diagonal([[0.0; 2]; 2], speed_sigma * speed_sigma),
        }
    }

    /// Advances by `dt` seconds with acceleration density `q`, m^2/s^3.
    pub(crate) fn predict(&mut self, dt: f64, q: f64) {
        self.position = add(self.position, scale(self.velocity, dt));
        let both = combine(self.cross, transpose(self.cross), 1.0);
        let grown = combine(combine(self.position_variance, both, dt), self.velocity_variance, dt * dt);
        self.position_variance = plus_diagonal(grown, q * dt.powi(3) / 3.0);
        self.cross = plus_diagonal(combine(self.cross, self.velocity_variance, dt), 0.5 * q * dt * dt);
        self.velocity_variance = plus_diagonal(self.velocity_variance, q * dt);
    }

    /// Updates with a measured position whose covariance is positive definite.
    pub(crate) fn update(&mut self, measured: Point, variance: Mat2) {
        let innovation = sub(measured, self.position);
        let weight = inverse(combine(self.position_variance, variance, 1.0));
        let position_gain = times(self.position_variance, weight);
        let velocity_gain = times(transpose(self.cross), weight);
        self.position = add(self.position, apply(position_gain, innovation));
        self.velocity = add(self.velocity, apply(velocity_gain, innovation));
        self.velocity_variance = symmetric(combine(self.velocity_variance, times(velocity_gain, self.cross), -1.0));
        self.cross = combine(self.cross, times(position_gain, self.cross), -1.0);
        self.position_variance =
            symmetric(combine(self.position_variance, times(position_gain, self.position_variance), -1.0));
    }

    /// Squared Mahalanobis distance of a measured position from the predicted one.
    pub(crate) fn distance_squared(&self, measured: Point, variance: Mat2) -> f64 {
        let innovation = sub(measured, self.position);
        let weighted = apply(inverse(combine(self.position_variance, variance, 1.0)), innovation);
        innovation[0] * weighted[0] + innovation[1] * weighted[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_constant_velocity() {
        let variance = plus_diagonal([[0.0; 2]; 2], 1e-6);
        let mut filter = Kalman::new([0.0, 0.0], variance, [0.0, 0.0], 0.5);
        for frame in 1..=100 {
            filter.predict(0.01, 1e-4);
            let t = 0.01 * f64::from(frame);
            filter.update([0.08 * t, -0.03 * t], variance);
        }
        // With exact measurements of a constant velocity, the only error is the start at rest, forgotten over 100
        // frames.
        assert!((filter.velocity[0] - 0.08).abs() < 1e-3 && (filter.velocity[1] + 0.03).abs() < 1e-3);
        assert!((filter.position[0] - 0.08).abs() < 1e-4);
        let p = filter.position_variance;
        assert!(p[0][0] > 0.0 && p[0][0] < 1e-6 && (p[0][1] - p[1][0]).abs() < 1e-18);
    }
}
