//! `dermis info`: shows what a recording or a file of frames holds, how long it is, and what is missing.

mod frames;

use std::collections::BTreeMap;
use std::io::Write;

use dermis_device::FileSpec;
use dermis_record::{Damage, Entry, LostFrames, Recording, is_recording, read_frames};
use dermis_skin::Skin;
use serde_json::json;

use super::reading::ReadArguments;
use crate::exit::Outcome;
use frames::Summary;

const EXAMPLE: &str = "\
Examples:
  dermis info press.mcap
  dermis info press.mcap --json
  dermis info frames.csv

Reads the whole file and verifies every checksum of a recording. For a file of frames, it reports how the file was \
understood and what its channels hold.";

/// Arguments of `dermis info`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// A recording, complete or not, or a file of frames; #0..60 after the name of such a file selects some frames.
    #[arg(value_name = "FILE")]
    file: FileSpec,
    #[command(flatten)]
    read: ReadArguments,
    /// Print JSON instead of text.
    #[arg(long)]
    json: bool,
}

/// Facts collected in one pass over the file.
#[derive(Default)]
struct Findings {
    frames: u64,
    /// Sequence numbers of the first and last frames.
    numbers: Option<(u64, u64)>,
    /// Host times of these frames, nanoseconds, monotonic.
    times_ns: Option<(u64, u64)>,
    first_wall_ns: Option<u64>,
    gaps: u64,
    missing: u64,
    /// Seconds since the first frame, event, detail.
    events: Vec<(f64, String, String)>,
}

impl Arguments {
    /// Prints the facts.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if self.read.options().format.is_some() || !is_recording(&self.file.path) {
            Summary::of(&read_frames(&self.file, self.read.options())?).print(self.json, out)?;
            return Ok(Outcome::Done);
        }
        let mut recording = Recording::open(&self.file.path)?;
        let findings = Findings::of(&mut recording)?;
        if self.json {
            print_json(&recording, &findings, out)?
        } else {
            print_text(&recording, &findings, out)?
        }
        Ok(Outcome::Done)
    }
}

impl Findings {
    fn of(recording: &mut Recording) -> anyhow::Result<Self> {
        let mut found = Self::default();
        while let Some(entry) = recording.next_entry()? {
            match entry {
                Entry::Frame(frame) => {
                    let missing =
                        found.numbers.map_or(0, |(_, last)| frame.sequence.saturating_sub(last).saturating_sub(1));
                    found.missing += missing;
                    found.gaps += u64::from(missing > 0);
                    found.frames += 1;
                    found.numbers = Some((found.numbers.map_or(frame.sequence, |n| n.0), frame.sequence));
                    let now_ns = frame.host_monotonic_ns;
                    found.times_ns = Some((found.times_ns.map_or(now_ns, |t| t.0), now_ns));
                    found.first_wall_ns.get_or_insert(frame.host_wall_ns);
                }
                Entry::Baseline { wall_ns, entry } => {
                    let record = &entry.record;
                    let detail = format!("{:?}, mean of {} frames {}", record.origin, record.frames, record.reason);
                    found.event(wall_ns, "baseline", detail.trim_end());
                }
                Entry::Event { wall_ns, entry } => found.event(wall_ns, &entry.event, &entry.detail),
                Entry::Touches { .. } => {}
            }
        }
        Ok(found)
    }

    fn event(&mut self, wall_ns: u64, event: &str, detail: &str) {
        let since_ns = wall_ns as f64 - self.first_wall_ns.unwrap_or(wall_ns) as f64;
        self.events.push((since_ns * 1e-9, event.to_owned(), detail.to_owned()));
    }

    fn duration_s(&self) -> f64 {
        self.times_ns.map_or(0.0, |(first, last)| last.saturating_sub(first) as f64 * 1e-9)
    }
}

fn skin_name(recording: &Recording) -> String {
    let file = recording.path().display().to_string();
    Skin::parse(recording.skin_toml(), &file).map_or_else(|_| "of another version".to_owned(), |skin| skin.name)
}

fn lost_frames(damage: &Damage) -> String {
    match damage.frames {
        LostFrames::Exactly(count) => count.to_string(),
        LostFrames::Unknown { in_damaged_chunks } => format!("at most {in_damaged_chunks}"),
    }
}

/// Upper bound on the frames that a killed recording may not have written.
fn most_unwritten(found: &Findings) -> String {
    let seconds = found.duration_s();
    if found.frames < 2 || seconds <= 0.0 {
        return "at most its last second was not written".to_owned();
    }
    let per_s = ((found.frames - 1) as f64 / seconds).ceil();
    format!("at most its last second, {per_s:.0} frames at its rate, was not written")
}

fn print_text(recording: &Recording, found: &Findings, out: &mut dyn Write) -> std::io::Result<()> {
    let head = recording.head();
    writeln!(out, "recording: {}", recording.path().display())?;
    writeln!(out, "source: {}", head.source)?;
    writeln!(out, "skin: {}", skin_name(recording))?;
    writeln!(out, "channels: {}", head.layout.channels())?;
    let calibrations = [("image", &head.calibration), ("forces", &head.forces)];
    for (what, _) in calibrations.iter().filter(|(_, text)| text.is_some()) {
        writeln!(out, "calibration: {what}")?;
    }
    writeln!(out, "frames: {}", found.frames)?;
    if let Some((first, last)) = found.numbers {
        let seconds = found.duration_s();
        writeln!(out, "numbers: {first} to {last}, {} missing in {} gaps", found.missing, found.gaps)?;
        writeln!(out, "duration: {seconds:.3} s, {:.1} frames/s", found.frames.saturating_sub(1) as f64 / seconds)?;
    }
    let damage = recording.damage();
    match recording.frames_dropped() {
        Some(dropped) => writeln!(out, "dropped while recording: {dropped}")?,
        None => writeln!(out, "dropped while recording: unknown")?,
    }
    if damage.is_none() {
        writeln!(out, "state: whole")?;
    } else {
        let end = if damage.cut_off { "the end is missing" } else { "the end is present" };
        let Damage { bytes, chunks, messages, .. } = damage;
        let frames = lost_frames(&damage);
        writeln!(
            out,
            "state: {end}; unreadable: {bytes} bytes, {chunks} chunks, {messages} messages, {frames} frames"
        )?;
    }
    if let Some(reason) = recording.stopped() {
        writeln!(out, "stopped: {reason}")?;
    } else if damage.cut_off {
        writeln!(out, "stopped: killed, or power was lost; {}", most_unwritten(found))?;
    }
    writeln!(out, "messages:")?;
    for (topic, count) in recording.counts() {
        writeln!(out, "  {topic:<24} {count}")?;
    }
    writeln!(out, "events:")?;
    for (seconds, event, detail) in &found.events {
        writeln!(out, "  {seconds:>9.3} s  {event}: {detail}")?;
    }
    Ok(())
}

fn print_json(recording: &Recording, found: &Findings, out: &mut dyn Write) -> anyhow::Result<()> {
    let (head, damage) = (recording.head(), recording.damage());
    let events: Vec<_> = found
        .events
        .iter()
        .map(|(time_s, event, detail)| json!({"time_s": time_s, "event": event, "detail": detail}))
        .collect();
    let lost = match damage.frames {
        LostFrames::Exactly(count) => json!(count),
        LostFrames::Unknown { .. } => json!(null),
    };
    let value = json!({
        "source": head.source,
        "skin": skin_name(recording),
        "channels": head.layout.channels(),
        "frames": found.frames,
        "first": found.numbers.map(|n| n.0),
        "last": found.numbers.map(|n| n.1),
        "gaps": found.gaps,
        "missing": found.missing,
        "duration_s": found.duration_s(),
        "dropped": recording.frames_dropped(),
        "whole": damage.is_none(),
        "stopped": recording.stopped(),
        "cut_off": damage.cut_off,
        "unreadable_bytes": damage.bytes,
        "unreadable_chunks": damage.chunks,
        "unreadable_messages": damage.messages,
        "unreadable_frames": lost,
        "messages": recording.counts().into_iter().collect::<BTreeMap<_, _>>(),
        "events": events,
    });
    serde_json::to_writer_pretty(&mut *out, &value)?;
    writeln!(out)?;
    Ok(())
}
