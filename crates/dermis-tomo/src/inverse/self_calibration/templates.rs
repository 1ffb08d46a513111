//! Effect of a touch at each place on each channel: Jacobian rows summed over a touch of Gaussian shape,
//! `T[c, g] = sum_p exp(-|x_p - x_g|^2 / (2 s^2)) J[c, p]`.

use faer::{Mat, MatRef};

use super::super::error::positive;
use super::super::{InverseError, check_finite};
use crate::mesh::Point;

/// Voltage changes due to a touch of unit conductivity change at each of a list of places.
#[derive(Clone, Debug)]
pub struct TouchTemplates {
    /// Channels x places.
    matrix: Mat<f64>,
    places_m: Vec<Point>,
}

impl TouchTemplates {
    /// Builds templates from a matrix (channels x places, `dv` for a *rise* of conductivity) and the positions of its
    /// columns, metres.
    ///
    /// # Errors
    /// No channel or place, mismatched sizes, or non-finite values.
    pub fn new(matrix: Mat<f64>, places_m: Vec<Point>) -> Result<Self, InverseError> {
        if places_m.is_empty() || places_m.len() != matrix.ncols() {
            let expected = matrix.ncols().max(1);
            return Err(InverseError::Size { what: "places of the templates", expected, got: places_m.len() });
        }
        if matrix.nrows() == 0 {
            return Err(InverseError::Size { what: "channels of the templates", expected: 1, got: 0 });
        }
        check_finite("place coordinate", &places_m.iter().flatten().copied().collect::<Vec<_>>())?;
        for column in matrix.col_iter() {
            check_finite("touch template", &column.iter().copied().collect::<Vec<_>>())?;
        }
        Ok(Self { matrix, places_m })
    }

    /// Builds templates from a Jacobian per pixel (channels x pixels) by summing it over a Gaussian touch of standard
    /// deviation `touch_sigma_m` around each place. Places may be a subset of the pixels. Leave out those within
    /// about a touch's width of the rim, where electrodes make every channel respond to everything.
    ///
    /// # Errors
    /// As [`TouchTemplates::new`]; also fails if the touch size is not positive and finite.
    pub fn blurred(
        jacobian: MatRef<'_, f64>,
        pixels_m: &[Point],
        places_m: &[Point],
        touch_sigma_m: f64,
    ) -> Result<Self, InverseError> {
        if pixels_m.len() != jacobian.ncols() {
            let (expected, got) = (jacobian.ncols(), pixels_m.len());
            return Err(InverseError::Size { what: "pixel positions", expected, got });
        }
        positive("touch_sigma_m", touch_sigma_m)?;
        let touch = Mat::from_fn(pixels_m.len(), places_m.len(), |pixel, place| {
            (-square_distance(pixels_m[pixel], places_m[place]) / (2.0 * touch_sigma_m * touch_sigma_m)).exp()
        });
        Self::new(jacobian * touch, places_m.to_vec())
    }

    /// Channels x places.
    pub fn matrix(&self) -> MatRef<'_, f64> {
        self.matrix.as_ref()
    }

    /// Positions of the columns, metres.
    pub fn places_m(&self) -> &[Point] {
        &self.places_m
    }
}

pub(super) fn square_distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)
}
