//! Pokes at known positions, and their table in a file.

use std::path::Path;

pub use dermis_touch::LoadQuantity;

use crate::Error;

/// Pokes at known positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pokes {
    /// Position of each poke, metres; of its first touch if it has several.
    pub positions_m: Vec<[f64; 2]>,
    /// Positions of the other touches of each poke, metres. May be empty if every poke is a single touch.
    pub further_m: Vec<Vec<[f64; 2]>>,
    /// Loads, if measured.
    pub loads: Option<(LoadQuantity, Vec<f64>)>,
}

/// Reads a table of pokes with columns x_m, y_m and optionally depth_m or force_n. The header may also say x_mm, y_mm
/// and depth_mm. Without a header, the units are metres and metres of depth. Rows with the same number in the column
/// `group` are touches of the same frame; frames are in the order in which their groups first appear.
///
/// # Errors
/// A file that is not a table of numbers, other columns, or missing values.
pub fn read_pokes(path: &Path) -> Result<Pokes, Error> {
    let table = dermis_device::instruments::csv::read_numbers(path)?.in_metres();
    let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
    let column = |name: &str, otherwise: usize| match &table.header {
        Some(_) => table.column_index(name),
        None => (otherwise < table.columns).then_some(otherwise),
    };
    let (Some(x), Some(y)) = (column("x_m", 0), column("y_m", 1)) else {
        return Err(content("columns".into(), "expected x_m, y_m and optionally group, depth_m or force_n".into()));
    };
    let load = column("force_n", usize::MAX)
        .map(|index| (LoadQuantity::ForceN, index))
        .or_else(|| column("depth_m", 2).map(|index| (LoadQuantity::DepthM, index)));
    let group = table.header.as_ref().and_then(|_| table.column_index("group"));
    let mut pokes = Pokes::default();
    let mut loads = Vec::new();
    let mut poke_of_group = std::collections::HashMap::new();
    for row in 0..table.rows() {
        let values = table.row(row).unwrap_or_default();
        let value = |index: usize| values.get(index).copied().unwrap_or(f64::NAN);
        let position = [value(x), value(y)];
        if position.iter().any(|v| !v.is_finite()) {
            return Err(content(format!("row {row}"), format!("position {position:?} is not finite")));
        }
        if let Some(index) = group {
            let number = value(index);
            if !number.is_finite() {
                return Err(content(format!("row {row}"), format!("group {number} is not a number")));
            }
            let next = pokes.positions_m.len();
            let poke = *poke_of_group.entry(number.to_bits()).or_insert(next);
            if poke < next {
                pokes.further_m[poke].push(position);
                continue;
            }
            pokes.further_m.push(Vec::new());
        }
        pokes.positions_m.push(position);
        loads.extend(load.map(|(_, index)| value(index)));
    }
    if let Some((quantity, _)) = load {
        if let Some(row) = loads.iter().position(|l| !(l.is_finite() && *l > 0.0)) {
            return Err(content(format!("row {row}"), format!("load {} is not a positive number", loads[row])));
        }
        pokes.loads = Some((quantity, loads));
    }
    Ok(pokes)
}
