//! The exchange format of EIT problems, `case.json`: a mesh, electrodes, explicit lists of stimulations and
//! measurements, and named conductivities. Signs and units follow EIDORS (current into the body is positive, SI,
//! 2D of thickness 1); indices count from zero. Unknown keys are ignored, since other tools write their results into
//! the same file.
//!
//! | key | holds |
//! |---|---|
//! | `nodes` | 2 or 3 coordinates each, metres |
//! | `elems` | 3 (triangles) or 4 (tetrahedra) node indices each, in any orientation |
//! | `electrodes` | `{type: "CEM", z_contact, faces: [[node, ..], ..]}` or `{type: "PEM", node}` |
//! | `stim` | stimulations x electrodes, amperes into the body; rows add to zero |
//! | `meas`, `meas_stim` | measurements x electrodes, and the stimulation that each belongs to |
//! | `sigma_NAME` | conductivity of each element, S/m (S for sheets) |
//! | `dim`, `n_nodes`, `n_elems`, `n_elec`, `n_meas` | optional; compared with the lists |

mod field;

use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use dermis_device::instruments::{csv, npy, read_bytes};
use dermis_skin::Skin;
use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{CellKind, Contact, Electrode, ElectrodeGroups, ElectrodedMesh, Mesh, read_msh};
use serde_json::Value;

use crate::Error;
use field::Field;

/// Widest mesh accepted without a stated unit, metres: wider than any tank, and narrower than a 10 mm skin whose
/// millimetres are read as metres.
const WIDEST_M: f64 = 5.0;

/// A problem read from a `case.json`.
#[derive(Clone, Debug)]
pub struct Case {
    file: PathBuf,
    /// Mesh and electrodes.
    pub body: ElectrodedMesh,
    /// Stimulation and measurement.
    pub protocol: Protocol,
    /// The `sigma_NAME` lists, by NAME; checked on use.
    conductivities: BTreeMap<String, Value>,
}

/// Selects a conductivity: a name in the case, or a file with one value per element.
///
/// ```
/// use dermis_lab::case::ConductivityChoice;
///
/// assert_eq!("hom".parse::<ConductivityChoice>()?.to_string(), "hom");
/// assert!("".parse::<ConductivityChoice>().is_err());
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConductivityChoice(String);

impl FromStr for ConductivityChoice {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.is_empty() {
            return Err("expected hom, incl, wave, another sigma_NAME of the case, or a file".to_string());
        }
        Ok(Self(text.to_string()))
    }
}

impl fmt::Display for ConductivityChoice {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.0)
    }
}

impl Case {
    /// Reads and checks a case.
    ///
    /// # Errors
    /// The file cannot be read, isn't JSON, lacks a key or holds an invalid value: counts that disagree, indices
    /// out of range, values that are not finite, meshes and electrodes that [`Mesh::new`] and [`ElectrodedMesh::new`]
    /// reject, stimulations that don't sum to zero. The message names file, key, index and value.
    pub fn open(file: &Path) -> Result<Self, Error> {
        Self::parse(&read_bytes(file)?, file)
    }

    /// Like [`Case::open`], from the file's content; `file` is only used in messages.
    ///
    /// # Errors
    /// As for [`Case::open`].
    pub fn parse(content: &[u8], file: &Path) -> Result<Self, Error> {
        let document: Value = serde_json::from_slice(content).map_err(|error| syntax_error(content, file, &error))?;
        let root = Field::root(file, &document);
        if !document.is_object() {
            return Err(root.refuse("an object with nodes, elems, electrodes, stim, meas and meas_stim"));
        }
        let mesh = mesh(&root)?;
        let electrodes = electrodes(&root, &mesh)?;
        let count = electrodes.len();
        let body = ElectrodedMesh::new(mesh, electrodes).map_err(|error| content_error(file, "electrodes", &error))?;
        let protocol = protocol(&root, count)?;
        let conductivities = match document {
            Value::Object(entries) => entries.into_iter().filter_map(conductivity_entry).collect(),
            _ => BTreeMap::new(),
        };
        Ok(Self { file: file.to_path_buf(), body, protocol, conductivities })
    }

    /// Combines a Gmsh mesh with a skin's protocol.
    ///
    /// Electrodes are the groups named by the prefix and a number; the skin's contact impedance applies on the rim,
    /// and its sheet conductance becomes `hom`. `unit_m` is the length of the file's unit in metres. Without it the
    /// file is taken to be in metres, and a mesh wider than 5 m is rejected.
    ///
    /// # Errors
    /// The file is not such a mesh, lacks these groups, or has a different number of electrodes from the protocol.
    pub fn of_mesh(file: &Path, skin: &Skin, prefix: &str, unit_m: Option<f64>) -> Result<Self, Error> {
        let refuse = |field: &str, reason: String| {
            Error::Live(dermis_live::Error::Content { file: file.to_path_buf(), field: field.into(), reason })
        };
        let impedance = skin.frontend.contact_impedance_ohm_m2 / skin.frontend.layer.rim_height_m().unwrap_or(1.0);
        let groups = ElectrodeGroups::Prefix(prefix.to_string());
        let read = read_msh(&read_bytes(file)?, &groups, &[impedance]);
        let read = read.map_err(|error| content_error(file, "mesh", &error))?;
        let width = |axis: usize| {
            let along = || read.mesh.nodes().iter().map(|node| node[axis]);
            along().fold(f64::MIN, f64::max) - along().fold(f64::MAX, f64::min)
        };
        let width = (0..3).map(width).fold(0.0, f64::max);
        if unit_m.is_none() && width > WIDEST_M {
            let reason =
                format!("{width:.3} m wide; expected --unit mm if its coordinates are millimetres, or --unit m");
            return Err(refuse("mesh", reason));
        }
        let (got, protocol) = (read.electrodes.len(), skin.protocol()?);
        let count = protocol.electrode_count();
        if got != count {
            let reason =
                format!("{got} groups named {prefix}1, {prefix}2, ...; expected {count}, as the skin has electrodes");
            return Err(refuse("electrodes", reason));
        }
        let scale = unit_m.unwrap_or(1.0);
        let nodes = read.mesh.nodes().iter().map(|node| node.map(|x| scale * x)).collect();
        let elements = read.mesh.elements().flatten().copied().collect();
        let mesh = Mesh::new(read.mesh.kind(), nodes, elements).map_err(|error| content_error(file, "mesh", &error))?;
        let rest = vec![skin.sheet_conductance_s(); mesh.element_count()];
        let body =
            ElectrodedMesh::new(mesh, read.electrodes).map_err(|error| content_error(file, "electrodes", &error))?;
        let conductivities = BTreeMap::from([("hom".to_string(), Value::from(rest))]);
        Ok(Self { file: file.to_path_buf(), body, protocol, conductivities })
    }

    /// The selected conductivity, one value per element.
    ///
    /// A name in the case takes precedence over a file of that name. A file is a NumPy array or a text table with the
    /// values in one column or one row.
    ///
    /// # Errors
    /// Neither exists, the number of values is wrong, or a value is not positive and finite.
    pub fn conductivity(&self, choice: &ConductivityChoice) -> Result<Vec<f64>, Error> {
        let elements = self.body.mesh.element_count();
        let name = choice.0.strip_prefix("sigma_").unwrap_or(&choice.0);
        if let Some(values) = self.conductivities.get(name) {
            let key = format!("sigma_{name}");
            let holder = serde_json::Map::from_iter([(key.clone(), values.clone())]);
            let holder = Value::Object(holder);
            let root = Field::root(&self.file, &holder);
            let field = root.need(&key, "a list")?;
            return field
                .list_of(elements, "conductivities (one per element)")?
                .map(|v| v.positive("conductivity"))
                .collect();
        }
        let file = Path::new(&choice.0);
        if !file.exists() {
            let known: Vec<&str> = self.conductivities.keys().map(String::as_str).collect();
            let reason =
                format!("is neither in the case (it has {}) nor is there a file of that name", known.join(", "));
            return Err(Error::Live(dermis_live::Error::Content {
                file: self.file.clone(),
                field: format!("sigma_{name}"),
                reason,
            }));
        }
        conductivity_file(file, elements)
    }

    /// Names of the conductivities in the case.
    pub fn conductivity_names(&self) -> impl Iterator<Item = &str> {
        self.conductivities.keys().map(String::as_str)
    }
}

fn conductivity_entry((key, value): (String, Value)) -> Option<(String, Value)> {
    let name = key.strip_prefix("sigma_")?;
    value.is_array().then(|| (name.to_string(), value))
}

fn conductivity_file(file: &Path, elements: usize) -> Result<Vec<f64>, Error> {
    let content = read_bytes(file)?;
    let refuse = |field: String, reason: String| {
        Error::Live(dermis_live::Error::Content { file: file.to_path_buf(), field, reason })
    };
    let (shape, values) = if content.starts_with(npy::MAGIC) {
        let array = npy::decode(&content, file)?;
        (array.shape, array.values)
    } else {
        let table = csv::parse(&content, file)?;
        (vec![table.rows(), table.columns], table.values)
    };
    let longest = shape.iter().copied().max().unwrap_or(1);
    if values.len() != elements || longest != elements {
        let reason = format!("has shape {shape:?}; expected {elements} conductivities (one per element) in one column");
        return Err(refuse("conductivity".to_string(), reason));
    }
    match values.iter().position(|value| !(*value > 0.0 && value.is_finite())) {
        Some(index) => {
            let reason = format!("is {}; expected a positive, finite conductivity", values[index]);
            Err(refuse(format!("conductivity[{index}]"), reason))
        }
        None => Ok(values),
    }
}

fn mesh(root: &Field<'_>) -> Result<Mesh, Error> {
    let nodes = root.need("nodes", "a list of node coordinates")?;
    let coordinates =
        nodes.list("a list of node coordinates")?.map(|node| coordinates(&node)).collect::<Result<Vec<_>, _>>()?;
    check_count(root, "n_nodes", coordinates.len(), "nodes")?;
    let elems = root.need("elems", "a list of elements")?;
    let kind = kind(root, &elems)?;
    let mut elements = Vec::new();
    for element in elems.list("a list of elements")? {
        for node in element.list_of(kind.nodes_per_element(), "node indices, as in the first element")? {
            elements.push(node.index(coordinates.len(), "nodes")?);
        }
    }
    check_count(root, "n_elems", elements.len() / kind.nodes_per_element(), "elems")?;
    Mesh::new(kind, coordinates, elements).map_err(|error| elems.error(error.to_string()))
}

fn coordinates(node: &Field<'_>) -> Result<[f64; 3], Error> {
    const EXPECTED: &str = "2 or 3 coordinates";
    let count = node.len(EXPECTED)?;
    if !(2..=3).contains(&count) {
        return Err(node.refuse(EXPECTED));
    }
    let mut xyz = [0.0; 3];
    for (slot, coordinate) in xyz.iter_mut().zip(node.list(EXPECTED)?) {
        *slot = coordinate.number()?;
    }
    Ok(xyz)
}

/// Triangles or tetrahedra, judged by the first element and checked against `dim`.
fn kind(root: &Field<'_>, elems: &Field<'_>) -> Result<CellKind, Error> {
    const EXPECTED: &str = "3 node indices (triangle) or 4 (tetrahedron)";
    let Some(first) = elems.list("a list of elements")?.next() else {
        return Err(elems.refuse("at least one element"));
    };
    let kind = match first.len(EXPECTED)? {
        3 => CellKind::Triangle,
        4 => CellKind::Tetrahedron,
        _ => return Err(first.refuse(EXPECTED)),
    };
    let dimension = kind.nodes_per_face();
    match root.get("dim") {
        Some(dim) if dim.number()? != dimension as f64 => {
            Err(dim.refuse(&format!("{dimension}, since elements have {} nodes", kind.nodes_per_element())))
        }
        _ => Ok(kind),
    }
}

fn electrodes(root: &Field<'_>, mesh: &Mesh) -> Result<Vec<Electrode>, Error> {
    let list = root.need("electrodes", "a list of electrodes")?;
    let electrodes = list.list("a list of electrodes")?.map(|e| electrode(&e, mesh)).collect::<Result<Vec<_>, _>>()?;
    if electrodes.len() < 2 {
        return Err(list.error(format!("holds {} electrodes; expected at least 2", electrodes.len())));
    }
    check_count(root, "n_elec", electrodes.len(), "electrodes")?;
    Ok(electrodes)
}

fn electrode(field: &Field<'_>, mesh: &Mesh) -> Result<Electrode, Error> {
    const TYPES: &str = "\"CEM\" (complete electrode model) or \"PEM\" (point electrode)";
    let node_count = mesh.nodes().len();
    let kind = field.need("type", TYPES)?;
    match kind.text(TYPES)? {
        "CEM" => {
            let impedance = field.need("z_contact", "the contact impedance in ohm.m^2 (ohm.m in 2D)")?;
            let faces = field.need("faces", "the mesh faces it touches")?;
            let per_face = mesh.kind().nodes_per_face();
            let face = |face: Field<'_>| -> Result<Vec<u32>, Error> {
                face.list_of(per_face, "node indices")?.map(|node| node.index(node_count, "nodes")).collect()
            };
            let contact = Contact::Faces(faces.list("a list of faces")?.map(face).collect::<Result<_, _>>()?);
            Ok(Electrode { contact, contact_impedance: impedance.positive("contact impedance")? })
        }
        "PEM" => Ok(Electrode { contact: Contact::Point(point(field, node_count)?), contact_impedance: 0.0 }),
        _ => Err(kind.refuse(TYPES)),
    }
}

/// The node of a point electrode: `node`, or `nodes` with a single entry.
fn point(field: &Field<'_>, node_count: usize) -> Result<u32, Error> {
    if field.get("node").is_none()
        && let Some(nodes) = field.get("nodes")
    {
        let mut only = nodes.list_of(1, "node of a point electrode")?;
        return only.next().map_or_else(|| Err(nodes.refuse("one node")), |node| node.index(node_count, "nodes"));
    }
    let node = field.need("node", "the index of a node")?;
    if node.is_list() {
        let mut only = node.list_of(1, "node of a point electrode")?;
        return only.next().map_or_else(|| Err(node.refuse("one node")), |node| node.index(node_count, "nodes"));
    }
    node.index(node_count, "nodes")
}

fn protocol(root: &Field<'_>, electrodes: usize) -> Result<Protocol, Error> {
    let stim = root.need("stim", "stimulations x electrodes, amperes")?;
    let stimulations = rows(&stim, electrodes, "currents (one per electrode)")?;
    for (row, field) in stimulations.iter().zip(stim.list("a list of rows")?) {
        let (sum, scale) = (row.iter().sum::<f64>(), row.iter().fold(0.0, |most: f64, i| most.max(i.abs())));
        // Tolerance on the sum: currents written with ten digits or more meet it.
        if !(scale > 0.0 && sum.abs() <= 1e-6 * scale) {
            return Err(field.error(format!("adds to {sum:e} A; expected currents that add to 0, not all of them 0")));
        }
    }
    let meas = root.need("meas", "measurements x electrodes, weights")?;
    let measurements = rows(&meas, electrodes, "weights (one per electrode)")?;
    check_count(root, "n_meas", measurements.len(), "meas")?;
    for (row, field) in measurements.iter().zip(meas.list("a list of rows")?) {
        if row.iter().all(|weight| *weight == 0.0) {
            return Err(field.error("is all 0; expected a weight on at least one electrode"));
        }
    }
    let meas_stim = root.need("meas_stim", "the stimulation of each measurement")?;
    let of = meas_stim
        .list_of(measurements.len(), "stimulation indices (one per measurement)")?
        .map(|index| Ok(index.index(stimulations.len(), "stimulations")? as usize))
        .collect::<Result<Vec<_>, Error>>()?;
    Protocol::from_rows(&stimulations, &measurements, &of).map_err(|error| meas.error(error.to_string()))
}

fn rows(field: &Field<'_>, columns: usize, what: &str) -> Result<Vec<Vec<f64>>, Error> {
    let row = |row: Field<'_>| row.list_of(columns, what)?.map(|value| value.number()).collect::<Result<Vec<_>, _>>();
    let rows = field.list("a list of rows")?.map(row).collect::<Result<Vec<_>, _>>()?;
    if rows.is_empty() { Err(field.refuse("at least one row")) } else { Ok(rows) }
}

/// Checks an optional count against the length of its list.
fn check_count(root: &Field<'_>, key: &str, found: usize, list: &str) -> Result<(), Error> {
    match root.get(key) {
        Some(count) if count.number()? != found as f64 => Err(count.refuse(&format!("{found}, the length of {list}"))),
        _ => Ok(()),
    }
}

fn content_error(file: &Path, field: &str, reason: &dyn fmt::Display) -> Error {
    Error::Live(dermis_live::Error::Content {
        file: file.to_path_buf(),
        field: field.to_string(),
        reason: reason.to_string(),
    })
}

/// The message for text that isn't JSON, with a hint for the common causes: numbers that JSON cannot hold, or a
/// truncated file.
fn syntax_error(content: &[u8], file: &Path, error: &serde_json::Error) -> Error {
    let place = format!("line {}, column {}", error.line(), error.column());
    let line = content.split(|byte| *byte == b'\n').nth(error.line().saturating_sub(1)).unwrap_or_default();
    let from = error.column().saturating_sub(2).min(line.len());
    let near = String::from_utf8_lossy(&line[from..line.len().min(from + 10)]).into_owned();
    let not_finite = ["NaN", "nan", "Infinity", "inf"].iter().find(|word| near.trim_start_matches('-').contains(*word));
    let reason = match not_finite {
        Some(word) => format!("is {word}; expected a finite number"),
        None if error.is_eof() => "the file ends inside its JSON; it is truncated".to_string(),
        None => {
            let text = error.to_string();
            format!("expected JSON; {}", text.split(" at line").next().unwrap_or(&text))
        }
    };
    Error::Live(dermis_live::Error::Content { file: file.to_path_buf(), field: place, reason })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The unit square as four triangles around its centre, with one electrode on the left side and one on the right.
    const SQUARE: &str = r#"{
        "nodes": [[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]],
        "elems": [[0, 1, 4], [2, 1, 4], [2, 3, 4], [0, 3, 4]],
        "electrodes": [{"type": "CEM", "z_contact": 0.1, "faces": [[0, 3]]}, {"type": "PEM", "node": 1}],
        "stim": [[-1, 1]], "meas": [[-1, 1]], "meas_stim": [0],
        "sigma0": 2, "sigma_hom": [2, 2, 2, 2], "sigma_odd": [2, -1, 2, 2], "notes": {"by": "another tool"}
    }"#;

    fn parse(text: &str) -> Result<Case, Error> {
        Case::parse(text.as_bytes(), Path::new("case.json"))
    }

    fn message_after(from: &str, to: &str) -> String {
        assert!(SQUARE.contains(from), "{from}");
        parse(&SQUARE.replacen(from, to, 1)).unwrap_err().to_string()
    }

    #[test]
    fn a_case_is_read_and_unknown_keys_are_ignored() {
        let case = parse(SQUARE).unwrap();
        assert_eq!(case.body.mesh.element_count(), 4);
        assert_eq!(case.body.electrodes[1].contact, Contact::Point(1));
        assert_eq!(case.protocol.channel_count(), 1);
        assert_eq!(case.conductivity_names().collect::<Vec<_>>(), ["hom", "odd"]);
        for name in ["hom", "sigma_hom"] {
            assert_eq!(case.conductivity(&name.parse().unwrap()).unwrap(), [2.0; 4]);
        }
        assert!(parse(&SQUARE.replace("\"node\": 1", "\"nodes\": [1], \"z_contact\": null")).is_ok());
    }

    #[test]
    fn refusals_name_key_index_value_and_expectation() {
        let table = [
            ("[1, 1],", "[1, 1, 0, 0],", "nodes[2]: is a list of 4 values; expected 2 or 3 coordinates"),
            ("[1, 1],", "[1, \"1\"],", "nodes[2][1]: is \"1\"; expected a finite number"),
            ("[1, 1],", "[1, NaN],", "line 2, column 39: is NaN; expected a finite number"),
            ("[2, 1, 4]", "[2, 5, 4]", "elems[1][1]: is 5; expected a zero-based index of one of 5 nodes"),
            ("[2, 1, 4]", "[2, 1.5, 4]", "elems[1][1]: is 1.5; expected a zero-based index"),
            ("[2, 1, 4]", "[2, 1]", "elems[1]: holds 2 values; expected 3 node indices"),
            ("[2, 1, 4]", "[1, 1, 4]", "elems: element 1 is degenerate"),
            ("\"sigma0\": 2", "\"n_elems\": 5", "n_elems: is 5; expected 4, the length of elems"),
            ("\"sigma0\": 2", "\"dim\": 3", "dim: is 3; expected 2, since elements have 3 nodes"),
            ("\"CEM\"", "\"cem\"", "electrodes[0].type: is \"cem\"; expected \"CEM\""),
            ("0.1", "0", "electrodes[0].z_contact: is 0; expected a positive contact impedance"),
            ("\"z_contact\": 0.1, ", "", "electrodes[0].z_contact: is missing; expected the contact impedance"),
            ("[[0, 3]]", "[[0, 2]]", "electrodes: electrode 0: face [0, 2] is not a face of the mesh"),
            ("[[0, 3]]", "[[0, 3, 1]]", "electrodes[0].faces[0]: holds 3 values; expected 2 node indices"),
            ("\"node\": 1", "\"node\": 9", "electrodes[1].node: is 9; expected a zero-based index of one of 5 nodes"),
            ("\"stim\": [[-1, 1]]", "\"stim\": [[1, 1]]", "stim[0]: adds to 2e0 A; expected currents that add to 0"),
            ("\"meas\": [[-1, 1]]", "\"meas\": [[-1]]", "meas[0]: holds 1 values; expected 2 weights"),
            ("\"meas\": [[-1, 1]]", "\"meas\": [[0, 0]]", "meas[0]: is all 0"),
            ("\"meas_stim\": [0]", "\"meas_stim\": [1]", "meas_stim[0]: is 1; expected a zero-based index of one of 1"),
            ("\"meas_stim\": [0]", "\"meas_stim\": []", "meas_stim: holds 0 values; expected 1 stimulation indices"),
            ("\"meas_stim\": [0],", "", "meas_stim: is missing"),
        ];
        for (from, to, expected) in table {
            let message = message_after(from, to);
            assert!(message.starts_with(&format!("case.json: {expected}")), "{to}: {message}");
        }
        let truncated = parse(&SQUARE[..SQUARE.len() / 2]).unwrap_err().to_string();
        assert!(truncated.contains("truncated"), "{truncated}");
        let list = parse("[1]").unwrap_err().to_string();
        assert!(list.starts_with("case.json: document: is a list of 1 values; expected an object"), "{list}");
    }

    #[test]
    fn conductivities_are_checked_when_asked_for() {
        let case = parse(SQUARE).unwrap();
        let message = |name: &str| case.conductivity(&name.parse().unwrap()).unwrap_err().to_string();
        assert_eq!(message("odd"), "case.json: sigma_odd[1]: is -1; expected a positive conductivity");
        let unknown = message("none.csv");
        assert!(unknown.contains("sigma_none.csv") && unknown.contains("it has hom, odd"), "{unknown}");
    }

    #[test]
    fn conductivity_files_are_columns_or_rows() {
        let case = parse(SQUARE).unwrap();
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("sigma.txt");
        let chosen = || case.conductivity(&path.to_str().unwrap().parse().unwrap());
        for text in ["1\n2\n3\n4\n", "sigma\n1\n2\n3\n4\n", "1,2,3,4\n"] {
            std::fs::write(&path, text).unwrap();
            assert_eq!(chosen().unwrap(), [1.0, 2.0, 3.0, 4.0], "{text:?}");
        }
        npy::write_f64(&path, &[4], &[1.0, 2.0, 3.0, 4.0]).unwrap();
        assert_eq!(chosen().unwrap(), [1.0, 2.0, 3.0, 4.0]);
        for (text, expected) in [
            ("1\n2\n3\n", "has shape [3, 1]; expected 4 conductivities"),
            ("1,2\n3,4\n", "has shape [2, 2]"),
            ("1\nnan\n3\n4\n", "conductivity[1]: is NaN; expected a positive"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = chosen().unwrap_err().to_string();
            assert!(message.contains(expected), "{text:?}: {message}");
        }
    }
}
