//! A frame of every twin with two touches that move, so that each frame is solved anew, and the time to make each twin.

use criterion::{BenchmarkGroup, Criterion, criterion_group, criterion_main, measurement::WallTime};
use dermis_twin::{Frontend, HealingSquareOptions, IonicOptions, PiezoOptions, Twin, TwinError};
use std::hint::black_box;

/// One frame with touches that run round a circle of this radius, in every frame elsewhere.
fn frame<F: Frontend>(
    group: &mut BenchmarkGroup<'_, WallTime>,
    name: &str,
    twin: Result<Twin<F>, TwinError>,
    circle_m: f64,
    pressure_pa: f64,
) {
    let Ok(mut twin) = twin else { return };
    let (mut frame, mut count) = (Vec::new(), 0u32);
    group.bench_function(name, |b| {
        b.iter(|| {
            count += 1;
            let (y, x) = (0.05 * f64::from(count)).sin_cos();
            for (pointer, sign) in [(0, circle_m), (1, -circle_m)] {
                twin.scene_mut().press(pointer, sign * x, sign * y, 0.011, pressure_pa)?;
            }
            twin.step(0.1 * f64::from(count), &mut frame).map(|truth| black_box(truth.sequence))
        });
    });
}

fn twins(c: &mut Criterion) {
    let healing = HealingSquareOptions::default();
    let ionic = [("ionic-disc", IonicOptions::disc()), ("ionic-square", IonicOptions::square())];
    let piezo = [
        ("piezo-square", PiezoOptions::square()),
        ("piezo-disc", PiezoOptions::disc()),
        ("piezo-cylinder", PiezoOptions::cylinder()),
    ];
    let mut group = c.benchmark_group("frame of two moving touches");
    group.sample_size(20);
    frame(&mut group, "healing-square", Twin::healing_square(&healing), 0.03, 80e3);
    ionic.iter().for_each(|(name, options)| frame(&mut group, name, Twin::ionic(options), 0.05, 1e3));
    piezo.iter().for_each(|(name, options)| frame(&mut group, name, Twin::piezo(options), 0.035, 10e3));
    group.finish();
    let mut group = c.benchmark_group("start-up");
    group.sample_size(10);
    group.bench_function("healing-square", |b| b.iter(|| Twin::healing_square(black_box(&healing)).is_ok()));
    for (name, options) in &ionic {
        group.bench_function(*name, |b| b.iter(|| Twin::ionic(black_box(options)).is_ok()));
    }
    for (name, options) in &piezo {
        group.bench_function(*name, |b| b.iter(|| Twin::piezo(black_box(options)).is_ok()));
    }
    group.finish();
}

criterion_group!(benches, twins);
criterion_main!(benches);
