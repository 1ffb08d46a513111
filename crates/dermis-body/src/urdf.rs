//! A robot as described by its URDF file: links, joints, and the shapes of the links. Inertias, materials,
//! transmissions and simulator extensions of the format (<http://wiki.ros.org/urdf/XML>, version 1.1 of which adds
//! `quat_xyzw`) are ignored.

use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use crate::error::Error;
use crate::transform::{Transform, Vector, length, scaled};

/// Largest URDF file, bytes: four times the largest robot descriptions in use.
pub const MOST_BYTES: u64 = 64 << 20;
/// Maximum number of links in a robot.
const MOST_LINKS: usize = 10_000;
/// Largest length in a URDF file, metres.
const MOST_M: f64 = 1e4;

/// A robot's links and joints, each with its line number. The joints need not form a tree yet.
#[derive(Clone, Debug)]
pub struct Urdf {
    /// Name of the robot.
    pub name: String,
    /// Links in file order.
    pub links: Vec<Link>,
    /// Joints in file order.
    pub joints: Vec<Joint>,
}

/// A rigid part.
#[derive(Clone, Debug)]
pub struct Link {
    /// Its name.
    pub name: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Visual shapes, or collision shapes if there are none.
    pub shapes: Vec<Shape>,
}

/// A shape of a link.
#[derive(Clone, Debug)]
pub struct Shape {
    /// Line in the file, from 1.
    pub line: usize,
    /// Its pose on the link.
    pub link_from_shape: Transform,
    /// Its geometry.
    pub geometry: Geometry,
}

/// Geometry of a shape in its own frame.
#[derive(Clone, Debug, PartialEq)]
pub enum Geometry {
    /// A box about the origin.
    Box {
        /// Lengths along x, y and z, metres.
        size_m: Vector,
    },
    /// A cylinder about the origin, its axis along z. Capsules count as cylinders.
    Cylinder {
        /// Radius, metres.
        radius_m: f64,
        /// Length, metres.
        length_m: f64,
    },
    /// A sphere about the origin.
    Sphere {
        /// Radius, metres.
        radius_m: f64,
    },
    /// Triangles in a file.
    Mesh {
        /// As written in the URDF file: a path, `file://...` or `package://...`.
        filename: String,
        /// Factors on x, y and z of the file.
        scale: Vector,
    },
}

/// Motion of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointKind {
    /// None.
    Fixed,
    /// Rotation about its axis, between limits.
    Revolute,
    /// Rotation about its axis, without limits.
    Continuous,
    /// Translation along its axis.
    Prismatic,
    /// Motion in more than one direction (planar, floating, spherical), which a single value cannot describe.
    Other,
}

/// A joint between two links.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Its name.
    pub name: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Motion.
    pub kind: JointKind,
    /// Parent link, nearer to the root.
    pub parent: String,
    /// Child link.
    pub child: String,
    /// Its pose at value 0.
    pub parent_from_joint: Transform,
    /// Unit axis in its own frame.
    pub axis: Vector,
    /// Lower and upper limit, radians or metres, if it has limits.
    pub limits: Option<[f64; 2]>,
    /// The joint that it mimics.
    pub mimic: Option<Mimic>,
}

/// Mimicry of another joint: `multiplier * value + offset`.
#[derive(Clone, Debug, PartialEq)]
pub struct Mimic {
    /// The joint that it mimics.
    pub joint: String,
    /// Factor on the other joint's value.
    pub multiplier: f64,
    /// Offset, radians or metres.
    pub offset: f64,
}

impl Urdf {
    /// Reads a URDF file.
    ///
    /// # Errors
    /// The file cannot be read or is too large; otherwise as for [`Urdf::parse`].
    pub fn open(file: &Path) -> Result<Self, Error> {
        Self::parse(&crate::files::read_text(file, MOST_BYTES)?, file)
    }

    /// Parses a text; `file` is only used in messages. [`crate::Kinematics::new`] checks that the joints form a tree.
    ///
    /// # Errors
    /// The text is not XML or not a robot, or has invalid numbers; the message gives the line.
    pub fn parse(text: &str, file: &Path) -> Result<Self, Error> {
        let fail = |line: usize, message: String| Error::Urdf { file: file.to_path_buf(), line, message };
        // Entities in a document type can expand a small text into a huge one.
        let options = ParsingOptions { allow_dtd: false, ..ParsingOptions::default() };
        let document = Document::parse_with_options(text, options).map_err(|error| {
            let is_cut_off =
                matches!(error, roxmltree::Error::UnclosedRootNode | roxmltree::Error::UnexpectedEndOfStream);
            let line = if is_cut_off { text.trim_end().lines().count().max(1) } else { error.pos().row as usize };
            fail(line, format!("not XML: {error}"))
        })?;
        let line_starts = text.match_indices('\n').map(|(at, _)| at + 1).collect();
        let reader = Reader { line_starts, file };
        let robot = document.root_element();
        if robot.tag_name().name() != "robot" {
            return Err(reader.fail(robot, format!("<{}>: expected <robot>", robot.tag_name().name())));
        }
        reader.robot(robot)
    }
}

/// A document being read.
struct Reader<'a> {
    /// Byte offsets of all lines but the first.
    line_starts: Vec<usize>,
    file: &'a Path,
}

impl Reader<'_> {
    fn line(&self, node: Node<'_, '_>) -> usize {
        1 + self.line_starts.partition_point(|&start| start <= node.range().start)
    }

    fn fail(&self, node: Node<'_, '_>, message: String) -> Error {
        Error::Urdf { file: self.file.to_path_buf(), line: self.line(node), message }
    }

    fn robot(&self, robot: Node<'_, '_>) -> Result<Urdf, Error> {
        let quaternions = robot.attribute("version").is_some_and(|version| version.trim() != "1.0");
        let (mut links, mut joints) = (Vec::new(), Vec::new());
        for node in robot.children().filter(Node::is_element) {
            match node.tag_name().name() {
                _ if is_xacro(node) => {
                    let message = "a xacro file: expected URDF, which `xacro FILE` generates from it".to_owned();
                    return Err(self.fail(node, message));
                }
                "link" => links.push(self.link(node, quaternions)?),
                "joint" => joints.push(self.joint(node, quaternions)?),
                _ => {}
            }
            if links.len() > MOST_LINKS || joints.len() > MOST_LINKS {
                return Err(
                    self.fail(node, format!("more than {MOST_LINKS} links or joints: expected at most as many"))
                );
            }
        }
        if links.is_empty() {
            return Err(self.fail(robot, "no <link>: expected at least one".to_owned()));
        }
        Ok(Urdf { name: robot.attribute("name").unwrap_or_default().to_owned(), links, joints })
    }

    fn link(&self, node: Node<'_, '_>, quaternions: bool) -> Result<Link, Error> {
        let name = self.name(node)?;
        let of = |tag: &'static str| -> Result<Vec<Shape>, Error> {
            let shapes = children(node, tag).map(|shape| self.shape(shape, quaternions));
            shapes.filter_map(Result::transpose).collect()
        };
        let (visuals, collisions) = (of("visual")?, of("collision")?);
        let shapes = if visuals.is_empty() { collisions } else { visuals };
        Ok(Link { name, line: self.line(node), shapes })
    }

    /// `None` if it has no geometry of a known kind.
    fn shape(&self, node: Node<'_, '_>, quaternions: bool) -> Result<Option<Shape>, Error> {
        let link_from_shape = self.origin(node, quaternions)?;
        let Some(geometry) = child(node, "geometry").and_then(|geometry| geometry.children().find(Node::is_element))
        else {
            return Ok(None);
        };
        let size = |key: &str| -> Result<f64, Error> {
            let [value] = self.numbers(geometry, key)?.ok_or_else(|| self.missing(geometry, key))?;
            if value > 0.0 && value <= MOST_M {
                return Ok(value);
            }
            Err(self.fail(geometry, format!("{key}=\"{value}\": expected metres above 0, at most {MOST_M}")))
        };
        let what = match geometry.tag_name().name() {
            "box" => {
                let size_m: Vector = self.numbers(geometry, "size")?.ok_or_else(|| self.missing(geometry, "size"))?;
                if size_m.iter().any(|&v| !(0.0..=MOST_M).contains(&v)) {
                    let message = format!("size=\"{size_m:?}\": expected metres, not negative, at most {MOST_M}");
                    return Err(self.fail(geometry, message));
                }
                Geometry::Box { size_m }
            }
            "cylinder" | "capsule" => Geometry::Cylinder { radius_m: size("radius")?, length_m: size("length")? },
            "sphere" => Geometry::Sphere { radius_m: size("radius")? },
            "mesh" => Geometry::Mesh {
                filename: self.attribute(geometry, "filename")?.to_owned(),
                scale: self.numbers(geometry, "scale")?.unwrap_or([1.0; 3]),
            },
            _ => return Ok(None),
        };
        Ok(Some(Shape { line: self.line(geometry), link_from_shape, geometry: what }))
    }

    fn joint(&self, node: Node<'_, '_>, quaternions: bool) -> Result<Joint, Error> {
        let name = self.name(node)?;
        let kind = match self.attribute(node, "type")? {
            "fixed" => JointKind::Fixed,
            "revolute" => JointKind::Revolute,
            "continuous" => JointKind::Continuous,
            "prismatic" => JointKind::Prismatic,
            "planar" | "floating" | "spherical" => JointKind::Other,
            other => {
                let expected = "fixed, revolute, continuous, prismatic, planar or floating";
                return Err(self.fail(node, format!("joint {name}: type=\"{other}\": expected {expected}")));
            }
        };
        let end = |tag: &'static str| -> Result<String, Error> {
            let end = child(node, tag).ok_or_else(|| self.fail(node, format!("joint {name}: expected a <{tag}>")))?;
            Ok(self.attribute(end, "link")?.to_owned())
        };
        Ok(Joint {
            line: self.line(node),
            kind,
            parent: end("parent")?,
            child: end("child")?,
            parent_from_joint: self.origin(node, quaternions)?,
            axis: self.axis(node, kind, &name)?,
            limits: self.limits(node, kind)?,
            mimic: child(node, "mimic").map(|mimic| self.mimic(mimic)).transpose()?,
            name,
        })
    }

    fn axis(&self, node: Node<'_, '_>, kind: JointKind, name: &str) -> Result<Vector, Error> {
        let Some(axis_node) = child(node, "axis") else { return Ok([1.0, 0.0, 0.0]) };
        let axis: Vector = self.numbers(axis_node, "xyz")?.ok_or_else(|| self.missing(axis_node, "xyz"))?;
        let length = length(axis);
        let moves = matches!(kind, JointKind::Revolute | JointKind::Continuous | JointKind::Prismatic);
        if !moves {
            return Ok([1.0, 0.0, 0.0]);
        }
        if length < 1e-9 {
            return Err(self.fail(axis_node, format!("joint {name}: axis xyz={axis:?}: expected a direction, not 0")));
        }
        Ok(scaled(axis, 1.0 / length))
    }

    fn limits(&self, node: Node<'_, '_>, kind: JointKind) -> Result<Option<[f64; 2]>, Error> {
        let has_ends = matches!(kind, JointKind::Revolute | JointKind::Prismatic);
        let Some(limit) = child(node, "limit").filter(|_| has_ends) else { return Ok(None) };
        let end = |key: &str| Ok::<_, Error>(self.numbers::<1>(limit, key)?.map(|[value]| value));
        let (Some(lower), Some(upper)) = (end("lower")?, end("upper")?) else { return Ok(None) };
        if lower > upper {
            return Err(self.fail(limit, format!("lower=\"{lower}\" upper=\"{upper}\": expected lower <= upper")));
        }
        Ok(Some([lower, upper]))
    }

    fn mimic(&self, node: Node<'_, '_>) -> Result<Mimic, Error> {
        let number = |key: &str, default: f64| Ok::<_, Error>(self.numbers::<1>(node, key)?.map_or(default, |[v]| v));
        let joint = self.attribute(node, "joint")?.to_owned();
        Ok(Mimic { joint, multiplier: number("multiplier", 1.0)?, offset: number("offset", 0.0)? })
    }

    fn origin(&self, node: Node<'_, '_>, quaternions: bool) -> Result<Transform, Error> {
        let Some(origin) = child(node, "origin") else { return Ok(Transform::IDENTITY) };
        let xyz: Vector = self.numbers(origin, "xyz")?.unwrap_or_default();
        if let Some(v) = xyz.iter().find(|v| v.abs() > MOST_M) {
            return Err(self.fail(origin, format!("xyz has {v}: expected metres, at most {MOST_M}")));
        }
        let rpy: Option<Vector> = self.numbers(origin, "rpy")?;
        if quaternions && let Some(q) = self.numbers::<4>(origin, "quat_xyzw")? {
            let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
            if rpy.is_some() {
                return Err(self.fail(origin, "rpy and quat_xyzw: expected one of the two".to_owned()));
            }
            if norm < 1e-9 {
                return Err(self.fail(origin, format!("quat_xyzw={q:?}: expected a rotation, not 0")));
            }
            return Ok(Transform::from_quaternion(xyz, q.map(|v| v / norm)));
        }
        Ok(Transform::from_xyz_rpy(xyz, rpy.unwrap_or_default()))
    }

    fn name(&self, node: Node<'_, '_>) -> Result<String, Error> {
        let name = self.attribute(node, "name")?;
        if name.is_empty() || name.len() > 200 || name.chars().any(char::is_control) {
            return Err(
                self.fail(node, format!("name={name:?}: expected 1 to 200 characters without control characters"))
            );
        }
        Ok(name.to_owned())
    }

    fn attribute<'n>(&self, node: Node<'n, '_>, key: &str) -> Result<&'n str, Error> {
        node.attribute(key).ok_or_else(|| self.missing(node, key))
    }

    fn missing(&self, node: Node<'_, '_>, key: &str) -> Error {
        self.fail(node, format!("<{}> without {key}: expected {key}=\"...\"", node.tag_name().name()))
    }

    /// Numbers of an attribute, if it is there.
    fn numbers<const N: usize>(&self, node: Node<'_, '_>, key: &str) -> Result<Option<[f64; N]>, Error> {
        let Some(text) = node.attribute(key) else { return Ok(None) };
        let wrong = || {
            let what = node.tag_name().name();
            let hint = if text.contains("${") { "; `xacro FILE` evaluates ${}" } else { "" };
            self.fail(node, format!("<{what}> {key}={text:?}: expected {N} numbers{hint}"))
        };
        let parsed: Result<Vec<f64>, _> = text.split_whitespace().map(str::parse).collect();
        let numbers: [f64; N] = parsed.ok().and_then(|list| list.try_into().ok()).ok_or_else(wrong)?;
        if numbers.iter().all(|number: &f64| number.is_finite()) { Ok(Some(numbers)) } else { Err(wrong()) }
    }
}

fn is_xacro(node: Node<'_, '_>) -> bool {
    node.tag_name().namespace().is_some_and(|name| name.contains("xacro"))
}

fn children<'a, 'i>(node: Node<'a, 'i>, tag: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    node.children().filter(move |child| child.has_tag_name(tag))
}

fn child<'a, 'i>(node: Node<'a, 'i>, tag: &'static str) -> Option<Node<'a, 'i>> {
    children(node, tag).next()
}
