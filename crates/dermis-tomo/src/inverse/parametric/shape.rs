//! The shape of a spot: a Gaussian, or the pressure of a flat round face, smoothed across its edge.

use crate::normal::{REACH, normal};

/// Smallest and largest smoothing of the edge, relative to the radius of the spot. With the largest, the face is 1.5
/// times as wide as its edge. With 0.5 instead of 0.35, presses twice as wide as a fingertip pass for several in one of
/// fifteen; with much sharper edges, wide spots pass for two presses.
const EDGES: [f64; 2] = [0.35, 0.776];
/// Exponent beyond which a Gaussian counts as zero: 6e-6.
const NOTHING: f64 = 12.0;

/// Load of a spot of amplitude 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpotShape {
    /// `exp(-d^2 / (2 r^2))` at distance d from the centre.
    Gaussian {
        /// Radius r, metres.
        radius_m: f64,
    },
    /// `h Phi((R - d) / s)`, with the normal distribution Phi. Height h and radius R give it the integral and the
    /// second moment of a Gaussian.
    Disc {
        /// Radius R, metres.
        disc_m: f64,
        /// Standard deviation s by which the edge is smoothed, metres.
        edge_m: f64,
        /// Height h.
        height: f64,
    },
}

impl SpotShape {
    /// A spot of this radius: a Gaussian, or a disc on a layer that smooths edges by this standard deviation (metres),
    /// within limits that depend on the radius.
    ///
    /// The integral of `Phi((R - d) / s)` is `pi (R^2 + s^2)`, and that of its product with `d^2` is `pi / 2 (R^4 + 6
    /// R^2 s^2 + 3 s^4)`, for s well below R. Their ratio must be `2 r^2`.
    pub fn new(radius_m: f64, smoothing_m: Option<f64>) -> Self {
        let Some(smoothing_m) = smoothing_m else { return Self::Gaussian { radius_m } };
        let [least, widest] = EDGES.map(|share| share * radius_m);
        let edge_m = smoothing_m.clamp(least, widest);
        let (wanted, edge) = (radius_m * radius_m, edge_m * edge_m);
        let half = 2.0 * wanted - 3.0 * edge;
        let square = half + (half * half + 4.0 * wanted * edge - 3.0 * edge * edge).sqrt();
        Self::Disc { disc_m: square.sqrt(), edge_m, height: 2.0 * wanted / (square + edge) }
    }

    /// The load at a squared distance from the centre.
    #[inline]
    pub fn at(&self, square_m2: f64) -> f64 {
        match *self {
            Self::Gaussian { radius_m } => {
                let exponent = 0.5 * square_m2 / (radius_m * radius_m);
                if exponent < NOTHING { (-exponent).exp() } else { 0.0 }
            }
            Self::Disc { disc_m, edge_m, height } => {
                let inside = disc_m - square_m2.sqrt();
                if inside >= REACH * edge_m {
                    height
                } else if inside > -REACH * edge_m {
                    height * normal(inside / edge_m)[0]
                } else {
                    0.0
                }
            }
        }
    }

    /// Derivative of the load by the distance, at a squared distance, 1/m.
    pub fn slope_at(&self, square_m2: f64) -> f64 {
        match *self {
            Self::Gaussian { radius_m } => -self.at(square_m2) * square_m2.sqrt() / (radius_m * radius_m),
            Self::Disc { disc_m, edge_m, height } => {
                let inside = (disc_m - square_m2.sqrt()) / edge_m;
                if inside.abs() < REACH { -height / edge_m * normal(inside)[1] } else { 0.0 }
            }
        }
    }

    /// The load in the middle of a large face.
    pub fn height(&self) -> f64 {
        match *self {
            Self::Gaussian { .. } => 1.0,
            Self::Disc { height, .. } => height,
        }
    }

    /// Distances up to which the load is full, and from which it is zero, metres.
    pub fn edges_m(&self) -> [f64; 2] {
        match *self {
            Self::Gaussian { radius_m } => [0.0, radius_m * (2.0 * NOTHING).sqrt()],
            Self::Disc { disc_m, edge_m, .. } => [(disc_m - REACH * edge_m).max(0.0), disc_m + REACH * edge_m],
        }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::PI;

    use super::*;

    /// Integral over the plane of a function of the distance, in small rings.
    fn over_the_plane(reach_m: f64, of: impl Fn(f64) -> f64) -> f64 {
        let width_m = reach_m / 20_000.0;
        (0..20_000).map(|k| (k as f64 + 0.5) * width_m).map(|d| 2.0 * PI * d * of(d) * width_m).sum()
    }

    #[test]
    fn a_spot_has_the_integral_and_the_second_moment_of_a_gaussian() {
        for (radius_m, smoothing_m) in [(5e-3, 2.5e-3), (0.01, 4e-3), (4e-3, 0.1), (2e-3, 1e-6)] {
            let shape = SpotShape::new(radius_m, Some(smoothing_m));
            let [_, reach_m] = shape.edges_m();
            let integral = over_the_plane(reach_m, |d| shape.at(d * d));
            let second = over_the_plane(reach_m, |d| d * d * shape.at(d * d));
            // The closed forms leave out what a smoothed edge has beyond the centre: 0.7 % for the widest one.
            let gaussian = 2.0 * PI * radius_m * radius_m;
            assert!((integral / gaussian - 1.0).abs() < 0.01, "{radius_m} {smoothing_m}: {}", integral / gaussian);
            let square = 2.0 * radius_m * radius_m;
            assert!((second / integral / square - 1.0).abs() < 0.01, "{}", second / integral / square);
        }
    }

    #[test]
    fn a_sharp_edge_makes_nearly_a_disc_and_a_wide_one_nearly_a_gaussian() {
        // A disc of radius R has the second moment R^2 / 2, so R = 2 r, and half the height of the Gaussian. With an
        // edge of 0.35 r, it is 1.84 r.
        let disc = SpotShape::new(5e-3, Some(1e-6));
        assert!((disc.at(0.0) - 0.57).abs() < 0.01 && (disc.at(9.2e-3_f64.powi(2)) / disc.at(0.0) - 0.5).abs() < 0.02);
        assert!(disc.at(0.019_f64.powi(2)) == 0.0 && (disc.at(25e-6) / disc.at(0.0) - 1.0).abs() < 0.01);
        let wide = SpotShape::new(5e-3, Some(1.0));
        for d in [0.0, 2e-3, 5e-3, 8e-3, 0.012, 0.016] {
            let gaussian = (-d * d / (2.0 * 25e-6_f64)).exp();
            assert!((wide.at(d * d) - gaussian).abs() < 0.1, "{d}: {} {gaussian}", wide.at(d * d));
        }
    }

    #[test]
    fn the_slope_is_the_difference_quotient() {
        for smoothing_m in [None, Some(2e-3)] {
            let shape = SpotShape::new(6e-3, smoothing_m);
            for d in [6e-3, 0.011, 0.014_f64] {
                let step = 2e-4;
                let difference = (shape.at((d + step).powi(2)) - shape.at((d - step).powi(2))) / (2.0 * step);
                assert!((difference - shape.slope_at(d * d)).abs() < 0.01 * shape.height() / 2e-3, "{d}");
            }
        }
    }
}
