//! Processing times of the stages.

use crate::latency::LatencyHistogram;

/// Time spent in each stage, in order.
#[derive(Debug, Default)]
pub struct StageLatencies {
    /// From the first byte of the frame to the start of processing.
    pub queue: LatencyHistogram,
    /// Channels, baseline, difference.
    pub condition: LatencyHistogram,
    /// Difference to image.
    pub image: LatencyHistogram,
    /// Image to touches.
    pub touches: LatencyHistogram,
    /// First byte to touches.
    pub total: LatencyHistogram,
}

impl StageLatencies {
    /// Names and histograms, in order.
    pub fn stages(&self) -> [(&'static str, &LatencyHistogram); 5] {
        [
            ("queue", &self.queue),
            ("condition", &self.condition),
            ("image", &self.image),
            ("touches", &self.touches),
            ("total", &self.total),
        ]
    }
}
