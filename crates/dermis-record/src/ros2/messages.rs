//! Messages of ROS 2 that a node sends in addition to those of recordings, as CDR.

use super::names::NodeName;
use super::shape::{PatchLimits, PatchShape};
use crate::cdr::{CdrReader, CdrWriter};
use crate::messages::Stamp;
use crate::view::{FLOAT32, cloud};
use dermis_body::{Taxels, Transform, Vector};
use dermis_touch::ReferenceRecord;
use dermis_touch::guard::{GuardReason, GuardReport};

fn message(write: impl FnOnce(&mut CdrWriter<'_>)) -> Vec<u8> {
    let mut bytes = Vec::new();
    write(&mut CdrWriter::new(&mut bytes));
    bytes
}

fn vector(cdr: &mut CdrWriter<'_>, values: Vector) {
    values.into_iter().for_each(|value| cdr.f64(value));
}

fn strings<'a>(cdr: &mut CdrWriter<'_>, texts: impl ExactSizeIterator<Item = &'a str>) {
    cdr.length(texts.len());
    texts.for_each(|text| cdr.string(text));
}

/// `geometry_msgs/WrenchStamped`: force (newtons) on the sensor and torque (newton metres) about the frame's origin.
pub(super) fn wrench(stamp: Stamp<'_>, force_n: Vector, torque_nm: Vector) -> Vec<u8> {
    message(|cdr| {
        cdr.header(stamp.wall_ns, stamp.frame_id);
        vector(cdr, force_n);
        vector(cdr, torque_nm);
    })
}

/// `sensor_msgs/PointCloud2` of the cells with their outward normals, the image's values and their standard deviations.
pub(super) fn cells(stamp: Stamp<'_>, cells: &Taxels, sigmas: &[f32], image: &[f32]) -> Vec<u8> {
    let fields = ["x", "y", "z", "nx", "ny", "nz", "pressure", "sigma"].map(|name| (name, FLOAT32));
    message(|cdr| {
        cdr.header(stamp.wall_ns, stamp.frame_id);
        cloud(cdr, &fields, cells.len(), |out| {
            for (index, pixel) in cells.pixels.iter().enumerate() {
                let [x, y, z] = cells.positions_m[index].map(|m| m as f32);
                let [nx, ny, nz] = cells.normals[index].map(|value| value as f32);
                let value = image.get(*pixel as usize).copied().unwrap_or(f32::NAN);
                let sigma = sigmas.get(index).copied().unwrap_or(f32::NAN);
                out.extend([x, y, z, nx, ny, nz, value, sigma].iter().flat_map(|number| number.to_le_bytes()));
            }
        });
    })
}

/// `dermis_msgs/Guard`.
pub(super) fn guard(stamp: Stamp<'_>, sequence: u64, report: &GuardReport) -> Vec<u8> {
    let reasons: Vec<&str> = report.reasons.iter().map(GuardReason::name).collect();
    message(|cdr| {
        cdr.header(stamp.wall_ns, stamp.frame_id);
        cdr.u64(sequence);
        cdr.string(report.verdict.name());
        strings(cdr, reasons.into_iter());
        cdr.bool(false);
        cdr.f64(1e-9 * report.stale_after_ns as f64);
    })
}

/// `dermis_msgs/Patch`. The noise is given for each cell, as in `cells`.
pub(super) fn patch(
    stamp: Stamp<'_>,
    shape: &PatchShape,
    limits: &PatchLimits,
    sigmas: &[f32],
    baseline: Option<(&ReferenceRecord, &str)>,
) -> Vec<u8> {
    message(|cdr| {
        cdr.header(stamp.wall_ns, stamp.frame_id);
        cdr.string(&shape.skin);
        cdr.string(shape.link.as_deref().unwrap_or_default());
        cdr.string(&shape.source);
        cdr.f64(shape.frames_per_s.unwrap_or(f64::NAN));
        for number in [shape.channels, shape.rows, shape.columns] {
            cdr.u32(number as u32);
        }
        let cells = &shape.cells;
        cdr.length(cells.len());
        cells.pixels.iter().for_each(|pixel| cdr.u32(*pixel));
        for list in [&cells.positions_m, &cells.normals] {
            cdr.length(list.len());
            list.iter().flatten().for_each(|value| cdr.f32(*value as f32));
        }
        cdr.length(cells.len());
        cells.areas_m2.iter().for_each(|area| cdr.f32(*area as f32));
        cdr.string(&shape.quantity);
        cdr.string(&shape.unit);
        cdr.length(cells.len());
        (0..cells.len()).for_each(|index| cdr.f32(sigmas.get(index).copied().unwrap_or(f32::NAN)));
        let force_from = limits.force_from.unwrap_or_default();
        cdr.string(force_from);
        cdr.f64(limits.touch_over_noise);
        let guard = limits.guard.as_ref();
        cdr.f64(guard.and_then(|guard| guard.force_n).unwrap_or(f64::NAN));
        cdr.f64(guard.and_then(|guard| guard.pressure_pa).unwrap_or(f64::NAN));
        cdr.bool(guard.is_some_and(|guard| guard.any_touch));
        cdr.f64(guard.map_or(f64::NAN, |guard| 1e-9 * guard.stale_after_ns as f64));
        cdr.string(baseline.map_or("", |(_, origin)| origin));
        cdr.u64(baseline.map_or(0, |(record, _)| record.frames as u64));
        strings(cdr, [format!("{} voltages per frame", shape.channels).as_str()].into_iter());
        let force = if force_from.is_empty() { "force: unknown".to_owned() } else { format!("force: by {force_from}") };
        let image = format!("image: {}, by the model of the skin", shape.quantity);
        let inferred =
            [image.as_str(), "touches: presses that explain the frame", &force, "normals and areas: by the skin file"];
        strings(cdr, inferred.into_iter());
    })
}

/// Level of a `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Level {
    Ok,
    Warn,
    Error,
    Stale,
}

/// A `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug)]
pub(super) struct Diagnosis {
    pub level: Level,
    pub name: String,
    pub message: String,
    pub hardware_id: String,
    pub values: Vec<(&'static str, String)>,
}

/// `diagnostic_msgs/DiagnosticArray`.
pub(super) fn diagnostics(wall_ns: u64, all: &[Diagnosis]) -> Vec<u8> {
    message(|cdr| {
        cdr.header(wall_ns, "");
        cdr.length(all.len());
        for Diagnosis { level, name, message, hardware_id, values } in all {
            cdr.u8(*level as u8);
            [name, message, hardware_id].into_iter().for_each(|text| cdr.string(text));
            cdr.length(values.len());
            for (key, value) in values {
                cdr.string(key);
                cdr.string(value);
            }
        }
    })
}

/// Pose of one frame of reference in another.
#[derive(Clone, Debug, PartialEq)]
pub struct NamedTransform {
    /// The outer frame.
    pub parent: String,
    /// The inner frame.
    pub child: String,
    /// Coordinates in the inner frame to coordinates in the outer one.
    pub parent_from_child: Transform,
}

/// `tf2_msgs/TFMessage`.
pub(super) fn transforms(wall_ns: u64, all: &[NamedTransform]) -> Vec<u8> {
    message(|cdr| {
        cdr.length(all.len());
        for NamedTransform { parent, child, parent_from_child } in all {
            cdr.header(wall_ns, parent);
            cdr.string(child);
            vector(cdr, parent_from_child.translation_m);
            parent_from_child.quaternion().into_iter().for_each(|value| cdr.f64(value));
        }
    })
}

/// `rmw_dds_common/ParticipantEntitiesInfo`, with identities of 16 bytes as from Iron on: the node and its endpoints.
pub(super) fn participant(guid: [u8; 16], node: &NodeName, writers: &[[u8; 16]], readers: &[[u8; 16]]) -> Vec<u8> {
    message(|cdr| {
        guid.into_iter().for_each(|byte| cdr.u8(byte));
        cdr.length(1);
        cdr.string(node.namespace());
        cdr.string(node.name());
        for list in [readers, writers] {
            cdr.length(list.len());
            list.iter().flatten().for_each(|byte| cdr.u8(*byte));
        }
    })
}

/// Length of the header that rmw_cyclonedds puts in front of requests and replies: the client's identity and a number.
/// rmw_fastrtps has both outside the message.
const CYCLONE_HEADER: usize = 16;
/// Encapsulation of a message.
const ENCAPSULATION: usize = 4;

/// The header of a request to `std_srvs/srv/Trigger`, if its client uses rmw_cyclonedds. The request itself is one
/// byte.
pub(super) fn cyclone_header(request: &[u8]) -> Option<[u8; CYCLONE_HEADER]> {
    request.get(ENCAPSULATION..ENCAPSULATION + CYCLONE_HEADER)?.try_into().ok()
}

/// The reply of `std_srvs/srv/Trigger`.
pub(super) fn trigger_reply(cyclone: Option<[u8; CYCLONE_HEADER]>, success: bool, text: &str) -> Vec<u8> {
    message(|cdr| {
        cyclone.into_iter().flatten().for_each(|byte| cdr.u8(byte));
        cdr.bool(success);
        cdr.string(text);
    })
}

/// Names and positions of a `sensor_msgs/JointState`; `None` for other bytes, or lists of different lengths.
pub(super) fn read_joints(bytes: &[u8]) -> Option<Vec<(String, f64)>> {
    let mut cdr = CdrReader::new(bytes)?;
    let (_, _, _) = (cdr.u32()?, cdr.u32()?, cdr.string()?);
    let names = (0..cdr.length(4)?).map(|_| cdr.string().map(str::to_owned)).collect::<Option<Vec<_>>>()?;
    let mut positions = Vec::new();
    cdr.doubles(&mut positions)?;
    (names.len() == positions.len()).then(|| names.into_iter().zip(positions).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use byteorder::LittleEndian;
    use serde::Deserialize;
    use serde::de::DeserializeOwned;

    /// Decodes a message with an independent implementation, and checks that nothing is left over.
    fn decode<T: DeserializeOwned>(message: &[u8]) -> T {
        let (encapsulation, body) = message.split_at(ENCAPSULATION);
        assert_eq!(encapsulation, [0, 1, 0, 0]);
        let (value, read) = cdr_encoding::from_bytes::<T, LittleEndian>(body).expect("CDR");
        assert_eq!(read, body.len());
        value
    }

    type Header = ((i32, u32), String);
    const STAMP: Stamp<'_> = Stamp { wall_ns: 5_000_000_007, frame_id: "palm" };

    fn header() -> Header {
        ((5, 7), "palm".to_owned())
    }

    #[test]
    fn wrenches_and_transforms_have_the_layout_of_ros() {
        let (found, force, torque): (Header, [f64; 3], [f64; 3]) =
            decode(&wrench(STAMP, [0.0, 0.0, -2.0], [0.1, 0.2, 0.3]));
        assert_eq!((found, force, torque), (header(), [0.0, 0.0, -2.0], [0.1, 0.2, 0.3]));

        let turned = Transform::from_xyz_rpy([1.0, 2.0, 3.0], [0.0, 0.0, std::f64::consts::PI]);
        let mount = NamedTransform { parent: "palm".into(), child: "skin".into(), parent_from_child: turned };
        let found: Vec<(Header, String, [f64; 3], [f64; 4])> = decode(&transforms(STAMP.wall_ns, &[mount]));
        let (outer, child, place, turn) = &found[0];
        assert_eq!((outer, child.as_str(), place), (&header(), "skin", &[1.0, 2.0, 3.0]));
        assert!((turn[2].abs() - 1.0).abs() < 1e-12 && turn[3].abs() < 1e-12, "{turn:?}");
    }

    #[test]
    fn diagnostics_and_verdicts_have_the_layout_of_ros() {
        type Row = (u8, String, String, String, Vec<(String, String)>);
        let row = Diagnosis {
            level: Level::Warn,
            name: "dermis: palm".into(),
            message: "3 channels left out".into(),
            hardware_id: "twin".into(),
            values: vec![("frames", "12".into())],
        };
        let (found, rows): (Header, Vec<Row>) = decode(&diagnostics(STAMP.wall_ns, &[row.clone(), row]));
        assert_eq!((found.0, rows.len()), ((5, 7), 2));
        assert_eq!((rows[1].0, rows[1].4[0].1.as_str()), (1, "12"));

        let report = GuardReport::before_frames(0, 100_000_000);
        type Verdict = (Header, u64, String, Vec<String>, bool, f64);
        let (found, sequence, verdict, reasons, is_rated, valid_s): Verdict = decode(&guard(STAMP, 9, &report));
        assert_eq!((found, sequence, verdict.as_str(), is_rated), (header(), 9, "stale", false));
        assert_eq!((reasons, valid_s), (vec!["no-baseline".to_owned()], 0.1));
    }

    #[derive(Debug, Deserialize)]
    struct NodeEntities {
        namespace: String,
        name: String,
        readers: Vec<[u8; 16]>,
        writers: Vec<[u8; 16]>,
    }

    #[test]
    fn a_node_announces_its_name_and_endpoints() {
        let node: NodeName = "/robot/skin".parse().unwrap();
        let message = participant([1; 16], &node, &[[2; 16], [3; 16]], &[[4; 16]]);
        let (guid, nodes): ([u8; 16], Vec<NodeEntities>) = decode(&message);
        assert_eq!((guid, nodes[0].namespace.as_str(), nodes[0].name.as_str()), ([1; 16], "/robot", "skin"));
        assert_eq!((&nodes[0].readers, &nodes[0].writers), (&vec![[4; 16]], &vec![[2; 16], [3; 16]]));
    }

    #[test]
    fn requests_for_a_tare_are_understood_in_both_forms() {
        // With rmw_fastrtps the request is one byte. Some senders pad it.
        assert_eq!(cyclone_header(&[0, 1, 0, 0, 0]), None);
        assert_eq!(cyclone_header(&[0, 1, 0, 0, 0, 0, 0, 0]), None);
        let request = [&[0, 1, 0, 0][..], &[7; 16], &[0]].concat();
        assert_eq!(cyclone_header(&request), Some([7; 16]));
        assert_eq!(decode::<(bool, String)>(&trigger_reply(None, true, "done")), (true, "done".to_owned()));
        let (client, number, success, text): (u64, i64, bool, String) =
            decode(&trigger_reply(Some([1; 16]), false, "no"));
        assert_eq!((client, number, success, text.as_str()), (0x0101_0101_0101_0101, client as i64, false, "no"));
    }

    #[test]
    fn joint_states_are_accepted_and_other_messages_refused() {
        let write = |names: &[&str], positions: &[f64]| {
            message(|cdr| {
                cdr.header(1, "");
                strings(cdr, names.iter().copied());
                cdr.doubles(positions);
                cdr.doubles(&[]);
                cdr.doubles(&[0.5]);
            })
        };
        let found = read_joints(&write(&["elbow", "wrist"], &[0.25, -1.0])).unwrap();
        assert_eq!(found, [("elbow".to_owned(), 0.25), ("wrist".to_owned(), -1.0)]);
        assert_eq!(read_joints(&write(&["elbow"], &[])), None, "a driver that gives velocities alone");
        let whole = write(&["elbow"], &[0.25]);
        for end in 0..40 {
            assert_eq!(read_joints(&whole[..end]), None, "{end}");
        }
    }
}
