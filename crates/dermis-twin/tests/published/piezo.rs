//! The piezoresistive skins of Sanchez-Delgado et al. (Intelligent Service Robotics 17, 2024): a carbon-sprayed sheet
//! over 64 small electrodes on a circuit board, under loose fabric patches on a neoprene backing.
//!
//! The electrodes are assumed to be on a regular 8 x 8 grid on the square, and on its image under the equal-area
//! concentric map on the disc, numbered row by row in alternating direction from the bottom left.

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec, Reference};
use dermis_tomo::mesh::square_to_disc;
use dermis_tomo::mesh::{ElectrodeShape, Outline};
use dermis_twin::instrument::{Converter, DriveSteps, GainRanges, InstrumentOptions, Multiplexer, Noise, Timing};
use dermis_twin::mechanics::{ContactLaw, Cover};
use dermis_twin::physics::PatchLayout;
use dermis_twin::{ElectrodedLayer, PatchedOptions, PatchedSkin, Twin, TwinError, TwinOptions};

/// Frames per second; the paper's converter takes 4.8 s per frame.
pub const PIEZO_RATE_HZ: f64 = 30.0;
/// Step of the current source, amperes.
const STEP_A: f64 = 2.6e-6;

/// Neighbours (k, k+1) drive; the last electrode pairs with the first. For each drive, all 64 electrodes are read
/// against the sink: 4,096 channels, with zeros for the 64 sinks themselves.
pub fn piezo_protocol() -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 64,
        drive: Drive::Adjacent,
        measure: Measure::SingleEnded(Reference::Sink),
        order: Order::Absolute,
        driven: Driven::Keep,
        amplitude_a: 15.0 * STEP_A,
    })
    .unwrap()
}

fn pads(place: impl Fn([f64; 2]) -> [f64; 2]) -> Vec<ElectrodeShape> {
    let unit = |k: usize| (2.0 * k as f64 + 1.0) / 8.0 - 1.0;
    let pad = |k: usize| {
        let (row, step) = (k / 8, k % 8);
        let column = if row.is_multiple_of(2) { step } else { 7 - step };
        ElectrodeShape::PadCircle { centre_m: place([unit(column), unit(row)]), radius_m: 1.5e-3 }
    };
    (0..64).map(pad).collect()
}

/// The square of 150 mm. The paper gives the limit of detection of 83 Pa, which determines the reference pressure;
/// the rest of the contact law is assumed. The backing of 5.5 mm spreads pressure uniformly.
pub fn piezo_square() -> PatchedOptions {
    PatchedOptions {
        layer: ElectrodedLayer {
            outline: Outline::Rectangle { width_m: 0.15, height_m: 0.15 },
            electrodes: pads(|[x, y]| [0.5 * 0.15 * x, 0.5 * 0.15 * y]),
            contact_impedances_ohm_m2: vec![1e-3],
            protocol: piezo_protocol(),
            conductance: Default::default(),
            element_size_m: 3.2e-3,
            electrode_element_size_m: 1.2e-3,
        },
        sheet_s: 1.0 / 2e3,
        patches: PatchLayout { pitch_m: 10e-3, gap_m: 1e-3, cells_per_side: 3 },
        cover: Cover { smoothing_m: 5.5e-3 / 3_f64.sqrt() },
        contact: ContactLaw { threshold_pa: 50.0, reference_pa: 888.0, exponent: 1.5, saturation_s_per_m2: 200.0 },
        memory: None,
    }
}

/// The disc of 120 mm; otherwise as the square.
pub fn piezo_disc() -> PatchedOptions {
    let mut disc = piezo_square();
    disc.layer.outline = Outline::Disc { radius_m: 0.5 * 0.12 };
    disc.layer.electrodes = pads(|place| square_to_disc(place).map(|value| 0.5 * 0.12 * value));
    disc
}

/// Current in steps of 2.6 uA up to 40 uA, a multiplexer of 400 ohm, and a 16-bit converter with 860 samples per
/// second and five ranges. Assumed: noise of 20 uV and 80 dB, inputs of 10 megohm and 20 pF, 10 us of settling.
pub fn piezo_instrument() -> InstrumentOptions {
    let (on_resistance_ohm, input_resistance_ohm, input_capacitance_f) = (400.0, 1e7, 20e-12);
    InstrumentOptions {
        noise: Noise { floor_v: 20e-6, proportional: 1e-4 },
        converter: Some(Converter { bits: 16, range_v: 4.096, gain: 1.0 }),
        drive: Some(DriveSteps { wanted_a: 15.0 * STEP_A, step_a: STEP_A, most_a: 40e-6 }),
        multiplexer: Some(Multiplexer { on_resistance_ohm, input_resistance_ohm, input_capacitance_f, crosstalk: 0.0 }),
        gain_ranges: Some(GainRanges { factor: 2.0, count: 5 }),
        timing: Some(Timing { settling_s: 1e-5, conversion_s: 1.0 / 860.0, frame_overhead_s: 0.0 }),
        ..InstrumentOptions::ideal()
    }
}

pub fn piezo_twin(options: PatchedOptions) -> Result<Twin<PatchedSkin>, TwinError> {
    let around = TwinOptions { instrument: piezo_instrument(), ..TwinOptions::default() };
    Twin::of(PatchedSkin::new(options)?, &around)
}
