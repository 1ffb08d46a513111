//! One sample on the bench: baseline, presses, images and touches, all computed with the model of the skin file, as a
//! running skin does it. Everything that doesn't depend on the sample is computed once.

use std::sync::{Mutex, PoisonError};

use dermis_live::calibrate::{MeasuredPoke, seen_pokes};
use dermis_live::calibration::{CalibratedImager, Calibration, Pokes};
use dermis_live::imager::{Imager, operator_needs_no_baseline};
use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::reference::Reference;
use dermis_live::stages::refinement::Refinement;
use dermis_skin::{Dice, Reads, Skin, Tolerances};
use dermis_tomo::mesh::Point;
use dermis_touch::Observation;
use dermis_touch::locator::PokeSight;
use dermis_twin::from_skin::MeshSizes;
use dermis_twin::instrument::{Instrument, InstrumentOptions};
use dermis_twin::mechanics::Indenter;
use dermis_twin::{Frontend, PressRange, TwinKit};

use super::cause::Cause;
use super::workshop::Built;
use super::{places, workshop};
use crate::Error;
use crate::twin_bench::distance_mm;

/// Frames in a baseline.
const BASELINE_FRAMES: usize = 32;
/// Time that presses are held, seconds, so that all mechanics settle.
const SETTLED_S: f64 = 1e4;
/// First index of pokes in the sequence of places, so that no poke is at a pressed place.
const FIRST_POKE: usize = 5000;
/// Element size of the twins, relative to a skin's usual twin. This takes a third of the time; the extra error also
/// appears in the skin as drawn.
const COARSER: f64 = 1.5;
/// Number of pokes used to find a typical amplitude.
const TYPICAL_POKES: usize = 20;
/// Time between unrelated frames, nanoseconds.
const APART_NS: u64 = 1_000_000_000;

/// A poke: its place, metres, and its frame.
type Poked = ([f64; 2], Vec<f64>);

/// How a sample is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Reader {
    /// With the skin file's model alone.
    Model,
    /// With calibrations on the sample itself, one for each of these numbers of pokes. All use the first pokes of the
    /// same sequence.
    Pokes(Vec<usize>),
}

/// The result of one press.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Press {
    /// Index of the place.
    pub place: usize,
    /// Distance to the nearest touch, millimetres; `None` if there was none nearby.
    pub error_mm: Option<f64>,
    /// Amplitude of that touch; on a calibrated sample relative to a typical poke's.
    pub amplitude: Option<f64>,
    /// Number of false touches.
    pub false_touches: usize,
}

/// A skin's model and its presses.
#[derive(Debug)]
pub(super) struct Bench {
    pub skin: Skin,
    pub prepared: Prepared,
    pub places_m: Vec<Point>,
    press: PressRange,
    frame_s: f64,
    /// Built once, if it doesn't depend on measurements.
    imager: Option<Imager>,
    /// Refinements free for reuse; building one takes seconds.
    refinements: Mutex<Vec<Refinement>>,
    /// The skin as drawn. Samples whose errors are all in the instrument are read from its frames.
    drawn: Drawn,
}

/// A skin as drawn, with its frames for every place.
#[derive(Debug)]
struct Drawn {
    /// Connected to the instruments of samples.
    frontend: Mutex<Box<dyn Frontend>>,
    instrument: InstrumentOptions,
    /// Voltages at rest and under a press at each place.
    rest_v: Vec<f64>,
    pressed_v: Vec<Vec<f64>>,
}

/// The body being read.
enum Body<'a> {
    Drawn(&'a Drawn),
    Built(Box<dyn Frontend>),
}

/// The action before a frame.
enum Act {
    Rest,
    /// Press at one of the bench's places.
    Press(usize, Indenter),
    /// Press elsewhere.
    Poke(Indenter),
}

/// A twin and its instrument.
struct Sample<'a> {
    body: Body<'a>,
    instrument: Instrument,
    gains: Vec<f64>,
    absent: Vec<u32>,
    frame_s: f64,
}

impl Sample<'_> {
    fn read(&mut self, act: Act) -> Result<Vec<f64>, Error> {
        let mut frame = self.truth(act)?;
        self.instrument.read(self.frame_s, &mut frame);
        Ok(self.without_absent(frame))
    }

    fn truth(&mut self, act: Act) -> Result<Vec<f64>, Error> {
        let mut frame = match (&mut self.body, &act) {
            (Body::Drawn(drawn), Act::Rest) => drawn.rest_v.clone(),
            (Body::Drawn(drawn), Act::Press(place, _)) => drawn.pressed_v[*place].clone(),
            (Body::Drawn(drawn), Act::Poke(indenter)) => {
                settled(&mut **drawn.frontend.lock().unwrap_or_else(PoisonError::into_inner), &[*indenter])?
            }
            (Body::Built(frontend), Act::Rest) => settled(&mut **frontend, &[])?,
            (Body::Built(frontend), Act::Press(_, indenter) | Act::Poke(indenter)) => {
                settled(&mut **frontend, &[*indenter])?
            }
        };
        frame.iter_mut().zip(&self.gains).for_each(|(voltage, gain)| *voltage *= gain);
        Ok(frame)
    }

    fn without_absent(&self, mut frame: Vec<f64>) -> Vec<f64> {
        self.absent.iter().for_each(|channel| frame[*channel as usize] = f64::NAN);
        frame
    }
}

/// The skin's usual press.
fn usual_press(press: &PressRange, place_m: Point) -> Indenter {
    Indenter::disc(place_m, press.initial_radius_m, press.initial_pressure_pa)
}

/// A frame under these indenters after all mechanics have settled.
fn settled(frontend: &mut dyn Frontend, indenters: &[Indenter]) -> Result<Vec<f64>, Error> {
    indenters.iter().try_for_each(|indenter| frontend.check_indenter(indenter))?;
    let mut frame = vec![0.0; frontend.channel_count()];
    frontend.voltages(indenters, SETTLED_S, &mut frame)?;
    Ok(frame)
}

impl Drawn {
    fn new(skin: &Skin, places_m: &[Point], indenter: impl Fn(Point) -> Indenter) -> Result<Self, Error> {
        let drawn = workshop::as_drawn(skin);
        let (mut frontend, instrument, _) = TwinKit::of(&drawn)?.twin.into_parts();
        let rest_v = settled(&mut *frontend, &[])?;
        let pressed_v =
            places_m.iter().map(|place| settled(&mut *frontend, &[indenter(*place)])).collect::<Result<_, Error>>()?;
        Ok(Self { frontend: Mutex::new(frontend), instrument: *instrument.options(), rest_v, pressed_v })
    }
}

impl Bench {
    /// A bench for a skin, with this number of places to press.
    pub fn new(skin: &Skin, place_count: usize) -> Result<Self, Error> {
        let mut skin = skin.clone();
        // Presses are independent, so every frame counts by itself.
        skin.touch.least_frames = 1;
        // The model knows only the kind of a board that loads the skin. The cost of that is not studied here, so twin
        // and model both use an ideal voltmeter.
        skin.backend.circuit = None;
        if skin.frontend.coils.is_none() {
            skin.twin.element_mm = Some(1e3 * COARSER * MeshSizes::of(&skin).element_m);
        }
        let prepared = Prepared::new(skin.clone())?;
        let press = dermis_twin::from_skin::press_range(&skin);
        let places_m = places::pressed(&skin.outline(), place_count, 0)?;
        let mut bench = Self {
            drawn: Drawn::new(&skin, &places_m, |place| usual_press(&press, place))?,
            places_m,
            press,
            frame_s: 1.0 / skin.backend.frame_rate_hz(),
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

    /// Builds a sample with errors from these causes.
    pub fn build(&self, tolerances: &Tolerances, causes: &[Cause], seeds: [u64; 2]) -> Result<Built, Error> {
        workshop::build(&self.skin, self.prepared.channels(), tolerances, causes, seeds)
    }

    /// Presses a sample at these places and reads the presses.
    ///
    /// Returns one list of presses with the skin file's model, or one list for each number of calibration pokes. With
    /// `is_exact` the presses have no noise.
    pub fn press(
        &self,
        built: &Built,
        reader: &Reader,
        places: &[usize],
        seeds: [u64; 2],
        is_exact: bool,
    ) -> Result<Vec<Vec<Press>>, Error> {
        let mut noise_seed = Dice::new(seeds[0], seeds[1], 0);
        let mut sample = self.sample(built, noise_seed.seed())?;
        let rest = sample.truth(Act::Rest)?;
        let mut baseline = Vec::with_capacity(BASELINE_FRAMES);
        for _ in 0..BASELINE_FRAMES {
            let mut frame = rest.clone();
            sample.instrument.read(self.frame_s, &mut frame);
            baseline.push(sample.without_absent(frame));
        }
        let pokes = match reader {
            Reader::Model => Vec::new(),
            Reader::Pokes(counts) => self.poke(&mut sample, counts.iter().copied().max().unwrap_or(0))?,
        };
        let mut frames = Vec::with_capacity(places.len());
        for &place in places {
            let act = Act::Press(place, usual_press(&self.press, self.places_m[place]));
            let frame = if is_exact { self.rectified(sample.truth(act)?) } else { sample.read(act)? };
            frames.push((place, sample.without_absent(frame)));
        }
        match reader {
            Reader::Model => {
                let (mut reconstructor, reference) = self.by_model(&baseline, &sample.absent)?;
                let presses = self.look(&mut reconstructor, &reference, &frames)?;
                self.keep(&mut reconstructor);
                Ok(vec![presses])
            }
            Reader::Pokes(counts) => {
                let seen = self.seen_pokes(&baseline, &pokes, &sample.absent)?;
                let by_pokes = |count: &usize| {
                    let (mut reconstructor, reference) = self.by_pokes(&baseline, &pokes[..*count], &seen[..*count])?;
                    let mut presses = self.look(&mut reconstructor, &reference, &frames)?;
                    let typical = self.typical_amplitude(&mut reconstructor, &reference, &pokes[..*count])?;
                    presses.iter_mut().for_each(|press| press.amplitude = press.amplitude.map(|a| a / typical));
                    self.keep(&mut reconstructor);
                    Ok(presses)
                };
                counts.iter().map(by_pokes).collect()
            }
        }
    }

    /// A frame without noise, with signs as the instrument delivers them.
    fn rectified(&self, mut frame: Vec<f64>) -> Vec<f64> {
        if self.skin.backend.reads == Reads::Magnitude {
            frame.iter_mut().for_each(|voltage| *voltage = voltage.abs());
        }
        frame
    }

    /// Results of presses, each given by its place and a frame.
    fn look(
        &self,
        reconstructor: &mut Reconstructor,
        reference: &Reference,
        frames: &[(usize, Vec<f64>)],
    ) -> Result<Vec<Press>, Error> {
        let mut presses = Vec::with_capacity(frames.len());
        for (number, (place, frame)) in frames.iter().enumerate() {
            self.look_at(reconstructor, reference, number, frame)?;
            presses.push(self.seen(*place, reconstructor));
        }
        Ok(presses)
    }

    /// Processes a frame that is unrelated to the previous one.
    fn look_at(
        &self,
        reconstructor: &mut Reconstructor,
        reference: &Reference,
        number: usize,
        frame: &[f64],
    ) -> Result<(), Error> {
        let mut image = vec![f32::NAN; self.prepared.map.grid().len()];
        let difference = reference.difference(frame, None);
        let time_ns = (number as u64 + 1) * APART_NS;
        reconstructor.forget(time_ns);
        reconstructor.image(&difference, &mut image)?;
        let placement = reconstructor.place(time_ns, &difference)?;
        reconstructor.follow_touches(time_ns, &image, placement)?;
        Ok(())
    }

    /// Amplitude that a reader gives a typical poke; NaN if it detects none. The unit of amplitudes depends
    /// on whether the model or the pokes place touches, which may differ between samples.
    fn typical_amplitude(
        &self,
        reconstructor: &mut Reconstructor,
        reference: &Reference,
        pokes: &[Poked],
    ) -> Result<f64, Error> {
        let mut amplitudes = Vec::new();
        for (number, (_, frame)) in pokes.iter().take(TYPICAL_POKES).enumerate() {
            // Times continue after those of the presses.
            self.look_at(reconstructor, reference, self.places_m.len() + number, frame)?;
            let contacts = reconstructor.touches.contacts().iter().map(|contact| contact.amplitude);
            amplitudes.extend(contacts.max_by(f64::total_cmp));
        }
        amplitudes.sort_by(f64::total_cmp);
        Ok(amplitudes.get(amplitudes.len() / 2).copied().unwrap_or(f64::NAN))
    }

    /// Largest distance at which a touch still belongs to the press, millimetres: a quarter of the shorter side.
    pub fn near_mm(&self) -> f64 {
        0.5e3 * self.prepared.half_width_m()
    }

    fn sample(&self, built: &Built, noise_seed: u64) -> Result<Sample<'_>, Error> {
        let (body, options) = if built.is_as_drawn {
            (Body::Drawn(&self.drawn), self.drawn.instrument)
        } else {
            let (frontend, instrument, _) = TwinKit::built(&built.skin, &built.as_built)?.twin.into_parts();
            (Body::Built(frontend), *instrument.options())
        };
        let instrument = built.instrument(options, noise_seed)?;
        let instrument = match &body {
            Body::Drawn(drawn) => drawn.frontend.lock().unwrap_or_else(PoisonError::into_inner).wired(instrument)?,
            Body::Built(frontend) => frontend.wired(instrument)?,
        };
        let absent = built.bad.map_or(Vec::new(), |bad| self.channels_of(bad));
        Ok(Sample { body, instrument, gains: built.gains.clone(), absent, frame_s: self.frame_s })
    }

    /// Channels that use an electrode or coil.
    fn channels_of(&self, electrode: u32) -> Vec<u32> {
        let protocol = &self.prepared.protocol;
        let uses = |measurement: &dermis_tomo::eit::Measurement| {
            protocol.stimulations()[measurement.stimulation as usize].touches(electrode)
                || protocol.patterns()[measurement.pattern as usize].touches(electrode)
        };
        let channels = protocol.measurements().iter().enumerate();
        channels.filter(|(_, measurement)| uses(measurement)).map(|(channel, _)| channel as u32).collect()
    }

    fn by_model(&self, baseline: &[Vec<f64>], absent: &[u32]) -> Result<(Reconstructor, Reference), Error> {
        let reference = Reference::of(&self.prepared, baseline)?;
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
        reconstructor.take_reference(&self.prepared, &reference);
        Ok((reconstructor, reference))
    }

    fn refinement(&self, noise: &[f64]) -> Result<Refinement, Error> {
        if !Refinement::is_wanted(&self.prepared, None) {
            return Ok(Refinement::none());
        }
        let idle = self.refinements.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut refinement = match idle {
            Some(refinement) => refinement,
            None => Refinement::new(&self.prepared, noise)?.taking_time(),
        };
        refinement.renew(&self.prepared, noise)?;
        Ok(refinement)
    }

    /// Returns the refinement to the pool for the next sample.
    fn keep(&self, reconstructor: &mut Reconstructor) {
        if reconstructor.refinement.refines() {
            let refinement = std::mem::replace(&mut reconstructor.refinement, Refinement::none());
            self.refinements.lock().unwrap_or_else(PoisonError::into_inner).push(refinement);
        }
    }

    /// The pokes as placed by the skin file's model alone.
    fn seen_pokes(&self, baseline: &[Vec<f64>], poked: &[Poked], absent: &[u32]) -> Result<Vec<PokeSight>, Error> {
        let (mut reconstructor, reference) = self.by_model(baseline, absent)?;
        let differences: Vec<Vec<f64>> = poked.iter().map(|(_, frame)| reference.difference(frame, None)).collect();
        let pokes = poked.iter().zip(&differences).map(|((truth_m, _), difference)| MeasuredPoke {
            difference,
            truth_m: *truth_m,
            load_share: 1.0,
        });
        let seen = seen_pokes(&mut reconstructor, &self.prepared, pokes)?;
        self.keep(&mut reconstructor);
        Ok(seen)
    }

    /// Makes the first `count` pokes of their own sequence, and reads a frame of each.
    fn poke(&self, sample: &mut Sample<'_>, count: usize) -> Result<Vec<Poked>, Error> {
        let places_m = places::pressed(&self.skin.outline(), count, FIRST_POKE)?;
        let mut poked = Vec::with_capacity(count);
        for place in places_m {
            poked.push((place, sample.read(Act::Poke(usual_press(&self.press, place)))?));
        }
        Ok(poked)
    }

    fn by_pokes(
        &self,
        baseline: &[Vec<f64>],
        poked: &[Poked],
        seen: &[PokeSight],
    ) -> Result<(Reconstructor, Reference), Error> {
        let (positions_m, frames): (Vec<[f64; 2]>, Vec<Vec<f64>>) = poked.iter().cloned().unzip();
        let pokes = Pokes { positions_m, further_m: Vec::new(), loads: None };
        // With as many baseline frames as pokes, each would be taken as the baseline of one poke. Drop one.
        let baseline = if frames.len() == baseline.len() { &baseline[1..] } else { baseline };
        let mut calibration = Calibration::fit(&self.prepared, baseline, &frames, &pokes)?;
        calibration.try_model(seen, &self.prepared)?;
        let reference = Reference::of(&self.prepared, baseline)?;
        let data: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
        let made = CalibratedImager::new(&self.prepared, Some(&calibration), reference, &data)?;
        let refinement = match calibration.correction() {
            Some(_) => self.refinement(&made.reference.noise)?,
            None => Refinement::none(),
        };
        let reconstructor = Reconstructor::new(&self.prepared, made.imager, made.placement, refinement)?;
        Ok((reconstructor, made.reference))
    }

    fn seen(&self, place: usize, reconstructor: &Reconstructor) -> Press {
        let stage = &reconstructor.touches;
        let begun = stage.touches().iter().filter(|touch| touch.observation != Observation::Missed).count();
        let touches = &stage.contacts()[..begun.min(stage.contacts().len())];
        let away = |centroid_m: Point| distance_mm(centroid_m, self.places_m[place]);
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
