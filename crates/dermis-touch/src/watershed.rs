//! Splits an image into the basins of its peaks by flooding from the top.
//!
//! Cells are visited from the highest down (ties by index, so the result is deterministic). A cell without flooded
//! neighbours starts a basin; others join the basin of their highest neighbour. The saddle of two basins is where
//! they first meet: the lower one is absorbed if its prominence over the saddle is too small. This is the watershed
//! by immersion of Vincent and Soille, IEEE PAMI 13 (1991) 583, run downwards and with merging by persistence.

use crate::cells::{Bounds, Lattice};

/// When two basins that meet are a single peak.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MergeRule {
    /// Merge if the saddle is above this share of the lower peak.
    pub saddle_ratio: f32,
    /// Merge if the lower peak rises less than this many sigma above the saddle.
    pub min_prominence_sigma: f32,
}

/// A peak and the cells that drain to it.
#[derive(Debug, Clone, Copy)]
struct Basin {
    peak: f32,
    /// Slot of the peak's cell.
    slot: u32,
    /// Index of the basin that absorbed this one, or its own.
    parent: u32,
    /// Prominence that the peak needs to remain separate, image units.
    min_prominence: f32,
}

/// The flooded image with its working memory. Values and labels are stored in the slots of a lattice; the values of
/// slots without a cell are NaN.
#[derive(Debug, Clone)]
pub(crate) struct Watershed<L> {
    lattice: L,
    /// Signed so that contacts are positive; NaN outside.
    values: Vec<f32>,
    /// Basin index + 1; 0 = not flooded.
    labels: Vec<u32>,
    /// (descending value, ascending slot) packed into one integer.
    order: Vec<u64>,
    basins: Vec<Basin>,
}

impl<L: Lattice> Watershed<L> {
    pub(crate) fn new(lattice: L) -> Self {
        let (slots, cells, most_peaks) = (lattice.slots(), lattice.cells(), lattice.most_peaks());
        Self {
            lattice,
            values: vec![f32::NAN; slots],
            labels: vec![0; slots],
            order: Vec::with_capacity(cells),
            basins: Vec::with_capacity(most_peaks),
        }
    }

    /// The cells.
    pub(crate) fn lattice(&self) -> &L {
        &self.lattice
    }

    /// Loads an image: values times `factor`, NaN if they are not finite or their noise is not usable. Returns the
    /// largest value (0 if none is positive).
    pub(crate) fn load(&mut self, image: &[f32], sigma: Option<&[f32]>, factor: f32) -> f32 {
        for (slots, cells) in self.lattice.pieces() {
            let target = &mut self.values[slots];
            let oriented = |value: f32| if value.abs() <= f32::MAX { factor * value } else { f32::NAN };
            match sigma {
                None => target.iter_mut().zip(&image[cells]).for_each(|(to, &from)| *to = oriented(from)),
                Some(sigma) => {
                    for ((to, &from), &sigma) in target.iter_mut().zip(&image[cells.clone()]).zip(&sigma[cells]) {
                        *to = if (0.0..=f32::MAX).contains(&sigma) { oriented(from) } else { f32::NAN };
                    }
                }
            }
        }
        largest_of(&self.values, |value| value)
    }

    /// Floods every cell at or above `floor` (which must be positive). `sigma` gives the noise of a cell.
    pub(crate) fn flood(&mut self, floor: f32, rule: MergeRule, sigma: impl Fn(usize) -> f32) {
        self.sort_cells(floor);
        self.labels.fill(0);
        self.basins.clear();
        let Self { lattice, values, labels, order, basins } = self;
        let mut flood = Flood { values, labels, basins, rule, sigma };
        lattice.with_room(|lattice, roots| {
            for &key in order.iter() {
                flood.take(lattice, unpack_slot(key), roots);
            }
        });
    }

    fn sort_cells(&mut self, floor: f32) {
        self.order.clear();
        for (slots, _) in self.lattice.pieces() {
            for slot in slots {
                let value = self.values[slot];
                if value >= floor {
                    // Positive floats sort like their bit patterns.
                    self.order.push((u64::from(!value.to_bits()) << 32) | slot as u64);
                }
            }
        }
        self.order.sort_unstable();
    }

    /// Remaining peaks from the highest down: (basin, value, slot).
    pub(crate) fn peaks(&self) -> impl Iterator<Item = (u32, f32, usize)> + '_ {
        self.basins
            .iter()
            .enumerate()
            .filter(|(index, basin)| basin.parent == *index as u32)
            .map(|(index, basin)| (index as u32, basin.peak, basin.slot as usize))
    }

    /// Merges one remaining basin into another.
    pub(crate) fn absorb(&mut self, basin: u32, into: u32) {
        self.basins[basin as usize].parent = into;
    }

    /// Number of flooded cells.
    pub(crate) fn flooded(&self) -> usize {
        self.order.len()
    }

    /// The flooded cell at index `position`, from the highest down: (slot, value, remaining basin).
    pub(crate) fn flooded_cell(&mut self, position: usize) -> (usize, f32, u32) {
        let slot = unpack_slot(self.order[position]);
        let basin = root(&mut self.basins, self.labels[slot] - 1);
        (slot, self.values[slot], basin)
    }

    /// Visits the flooded cells within bounds whose value is at least `least`, with slot and remaining basin.
    pub(crate) fn for_each_within(&mut self, bounds: Bounds, least: f32, mut visit: impl FnMut(&L, usize, u32)) {
        let Self { lattice, values, labels, basins, .. } = self;
        lattice.slots_within(bounds).for_each(|slot| {
            if values[slot] >= least && labels[slot] != 0 {
                visit(lattice, slot, root(basins, labels[slot] - 1));
            }
        });
    }

    /// Shift and height of the peak at a slot: see [`Lattice::refined_peak`].
    pub(crate) fn refined_peak(&self, slot: usize) -> ([f64; 2], f64) {
        self.lattice.refined_peak(&self.values, slot)
    }
}

/// An image while it is flooded.
struct Flood<'a, F> {
    values: &'a [f32],
    labels: &'a mut [u32],
    basins: &'a mut Vec<Basin>,
    rule: MergeRule,
    sigma: F,
}

impl<F: Fn(usize) -> f32> Flood<'_, F> {
    /// Floods one cell; `roots` has room for one number per neighbour.
    #[inline]
    fn take<L: Lattice>(&mut self, lattice: &L, slot: usize, roots: &mut [u32]) {
        let value = self.values[slot];
        let mut count = 0;
        let mut highest = (f32::NEG_INFINITY, 0u32);
        let mut last = (0u32, 0u32);
        for neighbour in lattice.neighbours(slot) {
            let label = self.labels[neighbour];
            if label == 0 {
                continue;
            }
            // Most neighbours have the same label: look its basin up once.
            if label != last.0 {
                last = (label, root(self.basins, label - 1));
                if !roots[..count].contains(&last.1) {
                    roots[count] = last.1;
                    count += 1;
                }
            }
            if self.values[neighbour] > highest.0 {
                highest = (self.values[neighbour], last.1);
            }
        }
        if count == 0 {
            let basin = self.basins.len() as u32;
            let min_prominence = self.rule.min_prominence_sigma * (self.sigma)(lattice.cell(slot));
            self.basins.push(Basin { peak: value, slot: slot as u32, parent: basin, min_prominence });
            self.labels[slot] = basin + 1;
            return;
        }
        self.labels[slot] = highest.1 + 1;
        if count > 1 {
            // Basins are numbered in the order of their peaks, so the lowest number is the highest peak.
            roots[..count].sort_unstable();
            self.absorb_at_saddle(&roots[..count], value);
        }
    }

    fn absorb_at_saddle(&mut self, roots: &[u32], saddle: f32) {
        for &lower in &roots[1..] {
            let Basin { peak, min_prominence, .. } = self.basins[lower as usize];
            if saddle > self.rule.saddle_ratio * peak || peak - saddle < min_prominence {
                self.basins[lower as usize].parent = roots[0];
            }
        }
    }
}

/// The remaining basin that `basin` was merged into.
fn root(basins: &mut [Basin], mut basin: u32) -> u32 {
    while basins[basin as usize].parent != basin {
        let parent = basins[basin as usize].parent;
        basins[basin as usize].parent = basins[parent as usize].parent;
        basin = parent;
    }
    basin
}

/// Number of values compared in parallel. Lane-by-lane comparisons become vector instructions; a single running
/// extreme does not.
const LANES: usize = 16;

/// The largest finite `size(value)`, or 0 if none is positive. The comparisons skip NaN.
pub(crate) fn largest_of(values: &[f32], size: impl Fn(f32) -> f32) -> f32 {
    let mut most = [0.0_f32; LANES];
    let mut raise = |lane: usize, value: f32| {
        let value = size(value);
        most[lane] = if value > most[lane] && value <= f32::MAX { value } else { most[lane] };
    };
    let (blocks, rest) = values.as_chunks::<LANES>();
    for block in blocks {
        for lane in 0..LANES {
            raise(lane, block[lane]);
        }
    }
    rest.iter().enumerate().for_each(|(lane, &value)| raise(lane, value));
    most.into_iter().fold(0.0, f32::max)
}

/// Like `largest_of`, over cells with usable noise. Also returns the smallest usable noise (infinite if there is
/// none).
pub(crate) fn largest_with_noise(values: &[f32], sigma: &[f32], size: impl Fn(f32) -> f32) -> (f32, f32) {
    let (mut most, mut least) = ([0.0_f32; LANES], [f32::INFINITY; LANES]);
    let mut take = |lane: usize, value: f32, sigma: f32| {
        let (value, usable) = (size(value), (0.0..=f32::MAX).contains(&sigma));
        most[lane] = if usable && value > most[lane] && value <= f32::MAX { value } else { most[lane] };
        least[lane] = if usable && sigma < least[lane] { sigma } else { least[lane] };
    };
    let (blocks, rest) = values.as_chunks::<LANES>();
    let (noises, rest_of_noise) = sigma.as_chunks::<LANES>();
    for (block, noise) in blocks.iter().zip(noises) {
        for lane in 0..LANES {
            take(lane, block[lane], noise[lane]);
        }
    }
    rest.iter().zip(rest_of_noise).enumerate().for_each(|(lane, (&value, &sigma))| take(lane, value, sigma));
    (most.into_iter().fold(0.0, f32::max), least.into_iter().fold(f32::INFINITY, f32::min))
}

fn unpack_slot(key: u64) -> usize {
    (key & 0xffff_ffff) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::{GridGeometry, GridLattice};

    fn flooded(columns: usize, image: &[f32], ratio: f32) -> Vec<(f32, usize)> {
        let grid = GridGeometry::centred(columns, image.len() / columns, 1e-3);
        let mut shed = Watershed::new(GridLattice::new(grid));
        shed.load(image, None, 1.0);
        shed.flood(0.01, MergeRule { saddle_ratio: ratio, min_prominence_sigma: 0.0 }, |_| 0.0);
        let peaks: Vec<_> = shed.peaks().collect();
        peaks.into_iter().map(|(_, value, slot)| (value, shed.lattice().cell(slot))).collect()
    }

    #[test]
    fn saddle_decides_between_one_and_two() {
        let ridge = [0.0, 2.0, 1.2, 1.5, 0.0];
        // 1.2 / 1.5 = 0.8.
        assert_eq!(flooded(5, &ridge, 0.75), [(2.0, 1)]);
        assert_eq!(flooded(5, &ridge, 0.85), [(2.0, 1), (1.5, 3)]);
    }

    #[test]
    fn nan_walls_separate_and_plateaus_have_one_peak() {
        assert_eq!(flooded(5, &[1.0, 1.0, f32::NAN, 1.0, 1.0], 0.75), [(1.0, 0), (1.0, 3)]);
    }

    #[test]
    fn rows_do_not_wrap() {
        // The last pixel of one row and the first of the next are not neighbours.
        let image = [0.0, 0.0, 0.0, 1.0, 0.9, 0.0, 0.0, 0.0];
        assert_eq!(flooded(4, &image, 0.75), [(1.0, 3), (0.9, 4)]);
    }
}
