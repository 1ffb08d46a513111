//! The shortcut's own resistance: a factored sheet of copper and its contribution to the impedances.

use dermis_tomo::sparse::{Ordering, SparseError, SpdStructure};
use faer::Mat;

use super::super::element::{PAIRS, SheetConductance, stiffness, weighted_mass};
use super::{Copper, Shortcut, TwoSheets};

impl TwoSheets {
    /// Adds the first-order effect of the shortcut's own resistance, `r' K_v^-1 r`, where r is the current from u
    /// into v.
    pub(super) fn add_copper_loss(&mut self, contact_s_per_m2: &[f64], potentials: &[f64]) {
        let Some(copper) = &self.copper else { return };
        let electrodes = potentials.len();
        for (triangle, area) in self.triangles.iter().zip(&self.areas) {
            let g = triangle.map(|node| contact_s_per_m2[node as usize]);
            if g == [0.0; 3] {
                continue;
            }
            for (&(a, b), value) in PAIRS.iter().zip(weighted_mass(*area, g)) {
                let (a, b) = (triangle[a] as usize, triangle[b] as usize);
                add_exchange(&mut self.spread, &self.fields, potentials, (a, b), value);
                if a != b {
                    add_exchange(&mut self.spread, &self.fields, potentials, (b, a), value);
                }
            }
        }
        self.exchange.clear();
        for &node in &self.touching {
            self.exchange.extend(self.spread.as_ref().col(node as usize).iter());
        }
        // The first node is grounded. Since no net current enters, this only sets the sheet's level.
        self.spread.as_mut().col_mut(0).fill(0.0);
        let right = self.spread.as_mut().transpose_mut();
        copper.structure.solve_at(&copper.factor, &self.touching, right, &mut self.memory);
        for (&node, current) in self.touching.iter().zip(self.exchange.chunks_exact(electrodes)) {
            let rise = self.spread.as_ref().col(node as usize);
            for (column, current) in current.iter().enumerate() {
                for row in 0..electrodes {
                    self.impedance[(row, column)] += current * rise[row];
                }
            }
        }
        // The other nodes have stayed at zero.
        for &node in &self.touching {
            self.spread.as_mut().col_mut(node as usize).fill(0.0);
        }
    }

    pub(super) fn make_copper(&self) -> Result<Option<Copper>, SparseError> {
        let Shortcut::Sheet { conductance_s } = self.shortcut else { return Ok(None) };
        let entries: Vec<(u32, u32)> = self.triangles.iter().flat_map(|t| PAIRS.map(|(a, b)| (t[a], t[b]))).collect();
        let coordinates: Vec<[f64; 3]> = self.positions.iter().map(|p| [p[0], p[1], 0.0]).collect();
        let (structure, slots) = SpdStructure::new(self.positions.len(), &entries, Ordering::Dissection(&coordinates))?;
        let mut values = vec![0.0; structure.value_count()];
        for (element, triangle) in self.triangles.iter().enumerate() {
            let corners = triangle.map(|node| self.positions[node as usize]);
            let local = stiffness(corners, SheetConductance::isotropic(conductance_s));
            for (k, (&(a, b), value)) in PAIRS.iter().zip(local).enumerate() {
                // Row and column of the grounded node are those of the identity.
                if triangle[a] != 0 && triangle[b] != 0 {
                    values[slots[6 * element + k] as usize] += value;
                } else if triangle[a] == triangle[b] {
                    values[slots[6 * element + k] as usize] = conductance_s;
                }
            }
        }
        let factor = structure.factor(&values)?;
        Ok(Some(Copper { structure, factor }))
    }
}

/// `r_a += m_ab (u_b - c)` for every electrode.
fn add_exchange(current: &mut Mat<f64>, fields: &Mat<f64>, potentials: &[f64], (a, b): (usize, usize), mass: f64) {
    let (mut current, field) = (current.as_mut().col_mut(a), fields.as_ref().col(b));
    let below = field[potentials.len()] - 1.0;
    for (electrode, potential) in potentials.iter().enumerate() {
        current[electrode] += mass * (field[electrode] + potential * below);
    }
}
