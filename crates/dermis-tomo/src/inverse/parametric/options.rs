//! The range that a table of spots covers.

/// Radii and sizes of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotOptions {
    /// Smallest radius, metres: about a pixel. Below that, the pixels become visible.
    pub smallest_radius_m: f64,
    /// Largest radius, metres.
    pub largest_radius_m: f64,
    /// Expected radius (the mean of the prior), metres.
    pub typical_radius_m: f64,
    /// Largest number of spots fitted together.
    pub most_spots: usize,
}
