//! Absolute imaging: the conductance of a sheet in siemens, with its uncertainty, from frames of a single state. No
//! baseline is needed.
//!
//! The conductance on a mesh's elements is `S exp(y)`. The prior of y is an unknown constant plus a Gaussian process.
//! The readings have noise, estimated from the frames or from reciprocal channels, and a model error. Each step
//! solves the problem linearised about the previous one (Tarantola, Inverse Problem Theory, 2005, eq. 3.51), `y+ = P
//! J'(J P J' + C)^-1 (v - F(y) + J y)`; the posterior covariance is that of the last step, `P - P J'(J P J' + C)^-1 J
//! P`. The coarse mesh's error for the uniform sheet is computed on a fine mesh and subtracted.

mod regions;

use dermis_device::FrameTable;
use dermis_live::channels::ChannelReader;
use dermis_skin::{Modality, Reads, Skin};
use dermis_tomo::eit::{ForwardModel, correlation};
use dermis_tomo::mesh::{Mesh, PixelGrid, PixelMap};
use dermis_touch::median;
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use serde::Serialize;

pub use self::regions::Region;
use self::regions::{length_m, regions};
use crate::Error;

/// Elements of the mesh that conductances are estimated on: finer than 16 to 64 electrodes can resolve.
const ELEMENTS: usize = 2500;
/// Elements of the fine mesh that the coarse one's error is measured against. Its own error is about a fifth of that.
const FINE_ELEMENTS: usize = 12_000;
/// Model error beyond noise, as a share of each reading: electrode positions and widths are off by about a tenth of a
/// millimetre.
const MODEL_ERROR: f64 = 1e-3;
/// Prior deviation of log conductance about its mean: two deviations span half to double.
const SPREAD: f64 = 0.35;
/// Prior deviation of the mean, as good as the uniform fit.
const MEAN_SPREAD: f64 = 0.3;
/// Maximum number of steps.
const STEPS: usize = 10;
/// Stop after a step that changes no element by more than this.
const SMALLEST_STEP: f64 = 1e-3;
/// Largest change of log conductance in one step.
const LARGEST_STEP: f64 = 0.7;
/// Minimum correlation with a uniform sheet. Below it the channel order must be wrong.
const LEAST_CORRELATION: f64 = 0.8;
/// Minimum number of frames for estimating the noise of their mean.
const ENOUGH_FRAMES: usize = 4;
/// Maximum number of channels: the covariance takes 8 bytes per pair.
const MOST_CHANNELS: usize = 6000;

/// Result of [`conductance`].
#[derive(Clone, Debug, Serialize)]
pub struct Conductance {
    /// Number of frames averaged.
    pub frames: usize,
    /// Number of channels with a reading.
    pub channels: usize,
    /// Median sheet conductance, siemens (the inverse of ohms per square).
    pub sheet_s: f64,
    /// Standard deviation of the median, siemens.
    pub sheet_sigma_s: f64,
    /// Conductance of the best-fitting uniform sheet, siemens.
    pub uniform_s: f64,
    /// Root mean square of the residuals, in standard deviations of the readings. About 1 or less if noise and model
    /// error are as assumed; a value above 1 widens all uncertainties.
    pub misfit: f64,
    /// Regions that differ by more than three standard deviations and by more than 5 %.
    pub regions: Vec<Region>,
    /// The pixels of the images.
    #[serde(skip)]
    pub grid: PixelGrid,
    /// Sheet conductance of each pixel, siemens, row 0 at the top; NaN outside.
    #[serde(skip)]
    pub image_s: Vec<f64>,
    /// Standard deviation of each pixel, siemens.
    #[serde(skip)]
    pub sigma_s: Vec<f64>,
}

/// Estimates the conductance of a sheet from frames of a single state.
///
/// # Errors
/// The skin has coils, a readout circuit or is read as differences; the frames don't belong to the skin, or their
/// channels have another order or a reversed sign; the model cannot be solved.
pub fn conductance(skin: &Skin, frames: &FrameTable) -> Result<Conductance, Error> {
    let refuse = |what: String, expected: &str, got: String| {
        Error::Live(dermis_live::Error::Frames { what, expected: expected.into(), got })
    };
    if skin.modality == Modality::Mit || skin.backend.circuit.is_some() || skin.backend.differences {
        let got = match skin.modality {
            Modality::Mit => "coils",
            _ if skin.backend.differences => "differences from a baseline (backend.differences)",
            _ => "a readout circuit (backend.circuit)",
        };
        let expected = "electrodes and whole readings of an ideal voltmeter";
        return Err(refuse(format!("conductance of {}", skin.name), expected, got.into()));
    }
    let protocol = skin.protocol()?;
    if protocol.channel_count() > MOST_CHANNELS {
        let expected = format!("at most {MOST_CHANNELS}");
        return Err(refuse(format!("channels of {}", skin.name), &expected, protocol.channel_count().to_string()));
    }
    let mut reader = ChannelReader::new(frames.layout(), &protocol, skin.backend.reads, &skin.name)?;
    let rows = reader.read_table(frames)?;
    let mut measured = Measured::of(&rows, protocol.channel_count());
    let body = skin.body_with_elements(ELEMENTS)?;
    let fine = ForwardModel::new(skin.body_with_elements(FINE_ELEMENTS)?.mesh, protocol.clone())?;
    let model = ForwardModel::new(body.mesh, protocol)?;
    let uniform = |model: &ForwardModel, s: f64| model.voltages(&vec![s; model.body().mesh.element_count()]);
    let file_s = skin.sheet_conductance_s();
    let at_file = uniform(&fine, file_s)?;
    if skin.backend.reads == Reads::Magnitude {
        measured.values.iter_mut().zip(&at_file).for_each(|(value, model)| *value = value.abs().copysign(*model));
    }
    let alike = correlation(&at_file, &measured.values);
    if alike.abs() < LEAST_CORRELATION || alike < 0.0 {
        let got = match alike < -LEAST_CORRELATION {
            true => format!("{alike:.3}: the sign is reversed (exchange sink and source, or plus and minus)"),
            false => format!("{alike:.3}: `dermis order` finds the order of channels"),
        };
        let what = format!("correlation of the readings with a uniform {}", skin.name);
        return Err(refuse(what, "0.8 or more", got));
    }
    // Two passes, because contact impedances don't scale with the sheet.
    let first_s = file_s / measured.gain(&at_file);
    let at_first = uniform(&fine, first_s)?;
    let uniform_s = first_s / measured.gain(&at_first);
    let (fine_v, coarse_v) = (uniform(&fine, uniform_s)?, uniform(&model, uniform_s)?);
    let mesh_error: Vec<f64> = fine_v.iter().zip(&coarse_v).map(|(fine, coarse)| fine - coarse).collect();
    let variances = measured.variances(&fine_v, &model.protocol().reciprocal_channels());
    let posterior = Posterior::fit(&model, &measured.values, &mesh_error, &variances, uniform_s)?;
    posterior.report(skin, &model, uniform_s, rows.len())
}

/// The mean frame.
struct Measured {
    values: Vec<f64>,
    /// Standard error of each mean; NaN with too few frames.
    errors: Vec<f64>,
}

impl Measured {
    fn of(rows: &[Vec<f64>], channels: usize) -> Self {
        let (mut values, mut errors) = (vec![f64::NAN; channels], vec![f64::NAN; channels]);
        for channel in 0..channels {
            let finite: Vec<f64> = rows.iter().map(|row| row[channel]).filter(|value| value.is_finite()).collect();
            if finite.is_empty() {
                continue;
            }
            let count = finite.len() as f64;
            let mean = finite.iter().sum::<f64>() / count;
            values[channel] = mean;
            if finite.len() >= ENOUGH_FRAMES {
                let square = finite.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
                errors[channel] = (square / (count - 1.0) / count).sqrt();
            }
        }
        Self { values, errors }
    }

    /// Least-squares gain from a model's readings to the measured ones.
    fn gain(&self, model: &[f64]) -> f64 {
        let pairs = || self.values.iter().zip(model).filter(|(value, _)| value.is_finite());
        pairs().map(|(value, model)| value * model).sum::<f64>() / pairs().map(|(_, model)| model * model).sum::<f64>()
    }

    /// Variance of each reading: noise, pooled over the channels, plus the model error. With fewer than four frames
    /// the noise comes from the differences of reciprocal channels, or is half a per cent of the median reading.
    fn variances(&self, model: &[f64], reciprocal: &[Option<(u32, f64)>]) -> Vec<f64> {
        let known: Vec<f64> =
            self.errors.iter().map(|error| error * error).filter(|square| square.is_finite()).collect();
        let noise = if known.is_empty() {
            let differences = reciprocal.iter().enumerate().filter_map(|(channel, partner)| {
                let (other, ratio) = (*partner)?;
                Some((self.values[channel] - ratio * self.values[other as usize]).abs())
            });
            // The median of |a - b| is 0.6745 sqrt(2) standard deviations.
            let typical = median(&differences.filter(|difference| difference.is_finite()).collect::<Vec<_>>());
            let size = median(&model.iter().map(|value| value.abs()).collect::<Vec<_>>());
            let noise = if typical.is_finite() { typical / (0.6745 * 2.0_f64.sqrt()) } else { 5e-3 * size };
            noise * noise
        } else {
            known.iter().sum::<f64>() / known.len() as f64
        };
        model.iter().map(|value| noise + (MODEL_ERROR * value).powi(2)).collect()
    }
}

/// Mean and covariance of each element's log conductance, relative to the uniform sheet.
struct Posterior {
    log: Vec<f64>,
    misfit: f64,
    prior: Mat<f64>,
    /// `J P` and `(J P J' + C)^-1 J P`, in standard deviations of the readings.
    jp: Mat<f64>,
    weighted: Mat<f64>,
}

impl Posterior {
    fn fit(
        model: &ForwardModel,
        measured: &[f64],
        mesh_error: &[f64],
        variances: &[f64],
        uniform_s: f64,
    ) -> Result<Self, Error> {
        let mesh = &model.body().mesh;
        let present: Vec<usize> = (0..measured.len()).filter(|&channel| measured[channel].is_finite()).collect();
        let prior = prior(mesh);
        let elements = mesh.element_count();
        let mut log = vec![0.0; elements];
        let deviations: Vec<f64> = present.iter().map(|&channel| variances[channel].sqrt()).collect();
        let mut step = 0;
        loop {
            let sigma: Vec<f64> = log.iter().map(|y| uniform_s * f64::exp(*y)).collect();
            let solution = model.solve(&sigma)?;
            let (voltages, jacobian) = (solution.voltages(), solution.jacobian());
            // Scaled to standard deviations of the readings, per unit of log conductance.
            let j = Mat::from_fn(present.len(), elements, |row, element| {
                jacobian.row(present[row])[element] * sigma[element] / deviations[row]
            });
            let left = |row: usize| {
                let channel = present[row];
                (measured[channel] - voltages[channel] - mesh_error[channel]) / deviations[row]
            };
            let misfit = ((0..present.len()).map(|row| left(row).powi(2)).sum::<f64>() / present.len() as f64).sqrt();
            let jp = &j * &prior;
            let mut gram = &jp * j.transpose();
            (0..present.len()).for_each(|k| gram[(k, k)] += 1.0);
            let singular = |_| dermis_tomo::inverse::InverseError::Singular {
                what: "the data-space system",
                hint: "look for readings that are NaN or infinite",
            };
            let factor = gram.llt(Side::Lower).map_err(singular)?;
            let shift = &j * Mat::from_fn(elements, 1, |element, _| log[element]);
            let right = Mat::from_fn(present.len(), 1, |row, _| left(row) + shift[(row, 0)]);
            let next = jp.transpose() * factor.solve(&right);
            let change = (0..elements).map(|k| (next[(k, 0)] - log[k]).abs()).fold(0.0, f64::max);
            if step == STEPS || change < SMALLEST_STEP {
                let weighted = factor.solve(&jp);
                return Ok(Self { log, misfit, prior, jp, weighted });
            }
            let shorten = if change > LARGEST_STEP { LARGEST_STEP / change } else { 1.0 };
            log.iter_mut().enumerate().for_each(|(k, y)| *y += shorten * (next[(k, 0)] - *y));
            step += 1;
        }
    }

    /// Standard deviation of each element.
    fn deviations(&self) -> Vec<f64> {
        let variance = |k: usize| {
            let explained: f64 = (0..self.jp.nrows()).map(|row| self.jp[(row, k)] * self.weighted[(row, k)]).sum();
            self.prior[(k, k)] - explained
        };
        (0..self.log.len()).map(|k| self.misfit.max(1.0) * variance(k).max(0.0).sqrt()).collect()
    }

    /// Standard deviations of weighted means; each column of `weights` holds one mean's weights over the elements.
    fn deviations_of(&self, weights: &Mat<f64>) -> Vec<f64> {
        let of_prior = &self.prior * weights;
        let (of_data, of_weighted) = (&self.jp * weights, &self.weighted * weights);
        let dot = |a: &Mat<f64>, b: &Mat<f64>, column: usize| -> f64 {
            (0..a.nrows()).map(|row| a[(row, column)] * b[(row, column)]).sum()
        };
        let variance = |column: usize| dot(weights, &of_prior, column) - dot(&of_data, &of_weighted, column);
        (0..weights.ncols()).map(|column| self.misfit.max(1.0) * variance(column).max(0.0).sqrt()).collect()
    }

    fn report(self, skin: &Skin, model: &ForwardModel, uniform_s: f64, frames: usize) -> Result<Conductance, Error> {
        let mesh = &model.body().mesh;
        let conductances: Vec<f64> = self.log.iter().map(|y| uniform_s * y.exp()).collect();
        let deviations = self.deviations();
        let sigmas: Vec<f64> = conductances.iter().zip(&deviations).map(|(s, deviation)| s * deviation).collect();
        let sheet_s = weighted_median(&conductances, mesh.measures());
        let total: f64 = mesh.measures().iter().sum();
        let share = Mat::from_fn(conductances.len(), 1, |k, _| mesh.measures()[k] / total);
        let map_error = |source| Error::Live(dermis_live::Error::Mesh { skin: skin.name.clone(), source });
        let map = PixelMap::new(skin.grid()?, mesh).map_err(map_error)?;
        let (image_s, sigma_s) =
            (map.to_pixels(&conductances).map_err(map_error)?, map.to_pixels(&sigmas).map_err(map_error)?);
        Ok(Conductance {
            frames,
            channels: model.protocol().channel_count(),
            sheet_s,
            sheet_sigma_s: sheet_s * self.deviations_of(&share)[0],
            uniform_s,
            misfit: self.misfit,
            regions: regions(mesh, &conductances, sheet_s, &|weights: &Mat<f64>| self.deviations_of(weights)),
            grid: *map.grid(),
            image_s,
            sigma_s,
        })
    }
}

/// Prior covariance of log conductance between elements.
fn prior(mesh: &Mesh) -> Mat<f64> {
    let length = length_m(mesh);
    let places: Vec<[f64; 3]> = (0..mesh.element_count()).map(|element| mesh.centroid(element)).collect();
    Mat::from_fn(places.len(), places.len(), |a, b| {
        let (a, b) = (places[a], places[b]);
        let square = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>();
        SPREAD * SPREAD * (-0.5 * square / (length * length)).exp() + MEAN_SPREAD * MEAN_SPREAD
    })
}

fn weighted_median(values: &[f64], weights: &[f64]) -> f64 {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let half = 0.5 * weights.iter().sum::<f64>();
    let mut below = 0.0;
    let middle = order.iter().find(|&&k| {
        below += weights[k];
        below >= half
    });
    middle.map_or(f64::NAN, |&k| values[k])
}
