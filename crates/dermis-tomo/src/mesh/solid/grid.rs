//! Grid lines, and the boxes between them, each with six tetrahedra.

use super::super::core::MeshError;

/// Maximum number of tetrahedra; larger meshes are refused before any work starts.
const MOST_TETRAHEDRA: usize = 12_000_000;

pub(super) fn refuse_too_many(tetrahedra: f64, field: &'static str, value: String) -> Result<(), MeshError> {
    if tetrahedra <= MOST_TETRAHEDRA as f64 {
        return Ok(());
    }
    let expected = format!("few enough for {MOST_TETRAHEDRA} tetrahedra ({tetrahedra:.0} would result)");
    Err(MeshError::Shape { field, value, expected })
}

/// Grid lines from `low` to `high`: all breaks, with steps of about one `cells`-th of the range between them.
pub(super) fn grid_lines(low: f64, high: f64, cells: usize, breaks: &[f64]) -> Vec<f64> {
    let slack = 1e-9 * (high - low);
    let mut fixed = vec![low, high];
    fixed.extend(breaks.iter().copied().filter(|&at| at > low + slack && at < high - slack));
    fixed.sort_by(f64::total_cmp);
    fixed.dedup_by(|later, earlier| *later - *earlier <= slack);
    let mut lines = vec![low];
    for pair in fixed.windows(2) {
        let steps = (cells as f64 * (pair[1] - pair[0]) / (high - low)).round().max(1.0) as usize;
        lines.extend((1..steps).map(|k| pair[0] + (pair[1] - pair[0]) * k as f64 / steps as f64));
        lines.push(pair[1]);
    }
    lines
}

pub(super) fn box_nodes(lines: &[Vec<f64>; 3]) -> Vec<[f64; 3]> {
    let [xs, ys, zs] = lines;
    let mut nodes = Vec::with_capacity(xs.len() * ys.len() * zs.len());
    for &z in zs {
        for &y in ys {
            nodes.extend(xs.iter().map(|&x| [x, y, z]));
        }
    }
    nodes
}

/// Six tetrahedra per box, one for each order in which a path can step along x, y and z from its lowest corner to its
/// highest.
pub(super) fn box_elements(lines: &[Vec<f64>; 3]) -> Vec<u32> {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let counts = [0, 1, 2].map(|axis| lines[axis].len() as u32);
    let stride = [1, counts[0], counts[0] * counts[1]];
    let mut elements = Vec::new();
    for k in 0..counts[2] - 1 {
        for j in 0..counts[1] - 1 {
            for i in 0..counts[0] - 1 {
                let corner = i * stride[0] + j * stride[1] + k * stride[2];
                for order in ORDERS {
                    let first = corner + stride[order[0]];
                    let second = first + stride[order[1]];
                    elements.extend([corner, first, second, second + stride[order[2]]]);
                }
            }
        }
    }
    elements
}
