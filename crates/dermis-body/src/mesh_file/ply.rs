//! PLY, text and binary.

use super::numbers::fan;

/// Maximum size of the header, bytes.
const MOST_HEAD: usize = 1 << 16;

/// The type of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Signed(usize),
    Unsigned(usize),
    Float(usize),
}

impl Kind {
    fn named(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::Signed(1),
            "short" | "int16" => Self::Signed(2),
            "int" | "int32" => Self::Signed(4),
            "uchar" | "uint8" => Self::Unsigned(1),
            "ushort" | "uint16" => Self::Unsigned(2),
            "uint" | "uint32" => Self::Unsigned(4),
            "float" | "float32" => Self::Float(4),
            "double" | "float64" => Self::Float(8),
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Signed(size) | Self::Unsigned(size) | Self::Float(size) => size,
        }
    }
}

struct Property {
    name: String,
    /// Type of the length, if it is a list.
    length: Option<Kind>,
    kind: Kind,
}

struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

/// The values after the header, in file order.
enum Body<'a> {
    Text(std::str::SplitAsciiWhitespace<'a>),
    Binary { bytes: &'a [u8], is_big: bool },
}

impl Body<'_> {
    fn next(&mut self, kind: Kind) -> Option<f64> {
        match self {
            Self::Text(words) => words.next()?.parse().ok(),
            Self::Binary { bytes, is_big } => {
                let (number, rest) = bytes.split_at_checked(kind.size())?;
                *bytes = rest;
                let mut little = [0; 8];
                little[..number.len()].copy_from_slice(number);
                if *is_big {
                    little[..number.len()].reverse();
                }
                let all = u64::from_le_bytes(little);
                let unused = 64 - 8 * kind.size() as u32;
                Some(match kind {
                    Kind::Signed(_) => ((all << unused) as i64 >> unused) as f64,
                    Kind::Unsigned(_) => all as f64,
                    Kind::Float(4) => f64::from(f32::from_bits(all as u32)),
                    Kind::Float(_) => f64::from_bits(all),
                })
            }
        }
    }

    /// The values of a property; one unless it is a list.
    fn values(&mut self, property: &Property, values: &mut Vec<f64>) -> Option<()> {
        values.clear();
        let count = match property.length {
            Some(kind) => self.next(kind).filter(|length| *length >= 0.0)? as usize,
            None => 1,
        };
        for _ in 0..count {
            values.push(self.next(property.kind)?);
        }
        Some(())
    }
}

/// Corners of the triangles in a PLY file.
///
/// # Errors
/// A malformed header, a truncated file, or a face with an unknown vertex; the message names it.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let (elements, mut body) = head(bytes)?;
    let (mut vertices, mut corners, mut values) = (Vec::new(), Vec::new(), Vec::new());
    for element in &elements {
        let is_vertex = element.name == "vertex";
        let axes = ["x", "y", "z"].map(|name| element.properties.iter().position(|property| property.name == name));
        // Elements without properties take no space.
        let count = if element.properties.is_empty() { 0 } else { element.count };
        for number in 0..count {
            let mut vertex = [f32::NAN; 3];
            for (index, property) in element.properties.iter().enumerate() {
                let cut_off = || format!("{} {number}: expected a number for {}", element.name, property.name);
                body.values(property, &mut values).ok_or_else(cut_off)?;
                if is_vertex && let Some(axis) = axes.iter().position(|axis| *axis == Some(index)) {
                    vertex[axis] = values.first().map_or(f32::NAN, |value| *value as f32);
                } else if element.name == "face" && ["vertex_indices", "vertex_index"].contains(&&*property.name) {
                    let corner = |value: &f64| vertices.get(*value as usize).copied();
                    let face: Option<Vec<[f32; 3]>> = values.iter().map(corner).collect();
                    corners.extend(fan(&face.ok_or_else(|| format!("face {number}: expected known vertices"))?));
                }
            }
            if is_vertex {
                vertices.push(vertex);
            }
        }
    }
    Ok(corners)
}

/// Parses the header: the elements that it lists, and the data after it.
fn head(bytes: &[u8]) -> Result<(Vec<Element>, Body<'_>), String> {
    let mut elements: Vec<Element> = Vec::new();
    let mut format = None;
    let mut at = 0;
    for number in 1.. {
        let rest = bytes.get(at..MOST_HEAD.min(bytes.len())).unwrap_or_default();
        let length =
            rest.iter().position(|byte| *byte == b'\n').ok_or("expected a header that ends with end_header")?;
        let line = String::from_utf8_lossy(&rest[..length]);
        at += length + 1;
        let words: Vec<&str> = line.split_whitespace().collect();
        let fault = || format!("line {number}: {:?}: expected a line of a PLY header", line.trim());
        match words[..] {
            ["ply"] | ["comment" | "obj_info", ..] | [] => {}
            ["format", name, _] => format = Some(name.to_owned()),
            ["element", name, count] => {
                let count = count.parse().map_err(|_| fault())?;
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref kind @ .., name] => {
                let kinds: Option<Vec<Kind>> =
                    kind.iter().filter(|word| **word != "list").map(|word| Kind::named(word)).collect();
                let (length, kind) = match kinds.as_deref() {
                    Some(&[kind]) => (None, kind),
                    Some(&[length, kind]) => (Some(length), kind),
                    _ => return Err(fault()),
                };
                let property = Property { name: name.to_owned(), length, kind };
                elements.last_mut().ok_or_else(fault)?.properties.push(property);
            }
            ["end_header"] => break,
            _ => return Err(fault()),
        }
    }
    let rest = &bytes[at..];
    let body = match format.as_deref() {
        Some("ascii") => {
            let text =
                std::str::from_utf8(rest).map_err(|error| format!("after the header: {error}: expected text"))?;
            Body::Text(text.split_ascii_whitespace())
        }
        Some("binary_little_endian") => Body::Binary { bytes: rest, is_big: false },
        Some("binary_big_endian") => Body::Binary { bytes: rest, is_big: true },
        other => {
            let got = other.unwrap_or("none");
            return Err(format!("format {got}: expected ascii, binary_little_endian or binary_big_endian"));
        }
    };
    Ok((elements, body))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "element vertex 3\nproperty float x\nproperty double y\nproperty short z\nproperty uchar red\n\
                        element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const CORNERS: [[f32; 3]; 3] = [[0.0, 0.0, 0.0], [1.5, 0.0, 0.0], [0.0, 2.0, -3.0]];

    fn binary(name: &str, number: impl Fn(&[u8]) -> Vec<u8>) -> Vec<u8> {
        let mut bytes = format!("ply\nformat {name} 1.0\ncomment a\n{HEAD}").into_bytes();
        for [x, y, z] in CORNERS {
            bytes.extend(number(&x.to_le_bytes()));
            bytes.extend(number(&f64::from(y).to_le_bytes()));
            bytes.extend(number(&(z as i16).to_le_bytes()));
            bytes.push(200);
        }
        bytes.push(3);
        (0..3_i32).for_each(|k| bytes.extend(number(&k.to_le_bytes())));
        bytes
    }

    #[test]
    fn three_forms_give_the_same_triangle() {
        let text = format!("ply\nformat ascii 1.0\n{HEAD}0 0 0 9\n1.5 0 0 9\n0 2 -3 9\n3 0 1 2\n");
        assert_eq!(read(text.as_bytes()).unwrap(), CORNERS);
        assert_eq!(read(&binary("binary_little_endian", <[u8]>::to_vec)).unwrap(), CORNERS);
        let reversed = |bytes: &[u8]| bytes.iter().rev().copied().collect();
        assert_eq!(read(&binary("binary_big_endian", reversed)).unwrap(), CORNERS);
    }

    #[test]
    fn faults_are_named() {
        let whole = binary("binary_little_endian", <[u8]>::to_vec);
        let fault = |bytes: &[u8]| read(bytes).unwrap_err();
        assert_eq!(fault(&whole[..whole.len() - 1]), "face 0: expected a number for vertex_indices");
        assert_eq!(
            fault(b"ply\nformat ascii 1.0\nproperty float x\n"),
            "line 3: \"property float x\": expected a line of a PLY header"
        );
        assert!(fault(b"ply\nformat zip 1.0\nend_header\n").starts_with("format zip: expected ascii"));
        let text = format!("ply\nformat ascii 1.0\n{HEAD}0 0 0 9\n1 0 0 9\n0 2 3 9\n3 0 1 7\n");
        assert_eq!(fault(text.as_bytes()), "face 0: expected known vertices");
        // More elements than any file can hold.
        let text =
            "ply\nformat ascii 1.0\nelement a 99999999999\nelement vertex 99999999999\nproperty float x\nend_header\n";
        assert_eq!(fault(text.as_bytes()), "vertex 0: expected a number for x");
    }
}
