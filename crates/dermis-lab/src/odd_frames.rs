//! Detects frames that cannot come from the same skin and instrument as their baseline, because their sign differs or
//! they are larger or smaller by orders of magnitude, and baselines that differ from the model in the same way. Such
//! frames are reported and not used.

use dermis_touch::health::FrameFaultKind;

/// Limit of the ratio of root mean squares, frame to baseline, in either direction. A press changes voltages by a
/// factor of several at most.
const OFF: f64 = 300.0;
/// Projection on the baseline below which the frame's sign is reversed.
const FLIPPED: f64 = -0.5;
/// Limit of the ratio of voltages, model to baseline, in either direction, beyond which the units are reported as
/// suspicious.
const OTHER_UNIT: f64 = 1e4;
/// Maximum number of frames named in a message; the rest are counted.
const MOST_NAMED: usize = 8;

/// The fault of a frame compared with its baseline, if any (NaN: missing).
pub(crate) fn odd(frame: &[f64], baseline: &[f64]) -> Option<FrameFaultKind> {
    let both = || frame.iter().zip(baseline).filter(|(value, rest)| value.is_finite() && rest.is_finite());
    let sum = |of: &dyn Fn(f64, f64) -> f64| both().map(|(value, rest)| of(*value, *rest)).sum::<f64>();
    let (size, along, rest) = (sum(&|v, _| v * v), sum(&|v, b| v * b), sum(&|_, b| b * b));
    if rest <= 0.0 || both().count() < 2 {
        return None;
    }
    let share = (size / rest).sqrt();
    if share > OFF {
        return Some(FrameFaultKind::OutOfRange);
    }
    if share < 1.0 / OFF {
        return Some(FrameFaultKind::Blank);
    }
    (along < FLIPPED * rest).then_some(FrameFaultKind::Flipped)
}

/// Messages about faulty frames, one line per kind of fault.
pub(crate) fn describe(odd: &[Option<FrameFaultKind>]) -> Vec<String> {
    let kinds = [FrameFaultKind::OutOfRange, FrameFaultKind::Blank, FrameFaultKind::Flipped];
    let line = |kind: FrameFaultKind| {
        let frames: Vec<usize> = (0..odd.len()).filter(|&index| odd[index] == Some(kind)).collect();
        let what = match kind {
            FrameFaultKind::OutOfRange => "more than 300 times as large as the baseline",
            FrameFaultKind::Blank => "less than a 300th of the baseline",
            _ => "with the opposite sign to the baseline",
        };
        let named: Vec<String> = frames.iter().take(MOST_NAMED).map(usize::to_string).collect();
        let more = match frames.len().saturating_sub(MOST_NAMED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        let text =
            format!("frames {}{more}: {what}; no image is made of them, and touches are unknown", named.join(", "));
        (!frames.is_empty()).then_some(text)
    };
    kinds.into_iter().filter_map(line).collect()
}

/// Message about a baseline whose sign or unit differs from the model's.
pub(crate) fn describe_baseline(baseline: &[f64], model: &[f64]) -> Option<String> {
    let both = || baseline.iter().zip(model).filter(|(value, _)| value.is_finite());
    let sum = |of: &dyn Fn(f64, f64) -> f64| both().map(|(value, volts)| of(*value, *volts)).sum::<f64>();
    let (size, along, volts) = (sum(&|b, _| b * b), sum(&|b, m| b * m), sum(&|_, m| m * m));
    let (factor, correlation) = ((size / volts).sqrt(), along / (size * volts).sqrt());
    if correlation < FLIPPED {
        return Some(format!(
            "the baseline has the opposite sign to the model (correlation {correlation:.2}): expected drives and readings \
             the other way round"
        ));
    }
    let is_other = factor.is_finite() && !(1.0 / OTHER_UNIT..=OTHER_UNIT).contains(&factor);
    is_other.then(|| format!("the baseline is {factor:.1e} times the model's volts: expected readings in volts"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_other_scale_or_sign_are_detected_and_presses_are_not() {
        let rest: Vec<f64> = (0..40).map(|k| 1e-3 * (1.0 + f64::from(k % 7))).collect();
        let with = |of: &dyn Fn(f64) -> f64| rest.iter().map(|v| of(*v)).collect::<Vec<f64>>();
        for power in 3..15 {
            let gain = 10_f64.powi(power);
            assert_eq!(odd(&with(&|v| gain * v), &rest), Some(FrameFaultKind::OutOfRange));
            assert_eq!(odd(&with(&|v| v / gain), &rest), Some(FrameFaultKind::Blank));
        }
        assert_eq!(odd(&with(&|v| -0.9 * v), &rest), Some(FrameFaultKind::Flipped));
        assert_eq!(odd(&with(&|_| 0.0), &rest), Some(FrameFaultKind::Blank));
        for press in [0.05, 0.5, 2.0, 20.0] {
            assert_eq!(odd(&with(&|v| press * v), &rest), None);
        }
        let lines = describe(&[None, Some(FrameFaultKind::Flipped), Some(FrameFaultKind::Flipped)]);
        let said =
            "frames 1, 2: with the opposite sign to the baseline; no image is made of them, and touches are unknown";
        assert_eq!(lines, [said]);
        assert!(describe_baseline(&with(&|v| -v), &rest).unwrap().contains("opposite sign"));
        assert!(describe_baseline(&with(&|v| 1e6 * v), &rest).unwrap().contains("1.0e6 times"));
        assert_eq!(describe_baseline(&rest, &rest), None);
    }
}
