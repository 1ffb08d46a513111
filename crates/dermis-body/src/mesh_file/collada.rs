//! COLLADA 1.4 and 1.5.

use std::collections::HashMap;

use roxmltree::{Document, Node};

use super::numbers::{Affine, Placed, fan, strip};

/// Corners of the triangles of the scene, metres: the file's unit is converted. Without a scene, all geometries.
///
/// # Errors
/// Malformed XML, references or numbers; the message names the line.
pub(super) fn read(bytes: &[u8]) -> Result<Vec<[f32; 3]>, String> {
    let text = String::from_utf8_lossy(bytes);
    let document = Document::parse(&text).map_err(|error| format!("{error}: expected XML"))?;
    let unit = document.descendants().find(|node| node.has_tag_name(tag(&document, "unit")));
    let metres = match unit.and_then(|unit| unit.attribute("meter")) {
        None => 1.0,
        Some(text) => text.trim().parse().map_err(|_| format!("unit {text:?}: expected metres"))?,
    };
    let ids = document.descendants().filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let (reader, mut placed) = (Reader { document: &document, ids }, Placed::default());
    let whole = Affine::scale([metres; 3]);
    match reader.scene()? {
        Some(scene) => reader.add_children(scene, &whole, 0, &mut placed)?,
        None => {
            for geometry in reader.all("geometry") {
                let corners = reader.corners(geometry, &mut placed)?;
                placed.add(&corners, &whole)?;
            }
        }
    }
    Ok(placed.corners)
}

/// A name in the namespace of the document.
fn tag<'a>(document: &'a Document<'_>, name: &'a str) -> roxmltree::ExpandedName<'a, 'a> {
    match document.root_element().tag_name().namespace() {
        Some(namespace) => (namespace, name).into(),
        None => name.into(),
    }
}

struct Reader<'a, 'input> {
    document: &'a Document<'input>,
    ids: HashMap<&'a str, Element<'a, 'input>>,
}

type Element<'a, 'input> = Node<'a, 'input>;

impl<'a, 'input> Reader<'a, 'input> {
    fn all(&self, name: &'a str) -> impl Iterator<Item = Element<'a, 'input>> + use<'a, 'input> {
        let tag = tag(self.document, name);
        self.document.descendants().filter(move |node| node.has_tag_name(tag))
    }

    fn children(
        &self,
        of: Element<'a, 'input>,
        name: &'a str,
    ) -> impl Iterator<Item = Element<'a, 'input>> + use<'a, 'input> {
        let tag = tag(self.document, name);
        of.children().filter(move |node| node.has_tag_name(tag))
    }

    fn fault(&self, at: Element<'a, 'input>, expected: &str) -> String {
        format!("line {}: expected {expected}", self.document.text_pos_at(at.range().start).row)
    }

    /// The element to which an attribute of another refers.
    fn target(&self, of: Element<'a, 'input>, attribute: &str, name: &'a str) -> Result<Element<'a, 'input>, String> {
        let id = of.attribute(attribute).and_then(|text| text.strip_prefix('#'));
        let found = id.and_then(|id| self.ids.get(id)).filter(|node| node.has_tag_name(tag(self.document, name)));
        found.copied().ok_or_else(|| self.fault(of, &format!("{attribute} of a known {name}")))
    }

    fn scene(&self) -> Result<Option<Element<'a, 'input>>, String> {
        match self.all("instance_visual_scene").next() {
            Some(instance) => self.target(instance, "url", "visual_scene").map(Some),
            None => Ok(self.all("visual_scene").next()),
        }
    }

    fn add_children(
        &self,
        of: Element<'a, 'input>,
        above: &Affine,
        depth: usize,
        placed: &mut Placed,
    ) -> Result<(), String> {
        let row = || self.document.text_pos_at(of.range().start).row;
        placed.enter(depth).map_err(|reason| format!("line {}: {reason}", row()))?;
        let mut transform = *above;
        for child in of.children().filter(Node::is_element) {
            match child.tag_name().name() {
                "matrix" => {
                    let m = self.exactly::<16>(child)?;
                    let matrix = Affine(std::array::from_fn(|row| std::array::from_fn(|column| m[4 * row + column])));
                    transform = transform.after(&matrix);
                }
                "translate" => transform = transform.after(&Affine::translation(self.exactly(child)?)),
                "scale" => transform = transform.after(&Affine::scale(self.exactly(child)?)),
                "rotate" => {
                    let [x, y, z, deg] = self.exactly(child)?;
                    let (sin, cos) = (0.5 * deg.to_radians()).sin_cos();
                    let length = (x * x + y * y + z * z).sqrt().max(f64::MIN_POSITIVE);
                    let [x, y, z] = [x, y, z].map(|part| sin * part / length);
                    transform = transform.after(&Affine::rotation([x, y, z, cos]));
                }
                "lookat" | "skew" => return Err(self.fault(child, "matrix, translate, rotate or scale")),
                "instance_geometry" => {
                    let corners = self.corners(self.target(child, "url", "geometry")?, placed)?;
                    placed.add(&corners, &transform)?;
                }
                "node" => self.add_children(child, &transform, depth + 1, placed)?,
                "instance_node" => {
                    self.add_children(self.target(child, "url", "node")?, &transform, depth + 1, placed)?;
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Corners of the triangles of a geometry, in the file's unit.
    fn corners(&self, geometry: Element<'a, 'input>, placed: &mut Placed) -> Result<Vec<[f32; 3]>, String> {
        let mut corners = Vec::new();
        for mesh in self.children(geometry, "mesh") {
            for primitive in mesh.children().filter(Node::is_element) {
                let name = primitive.tag_name().name();
                if ["triangles", "polylist", "polygons", "tristrips", "trifans"].contains(&name) {
                    self.add_primitive(primitive, &mut corners, placed)?;
                }
            }
        }
        Ok(corners)
    }

    fn add_primitive(
        &self,
        primitive: Element<'a, 'input>,
        corners: &mut Vec<[f32; 3]>,
        placed: &mut Placed,
    ) -> Result<(), String> {
        let inputs: Vec<_> = self.children(primitive, "input").collect();
        let offset =
            |input: &Element<'a, 'input>| input.attribute("offset").and_then(|text| text.parse::<usize>().ok());
        // Numbers per corner.
        let stride = inputs.iter().filter_map(offset).max().unwrap_or(0).saturating_add(1);
        let vertex = inputs.iter().find(|input| input.attribute("semantic") == Some("VERTEX"));
        let vertex = vertex.ok_or_else(|| self.fault(primitive, "an input VERTEX"))?;
        let points = self.positions(self.target(*vertex, "source", "vertices")?)?;
        placed.read(3 * points.len())?;
        let first = offset(vertex).unwrap_or(0);
        for list in self.children(primitive, "p") {
            let numbers = self.numbers(list)?;
            placed.read(numbers.len())?;
            let point = |of_corner: &[f64]| {
                let index = Some(of_corner[first]).filter(|index| *index >= 0.0)?;
                points.get(index as usize).copied()
            };
            let drawn: Option<Vec<[f32; 3]>> = numbers.chunks_exact(stride).map(point).collect();
            let drawn = drawn.ok_or_else(|| self.fault(list, "indices of known vertices"))?;
            match primitive.tag_name().name() {
                "triangles" => corners.extend_from_slice(&drawn[..drawn.len() / 3 * 3]),
                "tristrips" => corners.extend(strip(&drawn)),
                "polylist" => {
                    let mut rest = &drawn[..];
                    for counts in self.children(primitive, "vcount") {
                        for count in self.numbers(counts)? {
                            let polygon = rest.split_at_checked(count as usize);
                            let (polygon, others) =
                                polygon.ok_or_else(|| self.fault(counts, "as many corners as in p"))?;
                            corners.extend(fan(polygon));
                            rest = others;
                        }
                    }
                }
                _ => corners.extend(fan(&drawn)),
            }
        }
        Ok(())
    }

    /// The positions of vertices.
    fn positions(&self, vertices: Element<'a, 'input>) -> Result<Vec<[f32; 3]>, String> {
        let input = self.children(vertices, "input").find(|input| input.attribute("semantic") == Some("POSITION"));
        let input = input.ok_or_else(|| self.fault(vertices, "an input POSITION"))?;
        let source = self.target(input, "source", "source")?;
        let array = self.children(source, "float_array").next();
        let numbers = self.numbers(array.ok_or_else(|| self.fault(source, "a float_array"))?)?;
        let accessor = source.descendants().find(|node| node.has_tag_name(tag(self.document, "accessor")));
        let count = |name: &str| accessor.and_then(|accessor| accessor.attribute(name)?.parse::<usize>().ok());
        let stride = count("stride").unwrap_or(3);
        if stride < 3 {
            return Err(self.fault(source, "three numbers per vertex"));
        }
        let numbers = numbers.get(count("offset").unwrap_or(0)..).unwrap_or_default();
        Ok(numbers
            .chunks(stride)
            .filter(|part| part.len() >= 3)
            .map(|p| [p[0], p[1], p[2]].map(|v| v as f32))
            .collect())
    }

    fn exactly<const N: usize>(&self, element: Element<'a, 'input>) -> Result<[f64; N], String> {
        let numbers = self.numbers(element)?;
        numbers.try_into().map_err(|_| self.fault(element, &format!("{N} numbers")))
    }

    fn numbers(&self, element: Element<'a, 'input>) -> Result<Vec<f64>, String> {
        let words = element.text().unwrap_or_default().split_ascii_whitespace();
        let numbers: Result<Vec<f64>, _> = words.map(str::parse).collect();
        numbers.map_err(|_| self.fault(element, "numbers"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A square of 10 by 10 mm in a file whose unit is the millimetre, turned by 90 degrees about z and moved.
    const SQUARE: &str = r##"<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
 <asset><unit name="millimeter" meter="0.001"/><up_axis>Z_UP</up_axis></asset>
 <library_geometries><geometry id="g"><mesh>
  <source id="s"><float_array id="a" count="12">0 0 0 10 0 0 10 10 0 0 10 0</float_array>
   <technique_common><accessor source="#a" count="4" stride="3"/></technique_common></source>
  <vertices id="v"><input semantic="POSITION" source="#s"/></vertices>
  <polylist count="1"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL" source="#s" offset="1"/>
   <vcount>4</vcount><p>0 0 1 0 2 0 3 0</p></polylist>
 </mesh></geometry></library_geometries>
 <library_visual_scenes><visual_scene id="scene"><node>
  <translate>0 0 5</translate><rotate>0 0 1 90</rotate><instance_geometry url="#g"/>
 </node></visual_scene></library_visual_scenes>
 <scene><instance_visual_scene url="#scene"/></scene>
</COLLADA>"##;

    fn near(a: &[[f32; 3]], b: &[[f32; 3]]) -> bool {
        a.len() == b.len() && a.iter().flatten().zip(b.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-7)
    }

    #[test]
    fn nodes_units_and_polygons_are_applied() {
        let at = |x: f32, y: f32| [x, y, 5e-3];
        let corners = [at(0.0, 0.0), at(0.0, 0.01), at(-0.01, 0.01), at(0.0, 0.0), at(-0.01, 0.01), at(-0.01, 0.0)];
        assert!(near(&read(SQUARE.as_bytes()).unwrap(), &corners), "{:?}", read(SQUARE.as_bytes()));
        let triangles =
            SQUARE.replace("polylist", "triangles").replace("<vcount>4</vcount>", "").replace(" 3 0</p>", "</p>");
        assert!(near(&read(triangles.as_bytes()).unwrap(), &corners[..3]));
        let plain = SQUARE.replace(" xmlns=\"http://www.collada.org/2005/11/COLLADASchema\"", "");
        assert!(near(&read(plain.as_bytes()).unwrap(), &corners));
        let (before, after) = SQUARE.split_once(" <library_visual_scenes>").unwrap();
        let without_scene = format!("{before}</COLLADA>{}", &after[..0]);
        assert_eq!(read(without_scene.as_bytes()).unwrap().len(), 6);
    }

    #[test]
    fn faults_name_the_line() {
        let fault = |from: &str, to: &str| read(SQUARE.replace(from, to).as_bytes()).unwrap_err();
        assert!(fault("</mesh>", "").ends_with("expected XML"));
        assert_eq!(fault("url=\"#g\"", "url=\"#h\""), "line 12: expected url of a known geometry");
        assert_eq!(fault("10 10 0", "10 ten 0"), "line 5: expected numbers");
        assert_eq!(fault("<p>0 0", "<p>9 0"), "line 9: expected indices of known vertices");
        assert_eq!(fault("<vcount>4", "<vcount>5"), "line 9: expected as many corners as in p");
        assert_eq!(fault("0 0 1 90", "0 1 90"), "line 12: expected 4 numbers");
        let cycle = fault("<instance_geometry url=\"#g\"/>", "<node id=\"n\"><instance_node url=\"#n\"/></node>");
        assert!(cycle.ends_with("nested at most 64 deep"), "{cycle}");
    }
}
