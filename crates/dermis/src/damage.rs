//! Damage in the live pipeline: each frame is imaged a second time, against the intact skin, and
//! [`dermis_touch::damage`] tells from that image what is damaged. Once a damage is believed, touches are found against a
//! baseline that includes it; the intact reference stays as it was until nothing is damaged any more. When the skin has
//! rested for long enough at other values than its baseline's, a new baseline is proposed, never taken.

mod crack;
mod fit;

use dermis_touch::damage::{
    ClassProbabilities, Damage, DamageEvent, DamageFrame, DamageMonitor, DamageParams, DamageShape, DamageState,
};
use dermis_touch::{Baseline, ImageGeometry, PixelNoise, ReferenceOrigin, ReferenceRecord, Touch};

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::skin::Modality;

pub use crack::{Crack, CrackModel, CrackScratch};
pub use fit::CutEstimate;

/// A fit that explains less of the data's energy is not believed: what is damaged is no cut.
const LEAST_EXPLAINED: f64 = 0.7;
/// Rises of the touch image below this part of its deepest fall are lobes of damage not yet in the baseline. The lobes of a
/// cut reach 0.62 of its fall on the sandwich's twin, the falls about a press 0.13 of its rise.
const LOBE_SHARE: f64 = 0.8;
/// Rest that a proposal wants, seconds.
const REST_S: f64 = 30.0;
/// Readings that moved by less than this many standard deviations (root mean square over the channels, of means) rest.
const RESTING: f64 = 0.5;
/// A baseline that is off by less than this is good enough, in the same terms.
const OFF: f64 = 1.0;
/// Time constant of the mean readings, seconds.
const MEAN_S: f64 = 0.4;

/// Why a new baseline is proposed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProposalReason {
    /// The skin rests at other values than its baseline's.
    Offset,
    /// So it does, after damage has healed or while it heals no further.
    Healed,
}

impl ProposalReason {
    /// The word for it in files and streams.
    pub fn name(self) -> &'static str {
        match self {
            Self::Offset => "offset",
            Self::Healed => "healed",
        }
    }
}

/// A new baseline would do the skin good: it has rested, without touch and without change of damage. Taking it is left to
/// a tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// Why.
    pub reason: ProposalReason,
    /// Since when the skin has rested, on the frames' axis, nanoseconds.
    pub since_ns: u64,
    /// How far the readings are from the baseline, in standard deviations of the channels (root mean square).
    pub offset_sigma: f64,
}

/// All that is known of damage and baselines in a frame. Empty where damage is not watched.
#[derive(Clone, Copy, Debug, Default)]
pub struct DamageView<'a> {
    /// True where damage is watched and there is a baseline.
    pub watched: bool,
    /// Time of the frame on the axis that all times here are on, nanoseconds.
    pub now_ns: u64,
    /// All damages, suspected and healed ones included.
    pub damages: &'a [Damage],
    /// What happened to them in this frame.
    pub events: &'a [DamageEvent],
    /// The image against the intact skin, as the image of touches; empty where not watched.
    pub image: &'a [f32],
    /// Baselines that were in use, oldest first; the last is in use now.
    pub baselines: &'a [ReferenceRecord],
    /// Which of them damage is judged against.
    pub intact: Option<usize>,
    /// A new baseline is proposed.
    pub proposal: Option<Proposal>,
    /// Change of the readings as a whole since the start that was followed as drift, a share.
    pub drift: f64,
}

impl DamageView<'_> {
    /// True where there is nothing to tell: no damage, event or proposal.
    pub fn is_silent(&self) -> bool {
        self.damages.iter().all(|damage| damage.state == DamageState::Suspected)
            && self.events.is_empty()
            && self.proposal.is_none()
    }
}

/// What happened to a damage, for people: `damage 1 (20 mm at 23, 24 mm, 37 degrees) is covered by a touch`.
pub fn told(event: &DamageEvent) -> String {
    let damage = event.damage();
    let shape = &damage.shape;
    let [x_mm, y_mm] = shape.centre_m.map(|metres| 1e3 * metres);
    let (length_mm, degrees) = (1e3 * shape.length_m, shape.direction_rad.to_degrees());
    let left = 100.0 * damage.share;
    let what = match event {
        DamageEvent::Begin(_) => "is new".to_owned(),
        DamageEvent::Update(_) if damage.state == DamageState::Healing => format!("heals, {left:.0} % of it is left"),
        DamageEvent::Update(_) => "has grown or opened again".to_owned(),
        DamageEvent::Covered(_) => "is covered by a touch".to_owned(),
        DamageEvent::Uncovered(_) => "is free again".to_owned(),
        DamageEvent::Healed(_) => format!("is healed, {left:.0} % of it is left"),
    };
    format!("damage {} ({length_mm:.0} mm at {x_mm:.0}, {y_mm:.0} mm, {degrees:.0} degrees) {what}", damage.id)
}

/// Fits a cut to difference data against the intact skin (model volts, NaN where missing, of standard deviations `noise`):
/// its middle, direction and length with their covariance. `start` is where the image has it. None where none fits.
///
/// # Errors
/// Data or noise of another length than the skin's channels.
pub fn estimate_cut(
    prepared: &Prepared,
    model: &CrackModel,
    difference: &[f64],
    noise: &[f64],
    start: &DamageShape,
) -> Result<Option<CutEstimate>, Error> {
    let channels = prepared.channels();
    for (what, values) in [("difference data", difference), ("noise", noise)] {
        if values.len() != channels {
            let (expected, got) = (format!("{channels} values"), values.len().to_string());
            return Err(Error::Frames { what: what.into(), expected, got });
        }
    }
    let data = fit::CutData { model, difference, noise, rest: &prepared.voltages };
    // The image's middle is off by up to half a cut's length and some.
    Ok(fit::fit(&data, start.centre_m, 0.4 * prepared.half_width_m(), 0.0))
}

/// The shape of a fitted cut.
pub fn shape_of(estimate: &CutEstimate) -> DamageShape {
    let Crack { centre_m, length_m, direction_rad, .. } = estimate.crack;
    DamageShape { centre_m, length_m, width_m: 0.0, direction_rad, deviations: Some(estimate.deviations()) }
}

/// What one frame has shown.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DamageVerdict {
    /// The baseline of touches was replaced by one that includes the damage.
    pub adopted: bool,
    /// Something is suspected: the baseline must not follow it.
    pub suspicious: bool,
}

/// The stage's view of a frame.
pub(crate) struct DamageInput<'a> {
    pub time_ns: u64,
    /// Difference data against the touch baseline, model volts, NaN where channels are left out.
    pub difference: &'a [f64],
    pub scale: &'a [f64],
    /// Standard deviations of the channels, model volts.
    pub noise: &'a [f64],
    pub touches: &'a [Touch],
    pub loaded: bool,
    pub classes: Option<ClassProbabilities<'a>>,
}

/// Mean of the readings over free frames.
#[derive(Debug, Default)]
struct Readings {
    mean: Vec<f64>,
    frames: usize,
    last_ns: u64,
}

impl Readings {
    fn take(&mut self, time_ns: u64, raw: &[f64]) {
        let elapsed_s = time_ns.saturating_sub(self.last_ns) as f64 * 1e-9;
        self.last_ns = time_ns;
        self.frames += 1;
        let gain = if self.frames == 1 { 1.0 } else { (1.0 / self.frames as f64).max(-(-elapsed_s / MEAN_S).exp_m1()) };
        if self.frames == 1 {
            self.mean.clear();
            self.mean.extend_from_slice(raw);
        }
        for (mean, &value) in self.mean.iter_mut().zip(raw) {
            *mean = if mean.is_finite() && value.is_finite() { *mean + gain * (value - *mean) } else { value };
        }
    }
}

/// The monitor of a skin, the reference it judges by, and the rest that proposals wait for.
#[derive(Debug)]
pub(crate) struct DamageStage {
    monitor: DamageMonitor,
    /// Readings of the intact skin, and the drift that was followed when they were taken.
    intact: Vec<f64>,
    intact_drift: f64,
    intact_record: usize,
    difference: Vec<f64>,
    image: Vec<f32>,
    noise: Vec<f32>,
    readings: Readings,
    suspicious: bool,
    /// What cuts do, where the skin is a sheet that is read by electrodes.
    cracks: Option<CrackModel>,
    scratch: CrackScratch,
    /// Fitted cuts by the damage's identity.
    fitted: Vec<(u64, Crack)>,
    /// Readings and drift where the rest began.
    rest: Vec<f64>,
    rest_drift: f64,
    rest_since_ns: Option<u64>,
    proposal: Option<Proposal>,
    /// Damage has been confirmed or has grown, and is not in the baseline yet.
    pending: Option<u64>,
    ready: bool,
}

impl DamageStage {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let grid = prepared.map.grid();
        let geometry = ImageGeometry {
            columns: grid.columns,
            rows: grid.rows,
            pixel_m: grid.pixel_m,
            left_m: grid.left_m,
            top_m: grid.top_m,
        };
        let settings = &prepared.skin.damage;
        let half_width = prepared.half_width_m();
        let params = DamageParams {
            begin_sigma: settings.begin_sigma,
            smallest_depth: settings.smallest_depth,
            confirm_s: settings.confirm_s,
            reach_m: 0.1 * half_width,
            point_spread_m: 0.12 * half_width,
            ..DamageParams::default()
        };
        let channels = prepared.channels();
        Ok(Self {
            monitor: DamageMonitor::new(geometry, params)?,
            intact: vec![f64::NAN; channels],
            intact_drift: 1.0,
            intact_record: 0,
            difference: vec![0.0; channels],
            image: vec![f32::NAN; grid.len()],
            noise: Vec::new(),
            suspicious: false,
            cracks: prepared.has_cracks().then(|| CrackModel::new(prepared)).transpose()?,
            scratch: CrackScratch::default(),
            fitted: Vec::new(),
            readings: Readings { mean: Vec::with_capacity(channels), ..Readings::default() },
            rest: Vec::with_capacity(channels),
            rest_drift: 1.0,
            rest_since_ns: None,
            proposal: None,
            pending: None,
            ready: false,
        })
    }

    /// A new baseline stands. It becomes the intact reference only where nothing is damaged or suspected: re-zeroing never
    /// hides damage.
    pub fn renew(&mut self, baseline: &Baseline, noise: Vec<f32>) {
        self.noise = noise;
        let adopted = baseline.records().last().is_some_and(|record| record.origin == ReferenceOrigin::Damage);
        if !self.ready || (!adopted && self.monitor.is_intact()) {
            self.intact.copy_from_slice(baseline.baseline());
            self.intact_drift = baseline.drift_factor();
            self.intact_record = baseline.records().len().saturating_sub(1);
            self.monitor.renew();
            let monitor = &self.monitor;
            self.fitted.retain(|(id, _)| monitor.damages().iter().any(|damage| damage.id == *id));
        }
        self.ready = true;
        (self.rest_since_ns, self.proposal) = (None, None);
    }

    /// Another operator or other noise is in use.
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
        self.monitor.restart();
    }

    /// Below this, rises of the touch image are lobes of damage that its baseline does not include.
    pub fn floor(image: &[f32]) -> f64 {
        let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0_f32, f32::min);
        LOBE_SHARE * -f64::from(lowest)
    }

    /// Judges one frame.
    ///
    /// # Errors
    /// Data that cannot be imaged.
    pub fn process(
        &mut self,
        input: &DamageInput<'_>,
        prepared: &Prepared,
        imager: &mut Imager,
        baseline: &mut Baseline,
    ) -> Result<DamageVerdict, Error> {
        let drift = baseline.drift_factor() / self.intact_drift;
        for (channel, value) in self.difference.iter_mut().enumerate() {
            let left_out = input.difference[channel].is_nan();
            let difference = input.scale[channel] * (baseline.raw()[channel] - drift * self.intact[channel]);
            *value = if left_out { f64::NAN } else { difference };
        }
        imager.image(&self.difference, &mut self.image)?;
        self.monitor.process(&DamageFrame {
            time_ns: input.time_ns,
            image: &self.image,
            noise: PixelNoise::PerPixel(&self.noise),
            touches: input.touches,
            loaded: input.loaded,
            classes: input.classes,
        })?;
        let began = std::mem::replace(&mut self.suspicious, self.monitor.is_suspicious());
        if input.loaded || (self.suspicious && !began) {
            // What was before has no part in the mean of what is now.
            self.readings.frames = 0;
        }
        let news = |event: &DamageEvent| match event {
            DamageEvent::Begin(damage) => Some(*damage),
            DamageEvent::Update(damage) if damage.state == DamageState::Confirmed => Some(*damage),
            _ => None,
        };
        for index in 0..self.monitor.events().len() {
            if let Some(damage) = news(&self.monitor.events()[index]) {
                self.pending = Some(damage.id);
                self.place(&damage, input, prepared, drift)?;
            }
        }
        if input.loaded {
            (self.rest_since_ns, self.proposal) = (None, None);
        } else {
            self.readings.take(input.time_ns, baseline.raw());
        }
        let adopted = self.adopt(input, baseline)?;
        if !input.loaded && !adopted {
            self.propose(input.time_ns, baseline);
        }
        Ok(DamageVerdict { adopted, suspicious: self.monitor.is_suspicious() })
    }

    /// Fits a cut to a new damage, beside those known already.
    fn place(
        &mut self,
        damage: &Damage,
        input: &DamageInput<'_>,
        prepared: &Prepared,
        drift: f64,
    ) -> Result<(), Error> {
        let Some(model) = self.cracks.as_ref().filter(|_| self.readings.frames > 0) else { return Ok(()) };
        let mean = |(channel, scale): (usize, &f64)| {
            let change = scale * (self.readings.mean[channel] - drift * self.intact[channel]);
            if input.difference[channel].is_nan() { f64::NAN } else { change }
        };
        let mut difference: Vec<f64> = input.scale.iter().enumerate().map(mean).collect();
        self.fitted.retain(|(id, _)| *id != damage.id);
        let mut response = vec![0.0; difference.len()];
        for (_, crack) in &self.fitted {
            if model.respond(crack, &mut self.scratch, &mut response) {
                difference.iter_mut().zip(&response).for_each(|(sum, change)| *sum -= change);
            }
        }
        let estimate = estimate_cut(prepared, model, &difference, input.noise, &damage.shape)?;
        if let Some(estimate) = estimate.filter(|estimate| estimate.explained >= LEAST_EXPLAINED) {
            self.fitted.push((damage.id, estimate.crack));
            self.monitor.refine(damage.id, shape_of(&estimate), None);
        }
        Ok(())
    }

    /// Takes the readings as the baseline of touches once they include a damage that is believed.
    fn adopt(&mut self, input: &DamageInput<'_>, baseline: &mut Baseline) -> Result<bool, Error> {
        let settled = self.readings.frames as f64 >= 8.0 && !self.monitor.is_suspicious();
        let Some(id) = self.pending.filter(|_| settled && !input.loaded) else { return Ok(false) };
        self.pending = None;
        baseline.adopt(input.time_ns, &self.readings.mean, self.readings.frames, &format!("includes damage {id}"))?;
        Ok(true)
    }

    /// Watches the rest that a proposal wants.
    fn propose(&mut self, time_ns: u64, baseline: &Baseline) {
        let quiet = self.readings.frames >= 16 && !self.monitor.is_suspicious() && self.monitor.events().is_empty();
        let drift = baseline.drift_factor();
        let moved = |from: &[f64], factor: f64| {
            let (mut sum, mut noise) = (0.0, 0.0);
            let channels = self.readings.mean.iter().zip(from).zip(baseline.noise_std());
            for ((mean, from), sigma) in channels.filter(|((m, f), s)| m.is_finite() && f.is_finite() && s.is_finite())
            {
                sum += (mean - factor * from).powi(2);
                noise += sigma * sigma;
            }
            if noise > 0.0 { (sum / noise).sqrt() } else { 0.0 }
        };
        let resting = self.rest_since_ns.filter(|_| quiet && moved(&self.rest, drift / self.rest_drift) < RESTING);
        let Some(since_ns) = resting else {
            self.proposal = None;
            self.rest_since_ns = quiet.then_some(time_ns);
            self.rest.clear();
            self.rest.extend_from_slice(&self.readings.mean);
            self.rest_drift = drift;
            return;
        };
        let offset_sigma = moved(baseline.baseline(), 1.0);
        let rested = time_ns.saturating_sub(since_ns) as f64 * 1e-9 >= REST_S;
        let healed = |damage: &Damage| matches!(damage.state, DamageState::Healing | DamageState::Healed);
        let reason =
            if self.monitor.damages().iter().any(healed) { ProposalReason::Healed } else { ProposalReason::Offset };
        self.proposal = (rested && offset_sigma >= OFF).then_some(Proposal { reason, since_ns, offset_sigma });
    }

    /// What is known now.
    pub fn view<'a>(&'a self, baseline: &'a Baseline) -> DamageView<'a> {
        DamageView {
            watched: self.ready,
            now_ns: 0,
            damages: self.monitor.damages(),
            events: self.monitor.events(),
            image: &self.image,
            baselines: baseline.records(),
            intact: self.ready.then_some(self.intact_record),
            proposal: self.proposal,
            drift: baseline.drift_factor() - 1.0,
        }
    }
}

impl Prepared {
    /// Whether cuts can be fitted: on flat sheets that electrodes read as they are.
    fn has_cracks(&self) -> bool {
        self.skin.modality == Modality::Eit && self.skin.backend.circuit.is_none() && self.skin.frontend.bend.is_none()
    }
}
