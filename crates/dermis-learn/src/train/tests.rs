//! Training on discs in noise: the training network and the live network agree, the loss falls, and a resumed
//! training gives the same result as an uninterrupted one.

use std::path::Path;

use super::training::initial;
use super::*;
use crate::shards::SET_FORMAT;

/// Bright discs (class 1) in noise, 16 x 16.
fn discs(folder: &Path, samples: usize) -> TrainingSet {
    let manifest = Manifest {
        format: SET_FORMAT.into(),
        skin: "discs".into(),
        skin_sha256: "0".into(),
        seed: 5,
        samples,
        shard_samples: samples / 8,
        inputs: vec!["image".into()],
        rows: 16,
        columns: 16,
        classes: vec!["nothing".into(), "disc".into()],
        recipe: serde_json::Value::Null,
    };
    let set = TrainingSet::create(folder, manifest).unwrap();
    for number in 0..8 {
        let mut random = StdRng::seed_from_u64(number as u64);
        let mut shard = Shard::default();
        for _ in 0..samples / 8 {
            let [x, y] = [0, 1].map(|_| random.random_range(3.0..13.0));
            for pixel in 0..256 {
                let inside = ((pixel % 16) as f64 - x).hypot((pixel / 16) as f64 - y) < 3.0;
                shard.inputs.push(f32::from(u8::from(inside)) + random.random_range(-0.7..0.7));
                shard.labels.push(u8::from(inside));
            }
        }
        set.write(number, &shard).unwrap();
    }
    set
}

fn options(epochs: usize) -> TrainOptions {
    TrainOptions { width: 4, levels: 2, epochs, batch: 16, learning_rate: 1e-2, held_out: 0.25, ..Default::default() }
}

#[test]
fn the_network_that_runs_live_has_the_loss_of_the_one_that_descends() {
    let shape = UNetShape { inputs: 2, classes: 3, width: 4, levels: 3 };
    let tensors = initial(&shape, &mut StdRng::seed_from_u64(4)).unwrap();
    let mut trainable = NativeUNet::new(shape, &tensors, None, &[1.0; 3]).unwrap();
    let mut random = StdRng::seed_from_u64(6);
    let inputs: Vec<f32> = (0..2 * 8 * 12).map(|_| random.random_range(-1.0..1.0)).collect();
    let labels: Vec<u8> = (0..8 * 12).map(|_| random.random_range(0..3)).collect();
    let batch = Batch { count: 1, rows: 8, columns: 12, inputs: &inputs, labels: &labels };
    // Many steps with rate 0 move the running means to those of this batch without changing the weights.
    let mut loss = 0.0;
    for _ in 0..400 {
        loss = trainable.step(&batch, 0.0);
    }
    let after = trainable.tensors().unwrap();
    assert_eq!(after.get("up.0.conv1.weight"), tensors.get("up.0.conv1.weight"));
    let mut network = Network::new(shape, &after, 8, 12).unwrap();
    let mut values = vec![0.0; 3 * 96];
    network.probabilities(&inputs, 1.0, &mut values).unwrap();
    let own = labels.iter().enumerate().map(|(k, label)| -f64::from(values[usize::from(*label) * 96 + k]).ln());
    let own = own.sum::<f64>() / 96.0;
    // 0.9^400 of the initial statistics remain; single precision through ten blocks.
    assert!((own - loss).abs() < 1e-5 * loss.max(1.0), "{own} {loss}");
}

#[test]
fn the_symmetries_are_the_eight_of_the_square() {
    let images: Vec<Vec<usize>> = (0..8).map(|k| (0..9).map(|place| turned(place, 3, k)).collect()).collect();
    // A quarter turn: the top left corner moves to the top right, and neighbours stay neighbours.
    assert_eq!(images[5], [6, 3, 0, 7, 4, 1, 8, 5, 2]);
    for (k, image) in images.iter().enumerate() {
        let mut sorted = image.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, [0, 1, 2, 3, 4, 5, 6, 7, 8]);
        assert!(images[..k].iter().all(|other| other != image), "{k}");
        for (a, b) in [(0, 1), (1, 4), (4, 7), (7, 8)] {
            let apart = (image[a] / 3).abs_diff(image[b] / 3) + (image[a] % 3).abs_diff(image[b] % 3);
            assert_eq!(apart, 1, "{k} {a} {b}");
        }
    }
}

#[test]
fn an_interrupted_training_ends_as_the_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let set = discs(&folder.path().join("set"), 256);
    let run = |checkpoint: &str, stop_after: usize| {
        let checkpoint = folder.path().join(checkpoint);
        let options = options(4);
        let training = Training {
            set: &set,
            options: &options,
            checkpoint: &checkpoint,
            command: "test",
            start: None,
            input_scale: None,
        };
        let mut reports = Vec::new();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            train(&training, |progress| {
                if let Progress::Epoch(report) = progress {
                    reports.push(report.clone());
                    assert!(reports.len() < stop_after, "interrupted");
                }
            })
        }));
        (outcome.ok().map(|model| model.unwrap()), reports)
    };
    let (whole, reports) = run("whole", 99);
    let whole = whole.unwrap();
    assert_eq!(reports.len(), 4);
    assert!(reports[3].loss < 0.5 * reports[0].loss, "{reports:?}");
    let iou = whole.card.training.held_out_iou[1].unwrap();
    assert!(iou > 0.7, "{iou}");

    let (broken, first) = run("broken", 2);
    assert!(broken.is_none() && first.len() == 2);
    let (resumed, rest) = run("broken", 99);
    let resumed = resumed.unwrap();
    assert_eq!(rest.len(), 2);
    // The same arithmetic in the same order.
    assert_eq!(resumed.tensors, whole.tensors);
    assert_eq!(resumed.card.training.best_epoch, whole.card.training.best_epoch);

    // Random symmetries and unequal class weights change the training, which can still be resumed.
    let options_turned = TrainOptions { symmetries: true, class_weights: vec![1.0, 2.0], ..options(2) };
    let other = folder.path().join("turned");
    let training = Training {
        set: &set,
        options: &options_turned,
        checkpoint: &other,
        command: "test",
        start: None,
        input_scale: None,
    };
    let turned = train(&training, |_| {}).unwrap();
    assert!(turned.card.training.held_out_iou[1].unwrap() > 0.3, "{:?}", turned.card.training);
    assert_ne!(turned.tensors, whole.tensors);

    // A training started from finished weights begins at their loss.
    let (better, other) = (options(1), folder.path().join("further"));
    let start = Some(&whole.tensors);
    let training =
        Training { set: &set, options: &better, checkpoint: &other, command: "test", start, input_scale: None };
    let further = train(&training, |_| {}).unwrap().card.training;
    assert!(further.held_out_loss < 0.8 * reports[0].held_out_loss, "{further:?} {reports:?}");

    // Another training rejects the checkpoint; a damaged checkpoint is reported.
    let other = TrainOptions { seed: 9, ..options(4) };
    let checkpoint = folder.path().join("whole");
    let training = Training {
        set: &set,
        options: &other,
        checkpoint: &checkpoint,
        command: "test",
        start: None,
        input_scale: None,
    };
    let error = train(&training, |_| {}).unwrap_err().to_string();
    assert!(error.contains("made with other options"), "{error}");
    std::fs::write(checkpoint.join("checkpoint-0.safetensors"), b"no").unwrap();
    let training = Training { options: &options(4), ..training };
    let error = train(&training, |_| {}).unwrap_err().to_string();
    assert!(error.contains("not what the checkpoint says"), "{error}");
}

#[test]
fn foreign_weights_get_a_card_unchanged() {
    let folder = tempfile::tempdir().unwrap();
    let set = discs(&folder.path().join("set"), 40);
    let given = TrainOptions { epochs: 0, ..options(0) };
    let shape = UNetShape {
        inputs: set.manifest().inputs.len(),
        classes: set.manifest().classes.len(),
        width: given.width,
        levels: given.levels,
    };
    let elsewhere = crate::network::tests::random_tensors(&shape, 7);
    let scale = vec![0.5; shape.inputs];
    let checkpoint = folder.path().join("none");
    let judged = |start, input_scale| {
        let (options, command) = (&given, "test");
        train(&Training { set: &set, options, checkpoint: &checkpoint, command, start, input_scale }, |_| ())
    };
    let model = judged(Some(&elsewhere), Some(&scale[..])).unwrap();
    assert!(elsewhere.iter().all(|(name, _, values)| model.tensors.get(name).unwrap().1 == values));
    assert_eq!((model.card.training.epochs, &model.card.input_scale), (0, &scale));
    assert!(model.card.training.held_out_loss < 100.0 && model.novelty().is_some());
    let error = judged(None, None).unwrap_err().to_string();
    assert!(error.contains("at least 1 where there are no weights"), "{error}");
    let error = judged(Some(&elsewhere), Some(&[1.0, -1.0])).unwrap_err().to_string();
    assert!(error.contains("factor"), "{error}");
}
