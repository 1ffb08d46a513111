//! The skins that no paper has (`skins/examples`): each has a twin from its file alone, and presses at random places are found.

use std::path::{Path, PathBuf};

use dermis::Skin;
use dermis::device::FileSpec;
use dermis::lab::reconstruct::{Request, reconstruct};
use dermis::lab::twin_sample::{SampleRequest, random_presses, sample};
use dermis::twin::from_skin::press_range;

fn example(name: &str) -> Skin {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../skins/examples/{name}.toml"));
    Skin::open(file.to_str().unwrap()).unwrap()
}

fn file_spec(path: PathBuf) -> FileSpec {
    path.to_str().unwrap().parse().unwrap()
}

/// Median distance of touches from single presses at so many random places, and how many presses were not seen, or seen as
/// several.
fn median_mm(skin: Skin, presses: usize) -> (f64, usize, usize) {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let places = random_presses(&skin.outline(), &press_range(&skin), presses, 11);
    let request = SampleRequest {
        skin: skin.clone(),
        presses: places.clone(),
        baseline: at("b.npy"),
        frames: at("f.npy"),
        truth: None,
        seed: Some(2),
        repeats: 1,
    };
    sample(&request, |_, _| {}).unwrap();
    let request = Request {
        skin,
        baseline: file_spec(at("b.npy")),
        frames: file_spec(at("f.npy")),
        format: None,
        calibration: None,
        forces: None,
        hyperparameter: None,
        touches: Some(at("t.csv")),
        images: None,
    };
    reconstruct(&request, |_, _| {}).unwrap();
    let text = std::fs::read_to_string(at("t.csv")).unwrap();
    let mut found: Vec<Vec<[f64; 2]>> = vec![Vec::new(); presses];
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').take(4).map(|cell| cell.parse().unwrap()).collect();
        found[cells[0] as usize].push([cells[2], cells[3]]);
    }
    let (mut errors, mut missed, mut several) = (Vec::new(), 0, 0);
    for (press, found) in places.iter().zip(&found) {
        let [x, y] = press[0].centre_m.map(|value| 1e3 * value);
        let nearest = found.iter().map(|p| (p[0] - x).hypot(p[1] - y)).fold(f64::INFINITY, f64::min);
        missed += usize::from(found.is_empty());
        several += usize::from(found.len() > 1);
        errors.push(nearest);
    }
    errors.sort_by(f64::total_cmp);
    (errors[presses / 2], missed, several)
}

#[test]
fn presses_anywhere_are_found_on_every_example() {
    for (name, shorter_mm) in
        [("gel-pad", 60.0), ("l-sandwich", 120.0), ("fabric-ring", 120.0), ("liquid-ellipse", 110.0), ("em-3x4", 145.0)]
    {
        let (median, missed, several) = median_mm(example(name), 20);
        assert!(median <= 0.03 * shorter_mm, "{name}: {median} mm");
        // One in twenty may lie where little is seen.
        assert!(missed <= 1 && several <= 2, "{name}: {missed} missed, {several} seen as several");
    }
}

#[test]
fn a_copy_of_another_size_and_name_has_a_twin_of_its_own() {
    let mut skin = example("liquid-ellipse");
    skin.name = "smaller".into();
    let dermis::skin::Shape::Polygon { outer_mm, .. } = &mut skin.frontend.shape else { panic!() };
    outer_mm.iter_mut().flatten().for_each(|value| *value *= 0.6);
    let (median, missed, _) = median_mm(skin, 10);
    assert!(median <= 0.03 * 66.0 && missed == 0, "{median} mm, {missed} missed");
}
