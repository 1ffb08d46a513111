//! Tests of the damage monitor on synthetic images: dips and bumps of known position, depth and length.

use super::*;
use crate::cells::GridGeometry;
use crate::contact::{ContactSign, PixelNoise};
use crate::plane::distance;
use crate::touch::{Observation, Touch, TouchPhase};

const GRID: usize = 50;
const NOISE: PixelNoise<'static> = PixelNoise::Uniform(0.002);

fn geometry() -> GridGeometry {
    GridGeometry::centred(GRID, GRID, 2e-3)
}

/// A line of Gaussian spots with a standard deviation of 5 mm, from end to end, of a given height.
fn line(image: &mut [f32], from: [f64; 2], to: [f64; 2], height: f64) {
    for (index, value) in image.iter_mut().enumerate() {
        let [x, y] = geometry().pixel_centre_m(index);
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length2 = (dx * dx + dy * dy).max(1e-12);
        let t = (((x - from[0]) * dx + (y - from[1]) * dy) / length2).clamp(0.0, 1.0);
        let d = (x - from[0] - t * dx).hypot(y - from[1] - t * dy);
        *value += (height * (-0.5 * (d / 5e-3).powi(2)).exp()) as f32;
    }
}

fn touch(position_m: [f64; 2]) -> Touch {
    Touch {
        id: 1,
        phase: TouchPhase::Move,
        observation: Observation::Measured,
        sign: ContactSign::Positive,
        position_m,
        covariance_m2: [[0.0; 2]; 2],
        filtered_position_m: position_m,
        velocity_m_per_s: [0.0; 2],
        amplitude: 0.5,
        area_m2: 3e-4,
        force: None,
        radius_m: Some(0.01),
        load: None,
        other_place: None,
        age_frames: 1,
        begin_time_ns: 0,
        time_ns: 0,
    }
}

/// A monitor fed at 25 frames a second.
struct Bench {
    monitor: DamageMonitor,
    ticks: u64,
    events: Vec<DamageEvent>,
}

impl Bench {
    fn new() -> Self {
        let monitor = DamageMonitor::new(geometry(), DamageParams::default()).unwrap();
        Self { monitor, ticks: 0, events: Vec::new() }
    }

    fn run_with(&mut self, frames: u64, image: &[f32], touches: &[Touch], classes: Option<ClassProbabilities<'_>>) {
        for _ in 0..frames {
            let time_ns = self.ticks * 40_000_000;
            let frame = DamageFrame {
                time_ns,
                image,
                noise: NOISE,
                touches,
                loaded: !touches.is_empty(),
                known: None,
                classes,
            };
            self.monitor.process(&frame).unwrap();
            self.events.extend_from_slice(self.monitor.events());
            self.ticks += 1;
        }
    }

    fn run(&mut self, frames: u64, image: &[f32], touches: &[Touch]) {
        self.run_with(frames, image, touches, None);
    }

    fn names(&self) -> Vec<&'static str> {
        self.events.iter().map(DamageEvent::name).collect()
    }
}

fn flat() -> Vec<f32> {
    vec![0.0; GRID * GRID]
}

const FROM: [f64; 2] = [-0.02, 0.012];
const TO: [f64; 2] = [0.004, 0.03];

fn cut() -> Vec<f32> {
    let mut image = flat();
    line(&mut image, FROM, TO, -0.2);
    image
}

#[test]
fn a_lasting_drop_is_damage_with_place_direction_and_length() {
    let mut bench = Bench::new();
    bench.run(20, &flat(), &[]);
    bench.run(30, &cut(), &[]);
    assert!(bench.monitor.is_suspicious() && bench.events.is_empty(), "not believed within 1.2 s");
    bench.run(30, &cut(), &[]);
    assert_eq!(bench.names(), ["begin"]);
    let [damage] = bench.monitor.damages() else { panic!("{:?}", bench.monitor.damages()) };
    let middle = [0.5 * (FROM[0] + TO[0]), 0.5 * (FROM[1] + TO[1])];
    let off = distance(damage.shape.centre_m, middle);
    // With pixels of 2 mm, the centroid of a symmetric ridge is accurate to a small part of one.
    assert!(off < 0.5e-3, "{off}");
    let direction = (TO[1] - FROM[1]).atan2(TO[0] - FROM[0]);
    assert!((damage.shape.direction_rad - direction).abs() < 0.05, "{:?}", damage.shape);
    // The true length is 30 mm. Half-height regions cut off the tails, and subtracting a point's width corrects that
    // only roughly.
    assert!((damage.shape.length_m - 0.03).abs() < 8e-3, "{:?}", damage.shape);
    assert!((damage.depth - 0.2).abs() < 0.01 && damage.significance > 100.0, "{damage:?}");
    // The damage is seen once the first mean contains enough of the cut for the threshold, about one frame after it.
    assert!((0.8..1.4).contains(&(damage.since_ns as f64 * 1e-9)), "{damage:?}");
}

#[test]
fn lobes_of_a_touch_never_become_damage() {
    let mut image = flat();
    line(&mut image, [0.0; 2], [0.0; 2], 1.0);
    line(&mut image, [0.025, 0.0], [0.025, 0.0], -0.15);
    let mut bench = Bench::new();
    bench.run(10, &flat(), &[]);
    bench.run(200, &image, &[touch([0.0; 2])]);
    // The material creeps back over a third of a second.
    bench.run(8, &image.iter().map(|v| 0.6 * v).collect::<Vec<_>>(), &[]);
    bench.run(100, &flat(), &[]);
    assert!(bench.events.is_empty() && bench.monitor.damages().is_empty(), "{:?}", bench.events);
    // Without a touch, a dip below half of the largest rise is a side lobe of that rise.
    bench.run(200, &image, &[]);
    assert!(bench.monitor.damages().is_empty());
}

#[test]
fn a_press_on_damage_covers_it_and_a_release_shows_it_again() {
    let mut bench = Bench::new();
    bench.run(80, &cut(), &[]);
    let before = bench.monitor.damages()[0];
    let mut pressed = flat();
    line(&mut pressed, [-0.008, 0.021], [-0.008, 0.021], 0.9);
    bench.run(100, &pressed, &[touch([-0.008, 0.021])]);
    assert_eq!(bench.monitor.damages()[0].state, DamageState::Covered);
    bench.run(40, &cut(), &[]);
    assert_eq!(bench.names(), ["begin", "covered", "uncovered"]);
    let after = bench.monitor.damages()[0];
    assert_eq!((after.id, after.state, after.since_ns), (before.id, DamageState::Confirmed, before.since_ns));
    assert!(after.confirmed_ns > before.confirmed_ns && (after.shape, after.share) == (before.shape, 1.0));
}

#[test]
fn a_touch_at_another_place_leaves_damage_confirmed() {
    let mut bench = Bench::new();
    bench.run(80, &cut(), &[]);
    let mut both = cut();
    line(&mut both, [0.03, -0.03], [0.03, -0.03], 0.9);
    bench.run(100, &both, &[touch([0.03, -0.03])]);
    assert_eq!(bench.names(), ["begin"]);
    assert_eq!(bench.monitor.damages()[0].state, DamageState::Confirmed);
    // Sliding off it uncovers it although something still touches the skin.
    bench.run(20, &both, &[touch([-0.008, 0.021])]);
    bench.run(30, &both, &[touch([0.03, -0.03])]);
    assert_eq!(bench.names(), ["begin", "covered", "uncovered"]);
}

#[test]
fn healing_is_followed_to_its_end_and_a_reopened_scar_reported() {
    let mut bench = Bench::new();
    bench.run(80, &cut(), &[]);
    for step in (0..=20).rev() {
        let image: Vec<f32> = cut().iter().map(|v| v * step as f32 / 20.0).collect();
        bench.run(15, &image, &[]);
    }
    bench.run(60, &flat(), &[]);
    assert_eq!(bench.names(), ["begin", "update", "healed"]);
    assert!(bench.monitor.is_intact() && bench.monitor.damages()[0].share < 0.05);
    bench.run(100, &cut(), &[]);
    assert_eq!(bench.names(), ["begin", "update", "healed", "update"]);
    assert!(!bench.monitor.is_intact());
    bench.run(150, &flat(), &[]);
    bench.monitor.renew();
    assert!(bench.monitor.damages().is_empty());
}

#[test]
fn two_cuts_are_two_records_and_a_brief_dip_is_none() {
    let mut bench = Bench::new();
    let mut two = cut();
    line(&mut two, [0.02, -0.03], [0.03, -0.02], -0.15);
    bench.run(100, &two, &[]);
    let ids: Vec<u64> = bench.monitor.damages().iter().map(|damage| damage.id).collect();
    assert_eq!(ids, [1, 2]);
    let mut three = two.clone();
    line(&mut three, [-0.03, -0.03], [-0.03, -0.03], -0.15);
    bench.run(15, &three, &[]);
    bench.run(60, &two, &[]);
    assert_eq!((bench.monitor.damages().len(), bench.names()), (2, vec!["begin", "begin"]));
}

#[test]
fn a_dismissed_suspicion_leaves_no_trace_and_may_return() {
    let mut bench = Bench::new();
    bench.run(30, &cut(), &[]);
    assert!(bench.monitor.is_suspicious());
    bench.monitor.dismiss();
    assert!(bench.monitor.damages().is_empty() && bench.monitor.is_intact());
    bench.run(80, &flat(), &[]);
    assert!(bench.events.is_empty());
    bench.run(80, &cut(), &[]);
    bench.monitor.dismiss();
    assert_eq!((bench.names(), bench.monitor.damages().len()), (vec!["begin"], 1), "what is believed stays");
}

#[test]
fn a_damage_that_another_operator_images_keeps_its_identity_and_its_share() {
    let mut monitor = DamageMonitor::new(geometry(), DamageParams::default()).unwrap();
    let image_at = |middle: [f64; 2], depth: f64| {
        let mut image = flat();
        line(&mut image, [middle[0] - 0.01, middle[1]], [middle[0] + 0.01, middle[1]], -depth);
        image
    };
    monitor.begin_frame(0).unwrap();
    let id = monitor.declare(0, &image_at([0.01, 0.01], 0.2), NOISE).unwrap().unwrap();
    monitor.set_share(id, 0.5);
    monitor.begin_frame(1).unwrap();
    // Elsewhere, deeper, and half of it left.
    monitor.redraw(id, &image_at([-0.01, -0.012], 0.3), NOISE, 0.5, true).unwrap();
    let [damage] = monitor.damages() else { panic!("{:?}", monitor.damages()) };
    let [x, y] = damage.shape.centre_m;
    assert!((x + 0.01).hypot(y + 0.012) < 1e-3 && (damage.depth - 0.6).abs() < 0.02, "{damage:?}");
    assert!(damage.id == id && damage.share == 0.5 && monitor.events().is_empty(), "{damage:?}");
    // If nothing is visible it stays where it was. An unknown identity is ignored.
    let before = *damage;
    monitor.redraw(id, &flat(), NOISE, 0.5, true).unwrap();
    monitor.redraw(id + 1, &image_at([0.02, 0.02], 0.3), NOISE, 1.0, true).unwrap();
    assert_eq!(monitor.damages(), [before]);
    assert!(monitor.redraw(id, &[0.0; 3], NOISE, 1.0, true).is_err());
}

#[test]
fn a_networks_classes_take_precedence() {
    let damaged: Vec<f32> = cut().iter().map(|v| if *v < -0.05 { 0.9 } else { 0.02 }).collect();
    let none = vec![0.1; GRID * GRID];
    let mut bench = Bench::new();
    bench.run_with(200, &cut(), &[], Some(ClassProbabilities { damaged: &none, compressed: &none }));
    assert!(bench.events.is_empty(), "the network calls nothing damaged");
    bench.run_with(10, &cut(), &[], Some(ClassProbabilities { damaged: &damaged, compressed: &none }));
    assert_eq!(bench.names(), ["begin"]);
}

#[test]
fn bad_input_is_refused_by_name() {
    let bad = DamageParams { lobe_share: 2.0, ..DamageParams::default() };
    let error = DamageMonitor::new(geometry(), bad).unwrap_err().to_string();
    assert_eq!(error, "lobe_share = 2: expected from 0 to 1");
    let mut bench = Bench::new();
    let frame = DamageFrame {
        time_ns: 0,
        image: &[0.0; 3],
        noise: NOISE,
        touches: &[],
        loaded: false,
        known: None,
        classes: None,
    };
    assert!(bench.monitor.process(&frame).is_err());
}
