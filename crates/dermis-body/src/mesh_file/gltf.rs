//! glTF 2.0, as JSON with its buffers in other files or in itself, and as GLB.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path};

use serde::Deserialize;

use super::bounded_read::read_whole;
use super::numbers::{Affine, Placed, fan, strip};

/// Extensions under which corners are read as without them.
const HARMLESS: [&str; 2] = ["KHR_mesh_quantization", "KHR_texture_transform"];
/// Modes of primitives with triangles.
const TRIANGLES: u32 = 4;
const STRIP: u32 = 5;
const FAN: u32 = 6;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase", default)]
#[derive(Default)]
struct Document {
    scene: usize,
    scenes: Vec<Scene>,
    nodes: Vec<Node>,
    meshes: Vec<Mesh>,
    accessors: Vec<Accessor>,
    buffer_views: Vec<View>,
    buffers: Vec<Buffer>,
    extensions_required: Vec<String>,
}

#[derive(Deserialize)]
struct Scene {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    /// Column after column.
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
}

impl Node {
    fn transform(&self) -> Affine {
        if let Some(m) = &self.matrix {
            return Affine(std::array::from_fn(|row| std::array::from_fn(|column| m[4 * column + row])));
        }
        let moved = Affine::translation(self.translation.unwrap_or_default());
        let turned = self.rotation.map_or(Affine::IDENTITY, Affine::rotation);
        moved.after(&turned).after(&self.scale.map_or(Affine::IDENTITY, Affine::scale))
    }
}

#[derive(Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    indices: Option<usize>,
    #[serde(default = "triangles")]
    mode: u32,
}

fn triangles() -> u32 {
    TRIANGLES
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
    sparse: Option<serde_json::Value>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct View {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    byte_stride: Option<usize>,
}

#[derive(Deserialize)]
struct Buffer {
    uri: Option<String>,
}

/// Corners of the triangles of the default scene, metres.
///
/// # Errors
/// Malformed JSON, references or buffers, and extensions that change how corners are stored. The message says what was
/// expected.
pub(super) fn read(file: &Path, bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let (json, chunk) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
    let document: Document = serde_json::from_slice(json).map_err(|error| format!("{error}: expected glTF 2.0"))?;
    if let Some(name) = document.extensions_required.iter().find(|name| !HARMLESS.contains(&name.as_str())) {
        return Err(format!("extension {name}: expected a mesh without it"));
    }
    let buffers = document.buffers.iter().enumerate().map(|(number, buffer)| match (&buffer.uri, chunk) {
        (Some(uri), _) => fetch(file, uri).map(Cow::Owned),
        (None, Some(chunk)) if number == 0 => Ok(Cow::Borrowed(chunk)),
        (None, _) => Err(format!("buffer {number}: expected an uri")),
    });
    let buffers: Vec<Cow<[u8]>> = buffers.collect::<Result<_, _>>()?;
    let mut placed = Placed::default();
    let reader = Reader { document: &document, buffers: &buffers };
    for node in document.roots() {
        reader.add_node(node, &Affine::IDENTITY, 0, &mut placed)?;
    }
    Ok(placed.corners)
}

impl Document {
    /// The nodes of the default scene; without scenes, those that no other node has as a child.
    fn roots(&self) -> Vec<usize> {
        if let Some(scene) = self.scenes.get(self.scene).or(self.scenes.first()) {
            return scene.nodes.clone();
        }
        let children: BTreeSet<usize> = self.nodes.iter().flat_map(|node| node.children.iter().copied()).collect();
        (0..self.nodes.len()).filter(|number| !children.contains(number)).collect()
    }
}

/// The JSON and the binary chunk of a GLB file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), String> {
    let word = |at: usize| bytes.get(at..at + 4).and_then(|word| word.try_into().ok()).map(u32::from_le_bytes);
    let chunk = |at: usize, kind: &[u8; 4]| {
        let length = word(at)? as usize;
        let is_it = bytes.get(at + 4..at + 8)? == kind;
        bytes.get(at + 8..at.checked_add(8 + length)?).filter(|_| is_it)
    };
    let version = word(4).ok_or("expected the header of a GLB file")?;
    if version != 2 {
        return Err(format!("version {version}: expected 2"));
    }
    let json = chunk(12, b"JSON").ok_or("expected a whole JSON chunk")?;
    Ok((json, chunk(20 + json.len(), b"BIN\0")))
}

/// Content of a buffer, which is in the file itself or in another one.
fn fetch(file: &Path, uri: &str) -> Result<Vec<u8>, String> {
    if let Some(data) = uri.strip_prefix("data:") {
        let coded = data.split_once(";base64,").map(|(_, coded)| coded);
        return coded.and_then(base64).ok_or_else(|| "buffer in the file: expected base64".to_owned());
    }
    let name = percent_decoded(uri);
    let path = Path::new(&name);
    // A mesh from elsewhere may not read other folders.
    if uri.contains("://") || path.components().any(|part| !matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(format!("buffer {uri}: expected a file in the folder of the mesh or below"));
    }
    read_whole(&file.with_file_name("").join(path)).map_err(|reason| format!("buffer {uri}: {reason}"))
}

fn percent_decoded(uri: &str) -> String {
    let mut decoded = Vec::with_capacity(uri.len());
    let mut rest = uri.as_bytes();
    while let [first, others @ ..] = rest {
        let two = others.get(..2).filter(|_| *first == b'%').and_then(|two| std::str::from_utf8(two).ok());
        match two.and_then(|two| u8::from_str_radix(two, 16).ok()) {
            Some(byte) => {
                decoded.push(byte);
                rest = &others[2..];
            }
            None => {
                decoded.push(*first);
                rest = others;
            }
        }
    }
    String::from_utf8_lossy(&decoded).into_owned()
}

fn base64(text: &str) -> Option<Vec<u8>> {
    let (mut bytes, mut bits, mut count) = (Vec::with_capacity(text.len() * 3 / 4), 0_u32, 0);
    for letter in text.trim_end_matches('=').bytes() {
        let value = match letter {
            b'A'..=b'Z' => letter - b'A',
            b'a'..=b'z' => letter - b'a' + 26,
            b'0'..=b'9' => letter - b'0' + 52,
            b'+' => 62,
            b'/' => 63,
            _ => return None,
        };
        (bits, count) = (bits << 6 | u32::from(value), count + 6);
        if count >= 8 {
            count -= 8;
            bytes.push((bits >> count) as u8);
        }
    }
    Some(bytes)
}

struct Reader<'a> {
    document: &'a Document,
    buffers: &'a [Cow<'a, [u8]>],
}

impl Reader<'_> {
    fn add_node(&self, number: usize, above: &Affine, depth: usize, placed: &mut Placed) -> Result<(), String> {
        let node = self.document.nodes.get(number).ok_or_else(|| format!("node {number}: expected a known one"))?;
        placed.enter(depth).map_err(|reason| format!("node {number}: {reason}"))?;
        let transform = above.after(&node.transform());
        if let Some(mesh) = node.mesh {
            let unknown = || format!("mesh {mesh}: expected a known one");
            for primitive in &self.document.meshes.get(mesh).ok_or_else(unknown)?.primitives {
                let corners = self.corners(primitive, placed).map_err(|reason| format!("mesh {mesh}: {reason}"))?;
                placed.add(&corners, &transform)?;
            }
        }
        node.children.iter().try_for_each(|child| self.add_node(*child, &transform, depth + 1, placed))
    }

    fn corners(&self, primitive: &Primitive, placed: &mut Placed) -> Result<Vec<[f32; 3]>, String> {
        if ![TRIANGLES, STRIP, FAN].contains(&primitive.mode) {
            // Points and lines.
            return Ok(Vec::new());
        }
        let position = primitive.attributes.get("POSITION").ok_or("expected positions")?;
        let numbers = self.numbers(*position, "VEC3")?;
        placed.read(numbers.len())?;
        let points: Vec<[f32; 3]> =
            numbers.chunks_exact(3).map(|xyz| [xyz[0], xyz[1], xyz[2]].map(|v| v as f32)).collect();
        let corners = match primitive.indices {
            None => points,
            Some(indices) => {
                let point = |index: &f64| points.get(*index as usize).copied();
                let numbers = self.numbers(indices, "SCALAR")?;
                placed.read(numbers.len())?;
                let corners: Option<Vec<_>> = numbers.iter().map(point).collect();
                corners.ok_or("expected indices of known vertices")?
            }
        };
        Ok(match primitive.mode {
            STRIP => strip(&corners).collect(),
            FAN => fan(&corners).collect(),
            _ => corners[..corners.len() / 3 * 3].to_vec(),
        })
    }

    /// The numbers of an accessor of a kind, one vector after the other.
    fn numbers(&self, number: usize, kind: &str) -> Result<Vec<f64>, String> {
        let fault = |expected: &str| format!("accessor {number}: expected {expected}");
        let accessor = self.document.accessors.get(number).ok_or_else(|| fault("a known one"))?;
        if accessor.sparse.is_some() || accessor.kind != kind {
            return Err(fault(&format!("{kind}, not sparse")));
        }
        let view = accessor.buffer_view.and_then(|view| self.document.buffer_views.get(view));
        let view = view.ok_or_else(|| fault("a known view of a buffer"))?;
        let end = view.byte_offset.checked_add(view.byte_length);
        let buffer = self.buffers.get(view.buffer).zip(end);
        let bytes = buffer.and_then(|(buffer, end)| buffer.get(view.byte_offset..end));
        let bytes = bytes.ok_or_else(|| fault("a view within its buffer"))?;
        let size = match accessor.component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            other => return Err(fault(&format!("a component type of glTF 2.0, got {other}"))),
        };
        let parts = if kind == "VEC3" { 3 } else { 1 };
        let stride = view.byte_stride.filter(|stride| *stride > 0).unwrap_or(size * parts);
        let mut values = Vec::new();
        for k in 0..accessor.count {
            for part in 0..parts {
                let at = accessor.byte_offset.saturating_add(k.saturating_mul(stride)).saturating_add(part * size);
                let word = at.checked_add(size).and_then(|end| bytes.get(at..end));
                values.push(component(word.ok_or_else(|| fault("values within its view"))?, accessor));
            }
        }
        Ok(values)
    }
}

/// A number of a valid component type, from its bytes.
fn component(bytes: &[u8], accessor: &Accessor) -> f64 {
    let mut word = [0; 4];
    word[..bytes.len()].copy_from_slice(bytes);
    let word = u32::from_le_bytes(word);
    let (value, most) = match accessor.component_type {
        5120 => (f64::from(word as u8 as i8), 127.0),
        5121 => (f64::from(word as u8), 255.0),
        5122 => (f64::from(word as u16 as i16), 32767.0),
        5123 => (f64::from(word as u16), 65535.0),
        5125 => (f64::from(word), f64::from(u32::MAX)),
        _ => return f64::from(f32::from_bits(word)),
    };
    if accessor.normalized { (value / most).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A triangle that is moved by 1 along x and enlarged twofold, and the buffer of its corners and indices.
    const DOCUMENT: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [1]}],
        "nodes": [{"mesh": 0, "scale": [2, 2, 2]}, {"children": [0], "translation": [1, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
                      {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 6}],
        "buffers": [{BUFFER"byteLength": 42}]}"#;
    const CORNERS: [[f32; 3]; 3] = [[1.0, 0.0, 0.0], [3.0, 0.0, 0.0], [1.0, 2.0, 1.0]];

    fn buffer() -> Vec<u8> {
        let numbers = [0.0_f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5];
        let indices = [0_u16, 1, 2];
        numbers.iter().flat_map(|v| v.to_le_bytes()).chain(indices.iter().flat_map(|v| v.to_le_bytes())).collect()
    }

    fn glb(json: &str) -> Vec<u8> {
        let json = format!("{json}{}", " ".repeat((4 - json.len() % 4) % 4));
        let buffer = buffer();
        let words = |values: &[usize]| values.iter().flat_map(|v| (*v as u32).to_le_bytes()).collect::<Vec<_>>();
        let head =
            [b"glTF".to_vec(), words(&[2, 28 + json.len() + buffer.len(), json.len()]), b"JSON".to_vec()].concat();
        [head, json.into_bytes(), words(&[buffer.len()]), b"BIN\0".to_vec(), buffer].concat()
    }

    fn with(buffer: &str) -> String {
        DOCUMENT.replace("BUFFER", buffer)
    }

    #[test]
    fn buffers_are_chunks_data_or_files() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.gltf");
        assert_eq!(read(&file, &glb(&with(""))).unwrap(), CORNERS);
        let coded = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAA/AAABAAIA";
        let data = with(&format!(r#""uri": "data:application/octet-stream;base64,{coded}", "#));
        assert_eq!(read(&file, data.as_bytes()).unwrap(), CORNERS);
        std::fs::write(folder.path().join("a b.bin"), buffer()).unwrap();
        assert_eq!(read(&file, with(r#""uri": "a%20b.bin", "#).as_bytes()).unwrap(), CORNERS);
    }

    #[test]
    fn faults_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.gltf");
        let fault = |json: &str| read(&file, json.as_bytes()).unwrap_err();
        assert!(fault("{").ends_with("expected glTF 2.0"));
        assert!(fault(&with(r#""uri": "../a.bin", "#)).contains("expected a file in the folder of the mesh or below"));
        assert!(fault(&with(r#""uri": "none.bin", "#)).starts_with("buffer none.bin: "));
        let in_glb = |from: &str, to: &str| read(&file, &glb(&with("").replace(from, to))).unwrap_err();
        assert_eq!(in_glb("\"count\": 3", "\"count\": 4"), "mesh 0: accessor 0: expected values within its view");
        assert_eq!(
            in_glb("\"children\": [0]", "\"children\": [1]"),
            "node 1: expected at most 100000 nodes, nested at most 64 deep"
        );
        assert_eq!(
            in_glb("\"byteLength\": 36}", "\"byteLength\": 99}"),
            "mesh 0: accessor 0: expected a view within its buffer"
        );
        let draco = in_glb("\"scene\"", "\"extensionsRequired\": [\"KHR_draco_mesh_compression\"], \"scene\"");
        assert_eq!(draco, "extension KHR_draco_mesh_compression: expected a mesh without it");
        assert_eq!(read(&file, &glb("{}")[..20]).unwrap_err(), "expected a whole JSON chunk");
    }
}
