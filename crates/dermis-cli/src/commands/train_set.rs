//! `dermis train-set`: simulates and images random scenes on a skin, as training data for a network.

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use dermis_lab::learning::train_set::{LostElectrodes, TrainSetRequest, simulate};
use dermis_learn::Model;
use dermis_learn::scene::SceneKind;
use dermis_live::network::InputImage;

use super::skin_word::SkinWord;
use super::with_progress;
use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis train-set healing-square --samples 40 --shard 20 --out set

Every shard has its own skin (another mesh than the reconstruction's, slightly displaced electrodes, other contact \
impedances), its own instrument (gain, drift, noise) and its own lost electrodes. The folder has manifest.json and \
shard-00000.safetensors, ... with inputs (samples x images x rows x columns, F32) and labels (samples x rows x \
columns, U8: 0 background, 1 conductivity lowered, 2 raised). The same command resumes an interrupted set. The set \
depends only on --seed and the other options.";

/// Arguments of `dermis train-set`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    skin: SkinWord,
    /// Total number of samples.
    #[arg(long, value_name = "N", default_value_t = 14_000)]
    samples: usize,
    /// Samples that share a skin, an instrument and lost electrodes.
    #[arg(long, value_name = "N", default_value_t = 250)]
    shard: usize,
    /// Seed of all random numbers.
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Kind of scenes; default: chosen by the skin's layer.
    #[arg(long, value_enum)]
    scenes: Option<Scenes>,
    /// Inputs of the network: image, image*FACTOR (on lambda), refined, contacts, left, coverage, first-lowered,
    /// first-raised, about-first; separated by commas.
    #[arg(long, value_name = "IMAGES", value_delimiter = ',', default_value = "image")]
    inputs: Vec<InputImage>,
    /// Largest number of lost electrodes; if not 0, add the input coverage.
    #[arg(long, value_name = "N", default_value_t = 0)]
    lost: usize,
    /// Which electrodes are lost.
    #[arg(long, value_enum, default_value_t = Lost::Mixed)]
    lost_which: Lost,
    /// Noise of the instrument, dB below the root mean square of a frame.
    #[arg(long, alias = "noise-db", value_name = "DB", default_value_t = 56.8)]
    snr_db: f64,
    /// Change of the whole body's conductivity between baseline and frame: standard deviation of its logarithm.
    #[arg(long, value_name = "DEVIATION", default_value_t = 0.0)]
    background: f64,
    /// Least and largest contrast of objects in a tank, separated by a comma; default: 5 and 100.
    #[arg(long, value_name = "LEAST,LARGEST", value_delimiter = ',')]
    contrasts: Vec<f64>,
    /// First-stage model, for the inputs first-lowered, first-raised and about-first.
    #[arg(long, value_name = "MODEL.json")]
    first: Option<PathBuf>,
    /// Output folder.
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
}

/// Kind of scenes.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Scenes {
    /// No touch to four touches, and cuts: lines, arcs, holes.
    TouchesAndCuts,
    /// One to four objects in a tank, insulating or metallic.
    Objects,
    /// Objects as above, including crosses, Ts and stars.
    ObjectsAndCrosses,
}

/// Which electrodes are lost.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Lost {
    /// The first ones in half of the cases; otherwise a run of neighbours from anywhere, or scattered ones.
    Mixed,
    /// The first ones.
    First,
}

impl Arguments {
    /// Simulates the missing shards and prints how long it took.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let mut request = TrainSetRequest::new(self.skin.open()?, self.samples);
        request.shard_samples = self.shard;
        request.seed = self.seed;
        request.inputs = self.inputs;
        request.most_lost = self.lost;
        request.lost = match self.lost_which {
            Lost::Mixed => LostElectrodes::Mixed,
            Lost::First => LostElectrodes::First,
        };
        request.jitter.noise_db = self.snr_db;
        request.jitter.background = self.background;
        request.contrasts = match *self.contrasts.as_slice() {
            [] => None,
            [least, largest] => Some([least, largest]),
            _ => anyhow::bail!("--contrasts: expected two factors, got {}", self.contrasts.len()),
        };
        request.first = self.first.as_deref().map(Model::load).transpose()?;
        request.scenes = self.scenes.map(|scenes| match scenes {
            Scenes::TouchesAndCuts => SceneKind::TouchesAndCuts,
            Scenes::Objects => SceneKind::Objects,
            Scenes::ObjectsAndCrosses => SceneKind::ObjectsAndCrosses,
        });
        let begun = Instant::now();
        let set = with_progress("samples", |progress| simulate(&request, &self.out, progress))?;
        let manifest = set.manifest();
        writeln!(out, "samples: {} in {} shards", manifest.samples, manifest.shards())?;
        writeln!(out, "images: {} of {} x {}", manifest.inputs.join(", "), manifest.rows, manifest.columns)?;
        writeln!(out, "manifest: {}", set.manifest_sha256())?;
        writeln!(out, "time: {:.1} s", begun.elapsed().as_secs_f64())?;
        Ok(Outcome::Done)
    }
}
