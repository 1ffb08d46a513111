//! Instruments of the published skins, which their twins have by default. What a paper does not give is assumed, and said
//! so.

use super::snr::deviation_bias;
use super::{Converter, DriveSteps, GainRanges, InstrumentOptions, Multiplexer, Noise, Timing};

/// Paper I: average signal-to-noise ratio by its printed formula, dB, over this many frames of this many channels.
const IONIC_SNR_DB: f64 = 59.7;
const IONIC_FRAMES: usize = 100;
const IONIC_CHANNELS: f64 = 208.0;
const IONIC_FRAMES_PER_S: f64 = 16.0;

/// Paper P: step of the current source and its end, amperes; samples a second of the converter.
const PIEZO_STEP_A: f64 = 2.6e-6;
const PIEZO_MOST_A: f64 = 40e-6;
const PIEZO_SAMPLES_PER_S: f64 = 860.0;

impl InstrumentOptions {
    /// Paper I's: 16 frames of 208 channels a second, and noise in proportion to each voltage that has the paper's 59.7 dB
    /// on any skin if they are an amplitude ratio as usual, `20 log10(mean / deviation)`: 1.0e-3 of the reading, the
    /// harder of the two ways to read the paper; [`InstrumentOptions::ionic_as_printed`] is the other. A converter, of which
    /// the paper says nothing, is left out.
    pub fn ionic() -> Self {
        let channel_s = 1.0 / (IONIC_FRAMES_PER_S * IONIC_CHANNELS);
        Self {
            noise: Noise { floor_v: 0.0, proportional: 10_f64.powf(-IONIC_SNR_DB / 20.0) },
            // A half for settling is assumed; the sum is the paper's.
            timing: Some(Timing { settling_s: 0.5 * channel_s, conversion_s: 0.5 * channel_s, frame_overhead_s: 0.0 }),
            ..Self::ideal()
        }
    }

    /// The same with the noise at which the paper's eq. 1 as printed, `10 log10(mean / deviation)`
    /// ([`super::expected_ionic_snr_db`]), gives 59.7 dB over 100 frames: 1.1e-6 of the reading, better than converters of
    /// 16 bits can do. For noise of a floor see [`super::floor_for_ionic_snr_v`].
    pub fn ionic_as_printed() -> Self {
        let logarithm = IONIC_SNR_DB / 10.0 * std::f64::consts::LN_10 + deviation_bias(IONIC_FRAMES);
        Self { noise: Noise { floor_v: 0.0, proportional: (-logarithm).exp() }, ..Self::ionic() }
    }

    /// Paper P's: current in steps of 2.6 uA up to 40 uA, a multiplexer of 400 ohm, a 16-bit converter of 860 samples a
    /// second (ADS1115 class: +-4.096 V in five ranges by 2 assumed), so that 4096 channels take 4.8 s. Assumed: 39 uA
    /// asked for, noise of 20 uV (about a step of the converter in the range of the largest voltages) and 80 dB of the
    /// voltage, inputs of 10 megohm and 20 pF, 10 us of settling.
    pub fn piezo() -> Self {
        let (wanted_a, step_a, most_a) = (15.0 * PIEZO_STEP_A, PIEZO_STEP_A, PIEZO_MOST_A);
        let (on_resistance_ohm, input_resistance_ohm, input_capacitance_f) = (400.0, 1e7, 20e-12);
        Self {
            noise: Noise { floor_v: 20e-6, proportional: 1e-4 },
            converter: Some(Converter { bits: 16, range_v: 4.096, gain: 1.0 }),
            drive: Some(DriveSteps { wanted_a, step_a, most_a }),
            multiplexer: Some(Multiplexer {
                on_resistance_ohm,
                input_resistance_ohm,
                input_capacitance_f,
                crosstalk: 0.0,
            }),
            gain_ranges: Some(GainRanges { factor: 2.0, count: 5 }),
            timing: Some(Timing { settling_s: 1e-5, conversion_s: 1.0 / PIEZO_SAMPLES_PER_S, frame_overhead_s: 0.0 }),
            ..Self::ideal()
        }
    }

    /// Paper H's: noise through the two ends that it gives (22.7 dB at 0.4 mV, 67.0 dB at 87.9 mV by its eq. 5,
    /// [`super::snr_db`]) and the 14 bits of its board at an assumed gain of 8. Its average of 56.8 dB was not fitted. The
    /// default of this type.
    pub fn healing() -> Self {
        Self { noise: Noise::default(), converter: Some(Converter::default()), ..Self::ideal() }
    }
}
