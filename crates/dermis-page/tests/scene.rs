//! The scene of built-in skins: colours start at zero, and the skin's usual press fills half of their range.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_page::scene;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

/// Largest magnitude of the live image under the twin's initial press at the centre.
fn pressed_peak(name: &str) -> (f32, [f32; 2]) {
    let skin = Skin::open(name).expect("a built-in skin");
    let mut kit = TwinKit::of(&skin).expect("it has a twin");
    let prepared = Prepared::new(skin).expect("a built-in skin");
    let hint = scene(&prepared, Some(kit.press)).range_hint.expect("a range");
    let mut values = Vec::new();
    kit.twin.step(0.0, &mut values).expect("a frame");
    let mut pipeline = Pipeline::new(prepared, &Layout::Channels { count: values.len() }, None).expect("a pipeline");
    let mut frame = Frame::default();
    let mut peak = f32::NAN;
    for n in 1..=60_u64 {
        let now_ns = n * 40_000_000;
        if n == 40 {
            let scene = kit.twin.scene_mut();
            scene.press(1, 0.0, 0.0, kit.press.initial_radius_m, kit.press.initial_pressure_pa).expect("on the skin");
        }
        kit.twin.step(now_ns as f64 * 1e-9, &mut values).expect("a frame");
        frame.refill(n, HostStamp { monotonic_ns: now_ns, wall_ns: 0 }, &values, kit.twin.instrument().imaginary_v());
        let output = pipeline.process(&frame, now_ns).expect("a frame");
        peak = output.image.iter().map(|value| value.abs()).fold(f32::NAN, f32::max);
    }
    (peak, hint)
}

#[test]
fn colours_of_both_signs_are_on_both_sides_of_zero() {
    let (peak, [low, high]) = pressed_peak("pyeidors-tank");
    println!("{peak} of {low} to {high}");
    assert!(low == -high && (0.35..=0.65).contains(&(peak / high)), "{peak} of {low} to {high}");
}

#[test]
fn the_press_that_a_skin_is_made_for_fills_half_the_range() {
    for name in
        ["healing-square", "ionic-disc", "ionic-square", "piezo-square", "sciospec-tank", "em-8", "em-16-square"]
    {
        let (peak, [low, high]) = pressed_peak(name);
        let share = peak / high;
        println!("{name}: {peak} of {high}");
        assert!(low == 0.0 && (0.35..=0.65).contains(&share), "{name}: {peak} of {low} to {high}");
    }
}
