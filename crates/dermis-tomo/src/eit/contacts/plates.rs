//! A sheet under separate conducting plates, each at its own potential: patches of metal or fabric. The equations
//! are those of one layer above ([`super`]) with a potential for each plate: with the assignment `B` of contacts to
//! plates in place of `1`, `P = M^-1 - M^-1 B (B' M^-1 B)^-1 B' M^-1`.

use std::collections::BTreeMap;
use std::ops::Range;

use super::sheet::{ContactSheet, OF_PRESS, Touched};
use crate::eit::{EitError, ForwardModel};
use crate::mesh::Point;

/// Each triangle is divided into the square of this many equal parts to find the plates above it.
const DIVISIONS: usize = 8;
/// They are joined into the square of this many larger parts, with one point for each plate above one. With 2 instead
/// of 4, the channels are so rough in the radius of a press that fits end far from the best pressure.
const PARTS: usize = 4;
/// Least number of cells along each side of a plate, on skins with up to [`FEW_PLATES`] plates and with more, where
/// memory would run out. Current that enters a plate through its only cell cannot leave it: presses on patches smaller
/// than an element would have no effect.
const LEAST_CELLS: [usize; 2] = [3, 2];
/// Number of plates up to which they are few.
const FEW_PLATES: usize = 900;
/// Contacts below this share of the largest are left out: they carry no current.
const LEAST_CONTACT: f64 = 1e-9;

/// A small part of the sheet under one plate, at which contact is evaluated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlatePoint {
    /// Centroid, metres.
    pub position_m: Point,
    /// Area, m^2.
    pub area_m2: f64,
    /// The cell that it belongs to.
    pub cell: u32,
}

/// A point before the cells are known: with its plate, and the shares of the corners around it.
struct Part {
    position_m: Point,
    area_m2: f64,
    plate: u32,
    corners: [(u32, f64); 3],
}

/// A sheet under separate plates, prepared for any contacts. Current flows between sheet and plates in cells: parts of
/// one plate, no larger than about one of the sheet's elements. A cell sees the mean potential of the sheet under it.
#[derive(Debug)]
pub struct PlatedSheet {
    /// The sheet, with its cells in place of nodes.
    sheet: ContactSheet,
    /// Plate of each cell.
    plates: Vec<u32>,
    /// Column by column, from left to right, and upwards within each.
    points: Vec<PlatePoint>,
    columns: Columns,
}

/// Columns of equal width that divide the points of a sheet.
#[derive(Debug)]
struct Columns {
    left_m: f64,
    width_m: f64,
    /// Index of the first point of each column, and the number of all points.
    firsts: Vec<usize>,
}

/// Solution for one set of contacts.
#[derive(Clone, Debug)]
pub struct PlateContact {
    /// Change of each channel, volts.
    pub change_v: Vec<f64>,
    /// The cells in contact, ascending.
    cells: Vec<u32>,
    touched: Touched,
}

impl PlateContact {
    /// Number of cells in contact. Solving takes a time that grows with its cube.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// Values of the cells in contact, from those of all cells.
    pub fn of_cells<T: Copy>(&self, of_all: &[T]) -> Vec<T> {
        self.cells.iter().map(|&cell| of_all[cell as usize]).collect()
    }

    /// True if nothing is in contact.
    pub fn is_open(&self) -> bool {
        self.cells.is_empty()
    }
}

impl PlatedSheet {
    /// Computes the Green's function of a flat sheet with this conductance (siemens, one value per element).
    /// `plate_at` is the index of the plate above a position; `None` between plates. Only triangles have plates above
    /// them.
    ///
    /// # Errors
    /// As [`ContactSheet::new`].
    pub fn new(
        model: &ForwardModel,
        sheet_s: &[f64],
        plate_at: impl Fn(Point) -> Option<u32>,
    ) -> Result<Self, EitError> {
        let (sheet, order) = ContactSheet::with_order(model, sheet_s, 0.0)?;
        let mut parts = parts_under_plates(model, &order, plate_at);
        let columns = Columns::of(&mut parts, sheet.node_spacing_m());
        let cells = cells_of(&parts, sheet.node_spacing_m());
        let count = cells.iter().max().map_or(0, |last| *last as usize + 1);
        let (mut means, mut plates) = (vec![Vec::new(); count], vec![0; count]);
        for (part, &cell) in parts.iter().zip(&cells) {
            plates[cell as usize] = part.plate;
            means[cell as usize].extend(part.corners.map(|(node, share)| (node, share * part.area_m2)));
        }
        let point = |(part, cell): (&Part, u32)| {
            let Part { position_m, area_m2, .. } = *part;
            PlatePoint { position_m, area_m2, cell }
        };
        let points = parts.iter().zip(cells).map(point).collect();
        Ok(Self { sheet: sheet.averaged(&means), plates, points, columns })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.sheet.channels()
    }

    /// Channels on the bare sheet, volts.
    pub fn bare_v(&self) -> &[f64] {
        self.sheet.bare_v()
    }

    /// The sheet without its plates, with cells for nodes.
    pub fn sheet(&self) -> &ContactSheet {
        &self.sheet
    }

    /// True if one plate covers the whole sheet and so connects all contacts.
    pub fn has_one_plate(&self) -> bool {
        self.plates.iter().all(|plate| *plate == self.plates[0])
    }

    /// Number of cells, whether in contact or not.
    pub fn cell_count(&self) -> usize {
        self.plates.len()
    }

    /// All points at which the sheet can make contact.
    pub fn points(&self) -> &[PlatePoint] {
        &self.points
    }

    /// Ranges of points, ascending: all points within a distance of a centre (metres), and few others.
    pub fn points_near(&self, centre_m: Point, reach_m: f64) -> impl Iterator<Item = Range<usize>> + '_ {
        let Columns { left_m, width_m, firsts } = &self.columns;
        let last = firsts.len() - 2;
        let column = |x_m: f64| (((x_m - left_m) / width_m).max(0.0) as usize).min(last);
        (column(centre_m[0] - reach_m)..=column(centre_m[0] + reach_m)).map(move |column| {
            let from_m = left_m + width_m * column as f64;
            let nearest_m = centre_m[0].clamp(from_m, from_m + width_m);
            let half_m = (reach_m * reach_m - (nearest_m - centre_m[0]).powi(2)).max(0.0).sqrt();
            let points = &self.points[firsts[column]..firsts[column + 1]];
            let from = points.partition_point(|point| point.position_m[1] < centre_m[1] - half_m);
            let to = points.partition_point(|point| point.position_m[1] <= centre_m[1] + half_m);
            firsts[column] + from..firsts[column] + to.max(from)
        })
    }

    /// Solves for these contacts: the conductance of each cell to its plate, siemens.
    ///
    /// # Errors
    /// A conductance that is not finite.
    pub fn contact(&self, conductance_s: &[f64]) -> Result<PlateContact, EitError> {
        let largest = conductance_s.iter().copied().fold(0.0, f64::max);
        let touches = |cell: &u32| conductance_s[*cell as usize] > LEAST_CONTACT * largest;
        let cells: Vec<u32> = (0..self.plates.len() as u32).filter(touches).collect();
        let plates: Vec<u32> = cells.iter().map(|&cell| self.plates[cell as usize]).collect();
        let touched = cells.iter().map(|&cell| conductance_s[cell as usize]).collect();
        let touched = self.sheet.solve(cells.clone(), touched, &plates)?;
        let change_v = match cells.is_empty() {
            true => vec![0.0; self.channels()],
            false => self.sheet.change_of(&touched),
        };
        Ok(PlateContact { change_v, cells, touched })
    }

    /// Derivatives of the channels with respect to four parameters, channels x parameters, row-major. `moves` are the
    /// derivatives of the conductances of the cells in contact, siemens per unit of each parameter.
    pub fn derivatives(&self, contact: &PlateContact, moves: &[[f64; OF_PRESS]]) -> Vec<f64> {
        let cells = &contact.cells;
        let mut jacobian = vec![0.0; self.channels() * OF_PRESS];
        let (mut rows, mut relative) = (Vec::with_capacity(cells.len()), Vec::with_capacity(cells.len()));
        for (row, (moves, conductance)) in moves.iter().zip(&contact.touched.conductance_s).enumerate() {
            if moves.iter().any(|value| *value != 0.0) {
                rows.push(row);
                relative.push(moves.map(|value| value / conductance));
            }
        }
        self.sheet.exchange(&contact.touched, &rows, &relative, |channel, parameter, value| {
            jacobian[OF_PRESS * channel + parameter] = value;
        });
        jacobian
    }
}

/// The parts of the mesh's triangles under the plates. `order` has the index in the mesh of each of the sheet's nodes.
fn parts_under_plates(model: &ForwardModel, order: &[usize], plate_at: impl Fn(Point) -> Option<u32>) -> Vec<Part> {
    let mesh = &model.body.mesh;
    let mut place = vec![0; order.len()];
    order.iter().enumerate().for_each(|(at, &node)| place[node] = at as u32);
    let shares = subtriangles();
    let mut parts = Vec::new();
    // Area and moments of the corners' shares of each larger part under each plate.
    let mut of_triangle: BTreeMap<([usize; 3], u32), [f64; 5]> = BTreeMap::new();
    for (nodes, measure) in mesh.elements().zip(mesh.measures()) {
        let &[a, b, c] = nodes else { continue };
        let corners = [a, b, c].map(|node| mesh.nodes()[node as usize]);
        of_triangle.clear();
        for share in &shares {
            let [x, y] = [0, 1].map(|axis| (0..3).map(|k| share[k] * corners[k][axis]).sum::<f64>());
            let Some(plate) = plate_at([x, y]) else { continue };
            let area = measure / shares.len() as f64;
            let part = of_triangle.entry((larger_part(share), plate)).or_default();
            let added = [x, y, share[0], share[1], share[2]];
            part.iter_mut().zip(added).for_each(|(sum, value)| *sum += area * value);
        }
        for (&(_, plate), [x, y, of_corners @ ..]) in &of_triangle {
            let area_m2: f64 = of_corners.iter().sum();
            let corners = [0, 1, 2].map(|k| (place[[a, b, c][k] as usize], of_corners[k] / area_m2));
            parts.push(Part { position_m: [x / area_m2, y / area_m2], area_m2, plate, corners });
        }
    }
    parts
}

/// The cell of each part: squares of at most about this size, which divide the extent of each plate evenly.
fn cells_of(parts: &[Part], size_m: f64) -> Vec<u32> {
    let mut extents: BTreeMap<u32, [[f64; 2]; 2]> = BTreeMap::new();
    for Part { position_m, plate, .. } in parts {
        let extent = extents.entry(*plate).or_insert([*position_m; 2]);
        for (axis, at) in position_m.iter().enumerate() {
            extent[0][axis] = extent[0][axis].min(*at);
            extent[1][axis] = extent[1][axis].max(*at);
        }
    }
    let least = LEAST_CELLS[usize::from(extents.len() > FEW_PLATES)] as f64;
    let key = |part: &Part| {
        let [low, high] = extents[&part.plate];
        let [column, row] = [0, 1].map(|axis| {
            let length_m = high[axis] - low[axis];
            let count = (length_m / size_m).ceil().max(least);
            let share = (part.position_m[axis] - low[axis]) / length_m.max(f64::MIN_POSITIVE);
            (share * count).min(count - 1.0) as u32
        });
        (part.plate, row, column)
    };
    let mut numbers: BTreeMap<(u32, u32, u32), u32> = parts.iter().map(|part| (key(part), 0)).collect();
    (0..).zip(numbers.values_mut()).for_each(|(number, cell)| *cell = number);
    parts.iter().map(|part| numbers[&key(part)]).collect()
}

impl Columns {
    /// Sorts parts into columns about this wide.
    fn of(parts: &mut [Part], width_m: f64) -> Self {
        let left_m = parts.iter().map(|part| part.position_m[0]).fold(f64::INFINITY, f64::min);
        let column = |part: &Part| ((part.position_m[0] - left_m) / width_m) as usize;
        parts.sort_by(|a, b| column(a).cmp(&column(b)).then(a.position_m[1].total_cmp(&b.position_m[1])));
        let count = parts.last().map_or(1, |part| column(part) + 1);
        let firsts = (0..=count).map(|k| parts.partition_point(|part| column(part) < k)).collect();
        Self { left_m, width_m, firsts }
    }
}

/// The larger part of a triangle that contains these barycentric coordinates.
fn larger_part(share: &[f64; 3]) -> [usize; 3] {
    share.map(|value| (PARTS as f64 * value) as usize)
}

/// Barycentric coordinates of the centroids of a triangle's equal parts.
fn subtriangles() -> Vec<[f64; 3]> {
    let n = DIVISIONS as f64;
    let mut centres = Vec::new();
    for i in 0..DIVISIONS {
        for j in 0..DIVISIONS - i {
            let (a, b) = (i as f64, j as f64);
            let upright = [(a + 1.0 / 3.0) / n, (b + 1.0 / 3.0) / n];
            centres.push([upright[0], upright[1], 1.0 - upright[0] - upright[1]]);
            if i + j + 2 <= DIVISIONS {
                let inverted = [(a + 2.0 / 3.0) / n, (b + 2.0 / 3.0) / n];
                centres.push([inverted[0], inverted[1], 1.0 - inverted[0] - inverted[1]]);
            }
        }
    }
    centres
}
