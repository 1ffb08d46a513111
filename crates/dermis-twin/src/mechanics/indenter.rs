//! Indenters, and the pressure that reaches the layer under the cover: the indenter's uniform pressure, smoothed
//! across its edge by a Gaussian of standard deviation l (the cover's smoothing length), and scaled so that the whole
//! field carries the indenter's force (minus what falls off the skin).

use std::f64::consts::{FRAC_1_SQRT_2, PI, TAU};

use dermis_tomo::mesh::Point;
use serde::{Deserialize, Serialize};

use super::mask::Mask;
use crate::error::{TwinError, check, check_positive};

/// Standard acceleration of gravity, m/s^2, to convert mass to weight.
pub const STANDARD_GRAVITY_M_PER_S2: f64 = 9.80665;

/// Number of standard deviations beyond which a smoothed edge counts as zero (its value there is 3e-7 of the
/// pressure).
const REACH: f64 = 5.0;

/// The layer between indenter and contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Cover {
    /// Standard deviation of the smoothing, metres. A load spreads by about the thickness of the material it passes
    /// through.
    pub smoothing_m: f64,
}

impl Cover {
    /// Checks the number.
    ///
    /// # Errors
    /// A smoothing that is not positive and finite.
    pub fn check(&self) -> Result<(), TwinError> {
        check_positive("cover smoothing_m", self.smoothing_m)
    }
}

/// Shape of an indenter's face, seen from above.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Shape {
    /// A flat round face.
    Disc {
        /// Radius.
        radius_m: f64,
    },
    /// The edge of a tube.
    Ring {
        /// Inner radius.
        inner_m: f64,
        /// Outer radius.
        outer_m: f64,
    },
    /// A straight edge.
    Line {
        /// Length along the edge.
        length_m: f64,
        /// Width across the edge.
        width_m: f64,
        /// Direction, radians counter-clockwise from +x.
        angle_rad: f64,
    },
    /// A flat rectangular face.
    Rectangle {
        /// Along its own x axis.
        width_m: f64,
        /// Along its own y axis.
        height_m: f64,
        /// Rotation of its axes, radians counter-clockwise.
        angle_rad: f64,
    },
    /// Any face, given as a picture.
    Mask {
        /// The cells that press.
        mask: Mask,
        /// Side length of a cell.
        cell_m: f64,
        /// Rotation of the picture, radians counter-clockwise.
        angle_rad: f64,
    },
}

/// Load on an indenter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Load {
    /// Mean pressure under its face, pascals.
    PressurePa(f64),
    /// Total force, newtons.
    ForceN(f64),
}

/// One indenter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Indenter {
    /// Centre of its face.
    pub centre_m: Point,
    /// Shape of its face.
    pub shape: Shape,
    /// Load on it.
    pub load: Load,
}

impl Shape {
    /// Area of the face, m^2.
    pub fn area_m2(&self) -> f64 {
        match *self {
            Self::Disc { radius_m } => PI * radius_m * radius_m,
            Self::Ring { inner_m, outer_m } => PI * (outer_m * outer_m - inner_m * inner_m),
            Self::Line { length_m: a, width_m: b, .. } | Self::Rectangle { width_m: a, height_m: b, .. } => a * b,
            Self::Mask { mask, cell_m, .. } => mask.pressed_cells() as f64 * cell_m * cell_m,
        }
    }

    /// Radius of a disc of equal area, metres.
    pub fn equal_area_radius_m(&self) -> f64 {
        (self.area_m2() / PI).sqrt()
    }

    /// Smoothed indicator function at an offset from the centre: 1 well inside, 1/2 on a straight edge, 0 outside.
    /// Exact convolutions for lines and rectangles; radial edges are smoothed like straight ones.
    fn profile(&self, offset: [f64; 2], smoothing: f64) -> f64 {
        let below = |edge: f64, position: f64| normal_cdf((edge - position) / smoothing);
        let slab = |width: f64, position: f64| below(width / 2.0, position) - below(-width / 2.0, position);
        match *self {
            Self::Disc { radius_m } => below(radius_m, offset[0].hypot(offset[1])),
            Self::Ring { inner_m, outer_m } => {
                let r = offset[0].hypot(offset[1]);
                below(outer_m, r) - below(inner_m, r)
            }
            Self::Line { length_m: width, width_m: height, angle_rad }
            | Self::Rectangle { width_m: width, height_m: height, angle_rad } => {
                let [along, across] = turned(offset, angle_rad);
                slab(width, along) * slab(height, across)
            }
            Self::Mask { mask, cell_m, angle_rad } => {
                let cells = turned(offset, angle_rad).map(|length| length / cell_m);
                mask.profile(cells, |edge, position| normal_cdf((edge - position) * cell_m / smoothing))
            }
        }
    }

    /// Integral of the profile over the plane. With R ~ N(a, l^2), the integral for a disc is `pi E[R^2; R > 0]`.
    fn profile_area(&self, smoothing: f64) -> f64 {
        let round = |radius: f64| {
            let ratio = radius / smoothing;
            let density = (-0.5 * ratio * ratio).exp() / TAU.sqrt();
            PI * ((radius * radius + smoothing * smoothing) * normal_cdf(ratio) + radius * smoothing * density)
        };
        match *self {
            Self::Disc { radius_m } => round(radius_m),
            Self::Ring { inner_m, outer_m } => round(outer_m) - round(inner_m),
            _ => self.area_m2(),
        }
    }

    /// Distance from the centre beyond which the profile is zero.
    fn reach(&self, smoothing: f64) -> f64 {
        let farthest = match *self {
            Self::Disc { radius_m } => radius_m,
            Self::Ring { outer_m, .. } => outer_m,
            Self::Line { length_m: a, width_m: b, .. } | Self::Rectangle { width_m: a, height_m: b, .. } => {
                a.hypot(b) / 2.0
            }
            Self::Mask { mask, cell_m, .. } => cell_m * (mask.rows() as f64).hypot(mask.columns() as f64) / 2.0,
        };
        farthest + REACH * smoothing
    }

    fn check(&self) -> Result<(), TwinError> {
        match *self {
            Self::Disc { radius_m } => check_positive("disc radius_m", radius_m),
            Self::Ring { inner_m, outer_m } => {
                check("ring inner_m", inner_m, 0.0, f64::MAX, "zero or more, finite")?;
                check_positive("ring outer_m less inner_m", outer_m - inner_m)
            }
            Self::Line { length_m: a, width_m: b, angle_rad }
            | Self::Rectangle { width_m: a, height_m: b, angle_rad } => {
                check_positive("length or width of the indenter, m", a)?;
                check_positive("width or height of the indenter, m", b)?;
                check("angle_rad", angle_rad, -1e6, 1e6, "a finite angle")
            }
            Self::Mask { cell_m, angle_rad, .. } => {
                check_positive("mask cell_m", cell_m)?;
                check("angle_rad", angle_rad, -1e6, 1e6, "a finite angle")
            }
        }
    }
}

impl Indenter {
    /// A round indenter with a mean pressure.
    pub fn disc(centre_m: Point, radius_m: f64, pressure_pa: f64) -> Self {
        Self { centre_m, shape: Shape::Disc { radius_m }, load: Load::PressurePa(pressure_pa) }
    }

    /// A round weight lying on the skin, with its mass in grams.
    pub fn weight(centre_m: Point, radius_m: f64, mass_g: f64) -> Self {
        let load = Load::ForceN(1e-3 * mass_g * STANDARD_GRAVITY_M_PER_S2);
        Self { centre_m, shape: Shape::Disc { radius_m }, load }
    }

    /// Mean pressure under the face, pascals.
    pub fn pressure_pa(&self) -> f64 {
        match self.load {
            Load::PressurePa(pressure) => pressure,
            Load::ForceN(force) => force / self.shape.area_m2(),
        }
    }

    /// Total force, newtons.
    pub fn force_n(&self) -> f64 {
        self.pressure_pa() * self.shape.area_m2()
    }

    /// The same indenter with `share` times the load.
    pub fn scaled(&self, share: f64) -> Self {
        Self { load: Load::PressurePa(share * self.pressure_pa()), ..*self }
    }

    /// Adds its pressure at each position, pascals.
    pub fn add_pressure(&self, cover: Cover, positions_m: &[Point], pressure_pa: &mut [f64]) {
        let field = self.field(cover);
        for (position, sum) in positions_m.iter().zip(pressure_pa) {
            if field.reaches(*position, 0.0) {
                *sum += field.pressure_pa(*position);
            }
        }
    }

    /// The pressure field under the cover.
    pub(super) fn field(&self, cover: Cover) -> PressureField {
        let smoothing = cover.smoothing_m;
        PressureField {
            centre_m: self.centre_m,
            shape: self.shape,
            smoothing,
            peak_pa: self.force_n() / self.shape.profile_area(smoothing),
            reach_m: self.shape.reach(smoothing),
        }
    }

    /// Checks the numbers.
    ///
    /// # Errors
    /// Non-finite coordinates, lengths that are not positive, or a negative load.
    pub fn check(&self) -> Result<(), TwinError> {
        check("centre_m (x)", self.centre_m[0], -1e3, 1e3, "a position in metres")?;
        check("centre_m (y)", self.centre_m[1], -1e3, 1e3, "a position in metres")?;
        self.shape.check()?;
        match self.load {
            Load::PressurePa(value) => check("pressure_pa", value, 0.0, 1e9, "0 to 1e9 Pa"),
            Load::ForceN(value) => check("force_n", value, 0.0, 1e6, "0 to 1e6 N"),
        }?;
        // This also refuses a force on a face too small for it.
        check("pressure_pa", self.pressure_pa(), 0.0, 1e9, "0 to 1e9 Pa")
    }
}

/// The pressure of one indenter under the cover.
pub(super) struct PressureField {
    centre_m: Point,
    shape: Shape,
    smoothing: f64,
    peak_pa: f64,
    reach_m: f64,
}

impl PressureField {
    /// False if the pressure is zero everywhere within `margin_m` of a position.
    pub(super) fn reaches(&self, position_m: Point, margin_m: f64) -> bool {
        let reach = self.reach_m + margin_m;
        let [dx, dy] = [position_m[0] - self.centre_m[0], position_m[1] - self.centre_m[1]];
        dx * dx + dy * dy < reach * reach
    }

    /// Pressure at a position, pascals.
    pub(super) fn pressure_pa(&self, position_m: Point) -> f64 {
        let offset = [position_m[0] - self.centre_m[0], position_m[1] - self.centre_m[1]];
        self.peak_pa * self.shape.profile(offset, self.smoothing)
    }
}

/// An offset in the axes of a shape rotated by an angle.
fn turned([x, y]: Point, angle_rad: f64) -> Point {
    let (sine, cosine) = angle_rad.sin_cos();
    [x * cosine + y * sine, y * cosine - x * sine]
}

/// Standard normal distribution function. Relative pressure under a cover, at a distance of `x` smoothing lengths
/// inside a straight edge.
pub fn normal_cdf(x: f64) -> f64 {
    if x > 6.0 {
        1.0
    } else if x < -6.0 {
        0.0
    } else {
        0.5 * libm::erfc(-x * FRAC_1_SQRT_2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const COVER: Cover = Cover { smoothing_m: 1.5e-3 };

    /// Sum of the pressure over a grid of 0.25 mm, newtons.
    fn carried_force(indenter: Indenter) -> f64 {
        let step = 2.5e-4;
        let axis = |k: i32| f64::from(k) * step;
        let positions: Vec<Point> = (-200..=200).flat_map(|i| (-200..=200).map(move |j| [axis(i), axis(j)])).collect();
        let mut pressure = vec![0.0; positions.len()];
        indenter.add_pressure(COVER, &positions, &mut pressure);
        pressure.iter().sum::<f64>() * step * step
    }

    #[test]
    fn every_shape_carries_its_force() {
        let shapes = [
            Shape::Disc { radius_m: 0.01 },
            Shape::Disc { radius_m: 0.001 },
            Shape::Ring { inner_m: 0.008, outer_m: 0.012 },
            Shape::Line { length_m: 0.03, width_m: 0.002, angle_rad: 0.7 },
            Shape::Rectangle { width_m: 0.02, height_m: 0.01, angle_rad: -0.3 },
            Shape::Mask { mask: Mask::from_rows(&["#.##", ".#..", "###."]).unwrap(), cell_m: 0.004, angle_rad: 0.4 },
        ];
        for shape in shapes {
            let indenter = Indenter { centre_m: [0.003, -0.002], shape, load: Load::ForceN(2.5) };
            indenter.check().unwrap();
            // On a grid six times finer than the smoothing the sum is exact up to rounding, except for the conical
            // tip at the centre of the smallest disc.
            let force = carried_force(indenter);
            assert!((force / 2.5 - 1.0).abs() < 2e-3, "{shape:?} carries {force} N");
        }
    }

    #[test]
    fn pressure_and_force_agree() {
        let press = Indenter::disc([0.0; 2], 0.01, 80e3);
        assert!((press.force_n() - 25.132_741).abs() < 1e-6);
        let same = Indenter { load: Load::ForceN(press.force_n()), ..press };
        assert!((same.pressure_pa() - 80e3).abs() < 1e-6);
        assert!((same.scaled(0.5).force_n() - press.force_n() / 2.0).abs() < 1e-9);
    }

    #[test]
    fn a_mask_of_one_cell_is_a_square_and_rows_run_down() {
        let at = |shape: Shape, position: Point| {
            let mut pressure = [0.0];
            let indenter = Indenter { centre_m: [0.01, 0.0], shape, load: Load::PressurePa(1e3) };
            indenter.add_pressure(COVER, &[position], &mut pressure);
            pressure[0]
        };
        let square = Shape::Rectangle { width_m: 0.006, height_m: 0.006, angle_rad: 0.3 };
        let cell = Shape::Mask { mask: Mask::from_rows(&["#"]).unwrap(), cell_m: 0.006, angle_rad: 0.3 };
        let corner = Shape::Mask { mask: Mask::from_rows(&["#.", ".."]).unwrap(), cell_m: 0.006, angle_rad: 0.0 };
        for position in [[0.01, 0.0], [0.013, 0.001], [0.006, -0.003]] {
            assert!((at(square, position) - at(cell, position)).abs() < 1e-9 * 1e3);
        }
        // The first cell of the first row is at the top left.
        assert!(at(corner, [0.007, 0.003]) > 900.0 && at(corner, [0.013, -0.003]) < 1.0);
    }

    #[test]
    fn grams_become_newtons() {
        // One weight of 6.5 g exerts 64 mN, or 0.203 kPa on a disc of 20 mm.
        let weight = Indenter::weight([0.0; 2], 0.01, 6.5);
        assert!((weight.force_n() - 0.06374).abs() < 1e-5 && (weight.pressure_pa() - 203.0).abs() < 0.5);
    }

    #[test]
    fn bad_input_is_refused() {
        assert!(Indenter::disc([f64::NAN, 0.0], 0.01, 1e3).check().is_err());
        assert!(Indenter::disc([0.0; 2], 0.0, 1e3).check().is_err());
        assert!(Indenter::disc([0.0; 2], 0.01, -1.0).check().is_err());
        let ring = Shape::Ring { inner_m: 0.01, outer_m: 0.01 };
        assert!(Indenter { shape: ring, ..Indenter::disc([0.0; 2], 0.01, 1e3) }.check().is_err());
    }
}
