//! A fall that is no damage: the reference was taken while something touched the skin, and now that has gone. The skin
//! then comes nearer to what the model has for an intact sheet, by as much as it changes; damage takes it away from
//! there. And what has changed is what touches do, with the opposite sign, which a cut is not.

use dermis_skin::GainMatch;

use super::frame::DamageFrame;
use crate::prepare::Prepared;
use crate::stages::sandwich_contacts::{ReleaseLook, Released};

/// A change that is a touch's has at least so much of its weighted energy explained by touches.
const LEAST_EXPLAINED: f64 = 0.9;
/// Of the way to the intact sheet's model, on a scale on which damage is 0 and a release 1.
const LEAST_NEARER: f64 = 0.5;

/// Begins to look whether `change` (model volts, of the free skin against the reference, NaN where missing) is the
/// release of something that touched the skin when `reference` (as measured) was taken; `None` where it is not.
pub(super) fn begin_look(
    change: &[f64],
    reference: &[f64],
    frame: &DamageFrame<'_>,
    prepared: &Prepared,
) -> Option<ReleaseLook> {
    let offset: Vec<f64> =
        reference.iter().zip(frame.scale).zip(&prepared.voltages).map(|((r, scale), v)| scale * r - v).collect();
    // Where every channel is scaled to the model by itself, the reference cannot be off it.
    let knows = prepared.skin.imaging.gain != GainMatch::Channel;
    let nearer = nearer(change, &offset, &prepared.voltages).filter(|_| knows);
    let may_be = nearer.is_none_or(|share| share >= LEAST_NEARER);
    tracing::debug!(?nearer, "is this fall a touch that has gone?");
    frame.patches.filter(|_| may_be).and_then(|patches| patches.look_for_release(change))
}

/// Goes on with a look, which a frame does for a bounded time only; `None` where it has to go on in the next one.
pub(super) fn is_release(look: &mut ReleaseLook, frame: &DamageFrame<'_>) -> Option<bool> {
    let found = frame.patches.map_or(Released::Unknown, |patches| patches.go_on_looking(look));
    tracing::debug!(?found, "is this fall a touch that has gone?");
    match found {
        Released::UnderWay => None,
        Released::Unknown => Some(false),
        Released::Share(explained) => Some(explained >= LEAST_EXPLAINED),
    }
}

/// By how much of itself a change leads from the reference's offset towards no offset at all, the common gain left
/// aside: `-<offset, change> / <change, change>`. Model errors do not look like the change, so that it is about 1 where
/// the change undoes what the reference had too much, and about 0 where it has nothing to do with it. None without a
/// change.
fn nearer(change: &[f64], offset: &[f64], model: &[f64]) -> Option<f64> {
    let present = |values: &[f64]| -> Vec<f64> {
        let both = values.iter().zip(change).zip(offset);
        both.map(|((value, c), o)| if (c + o).is_finite() { *value } else { 0.0 }).collect()
    };
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let model = present(model);
    let aside = |values: Vec<f64>| -> Vec<f64> {
        let gain = dot(&values, &model) / dot(&model, &model);
        values.iter().zip(&model).map(|(value, m)| value - gain * m).collect()
    };
    let (change, offset) = (aside(present(change)), aside(present(offset)));
    let square = dot(&change, &change);
    (square > 0.0).then(|| -dot(&offset, &change) / square)
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
        // Over 40 channels two patterns that have nothing in common have a sixth of their length in common by chance.
        assert!((released - 1.0).abs() < 0.3 && cut.abs() < 0.3, "{released}, {cut}");
        let mut missing = change.clone();
        missing[3] = f64::NAN;
        assert!((nearer(&missing, &offset(1.0), &model).unwrap() - released).abs() < 0.1);
        assert_eq!(nearer(&[0.0; 40], &offset(1.0), &model), None);
    }
}
