//! Slits along the edges of an existing mesh. Each cut follows the nearest chain of edges, off by about half an
//! element; the nodes in between have a second value for the elements on one side. A sheet that is cut differently in
//! every scene then needs no new mesh, only a few more right-hand sides ([`super::TwoSheets::set_slit_paths`]).

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use dermis_tomo::mesh::{Contact, ElectrodedMesh, Point, distance, to_segment};
use dermis_tomo::sparse::SparseError;

use super::sheet_body::triangles_of;

/// Step along a cut for finding its nearest nodes, in mean edge lengths.
const STEP: f64 = 0.25;
/// Maximum distance of these nodes from the cut, in mean edge lengths.
const REACH: f64 = 0.9;
/// Maximum deviation of a path from its cut, in mean edge lengths.
const FARTHEST: f64 = 1.5;
/// Penalty on deviations: an edge's length is multiplied by one plus this times the squared deviation in mean edge
/// lengths.
const STRAYING: f64 = 4.0;
/// Minimum share of a cut's length that its edges must follow.
const FOLLOWED: f64 = 0.8;

/// A chain of edges along which a sheet is slit.
#[derive(Clone, Debug, PartialEq)]
pub struct SlitPath {
    /// Its nodes, including both ends, where the two sides meet.
    pub(super) nodes: Vec<u32>,
    /// Elements on one side of each inner node, in the order of the nodes.
    pub(super) side: Vec<Vec<u32>>,
    /// Conductance across the slit per length, S/m.
    pub(super) s_per_m: f64,
}

impl SlitPath {
    /// The nodes, including both ends.
    pub fn nodes(&self) -> &[u32] {
        &self.nodes
    }
}

/// A triangle mesh in the plane, prepared for finding paths.
#[derive(Debug)]
pub struct SlitPaths {
    positions: Vec<Point>,
    /// Corners counter-clockwise.
    triangles: Vec<[u32; 3]>,
    /// Elements around each node, and the nodes that share an element with it.
    around: Vec<Vec<u32>>,
    neighbours: Vec<Vec<u32>>,
    /// True for nodes inside the sheet that are not on an electrode.
    free: Vec<bool>,
    edge_m: f64,
}

impl SlitPaths {
    /// Prepares the sheet under these electrodes.
    ///
    /// # Errors
    /// A mesh with elements other than triangles.
    pub fn new(body: &ElectrodedMesh) -> Result<Self, SparseError> {
        let positions: Vec<Point> = body.mesh.nodes().iter().map(|p| [p[0], p[1]]).collect();
        let mut triangles = triangles_of(body)?;
        let at = |node: u32| positions[node as usize];
        let mut around = vec![Vec::new(); positions.len()];
        let mut length_m = 0.0;
        for (element, corners) in triangles.iter_mut().enumerate() {
            let [a, b, c] = corners.map(at);
            if (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0]) {
                corners.swap(1, 2);
            }
            length_m += distance(a, b) + distance(b, c) + distance(c, a);
            corners.iter().for_each(|&node| around[node as usize].push(element as u32));
        }
        let neighbours_of = |(node, elements): (usize, &Vec<u32>)| {
            let corners = elements.iter().flat_map(|&element| triangles[element as usize]);
            let mut neighbours: Vec<u32> = corners.filter(|&other| other as usize != node).collect();
            neighbours.sort_unstable();
            neighbours.dedup();
            neighbours
        };
        let neighbours: Vec<Vec<u32>> = around.iter().enumerate().map(neighbours_of).collect();
        // Nodes on the rim have more neighbours than elements.
        let mut free: Vec<bool> = around.iter().zip(&neighbours).map(|(a, n)| n.len() == a.len()).collect();
        for electrode in &body.electrodes {
            match &electrode.contact {
                Contact::Area(elements) => {
                    let nodes = elements.iter().flat_map(|&element| triangles[element as usize]);
                    nodes.for_each(|node| free[node as usize] = false);
                }
                Contact::Faces(faces) => {
                    faces.iter().flat_map(|face| face.as_slice()).for_each(|&node| free[node as usize] = false);
                }
                Contact::Point(node) => free[*node as usize] = false,
            }
        }
        let edge_m = length_m / (3 * triangles.len().max(1)) as f64;
        Ok(Self { positions, triangles, around, neighbours, free, edge_m })
    }

    /// The path nearest to a chain of points (metres), clear of existing paths, with this conductance across it per
    /// length (S/m). A chain that leaves the sheet is followed as far as possible. `None` if edges cannot follow it:
    /// at electrodes, at other paths, or if it is shorter than three edges.
    pub fn along(&self, chain_m: &[Point], beside: &[SlitPath], s_per_m: f64) -> Option<SlitPath> {
        let near = self.near(chain_m);
        let may_pass = |node: u32| self.free[node as usize] && !beside.iter().any(|path| path.nodes.contains(&node));
        let passable: Vec<u32> = near.iter().copied().filter(|&node| may_pass(node)).collect();
        let (points, reach_m) = (samples(chain_m, STEP * self.edge_m), REACH * self.edge_m);
        let inside = points.iter().filter(|&&point| self.nearest(&near, point, reach_m).is_some()).count();
        let ends: Vec<u32> = points.iter().filter_map(|&point| self.nearest(&passable, point, reach_m)).collect();
        if (ends.len() as f64) < FOLLOWED * inside as f64 {
            return None;
        }
        let mut nodes = self.cheapest(*ends.first()?, *ends.last()?, &passable, chain_m)?;
        self.straighten(&mut nodes);
        let followed = points.iter().filter(|&&point| self.nearest(&nodes, point, 1.5 * reach_m).is_some()).count();
        if nodes.len() < 4 || (followed as f64) < FOLLOWED * inside as f64 {
            return None;
        }
        let side = nodes.windows(3).map(|three| self.fan(three)).collect::<Option<_>>()?;
        Some(SlitPath { nodes, side, s_per_m })
    }

    /// The node nearest to a point, within a distance.
    fn nearest(&self, nodes: &[u32], point: Point, within_m: f64) -> Option<u32> {
        let off = |node: u32| {
            let [x, y] = self.positions[node as usize];
            (x - point[0]) * (x - point[0]) + (y - point[1]) * (y - point[1])
        };
        let within = (within_m * within_m, None);
        let nearer = |best: (f64, Option<u32>), &node: &u32| {
            let square = off(node);
            if square <= best.0 { (square, Some(node)) } else { best }
        };
        nodes.iter().fold(within, nearer).1
    }

    /// The cheapest chain of edges over these nodes, short and close to a chain of points (Dijkstra's algorithm).
    fn cheapest(&self, from: u32, to: u32, nodes: &[u32], chain_m: &[Point]) -> Option<Vec<u32>> {
        let off: HashMap<u32, f64> = nodes
            .iter()
            .map(|&node| {
                let at = self.positions[node as usize];
                let off_m = chain_m.windows(2).map(|ends| to_segment(at, ends[0], ends[1]).0);
                (node, off_m.fold(f64::INFINITY, f64::min) / self.edge_m)
            })
            .filter(|entry| entry.1 <= FARTHEST)
            .collect();
        let mut best: HashMap<u32, (f64, u32)> = HashMap::from([(from, (0.0, from))]);
        // Costs are not negative, so their bits have the same order.
        let mut open = BinaryHeap::from([(Reverse(0.0_f64.to_bits()), from)]);
        while let Some((Reverse(bits), node)) = open.pop() {
            if node == to {
                break;
            }
            let cost = f64::from_bits(bits);
            if best.get(&node).is_some_and(|entry| entry.0 < cost) {
                continue;
            }
            for &next in &self.neighbours[node as usize] {
                let Some(off) = off.get(&next) else { continue };
                let length = distance(self.positions[node as usize], self.positions[next as usize]);
                let cost = cost + length * (1.0 + STRAYING * off * off);
                if best.get(&next).is_none_or(|entry| cost < entry.0) {
                    best.insert(next, (cost, node));
                    open.push((Reverse(cost.to_bits()), next));
                }
            }
        }
        let mut nodes = vec![to];
        while *nodes.last()? != from {
            nodes.push(best.get(nodes.last()?)?.1);
        }
        nodes.reverse();
        Some(nodes)
    }

    /// Nodes in a box around a chain.
    fn near(&self, chain_m: &[Point]) -> Vec<u32> {
        let margin = 2.0 * self.edge_m;
        let fold =
            |axis: usize, start: f64, choose: fn(f64, f64) -> f64| chain_m.iter().map(|p| p[axis]).fold(start, choose);
        let low = [0, 1].map(|axis| fold(axis, f64::INFINITY, f64::min) - margin);
        let high = [0, 1].map(|axis| fold(axis, f64::NEG_INFINITY, f64::max) + margin);
        let within = |p: &Point| (0..2).all(|axis| p[axis] >= low[axis] && p[axis] <= high[axis]);
        (0..self.positions.len() as u32).filter(|&node| within(&self.positions[node as usize])).collect()
    }

    /// Removes nodes whose neighbours on the path are connected, so that the path does not touch itself.
    fn straighten(&self, nodes: &mut Vec<u32>) {
        let mut first = 0;
        while first + 2 < nodes.len() {
            let chord = (first + 2..nodes.len())
                .rev()
                .find(|&last| self.neighbours[nodes[first] as usize].contains(&nodes[last]));
            if let Some(last) = chord {
                nodes.drain(first + 1..last);
            }
            first += 1;
        }
    }

    /// Elements around the middle of three path nodes, on the left: counter-clockwise from the next edge to the last.
    fn fan(&self, three: &[u32]) -> Option<Vec<u32>> {
        let (before, node, after) = (three[0], three[1], three[2]);
        let mut elements = Vec::new();
        let mut corner = after;
        while corner != before {
            let next = self.around[node as usize].iter().find_map(|&element| {
                let corners = self.triangles[element as usize];
                let place = corners.iter().position(|&other| other == node)?;
                (corners[(place + 1) % 3] == corner).then(|| (element, corners[(place + 2) % 3]))
            });
            let (element, third) = next?;
            elements.push(element);
            corner = third;
        }
        Some(elements)
    }
}

/// Points along a chain.
fn samples(chain_m: &[Point], step_m: f64) -> Vec<Point> {
    let mut points: Vec<Point> = chain_m.first().copied().into_iter().collect();
    for ends in chain_m.windows(2) {
        let count = (distance(ends[0], ends[1]) / step_m).ceil().max(1.0) as usize;
        let at =
            |k: usize| [0, 1].map(|axis| ends[0][axis] + (ends[1][axis] - ends[0][axis]) * k as f64 / count as f64);
        points.extend((1..=count).map(at));
    }
    points
}

#[cfg(test)]
mod tests {
    use dermis_tomo::mesh::{ElectrodeShape, Outline, SheetSpec, SlitMesh};
    use faer::Mat;

    use super::super::{Shortcut, TwoSheets};
    use super::*;

    const SHEET_S: f64 = 5e-3;
    const LINE: [Point; 2] = [[-0.012, 0.004], [0.009, 0.018]];

    fn spec(lines: Vec<[[f64; 2]; 2]>, edge_m: f64) -> SheetSpec {
        let outline = Outline::Rectangle { width_m: 0.1, height_m: 0.1 };
        let pads = ElectrodeShape::PadCircle { centre_m: [0.0; 2], radius_m: 4e-3 }.grid(2, 2, [0.08; 2]);
        SheetSpec { lines, ..SheetSpec::new(outline, pads, edge_m) }
    }

    fn sheets(body: &ElectrodedMesh) -> TwoSheets {
        TwoSheets::new(body, SHEET_S, Shortcut::Equipotential).unwrap()
    }

    /// A press on one side of the cut and over one of its ends.
    fn press(positions: &[Point]) -> Vec<f64> {
        positions.iter().map(|p| 800.0 * (1.0 - distance(*p, [0.008, 0.016]) / 0.012).max(0.0)).collect()
    }

    fn largest(of: impl Fn(usize, usize) -> f64) -> f64 {
        (0..3).flat_map(|row| (0..3).map(move |column| (row, column))).map(|(r, c)| of(r, c).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_path_along_a_cut_that_the_mesh_follows_is_the_slit_mesh() {
        let (body, _) = spec(vec![LINE], 4e-3).build(&[1e-3]).unwrap();
        let SlitMesh { mesh: open, slits } = body.opened_along(&[LINE]).unwrap();
        let path = SlitPaths::new(&body).unwrap().along(&LINE, &[], 0.0).unwrap();
        assert_eq!(path.nodes().len(), slits[0].len() + 1, "edges of the line");
        for (touched, joined) in [(false, 0.0), (false, 0.5), (true, 0.0), (true, 0.5)] {
            let mut slit = TwoSheets::with_slits(&open, &slits[0], SHEET_S, Shortcut::Equipotential).unwrap();
            slit.set_joints(|_, _| joined);
            let mut along = sheets(&body);
            along.set_slit_paths(&[SlitPath { s_per_m: joined, ..path.clone() }]).unwrap();
            let contact = |positions: &[Point]| if touched { press(positions) } else { vec![0.0; positions.len()] };
            let [on_slit, on_path] = [slit.positions_m(), along.positions_m()].map(contact);
            let expected: Mat<f64> = slit.impedance(&on_slit).unwrap().to_owned();
            let intact: Mat<f64> = sheets(&body).impedance(&on_path).unwrap().to_owned();
            let got = along.impedance(&on_path).unwrap();
            let change = largest(|r, c| expected[(r, c)] - intact[(r, c)]);
            let error = largest(|r, c| expected[(r, c)] - got[(r, c)]);
            assert!(error < 1e-9 * change, "touched {touched}, joined {joined}: {error:e} of {change:e}");
            // Without paths, the result is as before.
            along.set_slit_paths(&[]).unwrap();
            let healed = along.impedance(&on_path).unwrap();
            assert!(largest(|r, c| healed[(r, c)] - intact[(r, c)]) < 1e-12 * change);
        }
    }

    #[test]
    fn a_mesh_that_does_not_follow_the_cut_finds_its_effect_within_its_elements() {
        let (fine, _) = spec(vec![LINE], 1e-3).build(&[1e-3]).unwrap();
        let SlitMesh { mesh: open, slits } = fine.opened_along(&[LINE]).unwrap();
        let change = |cut: &mut TwoSheets, intact: &mut TwoSheets| {
            let none = vec![0.0; cut.positions_m().len()];
            let cut: Mat<f64> = cut.impedance(&none).unwrap().to_owned();
            let none = vec![0.0; intact.positions_m().len()];
            cut - intact.impedance(&none).unwrap()
        };
        let mut slit = TwoSheets::with_slits(&open, &slits[0], SHEET_S, Shortcut::Equipotential).unwrap();
        let truth = change(&mut slit, &mut sheets(&fine));
        let (coarse, _) = spec(Vec::new(), 1.6e-3).build(&[1e-3]).unwrap();
        let path = SlitPaths::new(&coarse).unwrap().along(&LINE, &[], 0.0).unwrap();
        let mut along = sheets(&coarse);
        along.set_slit_paths(&[path]).unwrap();
        let found = change(&mut along, &mut sheets(&coarse));
        // The ends are up to half an edge off, for a cut of 25 mm: 6 % of its length, 12 % of its effect.
        let scale = largest(|r, c| truth[(r, c)]);
        let error = largest(|r, c| truth[(r, c)] - found[(r, c)]);
        println!("effect of a cut on another mesh: {:.3} off", error / scale);
        assert!(error < 0.12 * scale, "{error:e} of {scale:e}");
    }

    #[test]
    fn paths_keep_off_electrodes_and_each_other_and_end_at_the_rim() {
        let (body, _) = spec(Vec::new(), 2e-3).build(&[1e-3]).unwrap();
        let paths = SlitPaths::new(&body).unwrap();
        assert!(paths.along(&[[-0.05, 0.04], [-0.02, 0.04]], &[], 0.0).is_none(), "through a pad");
        assert!(paths.along(&[[0.0, 0.0], [0.003, 0.0]], &[], 0.0).is_none(), "hardly longer than an edge");
        assert!(paths.along(&[[0.2, 0.2], [0.3, 0.2]], &[], 0.0).is_none(), "off the sheet");
        let out = paths.along(&[[0.02, 0.0], [0.08, 0.0]], &[], 0.0).unwrap();
        let last = body.mesh.nodes()[*out.nodes().last().unwrap() as usize];
        assert!(last[0] > 0.045 && last[0] < 0.05, "{last:?}");
        assert!(paths.along(&[[0.03, -0.02], [0.03, 0.02]], &[out], 0.0).is_none(), "across another");
        let arc: Vec<[f64; 2]> = (0..9).map(|k| 0.2 * f64::from(k)).map(|a| [0.02 * a.cos(), 0.02 * a.sin()]).collect();
        let arc = paths.along(&arc, &[], 0.0).unwrap();
        assert_eq!(arc.side.len(), arc.nodes.len() - 2);
        for &node in arc.nodes() {
            let p = body.mesh.nodes()[node as usize];
            assert!((p[0].hypot(p[1]) - 0.02).abs() < 2e-3, "{p:?}");
        }
    }
}
