use super::*;

fn square() -> (Vec<[f64; 3]>, Vec<u32>) {
    (vec![[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]], vec![0, 1, 2, 0, 2, 3])
}

#[test]
fn measures_and_faces_of_a_square() {
    let (nodes, elements) = square();
    let mesh = Mesh::new(CellKind::Triangle, nodes, elements).unwrap();
    assert_eq!(mesh.measures(), &[0.5, 0.5]);
    assert_eq!(mesh.boundary_faces().len(), 4);
    assert_eq!(mesh.neighbours(), vec![[0, 1]]);
}

#[test]
fn folded_elements_are_refused() {
    let (mut nodes, elements) = square();
    nodes[3] = [0.9, 0.1, 0.];
    let error = Mesh::new(CellKind::Triangle, nodes, elements).unwrap_err();
    assert!(matches!(error, MeshError::Folded { .. }), "{error}");
}

#[test]
fn bad_meshes_name_the_offender() {
    let (nodes, _) = square();
    let with = |elements: Vec<u32>| Mesh::new(CellKind::Triangle, nodes.clone(), elements).unwrap_err();
    assert!(matches!(with(vec![0, 1]), MeshError::Count { got: 2, .. }));
    assert!(matches!(with(vec![0, 1, 9]), MeshError::NodeOutOfRange { node: 9, .. }));
    assert!(matches!(with(vec![0, 1, 1]), MeshError::Degenerate { element: 0, .. }));
    assert!(matches!(with(vec![0, 1, 2]), MeshError::Orphan { node: 3 }));
    let mut two = nodes.clone();
    two.extend([[5., 0., 0.], [6., 0., 0.], [5., 1., 0.]]);
    let error = Mesh::new(CellKind::Triangle, two, vec![0, 1, 2, 0, 2, 3, 4, 5, 6]).unwrap_err();
    assert!(matches!(error, MeshError::Disconnected { parts: 2, .. }), "{error}");
}

#[test]
fn electrodes_that_overlap_are_refused() {
    let (nodes, elements) = square();
    let mesh = Mesh::new(CellKind::Triangle, nodes, elements).unwrap();
    let on = |faces: Vec<Vec<u32>>| Electrode { contact: Contact::Faces(faces), contact_impedance: 0.1 };
    assert!(ElectrodedMesh::new(mesh.clone(), vec![on(vec![vec![0, 1]]), on(vec![vec![2, 3]])]).is_ok());
    let error = ElectrodedMesh::new(mesh.clone(), vec![on(vec![vec![0, 1]]), on(vec![vec![1, 0]])]).unwrap_err();
    assert_eq!(error.to_string(), "electrode 1: overlaps electrode 0");
    assert!(ElectrodedMesh::new(mesh, vec![on(vec![vec![1, 3]])]).is_err());
}
