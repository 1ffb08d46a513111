//! Damage that the caller knows to be permanent, in addition to what the monitor finds in the mean of free frames. It
//! is confirmed at once, and the caller says how much of it is left.

use super::region::Region;
use super::{DamageEvent, DamageMonitor, DamageState};
use crate::contact::PixelNoise;
use crate::error::{TouchError, require_length};

impl DamageMonitor {
    /// Begins a frame that only [`DamageMonitor::declare`] judges. Clears earlier events.
    ///
    /// # Errors
    /// [`TouchError::TimeReversed`].
    pub fn begin_frame(&mut self, time_ns: u64) -> Result<(), TouchError> {
        if let Some(previous_ns) = self.time_ns.filter(|previous| time_ns < *previous) {
            return Err(TouchError::TimeReversed { time_ns, previous_ns });
        }
        self.time_ns = Some(time_ns);
        self.events.clear();
        Ok(())
    }

    /// Declares the image of a permanent change as damage (below zero is damage). The deepest region gives its
    /// position; the others are treated as side lobes. If a damage site is already known there, it has grown. Returns
    /// the identity of the site, or `None` if no region is deep enough.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn declare(&mut self, since_ns: u64, image: &[f32], noise: PixelNoise<'_>) -> Result<Option<u64>, TouchError> {
        require_length("image", self.cells.len(), image.len())?;
        noise.validate(self.cells.len())?;
        let sigma = |cell: usize| f64::from(noise.at(cell));
        self.finder.find(image, &self.cells, &self.params, sigma, self.params.smallest_depth);
        let Some(&region) = self.finder.regions().first() else { return Ok(None) };
        let known = self.record_of(&region);
        if known.is_none() {
            if self.records.len() >= self.params.most {
                return Ok(None);
            }
            self.suspect(&region, since_ns);
        }
        let index = known.unwrap_or(self.records.len() - 1);
        let record = &mut self.records[index];
        let damage = &mut record.damage;
        if known.is_some() {
            if region.volume_m2 > damage.volume_m2 {
                damage.shape = region.shape;
            }
            damage.depth = damage.depth.max(region.depth);
            damage.volume_m2 = damage.share * damage.volume_m2 + region.volume_m2;
            damage.share = 1.0;
        }
        damage.significance = region.depth / region.sigma;
        damage.state = DamageState::Confirmed;
        damage.confirmed_ns = self.time_ns.unwrap_or(since_ns);
        record.modelled = true;
        let damage = record.damage;
        self.events.push(if known.is_some() { DamageEvent::Update(damage) } else { DamageEvent::Begin(damage) });
        self.publish();
        Ok(Some(damage.id))
    }

    /// Updates position, extent and depth of a known damage site from an image of its remainder, made by another
    /// operator. Nothing else changes. `left` is the share of its worst state that the image shows. If the image shows
    /// only this site, the deepest region is used, otherwise the nearest. If no region is deep enough, position and
    /// extent are unchanged.
    ///
    /// # Errors
    /// [`TouchError::Length`].
    pub fn redraw(
        &mut self,
        id: u64,
        image: &[f32],
        noise: PixelNoise<'_>,
        left: f64,
        is_alone: bool,
    ) -> Result<(), TouchError> {
        require_length("image", self.cells.len(), image.len())?;
        noise.validate(self.cells.len())?;
        let Some(index) = self.records.iter().position(|record| record.damage.id == id) else { return Ok(()) };
        let sigma = |cell: usize| f64::from(noise.at(cell));
        self.finder.find(image, &self.cells, &self.params, sigma, left * self.params.smallest_depth);
        let shape = self.records[index].damage.shape;
        let away = |region: &&Region| shape.distance_m(region.shape.centre_m);
        let regions = self.finder.regions();
        let region = if is_alone { regions.first() } else { regions.iter().min_by(|a, b| away(a).total_cmp(&away(b))) };
        let Some(&region) = region else { return Ok(()) };
        let damage = &mut self.records[index].damage;
        damage.shape = region.shape;
        (damage.depth, damage.volume_m2) = (region.depth / left, region.volume_m2 / left);
        damage.significance = region.depth / region.sigma;
        self.paint(self.records[index].bit, region.bit);
        self.publish();
        Ok(())
    }

    /// Sets how much of a damage site is left, as known by the caller. This may mark it as healing or healed.
    pub fn set_share(&mut self, id: u64, share: f64) {
        let [healing, healed] = [self.params.healing_share, self.params.healed_share];
        let open = self.records.iter_mut().find(|record| record.damage.id == id && record.damage.is_open());
        let Some(record) = open else { return };
        record.damage.share = share.clamp(0.0, 1.0);
        record.damage.state = match record.damage.share {
            share if share < healed => DamageState::Healed,
            share if share < healing => DamageState::Healing,
            _ => DamageState::Confirmed,
        };
        let damage = record.damage;
        match damage.state {
            DamageState::Healed => self.events.push(DamageEvent::Healed(damage)),
            DamageState::Healing => self.events.push(DamageEvent::Update(damage)),
            _ => {}
        }
        self.publish();
    }
}
