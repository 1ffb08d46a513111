//! Meshes around a body: planar triangles in layers, split into tetrahedra, fine towards the body's surface and
//! coarse towards the outer boundary. Parabolic edges follow round bodies.

use std::f64::consts::TAU;

use super::mesh::{EdgeMesh, chord};
use crate::error::{MitError, positive};
use crate::vector::{Vector, add, norm, scaled, subtract};

/// Grading of a mesh away from a body's surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grading {
    /// Thickness of the first layer inside, metres; at most a skin depth.
    pub first_m: f64,
    /// Growth factor of successive layers inside.
    pub growth: f64,
    /// Maximum layer thickness inside, metres.
    pub most_m: f64,
    /// Maximum layer thickness along the faces of a flat body, metres.
    pub wide_m: f64,
    /// Growth factor of successive layers in air.
    pub air_growth: f64,
    /// Distance of the outer boundary from the centre, metres; several times the size of the body.
    pub air_m: f64,
    /// Number of elements around a round body, a multiple of 8.
    pub around: usize,
}

impl Grading {
    /// Layers of 0.7 skin depths that grow inward, at most half as thick as the body's smallest half width. Air
    /// extends to 10 times the largest half width, where the response is a thousandth of its value at the body.
    pub fn for_body(skin_depth_m: f64, least_half_width_m: f64, greatest_half_width_m: f64) -> Self {
        Self {
            first_m: (0.7 * skin_depth_m).min(0.35 * least_half_width_m),
            growth: 1.8,
            most_m: 0.5 * least_half_width_m,
            wide_m: greatest_half_width_m / 3.0,
            air_growth: 2.0,
            air_m: 10.0 * greatest_half_width_m,
            around: 16,
        }
    }

    fn check(&self, reach_m: f64) -> Result<(), MitError> {
        positive("first_m", self.first_m)?;
        positive("most_m", self.most_m)?;
        positive("wide_m", self.wide_m)?;
        let at_least = |field: &'static str, value: f64, least: f64, expected: &'static str| {
            if value >= least && value.is_finite() {
                return Ok(());
            }
            Err(MitError::Value { field, value, expected })
        };
        at_least("growth", self.growth, 1.0, "1 or more")?;
        at_least("air_growth", self.air_growth, 1.0, "1 or more")?;
        at_least("air_m", self.air_m, 2.0 * reach_m, "at least twice the greatest half width of the body")?;
        if self.around < 8 || !self.around.is_multiple_of(8) {
            let expected = "a multiple of 8";
            return Err(MitError::Value { field: "around", value: self.around as f64, expected });
        }
        Ok(())
    }

    /// Layers from a surface inward through a thickness, as distances from the surface; the last is the thickness.
    fn inward(&self, thickness_m: f64) -> Vec<f64> {
        let mut sizes = vec![self.first_m.min(thickness_m)];
        let mut total = sizes[0];
        while total < thickness_m * (1.0 - 1e-9) {
            let next = (sizes[sizes.len() - 1] * self.growth).min(self.most_m);
            sizes.push(next);
            total += next;
        }
        // The error is distributed over all layers but the first, which keeps its thickness.
        let stretch = if sizes.len() > 1 { (thickness_m - sizes[0]) / (total - sizes[0]) } else { 1.0 };
        let mut at = 0.0;
        let mut distances: Vec<f64> = Vec::new();
        for (k, size) in sizes.iter().enumerate() {
            at += if k == 0 { *size } else { size * stretch };
            distances.push(at);
        }
        distances
    }

    /// Layers in air from a surface at `from_m` to the outer boundary, as positions; the first has the given
    /// thickness.
    fn outward(&self, from_m: f64, first_m: f64) -> Vec<f64> {
        let (mut at, mut size) = (from_m, first_m);
        let mut positions = Vec::new();
        while at + size * 1.5 < self.air_m {
            at += size;
            positions.push(at);
            size *= self.air_growth;
        }
        positions.push(self.air_m);
        positions
    }

    /// Upper estimate of the number of layers from [`Grading::inward`], without generating them.
    fn inward_count(&self, thickness_m: f64) -> f64 {
        let growing = if self.growth > 1.0 {
            ((self.most_m / self.first_m).max(1.0).ln() / self.growth.ln()).ceil()
        } else {
            0.0
        };
        let thinnest = if self.growth > 1.0 { self.most_m } else { self.first_m.min(self.most_m) };
        growing + (thickness_m / thinnest).ceil() + 2.0
    }

    /// The same for [`Grading::outward`].
    fn outward_count(&self, from_m: f64, first_m: f64) -> f64 {
        if self.air_growth > 1.0 {
            ((1.0 + (self.air_m - from_m) * (self.air_growth - 1.0) / first_m).max(1.0).ln() / self.air_growth.ln())
                .ceil()
                + 1.0
        } else {
            ((self.air_m - from_m) / first_m).ceil() + 1.0
        }
    }

    /// The same for [`Grading::symmetric`].
    fn symmetric_count(&self, half_m: f64, air_first_m: f64) -> f64 {
        let first_m = (self.air_growth.sqrt() * self.first_m.max(0.1 * half_m)).max(air_first_m);
        2.0 * (self.inward_count(half_m) + self.outward_count(half_m, first_m))
    }

    /// This grading along the radius of a cylinder: the rim of a thin disc needs no rings thinner than the disc
    /// itself.
    fn of_radius(&self, radius_m: f64, height_m: f64) -> Self {
        if radius_m > 1.5 * height_m {
            Self { first_m: self.first_m.max(0.8 * height_m), most_m: self.wide_m, ..*self }
        } else {
            *self
        }
    }

    /// This grading along a side of a plate: the edges of a thin plate need no layers thinner than the plate itself.
    fn of_side(&self, side_m: f64, thinnest_m: f64) -> Self {
        if side_m > 3.0 * thinnest_m {
            Self { first_m: self.first_m.max(0.8 * thinnest_m), most_m: self.wide_m, ..*self }
        } else {
            *self
        }
    }

    /// Upper estimate of the number of tetrahedra in a mesh around a cylinder, without generating it.
    pub fn cylinder_count(&self, radius_m: f64, height_m: f64) -> f64 {
        let side = TAU * radius_m / self.around as f64;
        let rings = self.of_radius(radius_m, height_m).inward_count(radius_m)
            + self.outward_count(radius_m, 0.8 * side.min(0.5 * radius_m));
        3.0 * 2.0 * self.around as f64 * rings * self.symmetric_count(0.5 * height_m, 0.0)
    }

    /// Upper estimate of the number of tetrahedra in a mesh around a plate, without generating it.
    pub fn plate_count(&self, size_m: [f64; 3]) -> f64 {
        let longest = size_m.iter().copied().fold(0.0, f64::max);
        let thinnest = size_m.iter().copied().fold(f64::INFINITY, f64::min);
        let along = |size: f64| self.of_side(size, thinnest).symmetric_count(0.5 * size, 0.06 * longest);
        6.0 * size_m.map(along).iter().product::<f64>()
    }

    /// Upper estimate of the number of tetrahedra in a mesh around a sphere, without generating it.
    pub fn sphere_count(&self, radius_m: f64) -> f64 {
        let triangles = if self.around > 14 { 320.0 } else { 80.0 };
        3.0 * triangles * (self.inward_count(radius_m) + self.outward_count(radius_m, 0.3 * radius_m))
    }

    /// Positions along an axis from minus to plus the outer boundary, for a body between plus and minus a half width;
    /// the first layer of air has at least the given thickness.
    fn symmetric(&self, half_m: f64, air_first_m: f64) -> Vec<f64> {
        let inside = self.inward(half_m);
        let mut positive: Vec<f64> = inside.iter().rev().skip(1).map(|d| half_m - d).collect();
        positive.push(half_m);
        positive.extend(self.outward(half_m, (self.air_growth.sqrt() * inside[0].max(0.1 * half_m)).max(air_first_m)));
        let mut all: Vec<f64> = positive.iter().rev().map(|x| -x).collect();
        all.push(0.0);
        all.extend(positive);
        all
    }
}

/// Memory per tetrahedron for the mesh and its second-order system, without the factor, bytes.
pub const TETRAHEDRON_BYTES: f64 = 2500.0;

/// Refuses a mesh that would need more memory than allowed, before generating it.
fn fits(body: &'static str, tetrahedra: f64) -> Result<(), MitError> {
    let what = || {
        format!("a mesh of {tetrahedra:.2e} tetrahedra around {body}, whose thinnest side is far below its longest,")
    };
    Ok(dermis_tomo::memory::check(TETRAHEDRON_BYTES * tetrahedra, what)?)
}

/// Triangles to repeat in layers.
struct Sheet {
    points: usize,
    triangles: Vec<[u32; 3]>,
}

/// Prisms between layers of the same triangles, each split into three tetrahedra. The diagonal of every side leaves
/// the lower layer at its lower-numbered point, so neighbours agree.
fn prisms(sheet: &Sheet, layers: usize, region: impl Fn(usize, usize) -> u8) -> (Vec<[u32; 4]>, Vec<u8>) {
    let (mut tetrahedra, mut regions) = (Vec::new(), Vec::new());
    for layer in 0..layers {
        for (t, triangle) in sheet.triangles.iter().enumerate() {
            let mut corners = *triangle;
            corners.sort_unstable();
            let low = corners.map(|v| v + (layer * sheet.points) as u32);
            let high = low.map(|v| v + sheet.points as u32);
            let [a, b, c] = low;
            tetrahedra.extend([[a, b, c, high[2]], [a, b, high[1], high[2]], [a, high[0], high[1], high[2]]]);
            regions.extend([region(layer, t); 3]);
        }
    }
    (tetrahedra, regions)
}

/// Triangulates a disc with rings around its centre; returns the ring of each triangle. Rings outside the body halve
/// their number of points once their circumference permits.
fn disc(radii: &[f64], counts: &[usize]) -> (Vec<[f64; 2]>, Sheet, Vec<usize>) {
    let mut points = vec![[0.0, 0.0]];
    let (mut triangles, mut ring_of) = (Vec::new(), Vec::new());
    let mut start = 1_u32;
    for (ring, (&radius, &count)) in radii.iter().zip(counts).enumerate() {
        for k in 0..count {
            let (sine, cosine) = (TAU * k as f64 / count as f64).sin_cos();
            points.push([radius * cosine, radius * sine]);
        }
        let outer = |k: usize| start + (k % count) as u32;
        if ring == 0 {
            (0..count).for_each(|k| triangles.push([0, outer(k), outer(k + 1)]));
        } else {
            let before = counts[ring - 1];
            let inner = |k: usize| start - before as u32 + (k % before) as u32;
            stitch(&mut triangles, before, count, inner, outer);
        }
        ring_of.resize(triangles.len(), ring);
        start += count as u32;
    }
    let sheet = Sheet { points: points.len(), triangles };
    (points, sheet, ring_of)
}

/// Triangles between two rings whose counts are equal or differ by a factor of two.
fn stitch(
    triangles: &mut Vec<[u32; 3]>,
    before: usize,
    count: usize,
    inner: impl Fn(usize) -> u32,
    outer: impl Fn(usize) -> u32,
) {
    for k in 0..before.min(count) {
        if before == count {
            // Alternating diagonals, so that the mesh has no twist.
            if k.is_multiple_of(2) {
                triangles.extend([[inner(k), outer(k), outer(k + 1)], [inner(k), inner(k + 1), outer(k + 1)]]);
            } else {
                triangles.extend([[inner(k), outer(k), inner(k + 1)], [inner(k + 1), outer(k), outer(k + 1)]]);
            }
        } else if count > before {
            let middle = outer(2 * k + 1);
            triangles.extend([
                [inner(k), outer(2 * k), middle],
                [inner(k), inner(k + 1), middle],
                [inner(k + 1), middle, outer(2 * k + 2)],
            ]);
        } else {
            let middle = inner(2 * k + 1);
            triangles.extend([
                [inner(2 * k), outer(k), middle],
                [middle, outer(k), outer(k + 1)],
                [middle, outer(k + 1), inner(2 * k + 2)],
            ]);
        }
    }
}

/// A cylinder around the z axis, centred on the origin, in a cylinder of air. Region 1 is the body.
///
/// # Errors
/// Sizes that are not positive, or a grading that does not fit them.
pub fn cylinder_mesh(radius_m: f64, height_m: f64, grading: &Grading) -> Result<EdgeMesh, MitError> {
    positive("radius_m", radius_m)?;
    positive("height_m", height_m)?;
    grading.check(radius_m.max(0.5 * height_m))?;
    fits("a cylinder", grading.cylinder_count(radius_m, height_m))?;
    let rim = grading.of_radius(radius_m, height_m);
    let mut radii: Vec<f64> = rim.inward(radius_m).iter().rev().skip(1).map(|d| radius_m - d).collect();
    radii.push(radius_m);
    let body_rings = radii.len();
    let side = TAU * radius_m / grading.around as f64;
    radii.extend(grading.outward(radius_m, 0.8 * side.min(0.5 * radius_m)));
    let half = |ring: &usize| *ring == 0 && body_rings > 1;
    let counts: Vec<usize> =
        (0..radii.len()).map(|ring| if half(&ring) { grading.around / 2 } else { grading.around }).collect();
    let (plane, sheet, ring_of) = disc(&radii, &counts);
    let levels = grading.symmetric(0.5 * height_m, 0.0);
    let inside = |layer: usize, t: usize| {
        let middle = 0.5 * (levels[layer] + levels[layer + 1]);
        u8::from(middle.abs() < 0.5 * height_m && ring_of[t] < body_rings)
    };
    let (tetrahedra, regions) = prisms(&sheet, levels.len() - 1, inside);
    let vertices = levels.iter().flat_map(|&z| plane.iter().map(move |p| [p[0], p[1], z])).collect();
    EdgeMesh::new(vertices, tetrahedra, regions, around_axis)
}

/// Midpoint of an edge in polar coordinates around the z axis.
fn around_axis(a: Vector, b: Vector) -> Vector {
    let (ra, rb) = (a[0].hypot(a[1]), b[0].hypot(b[1]));
    let middle = chord(a, b);
    if ra == 0.0 || rb == 0.0 {
        return middle;
    }
    let (x, y) = (a[0] / ra + b[0] / rb, a[1] / ra + b[1] / rb);
    let scale = 0.5 * (ra + rb) / x.hypot(y);
    [x * scale, y * scale, middle[2]]
}

/// A rectangular plate, centred on the origin, in a box of air. Region 1 is the body.
///
/// # Errors
/// Sizes that are not positive, or a grading that does not fit them.
pub fn plate_mesh(size_m: [f64; 3], grading: &Grading) -> Result<EdgeMesh, MitError> {
    for size in size_m {
        positive("size_m", size)?;
    }
    let longest = size_m.iter().copied().fold(0.0, f64::max);
    grading.check(0.5 * longest)?;
    fits("a plate", grading.plate_count(size_m))?;
    let axes = size_m.map(|size| {
        let thinnest = size_m.iter().copied().fold(f64::INFINITY, f64::min);
        grading.of_side(size, thinnest).symmetric(0.5 * size, 0.06 * longest)
    });
    let inside = |middle: Vector| u8::from((0..3).all(|k| middle[k].abs() < 0.5 * size_m[k]));
    box_mesh(&axes, inside)
}

/// A box of cells between planes at the given positions along x, y and z, each cell split into six tetrahedra.
/// `region` returns a cell's region, given its centre.
///
/// # Errors
/// Fewer than two positions along an axis, or positions that do not ascend.
pub fn box_mesh(axes: &[Vec<f64>; 3], region: impl Fn(Vector) -> u8) -> Result<EdgeMesh, MitError> {
    for axis in axes {
        if axis.len() < 2 {
            return Err(MitError::Count { what: "positions along an axis", expected: 2, got: axis.len() });
        }
        if let Some(pair) = axis.windows(2).find(|pair| pair[1] <= pair[0] || !(pair[1] - pair[0]).is_finite()) {
            let expected = "positions that ascend";
            return Err(MitError::Value { field: "step along an axis, metres", value: pair[1] - pair[0], expected });
        }
    }
    let [xs, ys, zs] = axes;
    let (nx, ny) = (xs.len(), ys.len());
    let at = |i: usize, j: usize| (i + j * nx) as u32;
    let mut triangles = Vec::new();
    for j in 0..ny - 1 {
        for i in 0..nx - 1 {
            if (i + j).is_multiple_of(2) {
                triangles
                    .extend([[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i, j + 1), at(i + 1, j + 1)]]);
            } else {
                triangles
                    .extend([[at(i, j), at(i + 1, j), at(i, j + 1)], [at(i + 1, j), at(i, j + 1), at(i + 1, j + 1)]]);
            }
        }
    }
    let sheet = Sheet { points: nx * ny, triangles };
    let middle = |axis: &[f64], k: usize| 0.5 * (axis[k] + axis[k + 1]);
    let of = |layer: usize, t: usize| {
        let (i, j) = ((t / 2) % (nx - 1), (t / 2) / (nx - 1));
        region([middle(xs, i), middle(ys, j), middle(zs, layer)])
    };
    let (tetrahedra, regions) = prisms(&sheet, zs.len() - 1, of);
    let vertices = zs.iter().flat_map(|&z| ys.iter().flat_map(move |&y| xs.iter().map(move |&x| [x, y, z]))).collect();
    EdgeMesh::new(vertices, tetrahedra, regions, chord)
}

/// A sphere around the origin, in a sphere of air: the subdivided faces of an icosahedron, in shells. Region 1 is the
/// body. `grading.around` is rounded to 10 or 20 elements around the equator.
///
/// # Errors
/// A radius that is not positive, or a grading that does not fit it.
pub fn sphere_mesh(radius_m: f64, grading: &Grading) -> Result<EdgeMesh, MitError> {
    positive("radius_m", radius_m)?;
    grading.check(radius_m)?;
    fits("a sphere", grading.sphere_count(radius_m))?;
    let (directions, sheet) = icosphere(if grading.around > 14 { 2 } else { 1 });
    let inside = grading.inward(radius_m);
    let mut radii: Vec<f64> = inside.iter().rev().skip(1).map(|d| radius_m - d).collect();
    radii.push(radius_m);
    let body = radii.len() - 1;
    radii.extend(grading.outward(radius_m, 0.3 * radius_m));
    let (mut tetrahedra, mut regions) = prisms(&sheet, radii.len() - 1, |layer, _| u8::from(layer < body));
    let centre = (radii.len() * sheet.points) as u32;
    tetrahedra.extend(sheet.triangles.iter().map(|&[a, b, c]| [a, b, c, centre]));
    regions.resize(tetrahedra.len(), 1);
    let mut vertices: Vec<Vector> = radii.iter().flat_map(|&r| directions.iter().map(move |&d| scaled(d, r))).collect();
    vertices.push([0.0; 3]);
    EdgeMesh::new(vertices, tetrahedra, regions, |a, b| {
        let (ra, rb) = (norm(a), norm(b));
        if ra == 0.0 || rb == 0.0 {
            return chord(a, b);
        }
        let direction = add(scaled(a, 1.0 / ra), scaled(b, 1.0 / rb));
        scaled(direction, 0.5 * (ra + rb) / norm(direction))
    })
}

fn icosphere(divisions: usize) -> (Vec<Vector>, Sheet) {
    let golden = 0.5 * (1.0 + 5.0_f64.sqrt());
    let mut points: Vec<Vector> = Vec::new();
    for a in [-1.0, 1.0] {
        for b in [-golden, golden] {
            points.extend([[0.0, a, b], [a, b, 0.0], [b, 0.0, a]]);
        }
    }
    let apart = |a: Vector, b: Vector| norm(subtract(a, b));
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                let sides = [(i, j), (i, k), (j, k)].map(|(a, b)| apart(points[a], points[b]));
                if sides.iter().all(|side| (side - 2.0).abs() < 1e-9) {
                    triangles.push([i as u32, j as u32, k as u32]);
                }
            }
        }
    }
    points.iter_mut().for_each(|p| *p = scaled(*p, 1.0 / norm(*p)));
    for _ in 0..divisions {
        let mut middles = std::collections::HashMap::new();
        let mut finer = Vec::with_capacity(4 * triangles.len());
        for &[a, b, c] in &triangles {
            let [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(|[p, q]: [u32; 2]| {
                *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                    let middle = add(points[p as usize], points[q as usize]);
                    points.push(scaled(middle, 1.0 / norm(middle)));
                    points.len() as u32 - 1
                })
            });
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    let sheet = Sheet { points: points.len(), triangles };
    (points, sheet)
}
