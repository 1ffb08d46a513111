//! Commands for a served twin, one per line, in words or as JSON: press, release, break, repair, cut, heal.

use dermis_twin::instrument::Fault;
use serde::Deserialize;

use crate::twin_source::TwinCommand;
use dermis_skin::TwinAction;
use dermis_twin::PressRange;

/// The available commands, as help text.
pub const WORDS: &str = "\
press X_MM Y_MM FORCE_N [RADIUS_MM]     press there, or move the press there
release                                 let go
fault electrode N open                  electrode N, counted from 1, loses contact
fault electrodes N M shorted            a wire connects two electrodes
fault coil N dead                       coil N, counted from 1, has no field
fault channel N stuck MILLIVOLT         channel N, counted from 1, always reads this
fault channel N noisy MILLIVOLT         channel N gets extra noise of this sigma
fault frames lost SHARE                 this share of the frames (0 to 1) is lost
fault frames repeated SHARE             this share of the frames is sent twice
repair                                  remove all faults
cut X0_MM Y0_MM X1_MM Y1_MM             a blade cuts a self-healing sheet
heal X_MM Y_MM RADIUS_MM CELSIUS HOURS  heat a disc of it (90 C for 2 h heals)
time-lapse FACTOR                       healing runs faster by this factor
drift PERCENT                           the conductivity rises by this per minute
renew                                   replace the sheet by a new one
or as JSON: {\"press\": {\"x_mm\": 1, \"y_mm\": 2, \"force_n\": 3}},
{\"fault\": {\"electrode_open\": 3}}, \"repair\"";

/// A command, typed in words or as JSON.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum LineCommand {
    Press {
        x_mm: f64,
        y_mm: f64,
        force_n: f64,
        radius_mm: Option<f64>,
        /// Several pointers may press at once.
        #[serde(default)]
        pointer: u64,
    },
    Release {
        #[serde(default)]
        pointer: u64,
    },
    Fault(LineFault),
    Repair,
    Cut {
        x0_mm: f64,
        y0_mm: f64,
        x1_mm: f64,
        y1_mm: f64,
    },
    Heal {
        x_mm: f64,
        y_mm: f64,
        radius_mm: f64,
        temperature_c: f64,
        hours: f64,
    },
    TimeLapse(f64),
    DriftPercentPerMin(f64),
    Renew,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
enum LineFault {
    ElectrodeOpen(u32),
    ElectrodesShorted([u32; 2]),
    CoilDead(u32),
    ChannelStuck { channel: usize, value_mv: f64 },
    ChannelNoisy { channel: usize, noise_mv: f64 },
    FramesLost(f64),
    FramesRepeated(f64),
}

/// Parses a line into a command; `None` for an empty line.
///
/// Forces are spread evenly over the indenter, which has the skin's usual radius unless the line gives one. The twin
/// itself checks that its skin and instrument have what the command names.
///
/// # Errors
/// A message with the line and what was expected.
///
/// ```
/// use dermis_lab::serve::command_of;
/// use dermis_skin::Skin;
/// use dermis_lab::twin_source::{TwinCommand, TwinSource};
///
/// let (twin, _) = TwinSource::new(&Skin::open("healing-square")?)?;
/// let Ok(Some(command)) = command_of("press 10 -5 20", &twin.press_range()) else { panic!() };
/// let TwinCommand::Press { position_m, .. } = command else { panic!() };
/// assert_eq!(position_m, [0.01, -0.005]);
/// # Ok::<(), dermis_lab::Error>(())
/// ```
pub fn command_of(line: &str, press: &PressRange) -> Result<Option<TwinCommand>, String> {
    let line = line.trim();
    if line.is_empty() {
        return Ok(None);
    }
    let said = match line.starts_with(['{', '"']) {
        true => serde_json::from_str(line).map_err(|error| format!("'{line}': {error}"))?,
        false => in_words(line).ok_or_else(|| format!("'{line}': expected one of\n{WORDS}"))?,
    };
    command(said, press).map(Some).map_err(|expected| format!("'{line}': expected {expected}"))
}

fn in_words(line: &str) -> Option<LineCommand> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let number = |text: &str| text.parse::<f64>().ok();
    Some(match words[..] {
        ["press", x, y, force] => LineCommand::press(number(x)?, number(y)?, number(force)?, None),
        ["press", x, y, force, radius] => {
            LineCommand::press(number(x)?, number(y)?, number(force)?, Some(number(radius)?))
        }
        ["release"] => LineCommand::Release { pointer: 0 },
        ["fault", "electrode", n, "open"] => LineCommand::Fault(LineFault::ElectrodeOpen(n.parse().ok()?)),
        ["fault", "electrodes", n, m, "shorted"] => {
            LineCommand::Fault(LineFault::ElectrodesShorted([n.parse().ok()?, m.parse().ok()?]))
        }
        ["fault", "channel", n, "stuck", value] => {
            LineCommand::Fault(LineFault::ChannelStuck { channel: n.parse().ok()?, value_mv: number(value)? })
        }
        ["fault", "channel", n, "noisy", noise] => {
            LineCommand::Fault(LineFault::ChannelNoisy { channel: n.parse().ok()?, noise_mv: number(noise)? })
        }
        ["fault", "coil", n, "dead"] => LineCommand::Fault(LineFault::CoilDead(n.parse().ok()?)),
        ["fault", "frames", "lost", share] => LineCommand::Fault(LineFault::FramesLost(number(share)?)),
        ["fault", "frames", "repeated", share] => LineCommand::Fault(LineFault::FramesRepeated(number(share)?)),
        ["repair"] => LineCommand::Repair,
        ["cut", x0, y0, x1, y1] => {
            LineCommand::Cut { x0_mm: number(x0)?, y0_mm: number(y0)?, x1_mm: number(x1)?, y1_mm: number(y1)? }
        }
        ["heal", x, y, radius, celsius, hours] => LineCommand::Heal {
            x_mm: number(x)?,
            y_mm: number(y)?,
            radius_mm: number(radius)?,
            temperature_c: number(celsius)?,
            hours: number(hours)?,
        },
        ["time-lapse", factor] => LineCommand::TimeLapse(number(factor)?),
        ["drift", percent] => LineCommand::DriftPercentPerMin(number(percent)?),
        ["renew"] => LineCommand::Renew,
        _ => return None,
    })
}

impl LineCommand {
    fn press(x_mm: f64, y_mm: f64, force_n: f64, radius_mm: Option<f64>) -> Self {
        Self::Press { x_mm, y_mm, force_n, radius_mm, pointer: 0 }
    }
}

fn command(said: LineCommand, press: &PressRange) -> Result<TwinCommand, String> {
    Ok(match said {
        LineCommand::Press { x_mm, y_mm, force_n, radius_mm, pointer } => {
            let radius_m = radius_mm.map_or(press.initial_radius_m, |radius_mm| radius_mm * 1e-3);
            if !(radius_m > 0.0 && force_n >= 0.0 && [x_mm, y_mm, force_n, radius_m].iter().all(|v| v.is_finite())) {
                return Err("finite numbers, a radius above 0 and a force of 0 or more".to_owned());
            }
            let pressure_pa = force_n / (std::f64::consts::PI * radius_m * radius_m);
            TwinCommand::Press { pointer, position_m: [x_mm * 1e-3, y_mm * 1e-3], radius_m, pressure_pa }
        }
        LineCommand::Release { pointer } => TwinCommand::Release { pointer },
        LineCommand::Fault(fault) => TwinCommand::Break(broken(fault)?),
        LineCommand::Repair => TwinCommand::Repair,
        LineCommand::Cut { x0_mm, y0_mm, x1_mm, y1_mm } => {
            treatment(TwinAction::Cut { from_mm: [x0_mm, y0_mm], to_mm: [x1_mm, y1_mm] })?
        }
        LineCommand::Heal { x_mm, y_mm, radius_mm, temperature_c, hours } => {
            treatment(TwinAction::Heal { at_mm: [x_mm, y_mm], radius_mm, temperature_c, hours })?
        }
        LineCommand::TimeLapse(factor) => treatment(TwinAction::TimeLapse(factor))?,
        LineCommand::DriftPercentPerMin(percent) => treatment(TwinAction::DriftPercentPerMin(percent))?,
        LineCommand::Renew => treatment(TwinAction::Renew)?,
    })
}

fn treatment(action: TwinAction) -> Result<TwinCommand, String> {
    let treatment = dermis_twin::from_skin::treatment_of(action);
    treatment.check().map_err(|error| error.to_string())?;
    Ok(TwinCommand::Treat(treatment))
}

/// Converts a fault from user numbering, which starts at 1.
fn broken(fault: LineFault) -> Result<Fault, String> {
    let expected = || "electrodes and channels counted from 1".to_owned();
    let electrode = |n: u32| n.checked_sub(1).ok_or_else(expected);
    Ok(match fault {
        LineFault::ElectrodeOpen(n) => Fault::OpenElectrode { electrode: electrode(n)? },
        LineFault::ElectrodesShorted([n, m]) => Fault::ShortedPair { electrodes: [electrode(n)?, electrode(m)?] },
        LineFault::ChannelStuck { channel, value_mv } => {
            Fault::StuckChannel { channel: channel.checked_sub(1).ok_or_else(expected)?, value_v: value_mv * 1e-3 }
        }
        LineFault::ChannelNoisy { channel, noise_mv } => {
            Fault::NoisyChannel { channel: channel.checked_sub(1).ok_or_else(expected)?, deviation_v: noise_mv * 1e-3 }
        }
        LineFault::CoilDead(n) => Fault::DeadCoil { coil: electrode(n)? },
        LineFault::FramesLost(probability) => Fault::DroppedFrames { probability },
        LineFault::FramesRepeated(probability) => Fault::DuplicatedFrames { probability },
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const PRESS: PressRange = PressRange {
        radius_m: [1e-3, 1e-1],
        pressure_pa: [0.0, 1e6],
        initial_radius_m: 0.01,
        initial_pressure_pa: 1e3,
    };

    fn of(line: &str) -> TwinCommand {
        command_of(line, &PRESS).unwrap_or_else(|error| panic!("{error}")).expect("a command")
    }

    #[test]
    fn words_and_json_say_the_same() {
        for (words, json) in [
            ("press 1 -2.5 3", r#"{"press": {"x_mm": 1, "y_mm": -2.5, "force_n": 3}}"#),
            ("press 1 2 3 4", r#"{"press": {"x_mm": 1, "y_mm": 2, "force_n": 3, "radius_mm": 4, "pointer": 0}}"#),
            ("release", r#"{"release": {}}"#),
            ("fault electrode 3 open", r#"{"fault": {"electrode_open": 3}}"#),
            ("fault electrodes 3 4 shorted", r#"{"fault": {"electrodes_shorted": [3, 4]}}"#),
            ("fault channel 7 stuck -1.5", r#"{"fault": {"channel_stuck": {"channel": 7, "value_mv": -1.5}}}"#),
            ("fault frames lost 0.25", r#"{"fault": {"frames_lost": 0.25}}"#),
            ("fault channel 9 noisy 2.5", r#"{"fault": {"channel_noisy": {"channel": 9, "noise_mv": 2.5}}}"#),
            ("fault coil 3 dead", r#"{"fault": {"coil_dead": 3}}"#),
            ("fault frames repeated 0.5", r#"{"fault": {"frames_repeated": 0.5}}"#),
            ("repair", r#""repair""#),
            ("cut -10 0 10 5", r#"{"cut": {"x0_mm": -10, "y0_mm": 0, "x1_mm": 10, "y1_mm": 5}}"#),
            (
                "heal 1 2 25 90 2",
                r#"{"heal": {"x_mm": 1, "y_mm": 2, "radius_mm": 25, "temperature_c": 90, "hours": 2}}"#,
            ),
            ("time-lapse 3600", r#"{"time_lapse": 3600}"#),
            ("drift 0.2", r#"{"drift_percent_per_min": 0.2}"#),
            ("renew", r#""renew""#),
        ] {
            assert_eq!(of(words), of(json), "{words}");
        }
    }

    #[test]
    fn forces_are_pressures_over_the_indenter_and_people_count_from_one() {
        let TwinCommand::Press { radius_m, pressure_pa, position_m, .. } = of("press 10 20 3.14159265358979") else {
            panic!()
        };
        assert_eq!((radius_m, position_m), (0.01, [0.01, 0.02]));
        assert!((pressure_pa - 1e4).abs() < 1e-6, "{pressure_pa} Pa");
        assert_eq!(of("fault electrode 3 open"), TwinCommand::Break(Fault::OpenElectrode { electrode: 2 }));
    }

    #[test]
    fn meaningless_lines_are_answered_with_the_valid_ones() {
        assert_eq!(command_of("  ", &PRESS), Ok(None));
        for (line, expected) in [
            ("pres 1 2 3", "press X_MM Y_MM FORCE_N"),
            ("press 1 2", "press X_MM Y_MM FORCE_N"),
            ("press a 2 3", "press X_MM Y_MM FORCE_N"),
            ("press 1 2 -3", "a force of 0 or more"),
            ("press 1 2 3 0", "a radius above 0"),
            ("fault electrode 0 open", "counted from 1"),
            ("cut 1 2 1 2", "cut length"),
            ("heal 0 0 25 900 2", "temperature_c: 900"),
            (r#"{"press": {"x_mm": 1}}"#, "missing field"),
            (r#"{"push": {}}"#, "unknown variant"),
        ] {
            let message = command_of(line, &PRESS).unwrap_err();
            assert!(message.contains(expected) && message.contains(line), "{line}: {message}");
        }
    }
}
