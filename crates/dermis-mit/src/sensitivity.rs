//! Sensitivity of mutual inductances to the conductivity and permeability of a layer of voxels near the coils, by
//! reciprocity.
//!
//! With `e^{+j w t}`, `curl(1/mu curl A) + j w sigma A = J` and both coils' potentials per ampere, take the
//! difference of the equations before and after a change, each multiplied by the other coil's potential. This leaves
//! `dM_mn/dsigma = -j w int A_m.A_n dV` and `dM_mn/dmu = 1/mu^2 int B_m.B_n dV = int H_m.H_n dV`. With `dZ = j w dM`
//! and `E = -j w A`, `dZ/dsigma = w^2 int A_m.A_n dV = -int E_m.E_n dV / (I_m I_n)` and
//! `dZ/dmu = j w int H_m.H_n dV = j w / mu^2 int B_m.B_n dV / (I_m I_n)`. The voltage that a receiver's equation
//! gives as `-j w int A.J` is minus the current times Z, so it has the opposite sign.
//!
//! The layer is assumed weak here: the fields in it are those of the coils alone, which holds if `w mu0 sigma L^2` is
//! far below 1 for its size L. Its currents follow `-j w A` only if nothing drives them against its faces: the
//! windings must be parallel to it, as in every [`crate::Coil`], and the layer must continue beyond the voxels. Metal
//! bodies are far from this limit: see [`crate::edge::Fields::sensitivities`] for derivatives with respect to their
//! materials and [`crate::MultipoleArray::slopes`] for derivatives with respect to their heights.

use std::f64::consts::TAU;

use rayon::prelude::*;

use crate::array::CoilArray;
use crate::constants::MU0;
use crate::error::{MitError, positive};
use crate::quadrature::gauss_legendre;
use crate::vector::{Complex, Vector, dot, norm};

/// A box of equal voxels, ordered by z, then y, then x (fastest).
#[derive(Clone, Debug, PartialEq)]
pub struct VoxelLayer {
    low_m: Vector,
    voxel_m: Vector,
    counts: [usize; 3],
    points: usize,
}

impl VoxelLayer {
    /// The box between two corners, divided into `counts` voxels along x, y and z. Every voxel is integrated with 2 x
    /// 2 x 2 Gauss-Legendre points (exact to degree 3 along each axis), unless changed by
    /// [`VoxelLayer::with_points`].
    ///
    /// # Errors
    /// Corners that are not in order, or no voxels along an axis.
    pub fn new(low_m: Vector, high_m: Vector, counts: [usize; 3]) -> Result<Self, MitError> {
        for axis in 0..3 {
            positive("size of the layer (m)", high_m[axis] - low_m[axis])?;
            positive("voxels along an axis", counts[axis] as f64)?;
        }
        let voxel_m = std::array::from_fn(|axis| (high_m[axis] - low_m[axis]) / counts[axis] as f64);
        Ok(Self { low_m, voxel_m, counts, points: 2 })
    }

    /// The same with `points` Gauss points along each side of a voxel: exact to degree `2 points - 1`. The scale of
    /// the fields is the distance d to the wire, so the remaining error is about `(voxel / 2d)^(2 points)`.
    ///
    /// # Errors
    /// No points, or more than 16.
    pub fn with_points(mut self, points: usize) -> Result<Self, MitError> {
        if !(1..=16).contains(&points) {
            let expected = "1 to 16";
            return Err(MitError::Value { field: "points along a voxel's side", value: points as f64, expected });
        }
        self.points = points;
        Ok(self)
    }

    /// Number of voxels.
    pub fn voxel_count(&self) -> usize {
        self.counts.iter().product()
    }

    /// Number of voxels along x, y and z.
    pub fn counts(&self) -> [usize; 3] {
        self.counts
    }

    /// Side lengths of a voxel, metres.
    pub fn voxel_m(&self) -> Vector {
        self.voxel_m
    }

    /// Centre of a voxel, metres; `None` if it does not exist.
    pub fn centre_m(&self, voxel: usize) -> Option<Vector> {
        (voxel < self.voxel_count()).then(|| self.at(voxel, [0.0; 3]))
    }

    /// A point in a voxel, given coordinates from -1 to 1.
    fn at(&self, voxel: usize, local: Vector) -> Vector {
        let [nx, ny, _] = self.counts;
        let index = [voxel % nx, voxel / nx % ny, voxel / (nx * ny)];
        std::array::from_fn(|k| self.low_m[k] + self.voxel_m[k] * (index[k] as f64 + 0.5 + 0.5 * local[k]))
    }

    /// Quadrature points of a voxel with their volumes.
    fn rule(&self) -> Vec<(Vector, f64)> {
        let line = gauss_legendre(self.points);
        let share = self.voxel_m.iter().product::<f64>() / 8.0;
        let mut rule = Vec::with_capacity(line.len().pow(3));
        for (z, w) in &line {
            for (y, v) in &line {
                rule.extend(line.iter().map(|(x, u)| ([*x, *y, *z], u * v * w * share)));
            }
        }
        rule
    }

    /// Maximum distance of any place in a voxel from the nearest quadrature point.
    fn spacing_m(&self) -> f64 {
        let line = gauss_legendre(self.points);
        let between = line.windows(2).map(|pair| 0.5 * (pair[1].0 - pair[0].0));
        let widest = between.fold(1.0 + line[0].0, f64::max);
        0.5 * widest * norm(self.voxel_m)
    }

    /// Sensitivities of all pairs of an array, voxels in parallel. Needs `16 pairs x voxels` bytes, and twice that
    /// during the computation. The time is that of `points^3` potentials and fields of every coil for each voxel.
    ///
    /// # Errors
    /// Wire in the layer, or so close that the quadrature points do not resolve its field (closer to one than a place
    /// in a voxel may be).
    pub fn sensitivities(&self, array: &CoilArray) -> Result<Sensitivities, MitError> {
        let (pairs, rule, voxels, least_m) = (array.pairs(), self.rule(), self.voxel_count(), self.spacing_m());
        let of_voxels = (0..voxels)
            .into_par_iter()
            .map(|voxel| self.of_voxel(voxel, array, &pairs, &rule, least_m))
            .collect::<Result<Vec<_>, MitError>>()?;
        let mut potentials = vec![0.0; pairs.len() * voxels];
        let mut fields = vec![0.0; pairs.len() * voxels];
        for (voxel, products) in of_voxels.iter().enumerate() {
            for (pair, [potential, field]) in products.iter().enumerate() {
                potentials[pair * voxels + voxel] = *potential;
                fields[pair * voxels + voxel] = *field;
            }
        }
        Ok(Sensitivities { pairs, voxels, potentials, fields })
    }

    /// `int A_m.A_n dV` and `int H_m.H_n dV` of all pairs.
    fn of_voxel(
        &self,
        voxel: usize,
        array: &CoilArray,
        pairs: &[[usize; 2]],
        rule: &[(Vector, f64)],
        least_m: f64,
    ) -> Result<Vec<[f64; 2]>, MitError> {
        let mut products = vec![[0.0; 2]; pairs.len()];
        let mut at_point: Vec<[Vector; 2]> = Vec::with_capacity(array.coils().len());
        for (local, volume) in rule {
            let point = self.at(voxel, *local);
            at_point.clear();
            for (k, coil) in array.coils().iter().enumerate() {
                let distance_m = coil.distance_m(point);
                if distance_m < least_m {
                    return Err(MitError::WireInVoxel { voxel: voxel + 1, coil: k + 1, distance_m, least_m });
                }
                let (a, b) = (coil.vector_potential(point), coil.flux_density(point));
                at_point.push([a, b]);
            }
            for (sums, &[m, n]) in products.iter_mut().zip(pairs) {
                let ([a, b], [c, d]) = (at_point[m], at_point[n]);
                sums[0] += volume * dot(a, c);
                sums[1] += volume / (MU0 * MU0) * dot(b, d);
            }
        }
        Ok(products)
    }
}

/// Sensitivities of pairs of coils to voxels, stored as integrals that are valid for all frequencies.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivities {
    pairs: Vec<[usize; 2]>,
    voxels: usize,
    potentials: Vec<f64>,
    fields: Vec<f64>,
}

impl Sensitivities {
    /// Pairs of coils (the rows).
    pub fn pairs(&self) -> &[[usize; 2]] {
        &self.pairs
    }

    /// Number of voxels (the columns).
    pub fn voxel_count(&self) -> usize {
        self.voxels
    }

    /// `int A_m.A_n dV`, by pair and voxel, V^2.s^2.m/A^2.
    pub fn potentials(&self) -> &[f64] {
        &self.potentials
    }

    /// `int H_m.H_n dV = dM/dmu`, by pair and voxel, metres (henries per henry per metre); real, and the same at
    /// every frequency. `dZ/dmu` is `j w` times it.
    pub fn fields(&self) -> &[f64] {
        &self.fields
    }

    /// `dM/dsigma = -j w int A_m.A_n dV`, by pair and voxel, henries per (S/m).
    pub fn inductance_by_conductivity(&self, frequency_hz: f64) -> Vec<Complex> {
        let factor = -TAU * frequency_hz;
        self.potentials.iter().map(|p| Complex::new(0.0, factor * p)).collect()
    }

    /// `dZ/dsigma = w^2 int A_m.A_n dV`, by pair and voxel, ohms per (S/m); real.
    pub fn impedance_by_conductivity(&self, frequency_hz: f64) -> Vec<f64> {
        let factor = (TAU * frequency_hz).powi(2);
        self.potentials.iter().map(|p| factor * p).collect()
    }
}
