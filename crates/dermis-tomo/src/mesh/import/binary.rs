//! Binary MSH files: raw numbers between sections that start with lines of text.

use super::{Lines, MshFile, Version, dimension_of};
use crate::mesh::MeshError;

impl MshFile {
    /// True if the header says that the file is binary.
    pub(super) fn is_binary(bytes: &[u8]) -> bool {
        let mut lines = bytes.split(|&byte| byte == b'\n');
        let is_msh = lines.next().is_some_and(|line| line.trim_ascii() == b"$MeshFormat");
        let format = lines.next().unwrap_or_default();
        is_msh && format.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty()).nth(1) == Some(b"1")
    }

    /// Reads a file for which [`MshFile::is_binary`] is true.
    pub(super) fn read_binary(&mut self, bytes: &[u8]) -> Result<(), MeshError> {
        let mut input = Bytes { bytes, at: 0, line: 0, is_big: false };
        input.line();
        let format = input.line().unwrap_or_default();
        let words: Vec<&str> = format.split_ascii_whitespace().collect();
        let version = words.first().and_then(|word| Version::of(word));
        let (Some(version), Some(&"8")) = (version, words.get(2)) else {
            return Err(input.error(format!("expected version 2.2 or 4.1 (\"4.1 1 8\"), got {format:?}")));
        };
        input.is_big = match input.take::<4>("the number one")? {
            [1, 0, 0, 0] => false,
            [0, 0, 0, 1] => true,
            other => return Err(input.error(format!("{other:?} is not the number one in either byte order"))),
        };
        input.close("$EndMeshFormat")?;
        while let Some(section) = input.line() {
            match (section.as_str(), version) {
                ("", _) => {}
                ("$PhysicalNames", _) => {
                    let text = input.section("$EndPhysicalNames")?;
                    let text = std::str::from_utf8(text).map_err(|_| input.error("names that are not text"))?;
                    let text = format!("{text}\n$EndPhysicalNames\n");
                    self.read_names(&mut Lines::new(&text))?;
                }
                ("$Entities", Version::V4) => entities(self, &mut input)?,
                ("$Nodes", Version::V4) => nodes(self, &mut input)?,
                ("$Elements", Version::V4) => elements(self, &mut input)?,
                ("$Nodes", Version::V2) => old_nodes(self, &mut input)?,
                ("$Elements", Version::V2) => old_elements(self, &mut input)?,
                (other, _) if other.starts_with('$') && !other.starts_with("$End") => {
                    input.section(&format!("$End{}", &other[1..]))?;
                }
                (other, _) => return Err(input.error(format!("expected a section, got {:?}", super::shortened(other)))),
            }
        }
        Ok(())
    }
}

/// Points: tag, x y z, groups. Others: tag, six bounds, groups, boundary.
fn entities(file: &mut MshFile, input: &mut Bytes<'_>) -> Result<(), MeshError> {
    let mut counts = [0; 4];
    for count in &mut counts {
        *count = input.size("the numbers of entities")?;
    }
    for (dimension, count) in counts.into_iter().enumerate() {
        for _ in 0..count {
            let tag = i64::from(input.int("an entity")?);
            for _ in 0..if dimension == 0 { 3 } else { 6 } {
                input.double("an entity")?;
            }
            let groups = input.size("groups of an entity")?;
            let groups = (0..groups).map(|_| input.int("groups of an entity").map(i64::from));
            let groups = groups.collect::<Result<Vec<i64>, MeshError>>()?;
            file.physical.insert((dimension as u8, tag), groups);
            if dimension > 0 {
                for _ in 0..input.size("the boundary of an entity")? {
                    input.int("the boundary of an entity")?;
                }
            }
        }
    }
    input.close("$EndEntities")
}

fn nodes(file: &mut MshFile, input: &mut Bytes<'_>) -> Result<(), MeshError> {
    let blocks = input.header("the header of $Nodes")?;
    for _ in 0..blocks {
        let dimension = input.int("a block of nodes")?;
        input.int("a block of nodes")?;
        let is_parametric = input.int("a block of nodes")? != 0;
        let count = input.size("a block of nodes")?;
        let tags = (0..count).map(|_| input.unsigned("a node tag")).collect::<Result<Vec<u64>, MeshError>>()?;
        for tag in tags {
            let mut xyz = [0.0; 3];
            for value in &mut xyz {
                *value = input.double("node coordinates")?;
            }
            for _ in 0..if is_parametric { dimension } else { 0 } {
                input.double("node coordinates")?;
            }
            file.put_node(tag, xyz).map_err(|reason| input.error(reason))?;
        }
    }
    input.close("$EndNodes")
}

fn elements(file: &mut MshFile, input: &mut Bytes<'_>) -> Result<(), MeshError> {
    let blocks = input.header("the header of $Elements")?;
    for _ in 0..blocks {
        input.int("a block of elements")?;
        let entity = i64::from(input.int("a block of elements")?);
        let kind = i64::from(input.int("a block of elements")?);
        let dimension = dimension_of(kind).map_err(|reason| input.error(reason))?;
        let count = input.size("a block of elements")?;
        let mut block = super::Block { dimension, entity, nodes: Vec::new() };
        for _ in 0..count {
            let element = input.unsigned("an element")?;
            for _ in 0..=dimension {
                let node = input.unsigned("an element")?;
                if !file.nodes.contains_key(&node) {
                    return Err(input.error(format!("element {element} names node {node}, which does not exist")));
                }
                block.nodes.push(node);
            }
        }
        file.blocks.push(block);
    }
    input.close("$EndElements")
}

/// Version 2.2: a line with the count, then a tag (int) and three doubles each.
fn old_nodes(file: &mut MshFile, input: &mut Bytes<'_>) -> Result<(), MeshError> {
    for _ in 0..input.count("the number of nodes")? {
        let tag = input.int("a node tag")?;
        let mut xyz = [0.0; 3];
        for value in &mut xyz {
            *value = input.double("node coordinates")?;
        }
        let tag = u64::try_from(tag).map_err(|_| input.error(format!("{tag} is not a node number")))?;
        file.put_node(tag, xyz).map_err(|reason| input.error(reason))?;
    }
    input.close("$EndNodes")
}

/// Version 2.2: a line with the count, then blocks of one type and number of tags.
fn old_elements(file: &mut MshFile, input: &mut Bytes<'_>) -> Result<(), MeshError> {
    let mut left = input.count("the number of elements")?;
    while left > 0 {
        let kind = i64::from(input.int("a block of elements")?);
        let dimension = dimension_of(kind).map_err(|reason| input.error(reason))?;
        let (count, tags) = (input.int("a block of elements")?, input.int("a block of elements")?);
        let count = usize::try_from(count).ok().filter(|count| (1..=left).contains(count));
        let (Some(count), 0..=1000) = (count, tags) else {
            return Err(input.error("a block of elements: its count and number of tags make no sense"));
        };
        for _ in 0..count {
            let element = input.int("an element")? as u64;
            let mut group = 0;
            for tag in 0..tags {
                let value = i64::from(input.int("tags of an element")?);
                group = if tag == 0 { value } else { group };
            }
            let nodes = (0..=dimension).map(|_| input.int("an element").map(|node| node as u64));
            let nodes = nodes.collect::<Result<Vec<u64>, MeshError>>()?;
            file.put_element(dimension, group, element, &nodes).map_err(|reason| input.error(reason))?;
        }
        left -= count;
    }
    input.close("$EndElements")
}

/// The unread rest of a file.
struct Bytes<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Number of text lines read.
    line: usize,
    is_big: bool,
}

impl<'a> Bytes<'a> {
    fn error(&self, reason: impl Into<String>) -> MeshError {
        let reason = format!("{} (at byte {} of a binary file)", reason.into(), self.at);
        MeshError::Parse { line: self.line, reason }
    }

    fn take<const N: usize>(&mut self, what: &str) -> Result<[u8; N], MeshError> {
        let part = self.bytes.get(self.at..self.at.saturating_add(N)).and_then(|part| part.try_into().ok());
        let part = part.ok_or_else(|| self.error(format!("the file ends where {what} should be")))?;
        self.at += N;
        Ok(part)
    }

    fn int(&mut self, what: &str) -> Result<i32, MeshError> {
        let part = self.take(what)?;
        Ok(if self.is_big { i32::from_be_bytes(part) } else { i32::from_le_bytes(part) })
    }

    fn unsigned(&mut self, what: &str) -> Result<u64, MeshError> {
        let part = self.take(what)?;
        Ok(if self.is_big { u64::from_be_bytes(part) } else { u64::from_le_bytes(part) })
    }

    fn double(&mut self, what: &str) -> Result<f64, MeshError> {
        Ok(f64::from_bits(self.unsigned(what)?))
    }

    /// A count of following items, at most the number of bytes left.
    fn size(&mut self, what: &str) -> Result<usize, MeshError> {
        let size = self.unsigned(what)?;
        let left = self.bytes.len() - self.at;
        usize::try_from(size)
            .ok()
            .filter(|size| *size <= left)
            .ok_or_else(|| self.error(format!("{what}: {size} of them, but only {left} bytes are left")))
    }

    /// Number of blocks, followed by three numbers that are not needed.
    fn header(&mut self, what: &str) -> Result<usize, MeshError> {
        let blocks = self.size(what)?;
        for _ in 0..3 {
            self.unsigned(what)?;
        }
        Ok(blocks)
    }

    /// The next line of text, without its end.
    fn line(&mut self) -> Option<String> {
        let rest = self.bytes.get(self.at..).filter(|rest| !rest.is_empty())?;
        let length = rest.iter().position(|&byte| byte == b'\n').unwrap_or(rest.len());
        self.at += (length + 1).min(rest.len());
        self.line += 1;
        Some(String::from_utf8_lossy(&rest[..length]).trim().to_string())
    }

    /// A line that contains a number.
    fn count(&mut self, what: &str) -> Result<usize, MeshError> {
        let line = self.line().unwrap_or_default();
        let left = self.bytes.len() - self.at;
        let count = line.parse::<usize>().ok().filter(|count| *count <= left);
        count.ok_or_else(|| self.error(format!("{what}: {:?} makes no sense", super::shortened(&line))))
    }

    /// The line that closes a section, after the line end of its numbers.
    fn close(&mut self, section: &str) -> Result<(), MeshError> {
        let mut line = self.line().unwrap_or_default();
        if line.is_empty() {
            line = self.line().unwrap_or_default();
        }
        if line == section {
            return Ok(());
        }
        Err(self.error(format!("expected {section}, got {:?}", super::shortened(&line))))
    }

    /// All bytes up to the line that closes a section.
    fn section(&mut self, end: &str) -> Result<&'a [u8], MeshError> {
        let rest = &self.bytes[self.at..];
        let found = rest.windows(end.len()).position(|part| part == end.as_bytes());
        let length = found.ok_or_else(|| self.error(format!("the file ends where {end} should be")))?;
        self.at += length;
        self.line();
        Ok(&rest[..length])
    }
}
