//! The noise of channels from frames that may or may not show touches.
//!
//! Two estimates are made, and the smaller is used. Successive frames d = x_(t+1) - x_t differ only by noise while
//! nothing moves: over the quieter half of the pairs, sigma = 1.4826 median |d| / sqrt 2. If every frame is another
//! touch, no pair is quiet. But touches of one skin are similar and noise is not, so the residual of frames without
//! their leading principal components is noise too.

use dermis_touch::median;
use faer::{Mat, Side};

/// Minimum number of frames.
const FEWEST: usize = 9;
/// Minimum number of frames and of channels for principal components, and maximum number of frames used.
const FEWEST_FOR_COMPONENTS: usize = 24;
const MOST_FRAMES: usize = 240;
/// Number of principal components attributed to touches: one per this many frames or channels, up to a maximum.
const COMPONENT_SHARE: usize = 4;
const MOST_COMPONENTS: usize = 16;
/// Ratio of a Gaussian's standard deviation to the median of |x|.
pub(crate) const MEDIAN_TO_SIGMA: f64 = 1.4826;

/// Standard deviation of the noise of each channel, in the unit of the frames (rows of one value per channel); NaN
/// for a channel without information. `None` for fewer than nine frames, or if nothing changes.
pub fn noise_of_frames(frames: &[Vec<f64>]) -> Option<Vec<f64>> {
    if frames.len() < FEWEST {
        return None;
    }
    let successive = of_successive(frames)?;
    let components = of_components(frames, &successive);
    let level = |noise: &[f64]| {
        let ratios = noise.iter().zip(&successive).filter(|(a, b)| a.is_finite() && **b > 0.0).map(|(a, b)| a / b);
        median(&ratios.collect::<Vec<_>>())
    };
    match components {
        Some(components) if level(&components) < 1.0 => Some(components),
        _ => Some(successive),
    }
}

/// Estimate from the quieter half of the pairs of successive frames.
fn of_successive(frames: &[Vec<f64>]) -> Option<Vec<f64>> {
    let channels = frames[0].len();
    let steps: Vec<Vec<f64>> = frames
        .windows(2)
        .map(|pair| pair[1].iter().zip(&pair[0]).map(|(after, before)| (after - before).abs()).collect())
        .collect();
    let middle = |kept: &[usize], channel: usize| {
        let values: Vec<f64> = kept.iter().map(|&t| steps[t][channel]).filter(|v| v.is_finite()).collect();
        let middle = median(&values);
        // Readings with few digits may be unchanged more often than not.
        if middle > 0.0 { middle } else { (2.0 / std::f64::consts::PI).sqrt() * mean(&values) }
    };
    let all: Vec<usize> = (0..steps.len()).collect();
    let typical: Vec<f64> = (0..channels).map(|channel| middle(&all, channel)).collect();
    let size = |step: &Vec<f64>| {
        let relative = step.iter().zip(&typical).filter(|(v, m)| v.is_finite() && **m > 0.0).map(|(v, m)| v / m);
        mean(&relative.collect::<Vec<f64>>())
    };
    let mut quiet: Vec<(f64, usize)> = steps.iter().map(size).zip(0..).filter(|(size, _)| size.is_finite()).collect();
    quiet.sort_by(|a, b| a.0.total_cmp(&b.0));
    let kept: Vec<usize> = quiet.iter().take(quiet.len().div_ceil(2)).map(|(_, t)| *t).collect();
    let scale = MEDIAN_TO_SIGMA / std::f64::consts::SQRT_2;
    let noise: Vec<f64> = (0..channels)
        .map(|channel| scale * middle(&kept, channel))
        .map(|sigma| if sigma > 0.0 { sigma } else { f64::NAN })
        .collect();
    noise.iter().any(|sigma| sigma.is_finite()).then_some(noise)
}

/// Estimate from the residual without the leading principal components.
fn of_components(frames: &[Vec<f64>], scale: &[f64]) -> Option<Vec<f64>> {
    let usable: Vec<usize> = (0..scale.len()).filter(|&k| scale[k].is_finite()).collect();
    let complete = |frame: &&Vec<f64>| usable.iter().all(|&k| frame[k].is_finite());
    let complete: Vec<&Vec<f64>> = frames.iter().filter(complete).collect();
    let count = complete.len().min(MOST_FRAMES);
    let channels = usable.len();
    if count < FEWEST_FOR_COMPONENTS || channels < FEWEST_FOR_COMPONENTS {
        return None;
    }
    let chosen: Vec<&Vec<f64>> = (0..count).map(|i| complete[i * complete.len() / count]).collect();
    let data = Mat::from_fn(count, channels, |t, k| chosen[t][usable[k]] / scale[usable[k]]);
    let gram = &data * data.transpose();
    let eigen = gram.self_adjoint_eigen(Side::Lower).ok()?;
    let components = (count.min(channels) / COMPONENT_SHARE).min(MOST_COMPONENTS);
    let leading = Mat::from_fn(count, components, |t, j| eigen.U()[(t, count - 1 - j)]);
    let rest = &data - &leading * (leading.transpose() * &data);
    // Degrees of freedom, less those that the components take from the noise.
    let freedom = (count - components) as f64 * (1.0 - components as f64 / channels as f64);
    let mut noise = vec![f64::NAN; scale.len()];
    for (j, &k) in usable.iter().enumerate() {
        let square: f64 = (0..count).map(|t| rest[(t, j)] * rest[(t, j)]).sum();
        noise[k] = scale[k] * (square / freedom).sqrt();
    }
    Some(noise)
}

pub(crate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
