//! Compares the chain and its faults with closed forms.

use super::*;
use dermis_tomo::eit::{Drive, Driven, Measure, Order, ProtocolSpec, Reference};

const CONVERTER: Converter = Converter { bits: 14, range_v: 1.0, gain: 8.0 };
const NOISE: Noise = Noise { floor_v: 2.9e-5, proportional: 3e-4 };

fn noisy() -> InstrumentOptions {
    InstrumentOptions { noise: NOISE, converter: Some(CONVERTER), ..InstrumentOptions::ideal() }
}

fn read(options: InstrumentOptions, voltages: &[f64]) -> Vec<f64> {
    let mut out = voltages.to_vec();
    Instrument::new(options, out.len(), 3).unwrap().read(0.0, &mut out);
    out
}

fn protocol(measure: Measure) -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 8,
        drive: Drive::Adjacent,
        measure,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    })
    .unwrap()
}

#[test]
fn currents_come_in_steps() {
    let drive = DriveSteps { wanted_a: 10e-6, step_a: 2.6e-6, most_a: 40e-6 };
    // 10 / 2.6 = 3.85: four steps.
    assert!((drive.actual_a() - 10.4e-6).abs() < 1e-18);
    // The maximum below 40 uA is 15 steps.
    assert!((DriveSteps { wanted_a: 90e-6, ..drive }.actual_a() - 39e-6).abs() < 1e-18);
    let options = InstrumentOptions { drive: Some(drive), ..InstrumentOptions::ideal() };
    assert!((read(options, &[1.0])[0] - 1.04).abs() < 1e-12);
}

#[test]
fn multiplexer_divides_couples_and_remembers() {
    let mux = Multiplexer {
        on_resistance_ohm: 400.0,
        input_resistance_ohm: 3600.0,
        input_capacitance_f: 1e-9,
        crosstalk: 0.1,
    };
    // 1 us is 2.5 time constants of 0.4 us.
    let timing = Timing { settling_s: 1e-6, ..Timing::default() };
    assert!((mux.residue(1e-6) - (-2.5_f64).exp()).abs() < 1e-15);
    let options = InstrumentOptions { multiplexer: Some(mux), timing: Some(timing), ..InstrumentOptions::ideal() };
    let out = read(options, &[0.0, 1.0, 0.0]);
    let r = (-2.5_f64).exp();
    // After coupling: 0.09, 0.9 (1 - 0.2) = 0.72, 0.09; each retains r of the previous one.
    let first = 0.09 * (1.0 - r);
    let second = 0.72 + r * (first - 0.72);
    let third = 0.09 + r * (second - 0.09);
    for (got, expected) in out.iter().zip([first, second, third]) {
        assert!((got - expected).abs() < 1e-14, "{out:?}");
    }
}

#[test]
fn small_voltages_take_finer_ranges() {
    let converter = Converter { bits: 16, range_v: 4.096, gain: 1.0 };
    let ranges = GainRanges { factor: 2.0, count: 5 };
    let options =
        InstrumentOptions { converter: Some(converter), gain_ranges: Some(ranges), ..InstrumentOptions::ideal() };
    // Steps of an ADS1115: 125 uV at 4.096 V, 7.8125 uV at 0.256 V.
    assert_eq!(read(options, &[3.00005, 0.1])[0], 3.0);
    let fine = read(options, &[0.100_01])[0] / 7.8125e-6;
    assert!((fine - 12801.0).abs() < 1e-9, "{fine}");
    assert_eq!(ranges.gain(0.3, 4.096), 8.0);
    let magnitude = InstrumentOptions { reading: Reading::Magnitude, ..InstrumentOptions::ideal() };
    assert_eq!(read(magnitude, &[-0.2, 0.1]), [0.2, 0.1]);
}

#[test]
fn complex_readings_turn_by_the_phase_error_and_each_part_has_its_noise() {
    let ideal = InstrumentOptions { reading: Reading::Complex, phase_error_rad: 0.3, ..InstrumentOptions::ideal() };
    let mut instrument = Instrument::new(ideal, 2, 1).unwrap();
    let mut frame = [0.5, -0.2];
    instrument.read(0.1, &mut frame);
    for (k, voltage) in [0.5_f64, -0.2].into_iter().enumerate() {
        let (real, imaginary): (f64, f64) = (frame[k], instrument.imaginary_v()[k]);
        assert!(
            (real.hypot(imaginary) - voltage.abs()).abs() < 1e-15 && (imaginary / real - 0.3_f64.tan()).abs() < 1e-14
        );
    }
    let noise = Noise { floor_v: 1e-3, proportional: 0.0 };
    let mut instrument = Instrument::new(InstrumentOptions { noise, ..ideal }, 4000, 2).unwrap();
    let mut frame = vec![0.5; 4000];
    instrument.read(0.1, &mut frame);
    let parts = [(&frame[..], 0.3_f64.cos()), (instrument.imaginary_v(), 0.3_f64.sin())];
    for (values, share) in parts {
        let variance = values.iter().map(|v| (v - 0.5 * share).powi(2)).sum::<f64>() / 4000.0;
        // With 4,000 samples the deviation is within 5 % (4.5 standard errors).
        assert!((variance.sqrt() / 1e-3 - 1.0).abs() < 0.05, "{variance:e}");
    }
    // A copy includes both parts, and a stuck channel has no quadrature.
    let faults = vec![Fault::StuckChannel { channel: 1, value_v: 7.0 }, Fault::DuplicatedFrames { probability: 0.5 }];
    instrument.set_faults(faults).unwrap();
    let mut last = (Vec::new(), Vec::new());
    for _ in 0..20 {
        frame.fill(0.5);
        instrument.read(0.1, &mut frame);
        assert_eq!((frame[1], instrument.imaginary_v()[1]), (7.0, 0.0));
        let now = (frame.clone(), instrument.imaginary_v().to_vec());
        assert_eq!(instrument.frame_fate() == FrameFate::Duplicated, now == last);
        last = now;
    }
    assert_eq!(read(InstrumentOptions { reading: Reading::Signed, ..ideal }, &[1.0])[0], 0.3_f64.cos());
    assert_eq!(read(InstrumentOptions { reading: Reading::Magnitude, ..ideal }, &[-1.0])[0], 1.0);
    assert!(Instrument::new(InstrumentOptions { phase_error_rad: 2.0, ..ideal }, 1, 0).is_err());
}

#[test]
fn mains_is_sampled_at_each_channels_time_and_warmth_scales() {
    let mains = Mains { amplitude_v: 2.0, frequency_hz: 50.0, phase_rad: 0.0 };
    let timing = Timing { settling_s: 1e-3, conversion_s: 4e-3, frame_overhead_s: 0.01 };
    let options = InstrumentOptions { mains: Some(mains), timing: Some(timing), ..InstrumentOptions::ideal() };
    let out = read(options, &[0.0; 4]);
    for (channel, value) in out.iter().enumerate() {
        // Midpoints of the conversions: 3, 8, 13, 18 ms; 0.1 pi per millisecond.
        let exact = 2.0 * (0.1 * std::f64::consts::PI * (3.0 + 5.0 * channel as f64)).sin();
        assert!((value - exact).abs() < 1e-12, "{out:?}");
    }
    let instrument = Instrument::new(options, 4, 0).unwrap();
    assert!((instrument.frame_period_s() - 0.03).abs() < 1e-15);
    assert!((instrument.channel_time_s(3) - 0.018).abs() < 1e-15);
    let temperature =
        Temperature { coefficient_per_k: 0.02, rise_k: 5.0, warm_up_s: 10.0, swing_k: 1.0, swing_period_s: 40.0 };
    let options = InstrumentOptions { temperature: Some(temperature), ..InstrumentOptions::ideal() };
    let mut instrument = Instrument::new(options, 1, 0).unwrap();
    let mut voltage = [1.0];
    instrument.read(10.0, &mut voltage);
    let exact = 1.0 + 0.02 * (5.0 * (1.0 - (-1.0_f64).exp()) + 1.0);
    assert!((voltage[0] - exact).abs() < 1e-14);
}

#[test]
fn noise_predicted_from_the_printed_formula_gives_its_figure() {
    let voltages: Vec<f64> = (0..208).map(|k| 1e-3 * 1.02_f64.powi(k) * if k % 3 == 0 { -1.0 } else { 1.0 }).collect();
    let floor_v = floor_for_ionic_snr_v(&voltages, 59.7, 100, 5e-7).unwrap();
    let tuned = InstrumentOptions { noise: Noise { floor_v, proportional: 5e-7 }, ..InstrumentOptions::ideal() };
    // Without a floor, the proportional noise at which an ideal frame reaches the figure.
    let unit = expected_ionic_snr_db(&voltages, f64::abs, 100);
    let noise = Noise { floor_v: 0.0, proportional: 10_f64.powf(-(59.7 - unit) / 10.0) };
    for options in [InstrumentOptions { noise, ..InstrumentOptions::ideal() }, tuned] {
        let mut instrument = Instrument::new(options, 208, 11).unwrap();
        let (mut sum, mut squares) = (vec![0.0; 208], vec![0.0; 208]);
        for _ in 0..100 {
            let mut frame = voltages.clone();
            instrument.read(1.0 / 16.0, &mut frame);
            for (channel, value) in frame.iter().enumerate() {
                let off = value - voltages[channel];
                sum[channel] += off;
                squares[channel] += off * off;
            }
        }
        let snr: f64 = (0..208)
            .map(|k| {
                let std = ((squares[k] - sum[k] * sum[k] / 100.0) / 99.0).sqrt();
                10.0 * ((voltages[k] + sum[k] / 100.0).abs() / std).log10()
            })
            .sum::<f64>()
            / 208.0;
        // One channel scatters by 10 / ln 10 / sqrt(2 * 99) = 0.31 dB, the mean of 208 channels by 0.021 dB.
        assert!((snr - 59.7).abs() < 0.09, "{snr}");
    }
    assert!(floor_for_ionic_snr_v(&voltages, 59.7, 100, 1e-5).is_none());
    assert!(floor_for_ionic_snr_v(&[0.0], 59.7, 100, 0.0).is_none());
}

#[test]
fn options_without_a_converter_come_back_from_toml() {
    let drift = Some(Drift { common_per_sqrt_s: 1e-4, channel_per_sqrt_s: 2e-5 });
    for options in [InstrumentOptions::ideal(), noisy(), InstrumentOptions { drift, ..noisy() }] {
        let text = toml::to_string(&options).unwrap();
        assert_eq!(toml::from_str::<InstrumentOptions>(&text).unwrap(), options, "{text}");
    }
    assert_eq!(toml::from_str::<InstrumentOptions>("").unwrap(), InstrumentOptions::ideal());
    let text = "converter = { bits = 12, range_v = 1.0, gain = 8.0 }";
    let bits = toml::from_str::<InstrumentOptions>(text).unwrap().converter;
    assert_eq!(bits, Some(Converter { bits: 12, ..CONVERTER }));
    assert!(toml::from_str::<InstrumentOptions>("converter = \"nothing\"").is_err());
    assert!(toml::from_str::<InstrumentOptions>("converter = { bit = 12, range_v = 1.0, gain = 8.0 }").is_err());
}

#[test]
fn an_open_electrode_floats_its_channels_and_stops_its_drives() {
    let protocol = protocol(Measure::Adjacent);
    let count = protocol.channel_count();
    let new = || Instrument::new(InstrumentOptions::ideal(), count, 5).unwrap();
    assert!(new().set_faults(vec![Fault::OpenElectrode { electrode: 0 }]).is_err());
    let mut instrument = new().with_protocol(&protocol).unwrap();
    instrument.set_faults(vec![Fault::OpenElectrode { electrode: 2 }]).unwrap();
    let mut frame = vec![0.5; count];
    instrument.read(0.1, &mut frame);
    for (measurement, value) in protocol.measurements().iter().zip(&frame) {
        let measured = protocol.patterns()[measurement.pattern as usize].touches(2);
        let driven = protocol.stimulations()[measurement.stimulation as usize].touches(2);
        match (measured, driven) {
            (true, _) => assert!(value.abs() <= 1.0 && *value != 0.5),
            (false, true) => assert_eq!(*value, 0.0),
            (false, false) => assert_eq!(*value, 0.5),
        }
    }
    instrument.set_faults(vec![]).unwrap();
    frame.fill(0.5);
    instrument.read(0.1, &mut frame);
    assert!(frame.iter().all(|value| *value == 0.5));
}

#[test]
fn a_short_ties_single_ended_channels() {
    let protocol = protocol(Measure::SingleEnded(Reference::Electrode(0)));
    let count = protocol.channel_count();
    let mut instrument =
        Instrument::new(InstrumentOptions::ideal(), count, 5).unwrap().with_protocol(&protocol).unwrap();
    instrument.set_faults(vec![Fault::ShortedPair { electrodes: [4, 5] }]).unwrap();
    let electrode = |channel: usize| {
        let pattern = protocol.measurements()[channel].pattern;
        protocol.patterns()[pattern as usize].entries().last().map_or(0, |entry| entry.0)
    };
    let mut frame: Vec<f64> = (0..count).map(|channel| f64::from(electrode(channel))).collect();
    instrument.read(0.1, &mut frame);
    let first = protocol.measurements().iter().enumerate().filter(|(_, m)| m.stimulation == 0);
    for (channel, _) in first {
        let expected = if [4, 5].contains(&electrode(channel)) { 4.5 } else { f64::from(electrode(channel)) };
        assert_eq!(frame[channel], expected);
    }
}

#[test]
fn frames_are_dropped_and_repeated_at_the_requested_rate() {
    let mut instrument = Instrument::new(InstrumentOptions::ideal(), 2, 8).unwrap();
    let faults = vec![
        Fault::StuckChannel { channel: 1, value_v: 7.0 },
        Fault::DroppedFrames { probability: 0.2 },
        Fault::DuplicatedFrames { probability: 0.1 },
    ];
    instrument.set_faults(faults).unwrap();
    let (mut dropped, mut doubled, mut last) = (0, 0, f64::NAN);
    for number in 0..4000 {
        let mut frame = [f64::from(number), 0.0];
        instrument.read(0.1, &mut frame);
        match instrument.frame_fate() {
            FrameFate::Delivered => last = frame[0],
            FrameFate::Dropped => dropped += 1,
            FrameFate::Duplicated => {
                doubled += 1;
                assert_eq!(frame[0], last);
            }
        }
        assert_eq!(frame[1], 7.0);
    }
    // Binomial: 800 +- 25 and 0.8 * 400 = 320 +- 17; four standard deviations.
    assert!((700..900).contains(&dropped) && (252..388).contains(&doubled), "{dropped} {doubled}");
    assert!(instrument.set_faults(vec![Fault::DroppedFrames { probability: 1.5 }]).is_err());
    assert!(instrument.set_faults(vec![Fault::StuckChannel { channel: 2, value_v: 0.0 }]).is_err());
}

#[test]
fn noise_is_the_same_with_and_without_frame_faults() {
    let mut sound = Instrument::new(noisy(), 3, 9).unwrap();
    let mut faulty = Instrument::new(noisy(), 3, 9).unwrap();
    faulty.set_faults(vec![Fault::StuckChannel { channel: 2, value_v: 0.0 }]).unwrap();
    for _ in 0..5 {
        let (mut a, mut b) = ([1e-3, 2e-3, 3e-3], [1e-3, 2e-3, 3e-3]);
        sound.read(0.1, &mut a);
        faulty.read(0.1, &mut b);
        assert_eq!(a[..2], b[..2]);
    }
}

#[test]
fn without_a_chain_readings_are_drift_noise_and_converter_to_the_bit() {
    let drift = Drift { common_per_sqrt_s: 1e-4, channel_per_sqrt_s: 1e-4 };
    let options = InstrumentOptions { drift: Some(drift), ..noisy() };
    let mut instrument = Instrument::new(options, 2, 4).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let (mut common, mut channel) = (0.0, [0.0; 2]);
    let root = 0.04_f64.sqrt();
    for _ in 0..20 {
        let mut expected = [0.0123, -0.0456];
        common += 1e-4 * root * normal(&mut random);
        for k in 0..2 {
            channel[k] += 1e-4 * root * normal(&mut random);
            expected[k] *= 1.0 + common + channel[k];
        }
        for value in &mut expected {
            *value += NOISE.deviation_v(*value) * normal(&mut random);
            *value = CONVERTER.read_v(*value);
        }
        let mut got = [0.0123, -0.0456];
        instrument.read(0.04, &mut got);
        assert_eq!(got.map(f64::to_bits), expected.map(f64::to_bits));
    }
}
