//! The scene of built-in skins: colours start at zero, and the skin's usual press fills half of their range.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::calibration::{Calibration, Pokes};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_page::scene;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

/// A twin with a pipeline, one frame every 40 ms.
struct Line {
    kit: TwinKit,
    pipeline: Pipeline,
    frames: u64,
}

impl Line {
    fn new(name: &str, calibration: Option<Calibration>) -> Self {
        let skin = Skin::open(name).expect("a built-in skin");
        let mut kit = TwinKit::of(&skin).expect("it has a twin");
        let mut values = Vec::new();
        kit.twin.step(0.0, &mut values).expect("a frame");
        let prepared = Prepared::new(skin).expect("a built-in skin");
        let layout = Layout::Channels { count: values.len() };
        Self { kit, pipeline: Pipeline::new(prepared, &layout, calibration).expect("a pipeline"), frames: 0 }
    }

    /// Runs `frames` frames; returns the last one's readings and the largest magnitude of its image.
    fn run(&mut self, frames: u64) -> (Vec<f64>, f32) {
        let (mut frame, mut values) = (Frame::default(), Vec::new());
        let mut last = (Vec::new(), f32::NAN);
        for _ in 0..frames {
            self.frames += 1;
            let now_ns = self.frames * 40_000_000;
            self.kit.twin.step(now_ns as f64 * 1e-9, &mut values).expect("a frame");
            let stamp = HostStamp { monotonic_ns: now_ns, wall_ns: 0 };
            frame.refill(self.frames, stamp, &values, self.kit.twin.instrument().imaginary_v());
            let output = self.pipeline.process(&frame, now_ns).expect("a frame");
            let peak = output.image.iter().map(|value| value.abs()).fold(f32::NAN, f32::max);
            last = (output.raw.to_vec(), peak);
        }
        last
    }

    /// Presses with the page's initial radius and pressure.
    fn press(&mut self, [x_m, y_m]: [f64; 2]) {
        let press = self.kit.press;
        let scene = self.kit.twin.scene_mut();
        scene.press(1, x_m, y_m, press.initial_radius_m, press.initial_pressure_pa).expect("on the skin");
    }
}

/// Largest magnitude of the live image under the twin's initial press at the centre, and the range of the colours.
fn pressed_peak(name: &str) -> (f32, [f32; 2]) {
    let mut line = Line::new(name, None);
    let hint = scene(line.pipeline.prepared(), Some(line.kit.press), None).range_hint.expect("a range");
    line.run(39);
    line.press([0.0, 0.0]);
    (line.run(21).1, hint)
}

/// A calibration by pokes alone, without the model, and the places of the pokes.
fn poked(name: &str) -> (Calibration, Vec<[f64; 2]>) {
    let mut line = Line::new(name, None);
    let rest = line.run(40).0;
    let ring = |share: f64, count: u32| {
        let angle = move |k: u32| std::f64::consts::TAU * f64::from(k) / f64::from(count);
        (0..count).map(move |k| [share * angle(k).cos(), share * angle(k).sin()])
    };
    let half_m = line.pipeline.prepared().half_width_m();
    let places: Vec<[f64; 2]> = ring(0.0, 1).chain(ring(0.35 * half_m, 6)).chain(ring(0.7 * half_m, 12)).collect();
    let frames: Vec<Vec<f64>> = places
        .iter()
        .map(|&place| {
            line.press(place);
            let pressed = line.run(20).0;
            line.kit.twin.scene_mut().release(1);
            line.run(20);
            pressed
        })
        .collect();
    let pokes = Pokes { positions_m: places.clone(), further_m: Vec::new(), loads: None };
    let calibration = Calibration::fit(line.pipeline.prepared(), &[rest], &frames, &pokes).expect("a calibration");
    (calibration, places)
}

#[test]
fn calibrated_amplitudes_are_in_pokes_and_colours_in_image_units() {
    let (calibration, places) = poked("ionic-disc");
    assert!(calibration.correction().is_none(), "images are made with the measured Jacobian");
    let mut line = Line::new("ionic-disc", Some(calibration));
    let press = Some(line.kit.press);
    let [calibrated, plain] =
        [line.pipeline.calibration(), None].map(|calibration| scene(line.pipeline.prepared(), press, calibration));
    assert_eq!((plain.amplitude_unit.as_str(), plain.image_unit.as_str()), ("", ""));
    assert_eq!(calibrated.amplitude_unit, "typical pokes");
    assert_ne!(calibrated.image_quantity, plain.image_quantity);
    line.run(39);
    line.press(places[3]);
    let (peak, [low, high]) = (line.run(21).1, calibrated.range_hint.expect("a range"));
    println!("{peak} of {low} to {high}; without the calibration up to {}", plain.range_hint.expect("a range")[1]);
    assert!(low == 0.0 && (0.25..=0.75).contains(&(peak / high)), "{peak} of {low} to {high}");
}

#[test]
fn colours_of_both_signs_are_on_both_sides_of_zero() {
    let (peak, [low, high]) = pressed_peak("pyeidors-tank");
    println!("{peak} of {low} to {high}");
    assert!(low == -high && (0.35..=0.65).contains(&(peak / high)), "{peak} of {low} to {high}");
}

#[test]
fn the_typical_press_fills_half_the_range() {
    for name in
        ["healing-square", "ionic-disc", "ionic-square", "piezo-square", "sciospec-tank", "em-8", "em-16-square"]
    {
        let (peak, [low, high]) = pressed_peak(name);
        let share = peak / high;
        println!("{name}: {peak} of {high}");
        assert!(low == 0.0 && (0.35..=0.65).contains(&share), "{name}: {peak} of {low} to {high}");
    }
}
