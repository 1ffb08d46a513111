//! Solutions: changes of mutual inductance and the field of the eddy currents.

use super::super::{Complex, MU0, add, scaled};
use super::elements::Point;
use super::system::{EddySystem, Samples};
use super::{Source, Vector};

/// Potentials of the eddy currents of several sources.
#[derive(Debug)]
pub struct Fields<'a> {
    system: &'a EddySystem<'a>,
    potentials: Vec<Vec<Complex>>,
    changes: Vec<Complex>,
    samples: Vec<Samples>,
    /// Iterations that the slowest source took.
    pub iterations: usize,
}

impl<'a> Fields<'a> {
    pub(super) fn new(
        system: &'a EddySystem<'a>,
        potentials: Vec<Vec<Complex>>,
        sides: &[Vec<Complex>],
        samples: Vec<Samples>,
        iterations: usize,
    ) -> Self {
        let count = potentials.len();
        // A right-hand side is also the functional that gives dM: -int j w mu0 sigma As.v + (1/mu_r - 1) Bs.curl v.
        let change = |m: usize, n: usize| {
            let scattered: Complex = potentials[m].iter().zip(&sides[n]).map(|(x, b)| x * b).sum();
            (scattered + system.direct(&samples[m], &samples[n])) / MU0
        };
        let changes = (0..count * count).map(|at| change(at / count, at % count)).collect();
        Self { system, potentials, changes, samples, iterations }
    }

    /// Sources.
    pub fn len(&self) -> usize {
        self.potentials.len()
    }

    /// True without sources.
    pub fn is_empty(&self) -> bool {
        self.potentials.is_empty()
    }

    /// Change of the mutual inductance of two sources, henries (for coils of 1 A): `None` for a source that does not exist.
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

    /// Change of the flux of a source through another that the system was not solved for, Wb (per ampere for coils): with a
    /// [`super::Dipole`] of unit moment, the flux density that the bodies add at its place, from the currents in them and
    /// so smoother than [`Fields::added`]. `None` for a source that does not exist.
    pub fn linked(&self, source: usize, probe: &dyn Source) -> Option<Complex> {
        let (potential, own) = (self.potentials.get(source)?, self.samples.get(source)?);
        let probe = self.system.sample(probe, [1.0; 3]);
        let side = self.system.side(&probe);
        let scattered: Complex = potential.iter().zip(&side).map(|(x, b)| x * b).sum();
        Some((scattered + self.system.direct(own, &probe)) / MU0)
    }

    /// Vector potential and flux density (T) that the bodies add to a source's field at a point; the potential is
    /// known up to a gradient. `None` outside the mesh or for a source that does not exist.
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
