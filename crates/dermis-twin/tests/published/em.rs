//! The EM-skins: coils under a membrane of conducting elements on sponge or springs. The paper gives coils,
//! frequencies, frame rates, signal-to-noise ratios, and the number and size of the elements; heights, stiffness,
//! travel and current are assumed.

use dermis_mit::sheet::SheetMaterial;
use dermis_mit::{CoilArray, Coupling, Sphere};
use dermis_tomo::mesh::Outline;
use dermis_twin::instrument::{Converter, GainRanges, InstrumentOptions, Noise, Reading};
use dermis_twin::mechanics::{Memory, Springs};
use dermis_twin::{Conductor, ElementOptions, ElementSkin, FoilOptions, Twin, TwinError, TwinOptions};

/// `n` x `n` positions around the origin, row by row from the bottom left.
pub fn grid(n: usize, pitch_m: f64) -> Vec<[f64; 2]> {
    let middle = 0.5 * (n as f64 - 1.0);
    let at = |k: usize| (k as f64 - middle) * pitch_m;
    (0..n * n).map(|k| [at(k % n), at(k / n)]).collect()
}

/// An aluminium sphere with the volume of a cylinder.
fn aluminium(diameter_m: f64, height_m: f64) -> Conductor {
    let radius_m = (0.1875 * diameter_m * diameter_m * height_m).cbrt();
    Conductor::Sphere(Sphere { radius_m, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 })
}

/// Eight coils at 55 kHz, 83 dB, 10 frames/s, under 5 x 5 aluminium cylinders of 10 mm (their height of 10 mm is
/// assumed) on sponge.
pub fn em_8() -> ElementOptions {
    ElementOptions {
        outline: Outline::Rectangle { width_m: 0.14, height_m: 0.14 },
        coils: CoilArray::em_8().unwrap(),
        places_m: grid(5, 0.02),
        cell_m: [0.02; 2],
        rest_m: 0.023,
        tolerance_m: 0.2e-3,
        element: aluminium(0.01, 0.01),
        springs: Springs { stiffness_n_per_m: 400.0, limit_m: 0.011, sharpness: 2.0, coupling_n_per_m: 12.0 },
        memory: Some(Memory { share: 0.04, time_constant_s: 0.3 }),
        coupling: Some(Coupling { degree: 3, reach_m: 0.03, sweeps: 2 }),
        current_a: 0.1,
        frequency_hz: 55e3,
        nearby: None,
        seed: 1,
    }
}

/// Sixteen round spirals at 20 kHz, 50 dB, 1 frame/s, under 8 x 8 springs 30 mm long, 22 mm wide and 13 mm apart,
/// each with a conductor.
pub fn em_16_circular() -> ElementOptions {
    ElementOptions {
        outline: Outline::Rectangle { width_m: 0.32, height_m: 0.32 },
        coils: CoilArray::em_16_circular().unwrap(),
        places_m: grid(8, 0.035),
        cell_m: [0.035; 2],
        rest_m: 0.026,
        element: aluminium(0.022, 0.01),
        springs: Springs { stiffness_n_per_m: 300.0, limit_m: 0.012, sharpness: 2.0, coupling_n_per_m: 0.0 },
        memory: Some(Memory { share: 0.02, time_constant_s: 0.3 }),
        coupling: Some(Coupling { degree: 3, reach_m: 0.05, sweeps: 2 }),
        frequency_hz: 20e3,
        ..em_8()
    }
}

/// The same with square spirals, 53 dB.
pub fn em_16_square() -> ElementOptions {
    ElementOptions { coils: CoilArray::em_16_square().unwrap(), ..em_16_circular() }
}

/// Noise proportional to each reading, and the 16 bits of the paper's converter.
pub fn em_instrument(snr_db: f64) -> InstrumentOptions {
    InstrumentOptions {
        noise: Noise { floor_v: 0.0, proportional: 10_f64.powf(-snr_db / 20.0) },
        converter: Some(Converter { bits: 16, range_v: 5.0, gain: 4.0 }),
        gain_ranges: Some(GainRanges { factor: 2.0, count: 16 }),
        reading: Reading::Magnitude,
        ..InstrumentOptions::ideal()
    }
}

pub fn em_twin(options: ElementOptions, snr_db: f64) -> Result<Twin<ElementSkin>, TwinError> {
    let around = TwinOptions { instrument: em_instrument(snr_db), ..TwinOptions::default() };
    Twin::of(ElementSkin::new(options)?, &around)
}

/// 35 um of copper over the eight coils, on their sponge, with a tension that spreads a dent over 17 mm.
pub fn foil() -> FoilOptions {
    FoilOptions {
        coils: CoilArray::em_8().unwrap(),
        side_m: 0.14,
        cells: 24,
        material: SheetMaterial { thickness_m: 35e-6, conductivity_s_per_m: 5.8e7 },
        rest_m: 0.018,
        tension_n_per_m: 300.0,
        stiffness_pa_per_m: 1e6,
        limit_m: 0.011,
        current_a: 0.1,
        frequency_hz: 55e3,
    }
}
