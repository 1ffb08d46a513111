//! The events that can happen to the running system, and their probabilities.

use dermis_lab::twin_commands::TwinCommand;
use dermis_twin::instrument::Fault;
use dermis_twin::physics::Cut;
use dermis_twin::{Heating, Treatment};
use proptest::prelude::*;
use serde_json::json;

/// An event.
#[derive(Debug, Clone)]
pub enum Step {
    /// Frames pass.
    Frames(u32),
    /// The same command is sent to the twin this many times.
    Command(TwinCommand, u32),
    /// The next frames are corrupted on the way; the number is the count of frames.
    Spoil(Spoilt, u32),
    Tare {
        force: bool,
    },
    Hyperparameter(f64),
    RecordStart,
    RecordStop,
    /// A page sends a message.
    Page(String),
    /// No frame arrives for this many milliseconds; the flag says if the source reports a problem.
    Silence(u32, bool),
    /// The process is told to end while it is stuck; here it keeps running.
    Signal,
}

/// Corruption of a frame on the way.
#[derive(Debug, Clone, Copy)]
pub enum Spoilt {
    /// Every reading has this value.
    All(f64),
    /// One in this many readings has this value.
    Some(usize, f64),
    /// Every reading is multiplied by this: another unit, a reversed sign, a slightly lower voltage.
    Scaled(f64),
    /// The instrument hangs: it repeats the previous frame under a new number.
    Frozen,
    /// Readings are missing, or there are too many.
    Length(usize),
    /// The frame is lost.
    Lost,
    /// The frame arrives twice.
    Twice,
    /// The device's clock jumps by this many seconds.
    Clock(i64),
    /// The host's wall clock jumps by this many seconds.
    WallClock(i64),
    /// The device restarts its numbering.
    Reset,
}

fn place() -> impl Strategy<Value = [f64; 2]> {
    // On the skin, off the skin, and not a place at all.
    let near = (-0.06..0.06, -0.06..0.06).prop_map(|(x, y)| [x, y]);
    prop_oneof![8 => near, 1 => Just([50.0, 0.0]), 1 => Just([f64::NAN, 0.0])]
}

fn command() -> impl Strategy<Value = TwinCommand> {
    let press = (0..3_u64, place(), prop_oneof![0.003..0.02, Just(0.0), Just(1e9)], -1e3..2e5).prop_map(
        |(pointer, position_m, radius_m, pressure_pa)| TwinCommand::Press {
            pointer,
            position_m,
            radius_m,
            pressure_pa,
        },
    );
    // Only a few lines, so that identical cuts, crossing cuts and cuts through pads all occur.
    let line = prop_oneof![
        Just([[0.0, 0.0], [0.02, 0.0]]),
        Just([[0.02, 0.0], [0.0, 0.0]]),
        Just([[0.01, -0.01], [0.01, 0.01]]),
        Just([[0.0, 0.0], [0.020001, 0.0]]),
        (place(), place()).prop_map(|(from, to)| [from, to]),
    ];
    let cut = line.prop_map(|[from, to]| Treatment::Cut(Cut::open(from, to)));
    let heat = (place(), 0.001..0.05, 20.0..160.0, 1.0..10_000.0).prop_map(
        |(centre_m, radius_m, temperature_c, duration_s)| {
            Treatment::Heat(Heating { centre_m, radius_m, temperature_c, duration_s })
        },
    );
    let treatment = prop_oneof![
        4 => cut,
        2 => heat,
        1 => Just(Treatment::Renew),
        1 => prop_oneof![Just(0.0), Just(3600.0), Just(1e6), Just(f64::NAN)].prop_map(Treatment::TimeLapse),
        1 => prop_oneof![Just(0.0), Just(0.01), Just(-0.01)].prop_map(Treatment::Warm),
    ];
    let fault = prop_oneof![
        (0..20_u32).prop_map(|electrode| Fault::OpenElectrode { electrode }),
        (0..20_u32, 0..20_u32).prop_map(|(a, b)| Fault::ShortedPair { electrodes: [a, b] }),
        (0..300_usize, -1.0..1.0).prop_map(|(channel, value_v)| Fault::StuckChannel { channel, value_v }),
        (0..300_usize, 0.0..0.1).prop_map(|(channel, deviation_v)| Fault::NoisyChannel { channel, deviation_v }),
        (0.0..1.2).prop_map(|probability| Fault::DroppedFrames { probability }),
        (0.0..1.0).prop_map(|probability| Fault::DuplicatedFrames { probability }),
    ];
    prop_oneof![
        5 => press,
        2 => (0..3_u64).prop_map(|pointer| TwinCommand::Release { pointer }),
        3 => treatment.prop_map(TwinCommand::Treat),
        2 => fault.prop_map(TwinCommand::Break),
        1 => Just(TwinCommand::Repair),
    ]
}

pub fn step() -> impl Strategy<Value = Step> {
    let number = prop_oneof![Just(f64::NAN), Just(f64::INFINITY), Just(0.0), Just(1e300), Just(-1e300)];
    let spoilt = prop_oneof![
        number.clone().prop_map(Spoilt::All),
        (1..9_usize, number).prop_map(|(every, value)| Spoilt::Some(every, value)),
        prop_oneof![Just(-1.0), Just(1e-3), Just(1e3), Just(1e12), -2.0..2.0].prop_map(Spoilt::Scaled),
        prop_oneof![Just(10.0), Just(-10.0), Just(2.5)].prop_map(Spoilt::All),
        Just(Spoilt::Frozen),
        (0..400_usize).prop_map(Spoilt::Length),
        Just(Spoilt::Lost),
        Just(Spoilt::Twice),
        (-100_000..100_000_i64).prop_map(Spoilt::Clock),
        (-100_000..100_000_i64).prop_map(Spoilt::WallClock),
        Just(Spoilt::Reset),
    ];
    prop_oneof![
        6 => (1..12_u32).prop_map(Step::Frames),
        6 => (command(), prop_oneof![4 => Just(1_u32), 1 => Just(400_u32)]).prop_map(|(c, n)| Step::Command(c, n)),
        4 => (spoilt, prop_oneof![3 => Just(1_u32), 1 => 2..15_u32]).prop_map(|(spoilt, n)| Step::Spoil(spoilt, n)),
        1 => any::<bool>().prop_map(|force| Step::Tare { force }),
        1 => prop_oneof![1e-6..1e3, Just(f64::NAN), Just(0.0), Just(1e300), Just(1e-300)].prop_map(Step::Hyperparameter),
        1 => Just(Step::RecordStart),
        1 => Just(Step::RecordStop),
        4 => page().prop_map(Step::Page),
        1 => (prop_oneof![0..900_u32, 1_100..100_000_u32], any::<bool>()).prop_map(|(ms, word)| Step::Silence(ms, word)),
        1 => Just(Step::Signal),
    ]
}

/// A message from a page: valid requests, requests with invalid numbers, and arbitrary text.
fn page() -> impl Strategy<Value = String> {
    let number = prop_oneof![
        4 => (-60.0..60.0).prop_map(|x: f64| json!(x)),
        1 => prop_oneof![Just(json!(1e300)), Just(json!(-1)), Just(json!(0)), Just(json!(null)), Just(json!("7"))],
    ];
    let press = prop::collection::vec(number.clone(), 4)
        .prop_map(|n| json!({"pointer_id": 3, "x_mm": n[0], "y_mm": n[1], "radius_mm": n[2], "pressure_kpa": n[3]}));
    let command = prop_oneof![
        any::<bool>().prop_map(|force| json!({"tare": {"force": force}})),
        Just(json!("record_start")),
        Just(json!("record_stop")),
        number.clone().prop_map(|value| json!({"hyperparameter": value})),
        press.clone().prop_map(|press| json!({"press": press})),
        press.prop_map(|press| json!({"move": press})),
        (2..5_u64).prop_map(|pointer| json!({"release": {"pointer_id": pointer}})),
        any::<bool>().prop_map(|wanted| json!({"demonstrate": wanted})),
        prop::collection::vec(0..300_u32, 0..70).prop_map(|channels| json!({"choose_channels": channels})),
        prop::collection::vec(number.clone(), 4)
            .prop_map(|n| { json!({"treat": {"cut": {"from_mm": [n[0], n[1]], "to_mm": [n[2], n[3]]}}}) }),
        prop::collection::vec(number.clone(), 5).prop_map(|n| {
            json!({"treat": {"heal": {"at_mm": [n[0], n[1]], "radius_mm": n[2], "temperature_c": n[3], "hours": n[4]}}})
        }),
        number.prop_map(|value| json!({"treat": {"time_lapse": value}})),
        Just(json!({"treat": "renew"})),
    ];
    let said = (prop_oneof![8 => Just(1), 1 => Just(2)], command)
        .prop_map(|(version, command)| json!({"v": version, "id": 1, "command": command}).to_string());
    prop_oneof![
        12 => said.clone(),
        1 => any::<u64>().prop_map(|sequence| json!({"v": 1, "ack": sequence}).to_string()),
        1 => (said, any::<prop::sample::Index>()).prop_map(|(said, end)| said[..end.index(said.len())].to_owned()),
        1 => ".*",
    ]
}
