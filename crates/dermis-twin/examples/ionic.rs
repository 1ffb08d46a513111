//! Prints results of the liquid skins' twins: depth under weights, voltages and their changes, the time per frame,
//! and where depth-averaged fields differ from three-dimensional ones:
//! `cargo run --release -p dermis-twin --example ionic`.

#[path = "../tests/published/mod.rs"]
mod published;

use std::time::Instant;

use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{Frontend, LiquidOptions, LiquidSkin, LiquidSolver, TwinError};
use published::{ionic_disc, ionic_disc_with_bolts, ionic_square};

const GRAMS: f64 = 6.5;

fn main() -> Result<(), TwinError> {
    for tension in [30.0, 45.0, 60.0, 80.0, 120.0] {
        ramp(LiquidOptions { tension_n_per_m: tension, memory: None, ..ionic_disc() })?;
    }
    cost()?;
    compare()?;
    heights()
}

/// Signal of a touch in three dimensions, with small electrodes low, halfway up and high on the wall.
fn heights() -> Result<(), TwinError> {
    for radius_mm in [0.0, 30.0, 60.0, 75.0] {
        print!("electrodes of 3 mm, touch of 0.255 N at {radius_mm} mm, signal:");
        for share in [0.16, 0.5, 0.84] {
            let options = LiquidOptions {
                memory: None,
                solver: LiquidSolver::Solid { layers: 8 },
                ..ionic_disc_with_bolts(3e-3, share).meshed(3.5e-3, 0.8e-3)
            };
            let mut skin = LiquidSkin::new(options)?;
            let rest = read(&mut skin, &[])?;
            let frame = read(&mut skin, &[Indenter::weight([radius_mm * 1e-3, 0.0], 0.01, 26.0)])?;
            let change = rms(frame.iter().zip(&rest).map(|(v, v0)| v / v0 - 1.0));
            print!(" {:.4} % at {share} of the depth,", 1e2 * change);
        }
        println!();
    }
    Ok(())
}

fn read(skin: &mut LiquidSkin, indenters: &[Indenter]) -> Result<Vec<f64>, TwinError> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.0, &mut frame)?;
    Ok(frame)
}

fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), v| (sum + v * v, count + 1.0));
    f64::sqrt(sum / count)
}

/// Deepest dent and relative change of the frame for 1 to 9 weights at three radii.
fn ramp(options: LiquidOptions) -> Result<(), TwinError> {
    let tension_n_per_m = options.tension_n_per_m;
    let mut skin = LiquidSkin::new(options)?;
    let rest = read(&mut skin, &[])?;
    println!("tension {tension_n_per_m} N/m, {} elements", skin.fields().element_count());
    for radius_mm in [0.0, 30.0, 60.0] {
        print!("  at {radius_mm} mm:");
        let mut per_weight = Vec::new();
        for weights in 1..=9 {
            let load = Indenter::weight([radius_mm * 1e-3, 0.0], 0.01, GRAMS * f64::from(weights));
            let frame = read(&mut skin, &[load])?;
            let dent = skin.membrane().deflection_m().iter().copied().fold(0.0, f64::max);
            let change = rms(frame.iter().zip(&rest).map(|(v, v0)| v / v0 - 1.0));
            per_weight.push(change / f64::from(weights));
            if [1, 2, 5, 9].contains(&weights) {
                print!(" {weights}: {:.2} mm {:.3} %,", 1e3 * dent, 1e2 * change);
            }
        }
        println!(" sensitivity at 9 over 1: {:.3}", per_weight[8] / per_weight[0]);
    }
    Ok(())
}

fn cost() -> Result<(), TwinError> {
    for (name, options) in [("disc", ionic_disc()), ("square", ionic_square())] {
        let mut skin = LiquidSkin::new(options)?;
        let frames = 300;
        let start = Instant::now();
        for frame in 0..frames {
            let x = 0.05 * (f64::from(frame) / 20.0).sin();
            read(&mut skin, &[Indenter::weight([x, 0.01], 0.01, 26.0), Indenter::weight([-x, -0.03], 0.01, 13.0)])?;
        }
        let rate = f64::from(frames) / start.elapsed().as_secs_f64();
        println!("{name}: {} elements, two moving touches, {rate:.0} frames/s", skin.fields().element_count());
    }
    Ok(())
}

/// Voltages at rest and touch signals, in the plane and in three dimensions.
fn compare() -> Result<(), TwinError> {
    let fine = LiquidOptions { memory: None, ..ionic_disc().meshed(2.5e-3, 1.0e-3) };
    let mut flat = LiquidSkin::new(fine.clone())?;
    let start = Instant::now();
    let mut solid = LiquidSkin::new(LiquidOptions { solver: LiquidSolver::Solid { layers: 6 }, ..fine })?;
    let (flat_rest, solid_rest) = (read(&mut flat, &[])?, read(&mut solid, &[])?);
    println!("solid: {} elements, first frame {:.1} s", solid.fields().element_count(), start.elapsed().as_secs_f64());
    distances("at rest", &flat, &flat_rest, &solid_rest);
    let change = |rest: &[f64], frame: Vec<f64>| -> Vec<f64> { frame.iter().zip(rest).map(|(v, v0)| v - v0).collect() };
    for (radius_mm, angle_deg, indenter_mm, force_n) in [
        (0.0, 0.0, 10.0, 0.255),
        (0.0, 0.0, 10.0, 0.58),
        (30.0, 0.0, 10.0, 0.255),
        (60.0, 0.0, 10.0, 0.255),
        (75.0, 0.0, 10.0, 0.255),
        (75.0, 11.25, 10.0, 0.255),
        (0.0, 0.0, 2.0, 0.255),
        (60.0, 0.0, 2.0, 0.255),
        (83.0, 0.0, 2.0, 0.255),
        (83.0, 11.25, 2.0, 0.255),
    ] {
        let (sine, cosine) = f64::to_radians(angle_deg).sin_cos();
        let centre_m = [1e-3 * radius_mm * cosine, 1e-3 * radius_mm * sine];
        let shape = Shape::Disc { radius_m: 1e-3 * indenter_mm };
        let load = [Indenter { centre_m, shape, load: Load::ForceN(force_n) }];
        let a = change(&flat_rest, read(&mut flat, &load)?);
        let b = change(&solid_rest, read(&mut solid, &load)?);
        let place = format!("{force_n} N on {indenter_mm} mm radius at {radius_mm} mm, {angle_deg} degrees");
        distances(&place, &flat, &a, &b);
    }
    Ok(())
}

/// Ratio of the 3D to the 2D solution by regression, its residual, and the same by distance between the measuring and
/// the driving pair.
fn distances(what: &str, skin: &LiquidSkin, flat: &[f64], solid: &[f64]) {
    let gain = |pairs: &[(f64, f64)]| {
        pairs.iter().map(|(a, b)| a * b).sum::<f64>() / pairs.iter().map(|(a, _)| a * a).sum::<f64>()
    };
    let all: Vec<(f64, f64)> = flat.iter().copied().zip(solid.iter().copied()).collect();
    let factor = gain(&all);
    let left = rms(all.iter().map(|(a, b)| b - factor * a)) / rms(all.iter().map(|(_, b)| *b));
    print!("{what}: solid {factor:.3} of flat, {:.1} % left; by distance", 1e2 * left);
    let protocol = skin.fields().protocol();
    let apart = |channel: usize| {
        let first =
            |pattern: &dermis_tomo::eit::Pattern| pattern.entries().iter().map(|e| e.0 as i64).collect::<Vec<_>>();
        let (drive, pair) = (first(protocol.stimulation_of(channel)), first(protocol.pattern_of(channel)));
        let gap = |a: i64, b: i64| (a - b).rem_euclid(16).min((b - a).rem_euclid(16));
        drive.iter().flat_map(|&a| pair.iter().map(move |&b| gap(a, b))).min().unwrap_or(0)
    };
    for distance in 1..=7 {
        let some: Vec<(f64, f64)> = (0..all.len()).filter(|&c| apart(c) == distance).map(|c| all[c]).collect();
        print!(" {:.3}", gain(&some));
    }
    println!();
}
