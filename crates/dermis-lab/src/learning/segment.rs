//! Recorded frames to labels, offline: what `dermis segment` does. With a model, the network's probabilities decide; a
//! frame unlike those that it was trained on, and every frame where there is no model, is labelled by thresholds on its
//! image.

use dermis_live::imager::Imager;
use dermis_live::imager::Refiner;
use std::path::PathBuf;

use dermis_device::instruments::npy;
use dermis_device::{FileSpec, FrameTable, ReadOptions};
use dermis_learn::Model;
use dermis_tomo::mesh::{INSIDE_COVERAGE, PixelGrid, PixelMap};

use crate::Error;
use dermis_live::channels::ChannelReader;
use dermis_live::network::Classifier;
use dermis_live::network::UNLIKE;
use dermis_live::network::{MaskRule, PRESENCE, enlarge, masks_of_image};
use dermis_live::network::{built_in, suits};
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::Skin;

/// What to segment and where to put it.
#[derive(Clone, Debug)]
pub struct SegmentRequest {
    /// The skin.
    pub skin: Skin,
    /// Frames of the untouched skin, which are averaged; missing channels are NaN.
    pub reference: FileSpec,
    /// The frames; missing channels are NaN.
    pub frames: FileSpec,
    /// How both files are read.
    pub read: ReadOptions,
    /// Which network labels the frames.
    pub network: NetworkChoice,
    /// Pixels along the longer side of the label images.
    pub size: usize,
    /// Where the labels go: NPY, u8, rows x columns (frames x rows x columns for several frames), row 0 at the top.
    pub labels: Option<PathBuf>,
    /// Where the probabilities go: NPY, f32, frames x classes x rows x columns; needs a network.
    pub probabilities: Option<PathBuf>,
}

/// Which network labels frames.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NetworkChoice {
    /// The one that ships with the skin, if one does and nothing that images depend on was changed; else none.
    Shipped,
    /// A model card made by `dermis train`.
    File(PathBuf),
    /// None: thresholds alone.
    None,
}

impl NetworkChoice {
    fn open(&self, skin: &Skin) -> Result<Option<Model>, Error> {
        Ok(match self {
            Self::Shipped => built_in(&skin.name)?.filter(|model| suits(model, skin)),
            Self::File(path) => Some(Model::load(path)?),
            Self::None => None,
        })
    }
}

/// How a frame was labelled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// By the network; its novelty score, where the model has one, was at most 1.
    Network {
        /// The score.
        novelty: Option<f32>,
    },
    /// By thresholds, since the novelty score was above [`UNLIKE`].
    UnlikeTraining {
        /// The score.
        novelty: f32,
    },
    /// By thresholds, since there is no model.
    Thresholds,
}

/// One labelled frame.
#[derive(Clone, Debug)]
pub struct Segmented {
    /// Classes of the pixels, row 0 at the top, 0 outside the skin.
    pub labels: Vec<u8>,
    /// Classes x pixels; of frames that a network labelled, where they are kept.
    pub probabilities: Option<Vec<f32>>,
    /// How.
    pub method: Method,
}

/// More pixels a side than this are a typing error.
const MOST_PIXELS: usize = 4096;

/// Labels all frames and writes what was asked for; `progress` is told how many of how many steps are done.
///
/// # Errors
/// Files that cannot be read or do not fit the skin, a model of another skin or damaged, outputs that cannot be
/// written.
pub fn segment(request: &SegmentRequest, progress: impl FnMut(usize, usize)) -> Result<Vec<Segmented>, Error> {
    let refuse = |what: &str, expected: &str, got: String| {
        Err(Error::Frames { what: what.into(), expected: expected.into(), got })
    };
    if !(8..=MOST_PIXELS).contains(&request.size) {
        return refuse("size of the labels", "8 to 4096 pixels", request.size.to_string());
    }
    let model = request.network.open(&request.skin)?;
    if request.probabilities.is_some() && model.is_none() {
        return refuse("probabilities", "a network, which gives them", "none for this skin".into());
    }
    let read = |file| dermis_record::read_frames_of(&request.skin, file, request.read.clone());
    let (references, frames) = (read(&request.reference)?, read(&request.frames)?);
    let prepared = Prepared::new(request.skin.clone())?;
    let reads = prepared.skin.backend.reads;
    let reader = |table: &FrameTable| {
        ChannelReader::new(table.layout(), &prepared.protocol, reads, &table.source().display().to_string())
    };
    let mut reference_reader = reader(&references)?;
    let references = reference_reader.read_table(&references)?;
    let mut frame_reader = reader(&frames)?;
    frame_reader.share_phase_of(&reference_reader);
    let frames = frame_reader.read_table(&frames)?;
    let reference = Reference::of(&prepared, &references)?;
    let differences: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
    let mut segmenter = Segmenter::new(&prepared, &reference, model.as_ref(), request.size)?;
    if request.probabilities.is_some() {
        segmenter.keep_probabilities();
    }
    let segmented = segmenter.label(&differences, progress)?;
    write(request, segmenter.label_size(), &segmented)?;
    Ok(segmented)
}

fn write(request: &SegmentRequest, [rows, columns]: [usize; 2], frames: &[Segmented]) -> Result<(), Error> {
    if let Some(path) = &request.labels {
        let labels: Vec<u8> = frames.iter().flat_map(|frame| frame.labels.iter().copied()).collect();
        let shape: &[usize] = if frames.len() == 1 { &[rows, columns] } else { &[frames.len(), rows, columns] };
        npy::write_u8(path, shape, &labels)?;
    }
    if let Some(path) = &request.probabilities {
        let classes = dermis_live::network::CLASSES.len();
        let absent = || vec![f32::NAN; classes * rows * columns];
        let values: Vec<f32> =
            frames.iter().flat_map(|frame| frame.probabilities.clone().unwrap_or_else(absent)).collect();
        npy::write_f32(path, &[frames.len(), classes, rows, columns], &values)?;
    }
    Ok(())
}

/// Labels difference frames of one skin against one reference.
pub struct Segmenter<'a> {
    prepared: &'a Prepared,
    reference: &'a Reference,
    network: Option<Classifier>,
    label_size: [usize; 2],
    outside: Vec<bool>,
    keeps_probabilities: bool,
}

impl<'a> Segmenter<'a> {
    /// Prepares operators and network.
    ///
    /// # Errors
    /// A model of another skin, or whose inputs are not known here.
    pub fn new(
        prepared: &'a Prepared,
        reference: &'a Reference,
        model: Option<&Model>,
        size: usize,
    ) -> Result<Self, Error> {
        let network = model.map(|model| Classifier::with_reference(prepared, reference, model)).transpose()?;
        let (low, high) = prepared.body.outline.bounds_m();
        let named = |source| Error::Mesh { skin: prepared.skin.name.clone(), source };
        let grid = PixelGrid::covering(low, high, size).map_err(named)?;
        let label_size = [grid.rows, grid.columns];
        let map = PixelMap::new(grid, &prepared.body.mesh.mesh).map_err(named)?;
        let outside = map.coverage().iter().map(|share| *share < INSIDE_COVERAGE).collect();
        Ok(Self { prepared, reference, network, label_size, outside, keeps_probabilities: false })
    }

    /// Keeps the probabilities of labelled frames, classes x pixels of the labels; they take much more memory than
    /// labels.
    pub fn keep_probabilities(&mut self) {
        self.keeps_probabilities = true;
    }

    /// Rows and columns of the labels.
    pub fn label_size(&self) -> [usize; 2] {
        self.label_size
    }

    /// Labels difference frames (model volts, `NaN` where missing).
    ///
    /// # Errors
    /// Frames of another length, without any channel, or whose forward problem cannot be solved.
    pub fn label(
        &mut self,
        differences: &[Vec<f64>],
        mut progress: impl FnMut(usize, usize),
    ) -> Result<Vec<Segmented>, Error> {
        let mut segmented: Vec<Option<Segmented>> = vec![None; differences.len()];
        let mut fallback = vec![Method::Thresholds; differences.len()];
        if let Some(network) = &mut self.network {
            let (size, mut done) = (network.image_size(), 0);
            let found = network.run_all(differences, |frames| {
                done += frames;
                progress(done, differences.len());
            })?;
            for (frame, (probabilities, novelty)) in found.into_iter().enumerate() {
                match novelty.filter(|novelty| *novelty > UNLIKE) {
                    Some(novelty) => fallback[frame] = Method::UnlikeTraining { novelty },
                    None => segmented[frame] = Some(self.labelled(&probabilities, size, novelty)),
                }
            }
        }
        let left: Vec<usize> = (0..differences.len()).filter(|&frame| segmented[frame].is_none()).collect();
        let rest: Vec<Vec<f64>> = left.iter().map(|&frame| differences[frame].clone()).collect();
        for (&frame, labels) in left.iter().zip(self.by_thresholds(&rest, &mut progress)?) {
            segmented[frame] = Some(Segmented { labels, probabilities: None, method: fallback[frame] });
        }
        Ok(segmented.into_iter().flatten().collect())
    }

    /// The network's probabilities, enlarged, and labels by them.
    fn labelled(&self, small: &[f32], (rows, columns): (usize, usize), novelty: Option<f32>) -> Segmented {
        let classes = dermis_live::network::CLASSES.len();
        let pixels = self.label_size[0] * self.label_size[1];
        let mut probabilities = Vec::with_capacity(classes * pixels);
        for class in small.chunks_exact(rows * columns) {
            probabilities.extend(enlarge(class, [rows, columns], self.label_size, &[]));
        }
        let mut labels = vec![0; pixels];
        PRESENCE.label(&probabilities, &mut labels);
        self.clear_outside(&mut labels);
        let probabilities = self.keeps_probabilities.then_some(probabilities);
        Segmented { labels, probabilities, method: Method::Network { novelty } }
    }

    fn by_thresholds(
        &self,
        differences: &[Vec<f64>],
        progress: &mut impl FnMut(usize, usize),
    ) -> Result<Vec<Vec<u8>>, Error> {
        if differences.is_empty() {
            return Ok(Vec::new());
        }
        let prepared = self.prepared;
        let mut imager = Imager::new(prepared, self.reference, differences)?;
        let grid = prepared.map.grid();
        let (images, rule) = match &prepared.skin.imaging.refinement {
            Some(refinement) => {
                let (mut done, all) = (0, refinement.steps * differences.len());
                let mut refiner = Refiner::new(prepared, refinement, self.reference, imager.hyperparameter())?;
                let images = refiner.images(differences, || {
                    done += 1;
                    progress(done, all);
                })?;
                (images, MaskRule::LOG_CONDUCTIVITY)
            }
            None => {
                let mut images = Vec::with_capacity(differences.len());
                for difference in differences {
                    let mut image = vec![f32::NAN; grid.len()];
                    imager.image(difference, &mut image)?;
                    images.push(image);
                }
                (images, MaskRule::linear(prepared.skin.touch.smallest_amplitude))
            }
        };
        let polarity = prepared.skin.imaging.polarity.sign() as f32;
        let label = |mut image: Vec<f32>| {
            image.iter_mut().for_each(|value| *value *= polarity);
            let large = enlarge(&image, [grid.rows, grid.columns], self.label_size, &self.outside);
            masks_of_image(&large, &rule)
        };
        Ok(images.into_iter().map(label).collect())
    }

    fn clear_outside(&self, labels: &mut [u8]) {
        labels.iter_mut().zip(&self.outside).filter(|(_, outside)| **outside).for_each(|(label, _)| *label = 0);
    }
}
