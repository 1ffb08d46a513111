//! Training sets and segmentation on a small skin: samples are repeatable and varied, lost channels are missing,
//! thresholds separate simulated frames, and models are rejected where they don't belong.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_lab::learning::segment::{Method, Segmenter};
use dermis_lab::learning::train_set::{Jitter, LostElectrodes, SimulatedFrames, TrainSetRequest, simulate};
use dermis_lab::twin_bench::Rig;
use dermis_learn::metrics::Confusion;
use dermis_learn::scene::{BACKGROUND, LOWERED, RAISED, SceneKind};
use dermis_learn::{CARD_FORMAT, Model, ModelCard, Tensors, TrainingRecord, UNetShape};
use dermis_live::network::{
    CLASSES, Classes, Classifier, FirstStep, InputImage, MaskRule, built_in, imaging_sha256, masks_of_image, suits,
};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_live::stages::classes::ClassPace;
use dermis_skin::Skin;
use dermis_tomo::quality::{centroid_above_m, icc};
use dermis_twin::AnyTwin;
use dermis_twin::Frontend;
use dermis_twin::mechanics::Indenter;

const SKIN: &str = r#"
name = "small"
modality = "eit"
[frontend]
shape = { disc = { diameter_mm = 100.0 } }
layer = { kind = "liquid", depth_mm = 10.0, conductivity_s_per_m = 0.1, tension_n_per_m = 0.0 }
electrodes = { rim = { count = 12, width_mm = 8.0, start_deg = 0.0 } }
contact_impedance_ohm_m2 = 1e-4
[backend]
current_ma = 1.0
drive = "adjacent"
measure = "adjacent"
[imaging]
grid = 16
elements = 700
"#;

fn skin() -> Skin {
    Skin::parse(SKIN, "small").unwrap()
}

fn request(samples: usize) -> TrainSetRequest {
    let mut request = TrainSetRequest::new(skin(), samples);
    request.shard_samples = 6;
    request.most_lost = 4;
    request.inputs = vec![InputImage::Step(1.0), InputImage::Step(0.3), InputImage::Coverage];
    request
}

#[test]
fn a_training_set_is_repeatable_and_continues() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut steps = Vec::new();
    let first = simulate(&request(15), &at("a"), |done, all| steps.push((done, all))).unwrap();
    assert_eq!(steps, [(0, 15), (6, 15), (12, 15), (15, 15)]);
    let second = simulate(&request(15), &at("b"), |_, _| {}).unwrap();
    std::fs::remove_file(second.shard_file(1)).unwrap();
    let second = simulate(&request(15), &at("b"), |_, _| {}).unwrap();
    for shard in 0..3 {
        let (a, b) = (first.read(shard).unwrap(), second.read(shard).unwrap());
        assert_eq!(a, b, "shard {shard}");
        assert_eq!(a.labels.len(), first.manifest().samples_of(shard) * 256);
        // The image shows something, but most of it is background.
        let here = a.labels.iter().filter(|label| **label != BACKGROUND).count();
        assert!(here > 0 && here * 2 < a.labels.len(), "{here} of {}", a.labels.len());
    }
    assert_ne!(first.read(0).unwrap().inputs, first.read(1).unwrap().inputs);
    // Another request doesn't mix with it.
    let mut other = request(15);
    other.seed = 2;
    assert!(simulate(&other, &at("a"), |_, _| {}).unwrap_err().to_string().contains("another training set"));
}

#[test]
fn the_simulated_skin_is_not_the_model_of_the_images() {
    let prepared = Prepared::new(skin()).unwrap();
    let frames = SimulatedFrames::new(&request(4), &prepared, 0, 4).unwrap();
    let finite: Vec<(f64, f64)> = frames.baseline.iter().zip(&prepared.voltages).map(|(a, b)| (*a, *b)).collect();
    let finite: Vec<(f64, f64)> = finite.into_iter().filter(|(a, _)| a.is_finite()).collect();
    let scale = finite.iter().map(|(a, b)| a * b).sum::<f64>() / finite.iter().map(|(_, b)| b * b).sum::<f64>();
    let rest: f64 = finite.iter().map(|(a, b)| (a - scale * b).powi(2)).sum();
    let error = (rest / finite.iter().map(|(a, _)| a * a).sum::<f64>()).sqrt();
    // With electrodes off by 0.15 mm of 50 and by 3 % in width, the misfit beyond a common factor is between 0.01 % and
    // 10 %.
    assert!((1e-4..0.1).contains(&error), "{error}");
}

/// With objects that conduct almost like the liquid, only changes of the liquid itself remain.
#[test]
fn the_liquid_strays_as_a_whole_and_the_first_electrodes_are_lost() {
    let prepared = Prepared::new(skin()).unwrap();
    let mut request = request(12);
    request.lost = LostElectrodes::First;
    request.contrasts = Some([1.0 + 1e-9, 1.0 + 1e-8]);
    request.jitter = Jitter { background: 0.05, drift: 0.0, noise_db: 200.0, ..Jitter::default() };
    for number in 0..4 {
        let frames = SimulatedFrames::new(&request, &prepared, number, 3).unwrap();
        let touches = |channel: usize, electrode: u32| prepared.protocol.channel_touches(channel, electrode);
        let is_lost = |electrode: u32| {
            (0..prepared.channels()).all(|channel| !touches(channel, electrode) || frames.baseline[channel].is_nan())
        };
        let lost: Vec<u32> = (0..12).filter(|electrode| is_lost(*electrode)).collect();
        assert!(lost.len() <= 4 && lost.iter().enumerate().all(|(k, electrode)| k as u32 == *electrode), "{lost:?}");
        for frame in &frames.frames {
            let ratios = frame.iter().zip(&frames.baseline).map(|(after, before)| after / before);
            let ratios: Vec<f64> = ratios.filter(|ratio| ratio.is_finite()).collect();
            assert!((ratios[0] - 1.0).abs() > 1e-6 && (ratios[0] - 1.0).abs() < 0.25, "{}", ratios[0]);
            assert!(ratios.iter().all(|ratio| (ratio / ratios[0] - 1.0).abs() < 1e-4));
        }
    }
    request.contrasts = Some([0.5, 2.0]);
    let error = simulate(&request, std::path::Path::new("nowhere"), |_, _| {}).unwrap_err().to_string();
    assert!(error.contains("contrasts"), "{error}");
}

/// In a sandwich touches are contacts with a floating shortcut, and cuts are slits. The channels know nothing of
/// classes, yet touches lower the driving voltage and cuts raise it.
#[test]
fn touches_and_cuts_of_a_sandwich_change_voltages_in_their_own_ways() {
    let prepared = Prepared::new(Skin::open("healing-square").unwrap()).unwrap();
    let mut request = TrainSetRequest::new(prepared.skin.clone(), 24);
    request.jitter =
        Jitter { place: 0.0, width: 0.0, contact: 0.0, gain: 0.0, drift: 0.0, background: 0.0, noise_db: 300.0 };
    let frames = SimulatedFrames::new(&request, &prepared, 0, 24).unwrap();
    let size = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
    let gap: Vec<f64> = frames.baseline.iter().zip(&prepared.voltages).map(|(a, b)| a - b).collect();
    // Two implementations, on different meshes of the same skin with 0.55 to 0.9 times as many elements.
    assert!(size(&gap) < 0.02 * size(&prepared.voltages), "{}", size(&gap) / size(&prepared.voltages));
    let mut counts = [0; 3];
    for (frame, scene) in frames.frames.iter().zip(&frames.scenes) {
        let change: f64 = frame.iter().zip(&frames.baseline).map(|(v, rest)| v * rest - rest * rest).sum();
        let change = change / size(&frames.baseline).powi(2);
        let of = |class: u8| scene.inclusions.iter().any(|inclusion| inclusion.class == class);
        match (of(RAISED), of(LOWERED)) {
            (true, false) => assert!(change < 0.0, "touches: {change}"),
            (false, true) => assert!(change > 0.0, "cuts: {change}"),
            (false, false) => assert!(change.abs() < 1e-12, "nothing: {change}"),
            (true, true) => {}
        }
        counts[usize::from(of(RAISED)) + usize::from(of(LOWERED))] += 1;
    }
    assert!(counts.iter().all(|count| *count > 0), "{counts:?}");
}

#[test]
fn coverage_falls_near_lost_electrodes() {
    let prepared = Prepared::new(skin()).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&prepared.voltages)).unwrap();
    let mut first = FirstStep::new(&prepared, &reference, &[InputImage::Coverage]).unwrap();
    let grid = *prepared.map.grid();
    let mut image = vec![9.0; grid.len()];
    first.images_of(&vec![0.0; prepared.channels()], &mut image).unwrap();
    let inside = prepared.map.inside_mask();
    for (value, inside) in image.iter().zip(&inside) {
        assert_eq!(*value, if *inside { 1.0 } else { 0.0 });
    }
    // Electrode 0 is at +x.
    let lost = |channel: usize| prepared.protocol.channel_touches(channel, 0);
    let frame: Vec<f64> = (0..prepared.channels()).map(|c| if lost(c) { f64::NAN } else { 0.0 }).collect();
    first.images_of(&frame, &mut image).unwrap();
    let at = |x: f64| image[grid.pixel_at([x, 0.001]).unwrap()];
    assert!(at(0.045) < 0.5 * at(-0.045) && at(-0.045) > 0.9, "{} {}", at(0.045), at(-0.045));
    first.images_of(&vec![0.0; prepared.channels()], &mut image).unwrap();
    assert_eq!(image[grid.pixel_at([0.045, 0.001]).unwrap()], 1.0);
}

// Measured: lowered 0.27, raised 0.34 (objects with contrasts of up to 100 on a linear image of a coarse mesh).
#[test]
fn thresholds_find_objects_of_both_signs() {
    let prepared = Prepared::new(skin()).unwrap();
    let mut request = request(24);
    request.most_lost = 0;
    request.scenes = Some(SceneKind::Objects);
    let frames = SimulatedFrames::new(&request, &prepared, 3, 24).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&frames.baseline)).unwrap();
    let differences: Vec<Vec<f64>> = frames.frames.iter().map(|frame| reference.difference(frame, None)).collect();
    let mut segmenter = Segmenter::new(&prepared, &reference, None, 16).unwrap();
    let found = segmenter.label(&differences, |_, _| {}).unwrap();
    let mut confusion = Confusion::new(3);
    for (frame, truth) in found.iter().zip(&frames.labels) {
        assert_eq!(frame.method, Method::Thresholds);
        confusion.add(truth, &frame.labels).unwrap();
    }
    let overlaps = [1, 2].map(|class| confusion.intersection_over_union(class).unwrap());
    // Guessing a single class everywhere would give about 0.05.
    assert!(overlaps.iter().all(|iou| *iou > 0.15), "{overlaps:?}");
}

/// A model of a small network with made-up weights.
fn made_up(inputs: &[&str]) -> Model {
    let shape = UNetShape { inputs: inputs.len(), classes: 3, width: 2, levels: 2 };
    let mut tensors = Tensors::default();
    for (number, spec) in shape.tensors().into_iter().enumerate() {
        let values = (0..spec.len()).map(|k| 0.2 + 0.1 * ((number + 3 * k) % 5) as f32).collect();
        tensors.insert(spec.name, spec.dims, values).unwrap();
    }
    let card = ModelCard {
        format: CARD_FORMAT.into(),
        weights: "m.safetensors".into(),
        weights_bytes: 0,
        weights_sha256: String::new(),
        shape,
        rows: 16,
        columns: 16,
        skin: "small".into(),
        skin_sha256: imaging_sha256(&skin()),
        inputs: inputs.iter().map(ToString::to_string).collect(),
        input_scale: vec![2.0; inputs.len()],
        classes: CLASSES.map(String::from).to_vec(),
        temperature: 1.0,
        first: None,
        training: TrainingRecord::default(),
    };
    Model::new(card, tensors)
}

#[test]
fn live_classes_are_those_of_the_network_until_a_frame_is_unlike_the_training_set() {
    let prepared = Prepared::new(skin()).unwrap();
    let mut request = request(3);
    request.most_lost = 0;
    let frames = SimulatedFrames::new(&request, &prepared, 1, 3).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&frames.baseline)).unwrap();
    let difference = reference.difference(&frames.frames[0], None);
    let mut model = made_up(&["image", "coverage"]);
    let mut classifier = Classifier::new(&prepared, &model).unwrap();
    let mut classes = Classes::new(1, 1);
    classifier.classify(&difference, &mut classes).unwrap();
    assert_eq!((classes.rows, classes.columns, classes.falls_back, classes.novelty), (16, 16, false, None));
    // Computed by hand: images, scale, network, and only background outside.
    let mut images = vec![0.0; 512];
    let inputs = [InputImage::Step(1.0), InputImage::Coverage];
    FirstStep::new(&prepared, &reference, &inputs).unwrap().images_of(&difference, &mut images).unwrap();
    images.iter_mut().for_each(|value| *value *= 2.0);
    let mut expected = vec![0.0; 768];
    model.network().unwrap().probabilities(&images, 1.0, &mut expected).unwrap();
    for (pixel, inside) in prepared.map.inside_mask().into_iter().enumerate() {
        for class in 0..3 {
            let outside = if class == 0 { 1.0 } else { 0.0 };
            let expected = if inside { expected[class * 256 + pixel] } else { outside };
            assert_eq!(classes.of_class(class as u8).unwrap()[pixel], expected, "{class} {pixel}");
        }
    }
    let counted = allocation_counter::measure(|| classifier.classify(&difference, &mut classes).unwrap());
    assert_eq!(counted.count_total, 0);

    // With a score that finds everything unusual, thresholds decide, and the probabilities are marked accordingly.
    let size = 4;
    model.tensors.insert("novelty.mean", vec![size], vec![100.0; size]).unwrap();
    model.tensors.insert("novelty.whitener", vec![size, size], vec![1.0; size * size]).unwrap();
    model.tensors.insert("novelty.reach", vec![1], vec![1.0]).unwrap();
    let mut classifier = Classifier::new(&prepared, &model).unwrap();
    classifier.classify(&difference, &mut classes).unwrap();
    assert!(classes.falls_back && classes.novelty.unwrap() > 1.0);
    let (image, polarity) = (&images[..256], prepared.skin.imaging.polarity.sign() as f32);
    let image: Vec<f32> = image.iter().map(|value| 0.5 * polarity * value).collect();
    let rule = MaskRule::linear(prepared.skin.touch.smallest_amplitude);
    assert_eq!(classes.labels, masks_of_image(&image, &rule));
    assert!(classes.labels.iter().any(|label| *label != BACKGROUND));
    for (pixel, label) in classes.labels.iter().enumerate() {
        assert_eq!(classes.of_class(*label).unwrap()[pixel], 1.0);
    }
    assert!(Classifier::new(&prepared, &made_up(&["coverage"])).unwrap_err().to_string().contains("an image among"));
}

#[test]
fn a_second_network_gets_the_first_ones_output() {
    let text = SKIN.replace("grid = 16", "grid = 40\nrefinement = { steps = 2 }");
    let prepared = Prepared::new(Skin::parse(&text, "small").unwrap()).unwrap();
    let request = TrainSetRequest::new(prepared.skin.clone(), 2);
    let frames = SimulatedFrames::new(&request, &prepared, 1, 2).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&frames.baseline)).unwrap();
    let difference = reference.difference(&frames.frames[0], None);
    let of_skin = |inputs: &[&str]| {
        let mut model = made_up(inputs);
        (model.card.rows, model.card.columns) = (40, 40);
        model.card.skin_sha256 = imaging_sha256(&prepared.skin);
        model
    };
    let first = of_skin(&["refined"]);
    let inputs = [InputImage::Step(1.0), InputImage::First(RAISED), InputImage::AboutFirst, InputImage::Refined];
    let mut images = vec![0.0; 4 * 1600];
    let mut step = FirstStep::with_first(&prepared, &reference, &inputs, Some(&first)).unwrap();
    step.images_of(&difference, &mut images).unwrap();
    let mut refined = vec![0.0; 1600];
    let mut plain = FirstStep::new(&prepared, &reference, &[InputImage::Refined]).unwrap();
    plain.images_of(&difference, &mut refined).unwrap();
    assert_eq!(images[4800..], refined);
    // The inputs of the first network times its scale.
    refined.iter_mut().for_each(|value| *value *= 2.0);
    let mut expected = vec![0.0; 4800];
    first.network().unwrap().probabilities(&refined, 1.0, &mut expected).unwrap();
    let inside = prepared.map.inside_mask();
    for pixel in 0..1600 {
        let probability = if inside[pixel] { expected[3200 + pixel] } else { 0.0 };
        assert_eq!(images[1600 + pixel], probability, "{pixel}");
        assert!(images[3200 + pixel].is_finite() && (inside[pixel] || images[3200 + pixel] == 0.0), "{pixel}");
    }
    assert!(images[3200..4800].iter().any(|value| value.abs() > 0.1));

    // Combined into one model they label frames. Without its first stage, or used live, the model is rejected.
    let mut second = of_skin(&["image", "first-raised", "about-first"]);
    let error =
        |model: &Model| Segmenter::new(&prepared, &reference, Some(model), 40).map(|_| ()).unwrap_err().to_string();
    assert!(error(&second).contains("a first network"), "{}", error(&second));
    second.set_first(&first).unwrap();
    assert!(first.clone().set_first(&second).is_err());
    let labelled = Segmenter::new(&prepared, &reference, Some(&second), 40).unwrap().label(&[difference], |_, _| {});
    assert!(matches!(labelled.unwrap()[0].method, Method::Network { novelty: None }));
    let error = Classifier::new(&prepared, &second).unwrap_err().to_string();
    assert!(error.contains("time for") && error.contains("first-raised"), "{error}");
}

#[test]
fn fitted_touches_are_an_input_of_sandwiches_that_refine_them() {
    let prepared = Prepared::new(Skin::open("healing-square").unwrap()).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&prepared.voltages)).unwrap();
    let inputs = [InputImage::Step(1.0), InputImage::Contacts, InputImage::Left];
    let mut first = FirstStep::new(&prepared, &reference, &inputs).unwrap();
    let mut rig = Rig::new("healing-square").unwrap();
    let press = Indenter::disc([0.012, -0.017], 0.01, 80e3);
    rig.frames(&[], 2).unwrap();
    let frame = rig.mean_frame(&[press], 1).unwrap();
    let difference = rig.reference().difference(&frame, None);
    let grid = *prepared.map.grid();
    let mut images = vec![0.0; 3 * grid.len()];
    first.images_of(&difference, &mut images).unwrap();
    let [image, contacts, left] = [0, 1, 2].map(|k| &images[k * grid.len()..(k + 1) * grid.len()]);
    // The pressing disc covers 314 mm^2, and the fit has its centre. Its pressure and its radius trade off.
    let covered: f64 = contacts.iter().map(|share| f64::from(*share)).sum();
    let area_mm2 = covered * (1e3 * grid.pixel_m).powi(2);
    assert!((220.0..450.0).contains(&area_mm2), "{area_mm2} mm^2");
    let mean = |axis: usize| {
        let sum: f64 = (0..grid.len()).map(|pixel| f64::from(contacts[pixel]) * grid.centre_m(pixel)[axis]).sum();
        sum / covered
    };
    assert!((mean(0) - 0.012).hypot(mean(1) + 0.017) < 0.5e-3, "{} {}", mean(0), mean(1));
    let energy = |image: &[f32]| image.iter().map(|value| f64::from(value * value)).sum::<f64>();
    assert!(energy(left) < 0.05 * energy(image), "{} of {}", energy(left), energy(image));

    let mut plain = prepared.skin.clone();
    plain.backend.circuit = Skin::open("hydrogel-disc").unwrap().backend.circuit;
    let prepared = Prepared::new(plain).unwrap();
    let error = FirstStep::new(&prepared, &reference, &inputs).unwrap_err().to_string();
    assert!(error.contains("contacts") && error.contains("circuit"), "{error}");
}

#[test]
fn models_of_other_skins_inputs_and_sizes_are_refused() {
    let prepared = Prepared::new(skin()).unwrap();
    let reference = Reference::of(&prepared, std::slice::from_ref(&prepared.voltages)).unwrap();
    let Model { card, tensors, .. } = made_up(&["image"]);
    let outcome = |card: &ModelCard| {
        let model = Model::new(card.clone(), tensors.clone());
        Segmenter::new(&prepared, &reference, Some(&model), 32).map(|_| ()).map_err(|error| error.to_string())
    };
    outcome(&card).unwrap();
    let message = |change: &dyn Fn(&mut ModelCard)| {
        let mut changed = card.clone();
        change(&mut changed);
        outcome(&changed).unwrap_err()
    };
    assert!(message(&|card| card.skin_sha256 = "00".into()).contains("train one for it"));
    assert!(message(&|card| card.inputs = vec!["touch".into()]).contains("expected image, image*FACTOR"));
    assert!(message(&|card| card.rows = 32).contains("expected images of 16 x 16, got 32 x 16"));
    assert!(message(&|card| card.classes.reverse()).contains("classes background, lowered, raised"));
    // A change that affects images changes the fingerprint; one that affects only touches doesn't.
    let mut other = skin();
    other.touch.begin_sigma += 1.0;
    assert_eq!(imaging_sha256(&other), imaging_sha256(&skin()));
    other.imaging.grid = 24;
    assert_ne!(imaging_sha256(&other), imaging_sha256(&skin()));
}

/// The healing square's twin without its instrument.
fn healing_square() -> impl Frontend {
    AnyTwin::from_skin(&Skin::open("healing-square").unwrap()).unwrap().into_parts().0
}

/// The shipped network on a twin that it has never seen, with other contact parameters and another mesh. No noise, so
/// that the result doesn't depend on chance.
#[test]
fn the_network_of_the_healing_square_finds_presses_of_its_twin() {
    let prepared = Prepared::new(Skin::open("healing-square").unwrap()).unwrap();
    let model = built_in("healing-square").unwrap().unwrap();
    assert!(built_in("ionic-disc").unwrap().is_none());
    assert!(model.card.training.calibration_error < 0.03, "{}", model.card.training.calibration_error);
    let mut classifier = Classifier::new(&prepared, &model).unwrap();
    let mut twin = healing_square();
    let mut frame = |places_mm: &[[f64; 2]]| {
        let press = |place: &[f64; 2]| Indenter::disc(place.map(|mm| mm * 1e-3), 0.01, 80e3);
        let indenters: Vec<Indenter> = places_mm.iter().map(press).collect();
        let mut voltages = vec![0.0; prepared.channels()];
        twin.voltages(&indenters, 0.04, &mut voltages).unwrap();
        voltages
    };
    let reference = Reference::of(&prepared, std::slice::from_ref(&frame(&[]))).unwrap();
    let grid = prepared.map.grid();
    let mut classes = Classes::new(grid.rows, grid.columns);
    let distance = |p: [f64; 2], q_mm: &[f64; 2]| (p[0] * 1e3 - q_mm[0]).hypot(p[1] * 1e3 - q_mm[1]);
    for places_mm in [vec![[0.0, 0.0]], vec![[25.0, 25.0]], vec![[12.5, -25.0]], vec![[-25.0, 0.0], [25.0, 0.0]]] {
        classifier.classify(&reference.difference(&frame(&places_mm), None), &mut classes).unwrap();
        assert!(!classes.falls_back, "{places_mm:?}: {:?}", classes.novelty);
        let raised: Vec<f64> = classes.of_class(RAISED).unwrap().iter().map(|p| f64::from(*p)).collect();
        let pressed = |pixel: usize| places_mm.iter().any(|place| distance(grid.centre_m(pixel), place) < 10.0);
        let truth: Vec<f64> = (0..grid.len()).map(|pixel| f64::from(u8::from(pressed(pixel)))).collect();
        // Measured: above 0.75 for one touch and 0.65 for two, with one touch within 1.3 mm. The linear image gives
        // 0.55 and 0.45.
        let likeness = icc(&truth, &raised).unwrap();
        assert!(likeness > 0.6, "{places_mm:?}: {likeness}");
        if let [place] = &places_mm[..] {
            let found = centroid_above_m(&raised, grid, 1.0, 0.5).unwrap();
            assert!(distance(found, place) < 2.0, "{found:?} {place:?}");
        }
    }
    classifier.classify(&vec![0.0; prepared.channels()], &mut classes).unwrap();
    assert!(classes.labels.iter().all(|label| *label == BACKGROUND), "an untouched skin is background");
}

/// With a network in the background, classes arrive later and match those of the frame they name bit for bit.
#[test]
fn a_network_in_the_background_names_the_frame_of_its_classes() {
    let model = built_in("healing-square").unwrap().unwrap();
    let pipeline = |pace| {
        let prepared = Prepared::new(Skin::open("healing-square").unwrap()).unwrap();
        let layout = Layout::Channels { count: prepared.channels() };
        let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        pipeline.set_classifier(Some(&model), pace).unwrap();
        pipeline
    };
    let (mut at_once, mut beside) = (pipeline(ClassPace::EveryFrame), pipeline(ClassPace::Background));
    let mut twin = healing_square();
    let mut read = |indenters: &[Indenter]| {
        let mut voltages = vec![0.0; at_once.prepared().channels()];
        twin.voltages(indenters, 0.04, &mut voltages).unwrap();
        voltages
    };
    let (rest, pressed) = (read(&[]), read(&[Indenter::disc([0.01, -0.02], 0.01, 80e3)]));
    let (mut frame, mut known, mut seen) = (Frame::default(), Vec::new(), None);
    // The network needs several milliseconds; the number of frames in that time depends on the machine. All frames
    // are also classified at once, so that late results can be compared.
    for number in 0..2000 {
        let values = if number < 40 { &rest } else { &pressed };
        let stamp = HostStamp { monotonic_ns: number * 20_000_000, wall_ns: number };
        frame.refill(number, stamp, values, &[]);
        let output = at_once.process(&frame, stamp.monotonic_ns).unwrap();
        assert!(output.classes.as_ref().is_none_or(|of| of.sequence == number));
        known.push(output.classes.map(|of| of.classes.into_owned()));
        let output = beside.process(&frame, stamp.monotonic_ns).unwrap();
        if let Some(of) = output.classes
            && let Some(expected) = known.get(of.sequence as usize)
        {
            assert!(of.sequence < number, "classes come later than their frame");
            assert_eq!(Some(&*of.classes), expected.as_ref(), "frame {}", of.sequence);
            seen = Some(of.sequence);
        }
        // Stop once a frame after the press has been classified.
        if seen.is_some_and(|sequence| sequence >= 45) {
            break;
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert!(seen.is_some(), "no classes of the first {} frames were seen", known.len());
}

#[test]
fn a_network_suits_the_skin_it_was_trained_for_while_touches_are_fitted() {
    let model = built_in("healing-square").unwrap().unwrap();
    let skin = Skin::open("healing-square").unwrap();
    let mut without_fits = skin.clone();
    without_fits.backend.circuit = Skin::open("hydrogel-disc").unwrap().backend.circuit;
    let mut changed = skin.clone();
    changed.imaging.grid = 48;
    assert!(suits(&model, &skin) && !suits(&model, &without_fits) && !suits(&model, &changed));
}

#[test]
fn a_network_that_is_shown_refined_images_is_not_for_live_frames() {
    let prepared = Prepared::new(Skin::open("ktc-tank").unwrap()).unwrap();
    let error = Classifier::new(&prepared, &built_in("ktc-tank").unwrap().unwrap()).unwrap_err().to_string();
    assert!(error.contains("time for") && error.contains("refined"), "{error}");
}
