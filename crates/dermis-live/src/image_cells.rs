//! Converts the cells of images for touch extraction. Only this file assumes that they are a grid.

use dermis_tomo::mesh::PixelGrid;
use dermis_touch::{GridGeometry, ImageCells};

/// The cells of images on a grid.
pub(crate) fn image_cells(grid: &PixelGrid) -> ImageCells {
    ImageCells::from(GridGeometry {
        columns: grid.columns,
        rows: grid.rows,
        pixel_m: grid.pixel_m,
        left_m: grid.left_m,
        top_m: grid.top_m,
    })
}
