//! Skins whose outline and electrodes come from a mesh file, and rim electrodes given by position.

use std::path::Path;

use dermis_lab::case::Case;
use dermis_live::prepare::Prepared;
use dermis_skin::{Electrodes, Shape, Skin};

/// A skin file for the mesh from the importer's tests: a 1 m disc from meshio with 12 boundary edges, four of which
/// are electrodes, and a node that belongs to no element.
fn skin(mesh: &str, more: &str) -> Result<Skin, String> {
    let folder = tempfile::tempdir().unwrap();
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../dermis-tomo/src/mesh/import/fixtures");
    for name in ["disc22.msh", "disc22_binary.msh"] {
        std::fs::copy(fixtures.join(name), folder.path().join(name)).unwrap();
    }
    let wide =
        std::fs::read_to_string(fixtures.join("disc22.msh")).unwrap().replace("e-01", "e+01").replace("e-02", "e+00");
    std::fs::write(folder.path().join("wide.msh"), wide).unwrap();
    let text = format!(
        "name = \"mesh\"\nmodality = \"eit\"\n[frontend]\nshape = {{ mesh = {{ {mesh} }} }}\n{more}\ncontact_impedance_ohm_m2 = 1e-4\n\
         layer = {{ kind = \"sheet\", thickness_mm = 5.0, conductivity_s_per_m = 0.3, modulus_kpa = 50.0 }}\n\
         [backend]\ncurrent_ma = 1.0\nchannels = [[1, 2, 3, 4], [2, 3, 4, 1], [1, 3], [2, 4]]\n[imaging]\ngrid = 24\nelements = 500\n"
    );
    let file = folder.path().join("skin.toml");
    std::fs::write(&file, text).unwrap();
    Skin::open(file.to_str().unwrap()).map_err(|error| error.to_string())
}

#[test]
fn outline_and_electrodes_are_those_of_the_mesh() {
    let text = skin("file = \"disc22.msh\"", "").unwrap();
    let Shape::Polygon { outer_mm, holes_mm } = &text.frontend.shape else { panic!("a polygon") };
    assert_eq!((outer_mm.len(), holes_mm.len()), (12, 0));
    let Electrodes::RimList(list) = &text.frontend.electrodes else { panic!("a list") };
    assert_eq!(list.len(), 4);
    // Centres of the electrodes in the mesh: edges 1-2, 4-5, 7-8 and 10-11 of 12.
    let body = text.body().unwrap();
    for (k, degrees) in [15.0_f64, 105.0, 195.0, 285.0].into_iter().enumerate() {
        let [x, y, _] = body.mesh.electrode_centre(k);
        let apart = (y.atan2(x).to_degrees() - degrees + 540.0).rem_euclid(360.0) - 180.0;
        assert!(apart.abs() < 0.5, "electrode {k} at {} degrees", y.atan2(x).to_degrees());
    }
    assert_eq!(skin("file = \"disc22_binary.msh\"", "").unwrap(), text);
    assert_eq!(Skin::parse(&text.to_toml(), "again.toml").unwrap(), text, "recordings have it in one piece");
    assert_eq!(Prepared::new(text).unwrap().voltages.len(), 4);
}

/// The voltages agree with those computed on the mesh directly.
#[test]
fn a_mesh_is_solved_on_its_own_elements() {
    let skin = skin("file = \"disc22.msh\"", "").unwrap();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../dermis-tomo/src/mesh/import/fixtures/disc22.msh");
    let case = Case::of_mesh(&file, &skin, "electrode", None).unwrap();
    assert_eq!((case.body.mesh.element_count(), case.body.electrodes.len()), (12, 4));
    // 1e-4 ohm.m^2 over a height of 5 mm.
    assert!((case.body.electrodes[0].contact_impedance - 0.02).abs() < 1e-12);
    let sigma = case.conductivity(&"hom".parse().unwrap()).unwrap();
    let small = Case::of_mesh(&file, &skin, "electrode", Some(1e-3)).unwrap();
    let volts = case.forward_model().unwrap().voltages(&sigma).unwrap();
    // The same sheet a thousand times smaller: only the contacts make a difference.
    let smaller = small.forward_model().unwrap().voltages(&sigma).unwrap();
    assert!(
        volts.iter().zip(&smaller).take(2).all(|(a, b)| a.is_finite() && a.signum() == b.signum()),
        "{volts:?} {smaller:?}"
    );
    let refused = Case::of_mesh(&file, &skin, "pin", None).unwrap_err().to_string();
    assert!(refused.contains("0 groups named pin1"), "{refused}");
}

#[test]
fn millimetres_read_as_metres_prompt_a_question_and_missing_groups_are_errors() {
    let refused = |mesh: &str, says: &str| {
        let message = skin(mesh, "").unwrap_err();
        assert!(message.contains(says), "{message}");
    };
    refused("file = \"wide.msh\"", "100.000 m wide: expected unit = \"mm\" if its coordinates are millimetres");
    let small = skin("file = \"wide.msh\", unit = \"mm\"", "").unwrap();
    let (low, high) = small.outline().bounds_m();
    assert!((high[0] - low[0] - 0.1).abs() < 1e-6, "{}", high[0] - low[0]);
    refused("file = \"disc22.msh\", electrodes = \"pin\"", "expected physical groups named pin1, pin2");
    refused("file = \"none.msh\"", "\"none.msh\", which does not exist");
    refused("file = \"skin.toml\"", "not an MSH file");
    let own =
        skin("file = \"disc22.msh\", electrodes = \"pin\"", "electrodes = { rim = { count = 4, width_mm = 50.0 } }");
    assert_eq!(own.unwrap().frontend.electrodes.count(), 4);
}

#[test]
fn places_are_put_on_the_rim_and_the_distance_is_known() {
    let text = Skin::open("healing-square").unwrap().to_toml();
    let place = |places: &str| {
        let start = text.find("[frontend.electrodes").unwrap();
        let end = start + text[start + 1..].find("\n[").map_or(text.len() - start, |next| next + 2);
        let electrodes = format!("[frontend.electrodes.rim-places]\nwidth_mm = 6.0\nplaces_mm = {places}\n");
        let text = format!("{}{electrodes}\n{}", &text[..start], &text[end..]);
        // The square's own protocol needs more electrodes.
        let mut table: toml::Table = text.parse().unwrap();
        let backend = table["backend"].as_table_mut().unwrap();
        backend.insert("channels".into(), toml::Value::try_from([[1, 2, 3, 4]]).unwrap());
        Skin::parse(&table.to_string(), "places.toml").map_err(|error| error.to_string())
    };
    let half = 0.5 * {
        let (low, high) = Skin::open("healing-square").unwrap().outline().bounds_m();
        1e3 * (high[0] - low[0])
    };
    let skin = place(&format!("[[{half}, 3.0], [1.0, {}], [-{half}, -2.0], [0.0, -{half}]]", half + 1.5)).unwrap();
    let moved = skin.frontend.electrodes.moved_mm(&skin.outline());
    assert!(moved[0] < 1e-9 && (moved[1] - 1.5).abs() < 1e-9, "{moved:?}");
    let centre = skin.body().unwrap().mesh.electrode_centre(1);
    assert!((centre[0] - 1e-3).abs() < 1e-4 && (1e3 * centre[1] - half).abs() < 1e-6, "{centre:?}");
    let far = place("[[0.0, 0.0], [1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]").unwrap_err();
    assert!(far.contains("electrode 1: expected a place at the rim"), "{far}");
}
