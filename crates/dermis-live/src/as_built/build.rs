//! Manufacturing errors as parameters, and the skin that results from them.

use dermis_skin::{SkinBody, Tolerances};
use dermis_tomo::mesh::{ElectrodeShape, ElectrodedMesh, Mesh, MeshError, Outline, Point, distance};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use serde::{Deserialize, Serialize};

/// Distance between the points that carry the random conductivity, in its correlation lengths.
const FIELD_STEP: f64 = 0.9;
/// Largest number of these points; their distance grows on longer skins.
const MOST_FIELD_POINTS: usize = 64;
/// Added to the correlation matrix of these points, so that it can be inverted.
const FIELD_JITTER: f64 = 1e-4;

/// How one skin differs from its file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Build {
    /// Displacement of each electrode, metres: along the rim and 0, or along x and y for pads under the sheet.
    pub moved_m: Vec<Point>,
    /// Change of each electrode's width, relative.
    pub wider: Vec<f64>,
    /// Logarithm of the factor on each contact impedance.
    pub contact_log: Vec<f64>,
    /// Correlation length of the conductivity, metres.
    pub field_length_m: f64,
    /// Points that carry the conductivity, metres, and their weights: its logarithm, relative to the file's, is the sum
    /// of the weights times `exp(-d^2 / 2 L^2)`.
    pub field_places_m: Vec<Point>,
    /// Weights of these points.
    pub field_weights: Vec<f64>,
}

impl Build {
    /// Conductivity at a position, relative to the file's.
    pub fn conductivity(&self, place_m: Point) -> f64 {
        let weighted = self.field_places_m.iter().zip(&self.field_weights);
        weighted.map(|(at, weight)| weight * correlation(*at, place_m, self.field_length_m)).sum::<f64>().exp()
    }

    /// The mesh with its electrodes where they are: nodes near the ends of electrodes on the rim and around pads move,
    /// and elements keep their numbers.
    ///
    /// # Errors
    /// Displacements so large that elements fold over.
    pub(crate) fn moved(&self, body: &SkinBody) -> Result<ElectrodedMesh, MeshError> {
        let mut handles: Vec<Handle> = handles(&body.outline, &body.electrodes, self);
        handles.retain(Handle::moves);
        let mesh = &body.mesh.mesh;
        let nodes = mesh.nodes().iter().map(|&[x, y, z]| {
            let [dx, dy] = handles.iter().fold([0.0; 2], |sum, handle| {
                let by = handle.displacement(&body.outline, [x, y]);
                [sum[0] + by[0], sum[1] + by[1]]
            });
            [x + dx, y + dy, z]
        });
        let elements = mesh.elements().flatten().copied().collect();
        let moved = Mesh::new(mesh.kind(), nodes.collect(), elements)?;
        let mut electrodes = body.mesh.electrodes.clone();
        for (electrode, log) in electrodes.iter_mut().zip(&self.contact_log) {
            electrode.contact_impedance *= log.exp();
        }
        ElectrodedMesh::new(moved, electrodes)
    }
}

/// The prior of a skin's errors, in terms of independent standard normal numbers.
#[derive(Debug)]
pub(crate) struct BuildPrior {
    /// Numbers of displacements: one for an electrode on the rim, two for a pad.
    axes: Vec<usize>,
    place_m: f64,
    width: f64,
    contact_log: f64,
    conductivity: f64,
    field_length_m: f64,
    field_places_m: Vec<Point>,
    /// Weights of the points by independent numbers.
    field: Mat<f64>,
}

impl BuildPrior {
    /// The prior that a skin's file states.
    pub(crate) fn of(body: &SkinBody, tolerances: &Tolerances) -> Self {
        let (low, high) = body.outline.bounds_m();
        let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
        let field_length_m = shorter_m * tolerances.conductivity_length_share;
        let conductivity = 0.01 * tolerances.conductivity_percent;
        let field_places_m = field_places(&body.outline, field_length_m);
        let count = field_places_m.len();
        let correlations = Mat::from_fn(count, count, |i, j| {
            let jitter = if i == j { FIELD_JITTER } else { 0.0 };
            correlation(field_places_m[i], field_places_m[j], field_length_m) + jitter
        });
        // Values at the points are L z with L L' the correlations; weights are their inverse times the values.
        let field = match correlations.llt(Side::Lower) {
            Ok(factor) => factor.solve(factor.L()),
            Err(_) => Mat::zeros(count, count),
        };
        Self {
            axes: body.electrodes.iter().map(|shape| 1 + usize::from(shape.pad_box().is_some())).collect(),
            place_m: 1e-3 * tolerances.electrode_place_mm,
            width: 0.01 * tolerances.electrode_width_percent,
            contact_log: tolerances.contact_impedance_factor.ln(),
            conductivity,
            field_length_m,
            field_places_m,
            field,
        }
    }

    /// Number of parameters.
    pub(crate) fn len(&self) -> usize {
        self.axes.iter().sum::<usize>() + 2 * self.axes.len() + self.field_places_m.len()
    }

    /// The skin of these parameters, each a standard normal number before anything is known.
    pub(crate) fn build(&self, parameters: &[f64]) -> Build {
        let mut next = parameters.iter().copied();
        let mut take = || next.next().unwrap_or_default();
        let moved_m = self.axes.iter().map(|axes| [0, 1].map(|k| if k < *axes { self.place_m * take() } else { 0.0 }));
        let moved_m = moved_m.collect();
        let wider = self.axes.iter().map(|_| self.width * take()).collect();
        let contact_log = self.axes.iter().map(|_| self.contact_log * take()).collect();
        let field: Vec<f64> = self.field_places_m.iter().map(|_| self.conductivity * take()).collect();
        let weight = |row: usize| field.iter().enumerate().map(|(k, z)| self.field[(row, k)] * z).sum();
        Build {
            moved_m,
            wider,
            contact_log,
            field_length_m: self.field_length_m,
            field_places_m: self.field_places_m.clone(),
            field_weights: (0..field.len()).map(weight).collect(),
        }
    }
}

/// A part of the mesh that moves with an electrode.
enum Handle {
    /// An end of an electrode on the rim, by its position there, its displacement along the rim, and its reach.
    End { position_m: f64, by_m: f64, reach_m: f64 },
    /// A pad: its centre, half its extent, its displacement, its relative growth and its reach beyond the extent.
    Pad { centre_m: Point, half_m: [f64; 2], by_m: [f64; 2], wider: f64, reach_m: f64 },
}

impl Handle {
    fn moves(&self) -> bool {
        match *self {
            Self::End { by_m, .. } => by_m != 0.0,
            Self::Pad { by_m, wider, .. } => by_m != [0.0; 2] || wider != 0.0,
        }
    }

    fn displacement(&self, outline: &Outline, place_m: Point) -> [f64; 2] {
        match *self {
            Self::End { position_m, by_m, reach_m } => {
                let (along_m, inward_m) = outline.nearest_rim(place_m);
                let perimeter_m = outline.perimeter_m();
                let off_m = wrapped(along_m - position_m, perimeter_m);
                let to_corner_m = outline
                    .rim_corners_m()
                    .into_iter()
                    .map(|corner| wrapped(along_m - corner, perimeter_m).abs())
                    .fold(f64::INFINITY, f64::min);
                let weight = hat(off_m / reach_m) * hat(inward_m / reach_m) * (to_corner_m / reach_m).min(1.0);
                if weight == 0.0 {
                    return [0.0; 2];
                }
                let (from, to) = (outline.rim_at(along_m), outline.rim_at(along_m + weight * by_m));
                [to[0] - from[0], to[1] - from[1]]
            }
            Self::Pad { centre_m, half_m, by_m, wider, reach_m } => {
                let off = [place_m[0] - centre_m[0], place_m[1] - centre_m[1]];
                let beyond = [0, 1].map(|axis| (off[axis].abs() - half_m[axis]).max(0.0));
                let at_rim = (outline.inside_by_m(place_m) / reach_m).min(1.0);
                let weight = hat(beyond[0].hypot(beyond[1]) / reach_m) * at_rim;
                [0, 1].map(|axis| weight * (by_m[axis] + wider * off[axis].clamp(-half_m[axis], half_m[axis])))
            }
        }
    }
}

/// 1 at 0, falling to 0 at 1 in a straight line.
fn hat(off: f64) -> f64 {
    (1.0 - off.abs()).max(0.0)
}

fn wrapped(off_m: f64, perimeter_m: f64) -> f64 {
    let off_m = off_m.rem_euclid(perimeter_m);
    if off_m > 0.5 * perimeter_m { off_m - perimeter_m } else { off_m }
}

fn handles(outline: &Outline, shapes: &[ElectrodeShape], build: &Build) -> Vec<Handle> {
    let perimeter_m = outline.perimeter_m();
    let rims: Vec<(f64, f64)> = shapes.iter().filter_map(|shape| shape.on_rim(outline)).collect();
    let mut handles = Vec::new();
    for ((shape, by_m), wider) in shapes.iter().zip(&build.moved_m).zip(&build.wider) {
        if let Some((position_m, half_m)) = shape.on_rim(outline) {
            // Half of the way to the next electrode, or to the middle of this one.
            let gaps =
                rims.iter().map(|(other, width)| wrapped(position_m - other, perimeter_m).abs() - half_m - width);
            let gap_m = gaps.filter(|gap| *gap > 0.0).fold(f64::INFINITY, f64::min);
            if half_m == 0.0 {
                handles.push(Handle::End { position_m, by_m: by_m[0], reach_m: 0.5 * gap_m });
                continue;
            }
            let reach_m = (0.5 * gap_m).min(half_m);
            for side in [-1.0, 1.0] {
                let by_m = by_m[0] + side * half_m * wider;
                handles.push(Handle::End { position_m: position_m + side * half_m, by_m, reach_m });
            }
            continue;
        }
        let Some((centre_m, half_m)) = shape.pad_box() else { continue };
        let others = shapes.iter().filter_map(|other| Some(other.pad_box()?.0));
        let apart_m =
            others.map(|other| distance(other, centre_m)).filter(|apart| *apart > 0.0).fold(f64::INFINITY, f64::min);
        let reach_m = (0.5 * apart_m - half_m[0].max(half_m[1])).max(0.25 * apart_m).min(0.5 * apart_m);
        handles.push(Handle::Pad { centre_m, half_m, by_m: *by_m, wider: *wider, reach_m });
    }
    handles
}

fn correlation(a: [f64; 2], b: [f64; 2], length_m: f64) -> f64 {
    let square = (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2);
    (-0.5 * square / (length_m * length_m)).exp()
}

/// A lattice of points over the skin and half a step around it.
fn field_places(outline: &Outline, length_m: f64) -> Vec<Point> {
    let (low, high) = outline.bounds_m();
    let size = [high[0] - low[0], high[1] - low[1]];
    let least_m = (size[0] * size[1] / MOST_FIELD_POINTS as f64).sqrt();
    let step_m = (FIELD_STEP * length_m).max(least_m);
    let count = size.map(|size| (size / step_m).ceil().max(1.0) as usize);
    let at = |axis: usize, k: usize| low[axis] + (k as f64 + 0.5) * size[axis] / count[axis] as f64;
    (0..count[1])
        .flat_map(|row| (0..count[0]).map(move |column| (column, row)))
        .map(|(c, r)| [at(0, c), at(1, r)])
        .collect()
}
