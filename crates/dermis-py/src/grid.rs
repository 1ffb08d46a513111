//! [`PyGrid`]: the pixels of images over a mesh.

use std::sync::Arc;

use dermis_tomo::mesh::PixelMap;
use pyo3::prelude::*;

use crate::arrays::{Array2, Array3, Doubles, array2, array3};
use crate::errors::Fault;
use crate::hints::ArrayLike;

/// A grid of pixels over a mesh, for images.
#[pyclass(frozen, module = "dermis", name = "Grid")]
pub struct PyGrid {
    /// Map from elements to pixels.
    pub map: Arc<PixelMap>,
}

#[pymethods]
impl PyGrid {
    /// Number of rows.
    #[getter]
    fn rows(&self) -> usize {
        self.map.grid().rows
    }

    /// Number of columns.
    #[getter]
    fn columns(&self) -> usize {
        self.map.grid().columns
    }

    /// Numbers of rows and columns.
    #[getter]
    fn shape(&self) -> (usize, usize) {
        (self.rows(), self.columns())
    }

    /// Side of a pixel, metres.
    #[getter]
    fn pixel_m(&self) -> f64 {
        self.map.grid().pixel_m
    }

    /// Left, right, bottom and top, millimetres, in the order of matplotlib's ``imshow``.
    #[getter]
    fn extent_mm(&self) -> [f64; 4] {
        let grid = self.map.grid();
        let (left, top) = (1e3 * grid.left_m, 1e3 * grid.top_m);
        let pixel = 1e3 * grid.pixel_m;
        [left, left + pixel * grid.columns as f64, top - pixel * grid.rows as f64, top]
    }

    /// True for pixels with a value, shape (rows, columns).
    #[getter]
    fn inside<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, bool>> {
        array2(py, self.map.inside_mask(), self.rows(), self.columns())
    }

    /// Centres of the pixels, shape (rows, columns, 2), metres.
    #[getter]
    fn centres_m<'py>(&self, py: Python<'py>) -> PyResult<Array3<'py, f64>> {
        let centres = self.map.grid().centres_m();
        let shape = [self.rows(), self.columns(), 2];
        array3(py, centres.as_flattened().to_vec(), shape)
    }

    /// Converts values of elements to an image, weighted by area of overlap; NaN outside.
    ///
    /// Parameters
    /// ----------
    /// values : array_like
    ///     Shape (m,): one value per element.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (rows, columns).
    fn to_pixels<'py>(&self, py: Python<'py>, values: ArrayLike<'py>) -> PyResult<Array2<'py, f64>> {
        let elements = self.map.element_count();
        let values = Doubles::vector("values", &values, elements, "one value per element")?;
        let image = self.map.to_pixels(values.values()?).map_err(Fault::from)?;
        array2(py, image, self.rows(), self.columns())
    }

    fn __repr__(&self) -> String {
        format!("<dermis.Grid: {} x {} pixels of {} mm>", self.rows(), self.columns(), 1e3 * self.pixel_m())
    }
}
