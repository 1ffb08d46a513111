//! A stretched membrane over a full tray of incompressible liquid, deflected by loads and gravity.
//!
//! Let w be the deflection into the liquid, T the tension (N/m, constant: slopes are small against the pre-stretch),
//! p the pressure of the load, c the liquid's pressure at the origin and g gravity in the skin's frame. Equilibrium
//! of an element of membrane is `T lap w = -p + c + rho (gx x + gy y) - rho gz w`, with `w = 0` at the rim and c such
//! that `integral w = 0`. Linear triangles; the matrix `T K - rho gz M` is factored once, each set of loads costs one
//! back-substitution, and c follows from the membrane's response to a uniform pressure.
//!
//! Without tension it is the open surface of a tank, held by gravity alone: the matrix is `-rho gz M` with lumped M,
//! so that the surface follows the pressure without ripples, and the rim is free.

use faer::Mat;

use crate::mesh::{CellKind, Mesh, Point};
use crate::sparse::{Ordering, SparseError, SpdFactor, SpdStructure};

/// Pairs (a, b), a >= b, of a triangle's corners.
const PAIRS: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

/// Properties of membrane and liquid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MembraneSpec {
    /// Tension, newtons per metre. 0 is an open tank, which needs gravity pointing into the skin.
    pub tension_n_per_m: f64,
    /// Density of the liquid, kg/m^3.
    pub density_kg_per_m3: f64,
    /// Gravity in the skin's frame (z out of the skin), m/s^2: `[0, 0, -9.81]` for a flat skin, `[0, -9.81, 0]` for
    /// an upright one.
    pub gravity_m_per_s2: [f64; 3],
}

/// A membrane on a mesh of triangles. Nodes on the mesh's border are fixed, unless the tank is open.
#[derive(Debug)]
pub struct Membrane {
    positions: Vec<Point>,
    triangles: Vec<[u32; 3]>,
    areas: Vec<f64>,
    structure: SpdStructure,
    factor: SpdFactor,
    /// Unknown of each node; fixed nodes have none.
    unknowns: Vec<Option<u32>>,
    /// `integral phi` of each node, m^2.
    shares_m2: Vec<f64>,
    /// Deflection for a uniform pressure of 1 Pa, m, and its volume.
    give: Vec<f64>,
    give_m3: f64,
    /// Nodal forces of gravity, newtons.
    weight_n: Vec<f64>,
    column: Mat<f64>,
    deflection_m: Vec<f64>,
    liquid_pa: f64,
}

impl MembraneSpec {
    /// True if there is no membrane.
    pub fn is_open(&self) -> bool {
        self.tension_n_per_m == 0.0
    }
}

impl Membrane {
    /// Prepares and factors the membrane, at rest under gravity alone. `plan` is a flat mesh of triangles.
    ///
    /// # Errors
    /// Another kind of mesh, non-finite numbers, or a membrane too slack to hold the liquid when it hangs underneath
    /// (the system is then not positive definite).
    pub fn new(plan: &Mesh, spec: MembraneSpec) -> Result<Self, SparseError> {
        let numbers = [spec.tension_n_per_m, spec.density_kg_per_m3].into_iter().chain(spec.gravity_m_per_s2);
        if !numbers.into_iter().all(f64::is_finite) || spec.tension_n_per_m < 0.0 {
            let reason = format!("a membrane needs finite numbers and a tension of zero or more; got {spec:?}");
            return Err(SparseError::Structure { reason });
        }
        if plan.kind() != CellKind::Triangle {
            let reason = "a membrane needs triangles; the mesh has tetrahedra".to_string();
            return Err(SparseError::Structure { reason });
        }
        let positions: Vec<Point> = plan.nodes().iter().map(|p| [p[0], p[1]]).collect();
        let triangles: Vec<[u32; 3]> = plan.elements().map(|cell| [cell[0], cell[1], cell[2]]).collect();
        let (unknowns, free) = number_free_nodes(plan, spec.is_open());
        let (structure, slots) = structure_of(&positions, &triangles, &unknowns, free)?;
        let mut values = vec![0.0; structure.value_count()];
        let mut slots = slots.into_iter();
        for (triangle, &area) in triangles.iter().zip(plan.measures()) {
            let stiffness = stiffness(triangle.map(|node| positions[node as usize]), area);
            for (&(a, b), stiffness) in PAIRS.iter().zip(stiffness) {
                if let Some(slot) = free_pair(&unknowns, triangle, (a, b)).and_then(|_| slots.next()) {
                    let mass = area
                        * match (spec.is_open(), a == b) {
                            (false, true) => 1.0 / 6.0,
                            (false, false) => 1.0 / 12.0,
                            (true, true) => 1.0 / 3.0,
                            (true, false) => 0.0,
                        };
                    let weight = -spec.density_kg_per_m3 * spec.gravity_m_per_s2[2] * mass;
                    values[slot as usize] += spec.tension_n_per_m * stiffness + weight;
                }
            }
        }
        let nodes = positions.len();
        let mut membrane = Self {
            areas: plan.measures().to_vec(),
            factor: structure.factor(&values)?,
            shares_m2: vec![0.0; nodes],
            give: vec![0.0; nodes],
            give_m3: 0.0,
            weight_n: vec![0.0; nodes],
            column: Mat::zeros(free, 1),
            deflection_m: vec![0.0; nodes],
            liquid_pa: 0.0,
            positions,
            triangles,
            structure,
            unknowns,
        };
        membrane.prepare(&spec);
        Ok(membrane)
    }

    /// Computes shares, response to a uniform pressure, gravity forces, and the rest position under them.
    fn prepare(&mut self, spec: &MembraneSpec) {
        let [gx, gy, _] = spec.gravity_m_per_s2;
        for (triangle, area) in self.triangles.iter().zip(&self.areas) {
            // rho (gx x + gy y) is linear: integral f phi_a = area (f_0 + f_1 + f_2 + f_a) / 12.
            let pressure = triangle.map(|node| {
                let [x, y] = self.positions[node as usize];
                -spec.density_kg_per_m3 * (gx * x + gy * y)
            });
            let sum: f64 = pressure.iter().sum();
            for (&node, pressure) in triangle.iter().zip(pressure) {
                self.shares_m2[node as usize] += area / 3.0;
                self.weight_n[node as usize] += area * (sum + pressure) / 12.0;
            }
        }
        let uniform = self.shares_m2.clone();
        self.solve(&uniform);
        self.give.copy_from_slice(&self.deflection_m);
        self.give_m3 = self.volume_m3();
        self.deflect(&vec![0.0; self.positions.len()]);
    }

    /// Positions of the nodes, metres.
    pub fn positions_m(&self) -> &[Point] {
        &self.positions
    }

    /// Areas of the triangles, m^2.
    pub fn areas_m2(&self) -> &[f64] {
        &self.areas
    }

    /// The triangles' nodes.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// Brings the membrane into equilibrium with nodal forces (newtons, one per node) and gravity.
    pub fn deflect(&mut self, load_n: &[f64]) {
        let total: Vec<f64> = load_n.iter().zip(&self.weight_n).map(|(load, weight)| load + weight).collect();
        self.solve(&total);
        self.liquid_pa = self.volume_m3() / self.give_m3;
        for (w, give) in self.deflection_m.iter_mut().zip(&self.give) {
            *w -= self.liquid_pa * give;
        }
    }

    /// Deflection into the liquid at each node, metres.
    pub fn deflection_m(&self) -> &[f64] {
        &self.deflection_m
    }

    /// Pressure of the liquid under the membrane at the origin, relative to outside, pascals.
    pub fn liquid_pressure_pa(&self) -> f64 {
        self.liquid_pa
    }

    /// Net volume displaced by the membrane, m^3: zero except for rounding.
    pub fn volume_m3(&self) -> f64 {
        self.shares_m2.iter().zip(&self.deflection_m).map(|(share, w)| share * w).sum()
    }

    /// Volume displaced downward by the membrane, m^3, which flows elsewhere.
    pub fn displaced_m3(&self) -> f64 {
        self.shares_m2.iter().zip(&self.deflection_m).map(|(share, w)| share * w.max(0.0)).sum()
    }

    /// Deflection under nodal forces with the tray open (c = 0).
    fn solve(&mut self, load_n: &[f64]) {
        for (unknown, load) in self.unknowns.iter().zip(load_n) {
            if let Some(unknown) = unknown {
                self.column[(*unknown as usize, 0)] = *load;
            }
        }
        self.structure.solve_in_place(&self.factor, self.column.as_mut());
        for (unknown, w) in self.unknowns.iter().zip(&mut self.deflection_m) {
            *w = unknown.map_or(0.0, |unknown| self.column[(unknown as usize, 0)]);
        }
    }
}

/// Numbers the free nodes and counts them. Nodes on the border are fixed unless the tank is open.
fn number_free_nodes(plan: &Mesh, is_open: bool) -> (Vec<Option<u32>>, usize) {
    let mut held = vec![false; plan.nodes().len()];
    let border = if is_open { Vec::new() } else { plan.boundary_faces() };
    border.iter().flat_map(|(face, _)| face).for_each(|&node| held[node as usize] = true);
    let mut free = 0_u32;
    let mut number = |held: bool| {
        (!held).then(|| {
            free += 1;
            free - 1
        })
    };
    let unknowns = held.into_iter().map(&mut number).collect();
    (unknowns, free as usize)
}

/// Unknowns of a pair of a triangle's corners, if both are free.
fn free_pair(unknowns: &[Option<u32>], triangle: &[u32; 3], (a, b): (usize, usize)) -> Option<(u32, u32)> {
    unknowns[triangle[a] as usize].zip(unknowns[triangle[b] as usize])
}

/// Structure over the free nodes, and the slots of the free pairs, triangle by triangle in the order of [`PAIRS`].
fn structure_of(
    positions: &[Point],
    triangles: &[[u32; 3]],
    unknowns: &[Option<u32>],
    free: usize,
) -> Result<(SpdStructure, Vec<u32>), SparseError> {
    if free == 0 {
        return Err(SparseError::Structure { reason: "every node of the membrane is held".to_string() });
    }
    let entries: Vec<(u32, u32)> =
        triangles.iter().flat_map(|t| PAIRS.iter().filter_map(|&pair| free_pair(unknowns, t, pair))).collect();
    let mut places = vec![[0.0; 3]; free];
    for (unknown, [x, y]) in unknowns.iter().zip(positions) {
        if let Some(unknown) = unknown {
            places[*unknown as usize] = [*x, *y, 0.0];
        }
    }
    SpdStructure::new(free, &entries, Ordering::Dissection(&places))
}

/// `integral grad phi_a . grad phi_b` for each of [`PAIRS`].
fn stiffness(corners: [Point; 3], area: f64) -> [f64; 6] {
    let edge = |k: usize| {
        let (from, to) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
        [to[0] - from[0], to[1] - from[1]]
    };
    let edges = [edge(0), edge(1), edge(2)];
    PAIRS.map(|(a, b)| (edges[a][0] * edges[b][0] + edges[a][1] * edges[b][1]) / (4.0 * area))
}
