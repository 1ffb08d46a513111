//! A sensing sheet under separate patches, for example of fabric, solved by a low-rank update. Fabric conducts so
//! much better than the sprayed sheet that each patch is one floating potential v. A cell of a patch with conductance
//! `d = g area` draws the current `q = d (u - v)` from the sheet, where u is the sheet's mean potential under the
//! cell, and `sum q = 0` over a patch.
//!
//! Over the touching cells only, let G be the bare sheet's mean potential under each cell for unit current into
//! another, U the same for each electrode's unit current, Z0 the bare sheet's transfer impedances, and B the
//! assignment of cells to patches: `(G + 1/d) q + B v = U`, `B' q = 0`, `Z = Z0 - U' q` (Sherman, Morrison and
//! Woodbury, with the floating potentials as a constraint). G, U and Z0 are computed once; a frame costs one dense
//! Cholesky factorisation of the touching cells.

use dermis_tomo::mesh::{ElectrodedMesh, Point};
use dermis_tomo::sparse::{Ordering, SparseError, SpdFactor, SpdStructure};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use faer::{Mat, MatRef, Par, Side};

use super::conductance_map::ConductanceMap;
use super::element::{PAIRS, SheetConductance, stiffness};
use super::patches_cells::{ContactCell, ContactCells, PatchLayout};
use super::sheet_body::{contact_entries, coordinates, refuse, triangles_of};

/// Number of right-hand sides solved together.
const BLOCK: usize = 64;
/// Minimum conductance of a touching cell, as a share of the sheet's.
const LEAST_CONTACT: f64 = 1e-9;

/// A sheet with electrodes under patches. The last electrode is the reference.
#[derive(Clone, Debug)]
pub struct PatchedSheet {
    contact: ContactCells,
    sheet_s: f64,
    /// Z0: electrodes x electrodes, ohm.
    open: Mat<f64>,
    /// U: electrodes without the reference x cells, ohm.
    response: Mat<f64>,
    /// G: cells x cells, ohm.
    coupling: Mat<f64>,
    touching: Vec<usize>,
    impedance: Mat<f64>,
}

impl PatchedSheet {
    /// Prepares a flat sheet of conductance `sheet_s` (siemens: thickness times conductivity), times a
    /// position-dependent factor, under patches.
    ///
    /// # Errors
    /// Point electrodes, fewer than two electrodes, or a singular system.
    pub fn new(
        body: &ElectrodedMesh,
        sheet_s: f64,
        layout: PatchLayout,
        conductance: &ConductanceMap,
    ) -> Result<Self, SparseError> {
        let sheet = BareSheet::new(body, sheet_s, conductance)?;
        let contact = ContactCells::new(&sheet.triangles, &sheet.positions, layout);
        let (structure, factor) = sheet.factor(&[], 0)?;
        let (nodes, electrodes, cells) = (sheet.positions.len(), sheet.electrodes, contact.cells.len());
        let mean = |potentials: MatRef<'_, f64>, column: usize, cell: usize| -> f64 {
            contact.weights[cell].iter().map(|&(node, weight)| weight * potentials[(node as usize, column)]).sum()
        };
        let mut fields = Mat::zeros(structure.size(), electrodes - 1);
        (0..electrodes - 1).for_each(|electrode| fields[(nodes + electrode, electrode)] = 1.0);
        structure.solve_in_place(&factor, fields.as_mut());
        let response = Mat::from_fn(electrodes - 1, cells, |electrode, cell| mean(fields.as_ref(), electrode, cell));
        let mut coupling = Mat::zeros(cells, cells);
        let mut block = Mat::zeros(structure.size(), BLOCK.min(cells));
        for first in (0..cells).step_by(BLOCK) {
            let count = BLOCK.min(cells - first);
            block.fill(0.0);
            for column in 0..count {
                contact.weights[first + column].iter().for_each(|&(node, w)| block[(node as usize, column)] = w);
            }
            structure.solve_in_place(&factor, block.as_mut().subcols_mut(0, count));
            for column in 0..count {
                (0..cells).for_each(|cell| coupling[(cell, first + column)] = mean(block.as_ref(), column, cell));
            }
        }
        let open = transfer(&fields, nodes, electrodes);
        Ok(Self { impedance: open.clone(), open, response, coupling, contact, sheet_s, touching: Vec::new() })
    }

    /// The contact cells.
    pub fn cells(&self) -> &[ContactCell] {
        &self.contact.cells
    }

    /// Number of patches.
    pub fn patch_count(&self) -> usize {
        self.contact.patch_count
    }

    /// Number of touching cells in the last call of [`PatchedSheet::impedance`].
    pub fn touching(&self) -> usize {
        self.touching.len()
    }

    /// Transfer impedances in ohm, electrodes x electrodes: the potential of the row's electrode for 1 A into the
    /// column's electrode and out of the last. `contact_s_per_m2` is g for each cell.
    ///
    /// # Errors
    /// Contact that is not finite.
    pub fn impedance(&mut self, contact_s_per_m2: &[f64]) -> Result<MatRef<'_, f64>, SparseError> {
        let conductance = |cell: usize| contact_s_per_m2[cell] * self.contact.cells[cell].area_m2;
        let touches = |cell: &usize| conductance(*cell) > LEAST_CONTACT * self.sheet_s;
        let touching: Vec<usize> = (0..self.contact.cells.len()).filter(touches).collect();
        self.impedance.copy_from(&self.open);
        if !touching.is_empty() {
            let size = touching.len();
            let mut system = Mat::from_fn(size, size, |a, b| self.coupling[(touching[a], touching[b])]);
            (0..size).for_each(|k| system[(k, k)] += 1.0 / conductance(touching[k]));
            self.subtract(system, &touching)?;
        }
        self.touching = touching;
        Ok(self.impedance.as_ref())
    }

    /// `Z = Z0 - U' (H^-1 - H^-1 B (B' H^-1 B)^-1 B' H^-1) U` with H = `system`, computed with Cholesky factors.
    fn subtract(&mut self, system: Mat<f64>, touching: &[usize]) -> Result<(), SparseError> {
        let sources = self.response.nrows();
        let mut patches: Vec<u32> = touching.iter().map(|&cell| self.contact.cells[cell].patch).collect();
        let patch_of = patches.clone();
        patches.sort_unstable();
        patches.dedup();
        let singular = |pivot: usize, size: usize| SparseError::NotPositiveDefinite { pivot, size };
        let mut sides = Mat::from_fn(touching.len(), sources + patches.len(), |row, column| match column < sources {
            true => self.response[(column, touching[row])],
            false => f64::from(u8::from(patch_of[row] == patches[column - sources])),
        });
        let factor = system.llt(Side::Lower).map_err(|_| singular(0, touching.len()))?;
        solve_lower_triangular_in_place(factor.L(), sides.as_mut(), Par::Seq);
        let (fields, floating) = (sides.get(.., ..sources), sides.get(.., sources..));
        let level = (floating.transpose() * floating).llt(Side::Lower).map_err(|_| singular(0, patches.len()))?;
        let mut levels = floating.transpose() * fields;
        solve_lower_triangular_in_place(level.L(), levels.as_mut(), Par::Seq);
        let change = levels.transpose() * &levels - fields.transpose() * fields;
        for column in 0..sources {
            for row in 0..sources {
                // Average both halves, so that reciprocity holds exactly.
                self.impedance[(row, column)] += 0.5 * (change[(row, column)] + change[(column, row)]);
            }
        }
        Ok(())
    }
}

/// The result of [`PatchedSheet::impedance`] from one sparse factorisation of all unknowns, including the patches.
/// Slow; used for tests.
///
/// # Errors
/// As [`PatchedSheet::new`].
pub fn direct_patched_impedance(
    body: &ElectrodedMesh,
    sheet_s: f64,
    layout: PatchLayout,
    contact_s_per_m2: &[f64],
) -> Result<Mat<f64>, SparseError> {
    let sheet = BareSheet::new(body, sheet_s, &ConductanceMap::Even)?;
    let contact = ContactCells::new(&sheet.triangles, &sheet.positions, layout);
    let (nodes, electrodes) = (sheet.positions.len(), sheet.electrodes);
    let first_patch = (nodes + electrodes - 1) as u32;
    let mut entries = Vec::new();
    for ((cell, weights), g) in contact.cells.iter().zip(&contact.weights).zip(contact_s_per_m2) {
        let mut difference = weights.clone();
        difference.push((first_patch + cell.patch, -1.0));
        for (k, a) in difference.iter().enumerate() {
            let pairs = difference[..=k].iter().filter(|_| *g > 0.0);
            entries.extend(pairs.map(|b| ((a.0.max(b.0), a.0.min(b.0)), g * cell.area_m2 * a.1 * b.1)));
        }
    }
    let touched: Vec<u32> = entries.iter().map(|entry| entry.0.0).filter(|row| *row >= first_patch).collect();
    let untouched = (0..contact.patch_count as u32).map(|k| first_patch + k).filter(|k| !touched.contains(k));
    entries.extend(untouched.map(|patch| ((patch, patch), sheet_s)));
    let (structure, factor) = sheet.factor(&entries, contact.patch_count)?;
    let mut fields = Mat::zeros(structure.size(), electrodes - 1);
    (0..electrodes - 1).for_each(|electrode| fields[(nodes + electrode, electrode)] = 1.0);
    structure.solve_in_place(&factor, fields.as_mut());
    Ok(transfer(&fields, nodes, electrodes))
}

/// The sheet alone: its geometry and the entries of its system.
struct BareSheet {
    triangles: Vec<[u32; 3]>,
    positions: Vec<Point>,
    electrodes: usize,
    places: Vec<[f64; 3]>,
    entries: Vec<((u32, u32), f64)>,
}

impl BareSheet {
    fn new(body: &ElectrodedMesh, sheet_s: f64, conductance: &ConductanceMap) -> Result<Self, SparseError> {
        if body.mesh.nodes().iter().any(|node| node[2] != 0.0) {
            return Err(refuse("expected a flat sheet (z = 0 at every node); unroll a bent one first".into()));
        }
        let positions: Vec<Point> = body.mesh.nodes().iter().map(|p| [p[0], p[1]]).collect();
        let triangles = triangles_of(body)?;
        let contacts = contact_entries(body)?;
        let mut entries: Vec<((u32, u32), f64)> = contacts.iter().map(|e| ((e.row, e.column), e.value)).collect();
        for triangle in &triangles {
            let corners = triangle.map(|node| positions[node as usize]);
            let middle = [0, 1].map(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0);
            let local = stiffness(corners, SheetConductance::isotropic(sheet_s * conductance.at(middle)));
            entries.extend(PAIRS.iter().zip(local).map(|(&(a, b), value)| ((triangle[a], triangle[b]), value)));
        }
        let places = coordinates(body, &positions);
        Ok(Self { triangles, positions, electrodes: body.electrodes.len(), places, entries })
    }

    /// Factors the system with additional entries and unknowns.
    fn factor(&self, more: &[((u32, u32), f64)], unknowns: usize) -> Result<(SpdStructure, SpdFactor), SparseError> {
        let all = || self.entries.iter().chain(more);
        let positions: Vec<(u32, u32)> = all().map(|entry| entry.0).collect();
        let ordering = if unknowns == 0 { Ordering::Dissection(&self.places) } else { Ordering::MinimumDegree };
        let (structure, slots) = SpdStructure::new(self.places.len() + unknowns, &positions, ordering)?;
        let mut values = vec![0.0; structure.value_count()];
        for (slot, entry) in slots.iter().zip(all()) {
            values[*slot as usize] += entry.1;
        }
        let factor = structure.factor(&values)?;
        Ok((structure, factor))
    }
}

/// Electrode potentials from the fields, with zeros in the row and column of the reference.
fn transfer(fields: &Mat<f64>, nodes: usize, electrodes: usize) -> Mat<f64> {
    let known = |row: usize, column: usize| row + 1 < electrodes && column + 1 < electrodes;
    let at = |row: usize, column: usize| fields[(nodes + row, column)];
    Mat::from_fn(electrodes, electrodes, |row, column| match known(row, column) {
        true => 0.5 * (at(row, column) + at(column, row)),
        false => 0.0,
    })
}
