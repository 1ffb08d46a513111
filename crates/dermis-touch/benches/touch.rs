//! Times finding the contacts in one 64 x 64 image, and tracking contacts as touches.

use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use dermis_touch::{Contact, ContactFinder, ContactParams, GridGeometry, PixelNoise, Tracker, TrackerParams};
use std::hint::black_box;

fn image(geometry: &GridGeometry, touches: usize, noise: f64) -> Vec<f32> {
    let centres = [(-0.025, 0.02), (0.03, 0.025), (0.0, -0.03), (-0.03, -0.025), (0.035, -0.02)];
    let mut state = 1u64;
    let mut grain = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as f64 / f64::from(1u32 << 31) - 0.5) * 3.46
    };
    (0..geometry.len())
        .map(|index| {
            let [x, y] = geometry.pixel_centre_m(index);
            let bell =
                |&(cx, cy): &(f64, f64)| (-((x - cx).powi(2) + (y - cy).powi(2)) / (2.0 * 0.008f64.powi(2))).exp();
            (centres[..touches].iter().map(bell).sum::<f64>() + noise * grain()) as f32
        })
        .collect()
}

fn touch(c: &mut Criterion) {
    let geometry = GridGeometry::centred(64, 64, 0.002);
    for (name, touches, correlation_length_m) in
        [("no touch", 0, 0.0), ("one touch", 1, 0.006), ("two touches", 2, 0.006), ("five touches", 5, 0.006)]
    {
        let image = image(&geometry, touches, 0.02);
        let params = ContactParams { correlation_length_m, ..Default::default() };
        let Ok(mut finder) = ContactFinder::new(geometry, params) else { return };
        let Ok(mut tracker) = Tracker::new(TrackerParams::default()) else { return };
        let (mut contacts, mut ended, mut time_ns) = (Vec::<Contact>::new(), Vec::new(), 0u64);
        c.bench_function(&format!("64x64 image to touches, {name}"), |b| {
            b.iter(|| {
                time_ns += 1_000_000;
                let found = finder.find(black_box(&image), PixelNoise::Uniform(0.02), &mut contacts);
                (found, tracker.update(time_ns, &contacts, &mut ended)).1
            });
        });
    }
    tracking(c);
}

fn tracking(c: &mut Criterion) {
    let geometry = GridGeometry::centred(64, 64, 0.002);
    let Ok(mut finder) = ContactFinder::new(geometry, ContactParams::default()) else { return };
    let mut contacts = Vec::new();
    if finder.find(&image(&geometry, 5, 0.02), PixelNoise::Uniform(0.02), &mut contacts).is_err() {
        return;
    }
    c.bench_function("tracker, five touches, 100 frames", |b| {
        b.iter_batched(
            || (Tracker::new(TrackerParams::default()), Vec::with_capacity(8)),
            |(tracker, mut ended)| {
                let mut tracker = tracker?;
                for frame in 0..100 {
                    tracker.update(frame * 1_000_000, black_box(&contacts), &mut ended)?;
                }
                Ok::<_, dermis_touch::TouchError>(tracker)
            },
            BatchSize::SmallInput,
        );
    });
}

criterion_group!(benches, touch);
criterion_main!(benches);
