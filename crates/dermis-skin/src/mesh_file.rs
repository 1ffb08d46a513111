//! `shape = { mesh = { file = "tank.msh" } }`: outline and electrodes of a skin from the rim and the groups of a Gmsh
//! mesh. Only the outline is kept; dermis then meshes the skin itself.

use std::collections::HashMap;
use std::path::Path;

use dermis_tomo::mesh::{CellKind, Contact, ElectrodeGroups, ElectrodedMesh, Point, distance, read_msh};

use crate::check::{Checker, MM};
use crate::error::Error;
use crate::frontend::{Electrodes, RimElectrode, Shape};
use crate::mesh_source::{LengthUnit, MeshFile};
use crate::parts::read_bytes_beside;

/// Key in skin files.
const FIELD: &str = "frontend.shape.mesh";
/// Maximum width of a mesh: wider than any skin, but narrower than a 10 mm skin whose millimetres are read as metres.
const WIDEST_M: f64 = 5.0;

impl MeshFile {
    /// The outline, and the electrodes if `wanted`.
    pub(crate) fn read(
        &self,
        wanted: bool,
        file: &str,
        folder: Option<&Path>,
    ) -> Result<(Shape, Option<Electrodes>), Error> {
        let checker = Checker { file };
        let (bytes, name) = read_bytes_beside(FIELD, &self.file, file, folder, "an MSH file next to the skin file")?;
        let refuse = |message: String| Error::SkinFile { file: name.clone(), message };
        let groups = ElectrodeGroups::Prefix(self.electrodes.clone());
        let read = read_msh(&bytes, &groups, &[1.0]).map_err(|error| refuse(error.to_string()))?;
        let flat = read.mesh.nodes().iter().all(|node| node[2] == read.mesh.nodes()[0][2]);
        if read.mesh.kind() != CellKind::Triangle || !flat {
            return Err(refuse("expected a flat mesh of triangles: a skin is a sheet".into()));
        }
        let unit_m = self.unit.map_or(1.0, LengthUnit::metres);
        let extent = |axis: usize| {
            let along = || read.mesh.nodes().iter().map(|node| node[axis]);
            along().fold(f64::MIN, f64::max) - along().fold(f64::MAX, f64::min)
        };
        let width_m = unit_m * extent(0).max(extent(1));
        if self.unit.is_none() && width_m > WIDEST_M {
            let expected = "unit = \"mm\" if its coordinates are millimetres, unit = \"m\" if they are metres";
            return Err(checker.refused(FIELD, format!("{:?}, {width_m:.3} m wide", self.file), expected));
        }
        let mut loops = loops(&read);
        let scale = unit_m / MM;
        let place = |node: &u32| {
            let [x, y, _] = read.mesh.nodes()[*node as usize];
            [scale * x, scale * y]
        };
        let area = |ring: &Vec<u32>| signed_area(&ring.iter().map(place).collect::<Vec<_>>());
        // The outer rim encloses the largest area.
        loops.sort_by(|a, b| area(b).abs().total_cmp(&area(a).abs()));
        if let Some(outer) = loops.first_mut()
            && area(outer) < 0.0
        {
            outer.reverse();
        }
        let Some((outer, holes)) = loops.split_first() else { return Err(refuse("a mesh without a rim".into())) };
        let electrodes = if wanted { Some(self.rim_electrodes(&read, outer, &place, &refuse)?) } else { None };
        let holes_mm = holes.iter().map(|ring| ring.iter().map(place).collect()).collect();
        Ok((Shape::Polygon { outer_mm: outer.iter().map(place).collect(), holes_mm }, electrodes))
    }

    /// The electrode groups as stretches of the outer rim.
    fn rim_electrodes(
        &self,
        read: &ElectrodedMesh,
        outer: &[u32],
        place: &dyn Fn(&u32) -> [f64; 2],
        refuse: &dyn Fn(String) -> Error,
    ) -> Result<Electrodes, Error> {
        let prefix = &self.electrodes;
        if read.electrodes.is_empty() {
            let message = format!(
                "expected physical groups named {prefix}1, {prefix}2, ... of rim edges (electrodes = \"PREFIX\" in the skin \
                 file's mesh names others), or electrodes in the skin file"
            );
            return Err(refuse(message));
        }
        let count = outer.len();
        let length = |k: usize| distance(place(&outer[k]), place(&outer[(k + 1) % count]));
        let mut begins = vec![0.0; count + 1];
        (0..count).for_each(|k| begins[k + 1] = begins[k] + length(k));
        let edge_of: HashMap<[u32; 2], usize> = (0..count)
            .map(|k| {
                let (a, b) = (outer[k], outer[(k + 1) % count]);
                ([a.min(b), a.max(b)], k)
            })
            .collect();
        let mut list = Vec::with_capacity(read.electrodes.len());
        for (number, electrode) in (1..).zip(&read.electrodes) {
            let Contact::Faces(faces) = &electrode.contact else {
                return Err(refuse(format!("electrode {number}: expected a group of rim edges")));
            };
            let edges: Option<Vec<usize>> =
                faces.iter().map(|face| edge_of.get(&[face[0].min(face[1]), face[0].max(face[1])]).copied()).collect();
            let mut edges =
                edges.ok_or_else(|| refuse(format!("electrode {number}: expected edges of the outer rim")))?;
            edges.sort_unstable();
            edges.dedup();
            // Handle stretches that cross the seam: start after the only gap.
            let gaps: Vec<usize> =
                (0..edges.len()).filter(|&k| (edges[k] + 1) % count != edges[(k + 1) % edges.len()]).collect();
            let first = match gaps[..] {
                [gap] => edges[(gap + 1) % edges.len()],
                _ => return Err(refuse(format!("electrode {number}: expected one stretch of the rim"))),
            };
            let width_mm: f64 = edges.iter().map(|&k| length(k)).sum();
            let at_deg = (360.0 * (begins[first] + 0.5 * width_mm) / begins[count]).rem_euclid(360.0);
            list.push(RimElectrode { at_deg, width_mm });
        }
        Ok(Electrodes::RimList(list))
    }
}

/// The rims of a mesh, each a closed chain of nodes.
fn loops(read: &ElectrodedMesh) -> Vec<Vec<u32>> {
    let mut next: HashMap<u32, Vec<u32>> = HashMap::new();
    for (edge, _) in read.mesh.boundary_faces() {
        next.entry(edge[0]).or_default().push(edge[1]);
        next.entry(edge[1]).or_default().push(edge[0]);
    }
    let mut starts: Vec<u32> = next.keys().copied().collect();
    starts.sort_unstable();
    let mut seen = std::collections::HashSet::new();
    let mut loops = Vec::new();
    for start in starts {
        if seen.contains(&start) {
            continue;
        }
        let (mut ring, mut node) = (Vec::new(), Some(start));
        while let Some(at) = node {
            seen.insert(at);
            ring.push(at);
            node = next.get(&at).and_then(|others| others.iter().copied().find(|other| !seen.contains(other)));
        }
        if ring.len() >= 3 {
            loops.push(ring);
        }
    }
    loops
}

fn signed_area(ring: &[Point]) -> f64 {
    let next = |k: usize| ring[(k + 1) % ring.len()];
    (0..ring.len()).map(|k| 0.5 * (ring[k][0] * next(k)[1] - next(k)[0] * ring[k][1])).sum()
}
