use dermis_skin::Bend;
use dermis_touch::TouchPhase;

use super::*;
use crate::sink::testing::touch;

const NOW_NS: u64 = 1_700_000_000_000_000_000;

fn scene(bend_diameter_mm: Option<f64>) -> Scene {
    let mut skin = Skin::open("healing-square").unwrap();
    skin.frontend.bend = bend_diameter_mm.map(|diameter_mm| Bend::Cylinder { diameter_mm });
    Scene::new(&skin, "palm")
}

fn batch(touches: &[Touch], ended: &[Touch]) -> TouchBatch {
    TouchBatch { wall_ns: NOW_NS, touches: touches.to_vec(), ended: ended.to_vec(), ..TouchBatch::default() }
}

/// The vector turned by the pose's orientation: v + 2 q x (q x v + w v).
fn turned(pose: Option<Pose>, v: [f64; 3]) -> [f64; 3] {
    let q = pose.and_then(|pose| pose.orientation).unwrap();
    let cross =
        |a: [f64; 3], b: [f64; 3]| [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    let axis = [q.x, q.y, q.z];
    let inner = cross(axis, v);
    let outer = cross(axis, std::array::from_fn(|k| inner[k] + q.w * v[k]));
    std::array::from_fn(|k| v[k] + 2.0 * outer[k])
}

fn position(pose: Option<Pose>) -> [f64; 3] {
    let p = pose.and_then(|pose| pose.position).unwrap();
    [p.x, p.y, p.z]
}

fn assert_near(found: [f64; 3], expected: [f64; 3]) {
    let error = (0..3).map(|k| (found[k] - expected[k]).abs()).fold(0.0, f64::max);
    assert!(error < 1e-12, "{found:?} is not {expected:?}");
}

#[test]
fn a_touch_is_one_entity_from_its_begin_to_its_end() {
    let mut scene = scene(None);
    let first = touch(1, TouchPhase::Begin, 3.0, -4.0);
    let found = scene.update(&batch(&[first], &[]));
    let [entity] = &found.entities[..] else { panic!("{found:?}") };
    assert_eq!((entity.id.as_str(), entity.frame_id.as_str(), entity.frame_locked), ("touch-1", "palm", true));
    assert_eq!(entity.timestamp, Some(time(NOW_NS)));
    assert!(found.deletions.is_empty() && entity.lifetime.is_some_and(|lifetime| lifetime.sec() >= 1));
    assert!(entity.arrows.is_empty(), "no force is known");
    assert_eq!(entity.texts[0].text, "1");

    // The same entity moves; a second one joins.
    let (moved, second) = (touch(1, TouchPhase::Move, 5.0, 0.0), touch(2, TouchPhase::Begin, 9.0, 9.0));
    let found = scene.update(&batch(&[moved, second], &[]));
    let ids: Vec<&str> = found.entities.iter().map(|entity| entity.id.as_str()).collect();
    assert_eq!((ids, found.deletions.len()), (vec!["touch-1", "touch-2"], 0));
    assert_near(position(found.entities[0].cylinders[0].pose), [5e-3, 0.0, 0.0]);

    // One ends in this frame; the end of the other was lost.
    let ended = touch(1, TouchPhase::End, 5.0, 0.0);
    let found = scene.update(&batch(&[], &[ended]));
    let gone: Vec<(&str, i32)> = found.deletions.iter().map(|gone| (gone.id.as_str(), gone.r#type)).collect();
    assert_eq!(gone, [("touch-1", Type::MatchingId.into()), ("touch-2", Type::MatchingId.into())]);
    assert!(found.entities.is_empty());
    assert!(scene.update(&batch(&[], &[])).deletions.is_empty(), "they are gone");
}

#[test]
fn an_arrow_points_against_the_normal_and_ends_at_the_touch() {
    for diameter_mm in [None, Some(100.0)] {
        let mut scene = scene(diameter_mm);
        let mut pressed = touch(7, TouchPhase::Begin, 20.0, -4.0);
        pressed.force = Some(ForceReading::FromLaw { force_n: 2.0, sigma_n: 0.1 });
        let update = scene.update(&batch(&[pressed], &[]));
        let entity = &update.entities[0];
        let arrow = &entity.arrows[0];
        let length_m = arrow.shaft_length + arrow.head_length;
        assert!((length_m - 0.02).abs() < 1e-12, "1 cm per newton");
        let direction = turned(arrow.pose, [1.0, 0.0, 0.0]);
        let (place, normal) = match diameter_mm {
            None => ([0.02, -0.004, 0.0], [0.0, 0.0, 1.0]),
            Some(_) => {
                let (sine, cosine) = (0.02_f64 / 0.05).sin_cos();
                ([0.05 * sine, -0.004, 0.05 * (cosine - 1.0)], [sine, 0.0, cosine])
            }
        };
        assert_near(direction, normal.map(|n| -n));
        let tail = position(arrow.pose);
        assert_near(std::array::from_fn(|k| tail[k] + length_m * direction[k]), place);
        // The disc lies in the surface, at the touch.
        assert_near(position(entity.cylinders[0].pose), place);
        assert_near(turned(entity.cylinders[0].pose, [0.0, 0.0, 1.0]), normal);
        let across = 2.0 * (1e-4 / std::f64::consts::PI).sqrt();
        assert_eq!(entity.cylinders[0].size.map(|size| [size.x, size.y]), Some([across, across]));
        assert_eq!(entity.texts[0].text, "7: 2.00 N");
        assert!(entity.metadata.iter().any(|pair| pair.key == "sigma_force_n" && pair.value == "0.100"));
    }
}

#[test]
fn the_ellipse_has_the_axes_of_the_covariance() {
    let mut scene = scene(None);
    let mut tilted = touch(1, TouchPhase::Begin, 0.0, 0.0);
    // Standard deviations of 3 mm at 30 degrees and 1 mm across.
    let (sine, cosine) = 30_f64.to_radians().sin_cos();
    let (long, short) = (9e-6, 1e-6);
    let xy = (long - short) * sine * cosine;
    tilted.covariance_m2 =
        [[long * cosine * cosine + short * sine * sine, xy], [xy, long * sine * sine + short * cosine * cosine]];
    let update = scene.update(&batch(&[tilted], &[]));
    let ellipse = &update.entities[0].spheres[0];
    let size = ellipse.size.unwrap();
    assert!((size.x - 6e-3).abs() < 1e-12 && (size.y - 2e-3).abs() < 1e-12, "{size:?}");
    assert_near(turned(ellipse.pose, [1.0, 0.0, 0.0]), [cosine, sine, 0.0]);

    // Without noise or model error there is nothing to draw.
    tilted.covariance_m2 = [[0.0; 2]; 2];
    assert!(scene.update(&batch(&[tilted], &[])).entities[0].spheres.is_empty());
}

#[test]
fn forces_outside_the_calibrated_range_or_area_are_marked() {
    let mut scene = scene(None);
    let mut pressed = touch(1, TouchPhase::Begin, 3.0, -4.0);
    for (force, text) in [
        (ForceReading::AboveRange { most_n: 5.0 }, "1: > 5.00 N"),
        (ForceReading::BelowRange { least_n: 0.5 }, "1: < 0.50 N"),
        (ForceReading::NotFinite, "1"),
    ] {
        pressed.force = Some(force);
        assert_eq!(scene.update(&batch(&[pressed], &[])).entities[0].texts[0].text, text);
    }
    // The arrow of a huge force stays in view.
    pressed.force = Some(ForceReading::Saturated { from_n: 1e6 });
    let arrow = scene.update(&batch(&[pressed], &[])).entities[0].arrows[0];
    assert!((arrow.shaft_length + arrow.head_length - LONGEST_ARROW_M).abs() < 1e-12);

    let covariance_m2 = [[4e-6, 0.0], [0.0, 9e-6]];
    pressed.other_place = Some(PlaceHypothesis { position_m: [-3e-3, 4e-3], covariance_m2, probability: 0.25 });
    let update = scene.update(&batch(&[pressed], &[]));
    let entity = &update.entities[0];
    assert_eq!((entity.cylinders.len(), entity.spheres.len(), entity.texts[1].text.as_str()), (2, 2, "or here (25 %)"));
    assert_near(position(entity.cylinders[1].pose), [-3e-3, 4e-3, 0.0]);
}
