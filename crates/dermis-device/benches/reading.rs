//! Speed of reading files of frames: `cargo bench -p dermis-device`.

use std::fmt::Write as _;
use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dermis_device::instruments::npy;
use dermis_device::{FileSpec, Format, ReadOptions, decode_with, read};

/// Frames of 208 channels; a few megabytes of text.
const FRAMES: usize = 4000;
const CHANNELS: usize = 208;

fn reading(criterion: &mut Criterion) {
    let value = |index: usize| 1e-3 + 1e-8 * (index * 7919 % 1_000_003) as f64;
    let mut text = String::new();
    for frame in 0..FRAMES {
        for channel in 0..CHANNELS {
            let end = if channel + 1 < CHANNELS { ',' } else { '\n' };
            let _ = write!(text, "{:.8}{end}", value(frame * CHANNELS + channel));
        }
    }
    let mut group = criterion.benchmark_group("reading");
    group.sample_size(10).throughput(Throughput::Bytes(text.len() as u64));
    let options = ReadOptions::default();
    group.bench_function("csv", |bench| {
        bench.iter(|| decode_with(Format::Csv, black_box(text.as_bytes()), "a.csv".as_ref(), &options));
    });
    let comma = text.replace(',', ";").replace('.', ",");
    group.bench_function("csv with decimal commas", |bench| {
        bench.iter(|| decode_with(Format::Csv, black_box(comma.as_bytes()), "a.csv".as_ref(), &options));
    });
    let folder = std::env::temp_dir().join(format!("dermis-reading-{}", std::process::id()));
    let path = folder.join("a.npy");
    let values: Vec<f64> = (0..FRAMES * CHANNELS).map(value).collect();
    let written =
        std::fs::create_dir_all(&folder).is_ok() && npy::write_f64(&path, &[FRAMES, CHANNELS], &values).is_ok();
    if written {
        group.throughput(Throughput::Bytes(8 * values.len() as u64));
        let spec = FileSpec::all(&path);
        group.bench_function("npy", |bench| bench.iter(|| read(black_box(&spec), None)));
    }
    let _ = std::fs::remove_dir_all(&folder);
    group.finish();
}

criterion_group!(benches, reading);
criterion_main!(benches);
