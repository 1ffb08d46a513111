//! One JSON object per line and frame, for pipes and logs.

mod damage;
mod each;
mod extras;
mod frame;
mod touch;

use std::io::Write;
use std::path::PathBuf;

use super::interface::{Sink, Summary};
use crate::Error;
use dermis_live::skin_frame::SkinFrame;
use extras::Plain;
pub use extras::{LineExtras, NoFields};
use frame::FrameLine;
pub(crate) use frame::Verdict;

/// Selects the frames that get a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LinesFor {
    /// Every frame.
    EveryFrame,
    /// Frames with a touch, in which one ended, or with a damage event.
    Touches,
}

/// Writes lines such as
/// `{"sequence":7,"time_s":12.000000345,"touches":[{"id":1,"phase":"begin","x_mm":12.5,...}],"clocks":{...}}`.
///
/// `time_s` is the host's monotonic clock from the start of the process. `clocks` gives the same frame on clocks that
/// other programs can read, in nanoseconds: `wall_ns` since 1970-01-01 UTC and `monotonic_ns` on the system's
/// monotonic clock (`CLOCK_MONOTONIC`), both at the frame's first byte, and `device_ns` on the device's own clock, or
/// null.
///
/// A touch has `id`, `phase` (`begin`, `move`, or once `end`), `x_mm`, `y_mm`, `amplitude`, `area_mm2`, `sigma_x_mm`
/// and `sigma_y_mm`. If a force is known, it has `force_n` and `force_range` (`within`; `below`, `above` or
/// `saturated`, in which case `force_n` is the end of the range; `none`; `law`: from the layer's law, with
/// `sigma_force_n`). If the forward model placed it, it has the fitted `radius_mm`. If a calibration by pokes estimates
/// them, it has `depth_mm` and `sigma_depth_mm`, or `poke_force_n` and `sigma_poke_force_n`. Values that are not
/// finite are `null`.
///
/// `health` is present if something is broken. `frame` (`kind`: `frozen`, `saturated`, `flipped`, `out-of-range` or
/// `blank`; `since_s`) means that the frames are wrong as a whole. It comes with `"touches_known": false`, since an
/// empty list then says nothing about the skin, and touches that end at that point have `"known": false`. `left_out`
/// is the number of channels left out, `electrodes` lists faulty electrodes (`electrode`, `kind`: `lost` or `shorted`
/// `with` another, `since_s`), and `channels` lists channels with faults of their own (`channel`, `kind`, `since_s`),
/// all counted from 1. If a frame's number or time is odd, there is `marks`: `lost_before`, `renumbered`,
/// `clock_jump_s` ([`FrameAnomalies`](dermis_live::clock::FrameAnomalies)).
///
/// `damage` is present if there is damage or news of it. It has `list` (`id`, `state`, `x_mm`, `y_mm`, `length_mm`,
/// `width_mm`, `direction_deg`, `depth`, the remaining `share`, `significance`, `since_s`, `confirmed_s`, and, if a
/// model was fitted, `sigma_mm` of x, y and length), `events` (`id`, `event`), the number of `baselines` so far and
/// which of them is the `intact` one (from 1), and a `proposal` of a new baseline (`reason`, `since_s`,
/// `offset_sigma`). Its times are on the pipeline's clock.
///
/// `guard` is present if the skin has a guard: `verdict` (`ok`, `stale` or `stop`), `reasons`, and `safety_rated`,
/// which is always false.
///
/// `json-lines.schema.json` is the schema of a line. Numbers have enough digits to be read back exactly. Every line is
/// flushed, so that a reader sees it at once. The line is built in reused memory: nothing is allocated once the longest
/// line has been written.
#[derive(Debug)]
pub struct JsonLines<W> {
    out: W,
    name: PathBuf,
    lines_for: LinesFor,
    line: Vec<u8>,
    summary: Summary,
    /// The frames come from a recording, and their monotonic times from another process.
    of_recording: bool,
}

impl<W: Write + Send> JsonLines<W> {
    /// Writes to `out`; `name` is only used in messages.
    pub fn new(out: W, name: impl Into<PathBuf>, lines_for: LinesFor) -> Self {
        let (line, summary) = (Vec::with_capacity(1024), Summary::default());
        Self { out, name: name.into(), lines_for, line, summary, of_recording: false }
    }

    /// For the frames of a recording, whose `monotonic_ns` is null because it came from another process's clock.
    #[must_use]
    pub fn of_recording(mut self) -> Self {
        self.of_recording = true;
        self
    }
}

impl<W> JsonLines<W> {
    /// The output.
    pub fn get_mut(&mut self) -> &mut W {
        &mut self.out
    }
}

impl<W: Write + Send> JsonLines<W> {
    /// Like [`Sink::accept`], with the additions of `extras`.
    ///
    /// # Errors
    /// As for [`Sink::accept`].
    pub fn accept_with<E: LineExtras>(&mut self, output: &SkinFrame<'_>, extras: &E) -> Result<(), Error> {
        self.summary.frames += 1;
        let quiet = output.damage.events.is_empty();
        let silent = output.touches.is_empty() && output.ended.is_empty() && quiet;
        if silent && self.lines_for == LinesFor::Touches {
            return Ok(());
        }
        self.line.clear();
        let line = FrameLine::new(output, extras, self.of_recording);
        let written = serde_json::to_writer(&mut self.line, &line).map_err(std::io::Error::from).and_then(|()| {
            self.line.push(b'\n');
            self.out.write_all(&self.line)?;
            self.out.flush()
        });
        written.map_err(Error::io(&self.name))?;
        self.summary.written += 1;
        Ok(())
    }
}

impl<W: Write + Send> Sink for JsonLines<W> {
    fn accept(&mut self, output: &SkinFrame<'_>) -> Result<(), Error> {
        self.accept_with(output, &Plain)
    }

    fn finish(&mut self) -> Result<Summary, Error> {
        self.out.flush().map_err(Error::io(&self.name))?;
        Ok(self.summary)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{output, touch};
    use super::*;
    use dermis_live::clock::FrameAnomalies;
    use dermis_touch::TouchPhase;
    use dermis_touch::guard::GuardReport;
    use dermis_touch::health::{ChannelFaultKind, ElectrodeFaultKind, Health};
    use serde_json::{Value, json};

    fn lines(bytes: &[u8]) -> Vec<Value> {
        std::str::from_utf8(bytes).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
    }

    #[test]
    fn a_line_is_one_object_with_touches_and_endings() {
        let mut bytes = Vec::new();
        let mut sink = JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame);
        let mut odd = touch(2, TouchPhase::Move, 0.5, 0.25);
        odd.amplitude = f64::NAN;
        let ended = [touch(3, TouchPhase::End, 1.0, 2.0)];
        sink.accept(&output(7, &[0.0; 6], &[odd], &ended)).unwrap();
        sink.accept(&output(8, &[0.0; 6], &[], &[])).unwrap();
        assert_eq!(sink.finish().unwrap(), Summary { frames: 2, written: 2 });
        let found = lines(&bytes);
        assert_eq!(found[0]["time_s"], json!(12.000000352));
        let expected = json!([
            {"id": 2, "phase": "move", "x_mm": 0.5, "y_mm": 0.25, "amplitude": null, "area_mm2": 100.0,
             "sigma_x_mm": 0.5, "sigma_y_mm": 0.25},
            {"id": 3, "phase": "end", "x_mm": 1.0, "y_mm": 2.0, "amplitude": 0.75, "area_mm2": 100.0,
             "sigma_x_mm": 0.5, "sigma_y_mm": 0.25},
        ]);
        for (found, expected) in found[0]["touches"].as_array().unwrap().iter().zip(expected.as_array().unwrap()) {
            for (key, expected) in expected.as_object().unwrap() {
                match expected.as_f64() {
                    Some(expected) => assert!((found[key].as_f64().unwrap() - expected).abs() < 1e-12, "{key}"),
                    None => assert_eq!(&found[key], expected, "{key}"),
                }
            }
        }
        assert!(found[1]["clocks"]["wall_ns"].is_u64() && found[1]["clocks"]["monotonic_ns"].is_u64());
        let rest: Vec<_> = found[1].as_object().unwrap().iter().filter(|(key, _)| *key != "clocks").collect();
        assert_eq!(json!(rest), json!([["sequence", 8], ["time_s", 12.000000353], ["touches", []]]));
    }

    #[test]
    fn forces_state_their_place_in_the_calibrated_range() {
        use dermis_touch::force::ForceReading::{NotFinite, Saturated, Valid};
        let of = |force| {
            let mut touch = touch(1, TouchPhase::Move, 0.0, 0.0);
            touch.force = Some(force);
            let mut bytes = Vec::new();
            JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame)
                .accept(&output(1, &[0.0; 6], &[touch], &[]))
                .unwrap();
            let touch = lines(&bytes)[0]["touches"][0].clone();
            (touch["force_n"].clone(), touch["force_range"].clone())
        };
        assert_eq!(of(Valid { force_n: 0.25, sigma_n: 0.01 }), (json!(0.25), json!("within")));
        assert_eq!(of(Saturated { from_n: 2.0 }), (json!(2.0), json!("saturated")));
        assert_eq!(of(NotFinite), (Value::Null, json!("none")));
    }

    #[test]
    fn faults_are_reported_with_numbers_from_one() {
        use dermis_touch::health::{ChannelFault, ElectrodeFault};
        let (since_ns, since_sequence) = (2_500_000_000, 7);
        let channel = |channel, kind| ChannelFault { channel, kind, since_ns, since_sequence };
        let channels = [channel(0, ChannelFaultKind::Electrode), channel(11, ChannelFaultKind::Stuck)];
        let kind = ElectrodeFaultKind::Shorted { with: 5 };
        let electrodes = [ElectrodeFault { electrode: 4, kind, since_ns, since_sequence }];
        let mut bytes = Vec::new();
        let health = Health { channels: (&channels).into(), electrodes: (&electrodes).into(), ..Health::default() };
        let output = SkinFrame { health, ..output(1, &[0.0; 6], &[], &[]) };
        JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame).accept(&output).unwrap();
        let expected = json!({"left_out": 2,
            "electrodes": [{"electrode": 5, "kind": "shorted", "with": 6, "since_s": 2.5}],
            "channels": [{"channel": 12, "kind": "stuck", "since_s": 2.5}]});
        assert_eq!(lines(&bytes)[0]["health"], expected);
    }

    #[test]
    fn touches_that_end_in_a_frame_fault_are_unknown() {
        use dermis_touch::health::{FrameFault, FrameFaultKind};
        let frame = Some(FrameFault { kind: FrameFaultKind::Flipped, since_ns: 2_500_000_000, since_sequence: 7 });
        let ended = [touch(3, TouchPhase::End, 1.0, 2.0)];
        let health = Health { frame, ..Health::default() };
        let mut bytes = Vec::new();
        let output = SkinFrame { health, ..output(1, &[0.0; 6], &[], &ended) };
        JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame).accept(&output).unwrap();
        let line = &lines(&bytes)[0];
        assert_eq!((&line["touches"][0]["known"], &line["touches_known"]), (&json!(false), &json!(false)));
        assert_eq!(line["health"]["frame"], json!({"kind": "flipped", "since_s": 2.5}));
    }

    #[test]
    fn odd_numbers_and_times_are_marked() {
        let mut bytes = Vec::new();
        let anomalies = FrameAnomalies { lost_before: 3, renumbered: false, clock_jump_ns: -1_500_000_000 };
        let output = SkinFrame { anomalies, ..output(1, &[0.0; 6], &[], &[]) };
        JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame).accept(&output).unwrap();
        assert_eq!(lines(&bytes)[0]["marks"], json!({"lost_before": 3, "renumbered": false, "clock_jump_s": -1.5}));
    }

    #[test]
    fn the_guards_verdict_is_there_with_its_reasons() {
        use dermis_touch::guard::{GuardReason, GuardReasons, GuardVerdict};
        let mut reasons = GuardReasons::default();
        reasons.insert(GuardReason::Held);
        reasons.insert(GuardReason::Force);
        let report = GuardReport { verdict: GuardVerdict::Stop, reasons, frame_ns: 0, stale_after_ns: 1 };
        let mut bytes = Vec::new();
        let output = SkinFrame { guard: Some(report), ..output(1, &[0.0; 6], &[], &[]) };
        JsonLines::new(&mut bytes, "test", LinesFor::EveryFrame).accept(&output).unwrap();
        let expected = json!({"verdict": "stop", "reasons": ["force", "held"], "safety_rated": false});
        assert_eq!(lines(&bytes)[0]["guard"], expected);
    }

    #[test]
    fn quiet_frames_can_be_left_out_but_endings_are_not() {
        let mut bytes = Vec::new();
        let mut sink = JsonLines::new(&mut bytes, "test", LinesFor::Touches);
        let touches = [touch(1, TouchPhase::Begin, 0.0, 0.0)];
        let end = [touch(1, TouchPhase::End, 0.0, 0.0)];
        sink.accept(&output(1, &[0.0; 6], &[], &[])).unwrap();
        sink.accept(&output(2, &[0.0; 6], &touches, &[])).unwrap();
        sink.accept(&output(3, &[0.0; 6], &[], &end)).unwrap();
        sink.accept(&output(4, &[0.0; 6], &[], &[])).unwrap();
        assert_eq!(sink.finish().unwrap(), Summary { frames: 4, written: 2 });
        let sequences: Vec<Value> = lines(&bytes).iter().map(|line| line["sequence"].clone()).collect();
        assert_eq!(sequences, [2, 3]);
    }

    #[test]
    fn a_reader_that_went_away_is_an_error_with_its_name() {
        struct Closed;
        impl Write for Closed {
            fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
                Err(std::io::ErrorKind::BrokenPipe.into())
            }
            fn flush(&mut self) -> std::io::Result<()> {
                Ok(())
            }
        }
        let mut sink = JsonLines::new(Closed, "standard output", LinesFor::EveryFrame);
        let message = sink.accept(&output(1, &[0.0; 6], &[], &[])).unwrap_err().to_string();
        assert!(message.starts_with("standard output: "), "{message}");
    }
}
