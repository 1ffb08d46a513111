//! The EM-skins from file to touches: the numbers in their files reach twins and models, and single presses are found
//! at the right element with the model's and with the measured Jacobian.

use dermis_lab::twin_bench::Rig;
use dermis_live::calibration::CalibratedImager;
use dermis_live::calibration::Calibration;
use dermis_live::calibration::Pokes;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_mit::catalogue::{body_cached, body_of, builtin_records, compute};
use dermis_skin::{Element, ElementShape, Layer, Skin, Solve};
use dermis_tomo::mesh::distance;
use dermis_twin::AnyTwin;
use dermis_twin::from_skin::element_options;
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{Conductor, Frontend};

/// Half the pitch of the elements. A position closer than this to an element is closest to it.
const HALF_PITCH_M: f64 = 0.01;

fn read(skin: &mut dyn Frontend, instrument: &mut Instrument, indenters: &[Indenter]) -> Vec<f64> {
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
fn numbers_in_files_reach_twins_and_models() {
    for name in ["em-8", "em-16-circular", "em-16-square"] {
        let skin = Skin::open(name).unwrap();
        let model = dermis_live::magnetic_model::MagneticModel::of(&skin).unwrap();
        let options = element_options(&skin).unwrap();
        let Layer::Elements(layer) = &skin.frontend.layer else { panic!("{name} has no elements") };
        let elements = skin.frontend.elements.as_ref().unwrap();
        let metres = |mm: f64, m: f64| assert!((1e-3 * mm - m).abs() < 1e-12, "{name}: {mm} mm, {m} m");
        assert_eq!(skin.frontend.coils.as_ref().unwrap().array().unwrap(), options.coils);
        assert_eq!(model.array, options.coils);
        assert_eq!(elements.places_m(), options.places_m);
        assert_eq!(elements.cell_m(), options.cell_m);
        assert_eq!(skin.outline(), options.outline);
        metres(elements.rest_mm, options.rest_m);
        metres(elements.travel_mm, options.springs.limit_m);
        metres(layer.height_tolerance_mm, options.tolerance_m);
        assert_eq!(layer.stiffness_n_per_m, options.springs.stiffness_n_per_m);
        assert_eq!(layer.sharpness, options.springs.sharpness);
        assert_eq!(layer.coupling_n_per_m, options.springs.coupling_n_per_m);
        let (file, memory) = (layer.memory.unwrap(), options.memory.unwrap());
        assert_eq!((file.share, file.time_constant_s), (memory.share, memory.time_constant_s));
        assert_eq!(
            (1e3 * skin.backend.frequency_khz.unwrap(), model.frequency_hz),
            (options.frequency_hz, options.frequency_hz)
        );
        metres(skin.backend.current_ma, options.current_a);
        // The twin uses the cylinder, the model a ball of the same volume.
        let element = skin.element().unwrap();
        assert_eq!(options.element, Conductor::Body(body_of(&element, options.frequency_hz).unwrap()));
        assert!((model.body.radius_m / element.shape.volume_radius_m() - 1.0).abs() < 1e-12);
        let coils = model.array.coils().len();
        assert_eq!(skin.protocol().unwrap().channel_count(), coils * (coils - 1) / 2);
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
    }
}

#[test]
fn every_element_is_found_by_the_model_and_by_the_measured_jacobian() {
    let skin = Skin::open("em-8").unwrap();
    let places = skin.frontend.elements.as_ref().unwrap().places_m();
    let (mut twin, mut instrument, _) = AnyTwin::from_skin(&skin).unwrap().into_parts();
    let prepared = Prepared::new(skin).unwrap();
    let rest: Vec<Vec<f64>> = (0..50).map(|_| read(&mut *twin, &mut instrument, &[])).collect();
    // Mean of `count` frames with each element pressed, after rest and after the mechanics have settled.
    let mut settled = |force_n: f64, count: usize| -> Vec<Vec<f64>> {
        let one = |place: &[f64; 2]| {
            (0..9).for_each(|_| drop(read(&mut *twin, &mut instrument, &[])));
            let indenters = [press(*place, force_n)];
            (0..3).for_each(|_| drop(read(&mut *twin, &mut instrument, &indenters)));
            let frames: Vec<Vec<f64>> = (0..count).map(|_| read(&mut *twin, &mut instrument, &indenters)).collect();
            (0..frames[0].len()).map(|c| frames.iter().map(|f| f[c]).sum::<f64>() / count as f64).collect()
        };
        places.iter().map(one).collect()
    };
    // As published: each of the 25 elements once, 25 x 28. Then again with more force, to be located.
    let pokes = Pokes { positions_m: places.clone(), further_m: Vec::new(), loads: None };
    let calibration = Calibration::fit(&prepared, &rest, &settled(1.5, 10), &pokes).unwrap();
    let frames = settled(2.0, 1);
    let mut pixels = prepared;
    pixels.skin.imaging.solve = Solve::Pixels;
    let mut heights = Prepared::new(pixels.skin.clone()).unwrap();
    heights.skin.imaging.solve = Solve::LiftOff;
    for (name, prepared, calibration) in
        [("model", &pixels, None), ("heights", &heights, None), ("measured", &pixels, Some(&calibration))]
    {
        let reference = Reference::of(prepared, &rest).unwrap();
        let mut calibrated = CalibratedImager::new(prepared, calibration, reference, &[]).unwrap();
        let mut image = vec![f32::NAN; prepared.map.grid().len()];
        let mut worst: f64 = 0.0;
        for (place, frame) in places.iter().zip(&frames) {
            calibrated.imager.image(&calibrated.reference.difference(frame, None), &mut image).unwrap();
            let peak = peak_m(prepared, &image);
            worst = worst.max(distance(peak, *place));
        }
        println!("{name}: worst {:.1} mm", 1e3 * worst);
        assert!(worst < HALF_PITCH_M, "{name}: {:.1} mm", 1e3 * worst);
    }
}

#[test]
fn a_skin_at_rest_has_no_touches() {
    for name in ["em-8", "em-16-square"] {
        let mut rig = Rig::new(name).unwrap();
        for frame in &rig.frames(&[], 100).unwrap() {
            let image = rig.image(frame).unwrap();
            assert!(rig.touches(&image).unwrap().is_empty(), "{name}");
        }
    }
}

#[test]
fn files_that_mix_coils_and_electrodes_are_refused() {
    let text = dermis_skin::builtin_text("em-8").unwrap();
    let refused = |from: &str, to: &str, field: &str| {
        assert!(text.contains(from), "{from}");
        let error = Skin::parse(&text.replace(from, to), "x").unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    };
    refused("modality = \"mit\"", "modality = \"eit\"", "modality");
    refused("drive = \"each-coil\"", "drive = \"adjacent\"", "backend.drive");
    refused("reads = \"magnitude\"", "reads = \"signed\"", "backend.reads");
    refused("frequency_khz = 55.0", "frequency_khz = 5500.0", "backend.frequency_khz");
    refused("travel_mm = 11.0", "travel_mm = 21.0", "frontend.elements.travel_mm");
    refused("pitch_mm = 20.0", "pitch_mm = -1.0", "frontend.elements.places.grid.pitch_mm");
    refused("inductance_uh = 150.0", "inductance_uh = 150.0, shield_mm = 5.0", "frontend.coils.shield_mm");
    let electrodes = dermis_skin::builtin_text("ionic-disc").unwrap();
    let text = electrodes.replace("[imaging]\n", "[imaging]\nsolve = \"lift-off\"\n");
    assert!(Skin::parse(&text, "x").unwrap_err().to_string().contains("imaging.solve"));
}

#[test]
fn cached_bodies_equal_those_from_edge_elements() {
    let records = builtin_records().unwrap();
    assert_eq!(records.len(), 16);
    // The quickest one to compute; all come from the same program.
    let record = records.iter().find(|record| record.frequency_hz == 1e3).unwrap();
    let again = compute(&record.element, 1e3).unwrap();
    let (kept, now) = (record.body().unwrap(), again.body().unwrap());
    let largest = now.tau().iter().map(|t| t.norm()).fold(0.0, f64::max);
    // Sums taken in another order round differently, over 13 to 23 iterations that stop at 1e-8.
    let off = kept.tau().iter().zip(now.tau()).map(|(a, b)| (*a - *b).norm()).fold(0.0, f64::max);
    assert!(off < 1e-6 * largest, "{off:e} of {largest:e}");
}

#[test]
fn bodies_are_cached_and_damaged_cache_files_recomputed() {
    let cache = tempfile::tempdir().unwrap();
    let shape = ElementShape::Plate { side_mm: 8.0, height_mm: 2.0 };
    let plate = Element { shape, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
    let body = body_cached(&plate, 1e3, Some(cache.path())).unwrap();
    let files: Vec<_> = std::fs::read_dir(cache.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert_eq!(files.len(), 1);
    let text = std::fs::read_to_string(&files[0]).unwrap();
    // The cached value is used. It has been edited by hand, so that it can be recognised.
    let other = text.replace("\"tau\":[[0,0,-", "\"tau\":[[0,0,");
    std::fs::write(&files[0], &other).unwrap();
    assert!(other != text && body_cached(&plate, 1e3, Some(cache.path())).unwrap() != body);
    for damaged in [&text[..text.len() / 2], "", &text.replace("\"frequency_hz\":1000.0", "\"frequency_hz\":2000.0")] {
        std::fs::write(&files[0], damaged).unwrap();
        assert!(body_cached(&plate, 1e3, Some(cache.path())).unwrap() == body);
        assert_eq!(std::fs::read_to_string(&files[0]).unwrap(), text);
    }
    // Without a cache the body is computed anyway.
    assert!(body_cached(&plate, 1e3, None).unwrap() == body);
    let error = body_cached(&Element { conductivity_s_per_m: -1.0, ..plate }, 1e3, None).unwrap_err().to_string();
    assert!(error.contains("-1"), "{error}");
}
