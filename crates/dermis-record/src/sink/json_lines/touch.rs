//! A touch in a line.

use dermis_touch::{LoadQuantity, Touch, TouchPhase};
use serde::Serialize;

use super::extras::LineExtras;
use crate::sink::interface::{TouchRow, load_numbers, other_numbers};

/// A touch. Values that are not finite are null.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub(super) struct TouchObject<X> {
    /// Identity, counting up from 1.
    id: u64,
    /// `begin`, `move`, or once `end`.
    phase: &'static str,
    /// False if the frames are wrong as a whole: the touch may still be there.
    #[serde(skip_serializing_if = "Option::is_none")]
    known: Option<bool>,
    x_mm: f64,
    y_mm: f64,
    /// Image units, not negative.
    amplitude: f64,
    area_mm2: f64,
    /// Standard deviations of the position.
    sigma_x_mm: f64,
    sigma_y_mm: f64,
    /// Force, or the end of the calibrated range if the force is outside it.
    #[serde(skip_serializing_if = "Option::is_none")]
    force_n: Option<f64>,
    /// `within`, `below`, `above` or `saturated` (by a calibration), `none` (no finite force), or `law` (by the layer's
    /// law).
    #[serde(skip_serializing_if = "Option::is_none")]
    force_range: Option<&'static str>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_force_n: Option<f64>,
    /// Fitted radius, if the forward model placed the touch.
    #[serde(skip_serializing_if = "Option::is_none")]
    radius_mm: Option<f64>,
    /// Depth, as calibrated by pokes.
    #[serde(skip_serializing_if = "Option::is_none")]
    depth_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_depth_mm: Option<f64>,
    /// Force, as calibrated by pokes.
    #[serde(skip_serializing_if = "Option::is_none")]
    poke_force_n: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_poke_force_n: Option<f64>,
    /// Another position that reads about the same, and the probability that the touch is there instead.
    #[serde(skip_serializing_if = "Option::is_none")]
    other_x_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    other_y_mm: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    other_probability: Option<f64>,
    #[serde(flatten)]
    extras: X,
}

impl<X: Serialize> TouchObject<X> {
    /// A touch with these further fields. With `is_known` false, the frames are wrong as a whole.
    pub fn new<E: LineExtras<Touch = X>>(touch: &Touch, is_known: bool, extras: &E) -> Self {
        let TouchRow { x_mm, y_mm, amplitude, area_mm2, sigma_x_mm, sigma_y_mm } = TouchRow::new(touch);
        let load_of = |quantity| {
            let [value, sigma] = load_numbers(touch.load.as_ref().filter(|load| load.quantity == quantity)?);
            Some((value, sigma))
        };
        let (depth, force) = (load_of(LoadQuantity::DepthM), load_of(LoadQuantity::ForceN));
        let other = touch.other_place.map(other_numbers);
        Self {
            id: touch.id,
            phase: match touch.phase {
                TouchPhase::Begin => "begin",
                TouchPhase::Move => "move",
                TouchPhase::End => "end",
            },
            known: (!is_known).then_some(false),
            x_mm,
            y_mm,
            amplitude,
            area_mm2,
            sigma_x_mm,
            sigma_y_mm,
            force_n: touch.force.map(|force| force.nearest_n().unwrap_or(f64::NAN)),
            force_range: touch.force.map(|force| force.range()),
            sigma_force_n: touch.force.and_then(|force| force.sigma_n()),
            radius_mm: touch.radius_m.map(|radius_m| 1e3 * radius_m),
            depth_mm: depth.map(|(value, _)| value),
            sigma_depth_mm: depth.map(|(_, sigma)| sigma),
            poke_force_n: force.map(|(value, _)| value),
            sigma_poke_force_n: force.map(|(_, sigma)| sigma),
            other_x_mm: other.map(|[x_mm, _, _]| x_mm),
            other_y_mm: other.map(|[_, y_mm, _]| y_mm),
            other_probability: other.map(|[_, _, probability]| probability),
            extras: extras.touch(touch),
        }
    }
}
