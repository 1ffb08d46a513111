//! The smallest force that a skin detects, from the mechanics of its twin. Membranes and air gaps are nonlinear, so
//! the pressure at each place is found by bisection.

use dermis_tomo::mesh::{PixelGrid, Point};
use dermis_twin::Frontend;
use dermis_twin::mechanics::Indenter;

use super::maps::{DETECTED_SIGMA, Noise, places, scattered};
use crate::Error;
use dermis_live::prepare::Prepared;
use dermis_twin::TwinKit;

/// Frames of the twin at rest from which the instrument's noise is estimated.
const NOISE_FRAMES: usize = 60;
/// Bisection steps on the logarithm of the pressure: from four decades down to 2 %.
const HALVINGS: usize = 9;
/// Lowest pressure tried, relative to the highest.
const LEAST_SHARE: f64 = 1e-4;

/// The smallest detectable force at places over a skin.
#[derive(Clone, Debug)]
pub struct ForceMap {
    /// Places, metres.
    pub places_m: Vec<Point>,
    /// Grid of the map.
    pub grid: PixelGrid,
    /// Pixel of each place.
    pub pixels: Vec<usize>,
    /// Radius of the round indenter, metres.
    pub radius_m: f64,
    /// Force, newtons; infinite where even the twin's hardest press goes undetected.
    pub force_n: Vec<f64>,
}

impl ForceMap {
    /// The map as a row-major image, NaN outside the skin.
    pub fn image(&self) -> Vec<f32> {
        scattered(&self.grid, &self.pixels, &self.force_n)
    }
}

/// Finds the smallest detectable force at each place of a skin.
///
/// The twin is pressed with the indenter that its sliders start with, and a press is detected once all channels
/// together are 3.3 standard deviations of the noise away from rest. [`Noise::Assumed`] means the noise of the twin's
/// own instrument, measured at rest. Places where the indenter would overlap the rim are left out.
///
/// # Errors
/// The skin has no twin, or its fields cannot be solved.
pub fn smallest_force(
    prepared: &Prepared,
    noise: Noise,
    along: usize,
    mut progress: impl FnMut(usize, usize),
) -> Result<ForceMap, Error> {
    let kit = TwinKit::of(&prepared.skin)?;
    let (radius_m, hardest_pa) = (kit.press.initial_radius_m, kit.press.pressure_pa[1]);
    let (mut frontend, mut instrument, _) = kit.twin.into_parts();
    let mut rest = vec![0.0; frontend.channel_count()];
    frontend.voltages(&[], 0.0, &mut rest)?;
    let read = |frame: &mut Vec<f64>| instrument.read(1.0, frame);
    let deviations = match noise {
        Noise::Assumed => deviations_at_rest(&rest, read),
        Noise::Volts(volts) => vec![volts; rest.len()],
        Noise::Decibels(db) => {
            let largest = rest.iter().map(|v| v.abs()).fold(0.0, f64::max);
            rest.iter().map(|v| 10_f64.powf(-db / 20.0) * v.abs().max(1e-4 * largest)).collect()
        }
    };
    let (grid, map) = places(prepared, along)?;
    let inside: Vec<usize> = map.inside_pixels().iter().map(|&pixel| pixel as usize).collect();
    let clear = |place: &Point| {
        (0..16).all(|k| {
            let angle = std::f64::consts::TAU * f64::from(k) / 16.0;
            let rim = [place[0] + radius_m * angle.cos(), place[1] + radius_m * angle.sin()];
            grid.pixel_at(rim).is_some_and(|pixel| inside.binary_search(&pixel).is_ok())
        })
    };
    let all: Vec<(usize, [f64; 2])> =
        inside.iter().copied().zip(map.inside_centres_m()).filter(|(_, place)| clear(place)).collect();
    let mut frame = vec![0.0; rest.len()];
    let mut force_n = Vec::with_capacity(all.len());
    for (index, (_, place)) in all.iter().enumerate() {
        let mut noticed = |pressure_pa: f64| -> Result<bool, Error> {
            frontend.voltages(&[Indenter::disc(*place, radius_m, pressure_pa)], 0.0, &mut frame)?;
            let change = |((now, before), noise): ((&f64, &f64), &f64)| ((now - before) / noise).powi(2);
            Ok(frame.iter().zip(&rest).zip(&deviations).map(change).sum::<f64>().sqrt() >= DETECTED_SIGMA)
        };
        let pressure_pa = threshold(hardest_pa, &mut noticed)?;
        force_n.push(pressure_pa * std::f64::consts::PI * radius_m * radius_m);
        progress(index + 1, all.len());
    }
    let (pixels, places_m) = all.into_iter().unzip();
    Ok(ForceMap { places_m, grid, pixels, radius_m, force_n })
}

/// The lowest detected pressure, by bisection on its logarithm.
fn threshold(hardest_pa: f64, noticed: &mut impl FnMut(f64) -> Result<bool, Error>) -> Result<f64, Error> {
    if !noticed(hardest_pa)? {
        return Ok(f64::INFINITY);
    }
    let (mut unnoticed, mut seen) = (LEAST_SHARE * hardest_pa, hardest_pa);
    for _ in 0..HALVINGS {
        let middle = (unnoticed * seen).sqrt();
        if noticed(middle)? { seen = middle } else { unnoticed = middle }
    }
    Ok(seen)
}

/// Standard deviation of the instrument's readings at rest, per channel. A channel that never moves (its noise is
/// below the converter's step) gets the average of all channels.
fn deviations_at_rest(rest: &[f64], mut read: impl FnMut(&mut Vec<f64>)) -> Vec<f64> {
    let (mut sum, mut squares) = (vec![0.0; rest.len()], vec![0.0; rest.len()]);
    for _ in 0..NOISE_FRAMES {
        let mut frame = rest.to_vec();
        read(&mut frame);
        for (channel, value) in frame.iter().enumerate() {
            let off = value - rest[channel];
            sum[channel] += off;
            squares[channel] += off * off;
        }
    }
    let count = NOISE_FRAMES as f64;
    let variance = |k: usize| ((squares[k] - sum[k] * sum[k] / count) / (count - 1.0)).max(0.0);
    let variances: Vec<f64> = (0..rest.len()).map(variance).collect();
    let mean = variances.iter().sum::<f64>() / variances.len().max(1) as f64;
    variances.iter().map(|v| if *v > 0.0 { v.sqrt() } else { mean.sqrt() }).collect()
}
