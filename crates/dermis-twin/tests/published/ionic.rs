//! The ionic skins: salted water in a shallow tray under a stretched latex membrane, enclosed and full, with 16 bolts
//! through the wall.

use std::f64::consts::FRAC_PI_2;

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, Outline};
use dermis_twin::instrument::{InstrumentOptions, Noise, Timing};
use dermis_twin::mechanics::{Cover, Memory, STANDARD_GRAVITY_M_PER_S2};
use dermis_twin::{ElectrodedLayer, LiquidOptions, LiquidSkin, LiquidSolver, Twin, TwinError, TwinOptions};

/// Frames per second.
pub const IONIC_RATE_HZ: f64 = 16.0;
/// Average signal-to-noise ratio by the printed formula, dB, over this many frames.
const SNR_DB: f64 = 59.7;
const FRAMES: f64 = 100.0;
/// Depth of the liquid.
pub const IONIC_DEPTH_M: f64 = 10.25e-3;
/// Side of the square that represents a bolt's washer. Assumed: the area of a standard 7 mm M3 washer.
const BOLT_M: f64 = 6.2e-3;

/// Adjacent drive and measurement, without channels on driven electrodes: 208 channels.
pub fn ionic_protocol() -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::Skip(0),
        measure: Measure::Skip(0),
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 6e-3,
    })
    .unwrap()
}

/// The round skin of 174 mm; electrode 1 at the top, numbered clockwise. Conductivity and contacts are assumed,
/// tension and memory fitted.
pub fn ionic_disc() -> LiquidOptions {
    LiquidOptions {
        layer: ElectrodedLayer {
            outline: Outline::Disc { radius_m: 0.5 * 0.174 },
            electrodes: Outline::rim_arcs(16, BOLT_M, FRAC_PI_2, Direction::Clockwise),
            contact_impedances_ohm_m2: vec![1e-4],
            protocol: ionic_protocol(),
            conductance: Default::default(),
            element_size_m: 4.5e-3,
            electrode_element_size_m: 1.2e-3,
        },
        electrode_height_m: BOLT_M,
        electrode_middle_m: 0.5 * IONIC_DEPTH_M,
        depth_m: IONIC_DEPTH_M,
        conductivity_s_per_m: 0.5,
        density_kg_per_m3: 1000.0,
        tension_n_per_m: 60.0,
        gravity_m_per_s2: [0.0, 0.0, -STANDARD_GRAVITY_M_PER_S2],
        cover: Cover { smoothing_m: 0.5e-3 },
        memory: Some(Memory { share: 0.05, time_constant_s: 20.0 }),
        solver: LiquidSolver::DepthAveraged,
    }
}

/// The square skin of 212 mm; electrode 1 at the left end of the bottom side, numbered counter-clockwise.
pub fn ionic_square() -> LiquidOptions {
    let mut square = ionic_disc();
    square.layer.outline = Outline::Rectangle { width_m: 0.212, height_m: 0.212 };
    square.layer.electrodes = square.layer.outline.rim_per_side(4, BOLT_M, Direction::CounterClockwise);
    square
}

/// The round skin with bolts of another size, centred at a share of the depth.
pub fn ionic_disc_with_bolts(side_m: f64, height_share: f64) -> LiquidOptions {
    let mut disc = ionic_disc();
    disc.layer.electrodes = Outline::rim_arcs(16, side_m, FRAC_PI_2, Direction::Clockwise);
    LiquidOptions { electrode_height_m: side_m, electrode_middle_m: height_share * IONIC_DEPTH_M, ..disc }
}

/// 16 frames per second with 208 channels each, and noise proportional to each voltage. It gives the paper's 59.7 dB
/// on any skin if that figure is an ordinary amplitude ratio, `20 log10(mean / deviation)`.
pub fn ionic_instrument() -> InstrumentOptions {
    let channel_s = 1.0 / (IONIC_RATE_HZ * 208.0);
    InstrumentOptions {
        noise: Noise { floor_v: 0.0, proportional: 10_f64.powf(-SNR_DB / 20.0) },
        timing: Some(Timing { settling_s: 0.5 * channel_s, conversion_s: 0.5 * channel_s, frame_overhead_s: 0.0 }),
        ..InstrumentOptions::ideal()
    }
}

/// The same with noise for which the paper's eq. 1 as printed, `10 log10(mean / deviation)`, gives 59.7 dB.
pub fn ionic_instrument_as_printed() -> InstrumentOptions {
    let n = FRAMES - 1.0;
    let logarithm = SNR_DB / 10.0 * std::f64::consts::LN_10 + (-0.5 / n - 1.0 / (6.0 * n * n));
    InstrumentOptions { noise: Noise { floor_v: 0.0, proportional: (-logarithm).exp() }, ..ionic_instrument() }
}

pub fn ionic_twin(options: LiquidOptions) -> Result<Twin<LiquidSkin>, TwinError> {
    let around = TwinOptions { instrument: ionic_instrument(), ..TwinOptions::default() };
    Twin::of(LiquidSkin::new(options)?, &around)
}
