//! Infers faulty electrodes from bad channels. An electrode is lost if most of its channels are bad and other
//! electrodes do not explain them. Two are shorted if exactly the channels driven or read across the two are gone.

use super::wiring::Wiring;
use super::{ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, HealthParams};

/// Minimum number of channels needed to judge an electrode.
const FEWEST: usize = 3;

/// Judges electrodes. Owns its working memory.
#[derive(Debug, Clone)]
pub(super) struct ElectrodeFaults {
    lost: Vec<bool>,
    before: Vec<bool>,
    explained: Vec<bool>,
}

impl ElectrodeFaults {
    pub fn new(wiring: &Wiring) -> Self {
        let electrodes = wiring.electrode_count();
        Self {
            lost: vec![false; electrodes],
            before: vec![false; electrodes],
            explained: vec![false; wiring.channel_count()],
        }
    }

    /// Lost electrodes.
    pub fn lost(&self) -> &[bool] {
        &self.lost
    }

    /// Refills `faults` from the channels that are `bad` (with kind and onset). Shorts are inferred from dead
    /// channels.
    pub fn judge(
        &mut self,
        wiring: &Wiring,
        params: &HealthParams,
        bad: impl Fn(u32) -> Option<(ChannelFaultKind, u64, u64)>,
        faults: &mut Vec<ElectrodeFault>,
    ) {
        faults.clear();
        self.before.copy_from_slice(&self.lost);
        for electrode in 0..self.lost.len() {
            let channels = wiring.channels_of(electrode as u32);
            let share = channels.iter().filter(|&&c| bad(c).is_some()).count() as f64 / channels.len().max(1) as f64;
            let limit = if self.before[electrode] { params.acquit_share } else { params.blame_share };
            self.lost[electrode] = channels.len() >= FEWEST && share >= limit;
        }
        self.acquit_the_explained(wiring, &bad);
        for electrode in (0..self.lost.len()).filter(|&e| self.lost[e]) {
            let channels = wiring.channels_of(electrode as u32).iter();
            if let Some((since_ns, since_sequence)) = channels.filter_map(|&c| bad(c)).map(|(_, t, s)| (t, s)).min() {
                let (electrode, kind) = (electrode as u32, ElectrodeFaultKind::Lost);
                faults.push(ElectrodeFault { electrode, kind, since_ns, since_sequence });
            }
        }
        self.shorts(wiring, &bad, faults);
        faults.sort_by_key(|fault| fault.electrode);
    }

    /// Acquits electrodes that other lost ones explain. An electrode between two lost ones has no good channel
    /// either, but its loss is not needed to explain anything.
    fn acquit_the_explained(&mut self, wiring: &Wiring, bad: &impl Fn(u32) -> Option<(ChannelFaultKind, u64, u64)>) {
        for suspect in 0..self.lost.len() {
            if !self.lost[suspect] {
                continue;
            }
            self.explained.fill(false);
            for other in (0..self.lost.len()).filter(|&e| e != suspect && self.lost[e]) {
                wiring.channels_of(other as u32).iter().for_each(|&c| self.explained[c as usize] = true);
            }
            let needed = |c: &&u32| bad(**c).is_some() && !self.explained[**c as usize];
            let count = wiring.channels_of(suspect as u32).iter().filter(needed).count();
            let own = wiring.channels_of(suspect as u32).iter().filter(|&&c| !self.explained[c as usize]).count();
            // Most of the channels that no other lost electrode explains must be bad.
            self.lost[suspect] = count > 0 && 2 * count > own;
        }
    }

    fn shorts(
        &self,
        wiring: &Wiring,
        bad: &impl Fn(u32) -> Option<(ChannelFaultKind, u64, u64)>,
        faults: &mut Vec<ElectrodeFault>,
    ) {
        let dead = |c: &u32| bad(*c).filter(|(kind, ..)| *kind >= ChannelFaultKind::Dead);
        for (drive, pair) in wiring.drives.iter().enumerate() {
            let [a, b] = pair[..] else { continue };
            if self.lost[a as usize] || self.lost[b as usize] {
                continue;
            }
            let same = |pattern: &Vec<u32>| pattern.len() == 2 && pattern.contains(&a) && pattern.contains(&b);
            let Some(pattern) = wiring.patterns.iter().position(same) else { continue };
            let (driven, read) = (wiring.channels_of_drive(drive), wiring.channels_of_pattern(pattern));
            if driven.len() < FEWEST || read.len() < FEWEST || !driven.iter().chain(read).all(|c| dead(c).is_some()) {
                continue;
            }
            let since = driven.iter().chain(read).filter_map(dead).map(|(_, time, sequence)| (time, sequence)).min();
            for (electrode, with) in [(a, b), (b, a)] {
                let known = faults.iter().any(|fault| fault.electrode == electrode);
                if let (Some((since_ns, since_sequence)), false) = (since, known) {
                    let kind = ElectrodeFaultKind::Shorted { with };
                    faults.push(ElectrodeFault { electrode, kind, since_ns, since_sequence });
                }
            }
        }
    }
}
