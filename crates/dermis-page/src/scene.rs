//! The constant properties of a running skin: its shape, electrodes, image grid, channels and units. Sent once to
//! each page.

use dermis_tomo::mesh::Point;
use serde::Serialize;

/// The skin as drawn by the page. Lengths are millimetres in the skin's frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct Scene {
    /// True if the skin is watched for damage.
    pub watches_damage: bool,
    /// Name of the skin.
    pub skin: String,
    /// `eit` or `mit`.
    pub modality: String,
    /// True if the skin is a twin, which can be pressed from the page.
    pub is_twin: bool,
    /// True if the twin can be cut and healed.
    pub is_treatable: bool,
    /// Closed rings, without repeating the first point: the outer boundary first, then holes.
    pub outline_mm: Vec<Vec<Point>>,
    /// Diameter of the cylinder that the sheet is bent around, with its axis along y; `None` if flat. Other lengths are
    /// those of the flattened sheet.
    pub bend_diameter_mm: Option<f64>,
    /// Electrodes (or coils) in the order of their numbers.
    pub electrodes: Vec<ElectrodeView>,
    /// The image's grid.
    pub grid: GridView,
    /// Drive and measuring pair of each channel, such as `1-8 / 2-9`.
    pub channel_labels: Vec<String>,
    /// Unit of channel values and of their noise, such as `V`.
    pub channel_unit: String,
    /// Quantity shown by the image, such as `conductivity change`.
    pub image_quantity: String,
    /// Unit of the image, such as `S/m`; empty for a ratio.
    pub image_unit: String,
    /// Unit of touch amplitudes: the image's, or with a calibration its typical pokes.
    pub amplitude_unit: String,
    /// Initial colour range; `None`: from the first frames.
    pub range_hint: Option<[f32; 2]>,
    /// Range of the hyperparameter's slider.
    pub hyperparameter_range: [f64; 2],
    /// Limits of a press from the page.
    pub press: PressLimits,
}

/// One electrode or coil.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct ElectrodeView {
    /// Number shown, from 1.
    pub number: u32,
    /// Position of the number: the electrode's centre.
    pub position_mm: Point,
    /// Its outline; empty for a point, two points for a rim segment, more for a polygon.
    pub outline_mm: Vec<Point>,
}

/// Position of the image: the outer edges of its corner pixels.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct GridView {
    /// Rows, the first at the top (largest y).
    pub rows: usize,
    /// Columns.
    pub cols: usize,
    /// Left edge.
    pub x_min_mm: f64,
    /// Right edge.
    pub x_max_mm: f64,
    /// Lower edge.
    pub y_min_mm: f64,
    /// Upper edge.
    pub y_max_mm: f64,
}

/// Ranges of the sliders for pressing a twin; requests outside them are refused.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct PressLimits {
    /// Smallest and largest radius of the indenter.
    pub radius_mm: [f64; 2],
    /// Smallest and largest pressure.
    pub pressure_kpa: [f64; 2],
    /// Initial radius.
    pub initial_radius_mm: f64,
    /// Initial pressure.
    pub initial_pressure_kpa: f64,
}

impl Default for PressLimits {
    fn default() -> Self {
        // The indenter (20 mm across) and pressure used in tests of self-healing skins, in the middle of the sliders.
        Self { radius_mm: [2.0, 30.0], pressure_kpa: [0.0, 200.0], initial_radius_mm: 10.0, initial_pressure_kpa: 80.0 }
    }
}
