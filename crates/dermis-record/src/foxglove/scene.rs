//! Touches as entities of a 3D scene, in the frame of the skin. Each touch is an entity with a disc of its radius, a
//! flat ellipse of one sigma, an arrow whose tip is the touch, and a label. It disappears when the touch ends.

use std::collections::BTreeSet;

use ::foxglove::messages::scene_entity_deletion::Type;
use ::foxglove::messages::{
    ArrowPrimitive, Color, CylinderPrimitive, Duration, KeyValuePair, Pose, SceneEntity, SceneEntityDeletion,
    SceneUpdate, SpherePrimitive, TextPrimitive,
};
use dermis_skin::Skin;
use dermis_touch::force::ForceReading;
use dermis_touch::{LoadQuantity, PlaceHypothesis, Touch};

use super::transforms::{quaternion, time, vector};
use crate::live_writer::TouchBatch;

/// Length of an arrow per newton, metres. A finger's firm press of 5 N gets an arrow of 50 mm.
pub(super) const ARROW_M_PER_N: f64 = 0.01;
/// Longest arrow, metres, so that a large force stays in view.
const LONGEST_ARROW_M: f64 = 0.3;
/// Length of the head, and diameters of shaft and head, as shares of an arrow's length.
const HEAD_SHARE: f64 = 0.25;
const SHAFT_DIAMETER_SHARE: f64 = 0.06;
const HEAD_DIAMETER_SHARE: f64 = 0.16;
/// Thickness of discs and ellipses, metres: flat, but thick enough not to flicker against the skin.
const THICKNESS_M: f64 = 0.3e-3;
/// Distance of a label from the skin, metres, if there is no arrow.
const LABEL_HEIGHT_M: f64 = 5e-3;
/// Height of a label, pixels.
const LABEL_PIXELS: f64 = 14.0;
/// Lifetime of an entity that is not renewed, in frame periods of the skin, and its minimum, seconds. It removes
/// touches whose end a slow client missed.
const LIFETIME_PERIODS: f64 = 5.0;
const LEAST_LIFETIME_S: f64 = 1.0;

const DISC: Color = Color { r: 0.95, g: 0.45, b: 0.1, a: 0.6 };
const ELLIPSE: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 0.8 };
const ARROW: Color = Color { r: 0.85, g: 0.1, b: 0.15, a: 1.0 };
const LABEL: Color = Color { r: 1.0, g: 1.0, b: 1.0, a: 1.0 };
const OTHER: Color = Color { r: 0.6, g: 0.6, b: 0.6, a: 0.5 };

/// The touches of a skin as entities.
pub(super) struct Scene {
    skin: Skin,
    frame_id: String,
    lifetime: Duration,
    /// Touches in the scene.
    shown: BTreeSet<u64>,
}

impl Scene {
    pub(super) fn new(skin: &Skin, frame_id: &str) -> Self {
        let lifetime_s = (LIFETIME_PERIODS / skin.backend.frame_rate_hz()).max(LEAST_LIFETIME_S);
        let lifetime = Duration::saturating_from_secs_f64(lifetime_s);
        Self { skin: skin.clone(), frame_id: frame_id.to_owned(), lifetime, shown: BTreeSet::new() }
    }

    /// The update for the touches of a frame. Touches that have ended, or are missing, are removed.
    pub(super) fn update(&mut self, batch: &TouchBatch) -> SceneUpdate {
        let now: BTreeSet<u64> = batch.touches.iter().map(|touch| touch.id).collect();
        let ended: BTreeSet<u64> = batch.ended.iter().map(|touch| touch.id).collect();
        let gone = self.shown.union(&ended).filter(|id| !now.contains(id));
        let timestamp = Some(time(batch.wall_ns));
        let deletion =
            |id: &u64| SceneEntityDeletion { timestamp, r#type: Type::MatchingId.into(), id: entity_id(*id) };
        let deletions = gone.map(deletion).collect();
        let entities = batch.touches.iter().map(|touch| self.entity(batch.wall_ns, touch)).collect();
        self.shown = now;
        SceneUpdate { deletions, entities }
    }

    fn entity(&self, wall_ns: u64, touch: &Touch) -> SceneEntity {
        let place = Place::of(&self.skin, touch.position_m);
        let force = Force::of(touch);
        let arrow = force.and_then(|force| force.arrow(&place));
        let label_m = force.map_or(0.0, |force| force.length_m()).max(LABEL_HEIGHT_M);
        let (radius_m, sigma) = (touch.footprint_radius_m(), sigma_ellipse(&place, touch.covariance_m2, ELLIPSE));
        let mut texts = vec![label(&place, label_m, label_text(touch, force))];
        let mut spheres: Vec<_> = sigma.into_iter().collect();
        let mut cylinders: Vec<_> = radius_m.map(|radius_m| disc(&place, radius_m, DISC)).into_iter().collect();
        if let Some(PlaceHypothesis { position_m, covariance_m2, probability }) = touch.other_place {
            let other = Place::of(&self.skin, position_m);
            cylinders.extend(radius_m.map(|radius_m| disc(&other, radius_m, OTHER)));
            spheres.extend(sigma_ellipse(&other, covariance_m2, OTHER));
            texts.push(label(&other, LABEL_HEIGHT_M, format!("or here ({:.0} %)", 1e2 * probability)));
        }
        SceneEntity {
            timestamp: Some(time(wall_ns)),
            frame_id: self.frame_id.clone(),
            id: entity_id(touch.id),
            lifetime: Some(self.lifetime),
            // A touch moves with its skin.
            frame_locked: true,
            metadata: metadata(touch, force),
            arrows: arrow.into_iter().collect(),
            spheres,
            cylinders,
            texts,
            ..SceneEntity::default()
        }
    }
}

fn entity_id(touch: u64) -> String {
    format!("touch-{touch}")
}

/// A point of the skin in space, with the directions there.
struct Place {
    position_m: [f64; 3],
    normal: [f64; 3],
    /// Rotation about y that turns the z axis into the normal, radians.
    tilt_rad: f64,
}

impl Place {
    fn of(skin: &Skin, sheet_m: [f64; 2]) -> Self {
        let surface = skin.surface();
        let (position_m, normal) = (surface.point_m(sheet_m), surface.normal(sheet_m));
        // Skins are flat or bent around an axis along y.
        Self { position_m, normal, tilt_rad: normal[0].atan2(normal[2]) }
    }

    /// The point at this height above the skin.
    fn above_m(&self, height_m: f64) -> [f64; 3] {
        std::array::from_fn(|axis| self.position_m[axis] + height_m * self.normal[axis])
    }

    /// Pose of something flat on the skin, turned about the normal.
    fn lying(&self, turn_rad: f64) -> Pose {
        let ((sy, cy), (sz, cz)) = ((0.5 * self.tilt_rad).sin_cos(), (0.5 * turn_rad).sin_cos());
        // Product of the rotation about y and the rotation about z.
        let orientation = quaternion([sy * sz, sy * cz, cy * sz, cy * cz]);
        Pose { position: Some(vector(self.position_m)), orientation: Some(orientation) }
    }

    /// Pose of an arrow that starts at this height and points at the skin: along its own x axis.
    fn pointing_in(&self, height_m: f64) -> Pose {
        let (sine, cosine) = (0.5 * (self.tilt_rad + std::f64::consts::FRAC_PI_2)).sin_cos();
        let orientation = quaternion([0.0, sine, 0.0, cosine]);
        Pose { position: Some(vector(self.above_m(height_m))), orientation: Some(orientation) }
    }
}

/// The force of a touch, or the end of the range that it exceeds.
#[derive(Clone, Copy)]
struct Force {
    newtons: f64,
    sigma_n: Option<f64>,
    /// `<` or `>` if the force is outside the calibrated range, otherwise empty.
    bound: &'static str,
}

impl Force {
    fn of(touch: &Touch) -> Option<Self> {
        let force = touch.force.and_then(|force| {
            let bound = match force {
                ForceReading::BelowRange { .. } => "< ",
                ForceReading::AboveRange { .. } | ForceReading::Saturated { .. } => "> ",
                _ => "",
            };
            Some(Self { newtons: force.nearest_n()?, sigma_n: force.sigma_n(), bound })
        });
        let of_pokes = || {
            let load = touch.load.filter(|load| load.quantity == LoadQuantity::ForceN)?;
            Some(Self { newtons: load.value.max(0.0), sigma_n: Some(load.sigma), bound: "" })
        };
        force.or_else(of_pokes).filter(|force| force.newtons.is_finite())
    }

    fn length_m(self) -> f64 {
        (ARROW_M_PER_N * self.newtons).clamp(0.0, LONGEST_ARROW_M)
    }

    /// The arrow of the force on the sensor, against the normal, with its tip at the touch.
    fn arrow(self, place: &Place) -> Option<ArrowPrimitive> {
        let length_m = self.length_m();
        (length_m > 0.0).then(|| ArrowPrimitive {
            pose: Some(place.pointing_in(length_m)),
            shaft_length: (1.0 - HEAD_SHARE) * length_m,
            shaft_diameter: SHAFT_DIAMETER_SHARE * length_m,
            head_length: HEAD_SHARE * length_m,
            head_diameter: HEAD_DIAMETER_SHARE * length_m,
            color: Some(ARROW),
        })
    }
}

fn disc(place: &Place, radius_m: f64, color: Color) -> CylinderPrimitive {
    CylinderPrimitive {
        pose: Some(place.lying(0.0)),
        size: Some(vector([2.0 * radius_m, 2.0 * radius_m, THICKNESS_M])),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color: Some(color),
    }
}

/// The ellipse of one standard deviation; `None` if the covariance is unknown.
fn sigma_ellipse(place: &Place, [[xx, xy], [_, yy]]: [[f64; 2]; 2], color: Color) -> Option<SpherePrimitive> {
    let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let (long_m, short_m) = ((mean + half).max(0.0).sqrt(), (mean - half).max(0.0).sqrt());
    (long_m.is_finite() && long_m > 0.0).then(|| SpherePrimitive {
        pose: Some(place.lying(0.5 * (2.0 * xy).atan2(xx - yy))),
        // A sphere without extent is not drawn.
        size: Some(vector([2.0 * long_m, (2.0 * short_m).max(0.1 * THICKNESS_M), 2.0 * THICKNESS_M])),
        color: Some(color),
    })
}

fn label(place: &Place, height_m: f64, text: String) -> TextPrimitive {
    TextPrimitive {
        pose: Some(Pose {
            position: Some(vector(place.above_m(height_m))),
            orientation: Some(quaternion([0.0, 0.0, 0.0, 1.0])),
        }),
        billboard: true,
        font_size: LABEL_PIXELS,
        scale_invariant: true,
        color: Some(LABEL),
        text,
    }
}

/// `3: 2.10 N`, `3: > 5.00 N`, or just `3`.
fn label_text(touch: &Touch, force: Option<Force>) -> String {
    match force {
        Some(Force { newtons, bound, .. }) => format!("{}: {bound}{newtons:.2} N", touch.id),
        None => touch.id.to_string(),
    }
}

/// Details of a touch for the 3D panel, which shows them when the touch is clicked.
fn metadata(touch: &Touch, force: Option<Force>) -> Vec<KeyValuePair> {
    let mut pairs = vec![
        ("x_mm", format!("{:.2}", 1e3 * touch.position_m[0])),
        ("y_mm", format!("{:.2}", 1e3 * touch.position_m[1])),
        ("sigma_x_mm", format!("{:.2}", 1e3 * touch.covariance_m2[0][0].sqrt())),
        ("sigma_y_mm", format!("{:.2}", 1e3 * touch.covariance_m2[1][1].sqrt())),
        ("amplitude", format!("{:.4}", touch.amplitude)),
        ("area_mm2", format!("{:.1}", 1e6 * touch.area_m2)),
    ];
    if let Some(Force { newtons, sigma_n, bound }) = force {
        pairs.push(("force_n", format!("{bound}{newtons:.3}")));
        pairs.extend(sigma_n.map(|sigma_n| ("sigma_force_n", format!("{sigma_n:.3}"))));
    }
    pairs.into_iter().map(|(key, value)| KeyValuePair { key: key.to_owned(), value }).collect()
}

#[cfg(test)]
mod tests;
