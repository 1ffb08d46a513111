//! `dermis devices`: lists the serial ports of this machine and the instruments that answer on them.

use std::io::Write;
use std::time::Duration;

use dermis_device::stream::{Port, StreamOptions, ports};
use dermis_device::{Instrument, SerialName, Source, SourceSelector, open_stream};
use dermis_skin::FileError;
use serde::Serialize;

use crate::exit::Outcome;

const EXAMPLE: &str = "\
Examples:
  dermis devices
  dermis devices --json

Opens every port with a USB device and asks the device to identify itself. Opening a port resets many boards; \
--no-ask only lists the ports. Pass a selector that is printed to `dermis run SKIN --source SELECTOR`.";

/// Arguments of `dermis devices`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Do not open the ports.
    #[arg(long)]
    no_ask: bool,
    /// Baud rate for asking, bits per second.
    #[arg(long, value_name = "N")]
    baud: Option<u32>,
    /// How long to wait for an answer.
    #[arg(long, default_value_t = 2.5, value_name = "SECONDS")]
    wait_s: f64,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Found {
    /// Value for `--source`.
    selector: String,
    path: String,
    product: Option<String>,
    /// Identification sent by the device; null if it was not asked or did not answer.
    device: Option<String>,
    /// Reason for a missing answer.
    problem: Option<String>,
}

impl Arguments {
    /// Lists the ports.
    pub fn run(&self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let ports =
            ports().map_err(|source| dermis_live::Error::Io(FileError { file: "serial ports".into(), source }))?;
        let found: Vec<Found> = ports.into_iter().map(|port| self.ask(port)).collect();
        if self.json {
            serde_json::to_writer_pretty(&mut *out, &found).map_err(std::io::Error::from)?;
            writeln!(out)?;
            return Ok(Outcome::Done);
        }
        if found.is_empty() {
            writeln!(out, "no serial ports; an instrument on the network is tcp:HOST:PORT")?;
        }
        for Found { selector, path, product, device, problem } in &found {
            let what = device.as_ref().or(problem.as_ref()).map_or("not asked", String::as_str);
            writeln!(out, "{selector}  {path}  {}  {what}", product.as_deref().unwrap_or("-"))?;
        }
        Ok(Outcome::Done)
    }

    fn ask(&self, port: Port) -> Found {
        let selector = SourceSelector::Serial {
            port: match port.usb {
                Some((vendor, product)) => SerialName::Usb { vendor, product, serial: port.serial.clone() },
                None => SerialName::Path(port.path.clone()),
            },
            baud: self.baud,
            instrument: Instrument::Wire,
        };
        // Ports without a USB device are built into the machine, and there can be dozens of them.
        let answer = (!self.no_ask && port.usb.is_some()).then(|| {
            let patience = Duration::try_from_secs_f64(self.wait_s).unwrap_or_default();
            let options = StreamOptions { patience, ..StreamOptions::default() };
            let opened = open_stream(&selector, options).map_err(|error| error.to_string());
            opened.map(|source| source.identity().unwrap_or_else(|| format!("{} channels", source.channels())))
        });
        let (device, problem) = match answer {
            Some(Ok(identity)) => (Some(identity), None),
            Some(Err(problem)) => (None, Some(problem)),
            None => (None, None),
        };
        Found { selector: selector.to_string(), path: port.path, product: port.product, device, problem }
    }
}
