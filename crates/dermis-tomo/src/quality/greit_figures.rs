//! The five figures of merit for the image of one small target, from A. Adler et al., *GREIT: a unified approach to
//! 2D linear EIT reconstruction of lung images*, Physiol. Meas. 30 (2009) S35, section 3: amplitude response,
//! position error, resolution, shape deformation and ringing.

use super::error::{QualityError, check_positive};
use super::peak::{centroid_m, peak};
use crate::mesh::{PixelGrid, Point, distance};

/// The target that an image should show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Centre, metres.
    pub centre_m: Point,
    /// Area, m^2.
    pub area_m2: f64,
    /// Change, in the unit of the image (S/m for conductivity); negative for a drop.
    pub change: f64,
}

/// Figures for the image of one target. The quarter-amplitude set q contains the pixels with at least a quarter of
/// the image's largest value, in the target's direction; C is the disc of equal area around q's centroid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GreitFigures {
    /// Sum of the image times the pixel area, divided by the target's change times its area: 1 if the whole change is
    /// recovered. Should not depend on the target's position.
    pub amplitude_response: f64,
    /// Distance of the target from the skin's centre minus that of q's centroid, metres; positive if the image is
    /// displaced inwards. The centre is the centroid of all pixels on the skin.
    pub radial_position_error_m: f64,
    /// Distance from q's centroid to the target, metres.
    pub position_error_m: f64,
    /// Square root of q's area relative to the skin's; smaller is sharper.
    pub resolution: f64,
    /// Share of q's pixels outside C: 0 for a round image.
    pub shape_deformation: f64,
    /// Sum of the values of opposite sign outside C relative to the sum inside C, in magnitude: 0 without overshoot.
    pub ringing: f64,
}

impl GreitFigures {
    /// Figures of an image (row-major, NaN outside the skin) on a grid.
    ///
    /// # Errors
    /// A length that does not match the grid, a target without area or change, or an image without a value of the
    /// target's sign.
    pub fn of(image: &[f64], grid: &PixelGrid, target: &Target) -> Result<Self, QualityError> {
        check_positive("target area_m2", target.area_m2)?;
        if !target.change.is_finite() || target.change == 0.0 {
            let (field, expected) = ("target change", "finite, not 0");
            return Err(QualityError::Value { field, value: target.change, expected });
        }
        let sign = target.change.signum();
        let (_, height) = peak(image, grid, sign)?;
        let skin: Vec<usize> = (0..image.len()).filter(|&index| image[index].is_finite()).collect();
        let quarter: Vec<usize> = skin.iter().copied().filter(|&i| sign * image[i] >= 0.25 * height).collect();
        let pixel_m2 = grid.pixel_m * grid.pixel_m;
        let (middle, centre) = (centroid_m(grid, &skin), centroid_m(grid, &quarter));
        let radius_m = (quarter.len() as f64 * pixel_m2 / std::f64::consts::PI).sqrt();
        let in_disc = |index: usize| distance(grid.centre_m(index), centre) <= radius_m;
        let total: f64 = skin.iter().map(|&index| image[index]).sum();
        let outside = quarter.iter().filter(|&&index| !in_disc(index)).count();
        let (mut inner, mut opposite) = (0.0, 0.0);
        for &index in &skin {
            let value = sign * image[index];
            if in_disc(index) {
                inner += value;
            } else if value < 0.0 {
                opposite -= value;
            }
        }
        Ok(Self {
            amplitude_response: total * pixel_m2 / (target.change * target.area_m2),
            radial_position_error_m: distance(target.centre_m, middle) - distance(centre, middle),
            position_error_m: distance(target.centre_m, centre),
            resolution: (quarter.len() as f64 / skin.len() as f64).sqrt(),
            shape_deformation: outside as f64 / quarter.len() as f64,
            ringing: opposite / inner,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A disc of radius 1 m in 200 x 200 pixels, with values from a function of position.
    fn disc(value: impl Fn(f64, f64) -> f64) -> (PixelGrid, Vec<f64>) {
        let grid = PixelGrid { columns: 200, rows: 200, left_m: -1.0, top_m: 1.0, pixel_m: 0.01 };
        let image = grid.centres_m().into_iter().map(|[x, y]| if x.hypot(y) > 1.0 { f64::NAN } else { value(x, y) });
        let image = image.collect();
        (grid, image)
    }

    #[test]
    fn a_round_image_with_a_trough_around_it() {
        // -2 within 0.2 m of (0.4, 0), +0.1 in the ring from 0.2 to 0.3 m.
        let (grid, image) = disc(|x, y| match (x - 0.4).hypot(y) {
            r if r <= 0.2 => -2.0,
            r if r <= 0.3 => 0.1,
            _ => 0.0,
        });
        let target = Target { centre_m: [0.5, 0.0], area_m2: 0.04 * PI, change: -2.0 };
        let figures = GreitFigures::of(&image, &grid, &target).unwrap();
        // Areas of 0.04 pi and 0.05 pi; discs with a radius of 20 pixels have them within 1 %.
        let response = (2.0 * 0.04 - 0.1 * 0.05) / (2.0 * 0.04);
        assert!((figures.amplitude_response - response).abs() < 0.01, "{figures:?}");
        assert!((figures.position_error_m - 0.1).abs() < 1e-9, "{figures:?}");
        assert!((figures.radial_position_error_m - 0.1).abs() < 1e-9, "{figures:?}");
        assert!((figures.resolution - 0.2).abs() < 0.002, "{figures:?}");
        assert!(figures.shape_deformation < 0.01, "{figures:?}");
        assert!((figures.ringing - 0.1 * 0.05 / (2.0 * 0.04)).abs() < 0.002, "{figures:?}");
    }

    #[test]
    fn an_oblong_image_is_deformed_by_the_share_outside_the_equal_disc() {
        // A 4:1 rectangle of 0.8 x 0.2 m. The disc of equal area has a radius of 0.22568 m and intersects it at x =
        // +-sqrt(r^2 - y^2).
        let (grid, image) = disc(|x, y| f64::from(u8::from(x.abs() < 0.4 && y.abs() < 0.1)));
        let target = Target { centre_m: [0.0, 0.0], area_m2: 0.16, change: 1.0 };
        let figures = GreitFigures::of(&image, &grid, &target).unwrap();
        let r2 = 0.16 / PI;
        // Overlap of the two: 4 times the integral of sqrt(r^2 - y^2) from 0 to 0.1.
        let h = 0.1_f64;
        let inside = 2.0 * (h * (r2 - h * h).sqrt() + r2 * (h / r2.sqrt()).asin());
        let exact = 1.0 - inside / 0.16;
        assert!((figures.shape_deformation - exact).abs() < 0.01, "{figures:?} {exact}");
        assert!((figures.amplitude_response - 1.0).abs() < 1e-9);
        assert_eq!(figures.ringing, 0.0);
    }

    #[test]
    fn impossible_targets_are_named() {
        let (grid, image) = disc(|_, _| 1.0);
        let target = Target { centre_m: [0.0; 2], area_m2: 1.0, change: -1.0 };
        assert!(matches!(GreitFigures::of(&image, &grid, &target), Err(QualityError::Undefined { .. })));
        let error = GreitFigures::of(&image, &grid, &Target { area_m2: 0.0, ..target }).unwrap_err();
        assert_eq!(error.to_string(), "target area_m2 = 0: expected positive and finite");
        assert!(GreitFigures::of(&image[1..], &grid, &Target { change: 1.0, ..target }).is_err());
    }
}
