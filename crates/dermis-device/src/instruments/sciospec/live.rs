//! Live readings from a Sciospec EIT16, EIT32 or larger, over its serial (USB-FS) port or network socket.
//!
//! Every message is `[tag][length][data][tag]`. A command is answered by `18 01 CODE 18`. Measurements arrive in
//! messages with tag `B4`: the group of sixteen channels, the two electrodes of the injection, the row of the
//! frequency list, a time stamp, and sixteen complex potentials against the common ground, single precision, all
//! big-endian. The host sets the skin's injections, amplitude, frequency and rate, and starts the instrument. It stops
//! the instrument when the connection is closed.
//!
//! The manufacturer's manual is not public. This module follows what two independent open-source clients agree on: the
//! Python packages sciopy (University of Rostock) and eit_app (TU Braunschweig). Where they leave something open, it
//! isn't used. The unit of the time stamp is unknown, so frames only have the host's clock. Gain and converter range
//! stay at their reset values. Potentials are assumed to be in volts, as in the instrument's `.eit` files.

use std::time::Duration;

use crate::stream::{Dialogue, Inbox};
use crate::{DeviceError, HostStamp, Layout};

/// Number of channels in a data message.
const GROUP: usize = 16;
/// Bytes of data in a data message: group, injection, row, time stamp, potentials.
const DATA: usize = 1 + 2 + 2 + 4 + GROUP * 8;
/// Longest wait for the answer to a command. A serial line at 9600 bits/s delivers it in 5 ms.
const PATIENCE: Duration = Duration::from_secs(3);
/// Maximum number of electrodes of an instrument.
const MOST_ELECTRODES: usize = 256;

/// Message tags.
const ANSWER: u8 = 0x18;
const SET: u8 = 0xb0;
const OUTPUT: u8 = 0xb2;
const MEASURE: u8 = 0xb4;

/// Answer codes.
const NOT_EXECUTED: u8 = 0x81;
const NOT_KNOWN: u8 = 0x82;
const EXECUTED: u8 = 0x83;
const READY: u8 = 0x84;
const BOOTED: u8 = 0x04;
const HELD_UP: u8 = 0x92;

/// Settings that the instrument gets before it measures.
#[derive(Debug, Clone, PartialEq)]
pub struct LiveSetup {
    /// Number of electrodes of the skin. They are plugged into the instrument's channels from 1 on.
    pub electrodes: usize,
    /// Electrodes (from 0) where the current enters and leaves, for each injection. No pair may occur twice.
    pub injections: Vec<(usize, usize)>,
    /// Amplitude of the current in amperes.
    pub amplitude_a: f64,
    /// Frequency of the current. `None` leaves it at its reset value.
    pub frequency_hz: Option<f64>,
    /// Frame rate. `None` leaves it at its reset value.
    pub frames_per_s: Option<f64>,
}

impl LiveSetup {
    fn check(&self) -> Result<(), String> {
        let count = self.electrodes;
        if !(2..=MOST_ELECTRODES).contains(&count) {
            return Err(format!("{count} electrodes; expected 2 to {MOST_ELECTRODES}"));
        }
        let mut seen = std::collections::HashSet::new();
        for &(source, sink) in &self.injections {
            if source >= count || sink >= count || source == sink || !seen.insert((source, sink)) {
                let text = format!("injection {}-{}", source + 1, sink + 1);
                return Err(format!("{text}: expected two electrodes of {count}, and no pair twice"));
            }
        }
        // Range that both clients allow: 100 nA to 10 mA.
        if !(1e-7..=1e-2).contains(&self.amplitude_a) {
            return Err(format!("{} A; expected 1e-7 to 0.01 A", self.amplitude_a));
        }
        let is_wrong = |value: Option<f64>| value.is_some_and(|value| !(value > 0.0 && value.is_finite()));
        if self.injections.is_empty() || is_wrong(self.frequency_hz) || is_wrong(self.frames_per_s) {
            return Err("expected at least one injection, and a positive frequency and rate".to_owned());
        }
        Ok(())
    }

    /// Commands in the order in which they are sent, with their purposes.
    fn commands(&self) -> Vec<Command> {
        let mut commands = vec![
            // If the previous host was unplugged, the instrument may still be measuring.
            Command::new("stop", MEASURE, &[0x00]).or_refused(),
            Command::new("reset its setup", SET, &[0x01]),
            // The instrument measures until it is stopped.
            Command::new("measure without end", SET, &[0x02, 0, 0]),
        ];
        let mut with =
            |name, option: u8, data: &[u8]| commands.push(Command::new(name, SET, &[&[option], data].concat()));
        if let Some(rate) = self.frames_per_s {
            with("set its rate", 0x03, &(rate as f32).to_be_bytes());
        }
        if let Some(hertz) = self.frequency_hz {
            let hertz = (hertz as f32).to_be_bytes();
            // Start, stop, one frequency, linear.
            with("set its frequency", 0x04, &[&hertz[..], &hertz, &[0, 1, 0]].concat());
        }
        with("set its amplitude", 0x05, &self.amplitude_a.to_be_bytes());
        for (source, sink) in &self.injections {
            with("set an injection", 0x06, &[*source as u8 + 1, *sink as u8 + 1]);
        }
        // Older instruments don't know this command, and have no other mode.
        commands.push(Command::new("measure against ground", SET, &[0x08, 1, 1]).or_refused());
        commands.extend([1, 2, 3].map(|option| Command::new("state what it measures", OUTPUT, &[option, 1])));
        commands.push(Command::new("start", MEASURE, &[0x01]));
        commands
    }
}

#[derive(Debug, Clone)]
struct Command {
    name: &'static str,
    bytes: Vec<u8>,
    /// True if refusing the command does no harm.
    may_be_refused: bool,
}

impl Command {
    fn new(name: &'static str, tag: u8, data: &[u8]) -> Self {
        let mut bytes = vec![tag, data.len() as u8];
        bytes.extend_from_slice(data);
        bytes.push(tag);
        Self { name, bytes, may_be_refused: false }
    }

    fn or_refused(mut self) -> Self {
        self.may_be_refused = true;
        self
    }
}

/// A Sciospec instrument as a [`Dialogue`].
#[derive(Debug)]
pub struct SciospecHost {
    setup: LiveSetup,
    commands: Vec<Command>,
    /// Index of the command whose answer is awaited. After the last one, the instrument measures.
    at: usize,
    /// When that command was sent, since the connection was made. `None` before the first tick.
    sent: Option<Duration>,
    received: Vec<u8>,
    frame: Assembly,
    sequence: u64,
}

/// A partially received frame.
#[derive(Debug, Default)]
struct Assembly {
    real_v: Vec<f64>,
    imaginary_v: Vec<f64>,
    /// Which messages have arrived, injection x group.
    has: Vec<bool>,
    begun: Option<HostStamp>,
}

impl SciospecHost {
    /// A host that applies this setup to the instrument.
    ///
    /// # Errors
    /// [`DeviceError::Refused`] for a setup that no instrument supports.
    pub fn new(setup: LiveSetup) -> Result<Self, DeviceError> {
        setup.check().map_err(|reason| DeviceError::Refused { order: "Sciospec setup".to_owned(), reason })?;
        let commands = setup.commands();
        Ok(Self { setup, commands, at: 0, sent: None, received: Vec::new(), frame: Assembly::default(), sequence: 0 })
    }

    fn groups(&self) -> usize {
        self.setup.electrodes.div_ceil(GROUP)
    }

    fn is_measuring(&self) -> bool {
        self.at == self.commands.len()
    }

    fn answered(&mut self, code: u8, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String> {
        let Some(command) = self.commands.get(self.at) else {
            return match code {
                HELD_UP => {
                    inbox.bad_because("the instrument could not send its data in time".to_owned());
                    Ok(())
                }
                BOOTED => Err("the instrument has restarted".to_owned()),
                _ => Ok(()),
            };
        };
        match code {
            EXECUTED => {}
            NOT_EXECUTED | NOT_KNOWN if command.may_be_refused => {}
            // The instrument sends these by itself after being switched on.
            BOOTED | READY => return Ok(()),
            NOT_EXECUTED => return Err(format!("the instrument did not {}", command.name)),
            NOT_KNOWN => return Err(format!("the instrument does not know the command to {}", command.name)),
            other => return Err(format!("asked to {}, the instrument answered {other:#04x}", command.name)),
        }
        self.at += 1;
        self.sent = None;
        if let Some(next) = self.commands.get(self.at) {
            send.extend_from_slice(&next.bytes);
        }
        Ok(())
    }

    fn measured(&mut self, data: &[u8], at: HostStamp, inbox: &mut Inbox) {
        let [group, source, sink, ..] = *data else { return };
        let (groups, electrodes) = (self.groups(), self.setup.electrodes);
        let group = usize::from(group).wrapping_sub(1);
        // The instrument also sends groups of channels that aren't plugged in.
        if group >= groups {
            return;
        }
        let pair = (usize::from(source).wrapping_sub(1), usize::from(sink).wrapping_sub(1));
        let Some(injection) = self.setup.injections.iter().position(|asked| *asked == pair) else {
            inbox.bad_because(format!("data of injection {source}-{sink}, which was not requested"));
            return;
        };
        let size = self.setup.injections.len() * electrodes;
        let place = injection * groups + group;
        if self.frame.begun.is_some() && (self.frame.has[place] || place == 0) {
            // The next frame has begun.
            inbox.bad_because("a frame without all of its injections".to_owned());
            self.sequence += 1;
            self.frame.begun = None;
        }
        if self.frame.begun.is_none() {
            self.frame.begun = Some(at);
            for values in [&mut self.frame.real_v, &mut self.frame.imaginary_v] {
                values.clear();
                values.resize(size, f64::NAN);
            }
            self.frame.has.clear();
            self.frame.has.resize(self.setup.injections.len() * groups, false);
        }
        self.frame.has[place] = true;
        let (numbers, _) = data[DATA - GROUP * 8..].as_chunks::<4>();
        // NaN and infinite readings are missing.
        let volt = |raw: &[u8; 4]| Some(f64::from(f32::from_be_bytes(*raw))).filter(|v| v.is_finite());
        let first = injection * electrodes + group * GROUP;
        for (channel, pair) in numbers.chunks_exact(2).take(electrodes - group * GROUP).enumerate() {
            if let (Some(real), Some(imaginary)) = (volt(&pair[0]), volt(&pair[1])) {
                self.frame.real_v[first + channel] = real;
                self.frame.imaginary_v[first + channel] = imaginary;
            }
        }
        if self.frame.has.iter().all(|has| *has) {
            let (stamp, frame, sequence) = (self.frame.begun.take().unwrap_or(at), &self.frame, self.sequence);
            inbox.take(|out| out.refill(sequence, stamp, &frame.real_v, &frame.imaginary_v));
            self.sequence += 1;
        }
    }
}

impl Dialogue for SciospecHost {
    fn open(&mut self, send: &mut Vec<u8>) {
        (self.at, self.sent) = (0, None);
        self.received.clear();
        self.frame.begun = None;
        send.extend_from_slice(&self.commands[0].bytes);
    }

    fn receive(&mut self, bytes: &[u8], at: HostStamp, inbox: &mut Inbox, send: &mut Vec<u8>) -> Result<(), String> {
        self.received.extend_from_slice(bytes);
        let received = std::mem::take(&mut self.received);
        let (mut from, mut skipped) = (0, 0_usize);
        while let [tag, length, ..] = received[from..] {
            let end = from + 2 + usize::from(length);
            let is_message = match tag {
                ANSWER => length == 1,
                MEASURE => usize::from(length) == DATA,
                // Unexpected answers.
                SET..=0xb3 | 0xb5..=0xbe | 0xd1 | 0xd2 => !self.is_measuring(),
                _ => false,
            };
            match received.get(end) {
                None if is_message => break,
                Some(last) if is_message && *last == tag => {
                    let data = &received[from + 2..end];
                    match tag {
                        ANSWER => self.answered(data[0], inbox, send)?,
                        MEASURE if self.is_measuring() => self.measured(data, at, inbox),
                        _ => {}
                    }
                    from = end + 1;
                }
                _ => {
                    skipped += 1;
                    from += 1;
                }
            }
        }
        self.received.extend_from_slice(&received[from..]);
        // Until the first answer, the bytes may begin within a message.
        if skipped > 0 && self.at > 0 {
            inbox.bad_because(format!("{skipped} bytes that belong to no message"));
        }
        Ok(())
    }

    fn tick(&mut self, open_for: Duration, _send: &mut Vec<u8>) -> Result<(), String> {
        let Some(command) = self.commands.get(self.at) else { return Ok(()) };
        let sent = *self.sent.get_or_insert(open_for);
        if open_for.saturating_sub(sent) > PATIENCE {
            return Err(format!("no answer when asked to {}", command.name));
        }
        Ok(())
    }

    fn close(&mut self, send: &mut Vec<u8>) {
        send.extend_from_slice(&self.commands[0].bytes);
    }

    fn layout(&self) -> Option<Layout> {
        let stimulations = self.setup.injections.clone();
        self.is_measuring().then_some(Layout::SingleEnded { electrodes: self.setup.electrodes, stimulations })
    }

    fn identity(&self) -> Option<String> {
        Some(format!("Sciospec, {} electrodes, {} injections", self.setup.electrodes, self.setup.injections.len()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Frame;

    fn setup() -> LiveSetup {
        let injections = (0..32).map(|first| (first, (first + 1) % 32)).collect();
        LiveSetup { electrodes: 32, injections, amplitude_a: 1e-3, frequency_hz: Some(1e4), frames_per_s: Some(10.0) }
    }

    fn potential_v(frame: usize, injection: usize, electrode: usize) -> f32 {
        1e-3 * (1 + injection) as f32 + 1e-5 * electrode as f32 + 1e-7 * frame as f32
    }

    /// A data message from the instrument.
    fn data(frame: usize, injection: usize, group: usize) -> Vec<u8> {
        let mut bytes = vec![MEASURE, DATA as u8, group as u8 + 1, injection as u8 + 1, (injection as u8 + 1) % 32 + 1];
        bytes.extend([0, 1, 0, 0, 0, 7]);
        for channel in 0..GROUP {
            let real = potential_v(frame, injection, GROUP * group + channel);
            bytes.extend(real.to_be_bytes());
            bytes.extend((-0.5 * real).to_be_bytes());
        }
        bytes.push(MEASURE);
        bytes
    }

    /// An instrument that executes every command unless `refuses` returns a code, and that records all commands.
    struct Instrument {
        refuses: fn(&[u8]) -> Option<u8>,
        told: Vec<Vec<u8>>,
    }

    impl Instrument {
        fn answer(&mut self, command: &[u8]) -> Vec<u8> {
            assert_eq!((command[1] as usize + 3, command[0]), (command.len(), command[command.len() - 1]));
            self.told.push(command.to_vec());
            vec![ANSWER, 1, (self.refuses)(command).unwrap_or(EXECUTED), ANSWER]
        }
    }

    fn started(refuses: fn(&[u8]) -> Option<u8>) -> Result<(SciospecHost, Instrument, Inbox, Taken), String> {
        let mut host = SciospecHost::new(setup()).unwrap();
        let mut instrument = Instrument { refuses, told: Vec::new() };
        let (mut inbox, frames, spare) = Inbox::new(64);
        let mut send = Vec::new();
        host.open(&mut send);
        while !send.is_empty() {
            let answer = instrument.answer(&std::mem::take(&mut send));
            host.receive(&answer, HostStamp::now(), &mut inbox, &mut send)?;
        }
        Ok((host, instrument, inbox, (frames, spare)))
    }

    type Taken = (std::sync::mpsc::Receiver<Frame>, std::sync::mpsc::SyncSender<Frame>);

    #[test]
    fn the_instrument_is_set_up_started_and_stopped() {
        let (mut host, instrument, ..) = started(|_| None).unwrap();
        assert!(host.is_measuring() && host.layout().is_some_and(|layout| layout.channels() == 32 * 32));
        let told = &instrument.told;
        assert_eq!(told[0], [0xb4, 1, 0, 0xb4]);
        assert_eq!(told[1], [0xb0, 1, 1, 0xb0]);
        assert_eq!(told[2], [0xb0, 3, 2, 0, 0, 0xb0]);
        // 10 and 10,000 in single precision, 0.001 in double precision.
        assert_eq!(told[3], [0xb0, 5, 3, 0x41, 0x20, 0, 0, 0xb0]);
        assert_eq!(told[4], [0xb0, 12, 4, 0x46, 0x1c, 0x40, 0, 0x46, 0x1c, 0x40, 0, 0, 1, 0, 0xb0]);
        assert_eq!(told[5], [0xb0, 9, 5, 0x3f, 0x50, 0x62, 0x4d, 0xd2, 0xf1, 0xa9, 0xfc, 0xb0]);
        assert_eq!(
            (told[6].as_slice(), told[37].as_slice()),
            (&[0xb0, 3, 6, 1, 2, 0xb0][..], &[0xb0, 3, 6, 32, 1, 0xb0][..])
        );
        assert_eq!(told.last().unwrap(), &[0xb4, 1, 1, 0xb4]);
        let mut send = Vec::new();
        host.close(&mut send);
        assert_eq!(send, [0xb4, 1, 0, 0xb4]);
    }

    #[test]
    fn frames_are_assembled_from_all_groups_for_any_chunking() {
        let (mut host, _, mut inbox, (frames, _spare)) = started(|_| None).unwrap();
        let mut stream = Vec::new();
        for frame in 0..3 {
            // Channels 33 to 64 are sent too.
            (0..32).for_each(|injection| (0..4).for_each(|group| stream.extend(data(frame, injection, group))));
        }
        for piece in stream.chunks(101) {
            host.receive(piece, HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
        }
        let frames: Vec<Frame> = frames.try_iter().collect();
        assert_eq!((frames.len(), inbox.losses()), (3, (0, 0)));
        for (index, frame) in frames.iter().enumerate() {
            assert_eq!(frame.sequence, index as u64);
            for (channel, (re, im)) in frame.values.iter().zip(&frame.imaginary).enumerate() {
                let expected = f64::from(potential_v(index, channel / 32, channel % 32));
                assert!(*re == expected && (im + 0.5 * expected).abs() < 1e-9, "{index} {channel}: {re} {im}");
            }
        }
    }

    #[test]
    fn a_damaged_message_loses_only_its_frame() {
        let (mut host, _, mut inbox, (frames, _spare)) = started(|_| None).unwrap();
        let whole = |frame| -> Vec<Vec<u8>> {
            (0..32).flat_map(|injection| (0..2).map(move |group| data(frame, injection, group))).collect()
        };
        let mut broken = whole(1);
        let last = broken[9].len() - 1;
        broken[9][last] = 0;
        for message in whole(0).into_iter().chain(broken).chain(whole(2)) {
            host.receive(&message, HostStamp::now(), &mut inbox, &mut Vec::new()).unwrap();
        }
        let sequences: Vec<u64> = frames.try_iter().map(|frame| frame.sequence).collect();
        assert_eq!(sequences, [0, 2]);
        assert!(inbox.losses().1 >= 1 && inbox.reason().is_some());
    }

    #[test]
    fn errors_of_refusals_and_silence_name_the_request() {
        assert!(started(|command| (command[2] == 8).then_some(NOT_KNOWN)).is_ok(), "older instruments");
        let Err(reason) = started(|command| (command[2] == 5 && command[0] == SET).then_some(NOT_EXECUTED)) else {
            panic!("refused");
        };
        assert_eq!(reason, "the instrument did not set its amplitude");
        let mut host = SciospecHost::new(setup()).unwrap();
        host.open(&mut Vec::new());
        assert!(host.tick(Duration::from_secs(1), &mut Vec::new()).is_ok());
        assert_eq!(host.tick(Duration::from_secs(5), &mut Vec::new()).unwrap_err(), "no answer when asked to stop");
        for wrong in [
            LiveSetup { injections: vec![(0, 0)], ..setup() },
            LiveSetup { injections: vec![(0, 1), (0, 1)], ..setup() },
            LiveSetup { amplitude_a: 0.02, ..setup() },
            LiveSetup { electrodes: 1000, ..setup() },
        ] {
            assert!(SciospecHost::new(wrong).is_err());
        }
    }
}
