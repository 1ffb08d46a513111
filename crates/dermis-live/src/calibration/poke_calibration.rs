//! A calibration by pokes at known positions. It consists of a measured Jacobian, on which images are made, and a
//! locator, which locates single touches with a calibrated sigma. With few pokes the locator relies on physics or on
//! sister skins, with many on the pokes alone.

mod as_built;
mod frames;
mod groups;
mod map;
mod review;
mod start;
mod stored;
mod strength;

pub(crate) use as_built::AsBuilt;
pub(crate) use frames::differences_of;
pub use frames::{PokeFrames, set_channels};
pub use groups::PokeGroup;
use groups::split;

use std::path::Path;

use dermis_tomo::inverse::MeasuredJacobian;
use dermis_tomo::mesh::Point;
use dermis_touch::evenly;
use dermis_touch::health::RestScatter;
use dermis_touch::locator::{
    Examples, FusedLocator, FusedReport, LabelledFrame, LeaveOneOut, LocatorError, MIN_EXAMPLES, PlaceCorrection,
    PokeSight, SeenPoke, SessionDrift, SuggestedPoke, Superposition, TypicalAmplitude,
};
use frames::without_silence;
use map::signature_map;
pub use review::PokeReview;
use serde::{Deserialize, Serialize};
use start::{Earlier, Started, fit_best};
pub use start::{StartReview, StartUse};
pub(super) use strength::SmallestAmplitude;
use strength::{SessionNoise, TouchStrength, Weighed};

use super::poke_check::{Sound, check_pokes};
use super::pokes::{LoadQuantity, Pokes, load_shares};
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{NoiseSource, Reference};

/// Correlation lengths tried for the measured Jacobian, relative to half the shorter side.
const LENGTHS: [f64; 4] = [0.15, 0.25, 0.4, 0.6];
/// Maximum number of pokes, evenly drawn, kept for later sessions, and of those that make the measured Jacobian. The
/// time of a fit grows with their cube.
const MOST_KEPT: usize = 1500;
const MOST_IN_JACOBIAN: usize = 800;
/// Maximum number of pokes, evenly drawn, that determine how weak a touch may be.
const MOST_WEIGHED: usize = 500;
/// Maximum number of pokes that determine the amplitude of a typical one.
const MOST_TYPICAL: usize = 200;
/// Maximum share of the pokes that the model may see as several touches, if it is to locate touches.
const MOST_SEVERAL: f64 = 0.1;
/// Minimum share of the pokes that the model must see. The locator locates the others.
const LEAST_SEEN: f64 = 0.5;
/// Minimum number of pokes, in the order they were made, for measuring drift.
const FEWEST_FOR_DRIFT: usize = 40;

/// Additional information used with the pokes.
#[derive(Clone, Copy, Debug)]
pub struct CalibrationOptions<'a> {
    /// Use the skin file's physics if it improves the prediction of left-out pokes. Never used if the wiring is
    /// unknown.
    pub physics: bool,
    /// Earlier calibrations, of this skin or of sisters. The new pokes decide whether and how one is used.
    pub start: &'a [Calibration],
}

impl Default for CalibrationOptions<'_> {
    fn default() -> Self {
        Self { physics: true, start: &[] }
    }
}

/// A calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "stored::StoredCalibration", into = "stored::StoredCalibration")]
pub struct Calibration {
    skin: String,
    /// Fingerprint of the skin ([`crate::same_skin`]); `None` in files of earlier versions.
    skin_sha256: Option<String>,
    channels: usize,
    load: Option<LoadQuantity>,
    /// Difference data of each poke, model volts, not divided by loads. Only a subset if there are very many pokes.
    frames: Vec<Vec<f64>>,
    positions_m: Vec<Point>,
    loads: Option<Vec<f64>>,
    locator: Box<FusedLocator>,
    /// Corrects the positions of the skin's model, if these are better than the locator's. The model then locates
    /// touches, and the locator estimates their load.
    by_model: Option<PlaceCorrection>,
    /// How the skin was built, and the errors of touches that remain, if that explains the pokes best.
    as_built: Option<AsBuilt>,
    /// Pokes with several touches, which only teach how touches add up.
    groups: Vec<PokeGroup>,
    /// Number of pokes used in the fit.
    pokes: usize,
    strength: TouchStrength,
    review: PokeReview,
}

impl Calibration {
    /// Fits a calibration to pokes. `baselines` has one frame for all pokes or one for each; frames are in the
    /// protocol's order.
    ///
    /// # Errors
    /// Inconsistent counts, positions off the skin, or pokes from which nothing can be learned.
    pub fn fit(prepared: &Prepared, baselines: &[Vec<f64>], frames: &[Vec<f64>], pokes: &Pokes) -> Result<Self, Error> {
        Self::fit_with(prepared, PokeFrames::Readings { baselines, frames }, pokes, &CalibrationOptions::default())
    }

    /// As [`Calibration::fit`], from readings or differences, with a choice of additional information.
    ///
    /// # Errors
    /// As [`Calibration::fit`]; a sister with a different number of channels.
    pub fn fit_with(
        prepared: &Prepared,
        measured: PokeFrames<'_>,
        pokes: &Pokes,
        options: &CalibrationOptions<'_>,
    ) -> Result<Self, Error> {
        if let Some(parts) = split(measured, pokes)? {
            let alone = Self::fit_with(prepared, parts.singles(), &parts.pokes, options)?;
            return Ok(Self { groups: parts.groups(prepared)?, ..alone });
        }
        let (reference, mut differences) = differences_of(prepared, measured)?;
        let scatter = measured.rest_scatter();
        let unsound_channels = scatter.as_ref().map_or_else(Vec::new, |scatter| scatter.unsound(None));
        set_channels(&mut differences, &unsound_channels, f64::NAN);
        let Sound { rows, repeated, dead_channels } = check_pokes(prepared, &differences, pokes)?;
        let picked = |most: usize| evenly(rows.len(), most).into_iter().map(|i| rows[i]);
        let places = |rows: &[usize]| rows.iter().map(|&i| pokes.positions_m[i]).collect::<Vec<_>>();
        let frames = rows.iter().flat_map(|&i| differences[i].iter().copied()).collect();
        let mut examples = Examples::new(prepared.channels(), frames, places(&rows))?;
        // Differences do not reveal the noise of the channels, so all have equal weight.
        if matches!(measured, PokeFrames::Readings { .. }) {
            examples = examples.with_channel_noise(reference.noise.clone())?;
        }
        if let Some((_, loads)) = &pokes.loads {
            examples = examples.with_loads(rows.iter().map(|&i| loads[i]).collect())?;
        }
        let map = signature_map(prepared, options.physics)?;
        let earlier: Vec<Earlier<'_>> = options.start.iter().map(Self::earlier).collect();
        let (started, drift) = rayon::join(
            || fit_best(&examples, &map, &earlier, prepared),
            || (rows.len() >= FEWEST_FOR_DRIFT).then(|| SessionDrift::measure(&examples)).transpose(),
        );
        let (Started { locator: fused, keeps, review: start }, drift) = (started?, drift?);
        let kept: Vec<usize> = picked(MOST_KEPT).collect();
        let mut scratch = fused.scratch();
        let mut weigh = |frame: &[f64]| {
            let located = fused.predict_into(frame, &mut scratch)?;
            Ok::<_, Error>(Weighed { amplitude: located.amplitude, sigma_m: located.sigma_x_m.max(located.sigma_y_m) })
        };
        // Few new pokes don't show how weak one may be.
        let earlier = keeps.and_then(|number| options.start.get(number));
        let earlier_frames = earlier.map_or(&[][..], |earlier| &earlier.frames);
        let some_earlier = evenly(earlier_frames.len(), MOST_WEIGHED).into_iter().map(|i| &earlier_frames[i]);
        let weighed = picked(MOST_WEIGHED).map(|i| &differences[i]).chain(some_earlier);
        let amplitudes: Result<Vec<f64>, Error> = weighed.map(|frame| Ok(weigh(frame)?.amplitude)).collect();
        let resting = measured.at_rest(&reference);
        let of_a_poke = measured.noise_share();
        let resting: Result<Vec<Weighed>, Error> = resting
            .iter()
            .map(|difference| weigh(difference).map(|rest| Weighed { amplitude: of_a_poke * rest.amplitude, ..rest }))
            .collect();
        let dead = dead_channels.iter().copied().filter(|channel| !unsound_channels.contains(channel)).collect();
        let rest_scatter =
            scatter.map_or_else(Vec::new, |scatter| scatter.robust().iter().map(|v| v.max(0.0)).collect());
        let mut calibration = Self {
            skin: prepared.skin.name.clone(),
            skin_sha256: Some(crate::same_skin::frames_sha256(&prepared.skin)),
            channels: prepared.channels(),
            load: pokes.loads.as_ref().map(|(quantity, _)| *quantity),
            frames: kept.iter().map(|&i| without_silence(&differences[i], &dead_channels)).collect(),
            positions_m: places(&kept),
            loads: pokes.loads.as_ref().map(|(_, loads)| kept.iter().map(|&i| loads[i]).collect()),
            locator: Box::new(fused),
            by_model: None,
            as_built: None,
            groups: Vec::new(),
            pokes: rows.len(),
            strength: TouchStrength::of(amplitudes?, &resting?, matches!(measured, PokeFrames::Readings { .. })),
            review: PokeReview { repeated, dead_channels: dead, drift, unsound_channels, rest_scatter, start },
        };
        if let Some(earlier) = earlier {
            calibration.keep_pokes_of(earlier);
        }
        Ok(calibration)
    }

    fn earlier(&self) -> Earlier<'_> {
        Earlier {
            skin: &self.skin,
            locator: &self.locator,
            frames: &self.frames,
            positions_m: &self.positions_m,
            loads: self.loads.as_deref(),
        }
    }

    /// Adds the pokes of an earlier calibration, up to as many as are kept at most.
    fn keep_pokes_of(&mut self, earlier: &Self) {
        let room = MOST_KEPT.saturating_sub(self.frames.len());
        for i in evenly(earlier.frames.len(), room) {
            self.frames.push(earlier.frames[i].clone());
            self.positions_m.push(earlier.positions_m[i]);
            if let Some(loads) = &mut self.loads {
                // A poke of unknown load counts as a typical one.
                let typical = loads.iter().sum::<f64>() / loads.len() as f64;
                loads.push(earlier.loads.as_ref().map_or(typical, |loads| loads[i]));
            }
        }
        self.groups.extend(earlier.groups.iter().cloned());
    }

    /// Lets the skin's model locate touches, corrected by the pokes, with the locator for those that the model does
    /// not see. Keeps the locator instead if its left-out errors are clearly smaller (median plus 90th percentile).
    /// `seen` are the pokes as the model sees them. Returns true if the model now locates touches.
    ///
    /// # Errors
    /// Positions, amplitudes or loads that are not finite.
    pub fn try_model(&mut self, seen: &[PokeSight], prepared: &Prepared) -> Result<bool, Error> {
        self.by_model = None;
        let pokes: Vec<SeenPoke> = seen.iter().filter_map(PokeSight::single).copied().collect();
        let several = seen.iter().filter(|sight| matches!(sight, PokeSight::Several(_))).count() as f64;
        let all = seen.len() as f64;
        if pokes.len() < MIN_EXAMPLES || several > MOST_SEVERAL * all || (pokes.len() as f64) < LEAST_SEEN * all {
            return Ok(false);
        }
        let correction = match PlaceCorrection::fit(&pokes, prepared.half_width_m()) {
            Ok(correction) => correction.beside(self.locator.leave_one_out(), seen),
            // Too few pokes are near where the model puts them, so it does not explain them.
            Err(LocatorError::Count { .. }) => return Ok(false),
            Err(error) => return Err(error.into()),
        };
        let total = |report: &LeaveOneOut| report.median_error_m + report.p90_error_m;
        // The model has more information than these pokes, so the locator must be significantly better.
        let clearly = 1.0 - 1.0 / all.sqrt();
        let locator = total(self.locator.leave_one_out());
        self.by_model = Some(correction).filter(|c| clearly * total(c.leave_one_out()) < locator);
        Ok(self.by_model.is_some())
    }

    /// The model of the skin as built, if the pokes tell how it was built and the given one is of the skin as drawn.
    ///
    /// # Errors
    /// A skin that cannot be solved.
    pub fn skin_as_built(&self, prepared: &Prepared) -> Result<Option<Prepared>, Error> {
        let as_built = self.as_built.as_ref().filter(|_| !prepared.is_as_built());
        as_built.map(|as_built| as_built.skin(prepared)).transpose()
    }

    /// True if touches are located by the model of the skin as built.
    pub fn is_as_built(&self) -> bool {
        self.as_built.is_some()
    }

    /// Lets the model of the skin as built locate touches, with these errors of pokes that it had not learned from.
    pub(crate) fn set_as_built(&mut self, as_built: AsBuilt, correction: PlaceCorrection) {
        (self.as_built, self.by_model) = (Some(as_built), Some(correction));
    }

    /// The correction of the model's positions, if the model locates touches; `None` if the locator does.
    pub fn correction(&self) -> Option<&PlaceCorrection> {
        self.by_model.as_ref()
    }

    /// Accuracy of each poke as located from the others.
    pub fn leave_one_out(&self) -> &LeaveOneOut {
        self.by_model.as_ref().map_or_else(|| self.locator.leave_one_out(), PlaceCorrection::leave_one_out)
    }

    /// The experts' results on the pokes and the use of physics and sister skins.
    pub fn experts(&self) -> &FusedReport {
        self.locator.report()
    }

    /// Channels to exclude from frames taken with these baselines, one for each frame: those that the calibration
    /// excluded, those that jump, and those that scatter well above their earlier level. Empty with too few
    /// baselines. If nearly all channels jump or scatter, only those that the calibration excluded.
    pub fn unsound_channels(&self, baselines: &[Vec<f64>]) -> Vec<u32> {
        let Some(scatter) = RestScatter::of(baselines) else { return Vec::new() };
        let mut unsound = scatter.unsound(Some(&self.review.rest_scatter));
        unsound.extend(&self.review.unsound_channels);
        unsound.sort_unstable();
        unsound.dedup();
        unsound
    }

    /// The calibration of a skin on which these channels no longer work. It is refitted without them to its pokes, or
    /// to the 1,500 of them that it keeps. `noise` is the current channel noise, in the unit of difference data. The
    /// locator then locates touches.
    ///
    /// # Errors
    /// A channel that does not exist, noise of the wrong length, or pokes from which nothing can be learned without
    /// them.
    pub fn without_channels(&self, prepared: &Prepared, channels: &[u32], noise: &[f64]) -> Result<Self, Error> {
        if let Some(&channel) = channels.iter().find(|channel| **channel as usize >= self.channels) {
            return Err(Error::Frames {
                what: "channels to leave out".into(),
                expected: format!("numbers below {}", self.channels),
                got: channel.to_string(),
            });
        }
        let mut silent = self.clone();
        let mut gone = self.frames.clone();
        set_channels(&mut silent.frames, channels, 0.0);
        for group in &mut silent.groups {
            set_channels(std::slice::from_mut(&mut group.frame), channels, 0.0);
        }
        set_channels(&mut gone, channels, f64::NAN);
        let mut examples = Examples::new(self.channels, gone.concat(), self.positions_m.clone())?;
        examples = examples.with_channel_noise(noise.to_vec())?;
        if let Some(loads) = &self.loads {
            examples = examples.with_loads(loads.clone())?;
        }
        let fused = fit_best(&examples, &signature_map(prepared, true)?, &[], prepared)?.locator;
        let amplitudes =
            gone.iter().map(|frame| Ok(fused.predict(frame)?.amplitude)).collect::<Result<Vec<f64>, Error>>()?;
        silent.locator = Box::new(fused);
        silent.by_model = None;
        silent.strength = TouchStrength::of(amplitudes, &[], true);
        Ok(silent)
    }

    /// Findings about the pokes, other than their locations.
    pub fn review(&self) -> &PokeReview {
        &self.review
    }

    /// Quantity in which the pokes' loads were measured, if frames reveal it. Touches then have a load too.
    pub fn load_quantity(&self) -> Option<LoadQuantity> {
        self.load.filter(|_| self.leave_one_out().load_error.is_some())
    }

    /// True if the pokes had loads that frames do not reveal.
    pub fn has_silent_loads(&self) -> bool {
        self.load.is_some() && self.leave_one_out().load_error.is_none()
    }

    /// The name of the skin that was poked.
    pub fn skin(&self) -> &str {
        &self.skin
    }

    /// The locator for single touches.
    pub(super) fn locator(&self) -> &FusedLocator {
        &self.locator
    }

    /// How touches add up, learned from all pokes. `None` if the model locates touches, or with too few pokes.
    ///
    /// # Errors
    /// As [`Superposition::fit`].
    pub(super) fn superposition(&self) -> Result<Option<Superposition>, Error> {
        if self.by_model.is_some() {
            return Ok(None);
        }
        let singles = self.frames.iter().zip(&self.positions_m);
        let singles = singles.map(|(frame, place_m)| LabelledFrame { frame, touches_m: std::slice::from_ref(place_m) });
        let groups = self.groups.iter();
        let groups = groups.map(|group| LabelledFrame { frame: &group.frame, touches_m: &group.touches_m });
        let labelled: Vec<LabelledFrame<'_>> = singles.chain(groups).collect();
        let is_used: Vec<bool> = self.locator.channel_weights().iter().map(|weight| *weight > 0.0).collect();
        Ok(Superposition::fit(&labelled, &is_used)?)
    }

    /// Amplitude that the locator gives a typical poke, over a skin whose shorter side is twice `half_width_m`,
    /// metres. `None` if no poke has an amplitude.
    ///
    /// # Errors
    /// As [`TypicalAmplitude::fit`].
    pub(super) fn typical_amplitude(&self, half_width_m: f64) -> Result<Option<TypicalAmplitude>, Error> {
        let mut scratch = self.locator.scratch();
        let load_share = load_shares(self.loads.as_deref());
        let (mut places_m, mut amplitudes) = (Vec::new(), Vec::new());
        for i in evenly(self.frames.len(), MOST_TYPICAL) {
            // Skip pokes that cannot be located.
            let Ok(located) = self.locator.predict_into(&self.frames[i], &mut scratch) else { continue };
            let amplitude = located.amplitude / load_share(i);
            if amplitude.is_finite() && amplitude > 0.0 {
                places_m.push(self.positions_m[i]);
                amplitudes.push(amplitude);
            }
        }
        if amplitudes.is_empty() {
            return Ok(None);
        }
        Ok(Some(TypicalAmplitude::fit(&places_m, &amplitudes, half_width_m)?))
    }

    /// Number of pokes.
    pub fn pokes(&self) -> usize {
        self.pokes
    }

    /// Positions where more pokes would help most.
    ///
    /// # Errors
    /// A count of zero.
    pub fn suggest_pokes(&self, count: usize) -> Result<Vec<SuggestedPoke>, Error> {
        Ok(self.locator.suggest_pokes(count)?)
    }

    /// The Jacobian measured by the pokes, per unit load (or per poke), on the skin's image grid.
    ///
    /// # Errors
    /// Fewer than three complete pokes.
    pub fn measured_jacobian(&self, prepared: &Prepared) -> Result<MeasuredJacobian, Error> {
        let complete = |index: &usize| self.frames[*index].iter().all(|v| v.is_finite());
        let complete: Vec<usize> = (0..self.frames.len()).filter(complete).collect();
        let chosen: Vec<usize> = evenly(complete.len(), MOST_IN_JACOBIAN).into_iter().map(|i| complete[i]).collect();
        // Loads relative to their mean, so that a typical poke has amplitude 1 with or without loads.
        let share = load_shares(self.loads.as_deref());
        let frames: Vec<Vec<f64>> =
            chosen.iter().map(|&i| self.frames[i].iter().map(|v| v / share(i)).collect()).collect();
        let positions: Vec<Point> = chosen.iter().map(|&i| self.positions_m[i]).collect();
        let lengths = LENGTHS.map(|share| share * prepared.half_width_m());
        Ok(MeasuredJacobian::interpolate(&frames, &positions, &prepared.map.inside_centres_m(), &lengths)?)
    }

    /// The amplitudes below which a frame with this reference shows no touch: see [`TouchStrength::smallest`]. If the
    /// model locates touches, these thresholds are for the touches it does not see, and weak pokes that it does see
    /// are irrelevant.
    pub(super) fn smallest_amplitude(
        &self,
        prepared: &Prepared,
        reference: &Reference,
    ) -> Result<SmallestAmplitude, Error> {
        let noise = (reference.noise_source != NoiseSource::Assumed).then_some(&reference.noise);
        // Noise that is zero everywhere has no amplitude.
        let noise = noise.and_then(|noise| self.locator.predict(noise).ok()).map(|located| SessionNoise {
            amplitude: located.amplitude,
            channels: self.channels,
            is_of_pairs: reference.noise_source == NoiseSource::Pairs,
        });
        let usual_error_m = self.locator.leave_one_out().median_error_m;
        let hold_sigma = prepared.skin.touch.hold_sigma;
        let smallest = self.strength.smallest(hold_sigma, noise, usual_error_m, prepared.half_width_m());
        let placed = if self.by_model.is_some() { smallest.anywhere } else { smallest.placed };
        Ok(SmallestAmplitude { placed, ..smallest })
    }

    /// Checks that this is a calibration of this skin.
    ///
    /// # Errors
    /// Another skin's name or number of channels.
    pub fn check(&self, prepared: &Prepared) -> Result<(), Error> {
        if self.skin != prepared.skin.name || self.channels != prepared.channels() {
            return Err(Error::Frames {
                what: "calibration".into(),
                expected: format!("one of skin {} with {} channels", prepared.skin.name, prepared.channels()),
                got: format!("one of skin {} with {} channels", self.skin, self.channels),
            });
        }
        crate::same_skin::check_print("calibration", (&self.skin, self.skin_sha256.as_deref()), &prepared.skin)
    }

    /// Accepts it for a skin of the same name regardless of its fingerprint.
    pub fn insist(self) -> Self {
        Self { skin_sha256: None, ..self }
    }

    /// Writes the calibration as JSON, atomically.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        dermis_device::write_atomic(path, |out| Ok(serde_json::to_writer(out, self)?))?;
        Ok(())
    }

    /// Reads a calibration.
    ///
    /// # Errors
    /// No such file, not a calibration, a different version, or inconsistent contents.
    pub fn load(path: &Path) -> Result<Self, Error> {
        Self::parse(&dermis_device::instruments::read_bytes(path)?, path)
    }

    /// Reads a calibration from its text; `path` is for messages.
    ///
    /// # Errors
    /// As [`Calibration::load`].
    pub fn parse(text: &[u8], path: &Path) -> Result<Self, Error> {
        let content = |field: String, reason: String| Error::Content { file: path.to_path_buf(), field, reason };
        serde_json::from_slice(text)
            .map_err(|error| content(format!("line {}, column {}", error.line(), error.column()), error.to_string()))
    }
}
