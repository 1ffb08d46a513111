//! The tabulated responses of a skin to spots, for given channel noise.

use std::sync::Arc;

use faer::linalg::solvers::DenseSolveCore;
use faer::{Mat, MatRef, Side};

use super::SpotOptions;
use super::large_changes::{ChangeResponse, LargeChanges};
use super::responses::Responses;
use super::table::Table;
use crate::inverse::InverseError;
use crate::inverse::error::positive;
use crate::mesh::Point;

/// Largest number of combinations of channels kept.
const MOST_COMBINATIONS: usize = 128;
/// Combinations with less than this share of the strongest one's energy are left out.
const LEAST_ENERGY: f64 = 1e-9;

/// The tabulated responses of one skin for given channel noise.
#[derive(Clone, Debug)]
pub struct SpotModel {
    options: SpotOptions,
    pub(super) responses: Responses,
    /// One row per channel: whitens and projects a frame.
    projection: Vec<f32>,
    channels: usize,
    /// Response to a uniform change of the whole skin.
    pub(super) uniform: Vec<f32>,
    /// Volts of each channel (rows) per unit of each combination (columns): from the table back to channels. 0 for
    /// channels that are left out.
    pub(super) lift: Mat<f64>,
    /// Nonlinear response to large spots, if known.
    pub(super) large: Option<Arc<LargeChanges>>,
    /// The changes caused by spots, kept if fits no longer correct for large ones.
    pub(super) loads: Option<Arc<LargeChanges>>,
}

impl SpotModel {
    /// Tabulates spots. `response` is channels x pixels, in volts per unit of load on a pixel. `uniform` is the
    /// response of the channels to a uniform change of the whole skin. `positions_m` holds the centres of the pixels,
    /// row by row, and `pixel_m` is their side. `deviations` holds the standard deviation of each channel in volts;
    /// channels whose deviation is not positive and finite are left out.
    ///
    /// # Errors
    /// Counts that disagree, radii that are not positive or not in order, values that are not finite, no usable
    /// channel.
    pub fn new(
        response: MatRef<'_, f64>,
        uniform: &[f64],
        deviations: &[f64],
        positions_m: &[Point],
        pixel_m: f64,
        options: SpotOptions,
    ) -> Result<Self, InverseError> {
        if uniform.len() != response.nrows() {
            let (expected, got) = (response.nrows(), uniform.len());
            return Err(InverseError::Size { what: "response to a uniform change", expected, got });
        }
        check(response, deviations, positions_m, pixel_m, &options)?;
        let options = options.on_pixels(pixel_m);
        let root = |channel: usize| {
            let deviation = deviations[channel];
            if deviation > 0.0 && deviation.is_finite() { 1.0 / deviation } else { 0.0 }
        };
        let whitened = Mat::from_fn(response.nrows(), response.ncols(), |c, p| root(c) * response[(c, p)]);
        let basis = combinations(whitened.as_ref())?;
        let reduced = basis.transpose() * &whitened;
        let table = Table::new(reduced.as_ref(), positions_m, pixel_m, &options);
        let count = basis.ncols();
        let projection =
            (0..response.nrows() * count).map(|k| (root(k / count) * basis[(k / count, k % count)]) as f32).collect();
        let of_uniform = |k: usize| (0..uniform.len()).map(|c| basis[(c, k)] * root(c) * uniform[c]).sum::<f64>();
        let uniform = (0..count).map(|k| of_uniform(k) as f32).collect();
        let volts = |channel: usize| if root(channel) > 0.0 { deviations[channel] } else { 0.0 };
        let lift = Mat::from_fn(response.nrows(), count, |c, k| volts(c) * basis[(c, k)]);
        let responses = Responses::new(table);
        let channels = response.nrows();
        Ok(Self { options, responses, projection, channels, uniform, lift, large: None, loads: None })
    }

    /// The same model for spots that may be large. `response` gives the change of the channels. `jacobian` is
    /// channels x pixels, in volts per relative change of a pixel, with the sign convention of spots. `spread` is
    /// pixels x pixels: the change of every pixel (rows) by a load on one (columns); leave it out if a load changes
    /// only its own pixel. `jacobian spread` must be the response that the model was made from, and `positions_m` the
    /// centres of the same pixels. `sign` is 1 if positive spots raise conductivity and -1 if they lower it. Call
    /// this before changing the noise or the channels of the model.
    ///
    /// # Errors
    /// Counts that disagree.
    pub fn with_large_changes(
        mut self,
        response: ChangeResponse,
        jacobian: MatRef<'_, f64>,
        spread: Option<MatRef<'_, f64>>,
        positions_m: &[Point],
        sign: f64,
    ) -> Result<Self, InverseError> {
        let (channels, count, pixels) = (self.channels, self.combinations(), positions_m.len());
        let spread_by = spread.map_or([pixels; 2], |spread| [spread.nrows(), spread.ncols()]);
        for (what, expected, got) in [
            ("channels of the Jacobian", channels, jacobian.nrows()),
            ("pixels of the Jacobian", pixels, jacobian.ncols()),
            ("pixels that a load changes", pixels, spread_by[0]),
            ("pixels with loads", pixels, spread_by[1]),
        ] {
            if expected != got {
                return Err(InverseError::Size { what, expected, got });
            }
        }
        let project = Mat::from_fn(count, channels, |k, c| f64::from(self.projection[c * count + k]));
        let reduced = &project * jacobian;
        let smoothing_m = self.options.smoothing_m;
        let large =
            LargeChanges::new(response, &self.projection, reduced.as_ref(), spread, positions_m, smoothing_m, sign);
        self.large = Some(Arc::new(large));
        self.loads = self.large.clone();
        Ok(self)
    }

    /// The same responses for other noise, from the same table, at a thousandth of the cost. Within the combinations
    /// that are kept, estimates are those of generalised least squares. Channels whose deviation is not positive and
    /// finite get the largest deviation of the others.
    ///
    /// # Errors
    /// The wrong number of channels, or none with a usable deviation.
    pub fn reweighted(&self, deviations: &[f64]) -> Result<Self, InverseError> {
        self.marginalised(deviations, &[])
    }

    /// Like [`SpotModel::reweighted`], with nuisances: changes of all channels (volts for one standard deviation of
    /// each) that may be part of any frame. The covariance of a frame is `D^2 + sum n n'`, so the amplitudes of the
    /// nuisances are marginalised out of the fits.
    ///
    /// # Errors
    /// As [`SpotModel::reweighted`], and nuisances of the wrong length.
    pub fn marginalised(&self, deviations: &[f64], nuisances: &[Vec<f64>]) -> Result<Self, InverseError> {
        let (channels, count) = (self.channels, self.combinations());
        if deviations.len() != channels {
            let (expected, got) = (channels, deviations.len());
            return Err(InverseError::Size { what: "deviations of channels", expected, got });
        }
        let usable = |d: &f64| *d > 0.0 && d.is_finite();
        let noisiest = deviations.iter().copied().filter(usable).fold(0.0, f64::max);
        let deviation = |c: usize| if usable(&deviations[c]) { deviations[c] } else { noisiest };
        let noise = Mat::from_fn(channels, count, |c, k| deviation(c) * f64::from(self.projection[c * count + k]));
        let mut covariance = noise.transpose() * &noise;
        for nuisance in nuisances {
            if nuisance.len() != channels {
                let (expected, got) = (channels, nuisance.len());
                return Err(InverseError::Size { what: "channels of a nuisance", expected, got });
            }
            let mut projected = vec![0.0; count];
            for (row, value) in self.projection.chunks_exact(count).zip(nuisance) {
                projected.iter_mut().zip(row).for_each(|(sum, entry)| *sum += f64::from(*entry) * value);
            }
            for column in 0..count {
                (0..count).for_each(|row| covariance[(row, column)] += projected[row] * projected[column]);
            }
        }
        let factor = covariance.llt(Side::Lower).map_err(|_| InverseError::Singular {
            what: "the noise of combinations of channels",
            hint: "at least one channel must have a positive deviation",
        })?;
        let inverse = factor.L().partial_piv_lu().inverse();
        let single = Mat::from_fn(count, count, |row, column| inverse[(row, column)] as f32);
        let row = |row: &[f32]| -> Vec<f32> { (&single * faer::ColRef::from_slice(row)).iter().copied().collect() };
        Ok(Self {
            options: self.options,
            responses: self.responses.combined(single.as_ref()),
            projection: self.projection.chunks_exact(count).flat_map(row).collect(),
            channels,
            uniform: row(&self.uniform),
            lift: &self.lift * factor.L(),
            large: self.large.clone(),
            loads: self.loads.clone(),
        })
    }

    /// The same responses for other noise and without some channels, from the same table. Values of the missing
    /// channels are ignored. A tabulated response t, brought back to channels and whitened for the new noise, is
    /// `W^1/2 L t`. With `W^1/2 L = Q R`, its projection on Q is `R t`: the remaining channels still see everything
    /// that the kept combinations can distinguish. Channels whose deviation is not positive and finite get the largest
    /// deviation of the others. All changes are treated as small.
    ///
    /// # Errors
    /// The wrong number of channels, or none left with a usable deviation.
    pub fn without(&self, missing: &[u32], deviations: &[f64]) -> Result<Self, InverseError> {
        let (channels, count) = (self.channels, self.combinations());
        if deviations.len() != channels {
            let (expected, got) = (channels, deviations.len());
            return Err(InverseError::Size { what: "deviations of channels", expected, got });
        }
        let usable = |d: &f64| *d > 0.0 && d.is_finite();
        let noisiest = deviations.iter().copied().filter(usable).fold(0.0, f64::max);
        let present: Vec<usize> = (0..channels).filter(|c| !missing.contains(&(*c as u32))).collect();
        if present.is_empty() || noisiest == 0.0 {
            return Err(InverseError::NoChannels { channels });
        }
        let deviation = |c: usize| if usable(&deviations[c]) { deviations[c] } else { noisiest };
        let whitened = Mat::from_fn(present.len(), count, |k, n| self.lift[(present[k], n)] / deviation(present[k]));
        let factor = whitened.qr();
        let (basis, triangle) = (factor.compute_thin_Q(), factor.thin_R());
        let kept = basis.ncols();
        let single = Mat::from_fn(kept, count, |row, column| triangle[(row, column)] as f32);
        let mut projection = vec![0.0; channels * kept];
        let mut lift = Mat::zeros(channels, kept);
        for (row, &channel) in present.iter().enumerate() {
            for k in 0..kept {
                projection[channel * kept + k] = (basis[(row, k)] / deviation(channel)) as f32;
                lift[(channel, k)] = basis[(row, k)] * deviation(channel);
            }
        }
        let uniform = (&single * faer::ColRef::from_slice(&self.uniform)).iter().copied().collect();
        let responses = self.responses.combined(single.as_ref());
        // With few channels left, a correction for large changes does more harm than good.
        let (options, loads) = (self.options, self.loads.clone());
        Ok(Self { options, responses, projection, channels, uniform, lift, large: None, loads })
    }

    /// Number of channels of a frame.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Number of combinations of channels in use.
    pub fn combinations(&self) -> usize {
        self.uniform.len()
    }

    /// Radii and sizes.
    pub fn options(&self) -> &SpotOptions {
        &self.options
    }

    /// Whitened, projected response of a spot of amplitude 1.
    ///
    /// # Errors
    /// A position or radius outside the table.
    pub fn response(&self, position_m: Point, radius_m: f64) -> Result<Vec<f64>, InverseError> {
        let mut rows = vec![0.0; 4 * self.combinations()];
        let mut tabulated = self.responses.scratch();
        self.responses.evaluate(position_m, radius_m.ln(), &mut tabulated, &mut rows).ok_or(InverseError::Value {
            what: "radius of a spot (m), or its place",
            index: None,
            value: radius_m,
            expected: "within the table",
        })?;
        Ok(rows[..self.combinations()].iter().map(|v| f64::from(*v)).collect())
    }

    /// Whitens and projects difference data (volts, all finite) into `reduced`.
    pub(super) fn project(&self, difference: &[f64], reduced: &mut [f32]) {
        reduced.fill(0.0);
        for (row, value) in self.projection.chunks_exact(reduced.len()).zip(difference) {
            let value = *value as f32;
            reduced.iter_mut().zip(row).for_each(|(sum, entry)| *sum += entry * value);
        }
    }
}

fn check(
    response: MatRef<'_, f64>,
    deviations: &[f64],
    positions_m: &[Point],
    pixel_m: f64,
    options: &SpotOptions,
) -> Result<(), InverseError> {
    if deviations.len() != response.nrows() {
        let (expected, got) = (response.nrows(), deviations.len());
        return Err(InverseError::Size { what: "deviations of channels", expected, got });
    }
    if positions_m.len() != response.ncols() || positions_m.is_empty() {
        let (expected, got) = (response.ncols(), positions_m.len());
        return Err(InverseError::Size { what: "positions of pixels", expected, got });
    }
    positive("side of a pixel (m)", pixel_m)?;
    positive("smallest radius of a spot (m)", options.smallest_radius_m)?;
    positive(
        "largest over smallest radius of a spot, less 1",
        options.largest_radius_m / options.smallest_radius_m - 1.0,
    )?;
    positive("typical radius of a spot (m)", options.typical_radius_m)?;
    positive("smoothing of edges (m)", options.smoothing_m.unwrap_or(1.0))?;
    positive("most spots", options.most_spots as f64)?;
    let sum: f64 = response.col_iter().map(|column| column.iter().sum::<f64>()).sum();
    if !sum.is_finite() {
        return Err(InverseError::Value { what: "sum of the responses", index: None, value: sum, expected: "finite" });
    }
    Ok(())
}

/// Orthonormal combinations of channels that span the response to changes of pixels: the strongest left singular
/// vectors of the whitened Jacobian, found in the range of its product with fixed pseudo-random vectors (Halko,
/// Martinsson and Tropp, SIAM Rev. 53, 2011, algorithm 4.3 with one power step).
fn combinations(whitened: MatRef<'_, f64>) -> Result<Mat<f64>, InverseError> {
    let (channels, pixels) = (whitened.nrows(), whitened.ncols());
    let count = MOST_COMBINATIONS.min(channels).min(pixels);
    let probes = Mat::from_fn(pixels, count, |row, column| {
        let mixed = (row as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15)
            ^ (column as u64 + 1).wrapping_mul(0xD1B5_4A32_D192_ED03);
        let mixed = (mixed ^ (mixed >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        (mixed >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
    });
    let first = orthonormal((whitened * &probes).as_ref())?;
    let again = whitened.transpose() * &first;
    orthonormal((whitened * &again).as_ref())
}

/// Orthonormal basis of the columns, without weak directions.
fn orthonormal(columns: MatRef<'_, f64>) -> Result<Mat<f64>, InverseError> {
    let singular = || InverseError::Singular {
        what: "the responses of spots",
        hint: "at least one channel must have noise and sensitivity above zero",
    };
    // Normalise the columns first: after a power step their norms differ by the square of the spectrum.
    let norms: Vec<f64> = columns.col_iter().map(|column| column.norm_l2()).collect();
    let scaled =
        Mat::from_fn(
            columns.nrows(),
            columns.ncols(),
            |r, c| {
                if norms[c] > 0.0 { columns[(r, c)] / norms[c] } else { 0.0 }
            },
        );
    let factor = scaled.as_ref().thin_svd().map_err(|_| singular())?;
    let values: Vec<f64> = factor.S().column_vector().iter().copied().collect();
    let largest = values.first().copied().unwrap_or(0.0);
    let kept = values.iter().take_while(|value| value.powi(2) > LEAST_ENERGY * largest * largest).count();
    if kept == 0 {
        return Err(singular());
    }
    Ok(factor.U().subcols(0, kept).to_owned())
}

#[cfg(test)]
mod tests;
