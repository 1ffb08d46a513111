//! The shape of a patch and the meaning of its values: the content of `dermis_msgs/Patch`.

use dermis_body::Taxels;
use dermis_live::pipeline::Pipeline;
use dermis_touch::guard::GuardLimits;

/// The shape of a patch; it doesn't change while the patch runs.
#[derive(Clone, Debug)]
pub(crate) struct PatchShape {
    pub skin: String,
    pub link: Option<String>,
    pub source: String,
    pub frames_per_s: Option<f64>,
    /// Voltages in a frame.
    pub channels: usize,
    /// Size of the image.
    pub rows: usize,
    pub columns: usize,
    /// The image's cells on the skin's surface.
    pub cells: Taxels,
    /// Meaning and unit of their values.
    pub quantity: String,
    pub unit: String,
}

impl PatchShape {
    /// The shape of a pipeline's skin.
    pub fn new(pipeline: &Pipeline, link: Option<String>, source: &str) -> Self {
        let prepared = pipeline.prepared();
        let (skin, grid) = (&prepared.skin, prepared.map.grid());
        // A calibration by pokes without a correction makes its own images, in shares of its pokes.
        let by_pokes = pipeline.calibration().is_some_and(|calibration| calibration.correction().is_none());
        let (quantity, unit) = match by_pokes {
            true => ("touch strength", "typical pokes per pixel"),
            false => (skin.modality.image_quantity(), ""),
        };
        Self {
            skin: skin.name.clone(),
            link,
            source: source.to_owned(),
            frames_per_s: skin.backend.frames_per_s,
            channels: prepared.channels(),
            rows: grid.rows,
            columns: grid.columns,
            cells: Taxels::of(&prepared.map, &skin.surface()),
            quantity: quantity.to_owned(),
            unit: unit.to_owned(),
        }
    }
}

/// Thresholds and limits of a patch.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct PatchLimits {
    /// Source of the forces.
    pub force_from: Option<&'static str>,
    /// Minimum peak of a touch, relative to the noise of the image.
    pub touch_over_noise: f64,
    pub guard: Option<GuardLimits>,
}

impl PatchLimits {
    pub fn new(pipeline: &Pipeline) -> Self {
        let source = pipeline.force_source();
        Self {
            force_from: source.map(|source| source.name()),
            touch_over_noise: pipeline.prepared().skin.touch.begin_sigma,
            guard: pipeline.guard_limits(),
        }
    }
}
