//! Random numbers for errors.

use rand::rngs::StdRng;
use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, StandardNormal};

/// Largest error, in standard deviations; larger ones would be noticed and corrected.
const CUT_OFF: f64 = 3.0;

/// Random numbers for one purpose in one sample.
#[derive(Debug)]
pub struct Dice(StdRng);

impl Dice {
    /// Random numbers of this seed, sample and purpose.
    pub fn new(seed: u64, sample: u64, purpose: u64) -> Self {
        let mut mixed = [seed, sample, purpose].into_iter().fold(0x5eed_u64, |hash, value| {
            // The finaliser of SplitMix64.
            let mut z = (hash ^ value).wrapping_add(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            z ^ (z >> 31)
        });
        mixed ^= mixed >> 32;
        Self(StdRng::seed_from_u64(mixed))
    }

    /// A normal random number, cut off.
    pub fn normal(&mut self) -> f64 {
        let value: f64 = StandardNormal.sample(&mut self.0);
        value.clamp(-CUT_OFF, CUT_OFF)
    }

    /// A number from 0 to `count` - 1.
    pub fn below(&mut self, count: usize) -> usize {
        self.0.random_range(0..count.max(1) as u64) as usize
    }

    /// A seed.
    pub fn seed(&mut self) -> u64 {
        self.0.random_range(0..=i64::MAX as u64)
    }
}
