//! The stages that run once per frame allocate nothing after warm-up.

mod common;

use allocation_counter::measure;
use common::{Noise, bell, paint, square};
use dermis_touch::{
    Baseline, BaselineParams, ContactFinder, ContactParams, ContactSigns, Load, PixelNoise, RunningStats, Tracker,
    TrackerParams,
};

#[test]
fn images_become_touches_without_allocating() {
    let geometry = square();
    // Touches that appear, cross, merge, separate and disappear, with noise.
    let images: Vec<Vec<f32>> = (0..100)
        .map(|frame| {
            let t = f64::from(frame);
            let mut noise = Noise::new(frame as u64 + 1);
            let coming = if (30..60).contains(&frame) { 1.0 } else { 0.0 };
            let bells = [
                bell(-50.0 + t, 2.0, 7.0, 1.0),
                bell(50.0 - t, -2.0, 7.0, 0.9),
                bell(0.0, 40.0, 7.0, coming),
                bell(20.0, -40.0, 7.0, -0.8),
            ];
            let mut image = paint(&geometry, &bells);
            image.iter_mut().for_each(|value| *value += 0.03 * noise.normal() as f32);
            image
        })
        .collect();
    let params = ContactParams { signs: ContactSigns::Both, correlation_length_m: 0.004, ..Default::default() };
    let mut finder = ContactFinder::new(geometry, params).unwrap();
    let mut tracker = Tracker::new(TrackerParams::default()).unwrap();
    let (mut contacts, mut ended) = (Vec::new(), Vec::new());
    let (mut begins, mut allocations) = (0, 0);
    for round in 0..2u64 {
        for (frame, image) in images.iter().enumerate() {
            let info = measure(|| {
                finder.find(image, PixelNoise::Uniform(0.03), &mut contacts).unwrap();
                tracker.update((round * 100 + frame as u64) * 20_000_000, &contacts, &mut ended).unwrap();
            });
            // The first round is the warm-up.
            allocations += round * info.count_total;
            begins += tracker.touches().iter().filter(|touch| touch.phase == dermis_touch::TouchPhase::Begin).count();
        }
    }
    assert!(begins >= 4, "the tracker hardly worked: {begins} begins");
    assert_eq!(allocations, 0);
}

#[test]
fn frames_are_compensated_without_allocating() {
    let mut baseline = Baseline::new(208, BaselineParams::default()).unwrap();
    let mut stats = RunningStats::new(208);
    let mut noise = Noise::new(1);
    for frame in 0..100u64 {
        let raw: Vec<f64> = (0..208).map(|_| noise.normal()).collect();
        let info = measure(|| {
            baseline.observe(frame * 20_000_000, &raw).unwrap();
            baseline.learn(Load::Free);
            stats.push(&raw).unwrap();
        });
        // Recording the start-up baseline, in frame 31, is the only allocation.
        assert!(info.count_total == 0 || frame == 31, "frame {frame}: {} allocations", info.count_total);
    }
}
