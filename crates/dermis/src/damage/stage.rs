//! The stage itself: the second image, the references that it and the touches are taken against, and what follows from the
//! monitor's events.

use dermis_touch::damage::{Damage, DamageEvent, DamageFrame, DamageMonitor, DamageParams, DamageShape, DamageState};
use dermis_touch::{Baseline, Contact, PixelNoise, ReferenceOrigin, Touch};

use super::healing::HealingMonitor;
use super::released::is_release;
use super::{Crack, CrackModel, CrackScratch, DamageView, Proposal, ProposalReason, estimate_cut, shape_of};
use crate::Error;
use crate::imager::Imager;
use crate::patches::{PatchStage, SheetCut};
use crate::prepare::Prepared;

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
/// Its least number of frames, by weight.
const FEWEST_IN_MEAN: f64 = 12.0;
/// Healing is estimated so often, seconds.
const HEALING_S: f64 = 0.5;
const FEWEST_FOR_HEALING: usize = 8;
/// What is on the skin and begins no touch is looked at so often, seconds, in the mean of at least so many frames: is it a cut?
/// Each look in vain doubles the time to the next, up to the most.
const UNEXPLAINED_S: [f64; 2] = [0.4, 12.8];
const FEWEST_UNEXPLAINED: u32 = 8;
/// It is one if a cut explains so much of the mean's weighted energy, and remains one while it explains so much of a frame's.
const CUT_EXPLAINS: [f64; 2] = [0.9, 0.8];
/// A suspicion is looked at so often, seconds, in the mean of at least so many frames: is it a touch that has gone?
const RELEASE_S: f64 = 0.6;
const FEWEST_FOR_RELEASE: usize = 3;
/// What rests on a damage for so long, no higher than this in the image and without moving farther than this, is not a touch
/// but warmth: heat heals, and makes the sheet more conductive. Published indenters reach 0.7 and more on a cut.
const WARM_S: f64 = 20.0;
const WARM_HEIGHT: f64 = 0.45;
const WARM_TRAVEL_M: f64 = 3e-3;
/// It lies within so much of the damage, metres. What lies there for so long and begins no touch at all is warmth too.
const WARM_REACH_M: f64 = 20e-3;
/// And so is what came on steadily there, however high and wherever it moves: between two looks ([`HEALING_S`]) the readings
/// changed by less than this share of the open cut's response. A press comes on within one.
const STEADY: f64 = 0.25;

/// What one frame has shown.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct DamageVerdict {
    /// The baseline of touches was replaced by one that includes the damage.
    pub adopted: bool,
    /// Something is suspected: the baseline must not follow it.
    pub suspicious: bool,
    /// Damage is in the baseline, which has to follow as it heals.
    pub healing: bool,
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
    /// What touches are made of, and what is not enough to begin one.
    pub contacts: &'a [Contact],
    pub loaded: bool,
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
        // However slow the frames, the mean is one of several.
        let follow = (-(-elapsed_s / MEAN_S).exp_m1()).min(1.0 / FEWEST_IN_MEAN);
        let gain = if self.frames == 1 { 1.0 } else { (1.0 / self.frames as f64).max(follow) };
        if self.frames == 1 {
            self.mean.clear();
            self.mean.extend_from_slice(raw);
        }
        for (mean, &value) in self.mean.iter_mut().zip(raw) {
            *mean = if mean.is_finite() && value.is_finite() { *mean + gain * (value - *mean) } else { value };
        }
    }
}

/// Frames in which something is on the skin that begins no touch. A thin cut raises the image almost as much beside it as it
/// lowers it, because no isotropic conductivity does what a cut does; the rise is taken for something that touches.
#[derive(Debug, Default)]
struct Unexplained {
    since_ns: u64,
    frames: u32,
    wait_s: f64,
    /// Mean change against the intact sheet with what is known of its damage, model volts.
    mean: Vec<f64>,
    /// The response of the cut that it is.
    cut: Option<Vec<f64>>,
}

impl Unexplained {
    fn clear(&mut self) {
        (self.frames, self.wait_s, self.cut) = (0, UNEXPLAINED_S[0], None);
    }
}

/// Something that rests on a damage.
#[derive(Debug)]
struct Warm {
    at_m: [f64; 2],
    since_ns: u64,
    readings: Readings,
}

/// What has come on steadily about a damage.
#[derive(Debug, Default)]
struct Course {
    since_ns: u64,
    readings: Readings,
    /// Change against the intact skin at the last look, model volts.
    last: Vec<f64>,
    /// It went on otherwise than steadily, or elsewhere.
    broken: bool,
}

impl Course {
    /// What is on the skin now begins a new one.
    fn restart(&mut self, time_ns: u64) {
        (self.since_ns, self.readings.frames, self.broken) = (time_ns, 0, false);
    }

    /// Whether a change is near that of the last look, `square` being that of the size to compare with.
    fn goes_on(&self, change: &[f64], square: f64) -> bool {
        if self.last.len() != change.len() {
            return false;
        }
        let both = change.iter().zip(&self.last).map(|(now, last)| now - last);
        let moved: f64 = both.filter(|moved| moved.is_finite()).map(|moved| moved * moved).sum();
        moved <= STEADY * STEADY * square
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
    /// What the fitted cuts make of the channels and of the image, as far as they are open; stale after any has changed.
    known: Vec<f64>,
    known_image: Vec<f32>,
    known_is_stale: bool,
    unexplained: Unexplained,
    image: Vec<f32>,
    noise: Vec<f32>,
    readings: Readings,
    suspicious: bool,
    /// When a suspicion began, or was last looked at.
    looked_ns: u64,
    /// Since when it is known that the baseline was taken under a touch; the intact reference is then what was read after it.
    released_ns: Option<u64>,
    /// What cuts do, where the skin is a sheet that is read by electrodes.
    cracks: Option<CrackModel>,
    scratch: CrackScratch,
    /// Fitted cuts by the damage's identity.
    fitted: Vec<(u64, Crack)>,
    /// What healed cuts have left in the sheet, as joined as they were when they became part of the intact reference.
    scars: Vec<SheetCut>,
    healing: HealingMonitor,
    healing_ns: u64,
    /// Joining of a healed scar, 1/m.
    healed_per_m: f64,
    warm: Option<Warm>,
    course: Course,
    /// Readings where the rest began.
    rest: Vec<f64>,
    rest_since_ns: Option<u64>,
    proposal: Option<Proposal>,
    /// Damage has been confirmed or has grown, and is not in the baseline yet.
    pending: Option<u64>,
    ready: bool,
}

impl DamageStage {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let geometry = prepared.image_geometry();
        let settings = &prepared.skin.damage;
        let half_width = prepared.half_width_m();
        let params = DamageParams {
            begin_sigma: settings.begin_sigma,
            smallest_depth: settings.smallest_depth,
            confirm_s: settings.confirm_s,
            reach_m: 0.1 * half_width,
            point_spread_m: 0.12 * half_width,
            // The last of a scar is hard to tell from the heat that closed it.
            healed_share: 0.3,
            ..DamageParams::default()
        };
        let channels = prepared.channels();
        Ok(Self {
            monitor: DamageMonitor::new(geometry, params)?,
            intact: vec![f64::NAN; channels],
            intact_drift: 1.0,
            intact_record: 0,
            difference: vec![0.0; channels],
            known: vec![0.0; channels],
            known_image: vec![0.0; prepared.map.grid().len()],
            known_is_stale: false,
            unexplained: Unexplained { wait_s: UNEXPLAINED_S[0], ..Unexplained::default() },
            image: vec![f32::NAN; prepared.map.grid().len()],
            noise: Vec::new(),
            suspicious: false,
            looked_ns: 0,
            released_ns: None,
            cracks: prepared.has_cracks().then(|| CrackModel::new(prepared)).transpose()?,
            scratch: CrackScratch::default(),
            fitted: Vec::new(),
            scars: Vec::new(),
            healing: HealingMonitor::default(),
            healing_ns: 0,
            healed_per_m: 1e3 / settings.healed_scar_mm,
            warm: None,
            course: Course::default(),
            readings: Readings { mean: Vec::with_capacity(channels), ..Readings::default() },
            rest: Vec::with_capacity(channels),
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
            self.keep_scars();
            self.monitor.renew();
            let monitor = &self.monitor;
            let stands = |id: u64| monitor.damages().iter().any(|damage| damage.id == id);
            self.fitted.retain(|(id, _)| stands(*id));
            self.healing.retain(stands);
            self.known_is_stale = true;
        }
        self.unexplained.clear();
        self.ready = true;
        (self.rest_since_ns, self.proposal, self.released_ns) = (None, None, None);
    }

    /// What is healed leaves the record with the new reference, and stays in the sheet.
    fn keep_scars(&mut self) {
        let healed = self.monitor.damages().iter().filter(|damage| damage.state == DamageState::Healed);
        for damage in healed {
            let is_fitted = self.fitted.iter().any(|(id, _)| *id == damage.id);
            let state = self.healing.states().iter().find(|state| state.id == damage.id && is_fitted);
            self.scars.extend(state.map(|state| SheetCut {
                ends_m: damage.shape.ends_m(),
                joined_per_m: state.joined * self.healed_per_m,
            }));
        }
    }

    /// The cuts and scars that the baseline of touches includes.
    pub fn cuts(&self) -> Vec<SheetCut> {
        let open = self.monitor.damages().iter().filter(|damage| damage.is_open() && damage.shape.length_m > 0.0);
        let open = open.map(|damage| SheetCut { ends_m: damage.shape.ends_m(), joined_per_m: 0.0 });
        open.chain(self.scars.iter().copied()).collect()
    }

    /// Another operator or other noise is in use.
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
        self.known_is_stale = true;
        self.monitor.restart();
    }

    /// Below this, rises of the touch image are lobes of damage that its baseline does not include.
    pub fn floor(image: &[f32]) -> f64 {
        let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0_f32, f32::min);
        LOBE_SHARE * -f64::from(lowest)
    }

    /// Judges one frame. `patches` are what touches are fitted by, where they are.
    ///
    /// # Errors
    /// Data that cannot be imaged.
    pub fn process(
        &mut self,
        input: &DamageInput<'_>,
        prepared: &Prepared,
        imager: &mut Imager,
        baseline: &mut Baseline,
        patches: Option<&mut PatchStage>,
    ) -> Result<DamageVerdict, Error> {
        let drift = baseline.drift_factor() / self.intact_drift;
        for (channel, value) in self.difference.iter_mut().enumerate() {
            let left_out = input.difference[channel].is_nan();
            let difference = input.scale[channel] * (baseline.raw()[channel] - drift * self.intact[channel]);
            *value = if left_out { f64::NAN } else { difference };
        }
        imager.image(&self.difference, &mut self.image)?;
        self.know(imager)?;
        let loaded = input.loaded && !self.is_cut(input, prepared)?;
        let input = &DamageInput { loaded, ..*input };
        self.monitor.process(&DamageFrame {
            time_ns: input.time_ns,
            image: &self.image,
            noise: PixelNoise::PerPixel(&self.noise),
            touches: input.touches,
            loaded: input.loaded,
            known: (!self.fitted.is_empty()).then_some(&self.known_image),
            classes: None,
        })?;
        let began = std::mem::replace(&mut self.suspicious, self.monitor.is_suspicious());
        if input.loaded || (self.suspicious && !began) {
            // What was before has no part in the mean of what is now.
            self.readings.frames = 0;
            self.looked_ns = input.time_ns;
        }
        let news = |event: &DamageEvent| match event {
            DamageEvent::Begin(damage) => Some(*damage),
            DamageEvent::Update(damage) if damage.state == DamageState::Confirmed => Some(*damage),
            _ => None,
        };
        for index in 0..self.monitor.events().len() {
            if let Some(damage) = news(&self.monitor.events()[index]) {
                let others = self.fitted.iter().any(|(id, _)| *id != damage.id);
                let is_new = matches!(self.monitor.events()[index], DamageEvent::Begin(_));
                // Where the baseline of touches has all the others, the new one is what differs from it.
                let includes = is_new && others && self.pending.is_none();
                self.pending = Some(damage.id);
                self.place(&damage, input, prepared, drift, includes.then_some(baseline.baseline()))?;
            }
        }
        if input.loaded {
            (self.rest_since_ns, self.proposal) = (None, None);
        } else {
            self.readings.take(input.time_ns, baseline.raw());
        }
        self.look_for_release(input, prepared, baseline, patches);
        self.follow_course(input, baseline);
        let adopted = self.adopt(input, baseline)? || self.adopt_warmth(input, baseline)?;
        self.follow_healing(input, prepared, drift);
        if !input.loaded && !adopted {
            self.propose(input.time_ns, baseline);
        }
        let healing = self.pending.is_none() && self.monitor.damages().iter().any(Damage::is_open);
        Ok(DamageVerdict { adopted, suspicious: self.monitor.is_suspicious(), healing })
    }

    /// Mean readings, of the free skin or of a warm one, against the intact one, model volts, NaN where channels are left out.
    fn against_intact(&self, mean: &[f64], input: &DamageInput<'_>, drift: f64) -> Vec<f64> {
        let intact: Vec<f64> = self.intact.iter().map(|value| drift * value).collect();
        mean_difference(mean, &intact, input)
    }

    /// Fits a cut to a new damage, beside those known already: as measured, where readings with those and without the new one
    /// are given, which leaves out what the model makes of them; as modelled otherwise.
    fn place(
        &mut self,
        damage: &Damage,
        input: &DamageInput<'_>,
        prepared: &Prepared,
        drift: f64,
        others: Option<&[f64]>,
    ) -> Result<(), Error> {
        if self.readings.frames == 0 {
            return Ok(());
        }
        let Some(model) = &self.cracks else { return Ok(()) };
        self.fitted.retain(|(id, _)| *id != damage.id);
        self.known_is_stale = true;
        let difference = match others {
            Some(others) => mean_difference(&self.readings.mean, others, input),
            None => {
                let mut difference = self.against_intact(&self.readings.mean, input, drift);
                known_response(model, &self.fitted, &self.healing, &mut self.scratch, &mut self.known);
                difference.iter_mut().zip(&self.known).for_each(|(sum, known)| *sum -= known);
                difference
            }
        };
        let estimate = estimate_cut(prepared, model, &difference, input.noise, &damage.shape)?;
        if let Some(estimate) = estimate.filter(|estimate| estimate.explained >= LEAST_EXPLAINED) {
            self.fitted.push((damage.id, estimate.crack));
            self.healing.watch(damage.id, &estimate.crack, model, prepared);
            self.monitor.refine(damage.id, shape_of(&estimate), None);
        }
        Ok(())
    }

    /// Brings what fitted cuts make of the channels and of the image up to date. `difference` is that of the frame.
    fn know(&mut self, imager: &mut Imager) -> Result<(), Error> {
        if !std::mem::take(&mut self.known_is_stale) {
            return Ok(());
        }
        let Some(model) = &self.cracks else { return Ok(()) };
        known_response(model, &self.fitted, &self.healing, &mut self.scratch, &mut self.known);
        let present = self.known.iter().zip(&self.difference);
        let present: Vec<f64> = present.map(|(known, d)| if d.is_nan() { f64::NAN } else { *known }).collect();
        imager.image(&present, &mut self.known_image)
    }

    /// Whether what is on the skin and begins no touch is a cut: the frame is then one of a free skin.
    fn is_cut(&mut self, input: &DamageInput<'_>, prepared: &Prepared) -> Result<bool, Error> {
        let Some(model) = &self.cracks else { return Ok(false) };
        if !input.loaded || !input.touches.is_empty() {
            self.unexplained.clear();
            return Ok(false);
        }
        let explains = |cut: &[f64], change: &mut dyn Iterator<Item = f64>| {
            explained(change, cut, &prepared.voltages) >= CUT_EXPLAINS[1]
        };
        // The baseline of touches does not include yet what is known by now.
        if self.pending.is_some() && explains(&self.known, &mut self.difference.iter().copied()) {
            return Ok(true);
        }
        let change = || self.difference.iter().zip(&self.known).map(|(difference, known)| difference - known);
        if let Some(cut) = &self.unexplained.cut {
            if explains(cut, &mut change()) {
                return Ok(true);
            }
            self.unexplained.clear();
        }
        let Unexplained { since_ns, frames, wait_s, mean, cut } = &mut self.unexplained;
        if *frames == 0 {
            *since_ns = input.time_ns;
            mean.clear();
            mean.resize(self.difference.len(), 0.0);
        }
        *frames += 1;
        let share = 1.0 / f64::from(*frames);
        mean.iter_mut().zip(change()).for_each(|(mean, change)| *mean += share * (change - *mean));
        let elapsed_s = input.time_ns.saturating_sub(*since_ns) as f64 * 1e-9;
        if elapsed_s < *wait_s || *frames < FEWEST_UNEXPLAINED {
            return Ok(false);
        }
        *frames = 0;
        *wait_s = (2.0 * *wait_s).min(UNEXPLAINED_S[1]);
        let grid = prepared.map.grid();
        let pixels = self.image.iter().enumerate().filter(|(_, value)| value.is_finite());
        let Some((lowest, _)) = pixels.min_by(|a, b| a.1.total_cmp(b.1)) else { return Ok(false) };
        let start = DamageShape {
            centre_m: grid.centre_m(lowest),
            length_m: 0.0,
            width_m: 0.0,
            direction_rad: 0.0,
            deviations: None,
        };
        let estimate = estimate_cut(prepared, model, mean, input.noise, &start)?;
        if let Some(estimate) = estimate.filter(|estimate| estimate.explained >= CUT_EXPLAINS[0]) {
            let mut response = vec![0.0; mean.len()];
            if model.respond(&estimate.crack, &mut self.scratch, &mut response) {
                *cut = Some(response);
            }
        }
        Ok(cut.is_some())
    }

    /// Gathers what is read while something lies on damage and nowhere else.
    fn follow_course(&mut self, input: &DamageInput<'_>, baseline: &Baseline) {
        if !input.loaded {
            self.course.restart(input.time_ns);
            return;
        }
        let places = input.touches.iter().map(|touch| touch.position_m);
        let mut places = places.chain(input.contacts.iter().map(|contact| contact.centroid_m));
        self.course.broken |= !places.all(|at_m| self.lies_on_damage(at_m));
        self.course.readings.take(input.time_ns, baseline.raw());
    }

    /// Whether a place lies on damage, open or healed: a scar is warm for longer than it is open.
    fn lies_on_damage(&self, at_m: [f64; 2]) -> bool {
        self.monitor.damages().iter().any(|damage| damage.shape.distance_m(at_m) <= WARM_REACH_M)
    }

    /// Estimates, now and then, how far fitted cuts have healed.
    fn follow_healing(&mut self, input: &DamageInput<'_>, prepared: &Prepared, drift: f64) {
        if self.healing.states().is_empty() {
            self.course.broken = true;
            self.course.last.clear();
            return;
        }
        if input.time_ns.saturating_sub(self.healing_ns) as f64 * 1e-9 < HEALING_S {
            return;
        }
        self.healing_ns = input.time_ns;
        if input.loaded {
            self.course.broken |= !self.course.goes_on(&self.difference, self.healing.open_square());
            if self.course.broken {
                return;
            }
        }
        self.course.last.clone_from(&self.difference);
        let readings = if input.loaded { &self.course.readings } else { &self.readings };
        if readings.frames < FEWEST_FOR_HEALING {
            return;
        }
        let difference = self.against_intact(&readings.mean, input, drift);
        self.healing.take(input.time_ns, &difference, input.noise, &prepared.voltages, self.healed_per_m);
        self.known_is_stale = true;
        for state in self.healing.states() {
            let damage = self.monitor.damages().iter().find(|damage| damage.id == state.id && damage.is_open());
            if let Some(shape) = damage.map(|damage| damage.shape) {
                self.monitor.refine(state.id, shape, Some(1.0 - state.joined.clamp(0.0, 1.0)));
            }
        }
    }

    /// A suspicion may be a touch that was in the reference and has gone. Then no damage comes of it: it is judged from what is
    /// read now, and a new baseline is proposed, which alone mends the image of touches.
    fn look_for_release(
        &mut self,
        input: &DamageInput<'_>,
        prepared: &Prepared,
        baseline: &Baseline,
        patches: Option<&mut PatchStage>,
    ) {
        let due = input.time_ns.saturating_sub(self.looked_ns) as f64 * 1e-9 >= RELEASE_S;
        let alone = !self.monitor.damages().iter().any(Damage::is_open);
        let seen = alone && self.readings.frames >= FEWEST_FOR_RELEASE && self.monitor.is_suspicious();
        let Some(patches) = patches.filter(|_| due && seen && !input.loaded) else { return };
        self.looked_ns = input.time_ns;
        let drift = baseline.drift_factor() / self.intact_drift;
        let change = self.against_intact(&self.readings.mean, input, drift);
        if is_release(&change, &self.intact, input, prepared, patches) {
            self.intact.copy_from_slice(&self.readings.mean);
            self.intact_drift = baseline.drift_factor();
            self.released_ns = Some(input.time_ns);
            self.monitor.dismiss();
        }
    }

    /// Takes into the baseline what is warmth about a damage and no touch: it has come on steadily, or rests there low, for long.
    fn adopt_warmth(&mut self, input: &DamageInput<'_>, baseline: &mut Baseline) -> Result<bool, Error> {
        let has_lasted = |since_ns: u64| input.time_ns.saturating_sub(since_ns) as f64 * 1e-9 >= WARM_S;
        let reason = "warmth about a damage";
        if input.loaded && !self.course.broken && has_lasted(self.course.since_ns) {
            let readings = &self.course.readings;
            baseline.adopt(input.time_ns, &readings.mean, readings.frames, reason)?;
            self.course.restart(input.time_ns);
            self.warm = None;
            return Ok(true);
        }
        let near = |at_m: [f64; 2]| self.lies_on_damage(at_m);
        let low = |touch: &Touch| touch.amplitude <= WARM_HEIGHT && near(touch.position_m);
        let here = match (input.touches, input.contacts) {
            // Something was there a moment ago: the next frames will tell.
            ([], []) if input.loaded => return Ok(false),
            ([], contacts) if contacts.iter().all(|contact| near(contact.centroid_m)) => {
                contacts.first().map(|contact| contact.centroid_m)
            }
            (touches, _) if touches.iter().all(low) => touches.first().map(|touch| touch.position_m),
            _ => None,
        };
        let Some(here) = here else {
            self.warm = None;
            return Ok(false);
        };
        let stays = |warm: &Warm| (warm.at_m[0] - here[0]).hypot(warm.at_m[1] - here[1]) <= WARM_TRAVEL_M;
        if !self.warm.as_ref().is_some_and(stays) {
            self.warm = Some(Warm { at_m: here, since_ns: input.time_ns, readings: Readings::default() });
        }
        let Some(warm) = &mut self.warm else { return Ok(false) };
        warm.readings.take(input.time_ns, baseline.raw());
        if !has_lasted(warm.since_ns) {
            return Ok(false);
        }
        baseline.adopt(input.time_ns, &warm.readings.mean, warm.readings.frames, reason)?;
        self.warm = None;
        Ok(true)
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
        if let Some(since_ns) = self.released_ns {
            let offset_sigma = deviation(&self.readings.mean, baseline.baseline(), baseline.noise_std());
            self.proposal = Some(Proposal { reason: ProposalReason::Touched, since_ns, offset_sigma });
            return;
        }
        let quiet = self.readings.frames >= 16 && !self.monitor.is_suspicious() && self.monitor.events().is_empty();
        let moved = |from: &[f64]| deviation(&self.readings.mean, from, baseline.noise_std());
        let resting = self.rest_since_ns.filter(|_| quiet && moved(&self.rest) < RESTING);
        let Some(since_ns) = resting else {
            self.proposal = None;
            self.rest_since_ns = quiet.then_some(time_ns);
            self.rest.clear();
            self.rest.extend_from_slice(&self.readings.mean);
            return;
        };
        let offset_sigma = moved(baseline.baseline());
        let rested = time_ns.saturating_sub(since_ns) as f64 * 1e-9 >= REST_S;
        let healed = self.monitor.damages().iter().any(|damage| damage.state == DamageState::Healed);
        let settled = self.healing.states().iter().all(|state| state.settled);
        let reason = if healed { ProposalReason::Healed } else { ProposalReason::Offset };
        let useful = offset_sigma >= OFF || healed;
        self.proposal = (rested && settled && useful).then_some(Proposal { reason, since_ns, offset_sigma });
    }

    /// What is known now.
    pub fn view<'a>(&'a self, baseline: &'a Baseline) -> DamageView<'a> {
        DamageView {
            now_ns: 0,
            watched: self.ready,
            damages: self.monitor.damages(),
            events: self.monitor.events(),
            image: &self.image,
            baselines: baseline.records(),
            intact: self.ready.then_some(self.intact_record),
            healing: self.healing.states(),
            proposal: self.proposal,
            drift: baseline.drift_factor() - 1.0,
        }
    }
}

/// Mean readings against others, model volts, NaN where channels are left out.
fn mean_difference(mean: &[f64], from: &[f64], input: &DamageInput<'_>) -> Vec<f64> {
    let change = |(channel, scale): (usize, &f64)| {
        let left_out = input.difference[channel].is_nan();
        if left_out { f64::NAN } else { scale * (mean[channel] - from[channel]) }
    };
    input.scale.iter().enumerate().map(change).collect()
}

/// Response of all fitted cuts together, each as far as it is still open.
fn known_response(
    model: &CrackModel,
    fitted: &[(u64, Crack)],
    healing: &HealingMonitor,
    scratch: &mut CrackScratch,
    known: &mut [f64],
) {
    known.fill(0.0);
    let mut response = vec![0.0; known.len()];
    for (id, crack) in fitted {
        let left = healing.states().iter().find(|state| state.id == *id).map_or(1.0, |state| state.left);
        if model.respond(crack, scratch, &mut response) {
            known.iter_mut().zip(&response).for_each(|(sum, change)| *sum += left * change);
        }
    }
}

/// Share of a change's energy (missing channels `NaN`) that a cut explains, together with a change of all resting voltages by
/// the same share.
fn explained(change: &mut dyn Iterator<Item = f64>, cut: &[f64], rest: &[f64]) -> f64 {
    let (mut energy, mut left, mut along, mut square) = (0.0, 0.0, 0.0, 0.0);
    for ((change, cut), rest) in change.zip(cut).zip(rest).filter(|((change, _), _)| change.is_finite()) {
        let difference = change - cut;
        energy += change * change;
        left += difference * difference;
        along += difference * rest;
        square += rest * rest;
    }
    if square > 0.0 && energy > 0.0 { 1.0 - (left - along * along / square) / energy } else { 0.0 }
}

/// Root mean square over the channels of how far means are from other readings, in standard deviations.
fn deviation(means: &[f64], from: &[f64], noise_std: &[f64]) -> f64 {
    let (mut sum, mut noise) = (0.0, 0.0);
    for ((mean, from), sigma) in means.iter().zip(from).zip(noise_std) {
        if (mean + from + sigma).is_finite() {
            sum += (mean - from).powi(2);
            noise += sigma * sigma;
        }
    }
    if noise > 0.0 { (sum / noise).sqrt() } else { 0.0 }
}
