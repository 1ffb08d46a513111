//! The self-healing sandwich of Chen, Wang et al.: a 100 mm square of conductive composite with 16 pads along its
//! rim, under an air gap and a copper layer.

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline};
use dermis_twin::instrument::{Converter, InstrumentOptions, Noise};
use dermis_twin::mechanics::{ContactLaw, Cover};
use dermis_twin::{ElectrodedLayer, HealingLaw, Heating, Sandwich, SandwichOptions, Twin, TwinError, TwinOptions};

/// Frames per second (not in the paper).
pub const HEALING_RATE_HZ: f64 = 25.0;
/// Lasting rise of the intact bar's conductivity after heating.
const LASTING_RISE: f64 = 2010.0 / 1920.0 - 1.0;

/// Pairs (k, k+7) drive and measure, without channels on driven electrodes: 208 channels.
pub fn healing_protocol() -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::PseudoPolar,
        measure: Measure::PseudoPolar,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 0.35e-3,
    })
    .unwrap()
}

/// Conductivity 4.98 S/m (a bar of 100 x 10 x 1 mm has 2.01 kohm), 1 mm thick; 35 um of copper; contacts of 14 ohm
/// per pad (assumed). The contact law is assumed: 80 kPa reaches about 60 % of saturation, where current crosses into
/// the copper within `sqrt(5 mS / g)` = 2.4 mm of an indenter's edge.
pub fn healing_square() -> SandwichOptions {
    let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: 6e-3, height_m: 6e-3, angle_rad: 0.0 };
    SandwichOptions {
        layer: ElectrodedLayer {
            outline: Outline::Rectangle { width_m: 0.1, height_m: 0.1 },
            electrodes: pad.ring(5, 5, [23.5e-3; 2], Direction::CounterClockwise),
            contact_impedances_ohm_m2: vec![5e-4],
            protocol: healing_protocol(),
            conductance: Default::default(),
            element_size_m: 1.7e-3,
            electrode_element_size_m: 1.0e-3,
        },
        sheet_s: 0.1 / (2010.0 * 0.01 * 0.001) * 1e-3,
        shortcut_s: 35e-6 * 5.8e7,
        cover: Cover { smoothing_m: 1.5e-3 },
        contact: ContactLaw { threshold_pa: 3e3, reference_pa: 60e3, exponent: 1.5, saturation_s_per_m2: 1500.0 },
        memory: None,
        healing: Some(healing_law()),
    }
}

/// Healing at 90 C for 2 h. The intact bar of 100 mm goes from 2.01 to 1.92 kohm, the cut bar from 2.07 to 2.15 kohm.
/// Assumed: 90 kJ/mol, the rise at the end of the heating, 12 h of relaxation, and the reach of the heat.
pub fn healing_law() -> HealingLaw {
    HealingLaw {
        temperature_c: 90.0,
        duration_s: 7200.0,
        room_c: 25.0,
        activation_k: 90e3 / 8.314,
        peak_rise: 0.3,
        lasting_rise: LASTING_RISE,
        relaxation_s: 12.0 * 3600.0,
        scar_m: 0.1 * (2150.0 * (1.0 + LASTING_RISE) / 2070.0 - 1.0),
        pad_rim_m: 4e-3,
    }
}

/// The published heat pad: 90 C for two hours.
pub fn heating(centre_m: [f64; 2], radius_m: f64) -> Heating {
    Heating { centre_m, radius_m, temperature_c: 90.0, duration_s: 7200.0 }
}

/// Noise fitted to 22.7 dB at 0.4 mV and 67.0 dB at 87.9 mV; the board's 14 bits at an assumed gain of 8.
pub fn healing_instrument() -> InstrumentOptions {
    InstrumentOptions {
        noise: Noise { floor_v: 2.898e-5, proportional: 2.972e-4 },
        converter: Some(Converter { bits: 14, range_v: 1.0, gain: 8.0 }),
        ..InstrumentOptions::ideal()
    }
}

pub fn healing_twin_options() -> TwinOptions {
    TwinOptions { instrument: healing_instrument(), ..TwinOptions::default() }
}

pub fn healing_twin() -> Result<Twin<Sandwich>, TwinError> {
    Twin::of(Sandwich::new(healing_square())?, &healing_twin_options())
}
