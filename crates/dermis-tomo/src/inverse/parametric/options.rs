//! What a table of spots spans.

/// Radii and sizes of the table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpotOptions {
    /// Smallest radius, metres: about a pixel, below which pixels show.
    pub smallest_radius_m: f64,
    /// Largest radius, metres.
    pub largest_radius_m: f64,
    /// Radius expected before anything is measured, metres.
    pub typical_radius_m: f64,
    /// At most so many spots are fitted together.
    pub most_spots: usize,
}
