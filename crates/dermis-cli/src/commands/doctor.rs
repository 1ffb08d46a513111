//! `dermis doctor`: explains in plain words what is wrong with an instrument or its skin, and what to do.

use std::io::Write;
use std::time::Duration;

use dermis_device::instruments::wire::Order;
use dermis_device::stream::{StreamOptions, StreamSource};
use dermis_device::{
    DeviceError, Instrument, Pacing, Playback, Repeat, Source, SourceSelector, open_sciospec, open_stream_greeted,
    open_wire,
};
use dermis_lab::doctor::{Answer, Check, FEWEST_FRAMES, examine};
use dermis_lab::measured_list::sciospec_setup_of;
use dermis_lab::twin_source::TwinSource;
use dermis_skin::{DEFAULT_NAME, Skin};

use super::reading::ReadArguments;
use super::skin_word::{SkinWord, skin};
use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis doctor
  dermis doctor healing-square --source twin --json

Do not touch the skin while this runs. Exit code 1 when something is wrong.";

/// Arguments of `dermis doctor`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    #[command(flatten)]
    skin: SkinWord,
    /// The instrument, as for `dermis run`: twin, tcp:HOST:PORT, serial:PORT and so on, or a file of frames.
    #[arg(long, default_value = "twin", value_name = "SOURCE")]
    source: String,
    #[command(flatten)]
    read: ReadArguments,
    /// Number of frames to examine.
    #[arg(long, default_value_t = 128, value_name = "N")]
    frames: u64,
    /// How long to wait for a frame.
    #[arg(long, default_value_t = 5.0, value_name = "SECONDS")]
    wait_s: f64,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

impl Arguments {
    /// Runs the examination and prints the result.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.frames < FEWEST_FRAMES {
            let text = format!("--frames {}: expected at least {FEWEST_FRAMES}", self.frames);
            return Err(UsageError(text).into());
        }
        let patience = Duration::try_from_secs_f64(self.wait_s)
            .map_err(|_| UsageError(format!("--wait-s {}: expected a number of seconds", self.wait_s)))?;
        let skin = skin(&self.skin.or(DEFAULT_NAME)?)?;
        let mut checks = Vec::new();
        if let Some((mut source, contacts_ohm)) = self.open(&skin, patience, &mut checks)? {
            checks.extend(examine(skin, source.as_mut(), self.frames, patience, contacts_ohm.as_deref())?);
        }
        self.print(&checks, out)?;
        let bad = checks.iter().any(|check| check.answer == Answer::Bad);
        Ok(if bad { Outcome::ProblemsFound } else { Outcome::Done })
    }

    /// Opens the source and, if possible, measures the contact impedances of its electrodes. `None` if opening
    /// failed, which is then one of the checks.
    fn open(&self, skin: &Skin, patience: Duration, checks: &mut Vec<Check>) -> anyhow::Result<Option<Examined>> {
        if self.source == "twin" {
            let (source, _) = TwinSource::new(skin)?;
            checks.push(Check::good("connection", source.name()));
            return Ok(Some((Box::new(source.unpaced()), None)));
        }
        match self.source.parse::<SourceSelector>().map_err(dermis_lab::Error::from)? {
            SourceSelector::Twin { .. } => Err(UsageError(format!(
                "--source {}: expected the name of the twin as SKIN, the first word",
                self.source
            ))
            .into()),
            SourceSelector::File(spec) => {
                let table = dermis_record::read_frames_of(skin, &spec, self.read.options())?;
                let playback =
                    Playback::new(table, Pacing::Immediate, Repeat::Once).map_err(dermis_lab::Error::from)?;
                checks.push(Check::good("connection", playback.name()));
                Ok(Some((Box::new(playback), None)))
            }
            live => {
                let options = StreamOptions { patience, ..StreamOptions::default() };
                match open_live(&live, options, skin)? {
                    Ok((source, contacts_ohm)) => {
                        let identity = source.identity().unwrap_or_else(|| "it does not identify itself".into());
                        checks.push(Check::good("connection", self.source.as_str()));
                        checks.push(Check::good("handshake", identity));
                        Ok(Some((Box::new(source), contacts_ohm)))
                    }
                    Err(DeviceError::SourceFailed { reason, .. }) => {
                        checks.push(Check::bad("connection", reason.as_str(), advice_on(&reason)));
                        Ok(None)
                    }
                    Err(error) => Err(dermis_lab::Error::from(error).into()),
                }
            }
        }
    }

    fn print(&self, checks: &[Check], out: &mut dyn Write) -> anyhow::Result<()> {
        if self.json {
            serde_json::to_writer_pretty(&mut *out, checks).map_err(std::io::Error::from)?;
            writeln!(out)?;
            return Ok(());
        }
        for Check { name, answer, found, advice } in checks {
            let mark = match answer {
                Answer::Good => "good",
                Answer::Bad => "BAD",
                Answer::Skipped => "-",
            };
            writeln!(out, "{mark:<5}{name:<18}{found}")?;
            if !advice.is_empty() {
                writeln!(out, "{:23}-> {advice}", "")?;
            }
        }
        Ok(())
    }
}

/// A source and the contact impedances of its electrodes, ohms, if it can measure them.
type Examined = (Box<dyn Source>, Option<Vec<f32>>);

/// A running instrument and the contact impedances of its electrodes, ohms, if it can measure them.
type OpenedLive = (StreamSource, Option<Vec<f32>>);

/// Opens an instrument with its current settings. An instrument on the wire is first asked for its contact
/// impedances, because it cannot measure them while frames flow. A Sciospec instrument is told the skin's injections.
/// The inner error is the instrument's own objection.
fn open_live(
    selector: &SourceSelector,
    options: StreamOptions,
    skin: &Skin,
) -> Result<Result<OpenedLive, DeviceError>, dermis_lab::Error> {
    let instrument = match selector {
        SourceSelector::Tcp { instrument, .. } | SourceSelector::Serial { instrument, .. } => *instrument,
        _ => Instrument::Wire,
    };
    let greeting = skin.backend.send.as_deref().unwrap_or_default();
    Ok(match instrument {
        Instrument::Wire => open_wired(selector, options),
        Instrument::Sciospec => open_sciospec(selector, options, sciospec_setup_of(skin)?).map(|source| (source, None)),
        _ => open_stream_greeted(selector, options, greeting).map(|source| (source, None)),
    })
}

/// An instrument on the wire is asked for its contacts first, which it cannot measure while frames flow.
fn open_wired(selector: &SourceSelector, options: StreamOptions) -> Result<OpenedLive, DeviceError> {
    let (source, control) = open_wire(selector, options, Vec::new(), false)?;
    let measures = control.description().is_some_and(|known| known.obeys(&Order::ElectrodeImpedance));
    let contacts_ohm = if measures { Some(control.call(Order::ElectrodeImpedance)?) } else { None };
    control.call(Order::Start)?;
    Ok((source, contacts_ohm))
}

/// Advice after a failed connection.
fn advice_on(reason: &str) -> &'static str {
    let reason = reason.to_lowercase();
    if reason.contains("permission") {
        "add yourself to the group that may use the port (sudo usermod -aG dialout $USER), and log in again"
    } else if reason.contains("busy") {
        "another program uses the port: close it"
    } else if reason.contains("no such") || reason.contains("not found") || reason.contains("no port") {
        "check cable and power; `dermis devices` lists the ports"
    } else if reason.contains("refused") {
        "nothing listens at that address and port: start the instrument's server, and check both"
    } else if reason.contains("no answer to the handshake") || reason.contains("sent no frame") {
        "it does not speak this protocol: append #lines or #floats:CHANNELS if it only sends numbers, or @BAUD for \
         another speed"
    } else {
        "check power, cable and address; `dermis devices` lists the ports"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn advice_fits_the_reason() {
        assert!(advice_on("cannot connect: Permission denied (os error 13)").contains("dialout"));
        assert!(advice_on("cannot connect: Connection refused").contains("nothing listens"));
        assert!(advice_on("connected, but it has sent no frame and no answer").contains("#lines"));
        assert!(advice_on("cannot connect: Device or resource busy").contains("another program"));
    }
}
