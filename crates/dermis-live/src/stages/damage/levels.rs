//! Damage of skins on which a cut and a press look alike, because both lower the conductivity: told apart by what
//! stays. [`LevelWatch`] follows the drift of each channel, which is the baseline of touches, and says when the
//! readings have come to rest elsewhere. A change that is left when something has been let go is imaged; where that
//! image is deep enough it is damage, with its place and extent there. What merely lies still is held for a touch, for
//! ten minutes.

use dermis_skin::Polarity;
use dermis_touch::damage::{DamageMonitor, LevelChange, LevelParams, LevelWatch};
use dermis_touch::{Baseline, PixelNoise, ReferenceOrigin};

use super::frame::Adoption;
use super::view::DamageView;
use crate::Error;
use crate::image_cells::image_cells;
use crate::prepare::Prepared;

/// What lies still for so long, seconds, and was never let go, is no touch any more.
const HELD_S: f64 = 600.0;
/// A change undoes a damage where the two are so much alike, but for the sign (cosine, channels in standard
/// deviations).
const UNDOES: f64 = 0.7;

/// The watch of a skin with what its images are made into.
#[derive(Debug)]
pub(crate) struct LevelStage {
    watch: LevelWatch,
    monitor: DamageMonitor,
    /// Image noise of each pixel.
    noise: Vec<f32>,
    /// The change at hand, if the readings rest away from their levels.
    found: Option<LevelChange>,
    /// It, model volts, NaN where channels are left out; and the image of it, in which damage is below zero.
    change: Vec<f64>,
    fall: Vec<f32>,
    /// Changes that open damages have made, as measured, by their identities.
    known: Vec<(u64, Vec<f64>)>,
    /// Difference of the frame at hand from the intact skin, and its image, as the image of touches.
    difference: Vec<f64>,
    image: Vec<f32>,
    /// Place of the intact skin's baseline among those that were in use.
    intact: Option<usize>,
    begin_sigma: f64,
    smallest_depth: f64,
}

impl LevelStage {
    /// Whether damage of a skin is told by levels: where an image rises under a touch because the skin conducts less.
    pub fn is_wanted(prepared: &Prepared) -> bool {
        prepared.skin.damage.watch && prepared.skin.imaging.polarity == Polarity::LowersConductivity
    }

    /// For a prepared skin.
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
            monitor: DamageMonitor::new(image_cells(grid), super::stage::damage_params(prepared))?,
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

    /// Takes in the readings of a frame; channels in `left_out` have no part. The levels that the baseline has to move
    /// to are those of [`LevelStage::levels`].
    ///
    /// # Errors
    /// Times that run backwards.
    pub fn read(&mut self, time_ns: u64, raw: &[f64], left_out: &[u32]) -> Result<(), Error> {
        self.monitor.begin_frame(time_ns)?;
        let is_sound = |channel: usize| left_out.binary_search(&(channel as u32)).is_err();
        self.found = self.watch.process(time_ns, raw, is_sound)?;
        Ok(())
    }

    /// Levels of the undisturbed skin, once a baseline stands.
    pub fn levels(&self) -> Option<&[f64]> {
        self.intact.is_some().then(|| self.watch.levels())
    }

    /// Whether the readings have left the levels.
    pub fn is_disturbed(&self) -> bool {
        self.watch.disturbed_since_ns().is_some()
    }

    /// A new baseline stands. One that this stage has not made is taken for the levels, and for those of the intact
    /// skin where nothing is damaged.
    ///
    /// # Errors
    /// A baseline of another length.
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

    /// Another operator or other noise is in use.
    pub fn set_noise(&mut self, noise: Vec<f32>) {
        self.noise = noise;
    }

    /// Damages whose changes are known.
    pub fn known_count(&self) -> usize {
        self.known.len()
    }

    /// What one of these has changed at its worst, model volts, and where its image goes, for
    /// [`LevelStage::redraw_known`]. `scale` holds the factors from readings to model volts.
    pub fn known(&mut self, index: usize, scale: &[f64], left_out: &[u32]) -> (&[f64], &mut [f32]) {
        for ((to, known), scale) in self.change.iter_mut().zip(&self.known[index].1).zip(scale) {
            *to = scale * known;
        }
        left_out.iter().for_each(|&channel| self.change[channel as usize] = f64::NAN);
        (&self.change, &mut self.fall)
    }

    /// Another model makes the images: a known damage lies where the image just made has it.
    ///
    /// # Errors
    /// An image of another size.
    pub fn redraw_known(&mut self, index: usize) -> Result<(), Error> {
        // In the image of touches damage rises as they do.
        self.fall.iter_mut().for_each(|value| *value = -*value);
        let noise = PixelNoise::PerPixel(&self.noise);
        Ok(self.monitor.redraw(self.known[index].0, &self.fall, noise, 1.0, true)?)
    }

    /// The change at hand, model volts, and where its image goes; `None` where the readings do not rest elsewhere.
    /// `scale` holds the factors from readings to model volts.
    pub fn change(&mut self, scale: &[f64]) -> Option<(&[f64], &mut [f32])> {
        self.found?;
        for ((to, change), scale) in self.change.iter_mut().zip(self.watch.change()).zip(scale) {
            *to = scale * change;
        }
        // An image of nothing cannot be made.
        let has_any = self.change.iter().any(|value| value.is_finite());
        has_any.then_some((&*self.change, &mut *self.fall))
    }

    /// Judges the change whose image was made. What stays becomes part of the levels; where it is damage, they are to
    /// be the baseline of touches from now on.
    ///
    /// # Errors
    /// An image of another size.
    pub fn judge(&mut self, time_ns: u64) -> Result<Option<Adoption>, Error> {
        let Some(found) = self.found.take() else { return Ok(None) };
        // In the image of touches damage rises as they do.
        self.fall.iter_mut().for_each(|value| *value = -*value);
        let finite = || self.fall.iter().copied().filter(|value| value.is_finite());
        let depth = -f64::from(finite().fold(0.0, f32::min));
        let rise = f64::from(finite().fold(0.0, f32::max));
        let lasted_s = time_ns.saturating_sub(found.since_ns) as f64 * 1e-9;
        // What conducts better than before is nothing that touches.
        let may_be_touch = depth > rise && !found.was_released() && lasted_s < HELD_S;
        if may_be_touch {
            return Ok(None);
        }
        let is_sudden = found.was_released() || !found.has_crept();
        let is_deep = found.significance >= self.begin_sigma && depth >= self.smallest_depth;
        // A cut makes nothing conduct better; beside one, the image rises by less than it falls.
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

    /// Keeps what a damage has changed, together with what it had before.
    fn remember(&mut self, id: u64) {
        let change = || self.watch.change().iter().map(|value| if value.is_finite() { *value } else { 0.0 });
        match self.known.iter_mut().find(|(known, _)| *known == id) {
            Some((_, sum)) => sum.iter_mut().zip(change()).for_each(|(sum, value)| *sum += value),
            None => self.known.push((id, change().collect())),
        }
    }

    /// A change that undoes what a damage has changed is its healing.
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

    /// Takes the difference of a frame from the intact skin: what is to be imaged, and where to. `difference` (model
    /// volts) is that from the baseline of touches, and `scale` as in [`LevelStage::change`].
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

    /// What is known now.
    pub fn view<'a>(&'a self, baseline: &'a Baseline) -> DamageView<'a> {
        DamageView {
            now_ns: 0,
            watched: self.intact.is_some(),
            damages: self.monitor.damages(),
            events: self.monitor.events(),
            image: &self.image,
            baselines: baseline.records(),
            intact: self.intact,
            healing: &[],
            proposal: None,
            drift: self.watch.drift(),
        }
    }
}
