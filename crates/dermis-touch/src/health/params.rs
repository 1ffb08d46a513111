//! Limits of healthy behaviour.

/// Number of frames over which evidence is summed; a fault is recognised within that many.
pub const HEALTH_WINDOW: usize = 10;

/// Limits of a [`HealthMonitor`](super::HealthMonitor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HealthParams {
    /// Upper bound on one frame's squared deviation, in units of its variance.
    pub most_per_frame: f32,
    /// A channel is bad if the squared deviations of the last ten frames sum to this. For Gaussian noise the sum is
    /// chi-squared with 10 degrees of freedom and exceeds 120 with probability 10^-20. Noise 3.5 times as large as
    /// usual reaches it on average.
    pub bad_sum: f32,
    /// Tolerated difference of reciprocal channels as a share of their change, since gains differ.
    pub share_of_change: f64,
    /// Additional tolerance, in multiples of their common change since the previous frame: they are read at different
    /// moments.
    pub share_of_motion: f64,
    /// Additional tolerance as a share of their resting value, for slow gain drift.
    pub share_of_rest: f64,
    /// Tolerated residual of channels without a partner, as a share of their resting value.
    pub unpartnered_share_of_rest: f64,
    /// Additional tolerance, in multiples of the median change of all channels.
    pub unpartnered_changes: f64,
    /// A reading below this share of its resting value has vanished.
    pub dead_share: f64,
    /// Share of the channels of a drive, measuring pair or electrode that must vanish together.
    pub dead_agreement: f64,
    /// Probability below which a run of equal readings counts as a frozen channel.
    pub stuck_chance: f64,
    /// An electrode is blamed if this share of its channels is bad.
    pub blame_share: f64,
    /// A blamed electrode is acquitted once less than this share is bad.
    pub acquit_share: f64,
    /// Consecutive fault-free frames after which a bad channel is acquitted.
    pub clean_frames: u32,
    /// The converter's limit, in the unit of the readings, if known.
    pub full_scale: Option<f64>,
}

impl Default for HealthParams {
    fn default() -> Self {
        Self {
            most_per_frame: 36.0,
            bad_sum: 120.0,
            share_of_change: 0.1,
            share_of_motion: 2.0,
            share_of_rest: 0.005,
            unpartnered_share_of_rest: 0.25,
            unpartnered_changes: 4.0,
            dead_share: 0.05,
            dead_agreement: 0.8,
            stuck_chance: 1e-12,
            blame_share: 0.7,
            acquit_share: 0.3,
            clean_frames: 50,
            full_scale: None,
        }
    }
}
