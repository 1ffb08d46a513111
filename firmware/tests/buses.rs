//! The boards' traffic on their buses, byte for byte, compared with the data sheets of the chips.

use dermis_firmware::board::{Board, Failure};
use dermis_firmware::magnitude::{AddressLines, Chain, Magnitude, Parts};
use dermis_firmware::mux64::{Mux64, Selection};
use dermis_wire::{NO_ELECTRODE, Status};
use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::digital::{Mock as Pin, State, Transaction as Level};
use embedded_hal_mock::eh1::i2c::{Mock as I2c, Transaction as Wires};
use embedded_hal_mock::eh1::spi::{Mock as Spi, Transaction as Words};

const ADC: u8 = 0x48;

/// From the power-on state of 2.048 V and 128 per second to 860 per second, then to 4.096 V: single conversions,
/// comparator off. The chip's driver starts a conversion with each setting, whose result is not read.
fn set_up() -> Vec<Wires> {
    vec![Wires::write(ADC, vec![0x01, 0x85, 0xe3]), Wires::write(ADC, vec![0x01, 0x83, 0xe3])]
}

fn spi(packets: &[&[u8]]) -> Spi<u8> {
    let transactions = packets
        .iter()
        .flat_map(|packet| [Words::transaction_start(), Words::write_vec(packet.to_vec()), Words::transaction_end()]);
    Spi::new(&transactions.collect::<Vec<_>>())
}

/// A conversion: check for idle, start, still busy, done, result.
fn conversion(config: [u8; 2], result: i16) -> Vec<Wires> {
    let [high, low] = config;
    let is_idle = |idle: bool| Wires::write_read(ADC, vec![0x01], vec![if idle { 0x80 } else { 0x00 } | high, low]);
    vec![
        is_idle(true),
        Wires::write(ADC, vec![0x01, 0x80 | high, low]),
        is_idle(false),
        is_idle(true),
        Wires::write_read(ADC, vec![0x00], result.to_be_bytes().to_vec()),
    ]
}

#[test]
fn a_measurement_is_a_selection_and_a_conversion() {
    let single_then_pair = [set_up(), conversion([0x43, 0xe3], 1234), conversion([0x03, 0xe3], -7)].concat();
    let mut i2c = I2c::new(&single_then_pair);
    // Fifteen current steps. Electrodes 62 and 63 drive, and 5 is read against ground, then against 63.
    let mut words = spi(&[&[15, 0x80 | 62, 0x80 | 63, 0x80 | 5, 0], &[15, 0x80 | 62, 0x80 | 63, 0x80 | 5, 0x80 | 63]]);
    let mut board = Mux64::new(words.clone(), i2c.clone(), NoopDelay::new(), 64).unwrap();
    for (measurement, counts) in [([62, 63, 5, NO_ELECTRODE], 1234), ([62, 63, 5, 63], -7)] {
        assert_eq!(board.measure(measurement), Err(nb::Error::WouldBlock), "started");
        assert_eq!(board.measure(measurement), Err(nb::Error::WouldBlock), "busy");
        let reading = board.measure(measurement).unwrap();
        assert_eq!((reading.counts, reading.status), (counts, Status::default()));
    }
    assert_eq!(board.scale_v(), 4.096 / 32_768.0);
    words.done();
    i2c.done();
}

#[test]
fn an_abandoned_conversion_is_not_mistaken_for_the_next() {
    // Both are single-ended, so the chip's driver alone couldn't distinguish their results.
    let mut first = conversion([0x43, 0xe3], 111);
    let second = conversion([0x43, 0xe3], 222);
    first.remove(2);
    let mut i2c = I2c::new(&[set_up(), first, second].concat());
    let mut words = spi(&[&[15, 0x80, 0x81, 0x82, 0], &[15, 0x80, 0x81, 0x83, 0]]);
    let mut board = Mux64::new(words.clone(), i2c.clone(), NoopDelay::new(), 64).unwrap();
    assert_eq!(board.measure([0, 1, 2, NO_ELECTRODE]), Err(nb::Error::WouldBlock));
    let next = [0, 1, 3, NO_ELECTRODE];
    assert_eq!(board.measure(next), Err(nb::Error::WouldBlock), "the other is thrown away, and this one started");
    assert_eq!(board.measure(next), Err(nb::Error::WouldBlock), "busy");
    assert_eq!(board.measure(next).unwrap().counts, 222);
    words.done();
    i2c.done();
}

#[test]
fn currents_are_whole_steps_within_the_sources_range() {
    let (mut i2c, mut words) = (I2c::new(&set_up()), spi(&[]));
    let mut board = Mux64::new(words.clone(), i2c.clone(), NoopDelay::new(), 64).unwrap();
    for (asked_a, steps) in [(0.0, 0.0), (1.2e-6, 0.0), (1.4e-6, 1.0), (20e-6, 8.0), (39e-6, 15.0), (40e-6, 15.0)] {
        let set_a = board.set_amplitude_a(asked_a).unwrap();
        assert!((set_a - steps * 2.6e-6).abs() < 1e-11, "{asked_a} A: {set_a} A");
    }
    for asked_a in [-1e-6, 41e-6, f32::NAN, f32::INFINITY] {
        assert_eq!(board.set_amplitude_a(asked_a), Err(Failure::BadArgument), "{asked_a} A");
    }
    words.done();
    i2c.done();
}

#[test]
fn a_selection_leaves_lines_open_that_have_no_electrode() {
    let selection = Selection { steps: 3, lines: [0, NO_ELECTRODE, 63, 1] };
    assert_eq!(selection.bytes(), [3, 0x80, 0x00, 0xbf, 0x81]);
}

#[test]
fn boards_with_too_many_or_too_few_electrodes_are_refused() {
    for electrodes in [0, 1, 65, 255] {
        let (mut words, mut i2c) = (spi(&[]), I2c::new(&[]));
        let board = Mux64::new(words.clone(), i2c.clone(), NoopDelay::new(), electrodes);
        assert_eq!(board.err(), Some(Failure::BadArgument), "{electrodes} electrodes");
        words.done();
        i2c.done();
    }
}

/// Levels of a decoder's four address lines for each coil in turn.
fn lines(coils: &[u8]) -> [Pin; 4] {
    [0, 1, 2, 3].map(|bit| {
        let levels = coils.iter().map(|coil| if coil >> bit & 1 == 1 { State::High } else { State::Low });
        Pin::new(&levels.map(Level::set).collect::<Vec<_>>())
    })
}

#[test]
fn the_magnitude_chain_sets_synthesiser_amplifiers_and_decoders() {
    // 20 kHz from a 25 MHz clock with 28 bits is 214748.36: word 214748 = 13 * 2^14 + 1756. Reset, write the word in
    // two halves, then run.
    let mut synthesiser = spi(&[&[0x01, 0x00], &[0x21, 0x00], &[0x46, 0xdc], &[0x40, 0x0d], &[0x20, 0x00]]);
    // Gain 1. Then 0.1 A, with 0.05 A at gain 1: gain 2.
    let mut sending = spi(&[&[0x40, 0], &[0x40, 1]]);
    let mut receiving = spi(&[&[0x40, 0]]);
    let wires = [set_up(), vec![Wires::write(ADC, vec![0x01, 0x85, 0xe3])], conversion([0x45, 0xe3], 20_000)].concat();
    let mut i2c = I2c::new(&wires);
    let (mut sender, mut receiver) = (lines(&[2]), lines(&[13]));
    let parts = Parts {
        synthesiser: synthesiser.clone(),
        sending: sending.clone(),
        receiving: receiving.clone(),
        i2c: i2c.clone(),
        sender: AddressLines(sender.clone()),
        receiver: AddressLines(receiver.clone()),
        delay: NoopDelay::new(),
    };
    let chain = Chain { coils: 16, clock_hz: 25e6, current_a: 0.05, settling_us: 1000 };
    let mut board = Magnitude::new(parts, chain).unwrap();
    assert!((board.frequency_hz() - 20e3).abs() < 0.1, "{} Hz", board.frequency_hz());
    assert_eq!(board.set_amplitude_a(0.1).unwrap(), 0.1);
    assert_eq!(board.set_frequency_hz(150e3), Err(Failure::BadArgument));
    let pair = [2, NO_ELECTRODE, 13, NO_ELECTRODE];
    assert_eq!(board.measure(pair), Err(nb::Error::WouldBlock));
    assert_eq!(board.measure(pair), Err(nb::Error::WouldBlock));
    assert_eq!(board.measure(pair).unwrap().counts, 20_000);
    // 20000 counts of 62.5 uV are the mean of a rectified sine: 2 / pi of its amplitude.
    let volts = 20_000.0 * f64::from(board.scale_v());
    assert!((volts - 1.25 * std::f64::consts::FRAC_PI_2).abs() < 1e-6, "{volts} V");
    [&mut synthesiser, &mut sending, &mut receiving].into_iter().for_each(Spi::done);
    sender.iter_mut().chain(&mut receiver).for_each(Pin::done);
    i2c.done();
}
