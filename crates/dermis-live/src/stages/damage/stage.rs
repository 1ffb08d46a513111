//! Damage detection in each frame, against the intact skin. The monitor detects damage in the image. Its helpers
//! handle the intact skin, fitted cuts, changes that no touch explains, rest and warmth. They do not change each
//! other: this stage passes on their results, and returns decisions for the baseline of touches.

use dermis_touch::damage::{
    Damage, DamageEvent, DamageFrame as MonitorFrame, DamageMonitor, DamageParams, DamageState,
};
use dermis_touch::{Baseline, PixelNoise, ReferenceOrigin};

use super::cuts::KnownCuts;
use super::frame::{Adoption, DamageDecision, DamageFrame};
use super::intact::IntactReference;
use super::readings::{Readings, mean_difference};
use super::release_test::is_release;
use super::rest::Rest;
use super::unexplained::Unexplained;
use super::view::DamageView;
use super::warmth::{Look, Warmth};
use crate::Error;
use crate::prepare::Prepared;
use crate::stages::plates::SheetCut;

/// Rises of the touch image below this share of its deepest fall are side lobes of damage not yet in the baseline. On
/// the sandwich's twin, the lobes of a cut reach 0.62 of its fall, while the falls around a press reach 0.13 of its
/// rise.
const LOBE_SHARE: f64 = 0.8;
/// Minimum number of frames in a mean for estimating healing.
const FEWEST_FOR_HEALING: usize = 8;
/// Minimum number of frames in the mean that becomes the baseline of a damaged skin.
const FEWEST_FOR_BASELINE: usize = 8;

/// Differences from the intact skin, and the image to write.
type ImageOfAll<'a> = (&'a [f64], &'a mut [f32]);

/// The damage monitor of a skin, and the helpers that prepare its input.
#[derive(Debug)]
pub(crate) struct DamageStage {
    monitor: DamageMonitor,
    intact: IntactReference,
    cuts: KnownCuts,
    unexplained: Unexplained,
    rest: Rest,
    warmth: Warmth,
    /// Mean readings over frames of a free skin.
    readings: Readings,
    /// Image noise of each pixel.
    noise: Vec<f32>,
    suspicious: bool,
    /// Damage that has been confirmed or has grown, and is not yet in the baseline.
    pending: Option<u64>,
}

/// Threshold below which rises of the touch image are side lobes of damage that the baseline does not include.
pub(crate) fn lobe_floor(image: &[f32]) -> f64 {
    let lowest = image.iter().copied().filter(|value| value.is_finite()).fold(0.0_f32, f32::min);
    LOBE_SHARE * -f64::from(lowest)
}

/// Parameters of damage detection from the skin file.
pub(super) fn damage_params(prepared: &Prepared) -> DamageParams {
    let settings = &prepared.skin.damage;
    let half_width = prepared.half_width_m();
    DamageParams {
        begin_sigma: settings.begin_sigma,
        smallest_depth: settings.smallest_depth,
        confirm_s: settings.confirm_s,
        reach_m: 0.1 * half_width,
        point_spread_m: 0.12 * half_width,
        // The last of a scar is hard to distinguish from the heat that closed it.
        healed_share: 0.3,
        ..DamageParams::default()
    }
}

impl DamageStage {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let (channels, grid) = (prepared.channels(), prepared.map.grid());
        Ok(Self {
            monitor: DamageMonitor::new(prepared.image_cells(), damage_params(prepared))?,
            intact: IntactReference::new(channels, grid.len()),
            cuts: KnownCuts::new(prepared)?,
            unexplained: Unexplained::new(),
            rest: Rest::new(channels),
            warmth: Warmth::default(),
            readings: Readings::with_capacity(channels),
            noise: Vec::new(),
            suspicious: false,
            pending: None,
        })
    }

    /// Reports a new baseline. It becomes the intact reference only if nothing is damaged or suspected, so re-zeroing
    /// never hides damage.
    pub fn set_baseline(&mut self, baseline: &Baseline, noise: Vec<f32>) {
        self.noise = noise;
        let adopted = baseline.records().last().is_some_and(|record| record.origin == ReferenceOrigin::Damage);
        if !self.intact.stands() || (!adopted && self.monitor.is_intact()) {
            self.intact.set(baseline);
            self.cuts.keep_scars(self.monitor.damages());
            self.monitor.renew();
            self.cuts.retain(self.monitor.damages());
        }
        self.unexplained.clear();
        self.rest.restart();
    }

    /// Reports a change of operator or noise.
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
        self.cuts.invalidate_image();
        self.monitor.restart();
    }

    /// Reports a change of the model that makes the images; the intact skin and the damage sites are kept. Returns the
    /// total effect of the damage, model volts, NaN in `left_out`, and the image to write for
    /// [`DamageStage::redraw`].
    pub fn see_anew(
        &mut self,
        noise: Vec<f32>,
        baseline: &Baseline,
        scale: &[f64],
        left_out: &[u32],
    ) -> ImageOfAll<'_> {
        self.set_noise(noise);
        self.unexplained.clear();
        let readings = if self.readings.frames > 0 { &self.readings.mean } else { baseline.baseline() };
        self.intact.compare_mean(readings, baseline, scale, left_out)
    }

    /// Moves known damage sites to their positions in the new image.
    ///
    /// # Errors
    /// An image of the wrong size.
    pub fn redraw(&mut self) -> Result<(), Error> {
        let noise = PixelNoise::PerPixel(&self.noise);
        let open: Vec<Damage> = self.monitor.damages().iter().filter(|damage| damage.is_open()).copied().collect();
        for damage in open.iter().filter(|damage| damage.share > 0.0) {
            self.monitor.redraw(damage.id, self.intact.image(), noise, damage.share, open.len() == 1)?;
        }
        Ok(())
    }

    /// The cuts and scars that the baseline of touches includes.
    pub fn cuts(&self) -> Vec<SheetCut> {
        self.cuts.in_sheet(self.monitor.damages())
    }

    /// Computes a frame's difference from the intact skin. Returns the data to image, and the image to write.
    /// `difference` and `scale` are as in [`DamageFrame`].
    pub fn compare(&mut self, baseline: &Baseline, difference: &[f64], scale: &[f64]) -> (&[f64], &mut [f32]) {
        self.intact.compare(baseline, difference, scale)
    }

    /// The response of the known cuts to image after [`DamageStage::compare`], and the image to write, if it has
    /// changed.
    pub fn update_known(&mut self) -> Option<(&[f64], &mut [f32])> {
        self.cuts.update_response(self.intact.difference())
    }

    /// Looks for damage in a frame whose images were made.
    ///
    /// # Errors
    /// Data to which no cut can be fitted.
    pub fn process(&mut self, frame: &DamageFrame<'_>, prepared: &Prepared) -> Result<DamageDecision, Error> {
        let lags = self.pending.is_some();
        // In a free frame there is no question; collected frames wait for the next one under load.
        let is_cut = frame.loaded && self.unexplained.is_cut(frame, &self.intact, &self.cuts, lags, prepared)?;
        // Contacts that begin no touch on a healed or renewed skin come from the baseline of touches alone, if the
        // frame matches the intact skin.
        let damages = self.monitor.damages();
        let is_mended = !damages.is_empty() && !damages.iter().any(Damage::is_open);
        let is_intact = frame.loaded && is_mended && frame.touches.is_empty() && self.intact.is_read(frame.noise);
        let frame = &DamageFrame { loaded: frame.loaded && !is_cut && !is_intact, ..*frame };
        self.monitor.process(&MonitorFrame {
            time_ns: frame.time_ns,
            image: self.intact.image(),
            noise: PixelNoise::PerPixel(&self.noise),
            touches: frame.touches,
            loaded: frame.loaded,
            known: self.cuts.image(),
            classes: None,
        })?;
        let began = std::mem::replace(&mut self.suspicious, self.monitor.is_suspicious());
        if frame.loaded || (self.suspicious && !began) {
            self.readings.restart();
            self.rest.postpone_look(frame.time_ns);
        }
        self.fit_new_damage(frame, prepared)?;
        if frame.loaded {
            self.rest.interrupt();
        } else {
            self.readings.add(frame.time_ns, frame.baseline.raw());
        }
        self.look_for_release(frame, prepared);
        self.warmth.gather(frame, self.monitor.damages());
        let adopt = self.adoption(frame).or_else(|| self.warmth.adoption(frame, self.monitor.damages()));
        self.estimate_healing(frame, prepared);
        if !frame.loaded && adopt.is_none() {
            let healing = self.cuts.healing();
            self.rest.update(frame.time_ns, &self.readings, frame.baseline, &self.monitor, healing);
        }
        let follow_rest = self.pending.is_none() && self.monitor.damages().iter().any(Damage::is_open);
        Ok(DamageDecision { adopt, hold_drift: self.monitor.is_suspicious(), follow_rest, is_free: is_intact })
    }

    /// Fits cuts to damage that is new or has grown. If the baseline of touches includes all other damage, a new one
    /// is fitted to the measured difference from that baseline. Otherwise the difference is from the intact skin,
    /// including the modelled effect of the others.
    fn fit_new_damage(&mut self, frame: &DamageFrame<'_>, prepared: &Prepared) -> Result<(), Error> {
        for index in 0..self.monitor.events().len() {
            let (damage, is_new) = match &self.monitor.events()[index] {
                DamageEvent::Begin(damage) => (*damage, true),
                DamageEvent::Update(damage) if damage.state == DamageState::Confirmed => (*damage, false),
                _ => continue,
            };
            let includes = is_new && self.cuts.knows_others(damage.id) && self.pending.is_none();
            self.pending = Some(damage.id);
            if self.readings.frames == 0 {
                continue;
            }
            let mean = &self.readings.mean;
            let change = if includes {
                mean_difference(mean, frame.baseline.baseline(), frame)
            } else {
                self.intact.change_of(mean, frame)
            };
            if let Some(shape) = self.cuts.fit(&damage, change, !includes, frame.noise, prepared)? {
                self.monitor.refine(damage.id, shape, None);
            }
        }
        Ok(())
    }

    /// Tests whether a suspicion is a touch that was in the reference and is gone. If so, it does not become damage:
    /// the current readings become the intact reference, and a new baseline is proposed, which alone repairs the
    /// image of touches.
    fn look_for_release(&mut self, frame: &DamageFrame<'_>, prepared: &Prepared) {
        if !self.rest.is_look_due(frame, &self.readings, &self.monitor) {
            return;
        }
        let change = self.intact.change_of(&self.readings.mean, frame);
        if is_release(&change, self.intact.readings(), frame, prepared) {
            self.intact.set_readings(&self.readings.mean, frame.baseline.drift_factor());
            self.rest.note_release(frame.time_ns);
            self.monitor.dismiss();
        }
    }

    /// Adopts the readings as baseline of touches once they include confirmed damage.
    fn adoption(&mut self, frame: &DamageFrame<'_>) -> Option<Adoption> {
        let settled = self.readings.frames >= FEWEST_FOR_BASELINE && !self.monitor.is_suspicious();
        let id = self.pending.take_if(|_| settled && !frame.loaded)?;
        let readings = self.readings.mean.clone();
        Some(Adoption { readings, frames: self.readings.frames, reason: format!("includes damage {id}") })
    }

    /// Estimates the healing of fitted cuts from time to time.
    fn estimate_healing(&mut self, frame: &DamageFrame<'_>, prepared: &Prepared) {
        let readings = match self.warmth.look(frame, self.intact.difference(), self.cuts.open_square()) {
            Look::None => return,
            Look::Free => &self.readings,
            Look::Course => self.warmth.course(),
        };
        if readings.frames < FEWEST_FOR_HEALING {
            return;
        }
        let change = self.intact.change_of(&readings.mean, frame);
        self.cuts.estimate_healing(frame.time_ns, &change, frame.noise, &prepared.voltages);
        for state in self.cuts.healing() {
            let damage = self.monitor.damages().iter().find(|damage| damage.id == state.id && damage.is_open());
            if let Some(shape) = damage.map(|damage| damage.shape) {
                self.monitor.refine(state.id, shape, Some(1.0 - state.joined.clamp(0.0, 1.0)));
            }
        }
    }

    /// Current view of damage and baselines.
    pub fn view<'a>(&'a self, baseline: &'a Baseline) -> DamageView<'a> {
        DamageView {
            now_ns: 0,
            watched: self.intact.stands(),
            damages: self.monitor.damages().into(),
            events: self.monitor.events().into(),
            image: self.intact.image().into(),
            baselines: baseline.records().into(),
            intact: self.intact.record(),
            healing: self.cuts.healing().into(),
            proposal: self.rest.proposal(),
            drift: baseline.drift_factor() - 1.0,
        }
    }
}
