//! The engine and a host, on a simulated board whose skin is a ring of resistors: every command, compared with closed
//! forms.

mod bench;

use bench::{Analog, Bench, Pause, Shared, Spi, Wires, chips};
use dermis_device::Status;
use dermis_device::instruments::wire::{Order, WireHost};
use dermis_firmware::mux64::{Mux64, STEP_A, Selection};
use dermis_firmware::{Engine, Named, STATE_BUDGET};
use dermis_wire::NO_ELECTRODE;

const ELECTRODES: u8 = 16;
/// Resistance between neighbours, ohms.
const RING_OHM: f64 = 1000.0;
/// Resistance of each contact, ohms.
const CONTACT_OHM: f64 = 150.0;
/// Resistance of the multiplexer's ground switch, ohms.
const SWITCH_OHM: f64 = 400.0;
/// Current at fifteen steps of the source.
const CURRENT_A: f64 = 39e-6;

/// A ring of equal resistors with an electrode at each node, one of which may be open.
struct Ring {
    open: Option<u8>,
}

/// Potential of node `at` relative to the mean of all nodes, for 1 A into `source` and out of `sink`. Between two
/// nodes d apart there are d (n - d) / n resistors, and the potential in a ring is half the difference of two such
/// values.
fn ring_ohm(at: u8, source: u8, sink: u8) -> f64 {
    let n = f64::from(ELECTRODES);
    let between = |a: u8, b: u8| {
        let d = f64::from(a.abs_diff(b));
        RING_OHM * d * (n - d) / n
    };
    0.5 * (between(at, sink) - between(at, source))
}

impl Analog for Ring {
    fn outputs_v(&mut self, Selection { steps, lines }: Selection) -> [f64; 2] {
        let [source, sink, positive, negative] = lines;
        let asked_a = f64::from(steps) * f64::from(STEP_A);
        let there = |electrode: u8| electrode < ELECTRODES;
        let is_open = |electrode: u8| self.open == Some(electrode);
        let flows = there(source) && there(sink) && (source == sink || !is_open(source) && !is_open(sink));
        let current_a = if flows { asked_a } else { 0.0 };
        // Without a path for the current the source goes to its limit.
        let limit_v = if asked_a > 0.0 && !flows && there(source) { 3.3 } else { 0.0 };
        let contact_ohm = |electrode: u8| match electrode {
            _ if source == sink => 0.0,
            e if e == source => CONTACT_OHM,
            e if e == sink => -CONTACT_OHM,
            _ => 0.0,
        };
        let potential_v = |electrode: u8| {
            if !there(electrode) || is_open(electrode) && electrode != source {
                return 0.0;
            }
            if !flows {
                // An open sink raises the potential of the whole skin.
                return if is_open(source) && electrode != source { 0.0 } else { limit_v };
            }
            let ring_ohm = ring_ohm(electrode, source, sink) - ring_ohm(sink, source, sink);
            current_a * (ring_ohm + contact_ohm(electrode) - contact_ohm(sink) + SWITCH_OHM)
        };
        [potential_v(positive), potential_v(negative)]
    }
}

type Board = Mux64<Spi<Ring>, Wires<Ring>, Pause<Ring>>;

fn bench(setup: Vec<Order>, start: bool) -> Bench<Board, Ring> {
    let chips = chips(Ring { open: None });
    Bench::new(chips.clone(), board(&chips), setup, start)
}

fn board(chips: &Shared<Ring>) -> Board {
    Mux64::new(Spi(chips.clone()), Wires(chips.clone()), Pause(chips.clone()), ELECTRODES)
        .expect("the converter answers")
}

/// Readings of the adjacent protocol, volts: every pair of neighbours except those of the drive spans 1/n of a
/// resistor.
fn check_adjacent(values: &[f64], current_a: f64, tolerance_v: f64) {
    assert_eq!(values.len(), 16 * 13);
    // The potential falls from source to sink over the fifteen resistors of the longer path, and pairs run from sink
    // to source.
    let expected_v = -current_a * RING_OHM / 16.0;
    for (channel, value) in values.iter().enumerate() {
        assert!((value - expected_v).abs() <= tolerance_v, "channel {channel}: {value} V, expected {expected_v} V");
    }
}

#[test]
fn readings_agree_with_the_ring() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent".into()), Order::Gain(Some(5))], true);
    for n in 0..3 {
        let (frame, _) = bench.frame();
        assert_eq!((frame.sequence, frame.gain), (n, Some(5)));
        // Half a count of 7.8 uV.
        check_adjacent(&frame.values, CURRENT_A, 0.5 * 0.256 / 32_768.0 + 1e-9);
        assert!(frame.channel_times_ns.windows(2).all(|pair| pair[1] > pair[0]), "readings follow each other");
        let last_s = frame.channel_times_ns[207] as f64 * 1e-9;
        assert!((0.3..0.4).contains(&last_s), "207 readings at about 600 a second take {last_s} s");
    }
    let description = bench.control.description().expect("it said");
    assert_eq!((description.electrodes, description.channels, description.adc_bits), (16, 208, 16));
    assert_eq!(description.protocol, "adjacent");
    assert_eq!(description.protocols, ["adjacent-sink", "adjacent-ground", "adjacent"]);
    assert!((description.amplitude_a - 39e-6).abs() < 1e-10);
    // Sent again once the first frame has been timed.
    assert!((2.5..3.2).contains(&description.most_frames_per_s), "{}", description.most_frames_per_s);
    assert_eq!(bench.inbox.losses(), (0, 0));
}

#[test]
fn the_range_follows_the_readings_frame_by_frame() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent-ground".into())], true);
    let gains: Vec<(Option<u8>, bool)> = (0..6)
        .map(|_| {
            let (frame, _) = bench.frame();
            (frame.gain, frame.status.has(Status::GAIN_CHANGED))
        })
        .collect();
    // Most readings are 39 uA times 15/16 of 1 kohm, two contacts and the switch: 64 mV, in the finest range.
    let expected = [(1, false), (2, true), (3, true), (4, true), (5, true), (5, false)];
    assert_eq!(gains, expected.map(|(gain, changed)| (Some(gain), changed)));
}

#[test]
fn a_list_of_the_hosts_is_measured_in_its_order() {
    let list: Vec<[u8; 4]> = (0..151).map(|k| [k % 16, (k + 5) % 16, (k + 3) % 16, (k + 9) % 16]).collect();
    let mut bench = bench(vec![Order::Protocol(list.clone()), Order::Gain(Some(4))], true);
    let (frame, _) = bench.frame();
    assert_eq!(frame.values.len(), 151);
    for ([source, sink, positive, negative], value) in list.iter().zip(&frame.values) {
        let expected_v = CURRENT_A * (ring_ohm(*positive, *source, *sink) - ring_ohm(*negative, *source, *sink));
        assert!((value - expected_v).abs() < 0.51 * 0.512 / 32_768.0, "{value} V, expected {expected_v} V");
    }
    assert_eq!(bench.control.description().expect("it said").protocol, "listed");
}

#[test]
fn every_command_is_answered() {
    let mut bench = bench(Vec::new(), false);
    let call = |bench: &mut Bench<Board, Ring>, order: Order| bench.call(order);
    let reason = |result: Result<Vec<f32>, String>| result.expect_err("a refusal");
    assert!((call(&mut bench, Order::AmplitudeA(20e-6)).unwrap()[0] - 20.8e-6).abs() < 1e-10);
    assert!(reason(call(&mut bench, Order::AmplitudeA(1e-3))).contains("cannot take this"));
    assert!(reason(call(&mut bench, Order::FrequencyHz(1e3))).contains("does not have this command"));
    assert!(reason(call(&mut bench, Order::Gain(Some(6)))).contains("cannot take this"));
    assert_eq!(call(&mut bench, Order::Gain(Some(5))).unwrap(), []);
    assert!(reason(call(&mut bench, Order::ProtocolName("spiral".into()))).contains("cannot take this"));
    assert!(reason(call(&mut bench, Order::Protocol(vec![[0, 1, 2, 16]]))).contains("cannot take this"));
    assert!(reason(call(&mut bench, Order::Protocol(vec![[0, 1, 2, 3]; 4097]))).contains("cannot take this"));
    assert_eq!(call(&mut bench, Order::ProtocolName("adjacent".into())).unwrap(), []);

    assert_eq!(call(&mut bench, Order::SingleShot).unwrap(), []);
    let (frame, _) = bench.frame();
    assert!(frame.status.has(Status::SINGLE));
    check_adjacent(&frame.values, 20.8e-6, 0.51 * 0.256 / 32_768.0);
    assert!(!bench.firmware.is_scanning());

    let [offset_v, noise_v, mean_ohm, most_ohm] = call(&mut bench, Order::SelfTest).unwrap()[..] else { panic!() };
    assert_eq!((offset_v, noise_v), (0.0, 0.0), "this converter has neither");
    // A count of 7.8 uV is 0.2 ohm at 39 uA.
    assert!((mean_ohm - 400.0).abs() < 0.2 && (most_ohm - 400.0).abs() < 0.2, "{mean_ohm} {most_ohm} ohm");

    // Neighbours drive: 15/16 of a resistor lies between them. An electrode three further on sees 1 - 2/16 of that.
    let expected_ohm = CONTACT_OHM + ring_ohm(3, 3, 4) - ring_ohm(6, 3, 4);
    bench.chips.borrow_mut().analog.open = Some(9);
    let ohms = call(&mut bench, Order::ElectrodeImpedance).unwrap();
    assert_eq!(ohms.len(), 16);
    assert!(ohms[9].is_nan(), "{} ohm", ohms[9]);
    // In the wide range a count of 125 uV is 3.2 ohm.
    assert!((f64::from(ohms[3]) - expected_ohm).abs() < 1.7, "{} ohm, expected {expected_ohm}", ohms[3]);
    assert!(ohms.iter().enumerate().all(|(k, ohm)| k == 9 || ohm.is_finite()), "{ohms:?}");

    let set_hz = call(&mut bench, Order::FramesPerS(1.5)).unwrap()[0];
    assert!((set_hz - 1.5).abs() < 1e-6);
    bench.chips.borrow_mut().analog.open = None;
    call(&mut bench, Order::Start).unwrap();
    assert!(reason(call(&mut bench, Order::SelfTest)).contains("busy"));
    assert!(reason(call(&mut bench, Order::Protocol(vec![[0, 1, 2, 3]]))).contains("busy"));
    let began_s = [bench.frame(), bench.frame()].map(|(frame, _)| frame.device_time_ns.expect("a clock") as f64 * 1e-9);
    let period_s = began_s[1] - began_s[0];
    assert!((period_s - 1.0 / 1.5).abs() < 0.001, "{period_s} s between frames");
    call(&mut bench, Order::Stop).unwrap();
    assert_eq!(bench.chips.borrow().selection.steps, 0, "the current is off");
    assert_eq!(bench.inbox.losses(), (0, 0));
}

#[test]
fn a_setting_during_a_frame_restarts_it_and_loses_none() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent".into()), Order::Gain(Some(5))], true);
    bench.frame();
    // Beyond the first part of the frame, which has 128 readings.
    (0..2000).for_each(|_| bench.step());
    bench.call(Order::AmplitudeA(10.4e-6)).unwrap();
    let (frame, _) = bench.frame();
    check_adjacent(&frame.values, 10.4e-6, 0.51 * 0.256 / 32_768.0);
    assert_eq!((frame.sequence, bench.inbox.losses()), (1, (0, 0)));
}

#[test]
fn a_board_that_went_on_measuring_is_met_again_as_it_was_set() {
    let setup = vec![Order::ProtocolName("adjacent".into()), Order::AmplitudeA(20.8e-6), Order::Gain(Some(5))];
    let mut bench = bench(setup.clone(), true);
    bench.frame();
    // More than half a frame passes with nobody listening, then the same host comes back.
    (0..5000).for_each(|_| bench.step());
    let before = bench.frames.try_iter().count() as u64;
    let heard = bench.chips.borrow().selections;
    bench.reconnect(None);
    let (frame, _) = bench.frame();
    assert_eq!((frame.sequence, bench.inbox.losses()), (1 + before, (0, 0)), "nothing was stopped for it");
    assert!(bench.chips.borrow().selections - heard <= 2 * 208);
    // Another host with other requirements stops and reconfigures it.
    let other = vec![Order::Protocol(vec![[0, 8, 4, 12]; 9]), Order::AmplitudeA(10.4e-6)];
    bench.reconnect(Some(WireHost::with_control(other, true)));
    let (frame, _) = bench.frame();
    assert_eq!(frame.values.len(), 9);
    assert!((bench.control.description().expect("it said").amplitude_a - 10.4e-6).abs() < 1e-10);
}

#[test]
fn an_open_electrode_shows_as_the_sources_limit() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent-ground".into()), Order::Gain(Some(1))], true);
    assert!(!bench.frame().0.status.has(Status::COMPLIANCE));
    bench.chips.borrow_mut().analog.open = Some(4);
    bench.frame();
    assert!(bench.frame().0.status.has(Status::COMPLIANCE));
}

#[test]
fn a_converter_that_falls_silent_is_marked_and_the_board_still_speaks() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent".into()), Order::Gain(Some(5))], true);
    bench.frame();
    bench.chips.borrow_mut().converter_answers = false;
    bench.frame();
    let (frame, _) = bench.frame();
    assert!(frame.status.has(Status::SATURATED));
    assert!(frame.values.iter().all(|value| (value + 0.256).abs() < 1e-6), "all at the limit");
    bench.chips.borrow_mut().converter_answers = true;
    bench.frame();
    let (frame, _) = bench.frame();
    check_adjacent(&frame.values, CURRENT_A, 0.51 * 0.256 / 32_768.0);
    assert_eq!(bench.inbox.losses(), (0, 0));
}

#[test]
fn noise_on_the_line_costs_no_frame() {
    let mut bench = bench(vec![Order::ProtocolName("adjacent".into())], true);
    bench.frame();
    let mut state = 1u32;
    for _ in 0..3000 {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        bench.chips.borrow_mut().to_board.push_back((state >> 24) as u8);
        bench.step();
    }
    bench.frame();
    bench.frame();
    assert_eq!(bench.inbox.losses(), (0, 0));
}

#[test]
fn lists_from_a_rule_match_their_names() {
    let list = |named: Named, electrodes: u8| -> Vec<[u8; 4]> {
        (0..named.len(electrodes)).map(|index| named.measurement(electrodes, index)).collect()
    };
    let sink = list(Named::AdjacentSink, 64);
    assert_eq!((sink.len(), sink[1], sink[4095]), (4096, [0, 1, 1, 1], [63, 0, 63, 0]));
    assert_eq!(list(Named::AdjacentGround, 64)[64], [1, 2, 0, NO_ELECTRODE]);
    let adjacent = list(Named::Adjacent, 16);
    assert_eq!(
        (adjacent.len(), adjacent[0], adjacent[12], adjacent[13]),
        (208, [0, 1, 2, 3], [0, 1, 14, 15], [1, 2, 3, 4])
    );
    for [source, sink, positive, negative] in adjacent {
        assert!([positive, negative].iter().all(|electrode| ![source, sink].contains(electrode)));
    }
    let coils: Vec<[u8; 2]> = list(Named::HigherCoils, 8).iter().map(|m| [m[0], m[2]]).collect();
    let expected: Vec<[u8; 2]> = (0..8).flat_map(|m| (m + 1..8).map(move |n| [m, n])).collect();
    assert_eq!(coils, expected);
    assert_eq!((list(Named::HigherCoils, 16).len(), list(Named::Adjacent, 2).len()), (120, 0));
}

/// Of 32 KiB: a list of 4,096 measurements and the engine; the rest is for stack, buses and the line.
#[test]
fn the_engine_fits_into_its_budget() {
    let list_bytes = size_of::<[[u8; 4]; 4096]>();
    let bytes = size_of::<Engine<'static, Board, (), ()>>();
    println!("engine with board: {bytes} bytes, list: {list_bytes} bytes");
    assert!(bytes <= STATE_BUDGET + 64, "{bytes} bytes with the board");
    assert!(list_bytes + bytes + 13 * 1024 < 32 * 1024, "13 KiB are left for all else");
}
