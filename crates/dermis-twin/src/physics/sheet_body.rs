//! Data of a sheet derived from its mesh: triangles, electrode terms, and positions of its unknowns.

use dermis_tomo::mesh::{Contact, ElectrodedMesh, Point};
use dermis_tomo::sparse::SparseError;

/// One entry of the constant part, the electrode contacts. Unknowns from the node count on are electrodes.
#[derive(Clone, Copy, Debug)]
pub(super) struct ContactEntry {
    pub(super) row: u32,
    pub(super) column: u32,
    pub(super) value: f64,
}

pub(super) fn refuse(reason: String) -> SparseError {
    SparseError::Structure { reason }
}

pub(super) fn triangles_of(body: &ElectrodedMesh) -> Result<Vec<[u32; 3]>, SparseError> {
    let triangle = |cell: &[u32]| match *cell {
        [a, b, c] => Ok([a, b, c]),
        _ => Err(refuse(format!("two sheets need triangles; an element has {} nodes", cell.len()))),
    };
    body.mesh.elements().map(triangle).collect()
}

/// The terms of the complete electrode model, lower triangle by unknown, without the reference electrode's unknown.
pub(super) fn contact_entries(body: &ElectrodedMesh) -> Result<Vec<ContactEntry>, SparseError> {
    let (mesh, nodes) = (&body.mesh, body.mesh.nodes().len() as u32);
    let reference = body.electrodes.len().saturating_sub(1);
    if reference == 0 {
        return Err(refuse(format!("expected at least 2 electrodes, got {}", body.electrodes.len())));
    }
    let mut entries = Vec::new();
    for (index, electrode) in body.electrodes.iter().enumerate() {
        let patches: Vec<(&[u32], f64)> = match &electrode.contact {
            Contact::Area(elements) => elements
                .iter()
                .map(|&element| (mesh.element(element as usize), mesh.measures()[element as usize]))
                .collect(),
            Contact::Faces(faces) => faces.iter().map(|face| (face.as_slice(), mesh.face_measure(face))).collect(),
            Contact::Point(node) => {
                return Err(refuse(format!("electrode {index} is a point (node {node}), not a pad")));
            }
        };
        let unknown = (index < reference).then_some(nodes + index as u32);
        for (corners, measure) in patches {
            let (conductance, count) = (measure / electrode.contact_impedance, corners.len() as f64);
            let mut push = |a: u32, b: u32, value: f64| {
                entries.push(ContactEntry { row: a.max(b), column: a.min(b), value });
            };
            for (i, &a) in corners.iter().enumerate() {
                for (j, &b) in corners[..=i].iter().enumerate() {
                    let weight = if i == j { 2.0 } else { 1.0 };
                    push(a, b, conductance * weight / (count * (count + 1.0)));
                }
                if let Some(unknown) = unknown {
                    push(unknown, a, -conductance / count);
                }
            }
            if let Some(unknown) = unknown {
                push(unknown, unknown, conductance);
            }
        }
    }
    Ok(entries)
}

/// Positions of the unknowns, for the elimination order.
pub(super) fn coordinates(body: &ElectrodedMesh, positions: &[Point]) -> Vec<[f64; 3]> {
    let mut places: Vec<[f64; 3]> = positions.iter().map(|p| [p[0], p[1], 0.0]).collect();
    let electrodes = body.electrodes.len() - 1;
    places.extend((0..electrodes).map(|electrode| body.electrode_centre(electrode)));
    places
}
