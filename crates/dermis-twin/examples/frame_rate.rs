//! Prints the time per frame of the healing square and the size of its signals:
//! `cargo run --release -p dermis-twin --example frame_rate`.

#[path = "../tests/published/mod.rs"]
mod published;

use std::time::Instant;

use dermis_twin::instrument::snr_db;
use dermis_twin::scene::Script;
use dermis_twin::{Sandwich, Twin, TwinError, TwinOptions};
use published::{healing_square, healing_twin, healing_twin_options};

fn main() -> Result<(), TwinError> {
    let start = Instant::now();
    let around = TwinOptions { script: Some(Script::demo()), ..healing_twin_options() };
    let mut twin = Twin::of(Sandwich::new(healing_square())?, &around)?;
    let elements = twin.frontend().body().mesh.element_count();
    println!("prepared {elements} elements in {:.0} ms", 1e3 * start.elapsed().as_secs_f64());
    let mut frame = Vec::new();
    let (mut pressed, mut quickest, mut total) = (0_u32, f64::INFINITY, 0.0);
    // From 2 s on, each frame differs from the last and needs a new solution.
    for step in 0..=200 {
        let start = Instant::now();
        twin.step(2.0 + 0.04 * f64::from(step), &mut frame)?;
        let spent = start.elapsed().as_secs_f64();
        if step > 50 {
            (pressed, quickest, total) = (pressed + 1, quickest.min(spent), total + spent);
        }
    }
    println!("pressed: {:.1} frames/s on average, {:.1} at best", f64::from(pressed) / total, 1.0 / quickest);
    signals()?;
    noise()
}

fn signals() -> Result<(), TwinError> {
    let mut twin = Twin::of(Sandwich::new(healing_square())?, &TwinOptions::default())?;
    let mut rest = Vec::new();
    twin.step(0.0, &mut rest)?;
    let size =
        |values: &[f64]| values.iter().map(|v| v.abs()).fold((f64::INFINITY, 0.0), |(l, h), v| (v.min(l), v.max(h)));
    let (least, most) = size(&rest);
    println!("at rest: {:.3} to {:.2} mV", 1e3 * least, 1e3 * most);
    let mut time = 0.0;
    for (radius, x, y, pressure) in [
        (0.0100, 0.0, 0.0, 80e3),
        (0.0125, 0.0, 0.0, 80e3),
        (0.0100, 0.0, 0.025, 80e3),
        (0.0100, 0.025, 0.025, 80e3),
        (0.0100, 0.0, 0.0, 40e3),
        (0.0100, 0.0, 0.0, 10e3),
    ] {
        twin.scene_mut().press(1, x, y, radius, pressure)?;
        let mut frame = Vec::new();
        twin.step(time + 1.0, &mut frame)?;
        time += 2.0;
        let change: Vec<f64> = frame.iter().zip(&rest).map(|(v, v0)| v - v0).collect();
        let rms = (change.iter().map(|v| v * v).sum::<f64>() / 208.0).sqrt();
        println!(
            "{:.0} kPa, {:.0} mm indenter at ({:.0}, {:.0}) mm: change {:.3} mV at most, {:.3} mV rms",
            pressure / 1e3,
            2e3 * radius,
            1e3 * x,
            1e3 * y,
            1e3 * size(&change).1,
            1e3 * rms
        );
        twin.scene_mut().release_all();
        twin.step(time, &mut frame)?;
    }
    Ok(())
}

fn noise() -> Result<(), TwinError> {
    let mut twin = healing_twin()?;
    let mut readings = vec![Vec::new(); 208];
    let mut frame = Vec::new();
    for step in 0..500 {
        twin.step(0.04 * f64::from(step), &mut frame)?;
        readings.iter_mut().zip(&frame).for_each(|(channel, value)| channel.push(*value));
    }
    let snr: Vec<f64> = readings.iter().map(|channel| snr_db(channel)).collect();
    let (least, most) = snr.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
    println!("SNR: average {:.2} dB, {least:.1} to {most:.1} dB", snr.iter().sum::<f64>() / 208.0);
    Ok(())
}
