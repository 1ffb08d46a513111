//! Converts a skin's electronics to instrument options.

use dermis_skin::{Reads, Skin};

use crate::error::TwinError;
use crate::instrument::{
    Converter, Drift, DriveSteps, GainRanges, InstrumentOptions, Mains, Multiplexer, Noise, Reading, Timing,
};
use crate::twin::Frontend;

/// Largest voltage of an untouched frontend, volts.
///
/// # Errors
/// Fields that cannot be solved.
pub fn resting_voltage_v(frontend: &mut dyn Frontend) -> Result<f64, TwinError> {
    let mut voltages_v = vec![0.0; frontend.channel_count()];
    frontend.voltages(&[], 0.0, &mut voltages_v)?;
    Ok(voltages_v.iter().fold(0.0, |most: f64, v| most.max(v.abs())))
}

/// The instrument of a skin with this largest resting voltage.
pub fn instrument_options(skin: &Skin, largest_v: f64) -> InstrumentOptions {
    let numbers = skin.backend.electronics.numbers(skin.frontend.layer.kind(), largest_v);
    let [common_per_sqrt_s, channel_per_sqrt_s] = numbers.drift_per_sqrt_s;
    let drifts = common_per_sqrt_s > 0.0 || channel_per_sqrt_s > 0.0;
    InstrumentOptions {
        noise: Noise { floor_v: numbers.noise_v, proportional: numbers.noise_share },
        drift: drifts.then_some(Drift { common_per_sqrt_s, channel_per_sqrt_s }),
        converter: numbers.converter.map(|(bits, range_v)| Converter { bits, range_v, gain: 1.0 }),
        drive: numbers.current_steps_a.map(|[step_a, most_a]| DriveSteps {
            wanted_a: skin.backend.current_ma * 1e-3,
            step_a,
            most_a,
        }),
        multiplexer: numbers.multiplexer.map(|multiplexer| Multiplexer {
            on_resistance_ohm: multiplexer.on_resistance_ohm,
            input_resistance_ohm: multiplexer.input_resistance_ohm,
            input_capacitance_f: multiplexer.input_capacitance_f,
            crosstalk: multiplexer.crosstalk,
        }),
        gain_ranges: (numbers.gain_ranges > 1).then_some(GainRanges { factor: 2.0, count: numbers.gain_ranges }),
        mains: numbers.mains.map(|[amplitude_v, frequency_hz]| Mains { amplitude_v, frequency_hz, phase_rad: 0.0 }),
        temperature: None,
        timing: numbers.timing_s.map(|[settling_s, conversion_s]| Timing {
            settling_s,
            conversion_s,
            frame_overhead_s: 0.0,
        }),
        reading: match skin.backend.reads {
            Reads::Signed => Reading::Signed,
            Reads::Magnitude => Reading::Magnitude,
            Reads::Complex => Reading::Complex,
        },
        phase_error_rad: skin.twin.phase_error_deg.to_radians(),
    }
}
