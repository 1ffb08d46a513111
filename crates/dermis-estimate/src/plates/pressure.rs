//! The pressure under presses, and the contact that it makes.

use dermis_tomo::mesh::Point;
use dermis_tomo::normal::{self, deviate_below, normal};

/// Parameters of a press: x, y, logarithm of the pressure, logarithm of the radius.
pub(super) const OF_PRESS: usize = 4;

/// A press in the parameters of the fit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pressed {
    pub position_m: Point,
    pub log_pressure: f64,
    pub log_radius: f64,
    /// It is part of the baseline and has ended.
    pub has_ended: bool,
}

/// `T C T'`.
pub(super) fn turned(
    turn: &[[f64; OF_PRESS]; OF_PRESS],
    covariance: &[[f64; OF_PRESS]; OF_PRESS],
) -> [[f64; OF_PRESS]; OF_PRESS] {
    let product = |a: usize, b: usize| {
        let pairs = (0..OF_PRESS).flat_map(|j| (0..OF_PRESS).map(move |k| (j, k)));
        pairs
            .filter(|&(j, k)| turn[a][j] != 0.0 && turn[b][k] != 0.0)
            .map(|(j, k)| turn[a][j] * covariance[j][k] * turn[b][k])
            .sum()
    };
    std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)))
}

/// The pressure under one press.
#[derive(Clone, Copy, Debug)]
pub(super) struct Field {
    centre_m: Point,
    pressure_pa: f64,
    radius_m: f64,
    spread_m: f64,
    per_spread: f64,
    /// Squared radii of the full pressure, and of all of it.
    square_core: f64,
    square_reach: f64,
}

impl Field {
    /// Pressures further outside the disc than this many spreads are left out, and those further inside are full.
    pub const REACH: f64 = normal::REACH;

    pub fn new(press: &Pressed, spread_m: f64) -> Self {
        let (pressure_pa, radius_m) = (press.log_pressure.exp(), press.log_radius.exp());
        let edge_m = Self::REACH * spread_m;
        let (core_m, reach_m) = ((radius_m - edge_m).max(0.0), radius_m + edge_m);
        let (square_core, square_reach) = (core_m * core_m, reach_m * reach_m);
        let (centre_m, per_spread) = (press.position_m, spread_m.recip());
        Self { centre_m, pressure_pa, radius_m, spread_m, per_spread, square_core, square_reach }
    }

    /// Distance from the centre beyond which there is no pressure, metres.
    pub fn reach_m(&self) -> f64 {
        self.radius_m + Self::REACH * self.spread_m
    }

    /// Distance from the centre beyond which the pressure is below this one (pascal), metres; at most the reach.
    pub fn reach_above_m(&self, least_pa: f64) -> f64 {
        let u = deviate_below(least_pa / self.pressure_pa);
        self.radius_m - u * self.spread_m
    }

    /// Distance from the centre up to which the pressure is full, metres.
    pub fn core_m(&self) -> f64 {
        self.square_core.sqrt()
    }

    /// Pressure at a distance from the centre beyond the full pressure (pascal), and its derivative by that distance.
    pub fn pressure_across(&self, distance_m: f64) -> (f64, f64) {
        let [below, density] = normal((self.radius_m - distance_m) * self.per_spread);
        (self.pressure_pa * below, -self.pressure_pa * density * self.per_spread)
    }

    /// Offset from the centre, and its square.
    #[inline]
    fn offset(&self, place_m: Point) -> ([f64; 2], f64) {
        let off = [place_m[0] - self.centre_m[0], place_m[1] - self.centre_m[1]];
        (off, off[0] * off[0] + off[1] * off[1])
    }

    /// Pressure at a position, pascal.
    #[inline]
    pub fn pressure_at(&self, place_m: Point) -> f64 {
        let (_, square) = self.offset(place_m);
        if square <= self.square_core {
            self.pressure_pa
        } else if square <= self.square_reach {
            self.pressure_across(square.sqrt()).0
        } else {
            0.0
        }
    }

    /// Derivatives of the pressure at a position by the parameters of the press; `None` beyond its reach.
    pub fn derivatives_at(&self, place_m: Point) -> Option<[f64; OF_PRESS]> {
        let (off, square) = self.offset(place_m);
        if square <= self.square_core {
            return Some([0.0, 0.0, self.pressure_pa, 0.0]);
        }
        if square > self.square_reach {
            return None;
        }
        let distance_m = square.sqrt();
        let (pressure, outwards) = self.pressure_across(distance_m);
        let along = -outwards / distance_m.max(1e-9);
        Some([along * off[0], along * off[1], pressure, -outwards * self.radius_m])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_a_pressure_are_those_of_differences() {
        let press = Pressed { position_m: [0.0; 2], log_pressure: 9.0, log_radius: 8e-3_f64.ln(), has_ended: false };
        let at = |press: &Pressed| Field::new(press, 1e-3).pressure_at([7e-3, 3e-3]);
        let by = Field::new(&press, 1e-3).derivatives_at([7e-3, 3e-3]).unwrap();
        let moved = |parameter: usize, step: f64| {
            let mut moved = press;
            match parameter {
                0 | 1 => moved.position_m[parameter] += step,
                2 => moved.log_pressure += step,
                _ => moved.log_radius += step,
            }
            at(&moved)
        };
        for (parameter, h) in [1e-4, 1e-4, 1e-3, 1e-2].into_iter().enumerate() {
            let difference = (moved(parameter, h) - moved(parameter, -h)) / (2.0 * h);
            // Steps of a tenth of the edge and more, which is wider than the table's.
            assert!((difference / by[parameter] - 1.0).abs() < 0.01, "{parameter}: {difference} {}", by[parameter]);
        }
    }
}
