//! Bodies that are symmetric about the three coordinate planes. Any field is the sum of eight fields that are even or
//! odd across each plane, and each of these needs only an octant of the mesh. Eight small systems cost far less than
//! a large one.
//!
//! If the vector potential is odd across a plane (equal to its mirror image with the sign reversed), its tangential
//! component is zero there; if it is even, the tangential field is zero.

use rayon::prelude::*;

use super::mesh::EdgeMesh;
use super::source::{Samples, Source};
use super::system::{EddySystem, Material, Order, SystemInfo};
use crate::error::MitError;
use crate::vector::{Complex, Vector, add, dot, scaled};

/// Share of a source below which one of its parts counts as zero.
const NOTHING: f64 = 1e-20;

/// A symmetric body at one frequency: the eight systems on an octant of its mesh.
#[derive(Debug)]
pub struct SymmetricBody<'a> {
    /// Each system with the planes across which it is odd, as bits.
    systems: Vec<(u8, EddySystem<'a>)>,
}

/// All subsets of planes.
const ALL: [u8; 8] = [0, 1, 2, 3, 4, 5, 6, 7];
/// Subsets whose potential is odd across the plane y = 0: fields of cosine harmonics.
const COSINES: [u8; 4] = [2, 3, 6, 7];

impl<'a> SymmetricBody<'a> {
    /// Assembles and factors the systems on an [`EdgeMesh::octant`].
    ///
    /// # Errors
    /// A mesh that is not an octant; otherwise as [`EddySystem::new`].
    pub fn new(
        octant: &'a EdgeMesh,
        materials: &[Material],
        frequency_hz: f64,
        order: Order,
    ) -> Result<Self, MitError> {
        Self::with_parts(octant, materials, frequency_hz, order, &ALL)
    }

    /// Half of the systems: those that respond to cosine harmonics. They cover every coil centred in the plane y = 0,
    /// and suffice for the tau of a body of revolution.
    ///
    /// # Errors
    /// As [`SymmetricBody::new`].
    pub fn of_cosines(
        octant: &'a EdgeMesh,
        materials: &[Material],
        frequency_hz: f64,
        order: Order,
    ) -> Result<Self, MitError> {
        Self::with_parts(octant, materials, frequency_hz, order, &COSINES)
    }

    fn with_parts(
        octant: &'a EdgeMesh,
        materials: &[Material],
        frequency_hz: f64,
        order: Order,
        parts: &[u8],
    ) -> Result<Self, MitError> {
        if !octant.is_octant {
            return Err(MitError::Count { what: "eighths in the mesh of a symmetric body", expected: 1, got: 8 });
        }
        let systems = parts
            .par_iter()
            .map(|&odd| Ok((odd, EddySystem::with_fixed(octant, materials, frequency_hz, order, Some(odd))?)))
            .collect::<Result<_, MitError>>()?;
        Ok(Self { systems })
    }

    /// Total size of all systems, and warnings.
    pub fn info(&self) -> SystemInfo {
        let all: Vec<SystemInfo> = self.systems.iter().map(|(_, system)| system.info()).collect();
        let sum = |of: fn(&SystemInfo) -> usize| all.iter().map(of).sum();
        SystemInfo {
            unknowns: sum(|info| info.unknowns),
            matrix_len: sum(|info| info.matrix_len),
            factor_len: sum(|info| info.factor_len),
            bytes: sum(|info| info.bytes),
            warnings: all.into_iter().next().map(|info| info.warnings).unwrap_or_default(),
        }
    }

    /// Changes of mutual inductance between any two sources, henries, row by row.
    ///
    /// # Errors
    /// An iteration that does not converge, or a source with a part whose system was left out.
    pub fn changes_h(&self, sources: &[&dyn Source]) -> Result<Vec<Complex>, MitError> {
        let count = sources.len();
        let mut changes = vec![Complex::new(0.0, 0.0); count * count];
        let Some((_, first)) = self.systems.first() else { return Ok(changes) };
        let reflected: Vec<Vec<Samples>> =
            sources.iter().map(|source| (0..8).map(|flips| first.sample(*source, signs(flips))).collect()).collect();
        for left_out in ALL.into_iter().filter(|odd| self.systems.iter().all(|(kept, _)| kept != odd)) {
            if let Some(s) = reflected.iter().position(|samples| part(samples, usize::from(left_out)).is_some()) {
                let (field, expected) = ("number of a source that is not even across the plane y = 0", "none");
                return Err(MitError::Value { field, value: (s + 1) as f64, expected });
            }
        }
        let parts = self
            .systems
            .par_iter()
            .map(|(odd, system)| {
                let (kept, samples): (Vec<usize>, Vec<Samples>) = (0..count)
                    .filter_map(|s| part(&reflected[s], usize::from(*odd)).map(|samples| (s, samples)))
                    .unzip();
                let fields = system.solve_samples(samples)?;
                Ok((kept, fields.changes_h().to_vec()))
            })
            .collect::<Result<Vec<_>, MitError>>()?;
        for (kept, values) in parts {
            for (m, &row) in kept.iter().enumerate() {
                for (n, &column) in kept.iter().enumerate() {
                    changes[row * count + column] += values[m * kept.len() + n] * 8.0;
                }
            }
        }
        Ok(changes)
    }
}

/// Signs of the coordinates for a set of flipped axes.
fn signs(flips: usize) -> Vector {
    [0, 1, 2].map(|axis| if flips >> axis & 1 == 1 { -1.0 } else { 1.0 })
}

/// The part of a source that is odd across the planes of these bits and even across the others, from its samples at
/// the points of all flips; `None` if it is zero.
fn part(reflected: &[Samples], odd: usize) -> Option<Samples> {
    let (mut sum, mut whole) = (0.0, 0.0);
    let at = |k: usize| {
        let (mut a, mut b) = ([0.0; 3], [0.0; 3]);
        for (flips, samples) in reflected.iter().enumerate() {
            let mirror = signs(flips);
            let parity = if (flips & odd).count_ones() % 2 == 1 { -0.125 } else { 0.125 };
            // The flux density is a pseudovector.
            let handed = if flips.count_ones() % 2 == 1 { -parity } else { parity };
            let (from_a, from_b) = samples[k];
            let image = |v: Vector| [mirror[0] * v[0], mirror[1] * v[1], mirror[2] * v[2]];
            a = add(a, scaled(image(from_a), parity));
            b = add(b, scaled(image(from_b), handed));
            whole += 0.125 * dot(from_a, from_a);
        }
        sum += dot(a, a);
        (a, b)
    };
    let samples: Samples = (0..reflected.first()?.len()).map(at).collect();
    (sum > NOTHING * whole).then_some(samples)
}
