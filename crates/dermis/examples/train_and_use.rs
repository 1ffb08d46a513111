//! A network that distinguishes touches from cuts: simulated samples, training, use. A training set this small teaches
//! little. A network for real use takes thousands of samples and several hours; see the book's chapter on learning.
//! `cargo run --release -p dermis --example train_and_use`

use dermis::learn::{Model, Segmenter, SimulatedFrames, TrainOptions, TrainSetRequest, Training, simulate, train};
use dermis::offline::Reference;
use dermis::pipeline::Prepared;
use dermis::skin::{Layer, SheetLayer};
use dermis::{Error, FileError, Skin};

/// Trains a network and labels a frame with it.
pub fn main() -> Result<(), Error> {
    let folder = std::env::temp_dir().join(format!("dermis-train-and-use-{}", std::process::id()));
    let mut skin = Skin::disc("my-disc", 100.0, Layer::Sheet(SheetLayer::gel(5.0, 0.2))).with_rim_electrodes(12, 8.0);
    (skin.imaging.grid, skin.imaging.elements) = (16, 700);

    // Samples: each shard has its own skin and instrument, which deviate slightly from the model.
    let mut request = TrainSetRequest::new(skin.clone(), 24);
    request.shard_samples = 8;
    let set = simulate(&request, &folder.join("set"), |done, all| println!("{done} of {all} samples"))?;

    // Training on the CPU. The model is a card (JSON) with its weights in a file next to it.
    let options = TrainOptions { width: 2, levels: 2, epochs: 3, batch: 8, held_out: 0.34, ..TrainOptions::default() };
    let checkpoint = folder.join("checkpoint");
    let training = Training {
        set: &set,
        options: &options,
        checkpoint: &checkpoint,
        command: "example train_and_use",
        start: None,
        input_scale: None,
    };
    let card = folder.join("model.json");
    train(&training, |_| {})?.save(&card)?;

    // Use: frames that the network hasn't seen, from another shard's skin.
    let prepared = Prepared::new(skin)?;
    let unseen = SimulatedFrames::new(&request, &prepared, 99, 4)?;
    let reference = Reference::of(&prepared, &[unseen.baseline])?;
    let differences: Vec<Vec<f64>> = unseen.frames.iter().map(|frame| reference.difference(frame, None)).collect();
    let mut segmenter = Segmenter::new(&prepared, &reference, Some(&Model::load(&card)?), 64)?;
    for (frame, labelled) in segmenter.label(&differences, |_, _| {})?.iter().enumerate() {
        let of = |class: u8| labelled.labels.iter().filter(|label| **label == class).count();
        println!("frame {frame}: {} pixels lowered, {} raised, by {:?}", of(1), of(2), labelled.method);
    }
    std::fs::remove_dir_all(&folder).map_err(|source| Error::Io(FileError { file: folder, source }))
}
