//! Figures of merit of images.

use dermis_tomo::quality::{GreitFigures, Target};
use pyo3::prelude::*;

use crate::arrays::{Doubles, shape_text};
use crate::errors::Fault;
use crate::grid::PyGrid;
use crate::hints::{ArrayLike, Named};

/// The GREIT figures of an image of one target (Adler et al., Physiol. Meas. 30, 2009).
///
/// Parameters
/// ----------
/// image : array_like
///     Shape (rows, columns) of the grid, NaN outside.
/// grid : Grid
///     The grid of the image.
/// centre_m : sequence of float
///     True position of the target.
/// area_m2, change : float
///     The target's area, and its change in the image's unit.
///
/// Returns
/// -------
/// dict
///     ``amplitude_response``, ``radial_position_error_m``, ``position_error_m``, ``resolution``,
///     ``shape_deformation``, ``ringing``.
#[pyfunction]
pub fn greit_figures<'py>(
    py: Python<'py>,
    image: ArrayLike<'py>,
    grid: &Bound<'py, PyGrid>,
    centre_m: [f64; 2],
    area_m2: f64,
    change: f64,
) -> PyResult<Named<'py, f64>> {
    let image = Doubles::of("image", &image)?;
    let grid = grid.get().map.grid();
    if image.shape() != [grid.rows, grid.columns] {
        let expected = format!("shape ({}, {})", grid.rows, grid.columns);
        return Err(Fault::input("image", expected, shape_text(image.shape())).into());
    }
    let target = Target { centre_m, area_m2, change };
    let figures = GreitFigures::of(image.values()?, grid, &target).map_err(Fault::from)?;
    Named::of(
        py,
        [
            ("amplitude_response", figures.amplitude_response),
            ("radial_position_error_m", figures.radial_position_error_m),
            ("position_error_m", figures.position_error_m),
            ("resolution", figures.resolution),
            ("shape_deformation", figures.shape_deformation),
            ("ringing", figures.ringing),
        ],
    )
}
