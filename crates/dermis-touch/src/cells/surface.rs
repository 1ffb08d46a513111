//! Cells of any shape, given by lists of positions, areas and neighbours. The elements of a triangle mesh are such
//! cells.

use crate::error::{TouchError, require, require_length};

/// Largest distance of a point from its cell, in sides of a square with the cell's area.
const REACH: f64 = 2.0;

/// Cells with positions on a chart of the skin (x right, y up, metres), areas and neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceCells {
    places_m: Vec<[f64; 2]>,
    areas_m2: Vec<f64>,
    /// Neighbours of cell i are `neighbours[starts[i]..starts[i + 1]]`: first those across an edge, then those at a
    /// corner, each ascending.
    starts: Vec<u32>,
    /// End of the edge neighbours of each cell.
    edge_ends: Vec<u32>,
    neighbours: Vec<u32>,
    cell_size_m: f64,
}

impl SurfaceCells {
    /// Builds cells from lists. `edge_neighbours` lists the neighbours of each cell that share an edge with it,
    /// `corner_neighbours` those that share only a corner. Both must be symmetric.
    ///
    /// # Errors
    /// [`TouchError::Length`] for lists of different lengths. [`TouchError::Parameter`] for no cells, positions or
    /// areas that are not finite, areas not above 0, and neighbours that do not exist or are not mutual.
    pub fn new(
        places_m: Vec<[f64; 2]>,
        areas_m2: Vec<f64>,
        edge_neighbours: &[Vec<u32>],
        corner_neighbours: &[Vec<u32>],
    ) -> Result<Self, TouchError> {
        let count = places_m.len();
        require(count > 0 && count < u32::MAX as usize, "cells", count as f64, "at least 1 and fewer than 2^32")?;
        require_length("areas of the cells", count, areas_m2.len())?;
        require_length("edge neighbours of the cells", count, edge_neighbours.len())?;
        require_length("corner neighbours of the cells", count, corner_neighbours.len())?;
        for (place, &area) in places_m.iter().zip(&areas_m2) {
            require(place[0].is_finite(), "place of a cell (m)", place[0], "finite")?;
            require(place[1].is_finite(), "place of a cell (m)", place[1], "finite")?;
            require(area.is_finite() && area > 0.0, "area of a cell (m^2)", area, "finite and above 0")?;
        }
        let (mut starts, mut edge_ends, mut neighbours) = (vec![0], Vec::with_capacity(count), Vec::new());
        for (edges, corners) in edge_neighbours.iter().zip(corner_neighbours) {
            let from = neighbours.len();
            add_sorted(&mut neighbours, from, edges);
            edge_ends.push(neighbours.len() as u32);
            add_sorted(&mut neighbours, from, corners);
            starts.push(neighbours.len() as u32);
        }
        let cell_size_m = (areas_m2.iter().sum::<f64>() / count as f64).sqrt();
        let cells = Self { places_m, areas_m2, starts, edge_ends, neighbours, cell_size_m };
        cells.check_neighbours()?;
        Ok(cells)
    }

    /// The elements of a triangle mesh. `triangles` holds indices into `nodes_m`. Neighbours share an edge or a
    /// corner; the position of a cell is its centroid.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] for corners that do not exist and triangles without area; otherwise as for
    /// [`SurfaceCells::new`].
    pub fn from_triangles(nodes_m: &[[f64; 2]], triangles: &[[u32; 3]]) -> Result<Self, TouchError> {
        let mut at_node: Vec<Vec<u32>> = vec![Vec::new(); nodes_m.len()];
        let (mut places_m, mut areas_m2) = (Vec::new(), Vec::new());
        for (index, triangle) in triangles.iter().enumerate() {
            for &node in triangle {
                let expected = "an index of a node";
                let Some(list) = at_node.get_mut(node as usize) else {
                    return Err(TouchError::Parameter { name: "corner of a triangle", value: node.into(), expected });
                };
                list.push(index as u32);
            }
            let [a, b, c] = triangle.map(|node| nodes_m[node as usize]);
            places_m.push([(a[0] + b[0] + c[0]) / 3.0, (a[1] + b[1] + c[1]) / 3.0]);
            areas_m2.push(0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])).abs());
        }
        let (mut edges, mut corners) = (vec![Vec::new(); triangles.len()], vec![Vec::new(); triangles.len()]);
        let mut around = Vec::new();
        for (index, triangle) in triangles.iter().enumerate() {
            around.clear();
            around.extend(triangle.iter().flat_map(|&node| &at_node[node as usize]).filter(|&&t| t != index as u32));
            around.sort_unstable();
            // A triangle that appears twice shares two corners, hence an edge.
            for group in around.chunk_by(|a, b| a == b) {
                let list = if group.len() > 1 { &mut edges } else { &mut corners };
                list[index].push(group[0]);
            }
        }
        Self::new(places_m, areas_m2, &edges, &corners)
    }

    fn check_neighbours(&self) -> Result<(), TouchError> {
        let name = "neighbour of a cell";
        for cell in 0..self.len() {
            for &other in self.neighbours(cell) {
                let exists = (other as usize) < self.len() && other as usize != cell;
                require(exists, name, f64::from(other), "the index of another cell")?;
                let both = self.neighbours(other as usize).contains(&(cell as u32));
                require(both, name, f64::from(other), "a cell that has this one as a neighbour too")?;
            }
        }
        Ok(())
    }

    /// Number of cells.
    #[must_use]
    pub fn len(&self) -> usize {
        self.places_m.len()
    }

    /// Always false: there is at least one cell.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.places_m.is_empty()
    }

    /// Positions of the cells, metres.
    #[must_use]
    pub fn places_m(&self) -> &[[f64; 2]] {
        &self.places_m
    }

    /// Areas of the cells, m^2.
    #[must_use]
    pub fn areas_m2(&self) -> &[f64] {
        &self.areas_m2
    }

    /// Neighbours of a cell: first those across an edge, then those at a corner, each ascending.
    #[must_use]
    pub fn neighbours(&self, cell: usize) -> &[u32] {
        &self.neighbours[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Neighbours of a cell across an edge, ascending.
    #[must_use]
    pub fn edge_neighbours(&self, cell: usize) -> &[u32] {
        &self.neighbours[self.starts[cell] as usize..self.edge_ends[cell] as usize]
    }

    /// Side of a square with the mean cell's area, metres.
    #[must_use]
    pub fn cell_size_m(&self) -> f64 {
        self.cell_size_m
    }

    pub(super) fn relative_area(&self, cell: usize) -> f64 {
        self.areas_m2[cell] / (self.cell_size_m * self.cell_size_m)
    }

    /// The cell nearest to a point, if the point is on it or close to it.
    pub(super) fn cell_at(&self, [x, y]: [f64; 2]) -> Option<usize> {
        let square = |place: &[f64; 2]| (place[0] - x).powi(2) + (place[1] - y).powi(2);
        let distances = self.places_m.iter().map(square).enumerate();
        let (cell, nearest) = distances.min_by(|a, b| a.1.total_cmp(&b.1))?;
        (nearest <= REACH * REACH * self.areas_m2[cell]).then_some(cell)
    }
}

/// Appends, in ascending order, those cells of `new` that the list does not already hold from index `from` on.
fn add_sorted(list: &mut Vec<u32>, from: usize, new: &[u32]) {
    let mut sorted: Vec<u32> = new.iter().copied().filter(|cell| !list[from..].contains(cell)).collect();
    sorted.sort_unstable();
    sorted.dedup();
    list.extend(sorted);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_know_edges_from_corners() {
        // A fan of three triangles around node 0: the outer two share only that node.
        let nodes = [[0.0, 0.0], [3.0, 0.0], [3.0, 3.0], [0.0, 3.0], [-3.0, 3.0]];
        let cells = SurfaceCells::from_triangles(&nodes, &[[0, 1, 2], [0, 2, 3], [0, 3, 4]]).unwrap();
        assert_eq!(cells.neighbours(0), [1, 2]);
        assert_eq!(cells.edge_neighbours(0), [1]);
        assert_eq!(cells.edge_neighbours(1), [0, 2]);
        assert_eq!(cells.places_m()[0], [2.0, 1.0]);
        assert_eq!(cells.areas_m2(), [4.5, 4.5, 4.5]);
        assert_eq!(cells.cell_at([2.0, 0.9]), Some(0));
        assert_eq!(cells.cell_at([20.0, 0.9]), None);
    }

    #[test]
    fn impossible_cells_are_named() {
        let places = vec![[0.0, 0.0], [1.0, 0.0]];
        let none = vec![Vec::new(), Vec::new()];
        let one_way = [vec![1], Vec::new()];
        let error = SurfaceCells::new(places.clone(), vec![1.0, 1.0], &one_way, &none).unwrap_err();
        assert!(error.to_string().contains("as a neighbour too"), "{error}");
        assert!(SurfaceCells::new(places.clone(), vec![1.0, 0.0], &none, &none).is_err());
        assert!(SurfaceCells::new(places, vec![1.0], &none, &none).is_err());
        assert!(SurfaceCells::from_triangles(&[[0.0; 2]; 3], &[[0, 1, 3]]).is_err());
        assert!(SurfaceCells::from_triangles(&[[0.0; 2]; 3], &[[0, 1, 2]]).is_err());
    }
}
