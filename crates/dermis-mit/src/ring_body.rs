//! Bodies of revolution as coaxial current-carrying rings with a rectangular cross-section: partial elements (Ruehli,
//! IEEE Trans. Microw. Theory Tech. 22, 1974) for eddy currents around an axis.
//!
//! `(R + j w L) I = -j w F_n` with the rings' resistances `2 pi rho / (sigma S)`, the mutual inductances of their
//! sections, and the fluxes F of a source through them; `dM_mn = F_m' I_n`. Only fluxes around the axis count. The
//! result is complete if one of the two sources is symmetric about the body's axis, since fields of different order
//! do not mix; otherwise it is the part of order 0.

use std::f64::consts::{PI, TAU};

use dermis_tomo::mesh::{Point, distance};
use faer::Mat;
use faer::prelude::Solve;
use rayon::prelude::*;

use crate::edge::{CoarseMesh, Source};
use crate::error::{MitError, frequency, positive};
use crate::quadrature::gauss_legendre;
use crate::ring::Ring;
use crate::sphere::skin_depth_m;
use crate::vector::{Complex, Vector};

/// Cross-section of a ring in the half plane of distance from the axis and height: a parallelogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// Centre: distance from the axis and height, metres.
    pub centre_m: Point,
    /// Vector from the centre to the middle of one side, metres.
    pub across_m: [f64; 2],
    /// Vector from the centre to the middle of an adjacent side, metres.
    pub along_m: [f64; 2],
}

impl Section {
    fn area(&self) -> f64 {
        4.0 * (self.across_m[0] * self.along_m[1] - self.across_m[1] * self.along_m[0]).abs()
    }

    /// Full lengths in the two directions.
    fn sides(&self) -> [f64; 2] {
        [self.across_m, self.along_m].map(|half| 2.0 * half[0].hypot(half[1]))
    }

    /// Gauss-Legendre points, with weights that sum to 1.
    fn points(&self, counts: [usize; 2]) -> Vec<([f64; 2], f64)> {
        let [rule_u, rule_v] = counts.map(gauss_legendre);
        let at = |u: f64, v: f64| [0, 1].map(|k| self.centre_m[k] + u * self.across_m[k] + v * self.along_m[k]);
        let rows = rule_u.iter().flat_map(|&(u, w)| rule_v.iter().map(move |&(v, x)| (at(u, v), 0.25 * w * x)));
        rows.collect()
    }

    /// Mean mutual inductance with another section's rings, henries.
    fn mutual_h(&self, other: &Self) -> f64 {
        let apart = distance(self.centre_m, other.centre_m).max(f64::MIN_POSITIVE);
        // Enough points that their spacing is smaller than the distance of the sections; one more in the second, so
        // that none coincide.
        let count = |side: f64, more: usize| ((2.0 * side / apart).ceil() as usize).clamp(1, 8) + more;
        let mine = self.points(self.sides().map(|side| count(side, 0)));
        let theirs = other.points(other.sides().map(|side| count(side, 1)));
        let ring = |[rho, z]: [f64; 2]| Ring::flat([0.0, 0.0, z], rho);
        let to = |p: Point| theirs.iter().map(|(q, w)| w * ring(p).mutual_h(&ring(*q))).sum::<f64>();
        mine.iter().map(|(p, w)| w * to(*p)).sum()
    }

    /// Self inductance from the geometric mean distance of a rectangle from itself, `0.2235 (a + b)` (Grover,
    /// Inductance Calculations, 1946, ch. 3).
    fn self_h(&self) -> f64 {
        let [a, b] = self.sides();
        Ring::flat([0.0; 3], self.centre_m[0]).self_inductance_h(0.2235 * (a + b))
    }

    /// Mean flux of a source through the rings, Wb (per ampere for coils).
    fn flux(&self, source: &dyn Source) -> f64 {
        self.points([2, 2]).iter().map(|([rho, z], w)| w * TAU * rho * mean_potential(source, *rho, *z)).sum()
    }
}

/// Mean over a circle of the potential around the axis, by the trapezoidal rule, which converges geometrically. The
/// points are doubled until the result no longer changes.
fn mean_potential(source: &dyn Source, rho: f64, z: f64) -> f64 {
    let at = |angle: f64| {
        let (sine, cosine) = angle.sin_cos();
        let a: Vector = source.vector_potential([rho * cosine, rho * sine, z]);
        (a[1] * cosine - a[0] * sine, (a[0] * a[0] + a[1] * a[1]).sqrt())
    };
    let sums = |points: usize, shift: f64| {
        (0..points)
            .map(|k| at(TAU * (k as f64 + shift) / points as f64))
            .fold((0.0, 0.0), |s, v| (s.0 + v.0, s.1 + v.1))
    };
    let (mut points, (mut sum, mut size)) = (4, sums(4, 0.0));
    loop {
        let (more, more_size) = sums(points, 0.5);
        let before = sum / points as f64;
        (sum, size, points) = (sum + more, size + more_size, 2 * points);
        if (sum / points as f64 - before).abs() <= 1e-10 * size / points as f64 || points >= 1024 {
            return sum / points as f64;
        }
    }
}

/// A body of revolution around the z axis, cut into rings.
#[derive(Clone, Debug)]
pub struct RingBody {
    sections: Vec<Section>,
    conductivity_s_per_m: f64,
    /// Thickness of the thickest surface ring, metres, if known.
    surface_m: f64,
    inductance: Mat<f64>,
}

/// Maximum thickness of surface rings, in skin depths.
const MOST_DEPTHS: f64 = 0.7;

impl RingBody {
    /// Builds a body from sections with uniform currents. `surface_m` is the thickness of the rings at the surface,
    /// used by [`RingBody::warnings`]. Needs `8 rings^2` bytes, and a solution needs three times as much again.
    ///
    /// # Errors
    /// No sections, a section without area or not entirely on one side of the axis, or a conductivity that is not
    /// positive.
    pub fn new(sections: Vec<Section>, surface_m: f64, conductivity_s_per_m: f64) -> Result<Self, MitError> {
        positive("conductivity_s_per_m", conductivity_s_per_m)?;
        positive("surface_m", surface_m)?;
        positive("rings", sections.len() as f64)?;
        for section in &sections {
            positive("area of a ring's section (m^2)", section.area())?;
            let inner = section.centre_m[0] - section.across_m[0].abs() - section.along_m[0].abs();
            if inner < -1e-9 * section.centre_m[0].abs() || inner.is_nan() {
                let expected = "0 or more";
                return Err(MitError::Value {
                    field: "least distance of a ring from the axis (m)",
                    value: inner,
                    expected,
                });
            }
        }
        let count = sections.len();
        let row = |i: usize| -> Vec<f64> {
            let of = |j: usize| if i == j { sections[i].self_h() } else { sections[i].mutual_h(&sections[j]) };
            (0..=i).map(of).collect()
        };
        let rows: Vec<Vec<f64>> = (0..count).into_par_iter().map(row).collect();
        let inductance = Mat::from_fn(count, count, |i, j| rows[i.max(j)][i.min(j)]);
        Ok(Self { sections, conductivity_s_per_m, surface_m, inductance })
    }

    /// A cylinder centred on the origin, with the given numbers of rings from axis to rim and from end to end.
    /// Surface rings are a quarter of a skin depth thick at the given frequency, the others grow inward. 8 x 16 rings
    /// have an error of 0.1 to 0.3 %.
    ///
    /// # Errors
    /// Sizes or a conductivity that are not positive, no rings, or a frequency outside 1 Hz to 1 MHz.
    pub fn cylinder(
        radius_m: f64,
        height_m: f64,
        conductivity_s_per_m: f64,
        frequency_hz: f64,
        [radial, axial]: [usize; 2],
    ) -> Result<Self, MitError> {
        positive("radius_m", radius_m)?;
        positive("height_m", height_m)?;
        positive("rings from axis to rim", radial as f64)?;
        positive("rings from end to end", axial as f64)?;
        let first_m = 0.25 * skin_depth_m(conductivity_s_per_m, 1.0, frequency_hz)?;
        let radii: Vec<f64> = layers(radius_m, radial, first_m).iter().rev().map(|depth| radius_m - depth).collect();
        // From both ends to the middle; an odd number has one ring across the middle.
        let half = layers(0.5 * height_m * axial as f64 / (axial + axial % 2) as f64, axial.div_ceil(2), first_m);
        let stretch = 0.5 * height_m / half[half.len() - 1];
        let mut levels: Vec<f64> = half.iter().map(|depth| depth * stretch - 0.5 * height_m).collect();
        if axial % 2 == 1 {
            levels.pop();
        }
        let upper: Vec<f64> = levels.iter().rev().filter(|z| **z < 0.0).map(|z| -z).collect();
        levels.extend(upper);
        let mut sections = Vec::with_capacity(radial * axial);
        for r in radii.windows(2) {
            for z in levels.windows(2) {
                sections.push(Section {
                    centre_m: [0.5 * (r[0] + r[1]), 0.5 * (z[0] + z[1])],
                    across_m: [0.5 * (r[1] - r[0]), 0.0],
                    along_m: [0.0, 0.5 * (z[1] - z[0])],
                });
            }
        }
        let last = |edges: &[f64]| edges[edges.len() - 1] - edges[edges.len() - 2];
        let surface_m = last(&radii).max(last(&levels));
        Self::new(sections, surface_m, conductivity_s_per_m)
    }

    /// Number of rings.
    pub fn ring_count(&self) -> usize {
        self.sections.len()
    }

    /// Warnings about surface rings too thick for the skin depth.
    ///
    /// # Errors
    /// A frequency outside 1 Hz to 1 MHz.
    pub fn warnings(&self, frequency_hz: f64) -> Result<Vec<CoarseMesh>, MitError> {
        let skin_depth_m = skin_depth_m(self.conductivity_s_per_m, 1.0, frequency_hz)?;
        if self.surface_m <= MOST_DEPTHS * skin_depth_m {
            return Ok(Vec::new());
        }
        Ok(vec![CoarseMesh { region: 1, height_m: self.surface_m, skin_depth_m, most: MOST_DEPTHS }])
    }

    /// Changes of mutual inductance between any two sources, henries, row by row. Valid if one of the two is
    /// symmetric about the z axis. Imposing [`crate::edge::Harmonic`] 0, 3 and 8 gives the entries of tau of order 0;
    /// the first divided by mu0 is the polarizability along the axis, m^3.
    ///
    /// # Errors
    /// A frequency outside 1 Hz to 1 MHz.
    pub fn changes_h(&self, sources: &[&dyn Source], frequency_hz: f64) -> Result<Vec<Complex>, MitError> {
        frequency(frequency_hz)?;
        let (count, w) = (self.sections.len(), TAU * frequency_hz);
        let fluxes: Vec<Vec<f64>> = sources
            .iter()
            .map(|source| self.sections.par_iter().map(|section| section.flux(*source)).collect())
            .collect();
        let impedance = Mat::from_fn(count, count, |i, j| {
            let section = &self.sections[i];
            let resistance = 2.0 * PI * section.centre_m[0] / (self.conductivity_s_per_m * section.area());
            Complex::new(if i == j { resistance } else { 0.0 }, w * self.inductance[(i, j)])
        });
        let sides = Mat::from_fn(count, sources.len(), |i, n| Complex::new(0.0, -w * fluxes[n][i]));
        // Complex symmetric, not Hermitian: only a factorisation for general matrices is correct.
        let currents = impedance.partial_piv_lu().solve(&sides);
        let change = |m: usize, n: usize| (0..count).map(|i| currents[(i, n)] * fluxes[m][i]).sum::<Complex>();
        Ok((0..sources.len() * sources.len()).map(|k| change(k / sources.len(), k % sources.len())).collect())
    }
}

/// Distances from a surface, from 0 to the thickness, of `count` layers. The first has the requested thickness, or
/// less if equal layers are thinner; each later one is thicker by the same factor.
fn layers(thickness_m: f64, count: usize, first_m: f64) -> Vec<f64> {
    let (first, n) = (first_m.min(thickness_m / count as f64), count as i32);
    let total = |ratio: f64| first * (0..n).map(|k| ratio.powi(k)).sum::<f64>();
    let (mut low, mut high) = (1.0, 2.0);
    while total(high) < thickness_m {
        high *= 2.0;
        if count == 1 {
            break;
        }
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if total(middle) < thickness_m { low = middle } else { high = middle }
    }
    let scale = thickness_m / total(low);
    let mut depths = vec![0.0];
    (0..n).for_each(|k| depths.push(depths[k as usize] + scale * first * low.powi(k)));
    depths
}
