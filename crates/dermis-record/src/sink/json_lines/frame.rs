//! A frame as a line.

use dermis_device::HostStamp;
use dermis_live::clock::FrameAnomalies;
use dermis_live::skin_frame::SkinFrame;
use dermis_touch::guard::{GuardReasons, GuardReport};
use dermis_touch::health::{ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, Health};
use serde::{Serialize, Serializer};

use super::damage::DamageObject;
use super::each::{Each, seconds};
use super::extras::LineExtras;
use super::touch::TouchObject;

/// A frame.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
#[serde(bound = "")]
pub(super) struct FrameLine<'a, E: LineExtras> {
    /// Number of the frame.
    sequence: u64,
    /// Arrival of its first byte on the host's monotonic clock, from the start of the process.
    time_s: f64,
    /// Its touches, then those that ended in it.
    #[cfg_attr(test, schemars(with = "Vec<TouchObject<super::extras::NoFields>>"))]
    touches: Touches<'a, E>,
    /// False if the frames are wrong as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    touches_known: Option<bool>,
    /// Faults, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    health: Option<HealthObject<'a>>,
    /// Oddities of the frame's number or time, if there are any.
    #[serde(skip_serializing_if = "Option::is_none")]
    marks: Option<Marks>,
    /// Verdict of the skin's guard; absent without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    guard: Option<Verdict>,
    /// Known damage, if there is any or if its state has changed.
    #[serde(skip_serializing_if = "Option::is_none")]
    damage: Option<DamageObject<'a>>,
    clocks: Clocks,
    #[cfg_attr(test, schemars(with = "super::extras::NoFields"))]
    #[serde(flatten)]
    extras: E::Line,
}

impl<'a, E: LineExtras> FrameLine<'a, E> {
    pub fn new(output: &'a SkinFrame<'a>, extras: &'a E, of_recording: bool) -> Self {
        let is_known = output.health.frame.is_none();
        Self {
            sequence: output.sequence,
            time_s: seconds(output.time_ns),
            touches: Touches { output, is_known, extras },
            touches_known: (!is_known).then_some(false),
            health: HealthObject::of(&output.health),
            marks: Marks::of(&output.anomalies),
            guard: output.guard.as_ref().map(Verdict::of),
            damage: DamageObject::of(&output.damage),
            clocks: Clocks {
                wall_ns: output.wall_ns,
                monotonic_ns: (!of_recording).then(|| HostStamp::on_system_clock(output.time_ns)),
                device_ns: output.device_time_ns,
            },
            extras: extras.line(),
        }
    }
}

struct Touches<'a, E> {
    output: &'a SkinFrame<'a>,
    is_known: bool,
    extras: &'a E,
}

impl<E: LineExtras> Serialize for Touches<'_, E> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let all = self.output.touches.iter().chain(self.output.ended.iter());
        serializer.collect_seq(all.map(|touch| TouchObject::new(touch, self.is_known, self.extras)))
    }
}

/// The frame's first byte on clocks that other programs can read, nanoseconds.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Clocks {
    /// Since 1970-01-01 UTC.
    wall_ns: u64,
    /// `CLOCK_MONOTONIC`; null in replays of recordings.
    monotonic_ns: Option<u64>,
    /// The device's own clock; null without one.
    device_ns: Option<u64>,
}

/// Faults. Electrodes and channels count from 1.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct HealthObject<'a> {
    /// The frames are wrong as a whole.
    #[serde(skip_serializing_if = "Option::is_none")]
    frame: Option<FrameFaultObject>,
    /// Number of channels left out.
    left_out: usize,
    #[cfg_attr(test, schemars(with = "Vec<ElectrodeObject>"))]
    electrodes: Each<'a, ElectrodeFault, ElectrodeObject>,
    /// Channels with faults of their own.
    #[cfg_attr(test, schemars(with = "Vec<ChannelObject>"))]
    channels: Each<'a, ChannelFault, ChannelObject>,
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct FrameFaultObject {
    /// `frozen`, `saturated`, `flipped`, `out-of-range` or `blank`.
    kind: &'static str,
    since_s: f64,
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct ElectrodeObject {
    electrode: u32,
    /// `lost` or `shorted`.
    kind: &'static str,
    /// The other electrode of a short.
    #[serde(skip_serializing_if = "Option::is_none")]
    with: Option<u32>,
    since_s: f64,
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct ChannelObject {
    channel: u32,
    kind: &'static str,
    since_s: f64,
}

impl<'a> HealthObject<'a> {
    fn of(health: &'a Health<'a>) -> Option<Self> {
        let frame =
            health.frame.map(|fault| FrameFaultObject { kind: fault.kind.name(), since_s: seconds(fault.since_ns) });
        let electrode = |fault: &ElectrodeFault| {
            let (kind, with) = match fault.kind {
                ElectrodeFaultKind::Lost => ("lost", None),
                ElectrodeFaultKind::Shorted { with } => ("shorted", Some(with + 1)),
            };
            Some(ElectrodeObject { electrode: fault.electrode + 1, kind, with, since_s: seconds(fault.since_ns) })
        };
        let channel = |fault: &ChannelFault| {
            (fault.kind != ChannelFaultKind::Electrode).then(|| ChannelObject {
                channel: fault.channel + 1,
                kind: fault.kind.name(),
                since_s: seconds(fault.since_ns),
            })
        };
        let (electrodes, channels) = (Each(&health.electrodes, electrode), Each(&health.channels, channel));
        (!health.is_sound()).then_some(Self { frame, left_out: health.channels.len(), electrodes, channels })
    }
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Marks {
    /// Number of frames missing before this one.
    lost_before: u64,
    /// The numbers started again.
    renumbered: bool,
    /// Jump of the device's clock.
    clock_jump_s: f64,
}

impl Marks {
    fn of(anomalies: &FrameAnomalies) -> Option<Self> {
        let FrameAnomalies { lost_before, renumbered, clock_jump_ns } = *anomalies;
        let marks = Self { lost_before, renumbered, clock_jump_s: clock_jump_ns as f64 / 1e9 };
        (!anomalies.is_none()).then_some(marks)
    }
}

/// The verdict of a guard on a frame.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub(crate) struct Verdict {
    /// `ok`, `stale` or `stop`.
    verdict: &'static str,
    /// Its reasons; none if it is `ok`.
    #[cfg_attr(test, schemars(with = "Vec<String>"))]
    reasons: Reasons,
    /// Always false.
    safety_rated: bool,
}

impl Verdict {
    pub(crate) fn of(report: &GuardReport) -> Self {
        Self { verdict: report.verdict.name(), reasons: Reasons(report.reasons), safety_rated: false }
    }
}

struct Reasons(GuardReasons);

impl Serialize for Reasons {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter().map(|reason| reason.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::super::extras::Plain;
    use super::*;

    #[test]
    fn the_schema_of_a_line_is_the_one_in_the_repository() {
        let schema = serde_json::to_value(schemars::schema_for!(FrameLine<'static, Plain>)).unwrap();
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/json-lines.schema.json");
        if std::env::var_os("DERMIS_BLESS").is_some() {
            std::fs::write(path, format!("{schema:#}\n")).unwrap();
        }
        let kept: serde_json::Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
        assert_eq!(schema, kept, "{path} differs; write it with DERMIS_BLESS=1");
    }
}
