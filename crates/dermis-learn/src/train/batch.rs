//! Samples of one step.

/// Samples of one step: images are batch x inputs x rows x columns, labels batch x rows x columns.
pub(super) struct Batch<'a> {
    pub(super) count: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
    pub(super) inputs: &'a [f32],
    pub(super) labels: &'a [u8],
}
