//! `dermis device`: identifies and configures one instrument on the wire, and runs a self-test or a single
//! measurement.

use std::io::Write;
use std::time::{Duration, Instant};

use dermis_device::instruments::wire::{Description, Order, WireControl};
use dermis_device::stream::{StreamOptions, StreamSource};
use dermis_device::{Frame, Source, SourceEvent, SourceSelector, open_wire};
use dermis_lab::measured_list::setup_of;
use dermis_lab::serve::Background;
use dermis_skin::{DEFAULT_NAME, Skin};
use serde_json::{Value, json};

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis device twin:healing-square
  dermis device twin:healing-square shot --json

Real instruments are serial:/dev/ttyACM0, serial:2341:0043 or tcp:HOST:PORT. Settings last until the device is reset \
or set again; `dermis run` sets it as the skin file says.";

/// Longest wait for a requested frame. A slow converter takes seconds for thousands of readings.
const FRAME: Duration = Duration::from_secs(60);

/// Arguments of `dermis device`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// The instrument, or a skin's twin.
    #[arg(value_name = "SELECTOR")]
    selector: String,
    /// Action for the instrument to carry out.
    #[arg(value_enum, default_value_t = Action::Describe)]
    action: Action,
    /// Measure with the protocol, current and frequency of a skin.
    #[arg(long, value_name = "SKIN")]
    skin: Option<String>,
    /// Measure with a protocol that the device knows by name.
    #[arg(long, value_name = "NAME", conflicts_with = "skin")]
    protocol: Option<String>,
    /// Amplitude of the drive current.
    #[arg(long, value_name = "MICROAMPERES")]
    amplitude_ua: Option<f32>,
    /// Frequency of the drive.
    #[arg(long, value_name = "HERTZ")]
    frequency_hz: Option<f32>,
    /// Gain in the device's own code, or auto.
    #[arg(long, value_name = "CODE", value_parser = gain)]
    gain: Option<Gain>,
    /// Frames per second.
    #[arg(long, value_name = "N")]
    rate: Option<f32>,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

/// An action of a device.
#[derive(Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Action {
    /// Describe itself and its settings.
    Describe,
    /// Test itself; its manual explains the numbers in the answer.
    SelfTest,
    /// Measure the contact impedance of every electrode, ohm.
    Impedance,
    /// Take one frame, volts.
    Shot,
}

/// A gain; `None` leaves the choice to the device.
#[derive(Clone, Copy)]
struct Gain(Option<u8>);

fn gain(text: &str) -> Result<Gain, String> {
    if text == "auto" {
        return Ok(Gain(None));
    }
    let code = text.parse::<u8>().ok().filter(|code| *code < u8::MAX);
    code.map(|code| Gain(Some(code))).ok_or_else(|| "expected auto or a code of 0 to 254".to_owned())
}

impl Arguments {
    /// Configures the device and runs the action.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let orders = self.orders()?;
        let (selector, _twin) = self.instrument()?;
        let options = StreamOptions { patience: Duration::from_secs(8), ..StreamOptions::default() };
        // Protocols are set while the connection opens. Unlike elsewhere, a setting that the device lacks is an error
        // here.
        let (lists, settings): (Vec<Order>, Vec<Order>) =
            orders.into_iter().partition(|order| matches!(order, Order::Protocol(_) | Order::ProtocolName(_)));
        let wanted = lists.clone();
        let (mut source, control) = open_wire(&selector, options, lists, false).map_err(dermis_lab::Error::from)?;
        let description = control.description();
        for order in wanted {
            if description.as_ref().is_some_and(|known| !known.obeys(&order)) {
                return Err(UsageError(format!("{selector}: does not accept a {order}")).into());
            }
        }
        for order in settings {
            let text = order.to_string();
            let set = control.call(order).map_err(dermis_lab::Error::from)?;
            tracing::info!("{text}: set to {set:?}");
        }
        let answer = self.act(&mut source, &control)?;
        self.print(&answer, out)?;
        Ok(Outcome::Done)
    }

    /// The requested settings.
    fn orders(&self) -> anyhow::Result<Vec<Order>> {
        let mut orders = Vec::new();
        if let Some(name) = &self.skin {
            orders.extend(setup_of(&Skin::open(name)?)?);
        }
        orders.extend(self.protocol.clone().map(Order::ProtocolName));
        orders.extend(self.amplitude_ua.map(|amplitude_ua| Order::AmplitudeA(amplitude_ua * 1e-6)));
        orders.extend(self.frequency_hz.map(Order::FrequencyHz));
        orders.extend(self.gain.map(|Gain(code)| Order::Gain(code)));
        orders.extend(self.rate.map(Order::FramesPerS));
        Ok(orders)
    }

    /// The instrument's selector. A twin is served for as long as the second value lives.
    fn instrument(&self) -> anyhow::Result<(SourceSelector, Option<Background>)> {
        match self.selector.parse::<SourceSelector>().map_err(dermis_lab::Error::from)? {
            SourceSelector::Twin { name } => {
                let name = name.as_deref().or(self.skin.as_deref()).unwrap_or(DEFAULT_NAME);
                let twin = Background::start(&Skin::open(name)?)?;
                Ok((twin.selector().clone(), Some(twin)))
            }
            SourceSelector::File(spec) => {
                let text = format!("{spec}: expected an instrument (serial:PORT or tcp:HOST:PORT) or twin:NAME");
                Err(UsageError(text).into())
            }
            live => Ok((live, None)),
        }
    }

    fn act(&self, source: &mut StreamSource, control: &WireControl) -> anyhow::Result<Value> {
        let call = |order: Order| control.call(order).map_err(dermis_lab::Error::from);
        Ok(match self.action {
            Action::Describe => description(control.description().as_ref()),
            Action::SelfTest => json!({ "self_test": call(Order::SelfTest)? }),
            Action::Impedance => json!({ "impedance_ohm": call(Order::ElectrodeImpedance)? }),
            Action::Shot => {
                call(Order::SingleShot)?;
                shot(&next_frame(source)?)
            }
        })
    }

    fn print(&self, answer: &Value, out: &mut dyn Write) -> anyhow::Result<()> {
        if self.json {
            serde_json::to_writer_pretty(&mut *out, answer).map_err(std::io::Error::from)?;
            writeln!(out)?;
            return Ok(());
        }
        let fields = answer.as_object().into_iter().flatten();
        for (name, value) in fields {
            match value {
                Value::Array(values) => {
                    let values: Vec<String> = values.iter().map(Value::to_string).collect();
                    writeln!(out, "{name}: {}", values.join(" "))?;
                }
                Value::String(text) => writeln!(out, "{name}: {text}")?,
                other => writeln!(out, "{name}: {other}")?,
            }
        }
        Ok(())
    }
}

fn description(known: Option<&Description>) -> Value {
    let Some(known) = known else { return json!({}) };
    json!({
        "device": known.device,
        "serial": known.serial,
        "firmware": known.firmware,
        "electrodes": known.electrodes,
        "channels": known.channels,
        "adc_bits": known.adc_bits,
        "protocol": known.protocol,
        "protocols": known.protocols,
        "frames_per_s": known.frames_per_s,
        "most_frames_per_s": known.most_frames_per_s,
        "amplitude_a": known.amplitude_a,
        "frequency_hz": known.frequency_hz,
    })
}

fn shot(frame: &Frame) -> Value {
    json!({
        "device_time_ns": frame.device_time_ns,
        "status": frame.status.0,
        "gain": frame.gain,
        "values_v": frame.values,
        "imaginary_v": frame.imaginary,
        "channel_times_ns": frame.channel_times_ns,
    })
}

fn next_frame(source: &mut StreamSource) -> anyhow::Result<Frame> {
    let (began, mut frame) = (Instant::now(), Frame::default());
    while began.elapsed() < FRAME {
        let event = source.next_frame(&mut frame, Duration::from_millis(100)).map_err(dermis_lab::Error::from)?;
        if event == SourceEvent::Frame {
            return Ok(frame);
        }
    }
    let reason = source.problem().unwrap_or_else(|| format!("no frame in {} s", FRAME.as_secs()));
    Err(dermis_lab::Error::from(dermis_device::DeviceError::SourceFailed { name: source.name().to_owned(), reason })
        .into())
}
