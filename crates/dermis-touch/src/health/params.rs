//! The limits of what is healthy.

/// Frames over which evidence is summed: a fault is recognised within as many.
pub const HEALTH_WINDOW: usize = 10;

/// Limits of a [`HealthMonitor`](super::HealthMonitor).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HealthParams {
    /// A squared deviation (in units of its variance) counts up to this.
    pub most_per_frame: f32,
    /// A channel is bad when the squared deviations of the last ten frames come to this. Of Gaussian noise their sum is
    /// chi-squared with 10 degrees of freedom, which exceeds 120 once in 10^20 times; noise 3.5 times as large as usual
    /// reaches it on average.
    pub bad_sum: f32,
    /// Reciprocal channels may differ by this share of their change: gains differ.
    pub share_of_change: f64,
    /// And by so many times what both have changed by since the frame before: they are read at different moments.
    pub share_of_motion: f64,
    /// And by this share of their resting value, for slow drift of gains.
    pub share_of_rest: f64,
    /// Channels without partner may differ from what the others let expect by this share of their resting value.
    pub unpartnered_share_of_rest: f64,
    /// And by so many times the median change of all channels.
    pub unpartnered_changes: f64,
    /// A reading below this share of its resting value is gone.
    pub dead_share: f64,
    /// Share of the channels of a drive, of a measuring pair or of an electrode that must be gone at once.
    pub dead_agreement: f64,
    /// Chance at which a run of equal readings is taken for a frozen channel.
    pub stuck_chance: f64,
    /// An electrode is blamed when this share of its channels is bad.
    pub blame_share: f64,
    /// And acquitted when no more than this share is.
    pub acquit_share: f64,
    /// A bad channel is taken back after so many frames in a row without fault.
    pub clean_frames: u32,
    /// The converter's end, in the unit of the readings, where known.
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
