//! A sheet under separate conducting plates, each at a potential of its own: patches of metal or fabric. The equations
//! are those of one layer above ([`super`]) with a potential for each plate: with the assignment `B` of contacts to
//! plates in place of `1`, `P = M^-1 - M^-1 B (B' M^-1 B)^-1 B' M^-1`.

use std::collections::BTreeMap;

use super::fit::OF_PATCH;
use super::sheet::{ContactSheet, Touched};
use crate::eit::{EitError, ForwardModel};

/// Each triangle is divided into the square of this many equal ones to find the plates above it.
const DIVISIONS: usize = 6;
/// Contacts below this share of the largest are left out: they carry no current.
const LEAST_CONTACT: f64 = 1e-9;

/// The part of a node's area that is under one plate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateCell {
    /// Centroid, metres.
    pub position_m: [f64; 2],
    /// Area, m^2.
    pub area_m2: f64,
    node: u32,
    plate: u32,
}

/// A sheet under separate plates, prepared for any contacts.
#[derive(Debug)]
pub struct PlatedSheet {
    sheet: ContactSheet,
    cells: Vec<PlateCell>,
}

/// Solution for one set of contacts.
#[derive(Clone, Debug)]
pub struct PlateContact {
    /// Change of each channel, volts.
    pub change_v: Vec<f64>,
    /// The cells in contact, as indices in [`PlatedSheet::cells`], ascending.
    pub cells: Vec<usize>,
    touched: Touched,
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
        plate_at: impl Fn([f64; 2]) -> Option<u32>,
    ) -> Result<Self, EitError> {
        let (sheet, order) = ContactSheet::with_order(model, sheet_s, 0.0)?;
        let mesh = &model.body.mesh;
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &node)| place[node] = at as u32);
        // Area and moments of each node under each plate.
        let mut parts: BTreeMap<(u32, u32), [f64; 3]> = BTreeMap::new();
        let shares = subtriangles();
        for (nodes, measure) in mesh.elements().zip(mesh.measures()) {
            let &[a, b, c] = nodes else { continue };
            let corners = [a, b, c].map(|node| mesh.nodes()[node as usize]);
            for share in &shares {
                let [x, y] = [0, 1].map(|axis| (0..3).map(|k| share[k] * corners[k][axis]).sum::<f64>());
                let Some(plate) = plate_at([x, y]) else { continue };
                for (node, share) in [a, b, c].into_iter().zip(share) {
                    let area = measure * share / shares.len() as f64;
                    let part = parts.entry((place[node as usize], plate)).or_default();
                    part.iter_mut().zip([area, area * x, area * y]).for_each(|(sum, value)| *sum += value);
                }
            }
        }
        let cells = parts.into_iter().map(|((node, plate), [area_m2, x, y])| PlateCell {
            position_m: [x / area_m2, y / area_m2],
            area_m2,
            node,
            plate,
        });
        Ok(Self { cells: cells.collect(), sheet })
    }

    /// Number of channels.
    pub fn channels(&self) -> usize {
        self.sheet.channels()
    }

    /// Channels on the bare sheet, volts.
    pub fn bare_v(&self) -> &[f64] {
        self.sheet.bare_v()
    }

    /// All cells that can make contact.
    pub fn cells(&self) -> &[PlateCell] {
        &self.cells
    }

    /// Solves for these contacts: the conductance of each cell, siemens.
    ///
    /// # Errors
    /// A conductance that is not finite.
    pub fn contact(&self, conductance_s: &[f64]) -> Result<PlateContact, EitError> {
        let largest = conductance_s.iter().copied().fold(0.0, f64::max);
        let touches = |cell: &usize| conductance_s[*cell] > LEAST_CONTACT * largest;
        let cells: Vec<usize> = (0..self.cells.len()).filter(touches).collect();
        let nodes = cells.iter().map(|&cell| self.cells[cell].node).collect();
        let plates: Vec<u32> = cells.iter().map(|&cell| self.cells[cell].plate).collect();
        let touched = self.sheet.solve(nodes, cells.iter().map(|&cell| conductance_s[cell]).collect(), &plates)?;
        let change_v = match cells.is_empty() {
            true => vec![0.0; self.channels()],
            false => self.sheet.change_of(&touched),
        };
        Ok(PlateContact { change_v, cells, touched })
    }

    /// Derivatives of the channels with respect to four parameters, channels x parameters, row-major. `moves` are the
    /// derivatives of the conductances of the cells in contact, siemens per unit of each parameter.
    pub fn derivatives(&self, contact: &PlateContact, moves: &[[f64; OF_PATCH]]) -> Vec<f64> {
        let mut jacobian = vec![0.0; self.channels() * OF_PATCH];
        let (mut rows, mut relative) = (Vec::new(), Vec::new());
        for (row, (moves, conductance)) in moves.iter().zip(&contact.touched.conductance_s).enumerate() {
            if moves.iter().any(|value| *value != 0.0) {
                rows.push(row);
                relative.push(moves.map(|value| value / conductance));
            }
        }
        self.sheet.exchange(&contact.touched, &rows, &relative, |channel, parameter, value| {
            jacobian[OF_PATCH * channel + parameter] = value;
        });
        jacobian
    }
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
