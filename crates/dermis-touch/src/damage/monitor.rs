//! The damage monitor: a mean over free frames, low regions in it, and the life of each damage site.

use super::region::{Region, RegionFinder};
use super::{Damage, DamageEvent, DamageParams, DamageShape, DamageState};
use crate::blob::seconds_between;
use crate::cells::ImageCells;
use crate::contact::PixelNoise;
use crate::error::{TouchError, require_length};
use crate::touch::Touch;

/// Drop a suspicion that has not been seen for this long, seconds.
const DROP_S: f64 = 0.3;
/// A damage site has grown if its volume exceeds its previous worst by this factor.
const GROWN: f64 = 1.25;
/// Minimum share of a low region's depth that known damage must leave unexplained for the region to be a new site.
const OF_ITS_OWN: f64 = 0.5;
/// A healed site has reopened above this share of its worst.
const REOPENED: f64 = 0.6;

/// A network's class probabilities for each cell, in image order, 0 to 1; NaN outside the skin.
#[derive(Debug, Clone, Copy)]
pub struct ClassProbabilities<'a> {
    /// Damaged.
    pub damaged: &'a [f32],
    /// Compressed.
    pub compressed: &'a [f32],
}

/// The inputs from one frame.
#[derive(Debug, Clone, Copy)]
pub struct DamageFrame<'a> {
    /// Time of the frame, nanoseconds; must not decrease.
    pub time_ns: u64,
    /// Image against the intact reference: below zero is damage. NaN outside the skin.
    pub image: &'a [f32],
    /// Standard deviation of that image's noise.
    pub noise: PixelNoise<'a>,
    /// The touches on the skin.
    pub touches: &'a [Touch],
    /// True while anything touches the skin, including contacts that are not yet touches.
    pub loaded: bool,
    /// Model image of the known damage. A low region that it explains is a side lobe and begins no new site.
    pub known: Option<&'a [f32]>,
    /// Class probabilities of the cells, if a network provides them. A damage then begins only where most of its area
    /// is classified as damaged, and counts as covered where most of it is classified as compressed.
    pub classes: Option<ClassProbabilities<'a>>,
}

/// A damage site with the monitor's private state.
#[derive(Debug, Clone, Copy)]
pub(super) struct Record {
    pub(super) damage: Damage,
    seen_ns: u64,
    /// Time since which `share` has called for another state.
    leaning_ns: Option<u64>,
    /// True if a model determined the share, not the image.
    pub(super) modelled: bool,
    pub(super) bit: u16,
    /// Time since which no touch has been on it.
    clear_ns: Option<u64>,
}

/// Distinguishes damage from touch, frame by frame. Owns its working memory.
///
/// Damage is searched for in the mean of frames in which nothing touches the skin, starting a while after the last
/// touch. Neither the lobes of a touch nor its after-effects then become damage. The monitor never changes the
/// reference: the caller owns it, and it must be the intact skin.
#[derive(Debug, Clone)]
pub struct DamageMonitor {
    pub(super) cells: ImageCells,
    pub(super) params: DamageParams,
    pub(super) finder: RegionFinder,
    mean: Vec<f32>,
    /// Noise variance of the mean over that of one frame.
    variance: f64,
    free_since_ns: Option<u64>,
    loaded_ns: Option<u64>,
    pub(super) time_ns: Option<u64>,
    pub(super) records: Vec<Record>,
    damages: Vec<Damage>,
    pub(super) events: Vec<DamageEvent>,
    /// Bits of the records that each cell belongs to.
    masks: Vec<u16>,
    next_id: u64,
}

impl DamageMonitor {
    /// A monitor for images on these cells.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when the cells or a parameter are out of range.
    pub fn new(cells: impl Into<ImageCells>, params: DamageParams) -> Result<Self, TouchError> {
        let cells = cells.into();
        cells.validate()?;
        params.validate()?;
        let count = cells.len();
        Ok(Self {
            cells,
            params,
            finder: RegionFinder::new(count, params.most),
            mean: vec![f32::NAN; count],
            variance: 1.0,
            free_since_ns: None,
            loaded_ns: None,
            time_ns: None,
            records: Vec::with_capacity(params.most),
            damages: Vec::with_capacity(params.most),
            // At most two events per site and frame, and one more from a model.
            events: Vec::with_capacity(3 * params.most),
            masks: vec![0; count],
            next_id: 1,
        })
    }

    /// The thresholds and times.
    #[must_use]
    pub fn params(&self) -> &DamageParams {
        &self.params
    }

    /// All damage sites, suspected and healed ones included, oldest first.
    #[must_use]
    pub fn damages(&self) -> &[Damage] {
        &self.damages
    }

    /// Events of the last frame, and any added since.
    #[must_use]
    pub fn events(&self) -> &[DamageEvent] {
        &self.events
    }

    /// True if there is neither damage nor suspicion, so that the skin as it is may serve as the intact reference.
    #[must_use]
    pub fn is_intact(&self) -> bool {
        self.damages.iter().all(|damage| damage.state == DamageState::Healed)
    }

    /// True while some damage is suspected.
    #[must_use]
    pub fn is_suspicious(&self) -> bool {
        self.damages.iter().any(|damage| damage.state == DamageState::Suspected)
    }

    /// Mean image over recent free frames. NaN outside the skin and before the first free frame.
    #[must_use]
    pub fn mean_image(&self) -> &[f32] {
        &self.mean
    }

    /// Processes one frame. Allocates nothing.
    ///
    /// # Errors
    /// [`TouchError::Length`], [`TouchError::TimeReversed`]; the state is then unchanged.
    pub fn process(&mut self, frame: &DamageFrame<'_>) -> Result<(), TouchError> {
        self.check(frame)?;
        self.events.clear();
        let elapsed_s = self.time_ns.map_or(0.0, |before| seconds_between(before, frame.time_ns));
        self.time_ns = Some(frame.time_ns);
        if frame.loaded || !frame.touches.is_empty() {
            self.loaded_ns = Some(frame.time_ns);
            self.free_since_ns = None;
        }
        self.cover(frame);
        let settled = self.loaded_ns.is_none_or(|last| seconds_between(last, frame.time_ns) >= self.params.settle_s);
        if settled {
            self.average(frame, elapsed_s);
            let since_ns = *self.free_since_ns.get_or_insert(frame.time_ns);
            if seconds_between(since_ns, frame.time_ns) >= self.params.average_s {
                self.judge(frame);
            }
        }
        self.publish();
        Ok(())
    }

    /// Takes a model's estimate of a damage site: its shape, and the share of its worst that is left, if the model has
    /// one.
    pub fn refine(&mut self, id: u64, shape: DamageShape, share: Option<f64>) {
        if let Some(record) = self.records.iter_mut().find(|record| record.damage.id == id) {
            record.damage.shape = shape;
            if let Some(share) = share.filter(|share| share.is_finite()) {
                record.damage.share = share.clamp(0.0, 1.0);
                record.modelled = true;
            }
        }
        let renewed = self.records.iter().find(|record| record.damage.id == id).map(|record| record.damage);
        for event in &mut self.events {
            if let (DamageEvent::Begin(damage) | DamageEvent::Update(damage), Some(renewed)) = (event, renewed)
                && damage.id == id
            {
                *damage = renewed;
            }
        }
        self.publish();
    }

    /// Call this after replacing the intact reference with the skin as it is. Healed damage is now part of the
    /// reference and is dropped.
    pub fn renew(&mut self) {
        let freed = |record: &Record| if record.damage.state == DamageState::Healed { record.bit } else { 0 };
        let bits = self.records.iter().map(freed).fold(0, |all, bit| all | bit);
        self.masks.iter_mut().for_each(|mask| *mask &= !bits);
        self.records.retain(|record| record.damage.state != DamageState::Healed);
        self.restart();
        self.publish();
    }

    /// Drops all suspicions as false and restarts the mean.
    pub fn dismiss(&mut self) {
        let suspected = |record: &Record| record.damage.state == DamageState::Suspected;
        let bits = self.records.iter().filter(|record| suspected(record)).fold(0, |all, record| all | record.bit);
        self.masks.iter_mut().for_each(|mask| *mask &= !bits);
        self.records.retain(|record| !suspected(record));
        self.restart();
        self.publish();
    }

    /// Restarts the mean, for example after a change of the operator that makes the image.
    pub fn restart(&mut self) {
        self.free_since_ns = None;
        self.mean.fill(f32::NAN);
    }

    fn check(&self, frame: &DamageFrame<'_>) -> Result<(), TouchError> {
        require_length("image", self.cells.len(), frame.image.len())?;
        frame.noise.validate(self.cells.len())?;
        if let Some(known) = frame.known {
            require_length("image of the known damage", self.cells.len(), known.len())?;
        }
        if let Some(classes) = &frame.classes {
            require_length("probabilities of damage", self.cells.len(), classes.damaged.len())?;
            require_length("probabilities of compression", self.cells.len(), classes.compressed.len())?;
        }
        match self.time_ns.filter(|previous| frame.time_ns < *previous) {
            Some(previous_ns) => Err(TouchError::TimeReversed { time_ns: frame.time_ns, previous_ns }),
            None => Ok(()),
        }
    }

    fn average(&mut self, frame: &DamageFrame<'_>, elapsed_s: f64) {
        let first = self.free_since_ns.is_none();
        let follow = -(-elapsed_s / self.params.average_s).exp_m1();
        // Plain mean until the exponential mean is as good.
        let gain = if first { 1.0 } else { follow.max(self.variance / (1.0 + self.variance)) };
        self.variance = gain * gain + (1.0 - gain) * (1.0 - gain) * if first { 0.0 } else { self.variance };
        for (mean, &value) in self.mean.iter_mut().zip(frame.image) {
            *mean = if first || !mean.is_finite() { value } else { *mean + gain as f32 * (value - *mean) };
        }
    }

    /// Updates which damage sites are covered by touches.
    fn cover(&mut self, frame: &DamageFrame<'_>) {
        let DamageParams { reach_m, settle_s, .. } = self.params;
        for index in 0..self.records.len() {
            let Record { damage, bit, .. } = self.records[index];
            if !damage.is_open() {
                continue;
            }
            let over = |touch: &Touch| {
                let radius_m = touch.radius_m.unwrap_or_else(|| (touch.area_m2 / std::f64::consts::PI).sqrt());
                damage.shape.distance_m(touch.position_m) <= radius_m + reach_m
            };
            let called =
                frame.loaded && frame.classes.is_some_and(|c| mean_within(&self.masks, bit, c.compressed) > 0.5);
            let record = &mut self.records[index];
            if called || frame.touches.iter().any(over) {
                record.clear_ns = None;
                if damage.state != DamageState::Covered {
                    record.damage.state = DamageState::Covered;
                    self.events.push(DamageEvent::Covered(record.damage));
                }
            } else if damage.state == DamageState::Covered {
                let since_ns = *record.clear_ns.get_or_insert(frame.time_ns);
                // The touch has moved elsewhere for long enough: the site counts as visible again. Without load,
                // `follow` decides.
                if frame.loaded && seconds_between(since_ns, frame.time_ns) >= settle_s {
                    record.damage.state = DamageState::Confirmed;
                    self.events.push(DamageEvent::Uncovered(record.damage));
                }
            }
        }
    }

    fn judge(&mut self, frame: &DamageFrame<'_>) {
        let highest = self.mean.iter().copied().filter(|v| v.is_finite()).fold(0.0_f32, f32::max);
        let least = self.params.smallest_depth.max(self.params.lobe_share * f64::from(highest));
        let averaged = self.variance.sqrt();
        let sigma = |cell: usize| averaged * f64::from(frame.noise.at(cell));
        self.finder.find(&self.mean, &self.cells, &self.params, sigma, least);
        for index in 0..self.finder.regions().len() {
            let region = self.finder.regions()[index];
            let of_its_own = self.is_of_its_own(&region, frame.known);
            match self.record_of(&region) {
                Some(record) if of_its_own || self.records[record].damage.state != DamageState::Suspected => {
                    self.measure(record, &region, frame.time_ns);
                }
                None if of_its_own => self.suspect(&region, frame.time_ns),
                _ => {}
            }
        }
        // Confirm one suspicion at a time, the largest first: once a model knows it, the others may prove to be its
        // lobes.
        let seen = |record: &&Record| record.damage.state == DamageState::Suspected && record.seen_ns == frame.time_ns;
        let largest = |a: &&Record, b: &&Record| a.damage.volume_m2.total_cmp(&b.damage.volume_m2);
        let first = self.records.iter().filter(seen).max_by(largest).map(|record| record.damage.id);
        for index in 0..self.records.len() {
            let damage = &self.records[index].damage;
            if damage.state != DamageState::Suspected || Some(damage.id) == first {
                self.follow(index, frame);
            }
        }
        self.drop_unseen(frame.time_ns);
    }

    /// The nearest record whose cells overlap the region, or whose shape lies close to it.
    pub(super) fn record_of(&self, region: &Region) -> Option<usize> {
        let distance = |record: &Record| {
            let own = record.damage.shape.distance_m(region.shape.centre_m);
            let other = region.shape.distance_m(record.damage.shape.centre_m);
            own.min(other)
        };
        let shares = |record: &Record| {
            let common = self.finder.labels().iter().zip(&self.masks);
            common.filter(|(label, mask)| **label & region.bit != 0 && **mask & record.bit != 0).count() > 0
        };
        let near = self.params.reach_m + 2.0 * self.params.point_spread_m;
        let candidates = self.records.iter().enumerate().filter(|(_, r)| shares(r) || distance(r) <= near);
        candidates.min_by(|a, b| distance(a.1).total_cmp(&distance(b.1))).map(|(index, _)| index)
    }

    /// True if the region is deeper than known damage explains.
    fn is_of_its_own(&self, region: &Region, known: Option<&[f32]>) -> bool {
        let Some(known) = known else { return true };
        let cells = self.finder.labels().iter().zip(self.mean.iter().zip(known));
        let left =
            cells.filter(|(label, _)| **label & region.bit != 0).map(|(_, (mean, known))| f64::from(known - mean));
        left.fold(0.0, f64::max) >= OF_ITS_OWN * region.depth
    }

    pub(super) fn suspect(&mut self, region: &Region, time_ns: u64) {
        let used = self.records.iter().fold(0_u16, |all, record| all | record.bit);
        if self.records.len() >= self.params.most {
            return;
        }
        let bit = 1 << (!used).trailing_zeros();
        let damage = Damage {
            id: self.next_id,
            state: DamageState::Suspected,
            shape: region.shape,
            depth: region.depth,
            volume_m2: region.volume_m2,
            share: 1.0,
            significance: region.depth / region.sigma,
            since_ns: time_ns,
            confirmed_ns: time_ns,
        };
        self.next_id += 1;
        self.records.push(Record { damage, seen_ns: time_ns, leaning_ns: None, modelled: false, bit, clear_ns: None });
        self.paint(bit, region.bit);
    }

    /// Assigns the cells of a region to a record.
    pub(super) fn paint(&mut self, bit: u16, region_bit: u16) {
        for (mask, label) in self.masks.iter_mut().zip(self.finder.labels()) {
            *mask = if label & region_bit != 0 { *mask | bit } else { *mask & !bit };
        }
    }

    /// Updates a record from a region in which it is seen. Position and size change only if it is suspected or has
    /// grown.
    fn measure(&mut self, index: usize, region: &Region, time_ns: u64) {
        let Record { damage, bit, seen_ns, .. } = &mut self.records[index];
        *seen_ns = time_ns;
        damage.significance = region.depth / region.sigma;
        let suspected = damage.state == DamageState::Suspected;
        let grown = region.volume_m2 > GROWN * damage.volume_m2 && region.depth >= damage.depth;
        if suspected || grown {
            (damage.shape, damage.depth, damage.volume_m2) = (region.shape, region.depth, region.volume_m2);
            let (bit, region_bit) = (*bit, region.bit);
            if grown && damage.is_open() {
                damage.share = 1.0;
                let damage = *damage;
                self.events.push(DamageEvent::Update(damage));
            }
            self.paint(bit, region_bit);
        }
    }

    /// Advances a record by one free frame.
    fn follow(&mut self, index: usize, frame: &DamageFrame<'_>) {
        let time_ns = frame.time_ns;
        let is_suspicious = self.is_suspicious();
        let (cells, mean, masks) = (&self.cells, &self.mean, &self.masks);
        let params = self.params;
        let record = &mut self.records[index];
        if !record.modelled && record.damage.state != DamageState::Suspected {
            let of_cell = |(cell, value): (usize, f32)| -f64::from(value) * cells.relative_area(cell);
            let left: f64 = within(masks, record.bit, mean).map(of_cell).sum();
            let left = left * (cells.cell_size_m() * cells.cell_size_m());
            record.damage.share = (left / record.damage.volume_m2).clamp(0.0, 1.0);
        }
        let share = record.damage.share;
        if share >= params.healed_share && record.damage.state != DamageState::Healed {
            record.damage.confirmed_ns = time_ns;
        }
        let wanted = match record.damage.state {
            DamageState::Suspected => DamageState::Confirmed,
            // A new cut diverts current, which makes other damage look shallower until the cut is known.
            DamageState::Confirmed if share < params.healing_share && !is_suspicious => DamageState::Healing,
            DamageState::Healing if share < params.healed_share => DamageState::Healed,
            DamageState::Healing if share > 0.5 + 0.5 * params.healing_share => DamageState::Confirmed,
            DamageState::Healed if share > REOPENED => DamageState::Confirmed,
            DamageState::Covered if share >= params.healing_share => DamageState::Confirmed,
            DamageState::Covered => DamageState::Healing,
            same => same,
        };
        if wanted == record.damage.state {
            record.leaning_ns = None;
            return;
        }
        let from = record.damage.state;
        let waits = if from == DamageState::Covered { 0.0 } else { params.confirm_s };
        let since_ns = match from {
            DamageState::Suspected => record.damage.since_ns,
            _ => *record.leaning_ns.get_or_insert(time_ns),
        };
        let called = |classes: super::ClassProbabilities<'_>| mean_within(masks, record.bit, classes.damaged) > 0.5;
        let doubted = from == DamageState::Suspected && !frame.classes.is_none_or(called);
        if seconds_between(since_ns, time_ns) < waits || doubted {
            return;
        }
        record.leaning_ns = None;
        record.damage.state = wanted;
        let damage = record.damage;
        self.events.push(match (from, wanted) {
            (DamageState::Suspected, _) => DamageEvent::Begin(damage),
            (DamageState::Covered, _) => DamageEvent::Uncovered(damage),
            (_, DamageState::Healed) => DamageEvent::Healed(damage),
            _ => DamageEvent::Update(damage),
        });
    }

    fn drop_unseen(&mut self, time_ns: u64) {
        let gone = |record: &Record| {
            record.damage.state == DamageState::Suspected && seconds_between(record.seen_ns, time_ns) > DROP_S
        };
        let bits = self.records.iter().filter(|record| gone(record)).fold(0, |all, record| all | record.bit);
        if bits != 0 {
            self.masks.iter_mut().for_each(|mask| *mask &= !bits);
            self.records.retain(|record| !gone(record));
        }
    }

    pub(super) fn publish(&mut self) {
        self.damages.clear();
        self.damages.extend(self.records.iter().map(|record| record.damage));
    }
}

/// The cells of a mask with finite values.
fn within<'a>(masks: &'a [u16], bit: u16, values: &'a [f32]) -> impl Iterator<Item = (usize, f32)> + 'a {
    let inside =
        masks.iter().zip(values).enumerate().filter(move |(_, (mask, value))| **mask & bit != 0 && value.is_finite());
    inside.map(|(cell, (_, value))| (cell, *value))
}

/// Unweighted mean over the cells of a mask.
fn mean_within(masks: &[u16], bit: u16, values: &[f32]) -> f64 {
    let (sum, count) = within(masks, bit, values).fold((0.0, 0u32), |(sum, n), (_, v)| (sum + f64::from(v), n + 1));
    if count > 0 { sum / f64::from(count) } else { f64::NAN }
}
