//! Training on discs in noise: the gradient network and the one that runs live agree, the loss falls, a training that
//! was interrupted ends where the uninterrupted one does.

use super::*;
use crate::shards::Manifest;
use crate::shards::SET_FORMAT;
use rand::Rng;

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
    let mut trainable = native::NativeUNet::new(shape, &tensors, None, &[1.0; 3]).unwrap();
    let mut random = StdRng::seed_from_u64(6);
    let inputs: Vec<f32> = (0..2 * 8 * 12).map(|_| random.random_range(-1.0..1.0)).collect();
    let labels: Vec<u8> = (0..8 * 12).map(|_| random.random_range(0..3)).collect();
    let batch = Batch { count: 1, rows: 8, columns: 12, inputs: &inputs, labels: &labels };
    // Many steps of rate 0 bring the running means to those of this batch, and the weights stay.
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
    // 0.9^400 of the initial statistics are left; single precision through ten blocks.
    assert!((own - loss).abs() < 1e-5 * loss.max(1.0), "{own} {loss}");
}

/// An independent implementation of forward, slopes and Adam.
#[cfg(feature = "train")]
#[test]
fn burn_takes_the_same_steps() {
    let shape = UNetShape { inputs: 2, classes: 3, width: 4, levels: 3 };
    let tensors = initial(&shape, &mut StdRng::seed_from_u64(4)).unwrap();
    let mut random = StdRng::seed_from_u64(6);
    let inputs: Vec<f32> = (0..4 * 2 * 8 * 12).map(|_| random.random_range(-1.0..1.0)).collect();
    let labels: Vec<u8> = (0..4 * 8 * 12).map(|_| random.random_range(0..3)).collect();
    let batch = Batch { count: 4, rows: 8, columns: 12, inputs: &inputs, labels: &labels };
    let weights = [1.0, 3.0, 0.5];
    let mut own = native::NativeUNet::new(shape, &tensors, None, &weights).unwrap();
    let device = Device::flex().autodiff();
    let mut other = burn::BurnUNet::new(shape, &tensors, None, &weights, &device).unwrap();
    for _ in 0..5 {
        let (a, b) = (own.step(&batch, 1e-3), other.step(&batch, 1e-3));
        assert!((a - b).abs() < 1e-4 * a, "{a} {b}");
    }
    for ((name, _, a), (_, _, b)) in own.tensors().unwrap().iter().zip(other.tensors().unwrap().iter()) {
        let gap = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // Adam divides by the slope's own size: where a slope is near 0, rounding turns into a part of a step (5 of 1e-3).
        assert!(gap < 1e-3, "{name} {gap}");
    }
}

#[test]
fn an_interrupted_training_ends_as_the_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    let set = discs(&folder.path().join("set"), 256);
    let run = |checkpoint: &str, stop_after: usize| {
        let checkpoint = folder.path().join(checkpoint);
        let options = options(4);
        let training = Training { set: &set, options: &options, checkpoint: &checkpoint, command: "test" };
        let mut reports = Vec::new();
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            train(&training, &Backend::Native, |progress| {
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

    // Another training does not take the checkpoint for its own; a damaged one is named.
    let other = TrainOptions { seed: 9, ..options(4) };
    let checkpoint = folder.path().join("whole");
    let training = Training { set: &set, options: &other, checkpoint: &checkpoint, command: "test" };
    let error = train(&training, &Backend::Native, |_| {}).unwrap_err().to_string();
    assert!(error.contains("made with other options"), "{error}");
    std::fs::write(checkpoint.join("checkpoint-0.safetensors"), b"no").unwrap();
    let training = Training { options: &options(4), ..training };
    let error = train(&training, &Backend::Native, |_| {}).unwrap_err().to_string();
    assert!(error.contains("not what the checkpoint says"), "{error}");
}
