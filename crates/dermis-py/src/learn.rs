//! Training sets made shard by shard, and checks of networks trained elsewhere.

use std::path::{Path, PathBuf};

use dermis_lab::learning::train_set::{Simulator, TrainSetRequest};
use dermis_learn::{Model, TrainingSet};
use dermis_live::prepare::Prepared;
use pyo3::prelude::*;

use crate::arrays::{Array1, Array3, Doubles, array1, array3, shape_text};
use crate::errors::Fault;
use crate::hints::ArrayLike;
use crate::skin::skin_of;
use crate::skin_argument::SkinLike;
use crate::work::{run, run_interruptibly};

/// Maximum number of samples in a shard, since shards are made in memory.
const MOST_SHARD_SAMPLES: usize = 10_000;
/// Maximum number of shards; each is a file in one folder.
const MOST_SHARDS: usize = 1_000_000;

fn request_of(skin: &Bound<'_, PyAny>, samples: usize, shard_samples: usize, seed: u64) -> PyResult<TrainSetRequest> {
    if samples == 0 || shard_samples == 0 {
        return Err(Fault::input(
            "samples",
            "1 or more, in shards of 1 or more",
            format!("{samples}, {shard_samples}"),
        )
        .into());
    }
    if shard_samples > MOST_SHARD_SAMPLES || samples.div_ceil(shard_samples) > MOST_SHARDS {
        let expected = format!("shards of at most {MOST_SHARD_SAMPLES} samples, and at most {MOST_SHARDS} of them");
        return Err(Fault::input("samples", expected, format!("{samples} in shards of {shard_samples}")).into());
    }
    let mut request = TrainSetRequest::new(skin_of(skin)?, samples);
    (request.shard_samples, request.seed) = (shard_samples, seed);
    Ok(request)
}

/// The prepared skin of a training set, and the set in its folder, new or existing.
fn set_of(request: &TrainSetRequest, folder: &Path) -> Result<(Prepared, TrainingSet), Fault> {
    let prepared = Prepared::new(request.skin.clone())?;
    let set = TrainingSet::create(folder, request.checked_manifest(prepared.map.grid())?)?;
    Ok((prepared, set))
}

/// Creates or opens the folder of a training set, and returns the numbers of the missing shards.
#[pyfunction]
#[pyo3(signature = (skin, folder, samples, *, shard_samples=250, seed=1))]
pub fn create_train_set(
    py: Python<'_>,
    skin: SkinLike<'_>,
    folder: PathBuf,
    samples: usize,
    shard_samples: usize,
    seed: u64,
) -> PyResult<Vec<usize>> {
    let request = request_of(&skin, samples, shard_samples, seed)?;
    run_interruptibly(py, "training set", move || Ok(set_of(&request, &folder)?.1.missing()))
}

/// Simulates one shard of a training set into its folder. A shard depends only on the seed and its number, and
/// appears under its name only when complete.
#[pyfunction]
#[pyo3(signature = (skin, folder, shard, samples, *, shard_samples=250, seed=1))]
pub fn write_shard(
    py: Python<'_>,
    skin: SkinLike<'_>,
    folder: PathBuf,
    shard: usize,
    samples: usize,
    shard_samples: usize,
    seed: u64,
) -> PyResult<usize> {
    let request = request_of(&skin, samples, shard_samples, seed)?;
    run_interruptibly(py, "shard", move || {
        let (prepared, set) = set_of(&request, &folder)?;
        if shard >= set.manifest().shards() {
            return Err(Fault::input("shard", format!("0 to {}", set.manifest().shards().saturating_sub(1)), shard));
        }
        if !set.missing().contains(&shard) {
            return Ok(0);
        }
        let count = set.manifest().samples_of(shard);
        set.write(shard, &Simulator::new(&request, &prepared)?.shard(shard, count)?)?;
        Ok(count)
    })
}

/// A network that classifies pixels.
#[pyclass(frozen, module = "dermis", name = "Network")]
pub struct PyNetwork {
    model: Model,
}

#[pymethods]
impl PyNetwork {
    /// Reads a model card and its weights.
    #[staticmethod]
    fn load(path: PathBuf) -> PyResult<Self> {
        Ok(Self { model: Model::load(&path).map_err(Fault::from)? })
    }

    /// Name of the skin.
    #[getter]
    fn skin(&self) -> &str {
        &self.model.card.skin
    }

    /// Names of the classes.
    #[getter]
    fn classes(&self) -> Vec<String> {
        self.model.card.classes.clone()
    }

    /// Factors for the input images, shape (inputs,).
    #[getter]
    fn input_scale<'py>(&self, py: Python<'py>) -> Array1<'py, f32> {
        array1(py, self.model.card.input_scale.clone())
    }

    /// Probabilities of the classes.
    ///
    /// Parameters
    /// ----------
    /// images : array_like
    ///     Shape (inputs, rows, columns), already multiplied by ``input_scale``.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (classes, rows, columns), float32.
    fn probabilities<'py>(&self, py: Python<'py>, images: ArrayLike<'py>) -> PyResult<Array3<'py, f32>> {
        let card = &self.model.card;
        let expected = [card.shape.inputs, card.rows, card.columns];
        let images = Doubles::of("images", &images)?.finite("images")?;
        if images.shape() != expected {
            return Err(Fault::input("images", shape_text(&expected), shape_text(images.shape())).into());
        }
        let values: Vec<f32> = images.values()?.iter().map(|value| *value as f32).collect();
        let probabilities = run(py, || {
            let mut network = self.model.network()?;
            let mut out = vec![0.0; card.shape.classes * card.rows * card.columns];
            network.probabilities(&values, card.temperature, &mut out)?;
            Ok(out)
        })?;
        array3(py, probabilities, [card.shape.classes, card.rows, card.columns])
    }
}
