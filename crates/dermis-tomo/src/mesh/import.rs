//! Reads meshes in Gmsh's MSH formats 2.2 and 4.1, text and binary (Gmsh reference manual, "MSH file format"): nodes,
//! first-order triangles and tetrahedra, and electrodes from physical groups. The domain is all tetrahedra, or all
//! triangles if there are no tetrahedra. Unneeded sections are skipped; sizes claimed in the file reserve no memory.

mod binary;

use std::collections::{BTreeMap, HashMap};

use super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::sheet::spread;

/// Selects the physical groups that are electrodes. A group one dimension below the domain's is a contact of faces,
/// one of the domain's own dimension (sheets) a contact of area, one of dimension 0 a point.
#[derive(Clone, Debug, PartialEq)]
pub enum ElectrodeGroups {
    /// Groups whose name is this prefix and a number, in numerical order: `electrode` matches `electrode1`,
    /// `electrode_2`, `electrode 16`.
    Prefix(String),
    /// These groups, given by dimension and physical tag, in this order.
    Tags(Vec<(u8, i64)>),
}

/// Reads a mesh and its electrodes. `contact_impedance` holds one value for all electrodes or one each.
///
/// # Errors
/// Errors with the line number for anything invalid or unsupported (other versions, elements of higher order), and
/// the errors of [`Mesh::new`] and [`ElectrodedMesh::new`].
pub fn read_msh(
    bytes: &[u8],
    groups: &ElectrodeGroups,
    contact_impedance: &[f64],
) -> Result<ElectrodedMesh, MeshError> {
    let mut file = MshFile::default();
    if MshFile::is_binary(bytes) {
        file.read_binary(bytes)?;
    } else {
        let text = std::str::from_utf8(bytes).map_err(|error| {
            let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
            MeshError::Parse { line, reason: "not text; expected an MSH file of Gmsh, version 2.2 or 4.1".into() }
        })?;
        file.read(&mut Lines::new(text))?;
    }
    file.into_mesh(groups, contact_impedance)
}

/// The lines of a file, numbered from 1.
struct Lines<'a> {
    lines: std::str::Lines<'a>,
    number: usize,
}

impl<'a> Lines<'a> {
    fn new(text: &'a str) -> Self {
        Self { lines: text.lines(), number: 0 }
    }

    /// The next line that is not blank.
    fn next(&mut self) -> Option<&'a str> {
        loop {
            self.number += 1;
            let line = self.lines.next()?.trim();
            if !line.is_empty() {
                return Some(line);
            }
        }
    }

    fn error(&self, reason: impl Into<String>) -> MeshError {
        MeshError::Parse { line: self.number, reason: reason.into() }
    }

    fn expect(&mut self, what: &str) -> Result<&'a str, MeshError> {
        self.next().ok_or_else(|| self.error(format!("the file ends where {what} should be")))
    }

    /// The numbers of the next line, at least `least` of them.
    fn numbers<T: std::str::FromStr>(&mut self, what: &str, least: usize) -> Result<Vec<T>, MeshError> {
        let line = self.expect(what)?;
        let parse = |word: &str| word.parse().map_err(|_| self.error(format!("{word:?} in {what} is not a number")));
        let numbers: Vec<T> = line.split_ascii_whitespace().map(parse).collect::<Result<_, _>>()?;
        if numbers.len() < least {
            return Err(self.error(format!("{what}: expected {least} numbers, got {}", numbers.len())));
        }
        Ok(numbers)
    }

    fn close(&mut self, section: &str) -> Result<(), MeshError> {
        let line = self.expect(section)?;
        if line == section {
            return Ok(());
        }
        Err(self.error(format!("expected {section}, got {:?}", shortened(line))))
    }
}

fn shortened(line: &str) -> String {
    line.chars().take(40).collect()
}

/// Elements of one entity.
struct Block {
    dimension: u8,
    entity: i64,
    /// Node tags, `dimension + 1` per element.
    nodes: Vec<u64>,
}

#[derive(Default)]
struct MshFile {
    names: BTreeMap<(u8, i64), String>,
    /// Physical tags of each entity.
    physical: HashMap<(u8, i64), Vec<i64>>,
    nodes: HashMap<u64, [f64; 3]>,
    blocks: Vec<Block>,
}

impl MshFile {
    fn read(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        if lines.expect("$MeshFormat")? != "$MeshFormat" {
            return Err(lines.error("not an MSH file: it does not begin with $MeshFormat"));
        }
        let is_old = read_format(lines)? == Version::V2;
        while let Some(line) = lines.next() {
            match line {
                "$PhysicalNames" => self.read_names(lines)?,
                "$Entities" => self.read_entities(lines)?,
                "$Nodes" if is_old => self.read_old_nodes(lines)?,
                "$Elements" if is_old => self.read_old_elements(lines)?,
                "$Nodes" => self.read_nodes(lines)?,
                "$Elements" => self.read_elements(lines)?,
                other if other.starts_with('$') && !other.starts_with("$End") => skip(lines, other)?,
                other => return Err(lines.error(format!("expected a section, got {:?}", shortened(other)))),
            }
        }
        Ok(())
    }

    /// `dimension tag "name"` lines.
    fn read_names(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let count = lines.numbers::<usize>("the number of physical names", 1)?[0];
        for _ in 0..count {
            let line = lines.expect("a physical name")?;
            let mut words = line.splitn(3, char::is_whitespace);
            let (dimension, tag) =
                (words.next().and_then(|w| w.parse().ok()), words.next().and_then(|w| w.parse().ok()));
            let name = words.next().map(|name| name.trim().trim_matches('"'));
            let (Some(dimension), Some(tag), Some(name)) = (dimension, tag, name) else {
                let got = shortened(line);
                return Err(lines.error(format!("expected dimension, tag and \"name\", got {got:?}")));
            };
            self.names.insert((dimension, tag), name.to_string());
        }
        lines.close("$EndPhysicalNames")
    }

    /// Points: tag, x y z, tags. Others: tag, six bounds, tags, boundary.
    fn read_entities(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let counts = lines.numbers::<usize>("the numbers of entities", 4)?;
        for (dimension, &count) in counts.iter().take(4).enumerate() {
            let tags_at = if dimension == 0 { 4 } else { 7 };
            for _ in 0..count {
                let line = lines.numbers::<f64>("an entity", tags_at + 1)?;
                let tags = line[tags_at + 1..].iter();
                let physical: Vec<i64> = tags.take(line[tags_at] as usize).map(|&tag| tag as i64).collect();
                if physical.len() as f64 != line[tags_at] {
                    let got = physical.len();
                    return Err(lines.error(format!("expected {} physical tags, got {got}", line[tags_at])));
                }
                self.physical.insert((dimension as u8, line[0] as i64), physical);
            }
        }
        lines.close("$EndEntities")
    }

    fn read_nodes(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let blocks = lines.numbers::<usize>("the header of $Nodes", 4)?[0];
        for _ in 0..blocks {
            let header = lines.numbers::<i64>("a block of nodes", 4)?;
            let mut tags = Vec::new();
            for _ in 0..header[3] {
                tags.push(lines.numbers::<u64>("a node tag", 1)?[0]);
            }
            for tag in tags {
                let xyz = lines.numbers::<f64>("node coordinates", 3)?;
                self.put_node(tag, [xyz[0], xyz[1], xyz[2]]).map_err(|reason| lines.error(reason))?;
            }
        }
        lines.close("$EndNodes")
    }

    fn put_node(&mut self, tag: u64, xyz: [f64; 3]) -> Result<(), String> {
        if let Some(value) = xyz.iter().find(|value| !value.is_finite()) {
            return Err(format!("node {tag}: coordinate {value} is not finite"));
        }
        match self.nodes.insert(tag, xyz) {
            Some(_) => Err(format!("node {tag} is given twice")),
            None => Ok(()),
        }
    }

    /// Version 2.2: `tag x y z` lines.
    fn read_old_nodes(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let count = lines.numbers::<usize>("the number of nodes", 1)?[0];
        for _ in 0..count {
            let line = lines.numbers::<f64>("a node", 4)?;
            if !(line[0] >= 0.0 && line[0] < 1e15) {
                return Err(lines.error(format!("{} is not a node number", line[0])));
            }
            self.put_node(line[0] as u64, [line[1], line[2], line[3]]).map_err(|reason| lines.error(reason))?;
        }
        lines.close("$EndNodes")
    }

    /// Version 2.2: `tag type count tags... nodes...` lines; the first tag is the physical group.
    fn read_old_elements(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let count = lines.numbers::<usize>("the number of elements", 1)?[0];
        for _ in 0..count {
            let line = lines.numbers::<u64>("an element", 3)?;
            let dimension = dimension_of(line[1] as i64).map_err(|reason| lines.error(reason))?;
            let tags = usize::try_from(line[2]).unwrap_or(usize::MAX);
            let nodes = line.get(tags.saturating_add(3)..).unwrap_or(&[]);
            if nodes.len() != usize::from(dimension) + 1 {
                let expected = dimension + 1;
                return Err(lines.error(format!(
                    "element {}: expected {expected} nodes, got {}",
                    line[0],
                    nodes.len()
                )));
            }
            let group = if tags > 0 { line[3] as i64 } else { 0 };
            self.put_element(dimension, group, line[0], nodes).map_err(|reason| lines.error(reason))?;
        }
        lines.close("$EndElements")
    }

    /// Adds an element of version 2.2 that belongs to a physical group (0 for none).
    fn put_element(&mut self, dimension: u8, group: i64, element: u64, nodes: &[u64]) -> Result<(), String> {
        if let Some(node) = nodes.iter().find(|node| !self.nodes.contains_key(node)) {
            return Err(format!("element {element} names node {node}, which does not exist"));
        }
        if group != 0 {
            self.physical.entry((dimension, group)).or_insert_with(|| vec![group]);
        }
        match self.blocks.last_mut() {
            Some(block) if block.dimension == dimension && block.entity == group => block.nodes.extend(nodes),
            _ => self.blocks.push(Block { dimension, entity: group, nodes: nodes.to_vec() }),
        }
        Ok(())
    }

    fn read_elements(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let blocks = lines.numbers::<usize>("the header of $Elements", 4)?[0];
        for _ in 0..blocks {
            let header = lines.numbers::<i64>("a block of elements", 4)?;
            let dimension = dimension_of(header[2]).map_err(|reason| lines.error(reason))?;
            let mut block = Block { dimension, entity: header[1], nodes: Vec::new() };
            for _ in 0..header[3] {
                let line = lines.numbers::<u64>("an element", dimension as usize + 2)?;
                let nodes = &line[1..dimension as usize + 2];
                if let Some(node) = nodes.iter().find(|node| !self.nodes.contains_key(node)) {
                    return Err(lines.error(format!("element {} names node {node}, which does not exist", line[0])));
                }
                block.nodes.extend(nodes);
            }
            self.blocks.push(block);
        }
        lines.close("$EndElements")
    }

    fn into_mesh(self, groups: &ElectrodeGroups, contact_impedance: &[f64]) -> Result<ElectrodedMesh, MeshError> {
        let has = |dimension: u8| self.blocks.iter().any(|b| b.dimension == dimension && !b.nodes.is_empty());
        let (kind, dimension) = if has(3) { (CellKind::Tetrahedron, 3) } else { (CellKind::Triangle, 2) };
        let mut numbers: HashMap<u64, u32> = HashMap::new();
        let (mut nodes, mut elements) = (Vec::new(), Vec::new());
        let domain = self.blocks.iter().filter(|block| block.dimension == dimension);
        for tag in domain.flat_map(|block| &block.nodes) {
            let number = *numbers.entry(*tag).or_insert_with(|| {
                nodes.push(self.nodes.get(tag).copied().unwrap_or_default());
                nodes.len() as u32 - 1
            });
            elements.push(number);
        }
        let mesh = Mesh::new(kind, nodes, elements)?;
        let groups = self.electrode_groups(groups)?;
        let impedances = spread(contact_impedance, groups.len())?;
        let mut electrodes = Vec::with_capacity(groups.len());
        for (index, (group, contact_impedance)) in groups.into_iter().zip(impedances).enumerate() {
            let contact = self
                .contact(group, dimension, &numbers)
                .map_err(|reason| MeshError::Electrode { electrode: index, reason })?;
            electrodes.push(Electrode { contact, contact_impedance });
        }
        ElectrodedMesh::new(mesh, electrodes)
    }

    fn electrode_groups(&self, groups: &ElectrodeGroups) -> Result<Vec<(u8, i64)>, MeshError> {
        let prefix = match groups {
            ElectrodeGroups::Tags(tags) => return Ok(tags.clone()),
            ElectrodeGroups::Prefix(prefix) => prefix,
        };
        let number = |name: &str| {
            let rest = name.strip_prefix(prefix.as_str())?;
            rest.trim_start_matches(['_', '-', ' ', '.']).parse::<u64>().ok()
        };
        let mut found: Vec<(u64, (u8, i64))> =
            self.names.iter().filter_map(|(&group, name)| number(name).map(|n| (n, group))).collect();
        found.sort_unstable();
        if let Some(pair) = found.windows(2).find(|pair| pair[0].0 == pair[1].0) {
            let value = format!("{prefix}{}", pair[0].0);
            return Err(MeshError::Shape { field: "physical name", value, expected: "given to one group only".into() });
        }
        Ok(found.into_iter().map(|(_, group)| group).collect())
    }

    fn contact(&self, group: (u8, i64), domain: u8, numbers: &HashMap<u64, u32>) -> Result<Contact, String> {
        let (dimension, tag) = group;
        let belongs = |block: &Block| {
            let physical = self.physical.get(&(block.dimension, block.entity));
            block.dimension == dimension
                && physical.is_some_and(|tags| tags.iter().any(|t| t.unsigned_abs() == tag.unsigned_abs()))
        };
        if dimension == domain && domain == 2 {
            let mut elements = Vec::new();
            let mut next = 0;
            for block in self.blocks.iter().filter(|block| block.dimension == domain) {
                let count = block.nodes.len() as u32 / 3;
                if belongs(block) {
                    elements.extend(next..next + count);
                }
                next += count;
            }
            return Ok(Contact::Area(elements));
        }
        let mut faces = Vec::new();
        for cell in self.blocks.iter().filter(|b| belongs(b)).flat_map(|b| b.nodes.chunks_exact(dimension as usize + 1))
        {
            let known = |tag: &u64| numbers.get(tag).copied().ok_or(format!("node {tag} belongs to no element"));
            faces.push(cell.iter().map(known).collect::<Result<Vec<u32>, String>>()?);
        }
        match (dimension, faces.as_slice()) {
            (_, []) => Err(format!("physical group {tag} of dimension {dimension} has no elements")),
            (0, [node]) => Ok(Contact::Point(node[0])),
            (0, several) => Err(format!("physical group {tag} has {} points, expected 1", several.len())),
            _ if dimension + 1 == domain => Ok(Contact::Faces(faces)),
            _ => {
                Err(format!("physical group {tag} has dimension {dimension}, which does not fit the domain's {domain}"))
            }
        }
    }
}

/// Dimension of the elements of a Gmsh type.
fn dimension_of(kind: i64) -> Result<u8, String> {
    match kind {
        15 => Ok(0),
        1 => Ok(1),
        2 => Ok(2),
        4 => Ok(3),
        other => {
            let known = "1 (lines), 2 (triangles), 4 (tetrahedra) and 15 (points)";
            Err(format!("element type {other} cannot be read; known are {known}"))
        }
    }
}

/// Versions of the format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Version {
    V2,
    V4,
}

impl Version {
    fn of(word: &str) -> Option<Self> {
        match word {
            "2" | "2.0" | "2.1" | "2.2" => Some(Self::V2),
            "4.1" => Some(Self::V4),
            _ => None,
        }
    }
}

fn read_format(lines: &mut Lines) -> Result<Version, MeshError> {
    let line = lines.expect("the version")?;
    let mut words = line.split_ascii_whitespace();
    let version = words.next().and_then(Version::of);
    match (version, words.next()) {
        (Some(version), Some("0")) => lines.close("$EndMeshFormat").map(|()| version),
        _ => {
            let got = shortened(line);
            Err(lines.error(format!("expected version 2.2 or 4.1 (\"4.1 0 8\"), got {got:?}; save it as one of these")))
        }
    }
}

fn skip(lines: &mut Lines, section: &str) -> Result<(), MeshError> {
    let end = format!("$End{}", &section[1..]);
    while lines.expect(&end)? != end {}
    Ok(())
}

#[cfg(test)]
mod tests;
