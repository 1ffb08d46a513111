//! Reads meshes in Gmsh's MSH 4.1 text format (Gmsh reference manual, "MSH file format"): nodes, first-order triangles
//! and tetrahedra, and electrodes from physical groups. The domain is all tetrahedra, or all triangles where there are
//! none. Sections that are not needed are skipped; sizes claimed in the text reserve no memory.

use std::collections::{BTreeMap, HashMap};

use super::core::{CellKind, Contact, Electrode, ElectrodedMesh, Mesh, MeshError};
use super::sheet::spread;

/// Which physical groups are electrodes. A group of dimension one below the domain's is a contact of faces, one of the
/// domain's own dimension (sheets) a contact of area, one of dimension 0 a point.
#[derive(Clone, Debug, PartialEq)]
pub enum ElectrodeGroups {
    /// Groups whose name is this prefix and a number, in the numbers' order: `electrode` takes `electrode1`,
    /// `electrode_2`, `electrode 16`.
    Prefix(String),
    /// These groups, given by dimension and physical tag, in this order.
    Tags(Vec<(u8, i64)>),
}

/// Reads a mesh and its electrodes. `contact_impedance` holds one value for all electrodes or one each.
///
/// # Errors
/// With the line number, whatever the format does not allow or this reader does not know (binary files, other versions,
/// elements of higher order); and everything [`Mesh::new`] and [`ElectrodedMesh::new`] refuse.
pub fn read_msh(
    bytes: &[u8],
    groups: &ElectrodeGroups,
    contact_impedance: &[f64],
) -> Result<ElectrodedMesh, MeshError> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let line = 1 + bytes[..error.valid_up_to()].iter().filter(|&&byte| byte == b'\n').count();
        MeshError::Parse { line, reason: "not text; binary MSH files cannot be read, save as ASCII".into() }
    })?;
    let mut file = MshFile::default();
    file.read(&mut Lines::new(text))?;
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
    /// Node tags, `dimension + 1` an element.
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
        read_format(lines)?;
        while let Some(line) = lines.next() {
            match line {
                "$PhysicalNames" => self.read_names(lines)?,
                "$Entities" => self.read_entities(lines)?,
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
                if let Some(value) = xyz[..3].iter().find(|value| !value.is_finite()) {
                    return Err(lines.error(format!("node {tag}: coordinate {value} is not finite")));
                }
                if self.nodes.insert(tag, [xyz[0], xyz[1], xyz[2]]).is_some() {
                    return Err(lines.error(format!("node {tag} is given twice")));
                }
            }
        }
        lines.close("$EndNodes")
    }

    fn read_elements(&mut self, lines: &mut Lines) -> Result<(), MeshError> {
        let blocks = lines.numbers::<usize>("the header of $Elements", 4)?[0];
        for _ in 0..blocks {
            let header = lines.numbers::<i64>("a block of elements", 4)?;
            let dimension = match header[2] {
                15 => 0,
                1 => 1,
                2 => 2,
                4 => 3,
                other => {
                    let known = "1 (lines), 2 (triangles), 4 (tetrahedra) and 15 (points)";
                    return Err(lines.error(format!("element type {other} cannot be read; known are {known}")));
                }
            };
            let mut block = Block { dimension, entity: header[1], nodes: Vec::new() };
            for _ in 0..header[3] {
                let line = lines.numbers::<u64>("an element", dimension as usize + 2)?;
                let nodes = &line[1..dimension as usize + 2];
                if let Some(node) = nodes.iter().find(|node| !self.nodes.contains_key(node)) {
                    return Err(lines.error(format!("element {} names node {node}, which is not there", line[0])));
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

fn read_format(lines: &mut Lines) -> Result<(), MeshError> {
    let line = lines.expect("the version")?;
    let words: Vec<&str> = line.split_ascii_whitespace().collect();
    match words[..] {
        ["4.1", "0", ..] => lines.close("$EndMeshFormat"),
        ["4.1", "1", ..] => Err(lines.error("binary MSH files cannot be read, save as ASCII")),
        _ => Err(lines.error(format!("expected version 4.1 in ASCII (\"4.1 0 8\"), got {:?}", shortened(line)))),
    }
}

fn skip(lines: &mut Lines, section: &str) -> Result<(), MeshError> {
    let end = format!("$End{}", &section[1..]);
    while lines.expect(&end)? != end {}
    Ok(())
}

#[cfg(test)]
mod tests;
