//! Meshes of tetrahedra around a body in air: a plane mesh of triangles, fitted to the body's outline, drawn out along z in
//! layers. Layers and rings are graded, fine at the body's surface and coarse toward the outer border.

use std::f64::consts::TAU;

use crate::mit::error::positive;
use crate::mit::{MitError, Vector};

/// Tetrahedra, some of which are body.
#[derive(Clone, Debug)]
pub struct EdgeMesh {
    /// Nodes, metres.
    pub nodes: Vec<Vector>,
    /// Tetrahedra, nodes in ascending order, so that edges and faces have the same direction in all that share them.
    pub tetrahedra: Vec<[u32; 4]>,
    /// Which tetrahedra are body.
    pub is_body: Vec<bool>,
    /// Nodes on the outer border.
    pub on_border: Vec<bool>,
    /// Radius of the sphere around the body's middle that holds it, metres.
    pub body_radius_m: f64,
}

/// How fine a mesh is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fineness {
    /// Thickness of the layer at the body's surface, metres: about a skin depth or less.
    pub surface_m: f64,
    /// Largest size inside the body, metres.
    pub inside_m: f64,
    /// Growth from layer to layer.
    pub growth: f64,
    /// From the body's middle to the outer border, metres.
    pub border_m: f64,
    /// Points around a round body.
    pub around: usize,
}

impl Fineness {
    fn check(&self) -> Result<(), MitError> {
        positive("surface_m", self.surface_m)?;
        positive("inside_m", self.inside_m)?;
        positive("border_m", self.border_m)?;
        if !(self.growth > 1.0 && self.growth <= 4.0) {
            return Err(MitError::Value { field: "growth", value: self.growth, expected: "above 1, at most 4" });
        }
        if !(6..=200).contains(&self.around) {
            return Err(MitError::Value { field: "around", value: self.around as f64, expected: "6 to 200" });
        }
        Ok(())
    }
}

impl EdgeMesh {
    /// A cylinder along z, its middle at the origin.
    ///
    /// # Errors
    /// Sizes that are not positive, a border inside the body.
    pub fn cylinder(radius_m: f64, height_m: f64, fineness: &Fineness) -> Result<Self, MitError> {
        fineness.check()?;
        positive("radius_m", radius_m)?;
        positive("height_m", height_m)?;
        let body_radius_m = radius_m.hypot(0.5 * height_m);
        check_border(fineness.border_m, body_radius_m)?;
        let mut radii = inward(radius_m, fineness, false);
        radii.extend(outward(radius_m, fineness.border_m, fineness));
        // A polygon inside the circle has less area; the one taken has the circle's.
        let sides = fineness.around as f64;
        let swell = (TAU / sides / (TAU / sides).sin()).sqrt();
        let plane = Plane::rings(&radii, fineness.around, swell);
        let layers = symmetric(0.5 * height_m, fineness);
        let inside = |[x, y]: [f64; 2], z: f64| x.hypot(y) < radius_m && z.abs() < 0.5 * height_m;
        Ok(Self::drawn_out(&plane, &layers, inside, body_radius_m))
    }

    /// A box with sides along the axes, its middle at the origin.
    ///
    /// # Errors
    /// As [`EdgeMesh::cylinder`].
    pub fn plate(size_m: Vector, fineness: &Fineness) -> Result<Self, MitError> {
        fineness.check()?;
        size_m.iter().try_for_each(|size| positive("size_m of a plate", *size))?;
        let half = size_m.map(|size| 0.5 * size);
        let body_radius_m = (half[0] * half[0] + half[1] * half[1] + half[2] * half[2]).sqrt();
        check_border(fineness.border_m, body_radius_m)?;
        let [x, y, z] = half.map(|half| symmetric(half, fineness));
        let inside = |[x, y]: [f64; 2], z: f64| x.abs() < half[0] && y.abs() < half[1] && z.abs() < half[2];
        Ok(Self::drawn_out(&Plane::grid(&x, &y), &z, inside, body_radius_m))
    }

    /// A grid of boxes, each cut into six tetrahedra; `inside` tells of a box's middle whether it is body.
    ///
    /// # Errors
    /// Fewer than two coordinates along an axis, or coordinates that do not ascend.
    pub fn grid(
        x_m: &[f64],
        y_m: &[f64],
        z_m: &[f64],
        inside: impl Fn([f64; 2], f64) -> bool,
        body_radius_m: f64,
    ) -> Result<Self, MitError> {
        for axis in [x_m, y_m, z_m] {
            if axis.len() < 2 {
                return Err(MitError::Count { what: "coordinates along an axis", expected: 2, got: axis.len() });
            }
            if let Some(pair) =
                axis.windows(2).find(|pair| pair[1].partial_cmp(&pair[0]) != Some(std::cmp::Ordering::Greater))
            {
                return Err(MitError::Value { field: "coordinates (m)", value: pair[1], expected: "ascending" });
            }
        }
        Ok(Self::drawn_out(&Plane::grid(x_m, y_m), z_m, inside, body_radius_m))
    }

    /// Draws a plane mesh out along z: each triangle and layer is a prism of three tetrahedra, whose side faces are cut from
    /// the lower end of the column of lower number, alike from both sides.
    fn drawn_out(plane: &Plane, layers_m: &[f64], inside: impl Fn([f64; 2], f64) -> bool, body_radius_m: f64) -> Self {
        let columns = plane.points.len();
        let node = |column: u32, layer: usize| layer as u32 * columns as u32 + column;
        let mut mesh = Self {
            nodes: layers_m.iter().flat_map(|&z| plane.points.iter().map(move |p| [p[0], p[1], z])).collect(),
            tetrahedra: Vec::new(),
            is_body: Vec::new(),
            on_border: Vec::new(),
            body_radius_m,
        };
        let top = layers_m.len() - 1;
        mesh.on_border = (0..=top)
            .flat_map(|layer| plane.on_border.iter().map(move |side| *side || layer == 0 || layer == top))
            .collect();
        for layer in 0..top {
            let middle_z = 0.5 * (layers_m[layer] + layers_m[layer + 1]);
            for triangle in &plane.triangles {
                let mut t = *triangle;
                t.sort_unstable();
                let centre = [0, 1].map(|axis| t.iter().map(|&k| plane.points[k as usize][axis]).sum::<f64>() / 3.0);
                let [b0, b1, b2] = t.map(|k| node(k, layer));
                let [t0, t1, t2] = t.map(|k| node(k, layer + 1));
                for mut tetrahedron in [[b0, b1, b2, t2], [b0, b1, t1, t2], [b0, t0, t1, t2]] {
                    tetrahedron.sort_unstable();
                    mesh.tetrahedra.push(tetrahedron);
                    mesh.is_body.push(inside(centre, middle_z));
                }
            }
        }
        mesh
    }

    /// Corners of a tetrahedron, metres.
    pub fn corners(&self, tetrahedron: usize) -> [Vector; 4] {
        self.tetrahedra[tetrahedron].map(|node| self.nodes[node as usize])
    }
}

fn check_border(border_m: f64, body_radius_m: f64) -> Result<(), MitError> {
    if border_m >= 2.0 * body_radius_m {
        return Ok(());
    }
    Err(MitError::Value { field: "border_m", value: border_m, expected: "twice the body's radius or more" })
}

/// Distances from a body's middle to its surface, fine at the surface; with the middle itself where asked for.
fn inward(half_m: f64, fineness: &Fineness, with_middle: bool) -> Vec<f64> {
    let (mut depths, mut depth, mut step) = (vec![half_m], 0.0, fineness.surface_m.min(half_m));
    while half_m - depth > 1.3 * step {
        depth += step;
        depths.push(half_m - depth);
        step = (step * fineness.growth).min(fineness.inside_m);
    }
    // What is left over is shared.
    if depths.len() > 1 {
        let first = depths.len() - 1;
        if depths[first] < 0.35 * step && with_middle {
            depths.pop();
        }
    }
    if with_middle {
        depths.push(0.0);
    }
    depths.reverse();
    depths
}

/// Distances beyond the surface to the border.
fn outward(from_m: f64, border_m: f64, fineness: &Fineness) -> Vec<f64> {
    let (mut all, mut at, mut step) = (Vec::new(), from_m, fineness.surface_m.max(0.5 * fineness.inside_m));
    loop {
        at += step;
        step *= fineness.growth.max(1.5);
        if at + 0.4 * step >= border_m {
            all.push(border_m);
            return all;
        }
        all.push(at);
    }
}

/// Coordinates on both sides of the middle.
fn symmetric(half_m: f64, fineness: &Fineness) -> Vec<f64> {
    let mut positive = inward(half_m, fineness, true);
    positive.extend(outward(half_m, fineness.border_m, fineness));
    let negative = positive.iter().skip(1).rev().map(|value| -value);
    negative.chain(positive.iter().copied()).collect()
}

/// Triangles in a plane.
struct Plane {
    points: Vec<[f64; 2]>,
    triangles: Vec<[u32; 3]>,
    on_border: Vec<bool>,
}

impl Plane {
    /// Concentric rings; near the middle with fewer points.
    fn rings(radii_m: &[f64], around: usize, swell: f64) -> Self {
        let mut plane = Self { points: vec![[0.0; 2]], triangles: Vec::new(), on_border: vec![false] };
        let mut before = vec![0_u32];
        for (k, radius) in radii_m.iter().enumerate() {
            let count = (6 * (k + 1)).min(around);
            let first = plane.points.len() as u32;
            for point in 0..count {
                let (sine, cosine) = (TAU * point as f64 / count as f64).sin_cos();
                plane.points.push([swell * radius * cosine, swell * radius * sine]);
                plane.on_border.push(k + 1 == radii_m.len());
            }
            let ring: Vec<u32> = (first..first + count as u32).collect();
            plane.join(&before, &ring);
            before = ring;
        }
        plane
    }

    /// Triangles between two rings whose first points lie at the same angle.
    fn join(&mut self, inner: &[u32], outer: &[u32]) {
        let (n, m) = (inner.len(), outer.len());
        let (mut i, mut j) = (0, 0);
        if n == 1 {
            self.triangles.extend((0..m).map(|k| [inner[0], outer[k], outer[(k + 1) % m]]));
            return;
        }
        while i < n || j < m {
            let (here, there) = (inner[i % n], outer[j % m]);
            // The next point in angle is taken.
            let take_outer = j < m && (i == n || (j as f64 + 1.0) / m as f64 <= (i as f64 + 1.0) / n as f64 + 1e-12);
            if take_outer {
                j += 1;
                self.triangles.push([here, there, outer[j % m]]);
            } else {
                i += 1;
                self.triangles.push([here, there, inner[i % n]]);
            }
        }
    }

    /// Rectangles cut along one diagonal.
    fn grid(x_m: &[f64], y_m: &[f64]) -> Self {
        let columns = x_m.len();
        let node = |i: usize, j: usize| (j * columns + i) as u32;
        let points = y_m.iter().flat_map(|&y| x_m.iter().map(move |&x| [x, y])).collect();
        let mut triangles = Vec::new();
        for j in 0..y_m.len() - 1 {
            for i in 0..columns - 1 {
                let [a, b, c, d] = [node(i, j), node(i + 1, j), node(i + 1, j + 1), node(i, j + 1)];
                // Diagonals alternate, so that the mesh favours no direction.
                if (i + j) % 2 == 0 {
                    triangles.extend([[a, b, c], [a, c, d]]);
                } else {
                    triangles.extend([[a, b, d], [b, c, d]]);
                }
            }
        }
        let last = [columns - 1, y_m.len() - 1];
        let on_border = (0..columns * y_m.len())
            .map(|k| k % columns == 0 || k / columns == 0 || k % columns == last[0] || k / columns == last[1])
            .collect();
        Self { points, triangles, on_border }
    }
}
