//! Detects a fall in the image that is not damage: the reference was taken while something touched the skin, and that
//! is now gone. The skin then moves towards the model of an intact sheet by the full size of the change; damage moves
//! it away. And the change is that of touches with the opposite sign, unlike a cut.

use dermis_skin::GainMatch;
use dermis_tomo::inner_product;

use super::frame::DamageFrame;
use crate::prepare::Prepared;

/// Minimum share of a change's weighted energy that touches must explain.
const LEAST_EXPLAINED: f64 = 0.9;
/// Minimum progress towards the model of an intact sheet, on a scale where damage is 0 and a release is 1.
const LEAST_NEARER: f64 = 0.5;

/// True if `change` (model volts, free skin minus reference, NaN where missing) is the release of a touch that was
/// present when `reference` (as measured) was taken.
pub(super) fn is_release(change: &[f64], reference: &[f64], frame: &DamageFrame<'_>, prepared: &Prepared) -> bool {
    let offset: Vec<f64> =
        reference.iter().zip(frame.scale).zip(&prepared.voltages).map(|((r, scale), v)| scale * r - v).collect();
    // If every channel is scaled to the model individually, the reference cannot deviate from it.
    let knows = prepared.skin.imaging.gain != GainMatch::Channel;
    let nearer = nearer(change, &offset, &prepared.voltages).filter(|_| knows);
    let may_be = nearer.is_none_or(|share| share >= LEAST_NEARER);
    let explained = if may_be { frame.refinement.share_of_release(change) } else { None };
    tracing::debug!(?nearer, ?explained, "is this fall a touch that has gone?");
    explained.is_some_and(|share| share >= LEAST_EXPLAINED)
}

/// Share of a change that leads from the reference's offset towards zero offset, ignoring the common gain:
/// `-<offset, change> / <change, change>`. Model errors do not resemble the change, so the value is about 1 if the
/// change removes an excess in the reference, and about 0 if it is unrelated. `None` without a change.
fn nearer(change: &[f64], offset: &[f64], model: &[f64]) -> Option<f64> {
    let present = |values: &[f64]| -> Vec<f64> {
        let both = values.iter().zip(change).zip(offset);
        both.map(|((value, c), o)| if (c + o).is_finite() { *value } else { 0.0 }).collect()
    };
    let model = present(model);
    let aside = |values: Vec<f64>| -> Vec<f64> {
        let gain = inner_product(&values, &model) / inner_product(&model, &model);
        values.iter().zip(&model).map(|(value, m)| value - gain * m).collect()
    };
    let (change, offset) = (aside(present(change)), aside(present(offset)));
    let square = inner_product(&change, &change);
    (square > 0.0).then(|| -inner_product(&offset, &change) / square)
}

#[cfg(test)]
mod tests {
    use super::nearer;

    #[test]
    fn undoing_an_offset_is_one_whatever_the_gain_and_the_model_s_error() {
        let model: Vec<f64> = (0..40).map(|k| 1.0 + f64::from(k % 7)).collect();
        let change: Vec<f64> = (0..40).map(|k| 0.1 * f64::sin(f64::from(k))).collect();
        // As large as the change, and unlike it.
        let error = |k: usize| 0.1 * (1.7 * k as f64).cos();
        let offset = |of_change: f64| -> Vec<f64> {
            (0..40).map(|k| 0.03 * model[k] + error(k) - of_change * change[k]).collect()
        };
        let [released, cut] = [1.0, 0.0].map(|share| nearer(&change, &offset(share), &model).unwrap());
        // Over 40 channels, two unrelated patterns have a cosine of about a sixth by chance.
        assert!((released - 1.0).abs() < 0.3 && cut.abs() < 0.3, "{released}, {cut}");
        let mut missing = change.clone();
        missing[3] = f64::NAN;
        assert!((nearer(&missing, &offset(1.0), &model).unwrap() - released).abs() < 0.1);
        assert_eq!(nearer(&[0.0; 40], &offset(1.0), &model), None);
    }
}
