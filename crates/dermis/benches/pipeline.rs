//! Speed of the live pipeline, from a frame of a touched skin to its image and touches.

use criterion::{Criterion, criterion_group, criterion_main};
use dermis::Error;
use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::{Pipeline, TARE_FRAMES};
use dermis_live::prepare::Prepared;
use dermis_live::stages::damage::{Crack, CrackModel, CrackScratch, estimate_cut};
use dermis_skin::{Skin, Solve};
use dermis_touch::damage::DamageShape;
use dermis_twin::TwinKit;

/// Time between frames, nanoseconds.
const STEP_NS: u64 = 50_000_000;
/// Frames in the repeated sequence.
const LOOP: usize = 64;

/// A skin's pipeline after its baseline, and frames of its twin under two presses.
fn pressed(name: &str, solve: Solve) -> Result<(Pipeline, Vec<Vec<f64>>), Error> {
    let mut skin = Skin::open(name)?;
    skin.imaging.solve = solve;
    let mut kit = TwinKit::of(&skin)?;
    let prepared = Prepared::new(skin)?;
    let half_width_m = prepared.half_width_m();
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None)?;
    let (mut values, mut frames, mut frame) = (Vec::new(), Vec::new(), Frame::default());
    for number in 0..TARE_FRAMES + LOOP {
        if number == TARE_FRAMES {
            let (radius_m, pressure_pa) = (kit.press.initial_radius_m, kit.press.pressure_pa[1]);
            kit.twin.scene_mut().press(0, -0.3 * half_width_m, 0.2 * half_width_m, radius_m, pressure_pa)?;
            kit.twin.scene_mut().press(1, 0.4 * half_width_m, -0.3 * half_width_m, radius_m, pressure_pa)?;
        }
        kit.twin.step(1e-9 * (number as u64 * STEP_NS) as f64, &mut values)?;
        if number < TARE_FRAMES {
            refill(&mut frame, number as u64, &values);
            pipeline.process(&frame, number as u64 * STEP_NS)?;
        } else {
            frames.push(values.clone());
        }
    }
    Ok((pipeline, frames))
}

fn refill(frame: &mut Frame, number: u64, values: &[f64]) {
    frame.refill(number, HostStamp { monotonic_ns: number * STEP_NS, wall_ns: number }, values, &[]);
}

fn pipelines(c: &mut Criterion) {
    let mut group = c.benchmark_group("frame to image and touches");
    for (label, name, solve) in [
        ("healing-square, 208 channels", "healing-square", Solve::Pixels),
        ("ionic-disc, 208 channels", "ionic-disc", Solve::Pixels),
        ("piezo-disc, 4096 channels", "piezo-disc", Solve::Pixels),
        ("em-16-square, 120 channels, pixels", "em-16-square", Solve::Pixels),
        ("em-8, 28 channels, heights", "em-8", Solve::LiftOff),
        ("em-16-square, 120 channels, heights", "em-16-square", Solve::LiftOff),
    ] {
        let (mut pipeline, frames) = match pressed(name, solve) {
            Ok(made) => made,
            Err(error) => {
                eprintln!("{label} could not be set up: {error}");
                continue;
            }
        };
        let (mut number, mut frame) = (TARE_FRAMES as u64, Frame::default());
        group.bench_function(label, |b| {
            b.iter(|| {
                refill(&mut frame, number, &frames[number as usize % LOOP]);
                let output = pipeline.process(&frame, number * STEP_NS).map(|output| output.touches.len());
                number += 1;
                output.unwrap_or(usize::MAX)
            });
        });
    }
    group.finish();
}

/// The work of the live watch for each new cut, on the stream's thread.
fn fits_of_cuts(c: &mut Criterion) {
    let fit = || -> Result<_, Error> {
        let prepared = Prepared::new(Skin::open("healing-square")?)?;
        let model = CrackModel::new(&prepared)?;
        let cut = Crack { centre_m: [0.02, -0.01], length_m: 0.02, direction_rad: 0.6, joined_per_m: 0.0 };
        let mut change = vec![0.0; prepared.channels()];
        model.respond(&cut, &mut CrackScratch::default(), &mut change);
        let noise = vec![1e-6; change.len()];
        Ok((prepared, model, change, noise))
    };
    let (prepared, model, change, noise) = match fit() {
        Ok(made) => made,
        Err(error) => return eprintln!("the fit of a cut could not be set up: {error}"),
    };
    // The centre found in the image is off by up to a centimetre.
    let start =
        DamageShape { centre_m: [0.026, -0.016], length_m: 0.03, width_m: 0.0, direction_rad: 0.0, deviations: None };
    c.bench_function("fit of a cut, healing-square", |b| {
        b.iter(|| estimate_cut(&prepared, &model, &change, &noise, &start).is_ok_and(|found| found.is_some()));
    });
}

criterion_group!(benches, pipelines, fits_of_cuts);
criterion_main!(benches);
