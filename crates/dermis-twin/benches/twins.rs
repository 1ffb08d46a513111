//! One frame of every twin with two moving touches, so that each frame needs a new solution, and the time to build
//! each twin.

#[path = "../tests/published/mod.rs"]
mod published;

use criterion::{BenchmarkGroup, Criterion, criterion_group, criterion_main, measurement::WallTime};
use dermis_twin::{Frontend, Twin, TwinError};
use published::{healing_twin, ionic_disc, ionic_square, ionic_twin, piezo_disc, piezo_square, piezo_twin};
use std::hint::black_box;

/// One frame with touches that move around a circle of this radius, so that every frame differs.
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
    let ionic = [("ionic-disc", ionic_disc()), ("ionic-square", ionic_square())];
    let piezo = [("piezo-square", piezo_square()), ("piezo-disc", piezo_disc())];
    let mut group = c.benchmark_group("frame of two moving touches");
    group.sample_size(20);
    frame(&mut group, "healing-square", healing_twin(), 0.03, 80e3);
    ionic.iter().for_each(|(name, options)| frame(&mut group, name, ionic_twin(options.clone()), 0.05, 1e3));
    piezo.iter().for_each(|(name, options)| frame(&mut group, name, piezo_twin(options.clone()), 0.035, 10e3));
    group.finish();
    let mut group = c.benchmark_group("start-up");
    group.sample_size(10);
    group.bench_function("healing-square", |b| b.iter(|| healing_twin().is_ok()));
    for (name, options) in &ionic {
        group.bench_function(*name, |b| b.iter(|| ionic_twin(black_box(options).clone()).is_ok()));
    }
    for (name, options) in &piezo {
        group.bench_function(*name, |b| b.iter(|| piezo_twin(black_box(options).clone()).is_ok()));
    }
    group.finish();
}

criterion_group!(benches, twins);
criterion_main!(benches);
