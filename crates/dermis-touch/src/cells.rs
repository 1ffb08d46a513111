//! The cells of an image. Each cell has a position, neighbours and an area. A flat grid of pixels is one kind of
//! cells; the elements of a surface mesh are another. Only this module knows about rows and columns.

mod grid;
mod lattice;
mod surface;

pub use grid::GridGeometry;
pub(crate) use lattice::{Bounds, GridLattice, Lattice, SurfaceLattice};
pub use surface::SurfaceCells;

use crate::error::TouchError;
use std::sync::Arc;

/// The cells of an image, one value each.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ImageCells {
    /// Square pixels in a row-major image with row 0 at the top. Neighbours are computed, not stored.
    Grid(GridGeometry),
    /// Cells of any shape, described by lists that clones share.
    Surface(Arc<SurfaceCells>),
}

impl ImageCells {
    /// Number of cells, inside and outside the skin.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::Grid(grid) => grid.len(),
            Self::Surface(cells) => cells.len(),
        }
    }

    /// True if there are no cells.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The grid, or `None` for a surface.
    #[must_use]
    pub fn as_grid(&self) -> Option<&GridGeometry> {
        match self {
            Self::Grid(grid) => Some(grid),
            Self::Surface(_) => None,
        }
    }

    /// Position of a cell, metres: the centre of a pixel, or the centroid of a mesh element.
    #[must_use]
    pub fn place_m(&self, cell: usize) -> [f64; 2] {
        match self {
            Self::Grid(grid) => grid.pixel_centre_m(cell),
            Self::Surface(cells) => cells.places_m()[cell],
        }
    }

    /// Area of a cell, m^2.
    #[must_use]
    pub fn area_m2(&self, cell: usize) -> f64 {
        match self {
            Self::Grid(grid) => grid.pixel_m * grid.pixel_m,
            Self::Surface(cells) => cells.areas_m2()[cell],
        }
    }

    /// Side of a square with the mean cell's area, metres. On a grid this is the pixel size.
    #[must_use]
    pub fn cell_size_m(&self) -> f64 {
        match self {
            Self::Grid(grid) => grid.pixel_m,
            Self::Surface(cells) => cells.cell_size_m(),
        }
    }

    /// Area of a cell over the square of [`ImageCells::cell_size_m`]: 1 for every pixel of a grid.
    #[must_use]
    pub fn relative_area(&self, cell: usize) -> f64 {
        match self {
            Self::Grid(_) => 1.0,
            Self::Surface(cells) => cells.relative_area(cell),
        }
    }

    /// The cell that contains a point. On a surface, the cell with the nearest position, if the point is within twice
    /// the side of a square of the cell's area.
    #[must_use]
    pub fn cell_at(&self, position_m: [f64; 2]) -> Option<usize> {
        match self {
            Self::Grid(grid) => grid.pixel_at(position_m),
            Self::Surface(cells) => cells.cell_at(position_m),
        }
    }

    /// Calls `visit` with each neighbour of a cell. On a grid these share an edge or a corner, row by row.
    pub fn for_each_neighbour(&self, cell: usize, visit: impl FnMut(usize)) {
        match self {
            Self::Grid(grid) => grid.neighbours(cell).for_each(visit),
            Self::Surface(cells) => cells.neighbours(cell).iter().map(|&other| other as usize).for_each(visit),
        }
    }

    /// Calls `visit` with each neighbour that shares an edge with the cell. On a grid: left, right, above, below.
    pub fn for_each_edge_neighbour(&self, cell: usize, visit: impl FnMut(usize)) {
        match self {
            Self::Grid(grid) => grid.edge_neighbours(cell).for_each(visit),
            Self::Surface(cells) => cells.edge_neighbours(cell).iter().map(|&other| other as usize).for_each(visit),
        }
    }

    /// Checks the dimensions of a grid. Surface cells were checked when they were built.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] naming the field.
    pub fn validate(&self) -> Result<(), TouchError> {
        match self {
            Self::Grid(grid) => grid.validate(),
            Self::Surface(_) => Ok(()),
        }
    }
}

impl From<GridGeometry> for ImageCells {
    fn from(grid: GridGeometry) -> Self {
        Self::Grid(grid)
    }
}

impl From<SurfaceCells> for ImageCells {
    fn from(cells: SurfaceCells) -> Self {
        Self::Surface(Arc::new(cells))
    }
}
