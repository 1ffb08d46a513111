//! A custom board for the firmware's engine, run on a computer: eight electrodes in a ring of resistors, a converter
//! made up in this file, and a host that requests ten frames.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;
use std::time::Duration;

use dermis_device::HostStamp;
use dermis_device::instruments::wire::WireHost;
use dermis_device::stream::{Dialogue, Inbox};
use dermis_firmware::{Board, Clock, Engine, Facts, Failure, Identity, Named, Reading};
use dermis_wire::{NO_ELECTRODE, Status};
use embedded_io::{ErrorType, Read, ReadReady, Write};

// ANCHOR: board
/// Eight electrodes, a current of 0.1 mA, and a 16-bit converter that takes two calls per reading.
struct RingBoard {
    is_converting: bool,
}

/// Resistance between neighbours in the ring, ohms, and volts per converter count.
const RESISTOR_OHM: f32 = 1000.0;
const CURRENT_A: f32 = 1e-4;
const SCALE_V: f32 = 1e-5;

impl RingBoard {
    /// A real board would use multiplexers and the converter. Here: potentials in a ring of eight equal resistors,
    /// with the current entering at one electrode and leaving at another.
    fn potential_v(source: u8, sink: u8, at: u8) -> f32 {
        let steps = |from: u8, to: u8| f32::from((to + 8 - from) % 8);
        let (along, other_way) = (steps(sink, source), 8.0 - steps(sink, source));
        let across_v = CURRENT_A * RESISTOR_OHM * along * other_way / 8.0;
        let place = steps(sink, at);
        if place <= along { across_v * place / along } else { across_v * (8.0 - place) / other_way }
    }
}

impl Board for RingBoard {
    fn facts(&self) -> Facts {
        Facts {
            device: "ring of resistors",
            electrodes: 8,
            adc_bits: 16,
            magnitude: false,
            coils: false,
            readings_per_s: 1000.0,
            has_frequency: false,
            has_impedance: false,
            protocols: &[Named::Adjacent],
        }
    }

    fn measure(&mut self, [source, sink, plus, minus]: [u8; 4]) -> nb::Result<Reading, Failure> {
        // The first call starts the converter; the second finds it done.
        self.is_converting = !self.is_converting;
        if self.is_converting {
            return Err(nb::Error::WouldBlock);
        }
        let minus_v = if minus == NO_ELECTRODE { 0.0 } else { Self::potential_v(source, sink, minus) };
        let volts = Self::potential_v(source, sink, plus) - minus_v;
        Ok(Reading { counts: (volts / SCALE_V).round() as i16, status: Status::default() })
    }

    fn amplitude_a(&self) -> f32 {
        CURRENT_A
    }

    fn set_amplitude_a(&mut self, _amplitude_a: f32) -> Result<f32, Failure> {
        Ok(CURRENT_A)
    }

    fn gain(&self) -> u8 {
        0
    }

    fn gains(&self) -> u8 {
        1
    }

    fn set_gain(&mut self, code: u8) -> Result<(), Failure> {
        if code == 0 { Ok(()) } else { Err(Failure::BadArgument) }
    }

    fn scale_v(&self) -> f32 {
        SCALE_V
    }

    fn quiet(&mut self) -> Result<(), Failure> {
        Ok(())
    }

    fn self_test(&mut self, _out: &mut [f32]) -> Result<usize, Failure> {
        Ok(0)
    }
}
// ANCHOR_END: board

/// The serial line: bytes to the board, and bytes to the host.
#[derive(Clone, Default)]
struct Line {
    to_board: Rc<RefCell<VecDeque<u8>>>,
    to_host: Rc<RefCell<Vec<u8>>>,
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl Read for Line {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let mut bytes = self.to_board.borrow_mut();
        let count = buffer.len().min(bytes.len());
        buffer.iter_mut().zip(bytes.drain(..count)).for_each(|(to, byte)| *to = byte);
        Ok(count)
    }
}

impl ReadReady for Line {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.to_board.borrow().is_empty())
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        self.to_host.borrow_mut().extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// A clock that advances by ten microseconds at every reading.
struct Counter(Cell<u64>);

impl Clock for Counter {
    fn now_ns(&mut self) -> u64 {
        self.0.set(self.0.get() + 10_000);
        self.0.get()
    }
}

fn main() -> Result<(), String> {
    let line = Line::default();
    let (port, clock) = (line.clone(), Counter(Cell::new(0)));
    // ANCHOR: engine
    let mut list = [[0; 4]; 256]; // room for a list of measurements that the host sends
    let identity = Identity { serial: "0001", boot: 1 };
    let mut engine = Engine::new(RingBoard { is_converting: false }, port, clock, identity, &mut list);
    let mut step = || engine.poll(); // on a microcontroller: loop { engine.poll(); }
    // ANCHOR_END: engine

    let mut host = WireHost::new();
    let (mut inbox, frames, _spare) = Inbox::new(16);
    let mut send = Vec::new();
    host.open(&mut send);
    let mut seen = 0;
    for _ in 0..1_000_000 {
        line.to_board.borrow_mut().extend(send.drain(..));
        let Ok(()) = step();
        let bytes = std::mem::take(&mut *line.to_host.borrow_mut());
        host.receive(&bytes, HostStamp::now(), &mut inbox, &mut send)?;
        host.tick(Duration::ZERO, &mut send)?;
        while let Ok(frame) = frames.try_recv() {
            println!(
                "frame {}: {} readings, the first {:.3} mV",
                frame.sequence,
                frame.values.len(),
                1e3 * frame.values[0]
            );
            seen += 1;
        }
        if seen >= 10 {
            return Ok(());
        }
    }
    Err(format!("{seen} frames in a million steps, expected 10"))
}
