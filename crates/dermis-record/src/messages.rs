//! The messages of a recording's own types: frames, baselines, touches and events, to CDR and back ([`super::schema`]
//! has their definitions).

use dermis_device::{Frame, Status};
use dermis_touch::{ReferenceOrigin, ReferenceRecord, Touch, TouchPhase};

use super::cdr::{CdrReader, CdrWriter};

/// A baseline as recorded.
#[derive(Debug, Clone, PartialEq)]
pub struct BaselineEntry {
    /// Time of the frame that completed the baseline, and the reason for it.
    pub record: ReferenceRecord,
    /// The baseline, one value per channel of the protocol.
    pub values: Vec<f64>,
    /// Standard deviation of each channel at rest, in the same unit; may be empty.
    pub noise_std: Vec<f64>,
}

impl Default for BaselineEntry {
    fn default() -> Self {
        let record = ReferenceRecord { time_ns: 0, frames: 0, origin: ReferenceOrigin::Given, reason: String::new() };
        Self { record, values: Vec::new(), noise_std: Vec::new() }
    }
}

/// The touches of a frame, as recorded.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TouchesEntry {
    /// The frame's number.
    pub sequence: u64,
    /// The frame's time on the host's monotonic clock, nanoseconds.
    pub time_ns: u64,
    /// Its touches, including those that ended in it.
    pub touches: Vec<TouchEntry>,
}

/// A touch as recorded, in the skin's frame, x to the right and y up.
#[derive(Debug, Clone, PartialEq)]
pub struct TouchEntry {
    /// Identity.
    pub id: u64,
    /// Begin, move or end.
    pub phase: TouchPhase,
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Amplitude in the image's unit.
    pub amplitude: f64,
    /// Area above half of the peak, m^2.
    pub area_m2: f64,
    /// Standard deviations of the position, metres.
    pub sigma_m: [f64; 2],
    /// Normal force, newtons; NaN without calibration.
    pub force_n: f64,
    /// Range of the force relative to its calibration; empty without one.
    pub force_range: String,
    /// Fitted radius, metres; NaN if none was fitted.
    pub radius_m: f64,
    /// An alternative position, if the position is ambiguous.
    pub other_place: Option<OtherPlaceEntry>,
}

/// An alternative position of a touch, as recorded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OtherPlaceEntry {
    /// Position, metres.
    pub position_m: [f64; 2],
    /// Standard deviations of the position in this case, metres.
    pub sigma_m: [f64; 2],
    /// Probability that the touch is there, 0 to 1.
    pub probability: f64,
}

impl From<&Touch> for TouchEntry {
    fn from(touch: &Touch) -> Self {
        let sigmas = |covariance_m2: [[f64; 2]; 2]| [0, 1].map(|axis| covariance_m2[axis][axis].sqrt());
        Self {
            id: touch.id,
            phase: touch.phase,
            position_m: touch.position_m,
            amplitude: touch.amplitude,
            area_m2: touch.area_m2,
            sigma_m: sigmas(touch.covariance_m2),
            force_n: touch.force.and_then(|force| force.nearest_n()).unwrap_or(f64::NAN),
            force_range: touch.force.map_or("", |force| force.range()).to_owned(),
            radius_m: touch.radius_m.unwrap_or(f64::NAN),
            other_place: touch.other_place.map(|other| OtherPlaceEntry {
                position_m: other.position_m,
                sigma_m: sigmas(other.covariance_m2),
                probability: other.probability,
            }),
        }
    }
}

/// An event as recorded.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EventEntry {
    /// Name of the event.
    pub event: String,
    /// Description for human readers.
    pub detail: String,
    /// Numbers that belong to it.
    pub values: Vec<f64>,
}

pub(super) fn write_frame(out: &mut Vec<u8>, frame: &Frame) {
    let mut cdr = CdrWriter::new(out);
    cdr.u64(frame.sequence);
    cdr.bool(frame.device_time_ns.is_some());
    cdr.u64(frame.device_time_ns.unwrap_or(0));
    cdr.u64(frame.host_monotonic_ns);
    cdr.u64(frame.host_wall_ns);
    cdr.doubles(&frame.values);
    cdr.doubles(&frame.imaginary);
    cdr.u32(u32::from(frame.status.0));
    cdr.i32(frame.gain.map_or(-1, i32::from));
    cdr.u64s(&frame.channel_times_ns);
}

/// Reads a frame into `frame`; `None` if the bytes are not such a message, in which case `frame` may be partly
/// filled.
pub(super) fn read_frame(bytes: &[u8], frame: &mut Frame) -> Option<()> {
    let mut cdr = CdrReader::new(bytes)?;
    frame.clear();
    frame.sequence = cdr.u64()?;
    let has_device_time = cdr.bool()?;
    frame.device_time_ns = Some(cdr.u64()?).filter(|_| has_device_time);
    frame.host_monotonic_ns = cdr.u64()?;
    frame.host_wall_ns = cdr.u64()?;
    cdr.doubles(&mut frame.values)?;
    cdr.doubles(&mut frame.imaginary)?;
    frame.status = Status(u16::try_from(cdr.u32()?).ok()?);
    // -1, with all bits set, means no gain.
    frame.gain = u8::try_from(cdr.u32()?).ok();
    cdr.u64s(&mut frame.channel_times_ns)
}

pub(super) fn write_baseline(out: &mut Vec<u8>, record: &ReferenceRecord, values: &[f64], noise_std: &[f64]) {
    let mut cdr = CdrWriter::new(out);
    cdr.u64(record.time_ns);
    cdr.u64(record.frames as u64);
    cdr.string(origin_name(record.origin));
    cdr.string(&record.reason);
    cdr.doubles(values);
    cdr.doubles(noise_std);
}

pub(super) fn read_baseline(bytes: &[u8]) -> Option<BaselineEntry> {
    let mut cdr = CdrReader::new(bytes)?;
    let (time_ns, frames) = (cdr.u64()?, usize::try_from(cdr.u64()?).ok()?);
    let name = cdr.string()?;
    let origin = *ORIGINS.iter().find(|origin| origin_name(**origin) == name)?;
    let record = ReferenceRecord { time_ns, frames, origin, reason: cdr.string()?.to_owned() };
    let mut entry = BaselineEntry { record, ..BaselineEntry::default() };
    cdr.doubles(&mut entry.values)?;
    cdr.doubles(&mut entry.noise_std)?;
    Some(entry)
}

/// Time of a message on the wall clock, nanoseconds since 1970-01-01 UTC, and its frame of reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stamp<'a> {
    pub wall_ns: u64,
    pub frame_id: &'a str,
}

/// Writes the touches of frame `sequence`; those that ended in it are in `ended`.
pub(super) fn write_touches(
    out: &mut Vec<u8>,
    stamp: Stamp<'_>,
    sequence: u64,
    time_ns: u64,
    touches: &[Touch],
    ended: &[Touch],
) {
    let all: Vec<TouchEntry> = touches.iter().chain(ended).map(TouchEntry::from).collect();
    let mut cdr = CdrWriter::new(out);
    cdr.u64(sequence);
    cdr.u64(time_ns);
    cdr.length(all.len());
    for touch in &all {
        cdr.u64(touch.id);
        cdr.string(phase_name(touch.phase));
        let ([x, y], [sigma_x, sigma_y]) = (touch.position_m, touch.sigma_m);
        let numbers = [x, y, touch.amplitude, touch.area_m2, sigma_x, sigma_y, touch.force_n];
        numbers.into_iter().for_each(|value| cdr.f64(value));
        cdr.string(&touch.force_range);
        cdr.f64(touch.radius_m);
    }
    let others = || all.iter().filter_map(|touch| Some((touch.id, touch.other_place?)));
    cdr.length(others().count());
    for (id, OtherPlaceEntry { position_m: [x, y], sigma_m: [sigma_x, sigma_y], probability }) in others() {
        cdr.u64(id);
        [x, y, sigma_x, sigma_y, probability].into_iter().for_each(|value| cdr.f64(value));
    }
    cdr.header(stamp.wall_ns, stamp.frame_id);
}

pub(super) fn read_touches(bytes: &[u8]) -> Option<TouchesEntry> {
    let mut cdr = CdrReader::new(bytes)?;
    let (sequence, time_ns) = (cdr.u64()?, cdr.u64()?);
    let mut touches = (0..cdr.length(1)?).map(|_| read_touch(&mut cdr)).collect::<Option<Vec<_>>>()?;
    // Recordings made before alternative positions were added end here.
    let others = if cdr.is_at_end() { 0 } else { cdr.length(1)? };
    for _ in 0..others {
        let id = cdr.u64()?;
        let (position_m, sigma_m) = ([cdr.f64()?, cdr.f64()?], [cdr.f64()?, cdr.f64()?]);
        let other = OtherPlaceEntry { position_m, sigma_m, probability: cdr.f64()? };
        touches.iter_mut().find(|touch| touch.id == id)?.other_place = Some(other);
    }
    Some(TouchesEntry { sequence, time_ns, touches })
}

fn read_touch(cdr: &mut CdrReader<'_>) -> Option<TouchEntry> {
    let id = cdr.u64()?;
    let name = cdr.string()?;
    let phase = *PHASES.iter().find(|phase| phase_name(**phase) == name)?;
    Some(TouchEntry {
        id,
        phase,
        position_m: [cdr.f64()?, cdr.f64()?],
        amplitude: cdr.f64()?,
        area_m2: cdr.f64()?,
        sigma_m: [cdr.f64()?, cdr.f64()?],
        force_n: cdr.f64()?,
        force_range: cdr.string()?.to_owned(),
        radius_m: cdr.f64()?,
        other_place: None,
    })
}

pub(super) fn write_event(out: &mut Vec<u8>, stamp: Stamp<'_>, event: &str, detail: &str, values: &[f64]) {
    let mut cdr = CdrWriter::new(out);
    cdr.string(event);
    cdr.string(detail);
    cdr.doubles(values);
    cdr.header(stamp.wall_ns, stamp.frame_id);
}

/// Writes joint values, radians or metres, as a `sensor_msgs/JointState`.
pub(super) fn write_joints<'a>(out: &mut Vec<u8>, wall_ns: u64, joints: impl ExactSizeIterator<Item = (&'a str, f64)>) {
    let mut cdr = CdrWriter::new(out);
    cdr.header(wall_ns, "");
    cdr.length(joints.len());
    let mut positions = Vec::with_capacity(joints.len());
    for (name, position) in joints {
        cdr.string(name);
        positions.push(position);
    }
    cdr.doubles(&positions);
    cdr.doubles(&[]);
    cdr.doubles(&[]);
}

pub(super) fn read_event(bytes: &[u8]) -> Option<EventEntry> {
    let mut cdr = CdrReader::new(bytes)?;
    let mut entry =
        EventEntry { event: cdr.string()?.to_owned(), detail: cdr.string()?.to_owned(), values: Vec::new() };
    cdr.doubles(&mut entry.values)?;
    Some(entry)
}

const ORIGINS: [ReferenceOrigin; 5] = [
    ReferenceOrigin::Startup,
    ReferenceOrigin::Tare,
    ReferenceOrigin::ForcedTare,
    ReferenceOrigin::Given,
    ReferenceOrigin::Damage,
];

/// Name of a baseline's origin.
pub(super) fn origin_name(origin: ReferenceOrigin) -> &'static str {
    match origin {
        ReferenceOrigin::Startup => "startup",
        ReferenceOrigin::Tare => "tare",
        ReferenceOrigin::ForcedTare => "forced-tare",
        ReferenceOrigin::Given => "given",
        ReferenceOrigin::Damage => "damage",
    }
}

const PHASES: [TouchPhase; 3] = [TouchPhase::Begin, TouchPhase::Move, TouchPhase::End];

pub(super) fn phase_name(phase: TouchPhase) -> &'static str {
    match phase {
        TouchPhase::Begin => "begin",
        TouchPhase::Move => "move",
        TouchPhase::End => "end",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sink::testing::touch;
    use dermis_touch::PlaceHypothesis;
    use proptest::prelude::*;

    /// The frame without its readings, and the readings as bits, NaN among them.
    fn bits(frame: &Frame) -> (Frame, Vec<u64>, Vec<u64>) {
        let bits = |values: &[f64]| values.iter().map(|value| value.to_bits()).collect();
        let rest = Frame { values: Vec::new(), imaginary: Vec::new(), ..frame.clone() };
        (rest, bits(&frame.values), bits(&frame.imaginary))
    }

    proptest! {
        #[test]
        fn frames_are_read_back_bit_for_bit(
            sequence: u64, device_time_ns: Option<u64>, host_monotonic_ns: u64, host_wall_ns: u64,
            values: Vec<u64>, imaginary: Vec<u64>, status: u16, gain: Option<u8>, channel_times_ns: Vec<u64>,
        ) {
            let values = values.into_iter().map(f64::from_bits).collect();
            let imaginary = imaginary.into_iter().map(f64::from_bits).collect();
            let status = Status(status);
            let frame = Frame {
                sequence, device_time_ns, host_monotonic_ns, host_wall_ns, values, imaginary, status, gain, channel_times_ns,
            };
            let mut bytes = vec![1];
            write_frame(&mut bytes, &frame);
            let mut found = Frame { imaginary: vec![5.0], device_time_ns: Some(1), ..Frame::default() };
            prop_assert!(read_frame(&bytes, &mut found).is_some());
            prop_assert_eq!(bits(&found), bits(&frame));
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes: Vec<u8>) {
            let bytes = [&[0, 1, 0, 0][..], &bytes].concat();
            let _ = read_frame(&bytes, &mut Frame::default());
            let _ = (read_baseline(&bytes), read_touches(&bytes), read_event(&bytes));
        }
    }

    #[test]
    fn baselines_come_back_with_origin_and_reason() {
        for origin in ORIGINS {
            let record = ReferenceRecord { time_ns: 7, frames: 32, origin, reason: "drift \u{2192} 0".to_owned() };
            let mut bytes = Vec::new();
            write_baseline(&mut bytes, &record, &[0.1, -0.0], &[1e-6]);
            let entry = BaselineEntry { record, values: vec![0.1, -0.0], noise_std: vec![1e-6] };
            assert_eq!(read_baseline(&bytes), Some(entry));
        }
    }

    #[test]
    fn touches_are_read_back_with_those_that_ended() {
        let mut touches = [touch(1, TouchPhase::Begin, 3.0, -4.0)];
        let covariance_m2 = [[4e-6, 0.0], [0.0, 9e-6]];
        touches[0].other_place = Some(PlaceHypothesis { position_m: [-3e-3, 4e-3], covariance_m2, probability: 0.25 });
        let ended = [touch(2, TouchPhase::End, 5.0, 6.0)];
        let mut bytes = Vec::new();
        let stamp = Stamp { wall_ns: 5, frame_id: "skin" };
        write_touches(&mut bytes, stamp, 7, 9, &touches, &ended);
        let found = read_touches(&bytes).unwrap();
        assert_eq!((found.sequence, found.time_ns, found.touches.len()), (7, 9, 2));
        let [first, second] = &found.touches[..] else { panic!("{found:?}") };
        assert_eq!((first.id, first.phase, first.position_m), (1, TouchPhase::Begin, [3e-3, -4e-3]));
        assert_eq!((first.sigma_m, first.area_m2, first.force_range.as_str()), ([0.5e-3, 0.25e-3], 1e-4, ""));
        assert!(first.force_n.is_nan() && first.radius_m.is_nan());
        let other = OtherPlaceEntry { position_m: [-3e-3, 4e-3], sigma_m: [2e-3, 3e-3], probability: 0.25 };
        assert_eq!((first.other_place, second.other_place), (Some(other), None));
        assert_eq!((second.id, second.phase, second.position_m), (2, TouchPhase::End, [5e-3, 6e-3]));

        // As written before alternative positions and headers were added: nothing after the touches.
        touches[0].other_place = None;
        write_touches(&mut bytes, stamp, 7, 9, &touches, &[]);
        let header_bytes = 4 + 4 + 4 + "skin".len() + 1;
        let before = read_touches(&bytes[..bytes.len() - header_bytes - 4]).unwrap();
        assert_eq!((before.touches.len(), before.touches[0].other_place), (1, None));
    }

    #[test]
    fn cut_messages_are_refused() {
        let frame = Frame { sequence: 3, values: vec![1.0, 2.0], ..Frame::default() };
        let mut bytes = Vec::new();
        write_frame(&mut bytes, &frame);
        for end in 0..bytes.len() {
            assert!(read_frame(&bytes[..end], &mut Frame::default()).is_none(), "{end}");
        }
    }
}
