//! Tables with one reading per row, as databases and `melt` write them: `frame, channel, value`.

use super::roles::part_of;
use super::scan::Table;

/// The column that counts the channels in a table with one reading per row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct ChannelColumn {
    pub(super) column: usize,
    /// Channels of a frame, which is also its number of rows.
    pub(super) channels: usize,
}

/// Finds the column that counts from 0 or 1 to the number of channels, again and again. Readings never do that. With a
/// single frame the column must be called `channel`, since a column that counts once may number the rows.
pub(super) fn channel_column(table: &Table, readings: &[usize]) -> Option<ChannelColumn> {
    // The other columns are one reading, or both parts of a complex one.
    let parts = readings.iter().filter(|&&column| table.name(column).and_then(part_of).is_some()).count();
    if readings.len() != 2 && !(readings.len() == 3 && parts == 2) {
        return None;
    }
    readings.iter().find_map(|&column| {
        let values = || table.values.chunks_exact(table.sketch.columns).map(|row| row[column]);
        let start = values().next().filter(|start| *start == 0.0 || *start == 1.0)?;
        let channels = values().skip(1).position(|value| value == start).map_or(table.rows(), |index| index + 1);
        let is_named = table.name(column).is_some_and(|name| {
            let name = name.to_lowercase();
            ["channel", "chan", "ch", "measurement", "meas"].contains(&name.as_str())
        });
        let counts = values().enumerate().all(|(row, value)| value == start + (row % channels) as f64);
        let is_whole = table.rows().is_multiple_of(channels) && (is_named || table.rows() > channels);
        (channels > 2 && counts && is_whole).then_some(ChannelColumn { column, channels })
    })
}
