//! Pokes at known positions, and their table in a file.

use std::collections::HashMap;
use std::path::Path;

use dermis_tomo::mesh::Point;

pub use dermis_touch::LoadQuantity;

use crate::Error;

/// Pokes at known positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pokes {
    /// Position of each poke, metres; of its first touch if it has several.
    pub positions_m: Vec<Point>,
    /// Positions of the other touches of each poke, metres. May be empty if every poke is a single touch.
    pub further_m: Vec<Vec<Point>>,
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
    let mut groups = Vec::new();
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
            groups.push(number);
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
    Ok(if group.is_some() { pokes.grouped(&groups) } else { pokes })
}

impl Pokes {
    /// Joins touches of one frame into one poke: those with the same number in `groups`, which has one for each of the
    /// positions. Pokes are in the order in which their groups first appear, with the load of their first touch.
    #[must_use]
    pub fn grouped(self, groups: &[f64]) -> Self {
        let mut joined =
            Self { loads: self.loads.as_ref().map(|(quantity, _)| (*quantity, Vec::new())), ..Self::default() };
        let mut poke_of_group = HashMap::new();
        for (touch, (position_m, group)) in self.positions_m.iter().zip(groups).enumerate() {
            let next = joined.positions_m.len();
            let poke = *poke_of_group.entry(group.to_bits()).or_insert(next);
            if poke < next {
                joined.further_m[poke].push(*position_m);
                continue;
            }
            joined.positions_m.push(*position_m);
            joined.further_m.push(Vec::new());
            if let (Some((_, kept)), Some((_, loads))) = (&mut joined.loads, &self.loads) {
                kept.push(loads[touch]);
            }
        }
        joined
    }
}

/// Load of each poke relative to a typical one, by its index; 1 if loads are unknown.
pub(crate) fn load_shares(loads: Option<&[f64]>) -> impl Fn(usize) -> f64 + '_ {
    let loads = loads.map(|loads| (loads, loads.iter().sum::<f64>() / loads.len() as f64));
    move |index| loads.map_or(1.0, |(loads, mean)| loads[index] / mean)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn touches_of_a_group_are_one_poke_in_the_order_of_first_appearance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.csv");
        std::fs::write(&path, "group,x_mm,y_mm,force_n\n7,1,2,1\n3,3,4,2\n7,5,6,9\n1,7,8,3\n").unwrap();
        let pokes = read_pokes(&path).unwrap();
        assert_eq!(pokes.positions_m, [[0.001, 0.002], [0.003, 0.004], [0.007, 0.008]]);
        assert_eq!(pokes.further_m, [vec![[0.005, 0.006]], vec![], vec![]]);
        assert_eq!(pokes.loads, Some((LoadQuantity::ForceN, vec![1.0, 2.0, 3.0])));
        std::fs::write(&path, "group,x_mm,y_mm\n,1,2\n").unwrap();
        assert!(read_pokes(&path).is_err());
    }
}
