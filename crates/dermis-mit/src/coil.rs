//! Coils as sets of filaments: circular and square spirals as concentric loops, solenoids in layers, annular sheets.
//! Includes calibration to a measured inductance, and images in a shield.

use crate::error::{MitError, positive};
use crate::harmonics::{HARMONICS, expansion};
use crate::ring::Ring;
use crate::segment::Segment;
use crate::vector::{Vector, add, dot, norm, scaled, subtract};

/// Radius of the sphere for field expansions, relative to the distance of the nearest wire.
const PROBE: f64 = 0.02;
/// Distance up to which two pieces of wire coincide, metres.
const SAME_M: f64 = 1e-12;

/// One piece of a winding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Filament {
    /// A loop.
    Ring(Ring),
    /// A straight piece of a closed polygon.
    Segment(Segment),
}

impl Filament {
    fn vector_potential(&self, point_m: Vector) -> Vector {
        match self {
            Self::Ring(ring) => ring.vector_potential(point_m),
            Self::Segment(segment) => segment.vector_potential(point_m),
        }
    }

    fn flux_density(&self, point_m: Vector) -> Vector {
        match self {
            Self::Ring(ring) => ring.flux_density(point_m),
            Self::Segment(segment) => segment.flux_density(point_m),
        }
    }

    fn distance_m(&self, point_m: Vector) -> f64 {
        match self {
            Self::Ring(ring) => ring.distance_m(point_m),
            Self::Segment(segment) => segment.distance_m(point_m),
        }
    }

    /// The mirror image in a plane of constant z.
    fn mirrored(&self, z_m: f64) -> Self {
        let across = |p: Vector| [p[0], p[1], 2.0 * z_m - p[2]];
        match *self {
            Self::Ring(ring) => Self::Ring(Ring {
                // An axis is a pseudovector: the mirrored loop turns the same way about the mirrored normal,
                // reversed.
                centre_m: across(ring.centre_m),
                axis: [-ring.axis[0], -ring.axis[1], ring.axis[2]],
                ..ring
            }),
            Self::Segment(s) => Self::Segment(Segment { from_m: across(s.from_m), to_m: across(s.to_m) }),
        }
    }

    fn moved(&self, by_m: Vector) -> Self {
        match *self {
            Self::Ring(ring) => Self::Ring(Ring { centre_m: add(ring.centre_m, by_m), ..ring }),
            Self::Segment(s) => Self::Segment(Segment { from_m: add(s.from_m, by_m), to_m: add(s.to_m, by_m) }),
        }
    }

    /// True if two pieces are identical up to rounding.
    fn is_same(&self, other: &Self) -> bool {
        let near = |p: Vector, q: Vector| norm(subtract(p, q)) < SAME_M;
        match (self, other) {
            (Self::Ring(a), Self::Ring(b)) => {
                near(a.centre_m, b.centre_m) && a.axis == b.axis && (a.radius_m - b.radius_m).abs() < SAME_M
            }
            (Self::Segment(a), Self::Segment(b)) => near(a.from_m, b.from_m) && near(a.to_m, b.to_m),
            _ => false,
        }
    }

    fn mutual_h(&self, other: &Self, least_m: f64) -> f64 {
        match (self, other) {
            (Self::Ring(a), Self::Ring(b)) if a == b => a.self_inductance_h(least_m),
            (Self::Ring(a), Self::Ring(b)) => a.mutual_h(b),
            (Self::Segment(a), Self::Segment(b)) => a.mutual_h(b, least_m),
            // Integrates the loop's potential along the segment, in steps.
            (Self::Ring(ring), Self::Segment(segment)) | (Self::Segment(segment), Self::Ring(ring)) => {
                const STEPS: usize = 64;
                let along = subtract(segment.to_m, segment.from_m);
                let at = |k: usize| add(segment.from_m, scaled(along, (k as f64 + 0.5) / STEPS as f64));
                (0..STEPS).map(|k| dot(ring.vector_potential(at(k)), along) / STEPS as f64).sum()
            }
        }
    }
}

/// Outline of a coil's turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CoilShape {
    /// Circles around the coil's centre.
    Round,
    /// Squares around the coil's centre, with sides along x and y.
    Square,
}

/// A winding.
#[derive(Clone, Debug, PartialEq)]
pub struct Coil {
    /// Centre, metres.
    pub centre_m: Vector,
    /// Distance from the centre to the outermost wire along x or y, metres.
    pub half_width_m: f64,
    /// Distance from the centre to the highest wire along z, metres.
    pub half_height_m: f64,
    shape: CoilShape,
    /// Wires with 1 A each.
    filaments: Vec<Filament>,
    /// Image wires in a shield, with -1 A each.
    images: Vec<Filament>,
    /// Factor on fields and fluxes: number of turns per filament.
    scale: f64,
    /// Geometric mean distance of the wire from itself, metres.
    mean_distance_m: f64,
}

/// Geometric mean distance of a round wire from itself, relative to its diameter: `e^(-1/4) / 2`.
pub(crate) const ROUND: f64 = 0.389_400_391_535_702_4;
/// Wire diameter of a spiral with unknown wire, relative to the distance between turns.
pub(crate) const WIRE_SHARE: f64 = 0.8;

/// A cross-section filled with filaments: side by side from the inner width outward, in stacked layers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct WindingSection {
    pub(crate) shape: CoilShape,
    /// Inner width, metres.
    pub(crate) inner_m: f64,
    /// Half the outer width, metres.
    pub(crate) half_width_m: f64,
    /// Number of filaments side by side, and their distance in metres.
    pub(crate) across: (usize, f64),
    /// Number of layers, and their distance in metres.
    pub(crate) layers: (usize, f64),
    /// Number of turns per filament.
    pub(crate) turns_each: f64,
    /// Height of the conductor, metres.
    pub(crate) conductor_height_m: f64,
    /// Geometric mean distance of the conductor from itself, metres.
    pub(crate) mean_distance_m: f64,
}

impl Coil {
    /// A flat circular spiral, modelled as concentric rings in the middle of each turn's share of the width; round
    /// wire that fills 80 % of the pitch.
    ///
    /// # Errors
    /// Diameters that are not positive or not in order, or no turns.
    pub fn circular_spiral(
        centre_m: Vector,
        inner_diameter_m: f64,
        outer_diameter_m: f64,
        turns: usize,
    ) -> Result<Self, MitError> {
        let pitch = pitch("circular spiral", inner_diameter_m, outer_diameter_m, turns)?;
        Ok(Self::spiral(centre_m, CoilShape::Round, [inner_diameter_m, outer_diameter_m], (turns, pitch)))
    }

    /// A flat square spiral, modelled as concentric squares with sides along x and y.
    ///
    /// # Errors
    /// As [`Coil::circular_spiral`], with widths.
    pub fn square_spiral(
        centre_m: Vector,
        inner_width_m: f64,
        outer_width_m: f64,
        turns: usize,
    ) -> Result<Self, MitError> {
        let pitch = pitch("square spiral", inner_width_m, outer_width_m, turns)?;
        Ok(Self::spiral(centre_m, CoilShape::Square, [inner_width_m, outer_width_m], (turns, pitch)))
    }

    fn spiral(centre_m: Vector, shape: CoilShape, [inner_m, outer_m]: [f64; 2], across: (usize, f64)) -> Self {
        let section = WindingSection {
            shape,
            inner_m,
            half_width_m: 0.5 * outer_m,
            across,
            layers: (1, 0.0),
            turns_each: 1.0,
            conductor_height_m: WIRE_SHARE * across.1,
            mean_distance_m: WIRE_SHARE * ROUND * across.1,
        };
        Self::filled(centre_m, &section)
    }

    /// A coil wound in layers with equal numbers of turns: layers from the inner diameter outward, turns along the
    /// length below and above the centre.
    ///
    /// # Errors
    /// Sizes that are not positive, no turns, or no layers.
    pub fn solenoid(
        centre_m: Vector,
        inner_diameter_m: f64,
        wire_diameter_m: f64,
        layers: usize,
        turns_per_layer: usize,
    ) -> Result<Self, MitError> {
        positive("inner_diameter_m", inner_diameter_m)?;
        positive("wire_diameter_m", wire_diameter_m)?;
        positive("layers", layers as f64)?;
        positive("turns_per_layer", turns_per_layer as f64)?;
        let section = WindingSection {
            shape: CoilShape::Round,
            inner_m: inner_diameter_m,
            half_width_m: 0.5 * inner_diameter_m + wire_diameter_m * layers as f64,
            across: (layers, wire_diameter_m),
            layers: (turns_per_layer, wire_diameter_m),
            turns_each: 1.0,
            conductor_height_m: wire_diameter_m,
            mean_distance_m: ROUND * wire_diameter_m,
        };
        Ok(Self::filled(centre_m, &section))
    }

    pub(crate) fn filled(centre_m: Vector, section: &WindingSection) -> Self {
        let (across, pitch_m) = section.across;
        let (layers, layer_pitch_m) = section.layers;
        let mut filaments = Vec::new();
        for k in 0..across {
            let half = 0.5 * section.inner_m + (k as f64 + 0.5) * pitch_m;
            for layer in 0..layers {
                let z = layer_pitch_m * (layer as f64 + 0.5 - 0.5 * layers as f64);
                turn(section.shape, add(centre_m, [0.0, 0.0, z]), half, &mut filaments);
            }
        }
        Self {
            centre_m,
            half_width_m: section.half_width_m,
            half_height_m: 0.5 * ((layers - 1) as f64 * layer_pitch_m + section.conductor_height_m),
            shape: section.shape,
            filaments,
            images: Vec::new(),
            scale: section.turns_each,
            mean_distance_m: section.mean_distance_m,
        }
    }

    /// The same coil with another geometric mean distance of its wire, which only affects the self inductance.
    pub fn with_mean_distance(mut self, mean_distance_m: f64) -> Self {
        self.mean_distance_m = mean_distance_m;
        self
    }

    /// The same coil above a perfectly conducting plane at height `z_m`: mirror images with reversed current.
    pub fn with_shield(mut self, z_m: f64) -> Self {
        self.images = self.filaments.iter().map(|filament| filament.mirrored(z_m)).collect();
        self
    }

    /// The same coil, displaced.
    pub fn moved(mut self, by_m: Vector) -> Self {
        self.centre_m = add(self.centre_m, by_m);
        self.filaments.iter_mut().for_each(|filament| *filament = filament.moved(by_m));
        self.images.iter_mut().for_each(|filament| *filament = filament.moved(by_m));
        self
    }

    /// Scales fields and fluxes to match a measured self inductance: real windings have slightly more turns than
    /// their model. Returns the coil and the factor on the turns.
    ///
    /// # Errors
    /// An inductance that is not positive.
    pub fn calibrated_to(mut self, measured_h: f64) -> Result<(Self, f64), MitError> {
        positive("measured inductance (H)", measured_h)?;
        let factor = (measured_h / self.self_inductance_h()).sqrt();
        self.scale *= factor;
        Ok((self, factor))
    }

    /// The wire.
    pub fn filaments(&self) -> &[Filament] {
        &self.filaments
    }

    /// Image wires in a shield, with reversed current.
    pub fn images(&self) -> &[Filament] {
        &self.images
    }

    /// Outline of its turns.
    pub fn shape(&self) -> CoilShape {
        self.shape
    }

    /// Number of turns per filament: 1, or more if turns are lumped, times the ratio of effective to nominal turns.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// True if all wire, including images, consists of rings around one axis along z.
    pub fn is_axisymmetric(&self) -> bool {
        self.filaments.iter().chain(&self.images).all(|filament| match filament {
            Filament::Ring(ring) => {
                ring.axis[0].abs() + ring.axis[1].abs() < 1e-12
                    && (ring.centre_m[0] - self.centre_m[0]).hypot(ring.centre_m[1] - self.centre_m[1]) < 1e-12
            }
            Filament::Segment(_) => false,
        })
    }

    /// True if all wire consists of squares around one axis along z, with sides along x and y.
    pub(crate) fn is_of_squares(&self) -> bool {
        let is_corner = |p: Vector| {
            let [x, y, _] = subtract(p, self.centre_m);
            (x.abs() - y.abs()).abs() < SAME_M
        };
        // The segments are in groups of four, one square after another.
        let is_square = |sides: &[Filament]| {
            let corner = |side: &Filament| match side {
                Filament::Segment(segment) => Some((segment.from_m, segment.to_m)),
                Filament::Ring(_) => None,
            };
            let corners: Vec<(Vector, Vector)> = sides.iter().filter_map(corner).collect();
            corners.len() == 4
                && (0..4).all(|k| {
                    let (from, to) = corners[k];
                    is_corner(from) && from == corners[(k + 3) % 4].1 && norm(subtract(from, to)) > SAME_M
                })
        };
        let are_squares = |wire: &[Filament]| wire.len().is_multiple_of(4) && wire.chunks_exact(4).all(is_square);
        are_squares(&self.filaments) && are_squares(&self.images)
    }

    fn sum(&self, of: impl Fn(&Filament) -> Vector) -> Vector {
        let wire = self.filaments.iter().fold([0.0; 3], |sum, filament| add(sum, of(filament)));
        let all = self.images.iter().fold(wire, |sum, filament| add(sum, scaled(of(filament), -1.0)));
        scaled(all, self.scale)
    }

    /// Vector potential per ampere, V.s/(m.A).
    pub fn vector_potential(&self, point_m: Vector) -> Vector {
        self.sum(|filament| filament.vector_potential(point_m))
    }

    /// Flux density per ampere, T/A.
    pub fn flux_density(&self, point_m: Vector) -> Vector {
        self.sum(|filament| filament.flux_density(point_m))
    }

    /// Minimum distance of the wire from a point, metres.
    pub fn distance_m(&self, point_m: Vector) -> f64 {
        self.filaments.iter().map(|filament| filament.distance_m(point_m)).fold(f64::INFINITY, f64::min)
    }

    /// Expansion of the coil's field around a point off the wire, per ampere: see [`crate::expansion`].
    pub fn expansion(&self, centre_m: Vector) -> [f64; HARMONICS] {
        expansion(centre_m, PROBE * self.distance_m(centre_m), |p| self.flux_density(p))
    }

    /// Mutual inductance, henries: the flux of the other coil and its images through this coil's wire.
    pub fn mutual_h(&self, other: &Coil) -> f64 {
        let pairs = |sources: &[Filament]| -> f64 {
            let least = self.mean_distance_m;
            self.filaments.iter().map(|a| sources.iter().map(|b| a.mutual_h(b, least)).sum::<f64>()).sum()
        };
        let images = if other.images.is_empty() { 0.0 } else { pairs(&other.images) };
        self.scale * other.scale * (pairs(&other.filaments) - images)
    }

    /// True if this coil is a displaced copy of the other, including images.
    pub(crate) fn is_moved(&self, other: &Coil) -> bool {
        let by = subtract(self.centre_m, other.centre_m);
        let same = |a: &[Filament], b: &[Filament]| {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.is_same(&b.moved(by)))
        };
        self.scale == other.scale
            && self.mean_distance_m == other.mean_distance_m
            && same(&self.filaments, &other.filaments)
            && same(&self.images, &other.images)
    }

    /// Self inductance, henries.
    pub fn self_inductance_h(&self) -> f64 {
        self.mutual_h(self)
    }
}

/// One turn with this half width around a point.
fn turn(shape: CoilShape, centre_m: Vector, half: f64, filaments: &mut Vec<Filament>) {
    match shape {
        CoilShape::Round => filaments.push(Filament::Ring(Ring::flat(centre_m, half))),
        CoilShape::Square => {
            let corner = |x: f64, y: f64| add(centre_m, [x * half, y * half, 0.0]);
            let corners = [corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0), corner(-1.0, -1.0)];
            filaments.extend(
                (0..4).map(|side| Filament::Segment(Segment { from_m: corners[side], to_m: corners[(side + 1) % 4] })),
            );
        }
    }
}

fn pitch(field: &'static str, inner: f64, outer: f64, turns: usize) -> Result<f64, MitError> {
    positive(field, inner)?;
    positive(field, outer)?;
    positive("turns", turns as f64)?;
    if outer <= inner {
        return Err(MitError::Value { field, value: outer, expected: "an outer size above the inner one" });
    }
    Ok(0.5 * (outer - inner) / turns as f64)
}
