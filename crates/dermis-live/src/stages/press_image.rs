//! The image of one press alone.

use dermis_tomo::mesh::PixelGrid;

use crate::imager::Imager;
use crate::prepare::Prepared;

/// The pixels near which the image of a press has its peak.
#[derive(Debug)]
pub(super) struct PressImage {
    grid: PixelGrid,
    /// Index of each pixel among the image's unknowns; `None` outside.
    unknowns: Vec<Option<u32>>,
    /// Largest distance of the peak from the press, pixels.
    reach: isize,
}

impl PressImage {
    /// For presses of this radius, metres.
    pub fn new(prepared: &Prepared, radius_m: f64) -> Self {
        let grid = *prepared.map.grid();
        let mut unknowns = vec![None; grid.len()];
        for (unknown, &pixel) in (0..).zip(prepared.map.inside_pixels()) {
            unknowns[pixel as usize] = Some(unknown);
        }
        Self { grid, unknowns, reach: (radius_m / grid.pixel_m).ceil().max(1.0) as isize }
    }

    /// The largest value of either sign near a position (metres) in the image of these channels (model volts, none
    /// left out); 0 off the skin.
    pub fn peak_near(&self, position_m: [f64; 2], imager: &Imager, volts: &[f64]) -> f64 {
        let mut most: f64 = 0.0;
        let Some(middle) = self.grid.pixel_at(position_m) else { return most };
        let (row, column) = ((middle / self.grid.columns) as isize, (middle % self.grid.columns) as isize);
        for r in row - self.reach..=row + self.reach {
            for c in column - self.reach..=column + self.reach {
                let on_grid = r >= 0 && c >= 0 && (r as usize) < self.grid.rows && (c as usize) < self.grid.columns;
                let Some(unknown) =
                    on_grid.then(|| self.unknowns[r as usize * self.grid.columns + c as usize]).flatten()
                else {
                    continue;
                };
                let value = imager.value_at(unknown as usize, volts);
                if value.abs() > most.abs() {
                    most = value;
                }
            }
        }
        most
    }
}
