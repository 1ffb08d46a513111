//! Fits patches to frames, one after the other.

use std::f64::consts::PI;

use dermis_tomo::eit::contacts::{ContactFit, ContactPatch, FitOptions, PatchFit};
use dermis_touch::{Contact, ContactStrength};

use super::gathered::Gathered;
use super::plausible::{BELIEVED, most_radius_m, plausible};
use super::seek::{Outcome, Seek, Tools};
use super::sheets::{CutSheets, SheetCut, Sheets};
use super::touch_rule::TouchRule;
use super::whitening::{Channels, Whitened};
use crate::Error;
use crate::prepare::Prepared;
use crate::stages::drift::Drift;

/// A fit that continues from the last frame is also accepted up to this factor of the last misfit.
const WORSENED: f64 = 1.5;
/// Pause after a failed search, nanoseconds: initial and maximum. It doubles with each further failure.
const PAUSE_NS: [u64; 2] = [30_000_000, 450_000_000];
/// Prior standard deviations of the logarithms of radius and conductance.
const LOG_DEVIATIONS: [f64; 2] = [0.5, 0.5];
/// A peak this many times as high as the image's lowest value is deep counts as a touch by itself.
const OUTSTANDING: f64 = 2.0;
/// Least time between two fits, nanoseconds. In that time, presses by hand or robot move less than the uncertainty of
/// their position.
const INTERVAL_NS: u64 = 5_000_000;
/// Shortest time between frames for which a search gets its full share, nanoseconds. With faster frames it gets the
/// share of this time.
const LEAST_NS: f64 = 500_000.0;
/// Cost of a step of a fit of one patch, nanoseconds of one core. A step of a fit of n patches takes n squared times
/// as long.
const STEP_NS: f64 = 0.4e6;
/// The baseline is frozen while something touches the skin. In that time all voltages may drift together by this
/// share per second: 2 % in ten minutes.
const DRIFT_PER_S: f64 = 0.02 / 600.0;
/// Steps of a fit that continues from the last frame, and the largest number for a fit that starts from the result of
/// a search, if the frame's time budget allows.
const STEPS: [usize; 2] = [4, 15];
/// Share of the time between frames that a search may take.
const SEARCH_SHARE: f64 = 0.5;

/// A press that is part of the baseline has ended if a press of opposite sign explains this share of a frame, and the
/// frame's mean square in squared deviations exceeds the second value. After a failed look, wait the third, in
/// frames.
const GONE_SHARE: f64 = 0.8;
const GONE_ENERGY: f64 = 4.0;
const GONE_WAIT: u32 = 8;

/// The patches of the last frame.
#[derive(Debug)]
struct Followed {
    fits: Vec<ContactFit>,
    /// State of their fit.
    standing: Option<PatchFit>,
    misfit: f64,
    /// Contacts of the last fit.
    shown: Vec<Contact>,
    /// Change of the channels due to these patches, model volts. It applies to the frames since the last fit, while
    /// the patches are accepted.
    explained: Vec<f64>,
}

/// The search in progress, and the pause before the next.
#[derive(Debug)]
struct Search {
    seek: Option<Seek>,
    /// Earliest time of the next search, and length of the next pause.
    pause_until_ns: u64,
    next_pause_ns: u64,
}

impl Followed {
    fn nothing() -> Self {
        Self { fits: Vec::new(), standing: None, misfit: f64::INFINITY, shown: Vec::new(), explained: Vec::new() }
    }
}

impl Search {
    fn restarted() -> Self {
        Self { seek: None, pause_until_ns: 0, next_pause_ns: PAUSE_NS[0] }
    }

    /// Allows the next search at once.
    fn restart(&mut self) {
        (self.pause_until_ns, self.next_pause_ns) = (0, PAUSE_NS[0]);
    }
}

/// Fits patches to frames, one after the other.
#[derive(Debug)]
pub(crate) struct PatchStage {
    sheets: CutSheets,
    rule: TouchRule,
    options: FitOptions,
    channels: Channels,
    whitened: Whitened,
    left: Vec<f64>,
    followed: Followed,
    gathered: Gathered,
    search: Search,
    gone: GoneLook,
    drift: Drift,
    seen_ns: Option<u64>,
    /// Time between the last two frames, nanoseconds.
    interval_ns: f64,
    /// True if each frame waits for its whole search, instead of leaving the rest to later frames.
    is_unhurried: bool,
    /// Time at which the skin was first touched, while it still is.
    touched_ns: Option<u64>,
    /// Time that a search may take in this frame, nanoseconds of one core.
    share_ns: f64,
    /// Number of sheets that have been in use.
    sheets_used: u64,
}

/// Detection of presses that are part of the baseline but have ended.
#[derive(Debug, Default)]
struct GoneLook {
    look: Option<ReleaseLook>,
    is_sure: bool,
    /// Frames until the next look.
    wait: u32,
}

/// A test in progress of whether a change comes from touches that have ended.
#[derive(Debug)]
pub(crate) struct ReleaseLook {
    seek: Seek,
    /// Mean square of the change, in squared deviations.
    energy: f64,
    /// Number of the sheets used for this test.
    sheets_used: u64,
}

/// Result of such a test in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Released {
    /// The test isn't finished.
    UnderWay,
    /// The test gave no result.
    Unknown,
    /// Touches of the opposite sign explain this share of the change's weighted energy.
    Share(f64),
}

impl PatchStage {
    /// A stage for this noise of the channels (model volts).
    pub(crate) fn new(prepared: &Prepared, noise: &[f64]) -> Result<Self, Error> {
        let touch = &prepared.skin.touch;
        let typical = ContactPatch {
            position_m: [0.0; 2],
            radius_m: 2.0 * touch.relative_size * prepared.half_width_m(),
            conductance_s_per_m2: touch.contact_s_per_m2,
        };
        Ok(Self {
            sheets: CutSheets::new(prepared, typical)?,
            rule: TouchRule::new(prepared),
            options: FitOptions {
                radius_m: typical.radius_m,
                radius_log_deviation: LOG_DEVIATIONS[0],
                most_radius_m: most_radius_m(prepared.half_width_m()),
                conductance_s_per_m2: typical.conductance_s_per_m2,
                conductance_log_deviation: LOG_DEVIATIONS[1],
                gain_deviation: 0.0,
                most_steps: STEPS[0],
            },
            channels: Channels::new(noise),
            whitened: Whitened::default(),
            left: Vec::new(),
            followed: Followed::nothing(),
            gathered: Gathered::default(),
            search: Search::restarted(),
            gone: GoneLook::default(),
            drift: Drift::new(prepared),
            seen_ns: None,
            interval_ns: f64::INFINITY,
            is_unhurried: false,
            touched_ns: None,
            share_ns: LEAST_NS,
            sheets_used: 1,
        })
    }

    /// Number of frames that had to wait for sheets with new cuts.
    pub(crate) fn waits(&self) -> u64 {
        self.sheets.waits()
    }

    /// Resets to the initial state with this noise of the channels (model volts), keeping the sheet.
    pub(crate) fn renew(&mut self, noise: &[f64]) {
        self.channels = Channels::new(noise);
        self.whitened = Whitened::default();
        self.left.clear();
        self.followed = Followed::nothing();
        self.gathered = Gathered::default();
        self.search = Search::restarted();
        self.gone = GoneLook::default();
        self.drift.forget();
        (self.seen_ns, self.touched_ns, self.interval_ns) = (None, None, f64::INFINITY);
    }

    /// From now on, finishes the search in each frame, however long it takes.
    pub(crate) fn take_time(&mut self) {
        self.is_unhurried = true;
    }

    /// Replaces the noise of the channels (model volts).
    pub(crate) fn set_noise(&mut self, noise: &[f64]) {
        self.channels.set_noise(noise);
    }

    /// Sets the cuts of the sheet. They take effect after three seconds of frame time, as the Green's function must
    /// be recomputed. Does nothing if the sheet has the same cuts already.
    pub(crate) fn set_cuts(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        self.sheets.order(time_ns, cuts);
    }

    /// True while a search for touches is in progress.
    pub(crate) fn is_seeking(&self) -> bool {
        self.search.seek.is_some()
    }

    /// Leaves out these channels from now on.
    pub(crate) fn leave_out(&mut self, channels: &[u32]) {
        self.channels.leave_out(channels);
    }

    /// Forgets the last frame: the next is unrelated to it.
    pub(crate) fn forget(&mut self) {
        self.let_go();
        self.touched_ns = None;
    }

    /// Stops following patches and allows the next search at once.
    pub(crate) fn let_go(&mut self) {
        self.followed.fits.clear();
        self.followed.shown.clear();
        self.gathered.count = 0;
        self.search.seek = None;
        self.search.restart();
    }

    /// Replaces the contacts of an image by patches fitted to its frame (model volts), or by those of the last fit if
    /// that was only a moment ago. If patches don't explain the frame, the image's contacts stay, but they start no
    /// touch unless one stands out clearly. `lowest` is the lowest value of the image.
    ///
    /// # Errors
    /// A sheet with new cuts that cannot be meshed or solved.
    pub(crate) fn refine(
        &mut self,
        time_ns: u64,
        difference: &[f64],
        lowest: f64,
        contacts: &mut Vec<Contact>,
    ) -> Result<(), Error> {
        if self.sheets.take_up(time_ns)? {
            self.sheets_used += 1;
            self.let_go();
        }
        if self.drift.observe(time_ns, !self.followed.shown.is_empty()) {
            self.channels.set_drift(self.drift.deviations(&vec![0.0; difference.len()]));
        }
        if self.drift.age_s > 0.0 && self.followed.shown.is_empty() && self.is_drift(difference) {
            contacts.clear();
        }
        self.refine_contacts(time_ns, difference, lowest, contacts);
        self.look_for_gone(difference);
        Ok(())
    }

    /// True if noise and drift explain a frame.
    fn is_drift(&self, difference: &[f64]) -> bool {
        let absent = self.channels.absent();
        let present = difference.iter().zip(absent).map(|(value, absent)| if *absent { f64::NAN } else { *value });
        self.drift.explains(present, self.channels.noise())
    }

    /// Tests whether a frame that patches don't explain comes from the end of a press that is part of the baseline.
    fn look_for_gone(&mut self, difference: &[f64]) {
        if !self.followed.shown.is_empty() || self.search.seek.is_some() {
            self.gone.look = None;
            return;
        }
        let look = match self.gone.look.take() {
            Some(look) => Some(look),
            None if self.gone.wait > 0 && !self.is_unhurried => {
                self.gone.wait -= 1;
                None
            }
            None => self.look_for_release(difference).filter(|look| look.energy > GONE_ENERGY),
        };
        let Some(mut look) = look else { return };
        match self.go_on_looking(&mut look) {
            Released::UnderWay => self.gone.look = Some(look),
            Released::Share(share) if share >= GONE_SHARE => self.gone.is_sure = true,
            Released::Share(_) | Released::Unknown => self.gone.wait = GONE_WAIT,
        }
    }

    /// True if a press that is part of the baseline has ended; reported once.
    pub(crate) fn take_gone(&mut self) -> bool {
        std::mem::take(&mut self.gone.is_sure)
    }

    fn refine_contacts(&mut self, time_ns: u64, difference: &[f64], lowest: f64, contacts: &mut Vec<Contact>) {
        // The time budget of a search follows the frame interval. A single long gap doesn't count, since the frames
        // behind it are already queued. The first frame has no limit.
        let since_ns = self.seen_ns.replace(time_ns).map_or(f64::INFINITY, |seen| time_ns.saturating_sub(seen) as f64);
        let usual_ns = since_ns.min(self.interval_ns);
        self.interval_ns = since_ns;
        self.share_ns = if self.is_unhurried { f64::INFINITY } else { SEARCH_SHARE * usual_ns.max(LEAST_NS) };
        self.left.clear();
        self.left.extend_from_slice(difference);
        if contacts.is_empty() {
            self.let_go();
            self.touched_ns = None;
            return;
        }
        let touched_ns = time_ns.saturating_sub(*self.touched_ns.get_or_insert(time_ns));
        self.options.gain_deviation = DRIFT_PER_S * touched_ns as f64 * 1e-9;
        if difference.len() != self.channels.absent().len() || difference.iter().any(|v| !v.is_finite()) {
            self.followed.fits.clear();
            self.followed.shown.clear();
            self.gathered.count = 0;
            return;
        }
        if !self.followed.shown.is_empty() {
            self.gathered.add(difference);
            let since_ns = self.gathered.fitted_ns.map_or(u64::MAX, |fitted_ns| time_ns.saturating_sub(fitted_ns));
            if since_ns < INTERVAL_NS {
                self.left.iter_mut().zip(&self.followed.explained).for_each(|(left, explained)| *left -= explained);
                contacts.clone_from(&self.followed.shown);
                return;
            }
            self.left.clear();
            let mean = self.gathered.mean();
            self.left.extend_from_slice(mean);
        }
        self.refine_now(time_ns, lowest, contacts);
    }

    /// Like [`PatchStage::refine`], for the frame in `left`.
    fn refine_now(&mut self, time_ns: u64, lowest: f64, contacts: &mut Vec<Contact>) {
        // Too weak to start a touch, and no touch is being followed that it could belong to.
        let Contact { significance, strength, .. } = contacts[0];
        if self.followed.fits.is_empty() && self.followed.shown.is_empty() && strength != ContactStrength::Strong {
            return;
        }
        self.channels.weigh(&self.left, &mut self.whitened);
        if !self.follow(STEPS[0]) && !self.search(time_ns) {
            self.followed.fits.clear();
            if self.search.seek.is_some() && !self.followed.shown.is_empty() {
                // While a search finds out what changed, for a few frames at most, keep the previous contacts.
                contacts.clone_from(&self.followed.shown);
                return;
            }
            self.followed.shown.clear();
            if self.search.seek.is_none() && contacts[0].amplitude > OUTSTANDING * -lowest {
                // A press on a cut looks like this: the image can show only one touch.
                contacts.truncate(1);
            } else {
                // These are side lobes of damage, or touches that are only just starting. Nothing starts, but
                // existing touches may stay.
                contacts.iter_mut().for_each(|contact| contact.strength = ContactStrength::Weak);
            }
            return;
        }
        let strongest = self.rule.strongest(&self.followed.fits);
        contacts.clear();
        let area = |radius_m: f64| PI * radius_m * radius_m;
        let unit = self.options.radius_m * self.options.radius_m;
        let factor = self.whitened.covariance_factor(self.followed.misfit);
        let fits = self.followed.fits.iter().filter(|fit| self.rule.is_touch(fit, strongest));
        contacts.extend(fits.map(|fit| {
            let (patch, c) = (&fit.patch, &fit.covariance);
            let amplitude = self.rule.effect_m2(patch) / unit;
            Contact {
                covariance_m2: [0, 1].map(|row| [0, 1].map(|column| factor * c[row][column])),
                significance: significance * self.rule.effect_m2(patch) / strongest,
                strength,
                radius_m: Some(patch.radius_m),
                is_single: true,
                ..Contact::even(patch.position_m, amplitude, area(patch.radius_m))
            }
        }));
        contacts.retain(|contact| contact.amplitude >= self.rule.smallest_amplitude);
        contacts.sort_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
        self.followed.shown.clone_from(contacts);
        self.gathered.fitted_ns = Some(time_ns);
        self.followed.explained.clear();
        self.followed.explained.extend(self.whitened.change.iter().zip(&self.left).map(|(change, left)| change - left));
    }

    /// The change of the channels due to the reported contacts in the last frame (model volts); `None` without
    /// contacts.
    pub(crate) fn explained(&self) -> Option<&[f64]> {
        (!self.followed.shown.is_empty()).then_some(&self.followed.explained[..])
    }

    /// Continues from the patches of the last frame. False if they don't explain this one.
    fn follow(&mut self, most_steps: usize) -> bool {
        if self.followed.fits.is_empty() {
            self.followed.standing = None;
            return false;
        }
        let standing = match &mut self.followed.standing {
            Some(standing) => standing,
            place => {
                let start: Vec<ContactPatch> = self.followed.fits.iter().map(|fit| fit.patch).collect();
                match self.sheets.now.fine.begin_fit(&start) {
                    Ok(begun) => place.insert(begun),
                    Err(_) => return false,
                }
            }
        };
        let before = self.followed.misfit;
        let options = FitOptions { most_steps, ..self.options };
        let result = self.sheets.now.fine.go_on(
            &self.whitened.change,
            &self.whitened.deviation,
            standing,
            &options,
            &mut self.left,
        );
        let Ok((fits, summary)) = result else { return false };
        let believed =
            summary.misfit <= BELIEVED.max(WORSENED * before) && plausible(&fits, &summary, self.rule.half_width_m);
        (self.followed.fits, self.followed.misfit) = (fits, summary.misfit);
        let strongest = self.rule.strongest(&self.followed.fits);
        believed && self.followed.fits.iter().all(|fit| self.rule.is_touch(fit, strongest))
    }

    /// Models and settings for a search.
    fn tools(&self) -> Tools<'_> {
        let Sheets { coarse, search, .. } = &self.sheets.now;
        Tools { sheet: coarse, search, options: &self.options, half_width_m: self.rule.half_width_m }
    }

    /// Continues the search in progress, or starts one unless the pause after a failed one isn't over. True if it
    /// found patches that also explain this frame.
    fn search(&mut self, time_ns: u64) -> bool {
        let under_way = self.search.seek.take();
        let tools = self.tools();
        let rested = self.is_unhurried || time_ns >= self.search.pause_until_ns;
        let begin = || rested.then(|| Seek::new(&tools, &self.whitened.change, &self.whitened.deviation)).flatten();
        let Some(mut seek) = under_way.or_else(begin) else { return false };
        let found = match seek.advance(&tools, self.share_ns) {
            Outcome::UnderWay => {
                self.search.seek = Some(seek);
                return false;
            }
            Outcome::Nothing => false,
            Outcome::Found(fits, misfit) => {
                // Steps that don't fit into this frame are done in the next ones.
                let step_ns = STEP_NS * (fits.len() * fits.len()).max(1) as f64;
                let steps = (self.share_ns / step_ns).clamp(STEPS[0] as f64, STEPS[1] as f64) as usize;
                (self.followed.fits, self.followed.misfit, self.followed.standing) = (fits, misfit, None);
                self.follow(steps)
            }
        };
        if found {
            self.search.restart();
        } else {
            self.search.pause_until_ns = time_ns.saturating_add(self.search.next_pause_ns);
            self.search.next_pause_ns = (2 * self.search.next_pause_ns).min(PAUSE_NS[1]);
        }
        found
    }

    /// Starts to test whether a change of the untouched skin (model volts, NaN where missing) is the end of touches
    /// that are part of the reference, so that patches of the opposite sign explain it. `None` if that cannot be
    /// tested.
    pub(crate) fn look_for_release(&self, change: &[f64]) -> Option<ReleaseLook> {
        let absent = self.channels.absent();
        let missing = |(value, absent): (&f64, &bool)| !value.is_finite() && !absent;
        if change.len() != absent.len() || change.iter().zip(absent).any(missing) {
            return None;
        }
        // Channels that are left out are ignored below.
        let opposite: Vec<f64> = change.iter().map(|value| if value.is_finite() { -value } else { 0.0 }).collect();
        let mut whitened = Whitened::default();
        self.channels.weigh(&opposite, &mut whitened);
        let Whitened { change, deviation, .. } = &whitened;
        let present = || change.iter().zip(deviation).filter(|(change, _)| change.is_finite());
        let energy =
            present().map(|(change, sigma)| (change / sigma).powi(2)).sum::<f64>() / present().count().max(1) as f64;
        let seek = Seek::new(&self.tools(), change, deviation)?;
        Some(ReleaseLook { seek, energy, sheets_used: self.sheets_used })
    }

    /// Continues such a test within the time budget of this frame.
    pub(crate) fn go_on_looking(&self, look: &mut ReleaseLook) -> Released {
        if look.sheets_used != self.sheets_used {
            return Released::Unknown;
        }
        match look.seek.advance(&self.tools(), self.share_ns) {
            Outcome::UnderWay => Released::UnderWay,
            Outcome::Nothing => Released::Unknown,
            Outcome::Found(_, misfit) => Released::Share(1.0 - misfit / look.energy),
        }
    }
}
