//! The adjoint Jacobian, per element or accumulated directly into pixels:
//! `J[m,k] = dv[m]/dsigma[k] = - int_k grad u_stim . grad u_meas`, where `u_meas` is the field of the measuring
//! pattern driven as a unit current (Geselowitz, IEEE Trans. Biomed. Eng. 18, 1971; sign as in EIDORS).

use std::collections::HashMap;

use pulp::{Arch, NullaryFnOnce};

use super::error::EitError;
use super::forward::Solution;
use super::protocol::{Pattern, Protocol};
use super::system::ElementGeometry;
use crate::mesh::{Mesh, PixelMap};

/// Elements per block: enough for vector instructions, few enough for the first-level cache.
const BLOCK: usize = 128;
/// Distance between the rows of a block. Not a power of two, so that rows do not compete for the same cache lines.
const STRIDE: usize = BLOCK + 8;

/// A dense matrix of sensitivities, row-major: `rows` channels x `columns` elements or pixels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Jacobian {
    /// Number of channels.
    pub rows: usize,
    /// Number of elements or pixels.
    pub columns: usize,
    /// Row-major values, V per S/m (V per S on a sheet).
    pub values: Vec<f64>,
}

impl Jacobian {
    /// Sensitivities of one channel.
    pub fn row(&self, channel: usize) -> &[f64] {
        &self.values[channel * self.columns..(channel + 1) * self.columns]
    }

    /// View of the same memory as a `faer` matrix.
    pub fn as_mat(&self) -> faer::MatRef<'_, f64> {
        faer::MatRef::from_row_major_slice(&self.values, self.rows, self.columns)
    }
}

impl Solution<'_> {
    /// Sensitivity of every channel to the conductivity of every element.
    pub fn jacobian(&self) -> Jacobian {
        let mut jacobian = Jacobian::default();
        self.jacobian_into(&mut jacobian);
        jacobian
    }

    /// As [`Solution::jacobian`], but reuses memory: a Jacobian is large, and getting fresh pages for it takes as
    /// long as computing it.
    pub fn jacobian_into(&self, jacobian: &mut Jacobian) {
        let fields = Fields::new(self);
        let (rows, columns) = (self.model.protocol.channel_count(), self.model.body.mesh.element_count());
        (jacobian.rows, jacobian.columns) = (rows, columns);
        jacobian.values.resize(rows * columns, 0.0);
        Arch::new().dispatch(ToElements { fields: &fields, columns, values: &mut jacobian.values });
    }

    /// Sensitivity of every channel to the conductivity of every inside pixel of a grid. Element sensitivities are
    /// distributed by area of overlap, without storing them all.
    pub fn jacobian_to_pixels(&self, map: &PixelMap) -> Jacobian {
        let fields = Fields::new(self);
        let mut by_pixel = vec![0.0; fields.pairs.len() * map.inside_count()];
        Arch::new().dispatch(ToPixels { fields: &fields, map, by_pixel: &mut by_pixel });
        fields.channels_of_pairs(&by_pixel, map.inside_count())
    }
}

impl Solution<'_> {
    /// `J' c`: sensitivity of a weighted sum of the channels to the conductivity of every element, without forming J.
    /// The weighted measuring patterns of one stimulation share one adjoint field, so the cost is one field per
    /// stimulation, whatever the number of channels.
    ///
    /// # Errors
    /// [`EitError::ChannelCount`] unless there is one weight per channel.
    pub fn vjp(&self, cotangent: &[f64]) -> Result<Vec<f64>, EitError> {
        let protocol = &self.model.protocol;
        if cotangent.len() != protocol.channel_count() {
            return Err(EitError::ChannelCount { expected: protocol.channel_count(), got: cotangent.len() });
        }
        let mut adjoints: Vec<Vec<(u32, f64)>> = vec![Vec::new(); protocol.stimulations().len()];
        for (channel, (measurement, weight)) in protocol.measurements().iter().zip(cotangent).enumerate() {
            let entries = protocol.pattern_of(channel).entries().iter().map(|&(electrode, w)| (electrode, weight * w));
            adjoints[measurement.stimulation as usize].extend(entries);
        }
        let (mesh, geometry) = (&self.model.body.mesh, &self.model.geometry);
        let mut gradient = vec![0.0; mesh.element_count()];
        for (stimulation, adjoint) in protocol.stimulations().iter().zip(adjoints) {
            let (drive, read) = (self.pattern_potentials(stimulation), self.pattern_potentials(&Pattern::new(adjoint)));
            for (element, sum) in gradient.iter_mut().enumerate() {
                let (cell, root) = (mesh.element(element), geometry.root(element));
                let (u, w) = (root_gradient(cell, root, &drive), root_gradient(cell, root, &read));
                *sum -= u[0] * w[0] + u[1] * w[1] + u[2] * w[2];
            }
        }
        Ok(gradient)
    }
}

/// `C' du` of one field in one element, as in [`Fields::gradients`].
fn root_gradient(cell: &[u32], root: &[f64], potentials: &[f64]) -> [f64; 3] {
    let rise = |corner: usize| potentials[cell[corner] as usize] - potentials[cell[0] as usize];
    let (a, b) = (rise(1), rise(2));
    if cell.len() == 3 {
        return [root[0] * a + root[1] * b, root[2] * b, 0.0];
    }
    let c = rise(3);
    [root[0] * a + root[1] * b + root[3] * c, root[2] * b + root[4] * c, root[5] * c]
}

/// Loop over blocks of elements, compiled for the vector instructions of the machine.
struct ToElements<'a> {
    fields: &'a Fields<'a>,
    columns: usize,
    /// Channels x elements.
    values: &'a mut [f64],
}

impl NullaryFnOnce for ToElements<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let mut gradients = self.fields.block();
        for first in (0..self.columns).step_by(BLOCK) {
            let len = BLOCK.min(self.columns - first);
            self.fields.gradients(first, len, &mut gradients);
            for (channel, &(pair, factor)) in self.fields.channels.iter().enumerate() {
                let target = &mut self.values[channel * self.columns + first..][..len];
                self.fields.sensitivity(pair, factor, &gradients, target);
            }
        }
    }
}

/// The same into pixels. Works on pairs of fields instead of channels, since reciprocal channels share a pair, and
/// pixel by pixel, so that an element's contributions go to contiguous runs.
struct ToPixels<'a> {
    fields: &'a Fields<'a>,
    map: &'a PixelMap,
    /// Pixels x pairs.
    by_pixel: &'a mut [f64],
}

impl NullaryFnOnce for ToPixels<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let (elements, pairs) = (self.fields.mesh.element_count(), self.fields.pairs.len());
        let mut gradients = self.fields.block();
        let mut lines = vec![0.0; pairs * BLOCK];
        let mut by_element = vec![0.0; pairs * BLOCK];
        for first in (0..elements).step_by(BLOCK) {
            let len = BLOCK.min(elements - first);
            self.fields.gradients(first, len, &mut gradients);
            for (pair, line) in lines.chunks_exact_mut(BLOCK).enumerate() {
                self.fields.sensitivity(pair as u32, 1.0, &gradients, &mut line[..len]);
            }
            transpose(&lines, pairs, BLOCK, &mut by_element);
            for (k, source) in by_element.chunks_exact(pairs).take(len).enumerate() {
                for (pixel, weight) in self.map.overlaps_of_element(first + k) {
                    let target = &mut self.by_pixel[pixel * pairs..(pixel + 1) * pairs];
                    target.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        }
    }
}

/// Two fields whose gradients are multiplied, the smaller index first.
type Pair = (u32, u32);

/// The distinct fields of a protocol, and how its channels combine them.
struct Fields<'a> {
    mesh: &'a Mesh,
    geometry: &'a ElementGeometry,
    /// Potentials, node by node; `count` fields each.
    potentials: Vec<f64>,
    count: usize,
    /// The distinct pairs of fields that the channels multiply.
    pairs: Vec<Pair>,
    /// For each channel, its pair and the factor on the product.
    channels: Vec<(u32, f64)>,
}

impl<'a> Fields<'a> {
    fn new(solution: &'a Solution<'_>) -> Self {
        let mut patterns = Distinct::default();
        let (pairs, channels) = patterns.pairs_of(&solution.model.protocol);
        let (mesh, count) = (&solution.model.body.mesh, patterns.list.len());
        let mut potentials = vec![0.0; mesh.nodes().len() * count];
        for (field, pattern) in patterns.list.iter().enumerate() {
            let of_nodes = solution.pattern_potentials(pattern);
            potentials.iter_mut().skip(field).step_by(count).zip(of_nodes).for_each(|(to, from)| *to = from);
        }
        Self { mesh, geometry: &solution.model.geometry, potentials, count, pairs, channels }
    }

    /// Buffer for the gradients of one block: fields x dimension x [`STRIDE`].
    fn block(&self) -> Vec<f64> {
        vec![0.0; self.count * self.mesh.dimension() * STRIDE]
    }

    /// `C' du` of every field in elements `first..first + len`. Its dot products are `measure * grad . grad`.
    #[inline(always)]
    fn gradients(&self, first: usize, len: usize, target: &mut [f64]) {
        for k in 0..len {
            let (cell, root) = (self.mesh.element(first + k), self.geometry.root(first + k));
            let at = |corner: usize| &self.potentials[cell[corner] as usize * self.count..][..self.count];
            let (base, a, b) = (at(0), at(1), at(2));
            if cell.len() == 3 {
                for (field, rows) in target.chunks_exact_mut(2 * STRIDE).enumerate() {
                    let (d0, d1) = (a[field] - base[field], b[field] - base[field]);
                    rows[k] = root[0] * d0 + root[1] * d1;
                    rows[STRIDE + k] = root[2] * d1;
                }
            } else {
                let c = at(3);
                for (field, rows) in target.chunks_exact_mut(3 * STRIDE).enumerate() {
                    let (d0, d1, d2) = (a[field] - base[field], b[field] - base[field], c[field] - base[field]);
                    rows[k] = root[0] * d0 + root[1] * d1 + root[3] * d2;
                    rows[STRIDE + k] = root[2] * d1 + root[4] * d2;
                    rows[2 * STRIDE + k] = root[5] * d2;
                }
            }
        }
    }

    /// `-factor * measure * grad . grad` of one pair over a block.
    #[inline(always)]
    fn sensitivity(&self, pair: u32, factor: f64, gradients: &[f64], target: &mut [f64]) {
        let (drive, read) = self.pairs[pair as usize];
        let dimension = self.mesh.dimension();
        let len = target.len();
        let row = |field: u32, axis: usize| &gradients[(field as usize * dimension + axis) * STRIDE..][..len];
        let (dx, rx, dy, ry) = (row(drive, 0), row(read, 0), row(drive, 1), row(read, 1));
        if dimension == 2 {
            for k in 0..len {
                target[k] = -factor * (dx[k] * rx[k] + dy[k] * ry[k]);
            }
        } else {
            let (dz, rz) = (row(drive, 2), row(read, 2));
            for k in 0..len {
                target[k] = -factor * (dx[k] * rx[k] + dy[k] * ry[k] + dz[k] * rz[k]);
            }
        }
    }

    /// Converts pixels x pairs to channels x pixels.
    fn channels_of_pairs(&self, by_pixel: &[f64], pixels: usize) -> Jacobian {
        let (rows, pairs) = (self.channels.len(), self.pairs.len());
        let mut values = vec![0.0; rows * pixels];
        for first in (0..pixels).step_by(BLOCK) {
            let block = &by_pixel[first * pairs..pairs * pixels.min(first + BLOCK)];
            for (channel, &(pair, factor)) in self.channels.iter().enumerate() {
                let source = block.iter().skip(pair as usize).step_by(pairs);
                let target = &mut values[channel * pixels + first..(channel + 1) * pixels];
                target.iter_mut().zip(source).for_each(|(to, from)| *to = factor * from);
            }
        }
        Jacobian { rows, columns: pixels, values }
    }
}

/// Patterns that are not multiples of each other, each scaled to weight 1 on its first electrode.
#[derive(Default)]
struct Distinct {
    list: Vec<Pattern>,
    known: HashMap<Vec<(u32, u64)>, u32>,
}

impl Distinct {
    /// Index of a pattern's direction, and the factor on it.
    fn add(&mut self, pattern: &Pattern) -> (u32, f64) {
        let scale = pattern.entries().first().map_or(1.0, |entry| entry.1);
        let unit: Vec<(u32, f64)> = pattern.entries().iter().map(|&(e, weight)| (e, weight / scale)).collect();
        let key = unit.iter().map(|&(electrode, weight)| (electrode, weight.to_bits())).collect();
        let index = *self.known.entry(key).or_insert_with(|| {
            self.list.push(Pattern::new(unit));
            self.list.len() as u32 - 1
        });
        (index, scale)
    }

    /// The distinct pairs of a protocol, and the pair and factor of each channel.
    fn pairs_of(&mut self, protocol: &Protocol) -> (Vec<Pair>, Vec<(u32, f64)>) {
        let drives: Vec<(u32, f64)> = protocol.stimulations().iter().map(|pattern| self.add(pattern)).collect();
        let reads: Vec<(u32, f64)> = protocol.patterns().iter().map(|pattern| self.add(pattern)).collect();
        let mut pairs = Vec::new();
        let mut known: HashMap<Pair, u32> = HashMap::new();
        let mut channel = |drive: (u32, f64), read: (u32, f64)| {
            let pair = (drive.0.min(read.0), drive.0.max(read.0));
            let index = *known.entry(pair).or_insert_with(|| {
                pairs.push(pair);
                pairs.len() as u32 - 1
            });
            (index, drive.1 * read.1)
        };
        let channels = protocol.measurements().iter();
        let channels = channels.map(|m| channel(drives[m.stimulation as usize], reads[m.pattern as usize])).collect();
        (pairs, channels)
    }
}

/// Transposes `rows x columns` to `columns x rows`, in tiles.
#[inline(always)]
fn transpose(from: &[f64], rows: usize, columns: usize, to: &mut [f64]) {
    const TILE: usize = 16;
    for row0 in (0..rows).step_by(TILE) {
        for column0 in (0..columns).step_by(TILE) {
            for column in column0..(column0 + TILE).min(columns) {
                for row in row0..(row0 + TILE).min(rows) {
                    to[column * rows + row] = from[row * columns + column];
                }
            }
        }
    }
}
