//! The live pipeline allocates nothing per frame while nothing touches the skin, and little while presses are fitted.

use allocation_counter::measure;
use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

/// Frames of the twin: baseline, untouched, pressed, moved with a second press next to it, untouched.
fn frames(skin: &Skin) -> Vec<Vec<f64>> {
    let mut twin = TwinKit::of(skin).unwrap().twin;
    let mut values = Vec::new();
    (0..120)
        .map(|frame| {
            match frame {
                50 => twin.scene_mut().press(0, -0.02, 0.01, 0.01, 1.2e3).unwrap(),
                70 => twin.scene_mut().press(1, 0.025, -0.01, 0.01, 1.0e3).unwrap(),
                75 => twin.scene_mut().move_to(0, -0.015, 0.012).unwrap(),
                90 => twin.scene_mut().release_all(),
                _ => {}
            }
            twin.step(f64::from(frame) * 0.04, &mut values).unwrap();
            values.clone()
        })
        .collect()
}

#[test]
fn frames_at_rest_are_read_without_allocating_and_presses_are_fitted_in_little() {
    let skin = Skin::open("ionic-disc").unwrap();
    let frames = frames(&skin);
    let prepared = Prepared::new(skin).unwrap();
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None).unwrap();
    let mut frame = Frame::default();
    let mut touched = 0;
    // The first round sets up and warms up; in the third a channel is missing.
    for round in 0..3u64 {
        for (index, values) in frames.iter().enumerate() {
            let number = round * frames.len() as u64 + index as u64;
            let at = HostStamp { monotonic_ns: number * 40_000_000, wall_ns: number };
            frame.refill(number, at, values, &[]);
            if round == 2 {
                frame.values[17] = f64::NAN;
            }
            let mut touches = 0;
            let info = measure(|| touches = pipeline.process(&frame, number * 40_000_000).unwrap().touches.len());
            touched += usize::from(round > 0 && touches > 0);
            // The pipeline prepares for a missing channel at the first frame without it, and again when it gives the
            // channel up.
            let prepares = round == 0 || (round == 2 && index < 10);
            // Pressed from 50 to 90; the tracker ends touches a few frames later. A forward solution allocates 50 kB, and
            // a fit takes up to some dozens.
            let at_rest = !(50..100).contains(&index);
            let most_bytes = if at_rest { 0 } else { 4 * 1024 * 1024 };
            assert!(
                prepares || info.bytes_total <= most_bytes,
                "round {round}, frame {index}, {touches} touches: {} allocations of {} bytes in all",
                info.count_total,
                info.bytes_total
            );
        }
    }
    assert!(touched > 60, "only {touched} frames with touches: the measurement says little");
}
