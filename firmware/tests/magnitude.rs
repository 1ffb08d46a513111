//! The induction backend with sixteen coils: synthesiser, amplifiers, decoders and rectifier in order, and a host
//! that reads the coils' mutual inductances as magnitudes.

mod bench;

use std::cell::RefCell;
use std::convert::Infallible;
use std::f64::consts::{FRAC_2_PI, PI};
use std::rc::Rc;

use bench::{Analog, Bench, Pause, Wires, chips};
use dermis_device::instruments::wire::Order;
use dermis_firmware::magnitude::{AddressLines, Chain, GAINS, Magnitude, Parts};
use dermis_firmware::mux64::Selection;
use dermis_wire::Features;
use embedded_hal::digital::{ErrorType as PinErrorType, OutputPin};
use embedded_hal::spi::{ErrorType as SpiErrorType, Operation, SpiDevice};

const CLOCK_HZ: f64 = 25e6;
const CURRENT_A: f64 = 0.05;

/// Mutual inductance of two coils on a 4 x 4 grid with 75 mm pitch, henry, modelled as two magnetic dipoles side by
/// side: negative.
fn mutual_h(a: u8, b: u8) -> f64 {
    let place = |coil: u8| [f64::from(coil % 4) * 0.075, f64::from(coil / 4) * 0.075];
    let ([ax, ay], [bx, by]) = (place(a), place(b));
    // mu0 / (4 pi) N^2 A^2 / d^3 with 51 turns of 50 mm diameter.
    -1e-7 * (51.0 * PI * 0.025 * 0.025_f64).powi(2) / (ax - bx).hypot(ay - by).powi(3)
}

/// State of the chips in the chain.
#[derive(Default)]
struct State {
    /// Low and high half of the synthesiser's word as received, and whether it is held in reset.
    halves: [u16; 2],
    second: bool,
    held: bool,
    gains: [u8; 2],
    coils: [u8; 2],
}

#[derive(Clone, Default)]
struct Coils(Rc<RefCell<State>>);

impl Analog for Coils {
    /// The mean of the rectified sine after the receiving amplifier.
    fn outputs_v(&mut self, _: Selection) -> [f64; 2] {
        let state = self.0.borrow();
        let [sends, receives] = state.coils;
        if state.held || sends == receives {
            return [0.0; 2];
        }
        let word = f64::from(state.halves[0]) + f64::from(state.halves[1]) * 16_384.0;
        let omega = 2.0 * PI * word * CLOCK_HZ / f64::from(1 << 28);
        let [sending, receiving] = state.gains.map(|code| f64::from(GAINS[usize::from(code)]));
        [omega * mutual_h(sends, receives).abs() * CURRENT_A * sending * receiving * FRAC_2_PI, 0.0]
    }
}

/// A device on SPI: the synthesiser, or an amplifier.
struct Chip {
    coils: Coils,
    amplifier: Option<usize>,
}

impl SpiErrorType for Chip {
    type Error = Infallible;
}

impl SpiDevice for Chip {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
        let mut state = self.coils.0.borrow_mut();
        for operation in operations {
            let Operation::Write([high, low]) = operation else { panic!("two bytes are written") };
            let word = u16::from_be_bytes([*high, *low]);
            match (self.amplifier, word >> 14) {
                (Some(which), 1) => state.gains[which] = *low,
                (None, 0) => (state.held, state.second) = (word & 0x0100 != 0, false),
                (None, 1) => {
                    let half = usize::from(state.second);
                    state.halves[half] = word & 0x3fff;
                    state.second = !state.second;
                }
                other => panic!("{other:?} is no instruction"),
            }
        }
        Ok(())
    }
}

/// An address line of one of the decoders.
struct Line {
    coils: Coils,
    decoder: usize,
    bit: u8,
}

impl PinErrorType for Line {
    type Error = Infallible;
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.coils.0.borrow_mut().coils[self.decoder] &= !(1 << self.bit);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.coils.0.borrow_mut().coils[self.decoder] |= 1 << self.bit;
        Ok(())
    }
}

#[test]
fn the_host_hears_mutual_inductances_as_magnitudes() {
    let coils = Coils::default();
    let chips = chips(coils.clone());
    let chip = |amplifier: Option<usize>| Chip { coils: coils.clone(), amplifier };
    let decoder = |decoder: usize| AddressLines([0, 1, 2, 3].map(|bit| Line { coils: coils.clone(), decoder, bit }));
    let parts = Parts {
        synthesiser: chip(None),
        sending: chip(Some(0)),
        receiving: chip(Some(1)),
        i2c: Wires(chips.clone()),
        sender: decoder(0),
        receiver: decoder(1),
        delay: Pause(chips.clone()),
    };
    let chain = Chain { coils: 16, clock_hz: CLOCK_HZ as f32, current_a: CURRENT_A as f32, settling_us: 2000 };
    let board = Magnitude::new(parts, chain).expect("every chip answers");
    let setup = vec![Order::FrequencyHz(50e3), Order::AmplitudeA(0.4), Order::FramesPerS(1.0)];
    let mut bench = Bench::new(chips.clone(), board, setup, true);
    // Let the gain settle first.
    (0..6).for_each(|_| drop(bench.frame()));
    let (frame, took_s) = bench.frame();
    let description = bench.control.description().expect("it said");
    assert!(description.features.has(Features::MAGNITUDE));
    assert!((description.frequency_hz - 50e3).abs() < 0.1 && (description.amplitude_a - 0.4).abs() < 1e-6);
    // The paper's instrument with 16 coils: 120 readings per frame, one frame per second.
    assert!((took_s - 1.0).abs() < 0.01, "{took_s} s a frame");
    let pairs = (0..16u8).flat_map(|a| (a + 1..16).map(move |b| (a, b)));
    let largest_v = frame.values.iter().fold(0.0, |most: f64, value| most.max(*value));
    let count_v = 2.048 / 32_768.0 * std::f64::consts::FRAC_PI_2 / f64::from(GAINS[usize::from(frame.gain.unwrap())]);
    assert!(largest_v > 10_000.0 * count_v, "the gain uses the range: {largest_v} V in counts of {count_v} V");
    assert_eq!(frame.values.len(), 120);
    for ((a, b), value) in pairs.zip(&frame.values) {
        let expected_v = 2.0 * PI * f64::from(description.frequency_hz) * mutual_h(a, b).abs() * 0.4;
        assert!(
            (value - expected_v).abs() < 0.51 * count_v + 1e-6 * expected_v,
            "{a}-{b}: {value} V, not {expected_v} V"
        );
    }
    // With the synthesiser off there is no signal; twice the current gives twice the voltage.
    bench.call(Order::Stop).unwrap();
    assert!(coils.0.borrow().held, "the current is off");
    let [silent_v, present_v, ratio] = bench.call(Order::SelfTest).unwrap()[..] else { panic!("three numbers") };
    assert_eq!(silent_v, 0.0);
    let expected_v = 2.0 * PI * 50e3 * mutual_h(0, 1).abs() * 0.4;
    assert!(
        (f64::from(present_v) - expected_v).abs() < count_v && (ratio - 2.0).abs() < 1e-2,
        "{present_v} V, {ratio}"
    );
    assert!(bench.call(Order::ElectrodeImpedance).unwrap_err().contains("does not have this command"));
    assert!(bench.call(Order::Protocol(vec![[0, 1, 2, 3]])).is_err(), "coils have no sink");
}
