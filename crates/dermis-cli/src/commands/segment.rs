//! `dermis segment`: labels recorded frames, 0 background, 1 conductivity lowered, 2 raised.

use std::io::Write;
use std::path::PathBuf;

use dermis_device::FileSpec;
use dermis_lab::learning::segment::{Method, NetworkChoice, SegmentRequest, Segmented, segment};
use dermis_live::network::CLASSES;

use super::recorded::RecordedFrames;
use super::{print_json, with_progress};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis segment healing-square --baseline rest.csv --frames press.csv \\
      --out labels.npy --size 64

labels.npy is rows x columns (frames x rows x columns for several frames), u8, row 0 at the top: 0 background, 1 \
conductivity lowered (damaged, resistive), 2 raised (compressed, conductive). The network of --model, or the one \
shipped with the skin, labels the frames. Without a network, and for frames unlike its training data (novelty score \
above 1.5), thresholds on the image label them. Missing channels are empty cells or NaN.";

/// Arguments of `dermis segment`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    recorded: RecordedFrames,
    /// Frames of the untouched skin.
    #[arg(long, alias = "reference", value_name = "FILE[#FRAMES]")]
    baseline: FileSpec,
    /// A model card made by `dermis train`; default: the network shipped with the skin, if any.
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// Use thresholds only, no network.
    #[arg(long, conflicts_with_all = ["model", "probabilities"])]
    no_model: bool,
    /// Pixels along the longer side of the labels.
    #[arg(long, value_name = "PIXELS", default_value_t = 256)]
    size: usize,
    /// Output file for the labels.
    #[arg(long, value_name = "LABELS.npy")]
    out: Option<PathBuf>,
    /// Output file for the probabilities: frames x classes x rows x columns, f32; NaN for frames labelled by
    /// thresholds.
    #[arg(long, value_name = "FILE.npy")]
    probabilities: Option<PathBuf>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Labels all frames and prints how each was labelled.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.out.is_none() && self.probabilities.is_none() {
            return Err(UsageError("nothing to write: give --out, --probabilities or both".into()).into());
        }
        let skin = self.recorded.skin.open()?;
        if !self.recorded.as_skin && self.recorded.read.options().format.is_none() {
            [&self.baseline, &self.recorded.frames]
                .into_iter()
                .try_for_each(|file| dermis_record::check_skin(file, &skin))?;
        }
        let request = SegmentRequest {
            skin,
            reference: self.baseline,
            frames: self.recorded.frames,
            read: self.recorded.read.options(),
            network: match self.model {
                Some(path) => NetworkChoice::File(path),
                None if self.no_model => NetworkChoice::None,
                None => NetworkChoice::Shipped,
            },
            size: self.size,
            labels: self.out,
            probabilities: self.probabilities,
        };
        let segmented = with_progress("steps", |progress| segment(&request, progress))?;
        if self.json {
            print_json(&segmented.iter().map(as_json).collect::<Vec<_>>(), out)?;
            return Ok(Outcome::Done);
        }
        for (number, frame) in segmented.iter().enumerate() {
            writeln!(out, "frame {number}: {}", described(frame))?;
        }
        Ok(Outcome::Done)
    }
}

/// Share of the labels in a class, per cent.
fn share_percent(frame: &Segmented, class: usize) -> f64 {
    let count = frame.labels.iter().filter(|label| usize::from(**label) == class).count();
    100.0 * count as f64 / frame.labels.len().max(1) as f64
}

fn as_json(frame: &Segmented) -> serde_json::Value {
    let (method, novelty) = match frame.method {
        Method::Network { novelty } => ("network", novelty),
        Method::UnlikeTraining { novelty } => ("thresholds", Some(novelty)),
        Method::Thresholds => ("thresholds", None),
    };
    let [lowered, raised] = [1, 2].map(|class| share_percent(frame, class));
    serde_json::json!({ "lowered_percent": lowered, "raised_percent": raised, "method": method, "novelty": novelty })
}

fn described(frame: &Segmented) -> String {
    let share = |class: usize| format!("{} {:.2} %", CLASSES[class], share_percent(frame, class));
    let method = match frame.method {
        Method::Network { novelty: Some(score) } => format!("network, novelty {score:.2}"),
        Method::Network { novelty: None } => "network".into(),
        Method::UnlikeTraining { novelty } => format!("thresholds, since novelty is {novelty:.2}"),
        Method::Thresholds => "thresholds".into(),
    };
    format!("{}, {} ({method})", share(1), share(2))
}
