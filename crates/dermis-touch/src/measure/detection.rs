//! Limit of detection as defined in the paper on the frontend/backend skin: the load at which V_rms, the RMS
//! difference of the frame from the untouched skin, exceeds the noise by 3.3 standard deviations over 30 frames.

use crate::error::{TouchError, require, require_finite, require_length};
use crate::statistics::{line, mean_std};

/// Number of standard deviations of noise that a signal must exceed.
pub const DETECTION_FACTOR: f64 = 3.3;

/// Number of frames of the untouched skin from which the paper measures noise.
pub const DETECTION_FRAMES: usize = 30;

/// V_rms: RMS over channels of `frame - reference`, in the channels' unit. Ignores channels that are not finite in
/// either; NaN if none is left.
///
/// # Errors
/// [`TouchError::Length`].
pub fn frame_difference_rms(frame: &[f64], reference: &[f64]) -> Result<f64, TouchError> {
    require_length("frame", reference.len(), frame.len())?;
    let differences = frame.iter().zip(reference).map(|(v, r)| v - r).filter(|difference| difference.is_finite());
    let (sum, count) = differences.fold((0.0, 0usize), |(sum, count), d| (sum + d * d, count + 1));
    Ok((sum / count as f64).sqrt())
}

/// V_rms of an untouched skin, in volts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseLevel {
    /// Mean V_rms of the frames: above 0, since V_rms of pure noise is positive.
    pub mean_v: f64,
    /// Standard deviation of their V_rms.
    pub std_v: f64,
    /// Number of frames used.
    pub frames: usize,
}

impl NoiseLevel {
    /// Noise level from the V_rms of frames of the untouched skin ([`DETECTION_FRAMES`] of them in the paper).
    ///
    /// # Errors
    /// Fewer than 2 values, values that are not finite.
    pub fn of(rms_v: &[f64]) -> Result<Self, TouchError> {
        if rms_v.len() < 2 {
            return Err(TouchError::TooFewFrames { what: "noise level", expected: 2, got: rms_v.len() });
        }
        require_finite("rms_v", rms_v)?;
        let (mean_v, std_v) = mean_std(rms_v);
        Ok(Self { mean_v, std_v, frames: rms_v.len() })
    }

    /// The V_rms above which a load counts as detected: mean + 3.3 standard deviations.
    #[must_use]
    pub fn threshold_v(&self) -> f64 {
        self.mean_v + DETECTION_FACTOR * self.std_v
    }
}

/// A limit of detection from a straight line through V_rms against load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DetectionLimit {
    /// `3.3 std / slope`, in the unit of the loads: the textbook limit, which assumes that the mean of a blank is the
    /// signal at no load.
    pub by_slope: f64,
    /// Load at which the line crosses mean + 3.3 std, in the unit of the loads; 0 if the line starts above it.
    pub by_crossing: f64,
    /// V_rms per unit of load.
    pub slope: f64,
    /// V_rms of the line at no load, volts.
    pub intercept_v: f64,
}

/// Fits a line to V_rms against load and finds where it exceeds the noise. Give repeats as separate points.
///
/// # Errors
/// Different lengths, fewer than 2 points, equal loads, values that are not finite, a line that does not rise.
pub fn detection_limit(loads: &[f64], rms_v: &[f64], noise: &NoiseLevel) -> Result<DetectionLimit, TouchError> {
    require_length("rms_v", loads.len(), rms_v.len())?;
    require_finite("loads", loads)?;
    require_finite("rms_v", rms_v)?;
    let (intercept_v, slope) = line(loads, rms_v)?;
    require(slope > 0.0, "slope of V_rms against load", slope, "above 0")?;
    let by_crossing = ((noise.threshold_v() - intercept_v) / slope).max(0.0);
    Ok(DetectionLimit { by_slope: DETECTION_FACTOR * noise.std_v / slope, by_crossing, slope, intercept_v })
}

/// The smallest load detected: its mean V_rms, and that of every larger load, is above the threshold. `None` if not
/// even the largest is detected. `steps` holds (load, V_rms of every repeat).
///
/// # Errors
/// A load or V_rms that is not finite; a load without repeats.
pub fn smallest_detected_load(steps: &[(f64, Vec<f64>)], noise: &NoiseLevel) -> Result<Option<f64>, TouchError> {
    let mut means = Vec::with_capacity(steps.len());
    for (index, (load, repeats)) in steps.iter().enumerate() {
        if !load.is_finite() {
            return Err(TouchError::NonFinite { what: "load", index, value: *load });
        }
        if repeats.is_empty() {
            return Err(TouchError::TooFewFrames { what: "V_rms of a load", expected: 1, got: 0 });
        }
        require_finite("V_rms of a load", repeats)?;
        means.push((*load, mean_std(repeats).0));
    }
    means.sort_by(|a, b| b.0.total_cmp(&a.0));
    let seen = means.iter().take_while(|(_, mean)| *mean > noise.threshold_v());
    Ok(seen.last().map(|(load, _)| *load))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rms_leaves_dead_channels_out() {
        let rms = frame_difference_rms(&[4.0, f64::NAN, 1.0], &[1.0, 0.0, 5.0]).unwrap();
        assert!((rms - 12.5_f64.sqrt()).abs() < 1e-15);
        assert!(frame_difference_rms(&[1.0], &[]).is_err());
    }

    #[test]
    fn limit_of_a_straight_line() {
        // Mean 2, deviations -1, 0, 1: sample deviation 1, threshold 5.3.
        let noise = NoiseLevel::of(&[1.0, 2.0, 3.0]).unwrap();
        assert!((noise.threshold_v() - 5.3).abs() < 1e-14);
        let loads = [0.1, 0.2, 0.4];
        let rms = loads.map(|load| 2.3 + 20.0 * load);
        let limit = detection_limit(&loads, &rms, &noise).unwrap();
        assert!((limit.slope - 20.0).abs() < 1e-12 && (limit.intercept_v - 2.3).abs() < 1e-12);
        assert!((limit.by_crossing - 0.15).abs() < 1e-12 && (limit.by_slope - 0.165).abs() < 1e-12);
        let error = detection_limit(&loads, &[3.0, 2.0, 1.0], &noise).unwrap_err();
        assert!(matches!(error, TouchError::Parameter { name: "slope of V_rms against load", .. }));
        assert!(detection_limit(&[0.1, 0.1], &[1.0, 2.0], &noise).is_err());
    }

    #[test]
    fn smallest_load_is_one_above_which_all_are_seen() {
        let noise = NoiseLevel { mean_v: 1.0, std_v: 1.0, frames: 30 };
        let step = |load: f64, mean: f64| (load, vec![mean - 0.5, mean + 0.5]);
        // 0.1 happens to be above the threshold but 0.2 is not, so 0.1 does not count.
        let steps = [step(0.1, 5.0), step(0.4, 6.0), step(0.2, 4.0), step(0.3, 4.4)];
        assert_eq!(smallest_detected_load(&steps, &noise).unwrap(), Some(0.3));
        assert_eq!(smallest_detected_load(&steps[2..3], &noise).unwrap(), None);
        assert!(smallest_detected_load(&[(0.1, vec![])], &noise).is_err());
    }

    #[test]
    fn noise_takes_two_finite_frames() {
        assert!(NoiseLevel::of(&[1.0]).is_err());
        assert!(matches!(NoiseLevel::of(&[1.0, f64::NAN]), Err(TouchError::NonFinite { index: 1, .. })));
    }
}
