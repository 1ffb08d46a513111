//! Damage on skins where a cut and a press look alike, because both lower the conductivity. They are distinguished by
//! their remainder. [`LevelWatch`] follows the drift of each channel, which gives the baseline of touches, and
//! reports when the readings have come to rest at other values. A change that remains after a load was released is
//! imaged. If its image is deep enough, it is damage, with position and extent from the image. A change that merely
//! stays is treated as a touch for ten minutes.

use std::borrow::Cow;

use dermis_skin::Polarity;
use dermis_touch::damage::{DamageMonitor, LevelChange, LevelParams, LevelWatch};
use dermis_touch::{Baseline, PixelNoise, ReferenceOrigin};

use super::frame::Adoption;
use super::view::DamageView;
use crate::Error;
use crate::prepare::Prepared;

/// A change that stays this long without a release is no longer treated as a touch, seconds.
const HELD_S: f64 = 600.0;
/// A change undoes damage if their cosine, apart from the sign, is at least this (channels in standard deviations).
const UNDOES: f64 = 0.7;

/// The level watch of a skin, and the monitor of the damage it finds.
#[derive(Debug)]
pub(crate) struct LevelStage {
    watch: LevelWatch,
    monitor: DamageMonitor,
    /// Image noise of each pixel.
    noise: Vec<f32>,
    /// The current change, if the readings rest away from their levels.
    found: Option<LevelChange>,
    /// This change, model volts, NaN in excluded channels, and its image, in which damage is below zero.
    change: Vec<f64>,
    fall: Vec<f32>,
    /// Changes due to open damage sites, as measured, by identity.
    known: Vec<(u64, Vec<f64>)>,
    /// Difference of the current frame from the intact skin, and its image, in the form of touch images.
    difference: Vec<f64>,
    image: Vec<f32>,
    /// Index of the intact skin's baseline among those used.
    intact: Option<usize>,
    begin_sigma: f64,
    smallest_depth: f64,
}

impl LevelStage {
    /// True if damage is detected by levels: on skins where touches raise the image by lowering conductivity.
    pub fn is_wanted(prepared: &Prepared) -> bool {
        prepared.skin.damage.watch && prepared.skin.imaging.polarity == Polarity::LowersConductivity
    }

    /// A stage for a prepared skin.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let settings = &prepared.skin.damage;
        let follow_s = prepared.skin.touch.drift_time_constant_s;
        let params = LevelParams {
            follow_s: if follow_s > 0.0 { follow_s } else { f64::INFINITY },
            jump_sigma: settings.begin_sigma,
            rest_s: settings.confirm_s,
        };
        let (channels, grid) = (prepared.channels(), prepared.map.grid());
        Ok(Self {
            watch: LevelWatch::new(channels, params)?,
            monitor: DamageMonitor::new(prepared.image_cells(), super::stage::damage_params(prepared))?,
            noise: Vec::new(),
            found: None,
            change: vec![f64::NAN; channels],
            fall: vec![f32::NAN; grid.len()],
            known: Vec::new(),
            difference: vec![f64::NAN; channels],
            image: vec![f32::NAN; grid.len()],
            intact: None,
            begin_sigma: settings.begin_sigma,
            smallest_depth: settings.smallest_depth,
        })
    }

    /// Takes the readings of a frame; ignores channels in `left_out`. Afterwards move the baseline to
    /// [`LevelStage::levels`].
    ///
    /// # Errors
    /// Times that run backwards.
    pub fn read(&mut self, time_ns: u64, raw: &[f64], left_out: &[u32]) -> Result<(), Error> {
        self.monitor.begin_frame(time_ns)?;
        let is_sound = |channel: usize| left_out.binary_search(&(channel as u32)).is_err();
        self.found = self.watch.process(time_ns, raw, is_sound)?;
        Ok(())
    }

    /// Levels of the undisturbed skin, once there is a baseline.
    pub fn levels(&self) -> Option<&[f64]> {
        self.intact.is_some().then(|| self.watch.levels())
    }

    /// True if the readings have left the levels.
    pub fn is_disturbed(&self) -> bool {
        self.watch.disturbed_since_ns().is_some()
    }

    /// Reports a new baseline. Unless this stage made it, it sets the levels, and if nothing is damaged, those of the
    /// intact skin.
    ///
    /// # Errors
    /// A baseline of the wrong length.
    pub fn set_baseline(&mut self, baseline: &Baseline, noise: Vec<f32>) -> Result<(), Error> {
        self.noise = noise;
        if baseline.records().last().is_some_and(|record| record.origin == ReferenceOrigin::Damage) {
            return Ok(());
        }
        let record = baseline.records().len().saturating_sub(1);
        if self.intact.is_none() {
            self.watch.start(baseline.baseline(), baseline.noise_std())?;
            self.intact = Some(record);
        } else {
            self.watch.set_levels(baseline.baseline())?;
            if self.monitor.is_intact() {
                self.intact = Some(record);
                self.known.clear();
                self.monitor.renew();
            }
        }
        Ok(())
    }

    /// Reports a change of operator or noise.
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
    }

    /// Number of damage sites whose changes are known.
    pub fn known_count(&self) -> usize {
        self.known.len()
    }

    /// The largest change due to one of these, model volts, and the image to write for [`LevelStage::redraw_known`].
    /// `scale` holds the factors from readings to model volts.
    pub fn known(&mut self, index: usize, scale: &[f64], left_out: &[u32]) -> (&[f64], &mut [f32]) {
        for ((to, known), scale) in self.change.iter_mut().zip(&self.known[index].1).zip(scale) {
            *to = scale * known;
        }
        left_out.iter().for_each(|&channel| self.change[channel as usize] = f64::NAN);
        (&self.change, &mut self.fall)
    }

    /// After a change of the model that makes the images, moves a known damage site to its position in the new image.
    ///
    /// # Errors
    /// An image of the wrong size.
    pub fn redraw_known(&mut self, index: usize) -> Result<(), Error> {
        // In touch images damage rises like touches.
        self.fall.iter_mut().for_each(|value| *value = -*value);
        let noise = PixelNoise::PerPixel(&self.noise);
        Ok(self.monitor.redraw(self.known[index].0, &self.fall, noise, 1.0, true)?)
    }

    /// The current change, model volts, and the image to write; `None` unless the readings rest away from their
    /// levels. `scale` holds the factors from readings to model volts.
    pub fn change(&mut self, scale: &[f64]) -> Option<(&[f64], &mut [f32])> {
        self.found?;
        for ((to, change), scale) in self.change.iter_mut().zip(self.watch.change()).zip(scale) {
            *to = scale * change;
        }
        // An image needs at least one channel.
        let has_any = self.change.iter().any(|value| value.is_finite());
        has_any.then_some((&*self.change, &mut *self.fall))
    }

    /// Judges the change whose image was made. A permanent change becomes part of the levels. If it is damage, the
    /// levels must become the baseline of touches.
    ///
    /// # Errors
    /// An image of the wrong size.
    pub fn judge(&mut self, time_ns: u64) -> Result<Option<Adoption>, Error> {
        let Some(found) = self.found.take() else { return Ok(None) };
        // In touch images damage rises like touches.
        self.fall.iter_mut().for_each(|value| *value = -*value);
        let finite = || self.fall.iter().copied().filter(|value| value.is_finite());
        let depth = -f64::from(finite().fold(0.0, f32::min));
        let rise = f64::from(finite().fold(0.0, f32::max));
        let lasted_s = time_ns.saturating_sub(found.since_ns) as f64 * 1e-9;
        // A region that conducts better than before is not a touch.
        let may_be_touch = depth > rise && !found.was_released() && lasted_s < HELD_S;
        if may_be_touch {
            return Ok(None);
        }
        let is_sudden = found.was_released() || !found.has_crept();
        let is_deep = found.significance >= self.begin_sigma && depth >= self.smallest_depth;
        // A cut makes nothing conduct better. Next to it, the image rises by less than it falls.
        let counts = is_sudden && is_deep && depth > rise && !found.is_remainder();
        let noise = PixelNoise::PerPixel(&self.noise);
        let id = if counts { self.monitor.declare(found.since_ns, &self.fall, noise)? } else { None };
        tracing::info!(
            "the levels have changed for good: {:.1} deviations, {depth:.4} deep in the image, {:.0} % of what it was: {}",
            found.significance,
            100.0 * found.share_of_peak,
            if id.is_some() { "damage" } else { "no damage" }
        );
        if id.is_none() {
            self.heal();
        }
        self.watch.accept();
        let Some(id) = id else { return Ok(None) };
        self.remember(id);
        let readings = self.watch.levels().to_vec();
        Ok(Some(Adoption { readings, frames: 3, reason: format!("includes damage {id}") }))
    }

    /// Adds the change due to a damage site to its earlier change.
    fn remember(&mut self, id: u64) {
        let change = || self.watch.change().iter().map(|value| if value.is_finite() { *value } else { 0.0 });
        match self.known.iter_mut().find(|(known, _)| *known == id) {
            Some((_, sum)) => sum.iter_mut().zip(change()).for_each(|(sum, value)| *sum += value),
            None => self.known.push((id, change().collect())),
        }
    }

    /// Treats a change that undoes the effect of a damage site as its healing.
    fn heal(&mut self) {
        let noise = self.watch.noise();
        let weighted = |values: &[f64], channel: usize| values[channel] / noise[channel];
        let mut best: Option<(usize, f64, f64)> = None;
        for (index, (id, known)) in self.known.iter().enumerate() {
            let share = self.monitor.damages().iter().find(|damage| damage.id == *id && damage.is_open());
            let Some(share) = share.map(|damage| damage.share) else { continue };
            let (mut cross, mut square, mut own) = (0.0, 0.0, 0.0);
            for channel in 0..noise.len() {
                let (a, b) = (weighted(known, channel), weighted(self.watch.change(), channel));
                if (a + b).is_finite() {
                    (cross, square, own) = (cross + a * b, square + a * a, own + b * b);
                }
            }
            let alike = -cross / (square * own).sqrt();
            if alike >= UNDOES && best.is_none_or(|(_, other, _)| alike > other) {
                best = Some((index, alike, share + cross / square));
            }
        }
        let Some((index, _, left)) = best else { return };
        self.monitor.set_share(self.known[index].0, left);
    }

    /// Computes a frame's difference from the intact skin. Returns the data to image, and the image to write.
    /// `difference` (model volts) is relative to the baseline of touches, and `scale` as in [`LevelStage::change`].
    pub fn compare(&mut self, difference: &[f64], scale: &[f64]) -> (&[f64], &mut [f32]) {
        self.difference.copy_from_slice(difference);
        for (id, known) in &self.known {
            let share =
                self.monitor.damages().iter().find(|damage| damage.id == *id).map_or(0.0, |damage| damage.share);
            for ((to, known), scale) in self.difference.iter_mut().zip(known).zip(scale) {
                *to += share * scale * known;
            }
        }
        (&self.difference, &mut self.image)
    }

    /// Current view of damage and baselines.
    pub fn view<'a>(&'a self, baseline: &'a Baseline) -> DamageView<'a> {
        DamageView {
            now_ns: 0,
            watched: self.intact.is_some(),
            damages: self.monitor.damages().into(),
            events: self.monitor.events().into(),
            image: (&self.image).into(),
            baselines: baseline.records().into(),
            intact: self.intact,
            healing: Cow::default(),
            proposal: None,
            drift: self.watch.drift(),
        }
    }
}
