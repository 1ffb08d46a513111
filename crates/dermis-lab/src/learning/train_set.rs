//! Simulates training sets: random scenes on jittered skins, solved on a mesh other than the reconstruction's,
//! read by an instrument with gain, drift, noise and some lost electrodes, and imaged like live frames. Each shard
//! has its own skin, instrument and set of lost electrodes, and depends only on the seed and its number.

use dermis_live::reference::Reference;
use std::path::Path;

use dermis_learn::scene::{Scene, SceneKind};
use dermis_learn::{Manifest, Model, SET_FORMAT, Shard, TrainingSet};
use dermis_tomo::mesh::{PixelGrid, Point};
use rand::rngs::StdRng;
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rayon::prelude::*;
use serde::Serialize;

use super::model_mismatch::{self, normal};
use super::solver::Solver;
use crate::Error;
use dermis_live::network::{CLASSES, FirstStep, InputImage};
use dermis_live::prepare::Prepared;
use dermis_skin::{Modality, Skin};

pub use super::model_mismatch::Jitter;

/// Which electrodes a shard loses. Their number is always even, and all even numbers are equally likely.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum LostElectrodes {
    /// The first ones in half of the shards, a run that starts anywhere in a quarter, scattered ones in a quarter.
    #[default]
    Mixed,
    /// The first ones.
    First,
}

impl LostElectrodes {
    // Takes a reference because serde requires one.
    fn is_mixed(&self) -> bool {
        *self == Self::Mixed
    }
}

/// Settings of a simulation.
#[derive(Clone, Debug)]
pub struct TrainSetRequest {
    /// The skin.
    pub skin: Skin,
    /// Total number of samples.
    pub samples: usize,
    /// Samples that share one skin, instrument and set of lost electrodes.
    pub shard_samples: usize,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Kind of scenes; chosen by the skin's layer if `None`.
    pub scenes: Option<SceneKind>,
    /// Images to give the network as input.
    pub inputs: Vec<InputImage>,
    /// Largest number of lost electrodes.
    pub most_lost: usize,
    /// Which electrodes are lost.
    pub lost: LostElectrodes,
    /// Deviations of skins and instruments.
    pub jitter: Jitter,
    /// Range of the contrast of objects in a tank: factors on the conductivity or its inverse. `None` uses the
    /// scenes' own range.
    pub contrasts: Option<[f64; 2]>,
    /// First-stage network, for sets whose inputs include its output.
    pub first: Option<Model>,
}

impl TrainSetRequest {
    /// A request with one first-step image as input and all electrodes present.
    pub fn new(skin: Skin, samples: usize) -> Self {
        Self {
            skin,
            samples,
            shard_samples: 250,
            seed: 1,
            scenes: None,
            inputs: vec![InputImage::Step(1.0)],
            most_lost: 0,
            lost: LostElectrodes::Mixed,
            jitter: Jitter::default(),
            contrasts: None,
            first: None,
        }
    }

    fn scenes(&self) -> SceneKind {
        let tank = self.skin.frontend.layer.is_open_tank();
        self.scenes.unwrap_or(if tank { SceneKind::Objects } else { SceneKind::TouchesAndCuts })
    }

    fn check(&self) -> Result<(), Error> {
        let refuse = |what: &str, expected: &str, got: String| {
            Err(Error::Live(dermis_live::Error::Frames { what: what.into(), expected: expected.into(), got }))
        };
        if self.skin.modality != Modality::Eit || self.skin.backend.circuit.is_some() {
            return refuse("skin of a training set", "an EIT skin without readout circuit", self.skin.name.clone());
        }
        let electrodes = self.skin.electrode_shapes().len();
        if self.most_lost > electrodes / 2 {
            let expected = format!("at most half of {electrodes}");
            return refuse("electrodes lost", &expected, self.most_lost.to_string());
        }
        if self.inputs.is_empty() {
            return refuse("input images", "at least one", "none".into());
        }
        if let Some(contrasts) = self.contrasts {
            let [least, largest] = contrasts;
            if !(least > 1.0 && largest >= least && largest.is_finite()) {
                return refuse("contrasts", "two factors above 1, the smaller first", format!("{contrasts:?}"));
            }
        }
        Ok(())
    }

    /// The manifest of this set, for images on the given grid.
    ///
    /// # Errors
    /// The request is invalid.
    pub fn checked_manifest(&self, grid: &PixelGrid) -> Result<Manifest, Error> {
        self.check()?;
        Ok(self.manifest(grid))
    }

    fn manifest(&self, grid: &PixelGrid) -> Manifest {
        #[derive(Serialize)]
        struct Recipe {
            scenes: SceneKind,
            most_lost_electrodes: usize,
            #[serde(skip_serializing_if = "LostElectrodes::is_mixed")]
            lost_electrodes: LostElectrodes,
            jitter: Jitter,
            #[serde(skip_serializing_if = "Option::is_none")]
            contrasts: Option<[f64; 2]>,
            #[serde(skip_serializing_if = "Option::is_none")]
            first_sha256: Option<String>,
        }
        let recipe = Recipe {
            scenes: self.scenes(),
            most_lost_electrodes: self.most_lost,
            lost_electrodes: self.lost,
            jitter: self.jitter,
            contrasts: self.contrasts,
            first_sha256: self.first.as_ref().map(|first| first.card.weights_sha256.clone()),
        };
        Manifest {
            format: SET_FORMAT.into(),
            skin: self.skin.name.clone(),
            skin_sha256: dermis_live::network::imaging_sha256(&self.skin),
            seed: self.seed,
            samples: self.samples,
            shard_samples: self.shard_samples,
            inputs: self.inputs.iter().map(ToString::to_string).collect(),
            rows: grid.rows,
            columns: grid.columns,
            classes: CLASSES.map(String::from).to_vec(),
            recipe: serde_json::to_value(recipe).unwrap_or_default(),
        }
    }
}

/// Simulates a training set into a folder, or completes one. `progress` gets the number of samples done and the
/// total.
///
/// # Errors
/// The request is invalid, the folder holds another set or cannot be written, or a forward problem cannot be solved.
/// Complete shards stay.
pub fn simulate(
    request: &TrainSetRequest,
    folder: &Path,
    mut progress: impl FnMut(usize, usize),
) -> Result<TrainingSet, Error> {
    request.check()?;
    let prepared = Prepared::new(request.skin.clone())?;
    let set = TrainingSet::create(folder, request.manifest(prepared.map.grid()))?;
    let missing = set.missing();
    let lacking: usize = missing.iter().map(|&shard| set.manifest().samples_of(shard)).sum();
    let mut done = request.samples - lacking;
    progress(done, request.samples);
    if missing.is_empty() {
        return Ok(set);
    }
    let mut simulator = Simulator::new(request, &prepared)?;
    for number in missing {
        let samples = set.manifest().samples_of(number);
        set.write(number, &simulator.shard(number, samples)?)?;
        done += samples;
        progress(done, request.samples);
    }
    Ok(set)
}

/// Simulates shards of a training set.
#[derive(Debug)]
pub struct Simulator<'a> {
    request: &'a TrainSetRequest,
    prepared: &'a Prepared,
    first_step: FirstStep,
}

impl<'a> Simulator<'a> {
    /// Prepares the operators.
    ///
    /// # Errors
    /// As for [`FirstStep::with_first`].
    pub fn new(request: &'a TrainSetRequest, prepared: &'a Prepared) -> Result<Self, Error> {
        let reference = Reference::of(prepared, std::slice::from_ref(&prepared.voltages))?;
        let first_step = FirstStep::with_first(prepared, &reference, &request.inputs, request.first.as_ref())?;
        Ok(Self { request, prepared, first_step })
    }

    /// Simulates one shard.
    ///
    /// # Errors
    /// A forward problem cannot be solved.
    pub fn shard(&mut self, number: usize, samples: usize) -> Result<Shard, Error> {
        let frames = SimulatedFrames::new(self.request, self.prepared, number, samples)?;
        let reference = Reference::of(self.prepared, std::slice::from_ref(&frames.baseline))?;
        let differences: Vec<Vec<f64>> = frames.frames.iter().map(|frame| reference.difference(frame, None)).collect();
        let mut shard = Shard::default();
        self.first_step.images_of_all(&differences, &mut shard.inputs)?;
        shard.labels = frames.labels.concat();
        Ok(shard)
    }
}

/// Frames that an instrument on a jittered skin would read, with the ground truth.
#[derive(Clone, Debug)]
pub struct SimulatedFrames {
    /// The untouched skin, volts, channels in the protocol's order; `NaN` at lost electrodes.
    pub baseline: Vec<f64>,
    /// One frame per scene.
    pub frames: Vec<Vec<f64>>,
    /// The scenes themselves.
    pub scenes: Vec<Scene>,
    /// Class of each pixel of the image grid.
    pub labels: Vec<Vec<u8>>,
}

impl SimulatedFrames {
    /// Simulates the frames of one shard; the scenes are solved in parallel.
    ///
    /// # Errors
    /// A jittered skin cannot be meshed or solved.
    pub fn new(request: &TrainSetRequest, prepared: &Prepared, number: usize, samples: usize) -> Result<Self, Error> {
        let mut random = StdRng::seed_from_u64(mixed(request.seed, number as u64));
        let body = model_mismatch::body(&request.skin, &request.jitter, &mut random)?;
        let instrument = Instrument::draw(request, prepared, &mut random);
        let mut solver = Solver::new(&request.skin, &body.mesh, &prepared.protocol)?;
        let rest = solver.voltages(&Scene::default(), &mut random)?;
        let baseline = instrument.read(&rest, false, &mut random);
        let seeds: Vec<u64> = (0..samples).map(|_| random.random()).collect();
        let grid = prepared.map.grid();
        let inside = prepared.map.inside_mask();
        let on_skin = |p: Point| grid.pixel_at(p).is_some_and(|pixel| inside[pixel]);
        let finest_m = grid.pixel_m.max(body.mesh.mesh.element_size_m());
        let size_m = prepared.half_width_m();
        let one = |solver: &mut Solver, seed: u64| {
            let mut random = StdRng::seed_from_u64(seed);
            let mut scene = Scene::draw(request.scenes(), size_m, finest_m, &on_skin, &mut random);
            if let Some(contrasts) = request.contrasts {
                scene.spread_contrasts(contrasts);
            }
            let voltages = solver.voltages(&scene, &mut random)?;
            let frame = instrument.read(&voltages, true, &mut random);
            let lookup = scene.lookup();
            let label = |pixel: usize| if inside[pixel] { lookup.at(grid.centre_m(pixel)).0 } else { 0 };
            let labels = (0..grid.len()).map(label).collect();
            Ok((frame, scene, labels))
        };
        // Every thread has its own solver; a scene depends only on its seed.
        let share = samples.div_ceil(rayon::current_num_threads()).max(1);
        let of_thread = |seeds: &[u64]| {
            let mut solver = Solver::new(&request.skin, &body.mesh, &prepared.protocol)?;
            seeds.iter().map(|&seed| one(&mut solver, seed)).collect::<Result<Vec<_>, Error>>()
        };
        let solved: Vec<Vec<Solved>> = seeds.par_chunks(share).map(of_thread).collect::<Result<_, Error>>()?;
        let mut all = Self { baseline, frames: Vec::new(), scenes: Vec::new(), labels: Vec::new() };
        for (frame, scene, labels) in solved.into_iter().flatten() {
            all.frames.push(frame);
            all.scenes.push(scene);
            all.labels.push(labels);
        }
        Ok(all)
    }
}

/// Frame, scene and labels.
type Solved = (Vec<f64>, Scene, Vec<u8>);

/// A separate seed for each shard (the finaliser of SplitMix64).
fn mixed(seed: u64, number: u64) -> u64 {
    let mut z = seed.wrapping_add((number + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Gain, drift, noise and lost electrodes.
struct Instrument {
    gain: Vec<f64>,
    drift: Vec<f64>,
    stimulation: Vec<usize>,
    lost: Vec<bool>,
    noise_share: f64,
    background: f64,
}

impl Instrument {
    fn draw(request: &TrainSetRequest, prepared: &Prepared, random: &mut StdRng) -> Self {
        let protocol = &prepared.protocol;
        let drives = protocol.stimulations().len();
        let common = 1.0 + normal(request.jitter.gain, random);
        let per_drive = request.skin.imaging.gain == dermis_skin::GainMatch::Drive;
        let own = |random: &mut StdRng| if per_drive { 1.0 + normal(request.jitter.gain, random) } else { 1.0 };
        let gain = (0..drives).map(|_| common * own(random)).collect();
        let drift = (0..drives).map(|_| 1.0 + normal(request.jitter.drift, random)).collect();
        let gone = lost_electrodes(request.lost, protocol.electrode_count(), request.most_lost, random);
        let lost = (0..protocol.channel_count())
            .map(|channel| gone.iter().any(|&electrode| protocol.channel_touches(channel, electrode)))
            .collect();
        let stimulation = protocol.measurements().iter().map(|m| m.stimulation as usize).collect();
        let noise_share = 10_f64.powf(-request.jitter.noise_db / 20.0);
        Self { gain, drift, stimulation, lost, noise_share, background: request.jitter.background }
    }

    fn read(&self, voltages: &[f64], drifted: bool, random: &mut StdRng) -> Vec<f64> {
        let square: f64 = voltages.iter().map(|v| v * v).sum::<f64>() / voltages.len().max(1) as f64;
        // The baseline is a mean of many frames.
        let noise = self.noise_share * square.sqrt() * if drifted { 1.0 } else { 0.2 };
        // Draw no number if the background stays fixed, to keep the sequence of the others.
        let strays = drifted && self.background > 0.0;
        let background = if strays { normal(self.background, random).exp() } else { 1.0 };
        voltages
            .iter()
            .enumerate()
            .map(|(channel, voltage)| {
                let drive = self.stimulation[channel];
                let gain = self.gain[drive] * if drifted { self.drift[drive] } else { 1.0 };
                let value = gain * voltage / background + normal(noise, random);
                if self.lost[channel] { f64::NAN } else { value }
            })
            .collect()
    }
}

/// A random even number of electrodes up to `most`, or exactly `most`.
fn lost_electrodes(which: LostElectrodes, electrodes: usize, most: usize, random: &mut StdRng) -> Vec<u32> {
    if most == 0 {
        return Vec::new();
    }
    let count = (random.random_range(0..=most.div_ceil(2)) * 2).min(most) as u32;
    let electrodes = electrodes as u32;
    let kind = if which == LostElectrodes::First { 0 } else { random.random_range(0..4) };
    match kind {
        0 | 1 => (0..count).collect(),
        2 => {
            let start = random.random_range(0..electrodes);
            (0..count).map(|k| (start + k) % electrodes).collect()
        }
        _ => {
            let mut all: Vec<u32> = (0..electrodes).collect();
            all.shuffle(random);
            all.truncate(count as usize);
            all
        }
    }
}
