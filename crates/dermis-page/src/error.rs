//! Errors of an update that contradicts itself.

/// Reason for not showing an update.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum UpdateError {
    /// An image whose values do not fill its grid.
    #[error("image of frame {frame} has {values} values; expected {rows} x {cols}, each side at most 65535")]
    ImageShape {
        /// Frame number of the update.
        frame: u64,
        /// Rows stated.
        rows: usize,
        /// Columns stated.
        cols: usize,
        /// Values found.
        values: usize,
    },
    /// Channel values that do not match their indices.
    #[error(
        "channels of frame {frame}: {indices} indices for {values} values; expected as many, or none for all channels in order"
    )]
    ChannelShape {
        /// Frame number of the update.
        frame: u64,
        /// Indices found.
        indices: usize,
        /// Values found.
        values: usize,
    },
}
