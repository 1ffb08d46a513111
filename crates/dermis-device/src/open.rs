//! Opens live instruments by name.

use crate::instruments::floats::Floats;
use crate::instruments::lines::Lines;
use crate::instruments::sciospec::live::{LiveSetup, SciospecHost};
use crate::instruments::wire::{Order, WireControl, WireHost};
use crate::selector::{Instrument, SourceSelector};
use crate::stream::{Connect, Dialogue, StreamOptions, StreamSource, TcpConnect};
use crate::{DeviceError, SerialName};

/// Opens a live instrument from a `tcp:` or `serial:` selector.
///
/// # Errors
/// [`DeviceError::SourceFailed`] if nothing answers in time. [`DeviceError::Selector`] for files and twins, for
/// instruments that need a setup ([`open_sciospec`]), and for serial ports if dermis was built without them.
pub fn open_stream(selector: &SourceSelector, options: StreamOptions) -> Result<StreamSource, DeviceError> {
    open_stream_greeted(selector, options, "")
}

/// As [`open_stream`]. `greeting` is sent on every connection, to instruments that print lines.
///
/// # Errors
/// As [`open_stream`].
pub fn open_stream_greeted(
    selector: &SourceSelector,
    options: StreamOptions,
    greeting: &str,
) -> Result<StreamSource, DeviceError> {
    let name = selector.to_string();
    let (connect, instrument) = connect(selector)?;
    StreamSource::open(connect, dialogue(&name, instrument, greeting)?, options)
}

/// Opens a Sciospec EIT instrument, and sends it the setup on every connection.
///
/// # Errors
/// As [`open_stream`], [`DeviceError::Refused`] for a setup that no such instrument supports, and
/// [`DeviceError::Selector`] if the selector names a different kind of instrument.
pub fn open_sciospec(
    selector: &SourceSelector,
    options: StreamOptions,
    setup: LiveSetup,
) -> Result<StreamSource, DeviceError> {
    match connect(selector)? {
        (connect, Instrument::Sciospec) => StreamSource::open(connect, Box::new(SciospecHost::new(setup)?), options),
        _ => Err(DeviceError::selector(&selector.to_string(), "a Sciospec instrument: serial:PORT#sciospec")),
    }
}

/// The connection to a live instrument, and the kind of instrument.
fn connect(selector: &SourceSelector) -> Result<(Box<dyn Connect>, Instrument), DeviceError> {
    let name = selector.to_string();
    match selector {
        SourceSelector::Tcp { host, port, instrument } => {
            Ok((Box::new(TcpConnect::new(name, host, *port)), *instrument))
        }
        SourceSelector::Serial { port, baud, instrument } => Ok((serial(name, port, *baud)?, *instrument)),
        _ => Err(DeviceError::selector(&name, "a live instrument: tcp:HOST:PORT or serial:PORT")),
    }
}

/// Opens an instrument on the wire together with its control. `setup` is applied on every connection; settings that
/// the instrument doesn't have are skipped. Without `start`, frames flow only after [`Order::Start`] or
/// [`Order::SingleShot`].
///
/// # Errors
/// As [`open_stream`]; also [`DeviceError::Selector`] if the selector names a different kind of instrument.
pub fn open_wire(
    selector: &SourceSelector,
    options: StreamOptions,
    setup: Vec<Order>,
    start: bool,
) -> Result<(StreamSource, WireControl), DeviceError> {
    let name = selector.to_string();
    let (connect, Instrument::Wire) = connect(selector)? else {
        return Err(DeviceError::selector(&name, "an instrument on the wire: tcp:HOST:PORT or serial:PORT"));
    };
    let (host, control) = WireHost::with_control(setup, start);
    Ok((StreamSource::open(connect, Box::new(host), options)?, control))
}

fn dialogue(name: &str, instrument: Instrument, greeting: &str) -> Result<Box<dyn Dialogue>, DeviceError> {
    Ok(match instrument {
        Instrument::Wire => Box::new(WireHost::new()),
        Instrument::Lines { channels } => Box::new(Lines::new(channels).with_greeting(greeting)),
        Instrument::Floats { channels } => Box::new(Floats::new(channels)),
        Instrument::Sciospec => {
            return Err(DeviceError::selector(name, "a skin for it, whose injections are sent to the instrument"));
        }
    })
}

#[cfg(feature = "serial")]
fn serial(name: String, port: &SerialName, baud: Option<u32>) -> Result<Box<dyn Connect>, DeviceError> {
    Ok(Box::new(crate::stream::SerialConnect::new(name, port.clone(), baud)))
}

#[cfg(not(feature = "serial"))]
fn serial(name: String, _port: &SerialName, _baud: Option<u32>) -> Result<Box<dyn Connect>, DeviceError> {
    Err(DeviceError::selector(&name, "another source: this dermis was built without serial ports"))
}
