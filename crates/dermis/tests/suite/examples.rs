//! The skins that aren't from a paper (`skins/examples`): the file of each suffices for a twin, and presses at random
//! places are found.

use std::path::{Path, PathBuf};

use dermis::Skin;
use dermis_device::FileSpec;
use dermis_lab::reconstruct::{Request, reconstruct};
use dermis_lab::twin_sample::{SampleRequest, random_presses, sample};
use dermis_skin::{DrivePattern, Electrodes, MeasurePattern, Reads, Shape};
use dermis_tomo::mesh::distance;
use dermis_twin::from_skin::press_range;
use dermis_twin::mechanics::Indenter;

fn example(name: &str) -> Skin {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../../skins/examples/{name}.toml"));
    Skin::open(file.to_str().unwrap()).unwrap()
}

fn file_spec(path: PathBuf) -> FileSpec {
    path.to_str().unwrap().parse().unwrap()
}

/// Touches in the last of `repeats` frames of each press, millimetres.
fn touches_of(skin: Skin, presses: &[Vec<Indenter>], repeats: usize) -> Vec<Vec<[f64; 2]>> {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let frames_in =
        |name: &str| at(name).with_extension(if skin.backend.reads == Reads::Complex { "csv" } else { "npy" });
    let (rest, frames) = (frames_in("rest"), frames_in("frames"));
    let request = SampleRequest {
        skin: skin.clone(),
        presses: presses.to_vec(),
        baseline: rest.clone(),
        frames: frames.clone(),
        truth: None,
        seed: Some(2),
        built: None,
        repeats,
    };
    sample(&request, |_, _| {}).unwrap();
    let request = Request {
        baseline: Some(file_spec(rest)),
        frames: file_spec(frames),
        skin,
        read: Default::default(),
        as_skin: false,
        calibration: None,
        forces: None,
        hyperparameter: None,
        touches: Some(at("t.csv")),
        images: None,
    };
    reconstruct(&request, |_, _| {}).unwrap();
    let text = std::fs::read_to_string(at("t.csv")).unwrap();
    let mut found: Vec<Vec<[f64; 2]>> = vec![Vec::new(); presses.len()];
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').take(4).map(|cell| cell.parse().unwrap()).collect();
        if cells[0] as usize % repeats == repeats - 1 {
            found[cells[0] as usize / repeats].push([cells[2], cells[3]]);
        }
    }
    found
}

fn place_mm(indenter: &Indenter) -> [f64; 2] {
    indenter.centre_m.map(|value| 1e3 * value)
}

/// Median distance of touches from single presses at random places, the number of presses not seen, and the number
/// seen as several.
fn median_mm(skin: Skin, presses: usize) -> (f64, usize, usize) {
    let places = random_presses(&skin.outline(), &press_range(&skin), presses, 11).unwrap();
    let found = touches_of(skin, &places, 1);
    let (mut errors, mut missed, mut several) = (Vec::new(), 0, 0);
    for (press, found) in places.iter().zip(&found) {
        let away = |p: &[f64; 2]| distance(*p, place_mm(&press[0]));
        errors.push(found.iter().map(away).fold(f64::INFINITY, f64::min));
        missed += usize::from(found.is_empty());
        several += usize::from(found.len() > 1);
    }
    errors.sort_by(f64::total_cmp);
    (errors[presses / 2], missed, several)
}

/// Presses pairs of places a quarter of the longer side apart; returns the number of pairs of which both presses were
/// found, each closer than half that distance.
fn pairs_found(skin: Skin, pairs: usize) -> usize {
    let (low, high) = skin.outline().bounds_m();
    let apart_mm = 0.25e3 * (high[0] - low[0]).max(high[1] - low[1]);
    let places = random_presses(&skin.outline(), &press_range(&skin), 40 * pairs, 7).unwrap();
    let partner = |k: usize| {
        let fits = |press: &&Vec<Indenter>| {
            (distance(place_mm(&press[0]), place_mm(&places[k][0])) / apart_mm - 1.0).abs() < 0.03
        };
        places.iter().skip(pairs).find(fits)
    };
    let presses: Vec<Vec<Indenter>> = (0..pairs).filter_map(|k| Some(vec![places[k][0], partner(k)?[0]])).collect();
    assert!(presses.len() + 1 >= pairs, "{} pairs", presses.len());
    let found = touches_of(skin, &presses, 12);
    let both = |(press, found): &(&Vec<Indenter>, &Vec<[f64; 2]>)| {
        let near = |k: usize, p: &[f64; 2]| distance(*p, place_mm(&press[k])) < 0.5 * apart_mm;
        (0..2).all(|k| found.iter().any(|p| near(k, p))) && found.len() >= 2
    };
    presses.iter().zip(&found).filter(both).count() + pairs - presses.len()
}

#[test]
fn presses_anywhere_are_found_on_every_example() {
    for (name, shorter_mm) in
        [("gel-pad", 60.0), ("l-sandwich", 120.0), ("fabric-ring", 120.0), ("liquid-ellipse", 110.0), ("em-3x4", 145.0)]
    {
        let (median, missed, several) = median_mm(example(name), 20);
        println!("{name}: {median:.2} mm, {missed} missed, {several} seen as several");
        assert!(median <= 0.03 * shorter_mm, "{name}: {median} mm");
        // One in twenty may lie where the skin sees little. Every frame has a different press, and none gives two
        // touches.
        assert!(missed <= 1 && several == 0, "{name}: {missed} missed, {several} seen as several");
    }
}

// Measured: 0.2 to 0.8 mm on 200 to 300 mm. Placed by the image they were off by 3.2 to 4.5 % of the diameter.
#[test]
fn dents_in_the_tanks_are_found_as_dents() {
    for name in ["golfball-tank", "sciospec-tank", "pyeidors-tank", "ktc-tank"] {
        let skin = Skin::open(name).unwrap();
        let diameter_mm = 1e3 * skin.outline().bounds_m().1[0] * 2.0;
        let (median, missed, several) = median_mm(skin, 16);
        println!("{name}: {median:.2} mm, {missed} missed, {several} seen as several");
        assert!(median < 0.005 * diameter_mm && missed == 0 && several <= 4, "{name}: {median}, {missed}, {several}");
    }
}

#[test]
fn two_presses_a_quarter_of_the_longer_side_apart_are_two() {
    for (name, least) in [("gel-pad", 9), ("l-sandwich", 8), ("fabric-ring", 8), ("liquid-ellipse", 9), ("em-3x4", 9)] {
        let found = pairs_found(example(name), 10);
        assert!(found >= least, "{name}: {found} of 10 pairs");
    }
}

#[test]
fn two_presses_are_resolved_on_other_sizes_and_electrode_counts() {
    let mut gel = example("gel-pad");
    gel.frontend.shape = Shape::Square { side_mm: 80.0 };
    let Electrodes::Rim { count, .. } = &mut gel.frontend.electrodes else { panic!() };
    *count = 16;
    let mut button = example("liquid-ellipse");
    button.frontend.shape = Shape::Disc { diameter_mm: 80.0 };
    let Electrodes::Rim { count, width_mm, .. } = &mut button.frontend.electrodes else { panic!() };
    (*count, *width_mm) = (8, 5.0);
    // Twelve of its channels are nearly zero at rest, so their individual gains mean nothing.
    let mut octagon = example("liquid-ellipse");
    octagon.name = "octagon".into();
    let corner = |k: u32| std::f64::consts::TAU * f64::from(k) / 8.0 + 0.3;
    let outer_mm = (0..8).map(|k| [50.5 * corner(k).cos(), 50.5 * corner(k).sin()]).collect();
    octagon.frontend.shape = Shape::Polygon { outer_mm, holes_mm: Vec::new() };
    let Electrodes::Rim { count, width_mm, start_deg, .. } = &mut octagon.frontend.electrodes else { panic!() };
    (*count, *width_mm, *start_deg) = (32, 3.28, Some(10.4));
    (octagon.backend.drive, octagon.backend.measure) = (DrivePattern::Skip(8), MeasurePattern::Skip(8));
    for (skin, least) in [(gel, 9), (button, 7), (octagon, 8)] {
        let name = skin.name.clone();
        let found = pairs_found(skin, 10);
        assert!(found >= least, "{name}: {found} of 10 pairs");
    }
}

#[test]
fn a_large_sandwich_places_presses_that_jump_from_frame_to_frame() {
    let mut skin = example("l-sandwich");
    skin.frontend.shape = Shape::Rectangle { width_mm: 200.0, height_mm: 80.0 };
    let Electrodes::Rim { count, .. } = &mut skin.frontend.electrodes else { panic!() };
    *count = 32;
    let (median, missed, several) = median_mm(skin, 20);
    assert!(median <= 1.0 && missed == 0 && several == 0, "{median} mm, {missed} missed, {several} seen as several");
}

#[test]
fn a_copy_of_another_size_and_name_has_a_twin_of_its_own() {
    let mut skin = example("liquid-ellipse");
    skin.name = "smaller".into();
    let Shape::Polygon { outer_mm, .. } = &mut skin.frontend.shape else { panic!() };
    outer_mm.iter_mut().flatten().for_each(|value| *value *= 0.6);
    let (median, missed, _) = median_mm(skin, 10);
    assert!(median <= 0.03 * 66.0 && missed == 0, "{median} mm, {missed} missed");
}
