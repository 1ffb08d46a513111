//! Solutions: changes of mutual inductance and the field of the eddy currents.

use super::elements::Point;
use super::source::{Samples, Source};
use super::system::EddySystem;
use crate::constants::MU0;
use crate::error::MitError;
use crate::vector::{Complex, Vector, add, scaled};

/// Derivatives of a change of mutual inductance with respect to the material of one body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivity {
    /// With respect to conductivity, henries per (S/m).
    pub by_conductivity: Complex,
    /// With respect to permeability, henries per (H/m).
    pub by_permeability: Complex,
}

/// Potentials of the eddy currents for several sources.
#[derive(Debug)]
pub struct Fields<'a> {
    system: &'a EddySystem<'a>,
    potentials: Vec<Vec<Complex>>,
    changes: Vec<Complex>,
    samples: Vec<Samples>,
    /// Number of iterations of the slowest source.
    pub iterations: usize,
}

impl EddySystem<'_> {
    /// Fields and changes of mutual inductance for sources that act one at a time.
    ///
    /// # Errors
    /// An iteration that does not converge.
    pub fn solve(&self, sources: &[&dyn Source]) -> Result<Fields<'_>, MitError> {
        let samples: Vec<Samples> = sources.iter().map(|source| self.sample(*source, [1.0; 3])).collect();
        self.solve_samples(samples)
    }

    pub(super) fn solve_samples(&self, mut samples: Vec<Samples>) -> Result<Fields<'_>, MitError> {
        samples.iter_mut().for_each(|samples| self.gauge.apply(samples));
        let sides: Vec<Vec<Complex>> = samples.iter().map(|sample| self.side(sample)).collect();
        let (potentials, iterations) = self.matrix.solve(&sides)?;
        Ok(Fields::new(self, potentials, &sides, samples, iterations))
    }
}

impl<'a> Fields<'a> {
    fn new(
        system: &'a EddySystem<'a>,
        potentials: Vec<Vec<Complex>>,
        sides: &[Vec<Complex>],
        samples: Vec<Samples>,
        iterations: usize,
    ) -> Self {
        let count = potentials.len();
        // A right-hand side is also the functional that yields dM: -int j w mu0 sigma As.v + (1/mu_r - 1) Bs.curl v.
        let change = |m: usize, n: usize| {
            let scattered: Complex = potentials[m].iter().zip(&sides[n]).map(|(x, b)| x * b).sum();
            (scattered + system.direct(&samples[m], &samples[n])) / MU0
        };
        let changes = (0..count * count).map(|at| change(at / count, at % count)).collect();
        Self { system, potentials, changes, samples, iterations }
    }

    /// Number of sources.
    pub fn len(&self) -> usize {
        self.potentials.len()
    }

    /// True if there are no sources.
    pub fn is_empty(&self) -> bool {
        self.potentials.is_empty()
    }

    /// Change of the mutual inductance of two sources, henries (for coils with 1 A); `None` if a source does not
    /// exist.
    pub fn change_h(&self, m: usize, n: usize) -> Option<Complex> {
        if m.max(n) >= self.len() {
            return None;
        }
        Some(self.changes[m * self.len() + n])
    }

    /// All changes, row by row.
    pub fn changes_h(&self) -> &[Complex] {
        &self.changes
    }

    /// Change of the flux of a source through a probe that was not part of the solution, Wb (per ampere for coils).
    /// With a [`super::Dipole`] of unit moment, this is the flux density that the bodies add at its position,
    /// computed from the currents in them and therefore smoother than [`Fields::added`]. `None` if the source does
    /// not exist.
    pub fn linked(&self, source: usize, probe: &dyn Source) -> Option<Complex> {
        let (potential, own) = (self.potentials.get(source)?, self.samples.get(source)?);
        let probe = self.system.sample(probe, [1.0; 3]);
        let side = self.system.side(&probe);
        let scattered: Complex = potential.iter().zip(&side).map(|(x, b)| x * b).sum();
        Some((scattered + self.system.direct(own, &probe)) / MU0)
    }

    /// Derivatives of every change with respect to the conductivity and permeability of every body, by reciprocity,
    /// from the total fields `A = As + Ar` in the body: `dM_mn/dsigma = -j w int A_m.A_n dV`,
    /// `dM_mn/dmu = 1/mu^2 int B_m.B_n dV`. These are the exact derivatives of this discrete model, up to the
    /// residual of its iteration. Rows as in [`Fields::changes_h`], with the bodies inside each.
    ///
    /// # Errors
    /// A number of sources that differs from the solution.
    pub fn sensitivities(&self, sources: &[&dyn Source]) -> Result<Vec<Sensitivity>, MitError> {
        if sources.len() != self.len() {
            return Err(MitError::Count { what: "sources", expected: self.len(), got: sources.len() });
        }
        let (count, regions) = (self.len(), self.system.coefficients.len() - 1);
        let mut sums = vec![[Complex::new(0.0, 0.0); 2]; count * count * regions];
        for (body, element) in self.system.bodies().into_iter().enumerate() {
            let region = self.system.mesh.regions[element] as usize - 1;
            for (q, volume) in self.system.volumes(element).into_iter().enumerate() {
                let whole: Vec<_> = (0..count).map(|s| self.whole(s, sources[s], body, element, q)).collect();
                for m in 0..count {
                    for n in 0..count {
                        let sum = &mut sums[(m * count + n) * regions + region];
                        for (k, sum) in sum.iter_mut().enumerate() {
                            *sum += (0..3).map(|i| whole[m][k][i] * whole[n][k][i]).sum::<Complex>() * volume;
                        }
                    }
                }
            }
        }
        let finish = |(at, [potentials, fields]): (usize, [Complex; 2])| {
            let reluctivity = self.system.coefficients[at % regions + 1].1 / MU0;
            Sensitivity {
                by_conductivity: potentials * Complex::new(0.0, -self.system.angular_frequency),
                by_permeability: fields * reluctivity.powi(2),
            }
        };
        Ok(sums.into_iter().enumerate().map(finish).collect())
    }

    /// Total potential and flux density of a source at a quadrature point.
    fn whole(&self, source: usize, outer: &dyn Source, body: usize, element: usize, q: usize) -> [[Complex; 3]; 2] {
        let point = &self.system.points[q];
        let map = self.system.mesh.geometry(element).map(point.barycentric);
        let coefficients = self.system.local(element, &self.potentials[source]);
        let own = self.samples[source][body * self.system.points.len() + q].0;
        let complex = |v: Vector| v.map(|x| Complex::new(x, 0.0));
        let mut all = [complex(own), complex(outer.flux_density(map.position_m))];
        for f in 0..self.system.functions() {
            for (all, v) in all.iter_mut().zip([map.value(point.values[f]), map.curl(point.curls[f])]) {
                all.iter_mut().zip(v).for_each(|(all, v)| *all += coefficients[f] * v);
            }
        }
        all
    }

    /// Vector potential and flux density (T) that the bodies add to a source's field at a point. The potential is
    /// determined up to a gradient. `None` outside the mesh, or if the source does not exist.
    pub fn added(&self, source: usize, point_m: Vector) -> Option<([Complex; 3], [Complex; 3])> {
        let potential = self.potentials.get(source)?;
        let (element, l) = self.system.mesh.locate(point_m)?;
        let map = self.system.mesh.geometry(element).map(l);
        let point = Point::new(l, 1.0);
        let coefficients = self.system.local(element, potential);
        let (mut re, mut im) = ([[0.0; 3]; 2], [[0.0; 3]; 2]);
        for f in 0..self.system.functions() {
            for (k, v) in [map.value(point.values[f]), map.curl(point.curls[f])].into_iter().enumerate() {
                re[k] = add(re[k], scaled(v, coefficients[f].re));
                im[k] = add(im[k], scaled(v, coefficients[f].im));
            }
        }
        let complex = |k: usize| std::array::from_fn(|axis| Complex::new(re[k][axis], im[k][axis]));
        Some((complex(0), complex(1)))
    }
}
