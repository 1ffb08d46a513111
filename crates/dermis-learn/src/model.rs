//! A trained model: the weights (safetensors) and next to them the model card (JSON) with their purpose, training and
//! quality. The card holds the size and SHA-256 of the weights, which are checked before any weights are parsed.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::LearnError;
use crate::network::Network;
use crate::novelty::Novelty;
use crate::shape::UNetShape;
use crate::weights::Tensors;

/// Version of the card format.
pub const CARD_FORMAT: &str = "dermis-model-1";
/// Prefix of the tensor names of a first network.
const FIRST: &str = "first.";
/// Maximum size of a card.
const LARGEST_CARD_BYTES: u64 = 1 << 20;
/// Maximum size of a weights file.
const LARGEST_WEIGHTS_BYTES: u64 = 1 << 30;

/// Model card: purpose, training and quality.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModelCard {
    /// [`CARD_FORMAT`].
    pub format: String,
    /// File name of the weights, in the card's folder.
    pub weights: String,
    /// Size of the weights file.
    pub weights_bytes: u64,
    /// SHA-256 of the weights file, hexadecimal.
    pub weights_sha256: String,
    /// Architecture.
    pub shape: UNetShape,
    /// Rows of the images.
    pub rows: usize,
    /// Columns of the images.
    pub columns: usize,
    /// Name of the skin.
    pub skin: String,
    /// Fingerprint of the skin's geometry, protocol and imaging.
    pub skin_sha256: String,
    /// Kinds of the input images, in order.
    pub inputs: Vec<String>,
    /// Factors applied to the input images.
    pub input_scale: Vec<f32>,
    /// Names of the classes, in the order of the labels.
    pub classes: Vec<String>,
    /// Divisor of the logits.
    pub temperature: f32,
    /// Card of the network that runs first, whose tensor names begin with `first.`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub first: Option<FirstCard>,
    /// Training record.
    pub training: TrainingRecord,
}

/// Description of a first network, taken from its own card.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FirstCard {
    /// Architecture.
    pub shape: UNetShape,
    /// Kinds of the input images, in order.
    pub inputs: Vec<String>,
    /// Factors applied to the input images.
    pub input_scale: Vec<f32>,
    /// Divisor of the logits.
    pub temperature: f32,
    /// SHA-256 of its weights in the separate file written by its training.
    pub weights_sha256: String,
}

/// Training of a model, and its metrics on held-out frames.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrainingRecord {
    /// The command, as typed.
    pub command: String,
    /// Seed of the initial weights and of the sample order.
    pub seed: u64,
    /// SHA-256 of the training set's manifest.
    pub data_sha256: String,
    /// Number of samples for training and held out.
    pub samples: [usize; 2],
    /// Number of passes over the samples.
    pub epochs: usize,
    /// The pass that gave the weights.
    pub best_epoch: usize,
    /// Adam's learning rate.
    pub learning_rate: f64,
    /// Batch size.
    pub batch: usize,
    /// Total training time over all runs.
    pub duration_s: f64,
    /// Mean cross-entropy on held-out frames.
    pub held_out_loss: f64,
    /// Intersection over union of each class on held-out frames; `null` for a class that does not occur.
    pub held_out_iou: Vec<Option<f64>>,
    /// Expected calibration error on held-out frames that were not used to fit the temperature.
    pub calibration_error: f64,
}

/// A model, either read from disk or about to be written.
#[derive(Clone, Debug, PartialEq)]
pub struct Model {
    /// The card.
    pub card: ModelCard,
    /// Weights and novelty score.
    pub tensors: Tensors,
    file: PathBuf,
}

impl Model {
    /// Combines card and weights. [`Model::save`] fills in their size and hash.
    pub fn new(card: ModelCard, tensors: Tensors) -> Self {
        let file = PathBuf::from(&card.weights);
        Self { card, tensors, file }
    }

    /// Reads a model card and the weights that it names.
    ///
    /// # Errors
    /// Fails if a file cannot be read, if the card has unknown keys or invalid values, or if the weights differ from
    /// the card in size, hash or architecture, or contain values that are not finite.
    pub fn load(card_file: &Path) -> Result<Self, LearnError> {
        let content = read_bounded(card_file, LARGEST_CARD_BYTES)?;
        let card: ModelCard = serde_json::from_slice(&content)
            .map_err(|error| LearnError::content(card_file, "model card", error.to_string()))?;
        check_card(&card, card_file)?;
        let file = card_file.with_file_name(&card.weights);
        let bytes = read_bounded(&file, LARGEST_WEIGHTS_BYTES)?;
        Self::from_parts(card, &bytes, &file, card_file)
    }

    /// As [`Model::load`], from contents in memory (embedded models).
    ///
    /// # Errors
    /// As [`Model::load`].
    pub fn from_contents(card: &str, weights: &[u8], name: &str) -> Result<Self, LearnError> {
        let file = Path::new(name);
        let card: ModelCard =
            serde_json::from_str(card).map_err(|error| LearnError::content(file, "model card", error.to_string()))?;
        check_card(&card, file)?;
        let weights_file = PathBuf::from(&card.weights);
        Self::from_parts(card, weights, &weights_file, file)
    }

    fn from_parts(card: ModelCard, bytes: &[u8], file: &Path, card_file: &Path) -> Result<Self, LearnError> {
        if bytes.len() as u64 != card.weights_bytes {
            let reason = format!("expected {} bytes, found {}", card.weights_bytes, bytes.len());
            return Err(LearnError::content(file, "size", reason));
        }
        let found = sha256(bytes);
        if found != card.weights_sha256 {
            let reason = format!("expected SHA-256 {}, found {found}: changed since it was made", card.weights_sha256);
            return Err(LearnError::content(file, "content", reason));
        }
        let tensors = Tensors::from_bytes(bytes, file)?;
        tensors.check(&card.shape, file)?;
        let model = Self { card, tensors, file: card_file.to_path_buf() };
        if let Some(first) = model.first()? {
            first.tensors.check(&first.card.shape, file)?;
        }
        Ok(model)
    }

    /// Puts another model in front of this one, which then receives its output as an input.
    ///
    /// # Errors
    /// Fails if the first model has a first model itself.
    pub fn set_first(&mut self, first: &Model) -> Result<(), LearnError> {
        let card = &first.card;
        if card.first.is_some() {
            return Err(LearnError::content(&first.file, "first", "expected a model without a first one of its own"));
        }
        for spec in card.shape.tensors() {
            if let Some((dims, values)) = first.tensors.get(&spec.name) {
                self.tensors.insert(format!("{FIRST}{}", spec.name), dims.to_vec(), values.to_vec())?;
            }
        }
        self.card.first = Some(FirstCard {
            shape: card.shape,
            inputs: card.inputs.clone(),
            input_scale: card.input_scale.clone(),
            temperature: card.temperature,
            weights_sha256: card.weights_sha256.clone(),
        });
        Ok(())
    }

    /// The first model, for the same skin and image size; it has no novelty score.
    ///
    /// # Errors
    /// Never for models read from disk, where tensors of the wrong size are reported earlier.
    pub fn first(&self) -> Result<Option<Model>, LearnError> {
        let Some(first) = &self.card.first else { return Ok(None) };
        let mut tensors = Tensors::default();
        for (name, dims, values) in self.tensors.iter() {
            if let Some(name) = name.strip_prefix(FIRST) {
                tensors.insert(name, dims.to_vec(), values.to_vec())?;
            }
        }
        let card = ModelCard {
            shape: first.shape,
            inputs: first.inputs.clone(),
            input_scale: first.input_scale.clone(),
            temperature: first.temperature,
            weights_sha256: first.weights_sha256.clone(),
            first: None,
            ..self.card.clone()
        };
        check_card(&card, &self.file)?;
        Ok(Some(Self { card, tensors, file: self.file.clone() }))
    }

    /// Writes weights and card, both atomically. The weights go next to the card, under its name with the extension
    /// `safetensors`.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn save(&mut self, card_file: &Path) -> Result<(), LearnError> {
        let bytes = self.tensors.to_bytes()?;
        let weights_file = card_file.with_extension("safetensors");
        let name = weights_file.file_name().and_then(|name| name.to_str());
        let Some(name) = name else {
            return Err(LearnError::content(card_file, "name", "expected a file name in UTF-8"));
        };
        self.card.weights = name.to_string();
        self.card.weights_bytes = bytes.len() as u64;
        self.card.weights_sha256 = sha256(&bytes);
        check_card(&self.card, card_file)?;
        let card = serde_json::to_vec_pretty(&self.card)
            .map_err(|error| LearnError::content(card_file, "model card", error.to_string()))?;
        write_whole(&weights_file, &bytes)?;
        write_whole(card_file, &card)?;
        self.file = card_file.to_path_buf();
        Ok(())
    }

    /// Refuses a skin other than the model's own.
    ///
    /// # Errors
    /// [`LearnError::OtherSkin`].
    pub fn check_skin(&self, name: &str, fingerprint: &str) -> Result<(), LearnError> {
        if self.card.skin_sha256 == fingerprint {
            return Ok(());
        }
        let short = |print: &str| print.chars().take(8).collect::<String>();
        Err(LearnError::OtherSkin {
            file: self.file.clone(),
            model: self.card.skin.clone(),
            model_print: short(&self.card.skin_sha256),
            skin: name.to_string(),
            skin_print: short(fingerprint),
        })
    }

    /// The network, ready to run.
    ///
    /// # Errors
    /// As [`Network::new`].
    pub fn network(&self) -> Result<Network, LearnError> {
        Network::new(self.card.shape, &self.tensors, self.card.rows, self.card.columns)
    }

    /// The novelty score, if the model has one.
    pub fn novelty(&self) -> Option<Novelty> {
        let shape = &self.card.shape;
        Novelty::load(&self.tensors, shape.channels(shape.levels - 1))
    }
}

fn check_card(card: &ModelCard, file: &Path) -> Result<(), LearnError> {
    let refuse = |field: &str, reason: String| Err(LearnError::content(file, field, reason));
    if card.format != CARD_FORMAT {
        return refuse("format", format!("expected {CARD_FORMAT:?}, found {:?}", card.format));
    }
    let plain = Path::new(&card.weights).file_name().is_some_and(|name| name == card.weights.as_str());
    if !plain {
        return refuse("weights", format!("expected a file name without folders, found {:?}", card.weights));
    }
    card.shape.check()?;
    card.shape.check_image(card.rows, card.columns)?;
    for (field, expected, got) in [
        ("classes", card.shape.classes, card.classes.len()),
        ("inputs", card.shape.inputs, card.inputs.len()),
        ("input_scale", card.shape.inputs, card.input_scale.len()),
    ] {
        if expected != got {
            return refuse(field, format!("expected {expected} entries, found {got}"));
        }
    }
    if let Some(scale) = card.input_scale.iter().find(|scale| !(scale.is_finite() && **scale > 0.0)) {
        return refuse("input_scale", format!("{scale} is not positive and finite"));
    }
    if !(card.temperature.is_finite() && card.temperature > 0.0) {
        return refuse("temperature", format!("{} is not positive and finite", card.temperature));
    }
    Ok(())
}

/// Hexadecimal SHA-256.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Reads a regular file of at most `most` bytes.
pub(crate) fn read_bounded(file: &Path, most: u64) -> Result<Vec<u8>, LearnError> {
    let found = fs::metadata(file).map_err(LearnError::io(file))?;
    // A device or a pipe may be endless.
    if !(found.is_file() || found.is_dir()) {
        return Err(LearnError::content(file, "kind", "expected a regular file"));
    }
    let length = found.len();
    if length > most {
        return Err(LearnError::content(file, "size", format!("expected at most {most} bytes, found {length}")));
    }
    fs::read(file).map_err(LearnError::io(file))
}

/// Writes a temporary file next to the target and then renames it, so that readers never see a partial file.
pub(crate) fn write_whole(file: &Path, bytes: &[u8]) -> Result<(), LearnError> {
    let mut name = file.file_name().map(|name| name.to_os_string()).unwrap_or_default();
    name.push(".part");
    let part = file.with_file_name(name);
    let stands = file.exists();
    let failed = |source| LearnError::Io { file: file.to_path_buf(), source };
    fs::write(&part, bytes).map_err(|error| {
        // Remove the partial file; failing to do so changes nothing.
        let _ = fs::remove_file(&part);
        failed(error)
    })?;
    // Replace the old file, but not one that appeared in the meantime.
    let put = if stands { fs::rename(&part, file) } else { rename_new(&part, file) };
    put.map_err(failed)
}

/// Renames a file unless the new name exists, by a hard link if the file system supports them.
fn rename_new(from: &Path, to: &Path) -> std::io::Result<()> {
    use std::io::{Error, ErrorKind};
    match fs::hard_link(from, to) {
        Ok(()) => fs::remove_file(from),
        Err(_) if fs::symlink_metadata(to).is_ok() => {
            let text =
                format!("appeared meanwhile and was not replaced; the finished one stands at {}", from.display());
            Err(Error::new(ErrorKind::AlreadyExists, text))
        }
        Err(_) => fs::rename(from, to),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::network::tests::random_tensors;

    pub(crate) fn some_model() -> Model {
        let shape = UNetShape { inputs: 1, classes: 3, width: 4, levels: 2 };
        let card = ModelCard {
            format: CARD_FORMAT.into(),
            weights: "x".into(),
            weights_bytes: 0,
            weights_sha256: String::new(),
            shape,
            rows: 8,
            columns: 8,
            skin: "healing-square".into(),
            skin_sha256: "0123456789".into(),
            inputs: vec!["first step".into()],
            input_scale: vec![1.0],
            classes: ["background", "damaged", "compressed"].map(String::from).to_vec(),
            temperature: 1.2,
            first: None,
            training: TrainingRecord::default(),
        };
        Model::new(card, random_tensors(&shape, 5))
    }

    #[test]
    fn a_model_is_read_as_it_was_written_and_knows_its_skin() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("m.json");
        let mut model = some_model();
        model.save(&file).unwrap();
        let read = Model::load(&file).unwrap();
        assert_eq!(read, model);
        read.check_skin("healing-square", "0123456789").unwrap();
        let error = read.check_skin("ionic-disc", "abcdefghijkl").unwrap_err().to_string();
        assert!(
            error.ends_with("is for skin healing-square (01234567), not for ionic-disc (abcdefgh); train one for it")
        );
        read.network().unwrap();
        assert!(read.novelty().is_none());
    }

    #[test]
    fn a_first_model_is_stored_in_the_same_files() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("m.json");
        let (mut model, mut first) = (some_model(), some_model());
        first.tensors.insert("head.bias", vec![3], vec![0.5, 0.25, 0.125]).unwrap();
        first.card.temperature = 0.9;
        first.save(&folder.path().join("first.json")).unwrap();
        model.set_first(&first).unwrap();
        model.save(&file).unwrap();
        let read = Model::load(&file).unwrap();
        let found = read.first().unwrap().unwrap();
        assert_eq!(found.tensors, first.tensors);
        assert_eq!((found.card.temperature, found.card.first), (0.9, None));
        assert_eq!(read.card.first.as_ref().unwrap().weights_sha256, first.card.weights_sha256);
        assert_eq!(first.first().unwrap(), None);
        // The card's entry about the first model is checked as well.
        model.card.first.as_mut().unwrap().shape.width = 5;
        model.save(&file).unwrap();
        assert!(Model::load(&file).unwrap_err().to_string().contains("down.0.conv1.weight: expected [5, 1, 3, 3]"));
    }

    #[test]
    fn changed_cut_and_foreign_files_are_refused_before_they_are_parsed() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("m.json");
        some_model().save(&file).unwrap();
        let weights = folder.path().join("m.safetensors");
        let whole = fs::read(&weights).unwrap();
        let message = || Model::load(&file).unwrap_err().to_string();

        fs::write(&weights, &whole[..100]).unwrap();
        assert!(message().contains(&format!("size: expected {} bytes, found 100", whole.len())), "{}", message());
        let mut changed = whole.clone();
        *changed.last_mut().unwrap() ^= 1;
        fs::write(&weights, &changed).unwrap();
        assert!(message().contains("content: expected SHA-256"), "{}", message());
        fs::remove_file(&weights).unwrap();
        assert!(matches!(Model::load(&file), Err(LearnError::Io { .. })));
        fs::write(&weights, &whole).unwrap();

        let card = fs::read_to_string(&file).unwrap();
        for (from, to, expected) in [
            ("dermis-model-1", "dermis-model-9", "format: expected \"dermis-model-1\""),
            ("m.safetensors", "../m.safetensors", "weights: expected a file name without folders"),
            ("\"width\": 4", "\"width\": 5", "down.0.conv1.weight: expected [5, 1, 3, 3]"),
            ("\"temperature\": 1.2", "\"temperature\": -1.0", "temperature: -1 is not positive"),
            ("\"rows\": 8", "\"rows\": 7", "rows of the images = 7: expected a multiple of 2"),
            ("\"skin\":", "\"colour\": 1, \"skin\":", "unknown field `colour`"),
        ] {
            assert!(card.contains(from), "{from}");
            fs::write(&file, card.replace(from, to)).unwrap();
            assert!(message().contains(expected), "{} / {expected}", message());
        }
        // A truncated card is rejected, wherever it was cut.
        for length in (0..card.len()).step_by(37) {
            fs::write(&file, &card[..length]).unwrap();
            assert!(message().contains("model card"), "{length}");
        }
    }
}
