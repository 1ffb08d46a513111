//! Finds how rotation permutes a skin's channels, from a map of its signatures.
//!
//! Channels must be listed drive by drive, in as many equal blocks as there are electrodes, and around the skin
//! within a block. The channel at which a block starts need not be known: each block is rotated back onto the first
//! and shifted cyclically to agree best with the others. All numbers of electrodes and both senses are tried, and the
//! one under which the map is most likely is chosen.

use std::f64::consts::TAU;

use faer::Mat;

use super::data::SignatureMap;
use super::error::LocatorError;
use super::turn::Turn;

/// Numbers of electrodes tried, if they divide the number of channels.
const ELECTRODES: std::ops::RangeInclusive<usize> = 4..=64;
/// Positions per side at which maps are compared, within a circle of `WITHIN` times half the shorter side.
const PLACES: usize = 18;
const WITHIN: f64 = 0.8;
/// Maximum number of rounds of shifting every block.
const ROUNDS: usize = 6;
/// Minimum information that the rotated channels of a map must give about each other: the mean drop in a channel's
/// log variance.
const LEAST_TOLD: f64 = 0.3;
/// Minimum share of a channel's variance that the other channels cannot explain.
const UNTOLD_VARIANCE: f64 = 1e-3;

impl Turn {
    /// The rotation under which the channels of a map explain each other best; `None` if they explain little.
    /// `map_at` gives the map at any positions.
    pub(super) fn find(
        channels: usize,
        positions_m: &[[f64; 2]],
        map_at: impl Fn(&[[f64; 2]]) -> Result<SignatureMap, LocatorError>,
    ) -> Result<Option<Self>, LocatorError> {
        let bound =
            |axis: usize, pick: fn(f64, f64) -> f64, start: f64| positions_m.iter().map(|p| p[axis]).fold(start, pick);
        let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
        let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
        let centre_m = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis]));
        let radius_m = WITHIN * 0.5 * (high[0] - low[0]).min(high[1] - low[1]);
        let at = |k: usize| radius_m * (2.0 * (k as f64 + 0.5) / PLACES as f64 - 1.0);
        let lattice = (0..PLACES * PLACES).map(|k| [at(k % PLACES), at(k / PLACES)]);
        let places: Vec<[f64; 2]> = lattice
            .filter(|p| p[0].hypot(p[1]) < radius_m)
            .map(|p| [0, 1].map(|axis| centre_m[axis] + p[axis]))
            .collect();
        let mut best: Option<(f64, Self)> = None;
        for turns in ELECTRODES.filter(|turns| channels.is_multiple_of(*turns)) {
            let angle = TAU / turns as f64;
            let turn = Self { channels: Vec::new(), resemblance: vec![1.0; turns], angle, centre_m };
            let maps = (0..turns)
                .map(|s| map_at(&places.iter().map(|p| turn.place_m(*p, s as f64)).collect::<Vec<_>>()))
                .collect::<Result<Vec<_>, _>>()?;
            for sense in [1.0, -1.0] {
                let back = |block: usize| if sense > 0.0 { block } else { (turns - block) % turns };
                let blocks: Vec<Mat<f64>> = (0..turns).map(|b| block_of(&maps[back(b)], b, turns)).collect();
                let order = ordered(&blocks);
                let (told, resemblance) = resemblance(&blocks, &order);
                if best.as_ref().is_none_or(|(most, _)| told > *most) {
                    let channels = permutations(&order);
                    best = Some((told, Self { channels, resemblance, angle: sense * angle, centre_m }));
                }
            }
        }
        Ok(best.filter(|(told, _)| *told > LEAST_TOLD).map(|(_, turn)| turn))
    }
}

/// The channels of one block: positions by channels.
fn block_of(map: &SignatureMap, block: usize, blocks: usize) -> Mat<f64> {
    let wide = map.channels / blocks;
    Mat::from_fn(map.len(), wide, |p, k| map.signatures[p * map.channels + block * wide + k])
}

/// For each block, its channels (indices within the block) in the common order of all blocks.
fn ordered(blocks: &[Mat<f64>]) -> Vec<Vec<usize>> {
    let (turns, wide) = (blocks.len(), blocks[0].ncols());
    let mut order: Vec<Vec<usize>> = vec![(0..wide).collect()];
    for block in 1..turns {
        let last = picked(&blocks[block - 1], &order[block - 1]);
        order.push(begun_alike(&last, &blocks[block]));
    }
    let mut sum = Mat::<f64>::zeros(blocks[0].nrows(), wide);
    for (block, order) in blocks.iter().zip(&order) {
        sum += picked(block, order);
    }
    for _ in 0..ROUNDS {
        let mut changed = false;
        for block in 0..turns {
            let own = picked(&blocks[block], &order[block]);
            let neighbour = |b: usize| picked(&blocks[b % turns], &order[b % turns]);
            let others = (&sum - &own) * (1.0 / turns as f64) + neighbour(block + turns - 1) + neighbour(block + 1);
            let new = begun_alike(&others, &blocks[block]);
            changed |= new != order[block];
            sum += picked(&blocks[block], &new) - own;
            order[block] = new;
        }
        if !changed {
            break;
        }
    }
    order
}

fn picked(block: &Mat<f64>, order: &[usize]) -> Mat<f64> {
    Mat::from_fn(block.nrows(), order.len(), |p, k| block[(p, order[k])])
}

/// The channels of a block, shifted cyclically to agree best with `wanted`.
fn begun_alike(wanted: &Mat<f64>, block: &Mat<f64>) -> Vec<usize> {
    let wide = wanted.ncols();
    let along = wanted.transpose() * block;
    let agreement = |first: usize| (0..wide).map(|k| along[(k, (k + first) % wide)]).sum::<f64>();
    let first = (0..wide).fold(0, |best, first| if agreement(first) > agreement(best) { first } else { best });
    (0..wide).map(|k| (k + first) % wide).collect()
}

/// How much the channels explain of each other, and their correlation after each number of steps.
fn resemblance(blocks: &[Mat<f64>], order: &[Vec<usize>]) -> (f64, Vec<f64>) {
    let turns = blocks.len();
    let maps: Vec<Mat<f64>> = blocks.iter().zip(order).map(|(block, order)| picked(block, order)).collect();
    let square = |m: &Mat<f64>| m.squared_norm_l2();
    let total = maps.iter().map(square).sum::<f64>().max(f64::MIN_POSITIVE);
    let inner = |a: &Mat<f64>, b: &Mat<f64>| -> f64 { (0..a.ncols()).map(|k| a.col(k).transpose() * b.col(k)).sum() };
    let after = |s: usize| (0..turns).map(|b| inner(&maps[b], &maps[(b + s) % turns])).sum::<f64>() / total;
    let correlation: Vec<f64> = (0..turns).map(after).collect();
    let angle = |s: usize, f: usize| TAU * (s * f) as f64 / turns as f64;
    let spectrum: Vec<f64> = (0..turns)
        .map(|f| (0..turns).map(|s| correlation[s] * angle(s, f).cos()).sum::<f64>().max(UNTOLD_VARIANCE))
        .collect();
    let back = |s: usize| (0..turns).map(|f| spectrum[f] * angle(s, f).cos()).sum::<f64>();
    let own = back(0);
    let told = -spectrum.iter().map(|v| (v * turns as f64 / own).ln()).sum::<f64>() / turns as f64;
    (told, (0..turns).map(|s| back(s) / own).collect())
}

/// For every number of steps, the channel that each channel becomes.
fn permutations(order: &[Vec<usize>]) -> Vec<Vec<usize>> {
    let (turns, wide) = (order.len(), order[0].len());
    let mut channels = vec![vec![0; turns * wide]; turns];
    for (s, row) in channels.iter_mut().enumerate() {
        for block in 0..turns {
            let to = (block + s) % turns;
            for kind in 0..wide {
                row[block * wide + order[block][kind]] = to * wide + order[to][kind];
            }
        }
    }
    channels
}
