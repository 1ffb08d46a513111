//! Calibrates a skin from its own unlabelled frames: scale, sign and weight of each channel, without knowing where
//! the touches were.
//!
//! Every frame `D` (relative voltage changes) is assumed to be one touch, `D = a T(g) + e` with `T(g)` the template
//! of place `g`. Channels are scaled to unit RMS, which removes gains and uncertain baselines. Signs follow from
//! synchronisation: `M = (D'D / n) o (T'T)` (channels x channels, elementwise product) is positive between two
//! channels whose signs are both right or both wrong. So the signs of its leading eigenvector, refined by
//! `s <- sign(M s)`, are right up to one common sign. Then each frame is located by its matched filter,
//! `max_g <wT(g), wD> / (|wT(g)| |wD|)`, and the weights follow from the residuals of the templates:
//! `w^-2 = mean (D - a T)^2 + floor`.

mod batch;
mod pair;
mod templates;
mod weigh;

pub use batch::LEAST_CALIBRATION_FRAMES;
pub use templates::TouchTemplates;

use batch::{Batch, Norms, Peak, channel_scale, check_not_infinite, row_rms, scale_rows, sign, synchronised_signs};
use faer::{Mat, MatRef};
use templates::square_distance;

use super::error::positive;
use super::{InverseError, Weighting, check_finite};
use crate::mesh::Point;

/// Effect of a touch on the skin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TouchEffect {
    /// Pressing lowers the conductivity (thinned gels and hydrogels).
    LowersConductivity,
    /// Pressing raises the conductivity (most piezoresistive composites and foams).
    RaisesConductivity,
}

/// Options of [`SelfCalibration::fit`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationOptions {
    /// Effect of a touch.
    pub effect: TouchEffect,
    /// Number of rounds of locating and reweighting.
    pub weight_iterations: usize,
    /// Minimum unexplained variance of every channel, relative to its mean square.
    pub noise_floor: f64,
    /// Score band: the position is the centroid of the scores within this distance of the best score.
    pub centroid_band: f64,
    /// Radius around the best place within which scores enter the centroid, metres.
    pub centroid_radius_m: f64,
}

impl Default for CalibrationOptions {
    /// Options for a skin of about 0.1 to 0.2 m whose conductivity falls under pressure.
    fn default() -> Self {
        Self {
            effect: TouchEffect::LowersConductivity,
            weight_iterations: 3,
            noise_floor: 0.02,
            centroid_band: 0.05,
            centroid_radius_m: 0.015,
        }
    }
}

impl CalibrationOptions {
    fn validate(&self) -> Result<(), InverseError> {
        positive("noise_floor", self.noise_floor)?;
        positive("centroid_band", self.centroid_band)?;
        positive("centroid_radius_m", self.centroid_radius_m)?;
        Ok(())
    }
}

/// A touch located by the matched filter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedTouch {
    /// Centroid of the best scores, metres.
    pub position_m: Point,
    /// Index of the best place in [`TouchTemplates::places_m`].
    pub peak: usize,
    /// Weighted correlation of the frame with the template of the best place, -1 to 1.
    pub score: f64,
    /// Strength relative to a typical calibration frame: the factor on the template with all channels at unit RMS.
    pub amplitude: f64,
}

/// Two touches in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MatchedPair {
    /// Centroids of the best explanations, metres, stronger touch first.
    pub positions_m: [Point; 2],
    /// Strengths relative to a typical calibration frame.
    pub amplitudes: [f64; 2],
    /// Share of the frame's weighted energy left unexplained, 0 to 1; a single touch leaves `1 - score^2`.
    pub left: f64,
}

/// Precomputed data for finding pairs of touches: places all over the skin and the products of their templates.
#[derive(Clone, Debug)]
pub struct PairSearch {
    apart_m: f64,
    coarse: Vec<usize>,
    grams: Mat<f64>,
}

/// A calibrated skin: the treatment of its channels, and a matched filter that locates single touches.
#[derive(Clone, Debug)]
pub struct SelfCalibration {
    options: CalibrationOptions,
    places_m: Vec<Point>,
    data_scale: Vec<f64>,
    row_factors: Vec<f64>,
    signs: Vec<f64>,
    weights: Vec<f64>,
    /// Weighted templates, places x channels.
    filter: Mat<f64>,
    /// Squares of the weighted templates.
    filter_squares: Mat<f64>,
    /// Sum of the squares over all channels, one per place.
    filter_norms: Mat<f64>,
    score: f64,
    independent: f64,
}

impl SelfCalibration {
    /// Calibrates on `frames` of relative changes, `(v - v_0) / mean(v_0)` for each channel of the templates, `NaN`
    /// for missing channels. `voltages` are the modelled baselines: their signs initialise the synchronisation, their
    /// magnitudes settle the common sign (a large voltage rarely has the wrong sign).
    ///
    /// Use frames with touches at many places, not idle ones. If none are available, differences between successive
    /// baselines taken between touches also work on a skin that recovers slowly: they contain the residue of the last
    /// touch.
    ///
    /// # Errors
    /// Mismatched sizes, fewer than [`LEAST_CALIBRATION_FRAMES`] frames with any change, infinite values, options
    /// that are not positive, or no channel that responds in both model and data.
    pub fn fit(
        templates: &TouchTemplates,
        voltages: &[f64],
        frames: &[Vec<f64>],
        options: CalibrationOptions,
    ) -> Result<Self, InverseError> {
        options.validate()?;
        let channels = templates.matrix().nrows();
        if voltages.len() != channels {
            return Err(InverseError::Size { what: "modelled voltages", expected: channels, got: voltages.len() });
        }
        check_finite("modelled voltage", voltages)?;
        let data_scale = channel_scale(frames, channels)?;
        let batch = Batch::new(frames, &data_scale);
        let sizes = row_rms(templates.matrix());
        let live: Vec<bool> = (0..channels).map(|c| data_scale[c] > 0.0 && sizes[c] > 0.0).collect();
        if !live.contains(&true) {
            return Err(InverseError::NoChannels { channels });
        }
        let unsigned: Vec<f64> =
            (0..channels).map(|c| if live[c] { sign(voltages[c]) / sizes[c] } else { 0.0 }).collect();
        let scaled = scale_rows(templates.matrix(), &unsigned);
        let signs = synchronised_signs(scaled.as_ref(), batch.values.as_ref(), voltages)?;
        let row_factors: Vec<f64> = unsigned.iter().zip(&signs).map(|(factor, sign)| factor * sign).collect();
        let mut calibration = Self {
            options,
            places_m: templates.places_m().to_vec(),
            data_scale,
            row_factors,
            signs,
            weights: live.into_iter().map(f64::from).collect(),
            filter: Mat::new(),
            filter_squares: Mat::new(),
            filter_norms: Mat::new(),
            score: 0.0,
            independent: 1.0,
        };
        let matched = calibration.matched_rows(templates);
        calibration.reweight(&matched, &batch);
        Ok(calibration)
    }

    /// Templates with calibrated rows, as the change due to a touch: places x channels.
    fn matched_rows(&self, templates: &TouchTemplates) -> Mat<f64> {
        let change = match self.options.effect {
            TouchEffect::LowersConductivity => -1.0,
            TouchEffect::RaisesConductivity => 1.0,
        };
        let factors: Vec<f64> = self.row_factors.iter().map(|factor| change * factor).collect();
        scale_rows(templates.matrix(), &factors).transpose().to_owned()
    }

    /// Alternates between locating all frames and reweighting the channels by their residuals.
    fn reweight(&mut self, matched: &Mat<f64>, batch: &Batch) {
        let floor = self.options.noise_floor;
        for _ in 0..self.options.weight_iterations {
            self.set_filter(matched);
            let peaks = self.peaks(batch);
            for channel in 0..self.weights.len() {
                let (mut sum, mut count) = (0.0, 0.0);
                for (frame, peak) in peaks.iter().enumerate() {
                    if batch.present[(channel, frame)] > 0.0 {
                        let explained = peak.amplitude * matched[(peak.place, channel)];
                        sum += (batch.values[(channel, frame)] - explained).powi(2);
                        count += 1.0;
                    }
                }
                if self.weights[channel] > 0.0 && count > 0.0 {
                    self.weights[channel] = 1.0 / (sum / count + floor).sqrt();
                }
            }
        }
        self.set_filter(matched);
        let peaks = self.peaks(batch);
        self.independent = self.independent_residuals(matched, batch, &peaks);
        let mut scores: Vec<f64> = peaks.iter().map(|peak| peak.score).collect();
        scores.sort_by(f64::total_cmp);
        self.score = scores[scores.len() / 2];
    }

    /// Effective number of independent values in a frame's residuals. Let r be the weighted residual of a frame
    /// relative to the frame's norm and S the mean of `r r'` over the frames; the number is `(tr S)^2 / tr S^2`, the
    /// participation ratio of the eigenvalues of S.
    fn independent_residuals(&self, matched: &Mat<f64>, batch: &Batch, peaks: &[Peak]) -> f64 {
        let norm = |frame: usize| {
            let square = |c: usize| (self.weights[c] * batch.values[(c, frame)]).powi(2);
            (0..self.weights.len()).map(square).sum::<f64>().sqrt()
        };
        let norms: Vec<f64> = (0..peaks.len()).map(norm).collect();
        let residual = |c: usize, frame: usize| {
            let Peak { place, amplitude, .. } = peaks[frame];
            let left = batch.values[(c, frame)] - amplitude * matched[(place, c)] * batch.present[(c, frame)];
            if norms[frame] > 0.0 { self.weights[c] * left / norms[frame] } else { 0.0 }
        };
        let residuals = Mat::from_fn(self.weights.len(), peaks.len(), residual);
        // The products between frames have the same eigenvalues as those between channels; use the smaller matrix.
        let products = if residuals.nrows() <= residuals.ncols() {
            &residuals * residuals.transpose()
        } else {
            residuals.transpose() * &residuals
        };
        let trace: f64 = (0..products.nrows()).map(|k| products[(k, k)]).sum();
        let squares = products.squared_norm_l2();
        if squares > 0.0 { (trace * trace / squares).max(1.0) } else { 1.0 }
    }

    fn set_filter(&mut self, matched: &Mat<f64>) {
        let weights = &self.weights;
        self.filter = Mat::from_fn(matched.nrows(), matched.ncols(), |place, c| weights[c] * matched[(place, c)]);
        self.filter_squares = Mat::from_fn(matched.nrows(), matched.ncols(), |r, c| self.filter[(r, c)].powi(2));
        self.filter_norms = &self.filter_squares * Mat::<f64>::full(matched.ncols(), 1, 1.0);
    }

    fn peaks(&self, batch: &Batch) -> Vec<Peak> {
        let (scores, norms) = self.score_batch(batch);
        (0..scores.ncols()).map(|frame| Peak::of(&scores, &norms, frame)).collect()
    }

    /// Scores, places x frames.
    fn score_batch(&self, batch: &Batch) -> (Mat<f64>, Norms) {
        let (mut scores, norms) = self.products(batch);
        for frame in 0..scores.ncols() {
            for place in 0..scores.nrows() {
                let both = norms.place(place, frame) * norms.frame[frame];
                scores[(place, frame)] = if both > 0.0 { scores[(place, frame)] / both } else { 0.0 };
            }
        }
        (scores, norms)
    }

    /// Products of the weighted templates and frames, places x frames, and the norms of both. A channel missing from
    /// a frame counts in neither norm.
    fn products(&self, batch: &Batch) -> (Mat<f64>, Norms) {
        let weighted = scale_rows(batch.values.as_ref(), &self.weights);
        let square_norm = |column: faer::ColRef<'_, f64>| column.iter().map(|v| v * v).sum::<f64>();
        let template = if batch.complete { self.filter_norms.clone() } else { &self.filter_squares * &batch.present };
        let frame = weighted.col_iter().map(|column| square_norm(column).sqrt()).collect();
        (&self.filter * &weighted, Norms { template, frame })
    }

    fn single(&self, frame: &[f64]) -> Result<Batch, InverseError> {
        let expected = self.data_scale.len();
        if frame.len() != expected {
            return Err(InverseError::Size { what: "channels of the frame", expected, got: frame.len() });
        }
        check_not_infinite(frame)?;
        let batch = Batch::new(&[frame], &self.data_scale);
        let usable = (0..expected).any(|c| batch.present[(c, 0)] > 0.0 && self.weights[c] > 0.0);
        if usable { Ok(batch) } else { Err(InverseError::NoChannels { channels: expected }) }
    }

    /// Correlation of a frame of relative changes with the template of every place, -1 to 1.
    ///
    /// # Errors
    /// A frame of the wrong length, with infinite values, or without any usable channel.
    pub fn scores(&self, frame: &[f64]) -> Result<Vec<f64>, InverseError> {
        let (scores, _) = self.score_batch(&self.single(frame)?);
        Ok(scores.col(0).iter().copied().collect())
    }

    /// Locates a single touch in a frame of relative changes; `None` if no channel changed at all.
    ///
    /// # Errors
    /// As [`SelfCalibration::scores`].
    pub fn locate(&self, frame: &[f64]) -> Result<Option<MatchedTouch>, InverseError> {
        self.locate_with_scores(frame, &mut Vec::new())
    }

    /// As [`SelfCalibration::locate`]; `scores` receives the result of [`SelfCalibration::scores`].
    ///
    /// # Errors
    /// As [`SelfCalibration::scores`].
    pub fn locate_with_scores(
        &self,
        frame: &[f64],
        scores: &mut Vec<f64>,
    ) -> Result<Option<MatchedTouch>, InverseError> {
        let batch = self.single(frame)?;
        let (all, norms) = self.score_batch(&batch);
        scores.clear();
        scores.extend(all.col(0).iter());
        if norms.frame[0] == 0.0 {
            return Ok(None);
        }
        let Peak { place, score, amplitude } = Peak::of(&all, &norms, 0);
        Ok(Some(MatchedTouch { position_m: self.centroid(scores, place), peak: place, score, amplitude }))
    }

    /// Turns the scores of a frame into probabilities of the places, given exactly one touch and a uniform prior:
    /// `p ~ (1 - c^2 + f)^(-n / 2)`, where c is the positive part of the score, f the noise floor common to all
    /// models, and n the effective number of independent values in the residuals of the calibration frames (the
    /// participation ratio of their covariance). With f = 0 this is the likelihood of Gaussian residuals of unknown
    /// size and a touch of unknown strength.
    pub fn probabilities(&self, scores: &[f64], probabilities: &mut Vec<f64>) {
        let unexplained = |score: f64| 1.0 - score.clamp(0.0, 1.0).powi(2) + self.options.noise_floor;
        let log = |score: f64| -0.5 * self.independent * unexplained(score).ln();
        let top = scores.iter().map(|score| log(*score)).fold(f64::NEG_INFINITY, f64::max);
        probabilities.clear();
        probabilities.extend(scores.iter().map(|score| if *score > 0.0 { (log(*score) - top).exp() } else { 0.0 }));
        let total: f64 = probabilities.iter().sum();
        if total > 0.0 {
            probabilities.iter_mut().for_each(|p| *p /= total);
        }
    }

    fn centroid(&self, scores: &[f64], peak: usize) -> Point {
        let centre = self.places_m[peak];
        let reach = self.options.centroid_radius_m.powi(2);
        let mut sum = [0.0; 3];
        for (place, score) in self.places_m.iter().zip(scores) {
            let excess = score - scores[peak] + self.options.centroid_band;
            if excess > 0.0 && square_distance(*place, centre) < reach {
                sum = [sum[0] + excess * place[0], sum[1] + excess * place[1], sum[2] + excess];
            }
        }
        // The peak itself always counts, with the full band.
        [sum[0] / sum[2], sum[1] / sum[2]]
    }

    /// Median score of the calibration frames, a measure of the model's fit. Below about 0.75, suspect the readout
    /// circuit or the electrode layout.
    pub fn score(&self) -> f64 {
        self.score
    }

    /// Mean log-likelihood of a reading over the usable channels, nats, up to a constant: -1/2 ln of the variance
    /// that the best place leaves unexplained (including the floor). Compares models without labels. With few frames
    /// it discriminates better than the score, which uses only half of them; differences above about 0.03 are
    /// significant.
    pub fn log_likelihood(&self) -> f64 {
        let used = self.weights.iter().filter(|weight| **weight > 0.0);
        let (count, sum) = used.fold((0_u32, 0.0), |(n, sum), weight| (n + 1, sum + weight.ln()));
        sum / f64::from(count.max(1))
    }

    /// RMS change of each channel over the calibration frames; 0 for a channel that never changed or was always
    /// missing.
    pub fn data_scale(&self) -> &[f64] {
        &self.data_scale
    }

    /// +1 for each channel whose modelled voltage has the right sign, -1 for the others.
    pub fn signs(&self) -> &[f64] {
        &self.signs
    }

    /// Weights of the channels, in units of 1 / [`SelfCalibration::data_scale`]; 0 for unusable ones.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }

    /// `W = diag(w^2)` for [`LinearProblem`](super::LinearProblem), for use with [`SelfCalibration::calibrated_rows`]
    /// and [`SelfCalibration::scaled`].
    pub fn weighting(&self) -> Weighting {
        Weighting::Diagonal(self.weights.iter().map(|weight| weight * weight).collect())
    }

    /// Converts a Jacobian `dv/dsigma` or [`TouchTemplates::matrix`] (channels x any number of columns) to
    /// sensitivities of [`SelfCalibration::scaled`] data: rows signed and scaled, rows of unusable channels zero.
    ///
    /// # Errors
    /// A different number of channels.
    pub fn calibrated_rows(&self, jacobian: MatRef<'_, f64>) -> Result<Mat<f64>, InverseError> {
        let expected = self.row_factors.len();
        if jacobian.nrows() != expected {
            return Err(InverseError::Size { what: "channels of the Jacobian", expected, got: jacobian.nrows() });
        }
        Ok(scale_rows(jacobian, &self.row_factors))
    }

    /// A frame of relative changes in units of each channel's RMS. `NaN` is kept; unusable channels are 0.
    ///
    /// # Errors
    /// A different number of channels.
    pub fn scaled(&self, frame: &[f64]) -> Result<Vec<f64>, InverseError> {
        let expected = self.data_scale.len();
        if frame.len() != expected {
            return Err(InverseError::Size { what: "channels of the frame", expected, got: frame.len() });
        }
        let scale = |(value, scale): (&f64, &f64)| if *scale > 0.0 { value / scale } else { 0.0 };
        Ok(frame.iter().zip(&self.data_scale).map(scale).collect())
    }

    /// Positions of the matched filter's columns, metres.
    pub fn places_m(&self) -> &[Point] {
        &self.places_m
    }
}

#[cfg(test)]
mod tests;
