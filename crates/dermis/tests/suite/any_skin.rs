//! Properties of every skin file: its twin uses all of its numbers, it keeps its own name and size, and it can be
//! written and read back.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::{
    BUILTIN_NAMES, CoilPlaces, Electrodes, Electronics, ElementPlaces, ElementShape, Layer, Memory, Pair, Preset,
    Shape, SheetLayer, Skin,
};
use dermis_twin::{AnyTwin, Frontend as _};
use serde_json::Value;

/// Relative difference, to the largest voltage, below which voltages are equal.
const SAME: f64 = 1e-9;
/// Half of the pressure acts with this delay.
const MEMORY: Option<Memory> = Some(Memory { share: 0.5, time_constant_s: 1.0 });

/// A disc that presses on a skin: centre (mm), radius (mm), pressure (kPa).
#[derive(Clone, Copy)]
struct Press {
    at_mm: [f64; 2],
    radius_mm: f64,
    kpa: f64,
}

impl Press {
    fn on(self, twin: &mut AnyTwin) {
        let [x, y] = self.at_mm;
        twin.scene_mut().press(1, 1e-3 * x, 1e-3 * y, 1e-3 * self.radius_mm, 1e3 * self.kpa).unwrap();
    }
}

/// Two frames of a skin's twin under a press, the second one a second later.
fn pressed(skin: &Skin, press: Press) -> Result<Vec<f64>, String> {
    let mut twin = AnyTwin::from_skin(skin).map_err(|error| error.to_string())?;
    let mut frame = Vec::new();
    // One frame without a press, and two more after it has started.
    twin.step(0.0, &mut frame).unwrap();
    press.on(&mut twin);
    let mut both = Vec::new();
    for time_s in [0.1, 1.1] {
        twin.step(time_s, &mut frame).unwrap();
        both.extend_from_slice(&frame);
    }
    Ok(both)
}

/// True if any voltage differs.
fn differ(a: &[f64], b: &[f64]) -> bool {
    let largest = a.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    a.len() != b.len() || a.iter().zip(b).any(|(a, b)| (a - b).abs() > SAME * largest)
}

/// Collects the paths of all numbers.
fn numbers(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Number(_) => found.push(at.to_string()),
        Value::Array(values) => values.iter().enumerate().for_each(|(k, v)| numbers(v, &format!("{at}/{k}"), found)),
        Value::Object(table) => table.iter().for_each(|(key, v)| numbers(v, &format!("{at}/{key}"), found)),
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// Replacements to try for a number, in order of preference.
fn others(number: &Value) -> Vec<Value> {
    if let Some(count) = number.as_u64() {
        return [count + 1, count.saturating_sub(1), 2 * count, count / 2].map(Value::from).to_vec();
    }
    match number.as_f64().unwrap() {
        0.0 => vec![0.07.into(), (-0.07).into()],
        value => vec![(1.07 * value).into(), (0.93 * value).into()],
    }
}

/// Changes every number of a skin's frontend and readout circuit, one at a time, and asserts that its twin's readings
/// change; for the numbers in `bounds`, that the area where it may be pressed changes.
fn every_number_counts(mut skin: Skin, press: Press, bounds: &[&str]) {
    skin.backend.electronics = Electronics { preset: Preset::Ideal, ..Electronics::default() };
    let skin = skin.checked().unwrap();
    let expected = pressed(&skin, press).unwrap();
    assert!(!differ(&expected, &pressed(&skin, press).unwrap()), "the same twin twice");
    let file = serde_json::to_value(&skin).unwrap();
    let (mut places, mut ignored) = (Vec::new(), Vec::new());
    numbers(&file["frontend"], "/frontend", &mut places);
    numbers(&file["backend"]["circuit"], "/backend/circuit", &mut places);
    for place in &places {
        let with = |other: Value| -> Result<bool, String> {
            let mut file = file.clone();
            *file.pointer_mut(place).unwrap() = other;
            let changed: Skin = serde_json::from_value(file).map_err(|error| error.to_string())?;
            let changed = changed.checked().map_err(|error| error.to_string())?;
            if bounds.contains(&place.as_str()) {
                let twin = AnyTwin::from_skin(&changed).map_err(|error| error.to_string())?;
                return Ok(twin.frontend().extent() != skin.outline());
            }
            Ok(differ(&expected, &pressed(&changed, press)?))
        };
        let number = file.pointer(place).unwrap();
        let mut refusals = Vec::new();
        let counts = others(number)
            .into_iter()
            .find_map(|other| with(other.clone()).map_err(|error| refusals.push(format!("{other}: {error}"))).ok());
        match counts {
            None => ignored.push(format!("{place} = {number}, no other of which is accepted: {refusals:?}")),
            Some(false) => ignored.push(format!("{place} = {number}")),
            Some(true) => {}
        }
    }
    println!("{}: {} numbers", skin.name, places.len());
    assert!(ignored.is_empty(), "{}: the twin knows nothing of {ignored:#?}", skin.name);
}

#[test]
fn a_sandwich_is_made_of_all_numbers_of_its_file() {
    let mut skin = Skin::open("healing-square").unwrap();
    let Layer::Sandwich(layer) = &mut skin.frontend.layer else { panic!("no sandwich") };
    layer.memory = MEMORY;
    (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(5.0), Some(2.0));
    every_number_counts(skin, Press { at_mm: [11.0, -7.0], radius_mm: 10.0, kpa: 60.0 }, &[]);
}

#[test]
fn a_liquid_is_made_of_all_numbers_of_its_file() {
    let mut skin = Skin::open("ionic-disc").unwrap();
    (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(9.0), Some(3.0));
    every_number_counts(skin, Press { at_mm: [21.0, -17.0], radius_mm: 15.0, kpa: 1.0 }, &[]);
}

#[test]
fn patches_are_made_of_all_numbers_of_their_file() {
    let mut skin = Skin::open("piezo-disc").unwrap();
    skin.frontend.electrodes = Electrodes::PadGrid { per_side: Pair::One(4), diameter_mm: 3.0 };
    let Layer::Patches(layer) = &mut skin.frontend.layer else { panic!("no patches") };
    layer.memory = MEMORY;
    (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(5.0), Some(1.5));
    every_number_counts(skin, Press { at_mm: [11.0, -7.0], radius_mm: 11.0, kpa: 1.0 }, &[]);
}

#[test]
fn elements_are_made_of_all_numbers_of_their_file() {
    let mut skin = Skin::open("em-8").unwrap();
    // Fewer and simpler coils and elements, because computing the field of every turn takes time.
    let coils = skin.frontend.coils.as_mut().unwrap();
    let CoilPlaces::Grid { rows, columns, left_out, .. } = &mut coils.places else { panic!("no grid") };
    (*rows, *columns, *left_out) = (2, 2, vec![4]);
    (coils.turns, coils.layers, coils.inductance_uh, coils.shield_mm) = (4, 2, Some(1.5), Some(-20.0));
    // A ball's response has a closed form; a cylinder of another size would take edge elements and many seconds.
    let elements = skin.frontend.elements.as_mut().unwrap();
    elements.shape = ElementShape::Sphere { diameter_mm: 11.0 };
    elements.places = ElementPlaces::Grid { rows: 2, columns: 2, pitch_mm: Pair::One(20.0) };
    // The skin's size only determines where it may be pressed, since it doesn't conduct there.
    every_number_counts(
        skin,
        Press { at_mm: [11.0, -7.0], radius_mm: 9.0, kpa: 10.0 },
        &["/frontend/shape/square/side_mm"],
    );
}

#[test]
fn a_sheet_is_made_of_all_numbers_of_its_file() {
    let layer = SheetLayer { memory: MEMORY, smoothing_mm: Some(2.0), ..SheetLayer::gel(5.0, 0.2) };
    let mut skin = Skin::rectangle("gel", 120.0, 80.0, Layer::Sheet(layer));
    (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(6.0), Some(3.0));
    every_number_counts(skin, Press { at_mm: [11.0, -7.0], radius_mm: 10.0, kpa: 30.0 }, &[]);
}

#[test]
fn a_readout_circuit_is_made_of_all_numbers_of_its_file() {
    let layer = SheetLayer { memory: MEMORY, smoothing_mm: Some(2.0), ..SheetLayer::gel(5.0, 0.2) };
    let mut skin = Skin::rectangle("loaded-gel", 120.0, 80.0, Layer::Sheet(layer));
    (skin.twin.element_mm, skin.twin.electrode_element_mm) = (Some(8.0), Some(4.0));
    skin.backend.circuit = Skin::open("hydrogel-disc").unwrap().backend.circuit;
    every_number_counts(skin, Press { at_mm: [11.0, -7.0], radius_mm: 10.0, kpa: 30.0 }, &[]);
}

#[test]
fn a_twin_behind_a_circuit_agrees_with_the_model_of_that_circuit() {
    let skin = Skin::open("hydrogel-disc").unwrap();
    let mut ideal = skin.clone();
    ideal.backend.electronics = Electronics { preset: Preset::Ideal, ..Electronics::default() };
    let mut twin = AnyTwin::from_skin(&ideal).unwrap();
    let mut frame = Vec::new();
    twin.step(0.0, &mut frame).unwrap();
    let model = Prepared::new(skin).unwrap().voltages;
    let largest = model.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    // The mesh differs, and with it the readings near the electrodes.
    let worst = frame.iter().zip(&model).map(|(a, b)| (a - b.abs()).abs()).fold(0.0, f64::max);
    assert!(worst < 0.05 * largest, "{worst} of {largest}");
}

#[test]
fn the_name_has_no_effect_and_the_size_has() {
    let press = Press { at_mm: [12.0, -9.0], radius_mm: 8.0, kpa: 1.2 };
    let published = Skin::open("ionic-disc").unwrap();
    let mut skin = published.clone();
    skin.name = "button".into();
    assert_eq!(pressed(&skin, press).unwrap(), pressed(&published, press).unwrap(), "a name is no physics");
    skin.frontend.shape = Shape::Disc { diameter_mm: 80.0 };
    skin.imaging.grid = 24;
    let skin = skin.checked().unwrap();
    assert!(differ(&pressed(&published, press).unwrap(), &pressed(&skin, press).unwrap()));
    let mut twin = AnyTwin::from_skin(&skin).unwrap();
    let period_ns = (1e9 / skin.backend.frame_rate_hz()) as u64;
    let prepared = Prepared::new(skin).unwrap();
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let (mut frame, mut values, mut touches) = (Frame::default(), Vec::new(), Vec::new());
    for number in 0..48 {
        if number == 36 {
            assert!(pipeline.reference().is_some() && touches.is_empty(), "{touches:?}");
            press.on(&mut twin);
        }
        let time_ns = number * period_ns;
        twin.step(1e-9 * time_ns as f64, &mut values).unwrap();
        frame.refill(number, HostStamp { monotonic_ns: time_ns, wall_ns: time_ns }, &values, &[]);
        touches = pipeline.process(&frame, time_ns).unwrap().touches.to_vec();
    }
    assert_eq!(touches.len(), 1, "{touches:?}");
    let [x_mm, y_mm] = touches[0].position_m.map(|m| 1e3 * m);
    let off_mm = (x_mm - press.at_mm[0]).hypot(y_mm - press.at_mm[1]);
    println!("{off_mm:.2} mm off");
    assert!(off_mm < 3.0, "{off_mm} mm: {touches:?}");
}

#[test]
fn built_in_files_are_the_same_written_and_read_again() {
    for name in BUILTIN_NAMES {
        let skin = Skin::open(name).unwrap();
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin, "{name}");
    }
}
