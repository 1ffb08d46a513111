//! One sample on the bench: baseline, presses, images and touches, all by the model of the skin file, as the running skin does
//! it. What does not depend on the sample is made once.

use std::sync::{Mutex, PoisonError};

use dermis_live::calibration::{CalibratedImager, Calibration, Pokes};
use dermis_live::imager::{Imager, operator_needs_no_baseline};
use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::reference::Reference;
use dermis_live::stages::refinement::Refinement;
use dermis_skin::{Skin, WeightChoice};
use dermis_touch::Observation;
use dermis_twin::instrument::{Instrument, InstrumentOptions, Noise};
use dermis_twin::mechanics::Indenter;
use dermis_twin::{Frontend, PressRange, TwinKit};

use super::workshop::Built;
use super::{Cause, Tolerances, places, workshop};
use crate::Error;
use crate::twin_bench::distance_mm;

/// Frames of a baseline.
const BASELINE_FRAMES: usize = 32;
/// Presses are held until all mechanics have settled, seconds.
const SETTLED_S: f64 = 1e4;
/// Where pokes begin in the sequence of places: none is at a place that is pressed.
const FIRST_POKE: usize = 5000;
/// Between frames that have nothing to do with each other, nanoseconds.
const APART_NS: u64 = 1_000_000_000;

/// What reads a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Reader {
    /// The skin file's model alone.
    Model,
    /// A calibration by so many pokes of that very sample.
    Pokes(usize),
}

/// One press as it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Press {
    /// Which place.
    pub place: usize,
    /// Distance of the nearest touch, millimetres; none where no touch was near.
    pub error_mm: Option<f64>,
    /// Its amplitude.
    pub amplitude: Option<f64>,
    /// Touches that nobody made.
    pub false_touches: usize,
}

/// A skin's model, and how it is pressed.
#[derive(Debug)]
pub(super) struct Bench {
    pub skin: Skin,
    pub prepared: Prepared,
    pub places_m: Vec<[f64; 2]>,
    press: PressRange,
    frame_s: f64,
    /// Made once where it depends on nothing measured.
    imager: Option<Imager>,
    /// Refinements that nobody uses at the moment; making one takes seconds.
    refinements: Mutex<Vec<Refinement>>,
}

/// A twin and its instrument.
struct Sample {
    frontend: Box<dyn Frontend>,
    instrument: Instrument,
    gains: Vec<f64>,
    absent: Vec<u32>,
    frame_s: f64,
}

impl Sample {
    fn read(&mut self, indenters: &[Indenter]) -> Result<Vec<f64>, Error> {
        let mut frame = self.truth(indenters)?;
        self.instrument.read(self.frame_s, &mut frame);
        Ok(self.without_absent(frame))
    }

    fn truth(&mut self, indenters: &[Indenter]) -> Result<Vec<f64>, Error> {
        indenters.iter().try_for_each(|indenter| self.frontend.check_indenter(indenter))?;
        let mut frame = vec![0.0; self.frontend.channel_count()];
        self.frontend.voltages(indenters, SETTLED_S, &mut frame)?;
        frame.iter_mut().zip(&self.gains).for_each(|(voltage, gain)| *voltage *= gain);
        Ok(frame)
    }

    fn without_absent(&self, mut frame: Vec<f64>) -> Vec<f64> {
        self.absent.iter().for_each(|channel| frame[*channel as usize] = f64::NAN);
        frame
    }
}

impl Bench {
    /// Of a skin, to be pressed at so many places.
    pub fn new(skin: &Skin, place_count: usize) -> Result<Self, Error> {
        let mut skin = skin.clone();
        // Every frame counts at once: presses have nothing to do with each other.
        skin.touch.least_frames = 1;
        // Twins have no board of their own: both they and the model are read by an ideal voltmeter.
        skin.backend.circuit = None;
        let prepared = Prepared::new(skin.clone())?;
        let mut bench = Self {
            places_m: places::pressed(&skin.outline(), place_count, 0)?,
            press: dermis_twin::from_skin::press_range(&skin),
            frame_s: 1.0 / skin.backend.frames_per_s.unwrap_or(20.0),
            imager: None,
            refinements: Mutex::new(Vec::new()),
            skin,
            prepared,
        };
        if operator_needs_no_baseline(&bench.prepared) {
            let voltages = bench.prepared.voltages.clone();
            let reference = Reference::from_baseline(&bench.prepared, &voltages, None)?;
            bench.imager = Some(Imager::new(&bench.prepared, &reference, &[])?);
        }
        Ok(bench)
    }

    /// A sample in which these causes go wrong.
    pub fn build(&self, tolerances: &Tolerances, causes: &[Cause], seeds: [u64; 2]) -> Result<Built, Error> {
        workshop::build(&self.skin, self.prepared.channels(), tolerances, causes, seeds)
    }

    /// Presses a sample at these places. `noise_seed`: of its instrument's noise, none for presses without noise.
    pub fn press(
        &self,
        built: &Built,
        reader: Reader,
        places: &[usize],
        seeds: [u64; 2],
        is_exact: bool,
    ) -> Result<Vec<Press>, Error> {
        let mut noise_seed = workshop::Dice::new(seeds[0], seeds[1], 0);
        let mut sample = self.sample(built, noise_seed.seed())?;
        let rest = sample.truth(&[])?;
        let mut baseline = Vec::with_capacity(BASELINE_FRAMES);
        for _ in 0..BASELINE_FRAMES {
            let mut frame = rest.clone();
            sample.instrument.read(self.frame_s, &mut frame);
            baseline.push(sample.without_absent(frame));
        }
        let (mut reconstructor, reference) = match reader {
            Reader::Model => self.by_model(&baseline, &sample.absent)?,
            Reader::Pokes(count) => self.by_pokes(&baseline, &mut sample, count)?,
        };
        let mut image = vec![f32::NAN; self.prepared.map.grid().len()];
        let mut presses = Vec::with_capacity(places.len());
        for (number, &place) in places.iter().enumerate() {
            let indenter = self.indenter(self.places_m[place]);
            let frame = if is_exact { sample.truth(&[indenter])? } else { sample.read(&[indenter])? };
            let frame = sample.without_absent(frame);
            let difference = reference.difference(&frame, None);
            let time_ns = (number as u64 + 1) * APART_NS;
            reconstructor.forget(time_ns);
            reconstructor.image(&difference, &mut image)?;
            let placement = reconstructor.place(&difference)?;
            reconstructor.follow_touches(time_ns, &image, placement)?;
            presses.push(self.seen(place, &reconstructor));
        }
        if reader == Reader::Model {
            let refinement = std::mem::replace(&mut reconstructor.refinement, Refinement::none());
            self.refinements.lock().unwrap_or_else(PoisonError::into_inner).push(refinement);
        }
        Ok(presses)
    }

    /// Distance beyond which a touch is none of the press's, millimetres: a quarter of the shorter side.
    pub fn near_mm(&self) -> f64 {
        0.5e3 * self.prepared.half_width_m()
    }

    fn sample(&self, built: &Built, noise_seed: u64) -> Result<Sample, Error> {
        let (frontend, instrument, _) = TwinKit::built(&built.skin, &built.as_built)?.twin.into_parts();
        let options = *instrument.options();
        let noise = Noise {
            floor_v: built.noise * options.noise.floor_v,
            proportional: built.noise * options.noise.proportional,
        };
        let options = InstrumentOptions { noise, ..options };
        let instrument = Instrument::new(options, frontend.channel_count(), noise_seed)?;
        let instrument = frontend.wired(instrument)?;
        let absent = built.bad.map_or(Vec::new(), |bad| self.channels_of(bad));
        Ok(Sample { frontend, instrument, gains: built.gains.clone(), absent, frame_s: self.frame_s })
    }

    /// Channels that an electrode or coil has a part in.
    fn channels_of(&self, electrode: u32) -> Vec<u32> {
        let protocol = &self.prepared.protocol;
        let uses = |measurement: &dermis_tomo::eit::Measurement| {
            protocol.stimulations()[measurement.stimulation as usize].touches(electrode)
                || protocol.patterns()[measurement.pattern as usize].touches(electrode)
        };
        let channels = protocol.measurements().iter().enumerate();
        channels.filter(|(_, measurement)| uses(measurement)).map(|(channel, _)| channel as u32).collect()
    }

    fn indenter(&self, place_m: [f64; 2]) -> Indenter {
        Indenter::disc(place_m, self.press.initial_radius_m, self.press.initial_pressure_pa)
    }

    /// Baseline and noise, as the running skin takes them; the covariance of the noise only where weights are made of it.
    fn reference(&self, baseline: &[Vec<f64>]) -> Result<Reference, Error> {
        if matches!(self.skin.imaging.weights, WeightChoice::MeasuredFull) {
            return Ok(Reference::of(&self.prepared, baseline)?);
        }
        let channels = 0..self.prepared.channels();
        let count = baseline.len() as f64;
        let mean: Vec<f64> =
            channels.clone().map(|c| baseline.iter().map(|frame| frame[c]).sum::<f64>() / count).collect();
        let squares = |c: usize| baseline.windows(2).map(|pair| (pair[1][c] - pair[0][c]).powi(2)).sum::<f64>();
        let deviation: Vec<f64> = channels.map(|c| (0.5 * squares(c) / (count - 1.0)).sqrt()).collect();
        Ok(Reference::from_baseline(&self.prepared, &mean, Some(&deviation))?)
    }

    fn by_model(&self, baseline: &[Vec<f64>], absent: &[u32]) -> Result<(Reconstructor, Reference), Error> {
        let reference = self.reference(baseline)?;
        let (imager, reference, placement) = match &self.imager {
            Some(imager) => {
                let mut imager = imager.clone();
                imager.set_noise(&reference.noise)?;
                (imager, reference, None)
            }
            None => {
                let data: Vec<Vec<f64>> = baseline.iter().map(|frame| reference.difference(frame, None)).collect();
                let made = CalibratedImager::new(&self.prepared, None, reference, &data)?;
                (made.imager, made.reference, made.placement)
            }
        };
        let refinement = self.refinement(&reference.noise)?;
        let mut reconstructor = Reconstructor::new(&self.prepared, imager, placement, refinement)?;
        if !absent.is_empty() {
            reconstructor.leave_out(&self.prepared, absent, &reference.noise)?;
        }
        Ok((reconstructor, reference))
    }

    fn refinement(&self, noise: &[f64]) -> Result<Refinement, Error> {
        if !Refinement::is_wanted(&self.prepared, false) {
            return Ok(Refinement::none());
        }
        let idle = self.refinements.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut refinement = match idle {
            Some(refinement) => refinement,
            None => Refinement::new(&self.prepared, noise)?,
        };
        refinement.renew(&self.prepared, noise)?;
        Ok(refinement)
    }

    fn by_pokes(
        &self,
        baseline: &[Vec<f64>],
        sample: &mut Sample,
        count: usize,
    ) -> Result<(Reconstructor, Reference), Error> {
        let positions_m = places::pressed(&self.skin.outline(), count, FIRST_POKE)?;
        let frames =
            positions_m.iter().map(|place| sample.read(&[self.indenter(*place)])).collect::<Result<Vec<_>, _>>()?;
        let pokes = Pokes { positions_m, loads: None };
        // One frame too few to be taken for the pokes' own baselines.
        let baseline = if frames.len() == baseline.len() { &baseline[1..] } else { baseline };
        let calibration = Calibration::fit(&self.prepared, baseline, &frames, &pokes)?;
        let reference = self.reference(baseline)?;
        let data: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
        let made = CalibratedImager::new(&self.prepared, Some(&calibration), reference, &data)?;
        let reconstructor = Reconstructor::new(&self.prepared, made.imager, made.placement, Refinement::none())?;
        Ok((reconstructor, made.reference))
    }

    fn seen(&self, place: usize, reconstructor: &Reconstructor) -> Press {
        let stage = &reconstructor.touches;
        let begun = stage.touches().iter().filter(|touch| touch.observation != Observation::Missed).count();
        let touches = &stage.contacts()[..begun.min(stage.contacts().len())];
        let away = |centroid_m: [f64; 2]| distance_mm(centroid_m, self.places_m[place]);
        let nearest = touches
            .iter()
            .map(|touch| (away(touch.centroid_m), touch.amplitude))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(error_mm, _)| *error_mm <= self.near_mm());
        Press {
            place,
            error_mm: nearest.map(|(error_mm, _)| error_mm),
            amplitude: nearest.map(|(_, amplitude)| amplitude),
            false_touches: touches.len() - usize::from(nearest.is_some()),
        }
    }
}
