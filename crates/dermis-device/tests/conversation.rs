//! The host's and the device's side of the wire talk to each other in memory. Tests delivery, counting, and the end of
//! a conversation.

use std::sync::mpsc::Receiver;
use std::time::Duration;

use dermis_device::instruments::wire::{DeviceInfo, WireDevice, WireHost};
use dermis_device::stream::{Dialogue, Inbox};
use dermis_device::{Frame, HostStamp, Layout};
use dermis_wire::{Command, Decoder, Message, ReplyStatus, Request, Status, encode};

const RATE: f32 = 50.0;
const PERIOD_NS: u64 = 20_000_000;

fn info(boot: u32, channels: u16) -> DeviceInfo {
    DeviceInfo {
        device: "made".into(),
        serial: "1".into(),
        firmware: "0".into(),
        protocol: "adjacent".into(),
        boot,
        electrodes: 16,
        channels,
        frames_per_s: RATE,
        amplitude_a: 0.0,
        frequency_hz: 0.0,
        magnitude: false,
    }
}

/// Both sides, and a host clock that advances by one period with every frame.
struct Line {
    host: WireHost,
    device: WireDevice,
    inbox: Inbox,
    out: Receiver<Frame>,
    now_ns: u64,
}

impl Line {
    fn new(boot: u32) -> Self {
        let (inbox, out, _) = Inbox::new(1000);
        Self { host: WireHost::new(), device: WireDevice::new(info(boot, 3)), inbox, out, now_ns: 0 }
    }

    /// Connects, and passes messages on until both sides are silent.
    fn connect(&mut self) -> Result<(), String> {
        let mut to_device = Vec::new();
        self.device.reset_link();
        self.host.open(&mut to_device);
        self.exchange(to_device)
    }

    fn exchange(&mut self, mut to_device: Vec<u8>) -> Result<(), String> {
        for _ in 0..10 {
            let mut to_host = Vec::new();
            self.device.receive(&to_device, &mut to_host);
            to_device = self.hear(&to_host)?;
        }
        assert!(to_device.is_empty(), "they never fall silent");
        Ok(())
    }

    /// The host's answer to these bytes.
    fn hear(&mut self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        let at = HostStamp { monotonic_ns: self.now_ns, wall_ns: 0 };
        let mut send = Vec::new();
        self.host.receive(bytes, at, &mut self.inbox, &mut send)?;
        Ok(send)
    }

    fn frame_bytes(&mut self, sequence: u64) -> Vec<u8> {
        let at = HostStamp { monotonic_ns: 0, wall_ns: 0 };
        let mut frame = Frame::default();
        let number = sequence as f64;
        frame.refill(sequence, at, &[number, -0.5, f64::NAN], &[]);
        let mut bytes = Vec::new();
        self.device.frame(&frame, Status::default(), &mut bytes);
        bytes
    }

    fn send_frame(&mut self, sequence: u64) {
        self.now_ns += PERIOD_NS;
        let bytes = self.frame_bytes(sequence);
        assert!(!bytes.is_empty(), "the device is not running");
        self.hear(&bytes).expect("a frame never ends a conversation");
    }

    /// The host's and the device's numbers of the frames that arrived.
    fn received(&self) -> Vec<(u64, f64)> {
        self.out.try_iter().map(|frame| (frame.sequence, frame.values[0])).collect()
    }
}

#[test]
fn frames_flow_after_the_handshake_with_their_values_and_times() {
    let mut line = Line::new(7);
    assert_eq!(line.host.layout(), None);
    line.connect().unwrap();
    assert!(line.device.is_running());
    assert_eq!(line.host.layout(), Some(Layout::Channels { count: 3 }));
    assert!(line.host.identity().unwrap().starts_with("made 1, firmware 0, 16 electrodes, 3 channels at 50 frames/s"));
    line.send_frame(41);
    let frame = line.out.try_recv().unwrap();
    assert_eq!((frame.sequence, frame.host_monotonic_ns), (0, PERIOD_NS), "a host counts from 0");
    assert_eq!(frame.values[..2], [41.0, -0.5]);
    assert!(frame.values[2].is_nan());

    let mut bye = Vec::new();
    line.host.close(&mut bye);
    line.device.receive(&bye, &mut Vec::new());
    assert!(!line.device.is_running());
}

#[test]
fn gaps_are_counted_exactly_also_where_the_number_wraps() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    for sequence in [u64::from(u32::MAX) - 1, u64::from(u32::MAX), 1 << 32, (1 << 32) + 4, (1 << 32) + 5] {
        line.send_frame(sequence);
    }
    assert_eq!(line.received().iter().map(|frame| frame.0).collect::<Vec<_>>(), [0, 1, 2, 6, 7]);
    assert_eq!(line.inbox.losses(), (3, 0));
}

#[test]
fn a_lost_connection_loses_exactly_the_frames_taken_in_the_meantime() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    (0..5).for_each(|sequence| line.send_frame(sequence));
    line.connect().unwrap();
    (25..27).for_each(|sequence| line.send_frame(sequence));
    assert_eq!(line.received().last(), Some(&(26, 26.0)));
    assert_eq!(line.inbox.losses(), (20, 0));
}

#[test]
fn repeated_and_late_frames_are_dropped_and_counted() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    for sequence in [10, 11, 11, 10, 12, 14, 13, 15] {
        line.send_frame(sequence);
    }
    assert_eq!(line.received().iter().map(|frame| frame.1).collect::<Vec<_>>(), [10.0, 11.0, 12.0, 14.0, 15.0]);
    // 13 came after 14 and can't be delivered any more.
    assert_eq!(line.inbox.losses(), (1, 3));
}

#[test]
fn a_reset_device_is_started_again_and_its_gap_follows_from_its_rate() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    (100..103).for_each(|sequence| line.send_frame(sequence));
    line.device = WireDevice::new(info(8, 3));
    let mut unasked = Vec::new();
    line.device.describe(0, &mut unasked);
    let start = line.hear(&unasked).unwrap();
    assert!(!start.is_empty(), "the host starts it again");
    line.exchange(start).unwrap();
    // At 50 frames/s, 1.0 s after the last frame: frame 0 of the new count is the 50th, so 49 are missing.
    line.now_ns += 49 * PERIOD_NS;
    line.send_frame(0);
    line.send_frame(1);
    assert_eq!(line.received().iter().map(|frame| frame.0).collect::<Vec<_>>(), [0, 1, 2, 52, 53]);
    assert_eq!(line.inbox.losses(), (49, 0));
}

#[test]
fn a_device_without_boot_number_may_restart_its_numbering_after_reconnecting() {
    let mut line = Line::new(0);
    line.connect().unwrap();
    (100..103).for_each(|sequence| line.send_frame(sequence));
    line.connect().unwrap();
    line.now_ns += 9 * PERIOD_NS;
    line.send_frame(0);
    assert_eq!(line.received().last(), Some(&(12, 0.0)));
    assert_eq!(line.inbox.losses(), (9, 0));
}

#[test]
fn a_device_that_restarts_its_numbering_silently_is_accepted_eventually() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    line.send_frame(1000);
    (0..40).for_each(|sequence| line.send_frame(sequence));
    let received = line.received();
    assert_eq!(received.len(), 1 + 40 - 16);
    assert_eq!(line.inbox.losses(), (16, 16), "sixteen seen as late, and as many missing in the host's count");
}

#[test]
fn another_device_on_the_port_is_refused_by_its_channels() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    line.device = WireDevice::new(info(9, 4));
    let reason = line.connect().unwrap_err();
    assert!(reason.starts_with("expected 3 channels, found 4 (made 1"), "{reason}");
    line.device = WireDevice::new(info(7, 3));
    line.connect().unwrap();
}

#[test]
fn the_hello_is_repeated_and_silence_ends_the_handshake() {
    let mut host = WireHost::new();
    let mut send = Vec::new();
    host.open(&mut send);
    let hello = send.len();
    let mut said = 0;
    let mut ended = None;
    for tenth in 1..100 {
        send.clear();
        if let Err(reason) = host.tick(Duration::from_millis(100 * tenth), &mut send) {
            ended = Some((tenth, reason));
            break;
        }
        said += send.len() / hello;
    }
    let (tenth, reason) = ended.expect("an end");
    assert_eq!((tenth, said), (31, 6));
    assert!(reason.contains("no answer to the handshake in 3 s"), "{reason}");
}

#[test]
fn frames_of_an_earlier_conversation_and_half_packets_before_the_first_are_no_losses() {
    let mut line = Line::new(7);
    line.connect().unwrap();
    let old = line.frame_bytes(5);
    let mut fresh = Line::new(7);
    let mut hello = Vec::new();
    fresh.host.open(&mut hello);
    fresh.hear(&old[10..]).unwrap();
    fresh.hear(&old).unwrap();
    fresh.exchange(hello).unwrap();
    fresh.send_frame(9);
    assert_eq!(fresh.received(), [(0, 9.0)]);
    assert_eq!(fresh.inbox.losses(), (0, 0));
}

/// The device's reply to a command, with its numbers.
fn reply_to(device: &mut WireDevice, command: Command<'_>) -> (ReplyStatus, Vec<f32>) {
    let (mut buffer, mut bytes) = ([0; 256], Vec::new());
    device.receive(encode(&Message::Command(Request { tag: 5, command }), &mut buffer).unwrap(), &mut bytes);
    let mut decoder = Decoder::new(vec![0; 4096]);
    match decoder.feed(&mut &bytes[..]) {
        Some(Ok(Message::Reply(reply))) => {
            assert_eq!((reply.tag, reply.command), (5, command.code()));
            (reply.status, reply.values.iter().collect())
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn a_device_reports_its_settings_and_self_test() {
    let mut device = WireDevice::new(DeviceInfo { amplitude_a: 2e-3, frequency_hz: 954.0, ..info(7, 3) });
    assert_eq!(reply_to(&mut device, Command::SelfTest), (ReplyStatus::Unknown, vec![]));
    device.set_measured(&[1.0], &[3.5, f32::NAN]);
    // A request for an unavailable value is answered with the actual one.
    assert_eq!(reply_to(&mut device, Command::Amplitude(1e-3)), (ReplyStatus::Done, vec![2e-3]));
    assert_eq!(reply_to(&mut device, Command::Frequency(1e3)), (ReplyStatus::Done, vec![954.0]));
    assert_eq!(reply_to(&mut device, Command::Rate(10.0)), (ReplyStatus::Done, vec![RATE]));
    assert_eq!(reply_to(&mut device, Command::Amplitude(f32::NAN)).0, ReplyStatus::BadArgument);
    assert_eq!(reply_to(&mut device, Command::Gain(255)), (ReplyStatus::Done, vec![]));
    assert_eq!(reply_to(&mut device, Command::Gain(3)).0, ReplyStatus::BadArgument);
    assert_eq!(reply_to(&mut device, Command::ProtocolName("other")).0, ReplyStatus::Unknown);
    assert_eq!(reply_to(&mut device, Command::SelfTest), (ReplyStatus::Done, vec![1.0]));
    let (status, contacts_ohm) = reply_to(&mut device, Command::ElectrodeImpedance);
    assert_eq!((status, contacts_ohm[0], contacts_ohm.len()), (ReplyStatus::Done, 3.5, 2));
    assert!(contacts_ohm[1].is_nan(), "open");
    assert_eq!(reply_to(&mut device, Command::Start).0, ReplyStatus::Done);
    assert_eq!(reply_to(&mut device, Command::ElectrodeImpedance).0, ReplyStatus::Busy);
}
