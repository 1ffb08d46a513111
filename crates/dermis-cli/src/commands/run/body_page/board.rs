//! The newest results of one patch, left by its thread and read by the page's server. The lock is held only for
//! copying.

use std::sync::{Mutex, MutexGuard, PoisonError};

use dermis::body::{PatchHealth, PatchState};
use dermis_page::{BodyTouchView, GuardView, PatchStateView, protocol};
use dermis_touch::guard::GuardReport;

use crate::page::PatchImage;

/// The board of one patch.
#[derive(Debug, Default)]
pub(super) struct PatchBoard(Mutex<Posted>);

/// Results of one patch.
#[derive(Debug, Default)]
pub(super) struct Posted {
    /// Counts images from 1.
    pub version: u64,
    /// Number of the frame.
    pub frame: u64,
    /// Host monotonic time of the frame's first byte, nanoseconds.
    pub time_ns: u64,
    /// The image.
    pub image: Vec<f32>,
    /// Touches on it.
    pub touches: Vec<BodyTouchView>,
    /// The guard's report on the frame, if the patch has a guard.
    pub guard: Option<GuardReport>,
    /// Frames per second.
    pub fps: f32,
    /// True while its twin shows touches by itself.
    pub demonstrates: bool,
    /// Force and torque on the body.
    pub body_wrench: Option<[[f64; 3]; 2]>,
    encoded: Option<PatchImage>,
}

impl PatchBoard {
    /// Posts results.
    pub fn post(&self, change: impl FnOnce(&mut Posted)) {
        change(&mut self.posted());
    }

    /// The newest image as a message, if there is one.
    pub fn image(&self, patch: usize) -> Option<PatchImage> {
        let mut posted = self.posted();
        let Posted { version, frame, time_ns, ref image, ref encoded, .. } = *posted;
        if version == 0 {
            return None;
        }
        if let Some(encoded) = encoded.as_ref().filter(|encoded| encoded.version == version) {
            return Some(encoded.clone());
        }
        let message = protocol::patch_image(patch, frame, time_ns, image);
        let image = PatchImage { patch, version, message };
        posted.encoded = Some(image.clone());
        Some(image)
    }

    /// The patch's state at a time on the host's monotonic clock, and the frame's time and wrench on the body.
    pub fn state(&self, health: PatchHealth, now_ns: u64) -> (PatchStateView, u64, Option<[[f64; 3]; 2]>) {
        let posted = self.posted();
        let is_over = matches!(health.state, PatchState::Ended | PatchState::Failed(_));
        let is_running = health.state == PatchState::Running;
        let guard = posted.guard.map(|report| if is_over { report.ended() } else { report.at(now_ns) });
        let name = health.state.name();
        let problem = match health.state {
            PatchState::Failed(reason) => Some(reason),
            _ => health.problem,
        };
        let view = PatchStateView {
            state: name,
            problem,
            frame: posted.frame,
            fps: if is_running { posted.fps } else { 0.0 },
            frames: health.frames,
            lost: health.lost + health.damaged + health.dropped,
            channels_left_out: health.channels_left_out,
            latency_p99_ms: health.latency_p99_ms,
            demonstrates: posted.demonstrates && !is_over,
            guard: guard.map(guard_view),
            // Touches of a patch that sends nothing are unknown.
            touches: if is_running { posted.touches.clone() } else { Vec::new() },
        };
        (view, posted.time_ns, posted.body_wrench)
    }

    fn posted(&self) -> MutexGuard<'_, Posted> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn guard_view(report: GuardReport) -> GuardView {
    let mut view = GuardView::default();
    view.show(&report);
    view
}
