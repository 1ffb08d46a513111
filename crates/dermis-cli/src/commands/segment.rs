//! `dermis segment`: recorded frames to labels, 0 background, 1 conductivity lowered, 2 raised.

use std::io::Write;
use std::path::PathBuf;

use dermis::learning::CLASSES;
use dermis::learning::segment::{Method, NetworkChoice, SegmentRequest, Segmented, segment};
use dermis::skin::Skin;
use dermis_device::{FileSpec, Format};

use super::progress_bar;
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis segment --skin healing-square --reference rest.csv --frames press.csv --out labels.npy --size 64

labels.npy is rows x columns (frames x rows x columns for several frames), u8, row 0 at the top: 0 background, 1 conductivity
lowered (damaged, resistive), 2 raised (compressed, conductive). The network of --model labels the frames, or the one that
ships with the skin; a frame unlike those that it was trained on (novelty score above 1.5) is labelled by thresholds on its
image, as all are where there is no network.
Missing channels are empty cells or NaN.";

/// Arguments of `dermis segment`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Built-in skin or skin file.
    #[arg(long, value_name = "NAME|FILE")]
    skin: String,
    /// Frames of the untouched skin; #0..60 or #name after the file's name takes some of them.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    reference: FileSpec,
    /// Frames to label.
    #[arg(long, value_name = "FILE[#FRAMES]")]
    frames: FileSpec,
    /// Format of both files (csv, columns, npy, sciospec, ktc, golfball, pyeidors); recognised where left out.
    #[arg(long)]
    format: Option<Format>,
    /// A model card made by `dermis train`; the network that ships with the skin, if any, where left out.
    #[arg(long, value_name = "MODEL.json")]
    model: Option<PathBuf>,
    /// Thresholds alone, no network.
    #[arg(long, conflicts_with_all = ["model", "probabilities"])]
    no_model: bool,
    /// Pixels along the longer side of the labels.
    #[arg(long, value_name = "PIXELS", default_value_t = 256)]
    size: usize,
    /// Where the labels go.
    #[arg(long, value_name = "LABELS.npy")]
    out: Option<PathBuf>,
    /// Where the probabilities go: frames x classes x rows x columns, f32; NaN for frames labelled by thresholds.
    #[arg(long, value_name = "FILE.npy")]
    probabilities: Option<PathBuf>,
}

impl Arguments {
    /// Labels all frames and says how each was.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.out.is_none() && self.probabilities.is_none() {
            return Err(UsageError("nothing asked for: give --out, --probabilities or both".into()).into());
        }
        let request = SegmentRequest {
            skin: Skin::open(&self.skin)?,
            reference: self.reference,
            frames: self.frames,
            format: self.format,
            network: match self.model {
                Some(path) => NetworkChoice::File(path),
                None if self.no_model => NetworkChoice::None,
                None => NetworkChoice::Shipped,
            },
            size: self.size,
            labels: self.out,
            probabilities: self.probabilities,
        };
        let bar = progress_bar("steps");
        let segmented = segment(&request, |done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        });
        bar.finish_and_clear();
        for (number, frame) in segmented?.iter().enumerate() {
            writeln!(out, "frame {number}: {}", described(frame))?;
        }
        Ok(Outcome::Done)
    }
}

fn described(frame: &Segmented) -> String {
    let share = |class: usize| {
        let count = frame.labels.iter().filter(|label| usize::from(**label) == class).count();
        format!("{} {:.2} %", CLASSES[class], 100.0 * count as f64 / frame.labels.len().max(1) as f64)
    };
    let method = match frame.method {
        Method::Network { novelty: Some(score) } => format!("network, novelty {score:.2}"),
        Method::Network { novelty: None } => "network".into(),
        Method::UnlikeTraining { novelty } => format!("thresholds, since novelty is {novelty:.2}"),
        Method::Thresholds => "thresholds".into(),
    };
    format!("{}, {} ({method})", share(1), share(2))
}
