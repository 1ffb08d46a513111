//! The EM-skins from file to touches: their files and twins agree, single presses are found on the right element under the
//! model's and the measured Jacobian.

use dermis::calibrate::Pokes;
use dermis::prepare::Prepared;
use dermis::skin::Skin;
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{EmOptions, EmSkin, Frontend, Twin};

/// Half the pitch of the elements: nearer than this to an element is nearest to it.
const HALF_PITCH_M: f64 = 0.01;

fn read(skin: &mut EmSkin, instrument: &mut Instrument, indenters: &[Indenter]) -> Vec<f64> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.1, &mut frame).unwrap();
    instrument.read(0.1, &mut frame);
    frame
}

fn press(centre_m: [f64; 2], force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m: 0.005 }, load: Load::ForceN(force_n) }
}

fn peak_m(prepared: &Prepared, image: &[f32]) -> [f64; 2] {
    let finite = image.iter().enumerate().filter(|(_, v)| v.is_finite());
    prepared.map.grid().centre_m(finite.max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0)
}

#[test]
fn files_and_twins_agree() {
    for (name, options) in [
        ("em-8", EmOptions::em_8()),
        ("em-16-circular", EmOptions::em_16_circular()),
        ("em-16-square", EmOptions::em_16_square()),
    ] {
        let skin = Skin::open(name).unwrap();
        let model = skin.magnetic().unwrap();
        let elements = model.elements;
        assert_eq!(skin.frontend.coils.unwrap().array, options.array);
        assert_eq!(elements.per_side, options.per_side);
        assert!((1e-3 * elements.pitch_mm - options.pitch_m).abs() < 1e-12);
        assert!((1e-3 * elements.rest_mm - options.rest_m).abs() < 1e-12);
        assert!((1e-3 * elements.travel_mm - options.springs.limit_m).abs() < 1e-12);
        assert!((model.body.radius_m / options.body().unwrap().radius_m - 1.0).abs() < 1e-12);
        assert!((skin.backend.frames_per_s.unwrap() - options.frame_rate_hz).abs() < 1e-12);
        let coils = model.array.coils().len();
        assert_eq!(skin.protocol().unwrap().channel_count(), coils * (coils - 1) / 2);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
    }
}

#[test]
fn every_element_is_found_by_the_model_and_by_the_measured_jacobian() {
    let skin = Skin::open("em-8").unwrap();
    let places = skin.frontend.elements.unwrap().places_m();
    let prepared = Prepared::new(skin).unwrap();
    let (mut twin, mut instrument, _) = Twin::em(&EmOptions::em_8()).unwrap().into_parts();
    let rest: Vec<Vec<f64>> = (0..50).map(|_| read(&mut twin, &mut instrument, &[])).collect();
    let mut settled = |force_n: f64| -> Vec<Vec<f64>> {
        let one = |place: &[f64; 2]| {
            (0..9).for_each(|_| drop(read(&mut twin, &mut instrument, &[])));
            (0..4).map(|_| read(&mut twin, &mut instrument, &[press(*place, force_n)])).next_back().unwrap()
        };
        places.iter().map(one).collect()
    };
    // As published: each of the 25 elements once, 25 x 28; then again and harder, to be found.
    let pokes = Pokes { positions_m: places.clone(), loads: None };
    let calibration = prepared.calibrate(&rest, &settled(1.5), &pokes).unwrap();
    let frames = settled(2.0);
    for (name, calibration) in [("model", None), ("measured", Some(&calibration))] {
        let reference = prepared.reference(&rest).unwrap();
        let mut calibrated = prepared.calibrated_imager(calibration, reference, &[]).unwrap();
        let mut image = vec![f32::NAN; prepared.map.grid().len()];
        let mut worst: f64 = 0.0;
        for (place, frame) in places.iter().zip(&frames) {
            calibrated.imager.image(&calibrated.reference.difference(frame, None), &mut image).unwrap();
            let peak = peak_m(&prepared, &image);
            worst = worst.max((peak[0] - place[0]).hypot(peak[1] - place[1]));
        }
        println!("{name}: worst {:.1} mm", 1e3 * worst);
        assert!(worst < HALF_PITCH_M, "{name}: {:.1} mm", 1e3 * worst);
    }
}

#[test]
fn files_that_mix_coils_and_electrodes_are_refused() {
    let text = dermis::skin::builtin_text("em-8").unwrap();
    let refused = |from: &str, to: &str, field: &str| {
        assert!(text.contains(from), "{from}");
        let error = Skin::parse(&text.replace(from, to), "x").unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    };
    refused("modality = \"mit\"", "modality = \"eit\"", "frontend.contact_impedance_ohm_m2");
    refused("drive = \"each-coil\"", "drive = \"adjacent\"", "backend.drive");
    refused("reads = \"magnitude\"", "reads = \"signed\"", "backend.reads");
    refused("frequency_khz = 55.0", "frequency_khz = 5500.0", "backend.frequency_khz");
    refused("travel_mm = 11.0", "travel_mm = 21.0", "frontend.elements.travel_mm");
    refused("pitch_mm = 20.0", "pitch_mm = -1.0", "frontend.elements.pitch_mm");
}
