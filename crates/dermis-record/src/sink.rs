//! Destinations for the results of the pipeline. A [`Sink`] takes one [`SkinFrame`](dermis_live::skin_frame::SkinFrame)
//! per frame and knows nothing of the stages before it; files appear under their names only when complete.

mod image_stack;
mod interface;
pub(crate) mod json_lines;
pub(crate) mod staged;
mod touch_table;

pub use image_stack::ImageStack;
pub use interface::{Sink, Summary};
pub use json_lines::{JsonLines, LineExtras, LinesFor, NoFields};
pub(crate) use staged::sync_directory;
pub use touch_table::{TouchColumns, TouchTable};

#[cfg(test)]
pub(crate) mod testing {
    use dermis_live::skin_frame::SkinFrame;
    use dermis_touch::{ContactSign, Observation, Touch, TouchPhase};

    /// A touch at (x, y) in millimetres with standard deviations of 0.5 and 0.25 mm and an area of 100 mm^2.
    pub(crate) fn touch(id: u64, phase: TouchPhase, x_mm: f64, y_mm: f64) -> Touch {
        Touch {
            id,
            phase,
            observation: Observation::Measured,
            sign: ContactSign::Positive,
            position_m: [x_mm / 1e3, y_mm / 1e3],
            covariance_m2: [[0.25e-6, 0.0], [0.0, 0.0625e-6]],
            filtered_position_m: [0.0; 2],
            velocity_m_per_s: [0.0; 2],
            amplitude: 0.75,
            area_m2: 1e-4,
            force: None,
            radius_m: None,
            load: None,
            other_place: None,
            age_frames: 1,
            begin_time_ns: 0,
            time_ns: 0,
        }
    }

    /// A frame with two channels and an image of 2 rows and 3 columns.
    pub(crate) fn output<'a>(
        sequence: u64,
        image: &'a [f32],
        touches: &'a [Touch],
        ended: &'a [Touch],
    ) -> SkinFrame<'a> {
        let (time_ns, wall_ns) = (12_000_000_345 + sequence, 1_700_000_000_000_000_000 + sequence);
        SkinFrame {
            sequence,
            time_ns,
            wall_ns,
            device_time_ns: Some(5),
            is_ready: true,
            raw: vec![1.0, 2.0].into(),
            compensated: vec![0.0, 0.5].into(),
            image: image.into(),
            columns: 3,
            rows: 2,
            touches: touches.into(),
            ended: ended.into(),
            ..SkinFrame::default()
        }
    }
}
