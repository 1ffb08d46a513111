//! Reproduces paper P's limit of detection and discernible distance on the twins of the square and the disc, after
//! fitting one parameter to the square's limit of detection:
//! `cargo run --release -p dermis-twin --example piezo_paper`.

#[path = "../tests/published/mod.rs"]
mod published;

use dermis_twin::piezo::{PUBLISHED_DISTANCES_M, PUBLISHED_LIMITS_PA};
use dermis_twin::{PaperP, PatchedOptions, TwinError};
use published::{piezo_disc, piezo_instrument, piezo_square};

fn main() -> Result<(), TwinError> {
    let (mut options, mut instrument) = (piezo_square(), piezo_instrument());
    let mut arguments = std::env::args().skip(1).filter_map(|argument| argument.parse::<f64>().ok());
    options.contact.threshold_pa = arguments.next().unwrap_or(options.contact.threshold_pa);
    options.contact.exponent = arguments.next().unwrap_or(options.contact.exponent);
    options.patches.pitch_m = arguments.next().map_or(options.patches.pitch_m, |pitch_mm| 1e-3 * pitch_mm);
    options.cover.smoothing_m = arguments.next().map_or(options.cover.smoothing_m, |mm| 1e-3 * mm);
    instrument.noise.floor_v = arguments.next().map_or(instrument.noise.floor_v, |uv| 1e-6 * uv);
    let (patches, cover, contact) = (options.patches, options.cover, options.contact);
    let disc = PatchedOptions { patches, cover, ..piezo_disc() };
    let mut paper = PaperP::new(options, disc, instrument, 1)?;
    let reference_pa = paper.fit()?;
    println!(
        "gap {} Pa, exponent {}: fitted reference pressure {reference_pa:.0} Pa",
        contact.threshold_pa, contact.exponent
    );
    for (k, (name, facts)) in ["square", "disc"].into_iter().zip(paper.facts()?).enumerate() {
        let (detection, correlation) = (facts.detection, facts.correlation);
        println!(
            "{name}: limit {:.1} Pa (paper {}), V_rms at rest {:.3} mV, noise {:.3} uV",
            detection.limit_pa,
            PUBLISHED_LIMITS_PA[k],
            1e3 * detection.rest_v,
            1e6 * detection.noise_v
        );
        for point in &detection.points {
            let mean = point.change_v.iter().sum::<f64>() / 5.0;
            println!("  {:5.1} g {:6.1} Pa: V_rms changed by {:.2} uV", point.mass_g, point.pressure_pa, 1e6 * mean);
        }
        println!(
            "  correlation 0.9 at {:.2} mm (paper {:.2}), 0.5 at {:.2} mm (paper {:.2})",
            1e3 * correlation.distance_09_m,
            1e3 * PUBLISHED_DISTANCES_M[k][0],
            1e3 * correlation.distance_05_m,
            1e3 * PUBLISHED_DISTANCES_M[k][1]
        );
        for point in correlation.points.iter().step_by(8) {
            println!("  {:4.1} mm: {:.3}", 1e3 * point.shift_m, point.correlation);
        }
    }
    Ok(())
}
