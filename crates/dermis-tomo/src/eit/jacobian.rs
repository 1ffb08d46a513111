//! The adjoint Jacobian, per element or summed straight into pixels:
//! `J[m,k] = dv[m]/dsigma[k] = - int_k grad u_stim . grad u_meas`, with `u_meas` the field of the measuring pattern
//! driven as unit current (Geselowitz, IEEE Trans. Biomed. Eng. 18, 1971; sign as EIDORS).

use super::forward::Solution;
use super::protocol::Pattern;
use crate::mesh::PixelMap;

/// Elements handled together: long enough for vector instructions, short enough for the caches.
const BLOCK: usize = 128;

/// A dense matrix of sensitivities, row-major: `rows` channels x `columns` elements or pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Jacobian {
    /// Channels.
    pub rows: usize,
    /// Elements or pixels.
    pub columns: usize,
    /// Row-major values, V per S/m (V per S on a sheet).
    pub values: Vec<f64>,
}

impl Jacobian {
    /// Sensitivities of one channel.
    pub fn row(&self, channel: usize) -> &[f64] {
        &self.values[channel * self.columns..(channel + 1) * self.columns]
    }

    /// The same memory as a matrix of `faer`.
    pub fn as_mat(&self) -> faer::MatRef<'_, f64> {
        faer::MatRef::from_row_major_slice(&self.values, self.rows, self.columns)
    }
}

impl Solution<'_> {
    /// Sensitivity of every channel to the conductivity of every element.
    pub fn jacobian(&self) -> Jacobian {
        let (rows, columns) = (self.model.protocol.channel_count(), self.model.body.mesh.element_count());
        let mut values = vec![0.0; rows * columns];
        self.for_each_block(|first, block| {
            for channel in 0..rows {
                let target = &mut values[channel * columns + first..][..block.len];
                block.sensitivity(channel, target);
            }
        });
        Jacobian { rows, columns, values }
    }

    /// Sensitivity of every channel to the conductivity of every inside pixel of a grid: the element sensitivities
    /// shared out by area of overlap, without forming them all.
    pub fn jacobian_to_pixels(&self, map: &PixelMap) -> Jacobian {
        let (rows, columns) = (self.model.protocol.channel_count(), map.inside_count());
        // Transposed while summing, so that the scatter of one element writes contiguous runs of channels.
        let mut by_pixel = vec![0.0; rows * columns];
        let mut sensitivities = vec![0.0; BLOCK * rows];
        let mut line = vec![0.0; BLOCK];
        self.for_each_block(|first, block| {
            for channel in 0..rows {
                block.sensitivity(channel, &mut line[..block.len]);
                for (k, value) in line[..block.len].iter().enumerate() {
                    sensitivities[k * rows + channel] = *value;
                }
            }
            for k in 0..block.len {
                let source = &sensitivities[k * rows..(k + 1) * rows];
                for (pixel, weight) in map.overlaps_of_element(first + k) {
                    let target = &mut by_pixel[pixel * rows..(pixel + 1) * rows];
                    target.iter_mut().zip(source).for_each(|(sum, value)| *sum += weight * value);
                }
            }
        });
        let mut values = vec![0.0; rows * columns];
        transpose(&by_pixel, columns, rows, &mut values);
        Jacobian { rows, columns, values }
    }

    fn for_each_block(&self, mut visit: impl FnMut(usize, &Block<'_>)) {
        let protocol = &self.model.protocol;
        let patterns: Vec<&Pattern> = protocol.stimulations().iter().chain(protocol.patterns()).collect();
        let potentials: Vec<Vec<f64>> = patterns.iter().map(|pattern| self.pattern_potentials(pattern)).collect();
        let mesh = &self.model.body.mesh;
        let dimension = mesh.dimension();
        let mut gradients = vec![0.0; patterns.len() * dimension * BLOCK];
        for first in (0..mesh.element_count()).step_by(BLOCK) {
            let len = BLOCK.min(mesh.element_count() - first);
            for (pattern, potential) in potentials.iter().enumerate() {
                let target = &mut gradients[pattern * dimension * BLOCK..(pattern + 1) * dimension * BLOCK];
                for k in 0..len {
                    scaled_gradient(mesh.element(first + k), self.model.geometry.root(first + k), potential, target, k);
                }
            }
            let stimulations = protocol.stimulations().len();
            visit(first, &Block { protocol, gradients: &gradients, dimension, stimulations, len });
        }
    }
}

struct Block<'a> {
    protocol: &'a super::protocol::Protocol,
    /// patterns x dimension x BLOCK
    gradients: &'a [f64],
    dimension: usize,
    stimulations: usize,
    len: usize,
}

impl Block<'_> {
    fn sensitivity(&self, channel: usize, target: &mut [f64]) {
        let measurement = self.protocol.measurements()[channel];
        let component =
            |pattern: usize, axis: usize| &self.gradients[(pattern * self.dimension + axis) * BLOCK..][..self.len];
        let (drive, read) = (measurement.stimulation as usize, self.stimulations + measurement.pattern as usize);
        let (dx, rx, dy, ry) = (component(drive, 0), component(read, 0), component(drive, 1), component(read, 1));
        if self.dimension == 2 {
            for k in 0..self.len {
                target[k] = -(dx[k] * rx[k] + dy[k] * ry[k]);
            }
        } else {
            let (dz, rz) = (component(drive, 2), component(read, 2));
            for k in 0..self.len {
                target[k] = -(dx[k] * rx[k] + dy[k] * ry[k] + dz[k] * rz[k]);
            }
        }
    }
}

/// `C' du`: its dot products are `measure * grad . grad`.
#[inline]
fn scaled_gradient(cell: &[u32], root: &[f64], potential: &[f64], target: &mut [f64], k: usize) {
    let base = potential[cell[0] as usize];
    let d0 = potential[cell[1] as usize] - base;
    let d1 = potential[cell[2] as usize] - base;
    if cell.len() == 3 {
        target[k] = root[0] * d0 + root[1] * d1;
        target[BLOCK + k] = root[2] * d1;
    } else {
        let d2 = potential[cell[3] as usize] - base;
        target[k] = root[0] * d0 + root[1] * d1 + root[3] * d2;
        target[BLOCK + k] = root[2] * d1 + root[4] * d2;
        target[2 * BLOCK + k] = root[5] * d2;
    }
}

/// `rows x columns` to `columns x rows`, in tiles.
fn transpose(from: &[f64], rows: usize, columns: usize, to: &mut [f64]) {
    const TILE: usize = 16;
    for row0 in (0..rows).step_by(TILE) {
        for column0 in (0..columns).step_by(TILE) {
            for row in row0..(row0 + TILE).min(rows) {
                for column in column0..(column0 + TILE).min(columns) {
                    to[column * rows + row] = from[row * columns + column];
                }
            }
        }
    }
}
