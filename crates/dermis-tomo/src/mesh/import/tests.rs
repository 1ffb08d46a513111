//! MSH files: valid ones are read, invalid ones are refused, and nothing panics.

use proptest::prelude::*;

use super::*;

/// A unit square of two triangles and a spare node, with electrodes on its left and right sides, in reverse order.
const SQUARE: &str = "$MeshFormat
4.1 0 8
$EndMeshFormat
$PhysicalNames
3
1 7 \"electrode2\"
1 8 \"electrode 1\"
2 9 \"skin\"
$EndPhysicalNames
$Entities
1 2 1 0
1 0 0 0 0
1 0 0 0 0 1 0 1 7 2 1 -2
2 1 0 0 1 1 0 1 8 0
1 0 0 0 1 1 0 1 9 2 1 2
$EndEntities
$Comments
anything at all
$EndComments
$Nodes
2 5 1 99
2 1 0 4
10
20
30
40
0 0 0
1 0 0
1 1 0
0 1 0
0 1 0 1
99
5 5 0
$EndNodes
$Elements
3 4 1 4
1 1 1 1
1 10 40
1 2 1 1
2 20 30
2 1 2 2
3 10 20 30
4 10 30 40
$EndElements
";

const TETRAHEDRON: &str = "$MeshFormat
4.1 0 8
$EndMeshFormat
$Entities
1 0 1 1
1 0 0 0 1 5
1 0 0 0 1 1 0 1 3 0
1 0 0 0 1 1 1 0 1 1
$EndEntities
$Nodes
1 4 1 4
3 1 0 4
1
2
3
4
0 0 0
1 0 0
0 1 0
0 0 1
$EndNodes
$Elements
3 3 1 3
0 1 15 1
1 4
2 1 2 1
2 1 2 3
3 1 4 1
3 1 2 3 4
$EndElements
";

fn named(prefix: &str) -> ElectrodeGroups {
    ElectrodeGroups::Prefix(prefix.into())
}

#[test]
fn names_give_electrodes_in_the_order_of_their_numbers() {
    let mesh = read_msh(SQUARE.as_bytes(), &named("electrode"), &[0.1, 0.2]).unwrap();
    assert_eq!(mesh.mesh.measures(), &[0.5, 0.5]);
    assert_eq!(mesh.mesh.nodes().len(), 4, "the spare node is left out");
    let Contact::Faces(faces) = &mesh.electrodes[0].contact else { panic!("no faces") };
    assert!(faces[0].iter().all(|&node| mesh.mesh.nodes()[node as usize][0] == 1.0), "electrode 1 is on the right");
    assert_eq!(mesh.electrodes[1].contact_impedance, 0.2);
    let windows = SQUARE.replace('\n', "\r\n");
    assert!(read_msh(windows.as_bytes(), &named("electrode"), &[0.1, 0.2]).unwrap() == mesh);
    assert!(read_msh(SQUARE.as_bytes(), &named("pin"), &[0.1]).unwrap().electrodes.is_empty());
}

#[test]
fn tags_give_faces_areas_and_points() {
    let groups = ElectrodeGroups::Tags(vec![(2, 3), (0, 5)]);
    let mesh = read_msh(TETRAHEDRON.as_bytes(), &groups, &[0.1]).unwrap();
    assert_eq!(mesh.mesh.kind(), CellKind::Tetrahedron);
    assert_eq!(mesh.electrode_measures(), vec![0.5, 0.0]);
    assert_eq!(mesh.electrodes[1].contact, Contact::Point(3));
    let area = read_msh(SQUARE.as_bytes(), &ElectrodeGroups::Tags(vec![(2, 9)]), &[0.1]).unwrap();
    assert_eq!(area.electrodes[0].contact, Contact::Area(vec![0, 1]));
}

#[test]
fn mistakes_carry_their_line() {
    let refused = |from: &str, to: &str| {
        assert!(SQUARE.contains(from), "{from}");
        let text = SQUARE.replacen(from, to, 1);
        read_msh(text.as_bytes(), &named("electrode"), &[0.1]).unwrap_err().to_string()
    };
    let cases = [
        ("4.1 0 8", "4.0 0 8", "line 2: expected version 2.2 or 4.1"),
        ("4.1 0 8", "4.1 1 8", "is not the number one in either byte order"),
        ("$MeshFormat", "solid cube", "line 1: not an MSH file"),
        ("1 1 0\n0 1 0", "1 one 0\n0 1 0", "line 29: \"one\" in node coordinates is not a number"),
        ("1 1 0\n0 1 0", "1 nan 0\n0 1 0", "line 29: node 30: coordinate NaN"),
        ("3 10 20 30", "3 10 20 31", "element 3 names node 31"),
        ("2 1 2 2\n", "2 1 9 2\n", "element type 9"),
        ("$EndElements\n", "", "the file ends where $EndElements"),
        ("2 1 2 2\n", "2 1 2 2000000000\n", "\"$EndElements\" in an element is not a number"),
        ("2 5 1 99", "2 5 1", "expected 4 numbers, got 3"),
        ("20\n30\n", "20\n20\n", "node 20 is given twice"),
        ("4 10 30 40", "4 10 30 30", "element 1 is degenerate"),
        ("\"electrode 1\"", "\"electrode2\"", "given to one group only"),
    ];
    for (from, to, expected) in cases {
        let message = refused(from, to);
        assert!(message.contains(expected), "{message:?} should say {expected:?}");
    }
    let error = read_msh(b"$MeshFormat\n\xff\n", &named("e"), &[0.1]).unwrap_err();
    assert!(matches!(error, MeshError::Parse { line: 2, .. }), "{error}");
    let missing = ElectrodeGroups::Tags(vec![(1, 77)]);
    let error = read_msh(SQUARE.as_bytes(), &missing, &[0.1]).unwrap_err().to_string();
    assert!(error.contains("electrode 0: physical group 77 of dimension 1 has no elements"), "{error}");
}

/// A disc of 12 triangles with a spare node and four edges as electrodes, as written by meshio 5.3.
const DISC_22: &[u8] = include_bytes!("fixtures/disc22.msh");
const DISC_22_BINARY: &[u8] = include_bytes!("fixtures/disc22_binary.msh");
const DISC_41: &[u8] = include_bytes!("fixtures/disc41.msh");
const DISC_41_BINARY: &[u8] = include_bytes!("fixtures/disc41_binary.msh");

#[test]
fn files_of_both_versions_are_read_as_text_and_binary() {
    let text = read_msh(DISC_22, &named("electrode"), &[0.1]).unwrap();
    assert_eq!((text.mesh.nodes().len(), text.mesh.element_count(), text.electrodes.len()), (13, 12, 4));
    assert!(read_msh(DISC_22_BINARY, &named("electrode"), &[0.1]).unwrap() == text);
    // The third electrode is opposite the first.
    let centre = |k: usize| text.electrode_centre(k);
    assert!((0..2).all(|axis| (centre(0)[axis] + centre(2)[axis]).abs() < 1e-12), "{:?} {:?}", centre(0), centre(2));
    // In version 4.1 this writer states the group of the triangles but not of the lines.
    let groups = ElectrodeGroups::Tags(vec![(2, 9)]);
    let new = read_msh(DISC_41, &groups, &[0.1]).unwrap();
    assert!(new.mesh == text.mesh && read_msh(DISC_41_BINARY, &groups, &[0.1]).unwrap() == new);
}

proptest! {
    #[test]
    fn mutated_binary_files_are_read_or_refused(
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in any::<prop::sample::Index>(),
        old in any::<bool>(),
    ) {
        let mut bytes = if old { DISC_22_BINARY } else { DISC_41_BINARY }.to_vec();
        for (place, byte) in edits {
            let index = place.index(bytes.len());
            bytes[index] = byte;
        }
        let _ = read_msh(&bytes, &named("electrode"), &[0.1]);
        bytes.truncate(cut.index(bytes.len()));
        let _ = read_msh(&bytes, &named("electrode"), &[0.1]);
    }

    #[test]
    fn any_bytes_are_read_or_refused(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = read_msh(&bytes, &named(""), &[0.1]);
        let mut framed = b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n".to_vec();
        framed.extend(&bytes);
        let _ = read_msh(&framed, &named(""), &[0.1]);
    }

    /// Changes, drops or doubles bytes, words and lines of valid files.
    #[test]
    fn mutated_files_are_read_or_refused(
        edits in prop::collection::vec((any::<prop::sample::Index>(), 0usize..5, any::<i64>(), any::<u8>()), 1..5),
        solid in any::<bool>(),
    ) {
        let source = if solid { TETRAHEDRON } else { SQUARE };
        let mut lines: Vec<String> = source.lines().map(str::to_string).collect();
        for (place, how, number, byte) in edits {
            let index = place.index(lines.len());
            match how {
                0 => { lines.remove(index); }
                1 => lines.insert(index, lines[index].clone()),
                2 => lines[index] = number.to_string(),
                3 => {
                    let mut words: Vec<String> = lines[index].split(' ').map(str::to_string).collect();
                    let word = byte as usize % words.len();
                    words[word] = number.to_string();
                    lines[index] = words.join(" ");
                }
                _ => lines[index].push(char::from(byte)),
            }
            if lines.is_empty() {
                break;
            }
        }
        let groups = [named("electrode"), ElectrodeGroups::Tags(vec![(2, 3), (0, 5), (1, i64::MIN), (9, 1)])];
        for group in groups {
            let _ = read_msh(lines.join("\n").as_bytes(), &group, &[0.1]);
        }
    }
}
