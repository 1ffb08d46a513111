//! Patches fitted to one frame after the other.

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

/// A fit that goes on from the frame before is believed up to so many times the misfit before, too.
const WORSENED: f64 = 1.5;
/// After a search in vain so much time passes before the next, twice as much after each further one, up to the most;
/// nanoseconds.
const PAUSE_NS: [u64; 2] = [30_000_000, 450_000_000];
/// Standard deviations of the logarithms of radius and conductance before anything is measured.
const LOG_DEVIATIONS: [f64; 2] = [0.5, 0.5];
/// A peak so many times as high as the image is low stands out by itself.
const OUTSTANDING: f64 = 2.0;
/// Least time between two fits, nanoseconds: what is pressed by hand or robot moves less than the uncertainty of its
/// place meanwhile.
const INTERVAL_NS: u64 = 5_000_000;
/// Frames that come faster than this may still take half of it, nanoseconds.
const LEAST_NS: f64 = 500_000.0;
/// A step of a fit of one patch to a frame, nanoseconds of a core; one of n patches takes n squared times that.
const STEP_NS: f64 = 0.4e6;
/// The baseline does not follow drift while something touches the skin. So much of all voltages may have drifted since
/// by the second: 2 % in ten minutes.
const DRIFT_PER_S: f64 = 0.02 / 600.0;
/// Steps of a fit: from the frame before, and at most from what a search found, where a frame's share allows it.
const STEPS: [usize; 2] = [4, 15];
/// Share of the time between frames that a search may take.
const SEARCH_SHARE: f64 = 0.5;

/// A press has gone from the baseline where its opposite explains this share of a frame whose mean square over the
/// deviations exceeds this. After a look in vain, this many frames pass.
const GONE_SHARE: f64 = 0.8;
const GONE_ENERGY: f64 = 4.0;
const GONE_WAIT: u32 = 8;

/// The patches of the last frame.
#[derive(Debug)]
struct Followed {
    fits: Vec<ContactFit>,
    /// Where their fit stands.
    standing: Option<PatchFit>,
    misfit: f64,
    /// Contacts of the last fit.
    shown: Vec<Contact>,
    /// What patches make of the frames since the last fit, while these patches are believed: model volts.
    explained: Vec<f64>,
}

/// The search under way, and the pause before the next.
#[derive(Debug)]
struct Search {
    seek: Option<Seek>,
    /// No search before this time, and how long the next pause is.
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

    /// The next search need not wait.
    fn restart(&mut self) {
        (self.pause_until_ns, self.next_pause_ns) = (0, PAUSE_NS[0]);
    }
}

/// Fits the patches of one frame after the other.
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
    /// Whether frames wait for the whole of a search, and no search for a later frame.
    is_unhurried: bool,
    /// Since when something has been on the skin.
    touched_ns: Option<u64>,
    /// How much of a search this frame may take, nanoseconds of a core.
    share_ns: f64,
    /// Sheets that were in use so far.
    sheets_used: u64,
}

/// Whether presses have gone that the baseline holds.
#[derive(Debug, Default)]
struct GoneLook {
    look: Option<ReleaseLook>,
    is_sure: bool,
    /// Frames before the next look.
    wait: u32,
}

/// A look at whether a change is that of touches that have gone, under way.
#[derive(Debug)]
pub(crate) struct ReleaseLook {
    seek: Seek,
    /// Mean square of the change over its noise.
    energy: f64,
    /// The sheets that it is made on.
    sheets_used: u64,
}

/// What a look at a release came to in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Released {
    /// There is more to do.
    UnderWay,
    /// Nothing can be said.
    Unknown,
    /// Touches of the opposite sign explain this share of the change's weighted energy.
    Share(f64),
}

impl PatchStage {
    /// What fits patches, at this noise of the channels (model volts).
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

    /// Frames that have waited for sheets with new cuts.
    pub(crate) fn waits(&self) -> u64 {
        self.sheets.waits()
    }

    /// As new at this noise of the channels (model volts), on the sheet as it is.
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

    /// From now on each frame waits for as much of a search as it takes.
    pub(crate) fn take_time(&mut self) {
        self.is_unhurried = true;
    }

    /// Replaces the noise of the channels (model volts).
    pub(crate) fn set_noise(&mut self, noise: &[f64]) {
        self.channels.set_noise(noise);
    }

    /// Takes the sheet to have these cuts, from three seconds of the frames' time on: its Green's function has to be
    /// worked out anew. Does nothing where they are those that it has.
    pub(crate) fn set_cuts(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        self.sheets.order(time_ns, cuts);
    }

    /// Whether it is being worked out what touches the skin.
    pub(crate) fn is_seeking(&self) -> bool {
        self.search.seek.is_some()
    }

    /// Goes on without these channels.
    pub(crate) fn leave_out(&mut self, channels: &[u32]) {
        self.channels.leave_out(channels);
    }

    /// The next frame has nothing to do with the last.
    pub(crate) fn forget(&mut self) {
        self.let_go();
        self.touched_ns = None;
    }

    /// Nothing is followed any more, and the next search need not wait.
    pub(crate) fn let_go(&mut self) {
        self.followed.fits.clear();
        self.followed.shown.clear();
        self.gathered.count = 0;
        self.search.seek = None;
        self.search.restart();
    }

    /// Replaces the contacts of an image by the patches of its frame (model volts), or by those of the last fit where
    /// that is only a moment ago. Those of a frame that patches do not explain stay as the image has them; they begin
    /// no touch, unless one stands far out of the image, of which `lowest` is the lowest value.
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

    /// Whether noise and drift explain a frame.
    fn is_drift(&self, difference: &[f64]) -> bool {
        let absent = self.channels.absent();
        let present = difference.iter().zip(absent).map(|(value, absent)| if *absent { f64::NAN } else { *value });
        self.drift.explains(present, self.channels.noise())
    }

    /// Looks whether a frame that patches do not explain is that of a press which the baseline holds and which has gone.
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

    /// Whether a press that the baseline holds has gone; said once.
    pub(crate) fn take_gone(&mut self) -> bool {
        std::mem::take(&mut self.gone.is_sure)
    }

    fn refine_contacts(&mut self, time_ns: u64, difference: &[f64], lowest: f64, contacts: &mut Vec<Contact>) {
        // How long a search may take in this frame: as slow as frames come. A single gap is none: the frames behind it
        // wait in line. The first frame waits for nothing.
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

    /// As [`PatchStage::refine`], of the frame in `left`.
    fn refine_now(&mut self, time_ns: u64, lowest: f64, contacts: &mut Vec<Contact>) {
        // Too weak to begin a touch, and none there that it could be.
        let Contact { significance, strength, .. } = contacts[0];
        if self.followed.fits.is_empty() && self.followed.shown.is_empty() && strength != ContactStrength::Strong {
            return;
        }
        self.channels.weigh(&self.left, &mut self.whitened);
        if !self.follow(STEPS[0]) && !self.search(time_ns) {
            self.followed.fits.clear();
            if self.search.seek.is_some() && !self.followed.shown.is_empty() {
                // Until it is known what changed, a few frames at most, what was there stays where it was.
                contacts.clone_from(&self.followed.shown);
                return;
            }
            self.followed.shown.clear();
            if self.search.seek.is_none() && contacts[0].amplitude > OUTSTANDING * -lowest {
                // A press on a cut looks like this: the image knows one touch.
                contacts.truncate(1);
            } else {
                // Lobes of damage, and touches that are only beginning: nothing begins, what is there may stay.
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

    /// What the contacts that are shown explain of the last frame (model volts); `None` where none are.
    pub(crate) fn explained(&self) -> Option<&[f64]> {
        (!self.followed.shown.is_empty()).then_some(&self.followed.explained[..])
    }

    /// Goes on from the patches of the frame before; false where these do not explain this one.
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

    /// What a search works with.
    fn tools(&self) -> Tools<'_> {
        let Sheets { coarse, search, .. } = &self.sheets.now;
        Tools { sheet: coarse, search, options: &self.options, half_width_m: self.rule.half_width_m }
    }

    /// Goes on with the search under way, or begins one unless one in vain was just before; true where patches were
    /// found that explain this frame too.
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
                // What a frame leaves to be done, the next ones do.
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

    /// Begins to look whether a change of the free skin (model volts, NaN where missing) is that of touches that have
    /// gone, which the reference holds: whether patches of the opposite sign explain it. None where that cannot be
    /// said.
    pub(crate) fn look_for_release(&self, change: &[f64]) -> Option<ReleaseLook> {
        let absent = self.channels.absent();
        let missing = |(value, absent): (&f64, &bool)| !value.is_finite() && !absent;
        if change.len() != absent.len() || change.iter().zip(absent).any(missing) {
            return None;
        }
        // Channels that are left out have no part in what follows.
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

    /// Goes on with such a look for as long as a frame may take of it.
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
