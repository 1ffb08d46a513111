//! Helpers shared by the mesh readers: numbers in text, polygons, transforms, and limits of scenes.

/// Maximum number of corners in one file, three per triangle. A small file may instance one mesh many times.
const MOST_CORNERS: usize = 12_000_000;
/// Maximum number of numbers read for one file. A mesh that is instanced many times is read as often.
const MOST_NUMBERS: usize = 20 * MOST_CORNERS;
/// Maximum number of nodes in a scene, and their maximum nesting depth.
const MOST_NODES: usize = 100_000;
const MOST_DEPTH: usize = 64;

/// A transform of points as the upper three rows of its matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine(pub [[f64; 4]; 3]);

impl Affine {
    /// Leaves points unchanged.
    pub const IDENTITY: Self = Self([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);

    /// Multiplies coordinates.
    pub fn scale([x, y, z]: [f64; 3]) -> Self {
        Self([[x, 0.0, 0.0, 0.0], [0.0, y, 0.0, 0.0], [0.0, 0.0, z, 0.0]])
    }

    /// Moves points.
    pub fn translation([x, y, z]: [f64; 3]) -> Self {
        Self([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
    }

    /// Rotates points by a quaternion of any length.
    pub fn rotation([x, y, z, w]: [f64; 4]) -> Self {
        let s = 2.0 / (x * x + y * y + z * z + w * w);
        Self([
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), 0.0],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w), 0.0],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y), 0.0],
        ])
    }

    /// Applies the other transform first, then this one.
    pub fn after(&self, other: &Self) -> Self {
        let entry = |row: usize, column: usize| {
            let turned: f64 = (0..3).map(|k| self.0[row][k] * other.0[k][column]).sum();
            turned + if column == 3 { self.0[row][3] } else { 0.0 }
        };
        Self(std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column))))
    }

    /// The transformed point.
    pub fn apply(&self, point: [f32; 3]) -> [f32; 3] {
        let [x, y, z] = point.map(f64::from);
        self.0.map(|[a, b, c, d]| (a * x + b * y + c * z + d) as f32)
    }
}

/// The corners of a scene, placed node by node.
#[derive(Debug, Default)]
pub(super) struct Placed {
    pub corners: Vec<[f32; 3]>,
    nodes: usize,
    numbers: usize,
}

impl Placed {
    /// Counts a node at this depth.
    ///
    /// # Errors
    /// Too many nodes or levels, for example in a scene that contains itself.
    pub fn enter(&mut self, depth: usize) -> Result<(), String> {
        self.nodes += 1;
        if depth > MOST_DEPTH || self.nodes > MOST_NODES {
            return Err(format!("expected at most {MOST_NODES} nodes, nested at most {MOST_DEPTH} deep"));
        }
        Ok(())
    }

    /// Counts numbers that have been read.
    ///
    /// # Errors
    /// More than a file may have, as in one that uses the same large mesh very often.
    pub fn read(&mut self, numbers: usize) -> Result<(), String> {
        self.numbers = self.numbers.saturating_add(numbers);
        if self.numbers > MOST_NUMBERS {
            return Err(format!("expected at most {MOST_NUMBERS} numbers, each counted as often as it is used"));
        }
        Ok(())
    }

    /// Adds transformed corners.
    ///
    /// # Errors
    /// Too many corners for a mesh.
    pub fn add(&mut self, corners: &[[f32; 3]], by: &Affine) -> Result<(), String> {
        if self.corners.len() + corners.len() > MOST_CORNERS {
            return Err(format!("expected at most {} triangles", MOST_CORNERS / 3));
        }
        self.corners.extend(corners.iter().map(|corner| by.apply(*corner)));
        Ok(())
    }
}

/// The triangles of a convex polygon, three corners each; empty for fewer than three corners.
pub(super) fn fan<T: Copy>(corners: &[T]) -> impl Iterator<Item = T> + '_ {
    let pairs = corners.get(1..).unwrap_or_default().windows(2);
    pairs.flat_map(|pair| [corners[0], pair[0], pair[1]])
}

/// The triangles of a strip: three corners each.
pub(super) fn strip<T: Copy>(corners: &[T]) -> impl Iterator<Item = T> + '_ {
    let threes = corners.windows(3).enumerate();
    threes
        .flat_map(|(k, three)| if k % 2 == 0 { [three[0], three[1], three[2]] } else { [three[1], three[0], three[2]] })
}

/// The first three numbers in a text.
pub(super) fn three_numbers(text: &str) -> Option<[f32; 3]> {
    let mut numbers = text.split_whitespace().map(|word| word.parse().ok());
    Some([numbers.next()??, numbers.next()??, numbers.next()??])
}
