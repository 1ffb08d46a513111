//! A simulated board behind embedded-hal's traits: chips that behave like their data sheets, a clock that advances
//! with every bit on a bus, and an analogue side provided by the test. And a host connected to it.
#![allow(dead_code)]

use std::cell::RefCell;
use std::collections::VecDeque;
use std::convert::Infallible;
use std::rc::Rc;

use dermis_device::Frame;
use dermis_device::HostStamp;
use dermis_device::instruments::wire::{Order, WireControl, WireHost};
use dermis_device::stream::{Dialogue, Inbox};
use dermis_firmware::mux64::Selection;
use dermis_firmware::{Board, Clock, Engine, Identity};
use embedded_hal::delay::DelayNs;
use embedded_hal::i2c::{self, I2c, NoAcknowledgeSource, Operation as I2cOperation};
use embedded_hal::spi::{self, Operation as SpiOperation, SpiDevice};

/// Clocks of the buses and of the serial line, bits per second.
pub const SPI_HZ: u64 = 10_000_000;
pub const I2C_HZ: u64 = 400_000;
pub const SERIAL_HZ: u64 = 1_000_000;
/// Processor time between polls of the line.
const LOOP_NS: u64 = 2_000;
/// Address of the converter with its address pin at ground.
const ADDRESS: u8 = 0x48;

/// The electrodes: potentials at the outputs 0 and 1 against ground, volts, for a selection.
pub trait Analog {
    fn outputs_v(&mut self, selection: Selection) -> [f64; 2];
}

/// State shared by all chips.
pub struct Chips<A> {
    pub analog: A,
    pub now_ns: u64,
    pub selection: Selection,
    /// The converter: register pointer, configuration, end of the conversion, result, and whether it answers.
    pointer: u8,
    config: u16,
    done_ns: u64,
    result: i16,
    pub converter_answers: bool,
    /// Number of conversions and of selections.
    pub conversions: u64,
    pub selections: u64,
    /// Noise at the converter's input, volts, and the state of its generator.
    pub noise_v: f64,
    random: u64,
    /// The serial line.
    pub to_board: VecDeque<u8>,
    pub to_host: Vec<u8>,
}

pub type Shared<A> = Rc<RefCell<Chips<A>>>;

pub fn chips<A: Analog>(analog: A) -> Shared<A> {
    Rc::new(RefCell::new(Chips {
        analog,
        now_ns: 1_000_000,
        selection: Selection { steps: 0, lines: [0xff; 4] },
        pointer: 0,
        config: 0x8583,
        done_ns: 0,
        result: 0,
        converter_answers: true,
        conversions: 0,
        selections: 0,
        noise_v: 0.0,
        random: 0x9e37_79b9_7f4a_7c15,
        to_board: VecDeque::new(),
        to_host: Vec::new(),
    }))
}

impl<A: Analog> Chips<A> {
    /// A nearly normal number: the sum of twelve uniform ones (central limit theorem), from Marsaglia's xorshift
    /// (2003).
    fn normal(&mut self) -> f64 {
        let mut uniform = || {
            self.random ^= self.random << 13;
            self.random ^= self.random >> 7;
            self.random ^= self.random << 17;
            (self.random >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }

    /// Starts a conversion with the given configuration (data sheet, table 8).
    fn convert(&mut self) {
        let full_scale_v = [6.144, 4.096, 2.048, 1.024, 0.512, 0.256, 0.256, 0.256][usize::from(self.config >> 9 & 7)];
        let [positive_v, negative_v] = self.analog.outputs_v(self.selection);
        let volts = match self.config >> 12 & 7 {
            0 => positive_v - negative_v,
            4 => positive_v,
            other => panic!("inputs {other} are not connected"),
        };
        let counts = (volts + self.noise_v * self.normal()) / full_scale_v * 32_768.0;
        self.result = counts.round().clamp(-32_768.0, 32_767.0) as i16;
        let per_s = [8, 16, 32, 64, 128, 250, 475, 860][usize::from(self.config >> 5 & 7)];
        // Waking from power-down takes 25 us.
        self.done_ns = self.now_ns + 25_000 + 1_000_000_000 / per_s;
        self.conversions += 1;
    }
}

pub struct Spi<A>(pub Shared<A>);

impl<A> spi::ErrorType for Spi<A> {
    type Error = Infallible;
}

impl<A: Analog> SpiDevice for Spi<A> {
    fn transaction(&mut self, operations: &mut [SpiOperation<'_, u8>]) -> Result<(), Infallible> {
        let mut chips = self.0.borrow_mut();
        for operation in operations {
            let SpiOperation::Write(bytes) = operation else { panic!("the multiplexer is only written to") };
            let [steps, a, b, c, d] = **bytes else { panic!("{} bytes", bytes.len()) };
            let line = |byte: u8| if byte & 0x80 == 0 { 0xff } else { byte & 0x3f };
            chips.selection = Selection { steps, lines: [a, b, c, d].map(line) };
            chips.selections += 1;
            chips.now_ns += bytes.len() as u64 * 8 * 1_000_000_000 / SPI_HZ;
        }
        Ok(())
    }
}

pub struct Wires<A>(pub Shared<A>);

impl<A> i2c::ErrorType for Wires<A> {
    type Error = i2c::ErrorKind;
}

impl<A: Analog> I2c for Wires<A> {
    fn transaction(&mut self, address: u8, operations: &mut [I2cOperation<'_>]) -> Result<(), i2c::ErrorKind> {
        let mut chips = self.0.borrow_mut();
        if address != ADDRESS || !chips.converter_answers {
            return Err(i2c::ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address));
        }
        for operation in operations {
            // Every byte is acknowledged, and an address comes first.
            let bytes = 1 + match operation {
                I2cOperation::Write(bytes) => bytes.len(),
                I2cOperation::Read(bytes) => bytes.len(),
            };
            chips.now_ns += bytes as u64 * 9 * 1_000_000_000 / I2C_HZ;
            match operation {
                I2cOperation::Write([pointer]) => chips.pointer = *pointer,
                I2cOperation::Write([1, high, low]) => {
                    chips.pointer = 1;
                    chips.config = u16::from_be_bytes([*high, *low]);
                    if chips.config & 0x8000 != 0 {
                        chips.convert();
                    }
                }
                I2cOperation::Read(bytes) => {
                    let idle = if chips.now_ns >= chips.done_ns { 0x8000 } else { 0 };
                    let register = match chips.pointer {
                        0 => chips.result as u16,
                        1 => chips.config & 0x7fff | idle,
                        other => panic!("register {other} is not read"),
                    };
                    bytes.copy_from_slice(&register.to_be_bytes());
                }
                I2cOperation::Write(bytes) => panic!("{bytes:?} is no register"),
            }
        }
        Ok(())
    }
}

pub struct Pause<A>(pub Shared<A>);

impl<A> DelayNs for Pause<A> {
    fn delay_ns(&mut self, ns: u32) {
        self.0.borrow_mut().now_ns += u64::from(ns);
    }
}

pub struct Watch<A>(pub Shared<A>);

impl<A> Clock for Watch<A> {
    fn now_ns(&mut self) -> u64 {
        self.0.borrow().now_ns
    }
}

pub struct Line<A>(pub Shared<A>);

impl<A> embedded_io::ErrorType for Line<A> {
    type Error = Infallible;
}

impl<A> embedded_io::ReadReady for Line<A> {
    fn read_ready(&mut self) -> Result<bool, Infallible> {
        Ok(!self.0.borrow().to_board.is_empty())
    }
}

impl<A> embedded_io::Read for Line<A> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Infallible> {
        let mut chips = self.0.borrow_mut();
        let count = bytes.len().min(chips.to_board.len());
        bytes.iter_mut().zip(chips.to_board.drain(..count)).for_each(|(place, byte)| *place = byte);
        Ok(count)
    }
}

impl<A> embedded_io::Write for Line<A> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut chips = self.0.borrow_mut();
        chips.to_host.extend_from_slice(bytes);
        // The processor waits for the line: ten bits per byte.
        chips.now_ns += bytes.len() as u64 * 10 * 1_000_000_000 / SERIAL_HZ;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Firmware with room for lists of 4,096 measurements, on a simulated board.
pub type Firmware<B, A> = Engine<'static, B, Line<A>, Watch<A>>;

pub const IDENTITY: Identity = Identity { serial: "P-1", boot: 77 };

/// Firmware and a host, connected.
pub struct Bench<B, A> {
    pub chips: Shared<A>,
    pub firmware: Firmware<B, A>,
    pub host: WireHost,
    pub control: WireControl,
    pub inbox: Inbox,
    pub frames: std::sync::mpsc::Receiver<Frame>,
    began_ns: u64,
}

impl<B: Board, A: Analog> Bench<B, A> {
    /// A host that configures the board with `setup` and, if wanted, starts it.
    pub fn new(chips: Shared<A>, board: B, setup: Vec<Order>, start: bool) -> Self {
        // In place of a board's static memory.
        let list = vec![[0; 4]; 4096].leak();
        let firmware = Engine::new(board, Line(chips.clone()), Watch(chips.clone()), IDENTITY, list);
        let (mut host, control) = WireHost::with_control(setup, start);
        let (inbox, frames, _) = Inbox::new(16);
        let mut send = Vec::new();
        host.open(&mut send);
        chips.borrow_mut().to_board.extend(send);
        let began_ns = chips.borrow().now_ns;
        Self { chips, firmware, host, control, inbox, frames, began_ns }
    }

    /// Interrupts the line: the host reconnects, or `another` one does, while the board keeps running.
    pub fn reconnect(&mut self, another: Option<(WireHost, WireControl)>) {
        if let Some((host, control)) = another {
            (self.host, self.control) = (host, control);
        }
        self.began_ns = self.chips.borrow().now_ns;
        let mut send = Vec::new();
        self.host.open(&mut send);
        self.chips.borrow_mut().to_board.extend(send);
    }

    /// One pass of the firmware's main loop, and the host's reading and answering.
    pub fn step(&mut self) {
        self.chips.borrow_mut().now_ns += LOOP_NS;
        self.firmware.poll().expect("the line takes bytes");
        let (bytes, now_ns) = {
            let mut chips = self.chips.borrow_mut();
            (std::mem::take(&mut chips.to_host), chips.now_ns)
        };
        let mut send = Vec::new();
        if !bytes.is_empty() {
            let at = HostStamp { monotonic_ns: now_ns, wall_ns: now_ns };
            self.host.receive(&bytes, at, &mut self.inbox, &mut send).expect("a conversation");
        }
        let open_for = std::time::Duration::from_nanos(now_ns - self.began_ns);
        self.host.tick(open_for, &mut send).expect("a conversation");
        self.chips.borrow_mut().to_board.extend(send);
    }

    /// The next frame, and its duration on the board's clock, seconds.
    pub fn frame(&mut self) -> (Frame, f64) {
        let began_ns = self.chips.borrow().now_ns;
        loop {
            self.step();
            let now_ns = self.chips.borrow().now_ns;
            if let Ok(frame) = self.frames.try_recv() {
                return (frame, (now_ns - began_ns) as f64 * 1e-9);
            }
            assert!(now_ns - began_ns < 60_000_000_000, "no frame in a minute");
        }
    }

    /// Sends an order from the host, and runs the board until the answer arrives.
    pub fn call(&mut self, order: Order) -> Result<Vec<f32>, String> {
        let question = self.control.ask(order).map_err(|error| error.to_string())?;
        loop {
            if let Some(answer) = question.answer() {
                return answer.map_err(|error| error.to_string());
            }
            self.step();
        }
    }
}
