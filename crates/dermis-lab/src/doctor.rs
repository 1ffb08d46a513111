//! The examination behind `dermis doctor`. It runs a series of checks on frames of an untouched skin. Each answer
//! states in plain words what was found and what to do about it.

mod wiring;

use std::time::{Duration, Instant};

use dermis_device::{Frame, FrameTable, Layout, Source, SourceEvent};
use dermis_touch::health::{ChannelFaultKind, ElectrodeFaultKind, Health};
use serde::Serialize;

use crate::Error;
use crate::channel_search::{FoundOrder, find_order};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::{Modality, Skin};

/// Minimum number of frames to examine: enough for the baseline and for fault detection after it.
pub const FEWEST_FRAMES: u64 = 64;
/// Relative tolerance on the frame rate that the skin file states.
const RATE_SHARE: f64 = 0.1;
/// Largest noise that still allows touches, as a share of the largest reading.
const NOISE_SHARE: f64 = 0.01;
/// Channels are named as noisy if they exceed the median noise by this factor and are above a tenth of
/// [`NOISE_SHARE`].
const NOISY_TIMES: f64 = 10.0;
/// Minimum correlation of the baseline with the model.
const LEAST_CORRELATION: f64 = 0.9;
/// Largest mismatch of reciprocal channels: the median difference relative to their size.
const MOST_MISMATCH: f64 = 0.05;
/// Contacts are named if they exceed the median resistance by this factor.
const POOR_TIMES: f64 = 5.0;
/// Range that counts as a factor of a thousand, allowing for errors of conductance and current in the skin file.
const THOUSAND: [f64; 2] = [250.0, 4000.0];
/// Maximum number of channels named in one answer.
const MOST_NAMED: usize = 8;

/// Outcome of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// All is well.
    Good,
    /// Something is wrong.
    Bad,
    /// The check didn't apply.
    Skipped,
}

/// One check and its outcome.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// Outcome.
    pub answer: Answer,
    /// Finding.
    pub found: String,
    /// Advice; empty if nothing needs doing.
    pub advice: String,
}

impl Check {
    /// A check that passed.
    pub fn good(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, answer: Answer::Good, found: found.into(), advice: String::new() }
    }

    /// A check that failed, with advice.
    pub fn bad(name: &'static str, found: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { name, answer: Answer::Bad, found: found.into(), advice: advice.into() }
    }

    /// A check that didn't apply, with the reason.
    pub fn skipped(name: &'static str, found: impl Into<String>) -> Self {
        Self { name, answer: Answer::Skipped, found: found.into(), advice: String::new() }
    }
}

/// Data collected from the frames.
struct Seen {
    pipeline: Pipeline,
    layout: Layout,
    frames: u64,
    elapsed_s: f64,
    lost: u64,
    bad: u64,
    /// Channels that repeatedly shared the largest magnitude of a frame with other channels.
    at_end: Vec<usize>,
}

/// Examines up to `most` frames of a source, waiting up to `patience` for each, and returns the checks in the order in
/// which to read them.
///
/// The skin must not be touched. `contacts_ohm` holds the contact impedances measured by the instrument, if it can
/// measure them.
///
/// # Errors
/// The skin cannot be prepared. Problems of the source are reported as answers.
pub fn examine(
    skin: Skin,
    source: &mut dyn Source,
    most: u64,
    patience: Duration,
    contacts_ohm: Option<&[f32]>,
) -> Result<Vec<Check>, Error> {
    let prepared = Prepared::new(skin)?;
    let layout = source.layout().clone();
    let channels = prepared.channels();
    let pipeline = match Pipeline::new(prepared, &layout, None) {
        Ok(pipeline) => pipeline,
        Err(error) => {
            let advice = match &layout {
                Layout::Channels { count } if count + 1 == channels => {
                    "one reading of every frame is missing: look for a loop that ends one early, a column that was cut off, \
                     or a header that was taken for a frame"
                }
                _ => "give the skin file that belongs to this instrument, or set its protocol to the skin's",
            };
            return Ok(vec![Check::bad("channels", error.to_string(), advice)]);
        }
    };
    let mut seen = Seen { pipeline, layout, frames: 0, elapsed_s: 0.0, lost: 0, bad: 0, at_end: Vec::new() };
    let mut checks = Vec::new();
    let contacts = contact_impedance(&seen.pipeline.prepared().skin, contacts_ohm);
    if let Err(reason) = seen.watch(source, most.max(FEWEST_FRAMES), patience) {
        let advice = "check power, cable and whether another program has the port open; then run this again";
        checks.push(Check::bad("frames", reason, advice));
    }
    checks.push(seen.rate());
    if seen.pipeline.reference().is_none() {
        checks.push(contacts);
        checks.push(Check::skipped("everything else", format!("no baseline: {} frames arrived", seen.frames)));
        return Ok(checks);
    }
    checks.extend([seen.noise(), seen.saturation()]);
    checks.extend(seen.faults());
    checks.extend([seen.scale(), seen.reciprocity(), seen.order(), contacts]);
    Ok(checks)
}

impl Seen {
    /// Collects frames; returns the reason if there were too few.
    fn watch(&mut self, source: &mut dyn Source, most: u64, patience: Duration) -> Result<(), String> {
        let (mut frame, mut first_ns, mut last_ns) = (Frame::with_capacity(self.layout.channels()), None, 0);
        let (mut waited, mut largest) = (Instant::now(), 0.0);
        let mut ends: Vec<usize> = vec![0; self.pipeline.prepared().channels()];
        let outcome = loop {
            if self.frames >= most {
                break Ok(());
            }
            match source.next_frame(&mut frame, Duration::from_millis(100)) {
                Ok(SourceEvent::Frame) => {
                    waited = Instant::now();
                    let read_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
                    let first = *first_ns.get_or_insert(read_ns);
                    last_ns = read_ns.max(last_ns);
                    self.frames += 1;
                    self.elapsed_s = last_ns.saturating_sub(first) as f64 * 1e-9;
                    match self.pipeline.process(&frame, frame.host_monotonic_ns) {
                        Ok(output) => count_ends(&output.raw, &mut largest, &mut ends),
                        Err(error) => break Err(error.to_string()),
                    }
                }
                Ok(SourceEvent::Idle) if waited.elapsed() > patience => {
                    let problem = source.problem().unwrap_or_else(|| "no more frames arrived".into());
                    break Err(format!("{problem} ({} frames in all)", self.frames));
                }
                Ok(SourceEvent::Idle) => {}
                Ok(SourceEvent::End) => break Ok(()),
                Err(error) => break Err(error.to_string()),
            }
        };
        let counters = source.counters();
        (self.lost, self.bad) = (counters.lost, counters.bad);
        let often = |count: &usize| *count as u64 * 10 > self.frames;
        self.at_end = ends.iter().enumerate().filter(|(_, count)| often(count)).map(|(channel, _)| channel).collect();
        outcome
    }

    fn skin(&self) -> &Skin {
        &self.pipeline.prepared().skin
    }

    /// Channels by number and label, for a message.
    fn named(&self, channels: &[usize]) -> String {
        let prepared = self.pipeline.prepared();
        let name = |&channel: &usize| format!("{} ({})", channel + 1, prepared.protocol.channel_label(channel));
        let shown: Vec<String> = channels.iter().take(MOST_NAMED).map(name).collect();
        let more = channels.len().saturating_sub(MOST_NAMED);
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        let word = if channels.len() == 1 { "channel" } else { "channels" };
        format!("{word} {}{rest}", shown.join(", "))
    }

    fn rate(&self) -> Check {
        let per_s = self.frames.saturating_sub(1) as f64 / self.elapsed_s.max(f64::MIN_POSITIVE);
        if self.lost + self.bad > 0 {
            let found = format!("{per_s:.1} frames/s; {} frames lost, {} damaged on the way", self.lost, self.bad);
            let advice = "the log says what is wrong with damaged frames; if bytes are lost, use a shorter or shielded \
                          cable, a lower rate, or a separate port; \
                          for FTDI adapters set latency_timer to 1";
            return Check::bad("rate", found, advice);
        }
        match self.skin().backend.frames_per_s {
            Some(wanted) if (per_s / wanted - 1.0).abs() > RATE_SHARE && self.frames > 1 => Check::bad(
                "rate",
                format!("{per_s:.1} frames/s, where the skin file has {wanted:.1}"),
                "correct backend.frames_per_s, or the instrument's setting",
            ),
            _ => Check::good("rate", format!("{per_s:.1} frames/s, none lost")),
        }
    }

    fn noise(&self) -> Check {
        let (baseline, noise) = self.pipeline.baseline();
        let largest = baseline.iter().map(|v| v.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let mut sorted: Vec<f64> = noise.iter().copied().filter(|v| v.is_finite()).collect();
        sorted.sort_by(f64::total_cmp);
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN);
        let limit = (NOISY_TIMES * median).max(0.1 * NOISE_SHARE * largest);
        let noisy: Vec<usize> = (0..noise.len()).filter(|&c| noise[c] > limit).collect();
        let usual = format!("median {:.3} mV, {:.4} % of the largest reading", 1e3 * median, 100.0 * median / largest);
        if median > NOISE_SHARE * largest {
            let advice = "look for loose ground, a switching supply nearby, or too small a drive current; \
                          nothing may touch the skin while this runs";
            return Check::bad("noise", usual, advice);
        }
        if noisy.is_empty() {
            return Check::good("noise", usual);
        }
        let found = format!("{usual}; far noisier: {}", self.named(&noisy));
        Check::bad(
            "noise",
            found,
            "press the connectors of their electrodes; what they have in common is the likely cause",
        )
    }

    fn saturation(&self) -> Check {
        if self.at_end.is_empty() {
            return Check::good("saturation", "no reading at the converter's limit");
        }
        let found = format!("{} at the converter's limit", self.named(&self.at_end));
        Check::bad("saturation", found, "lower the gain or the drive current")
    }

    /// Electrode faults first, then faults of single channels.
    fn faults(&self) -> Vec<Check> {
        let health = self.pipeline.health();
        let word = if self.skin().modality == Modality::Mit { "coil" } else { "electrode" };
        let mut checks: Vec<Check> =
            health.electrodes.iter().filter_map(|fault| electrode_check(word, fault)).collect();
        for kind in [
            ChannelFaultKind::Missing,
            ChannelFaultKind::Saturated,
            ChannelFaultKind::Stuck,
            ChannelFaultKind::Dead,
            ChannelFaultKind::Noisy,
            ChannelFaultKind::Inconsistent,
        ] {
            checks.extend(self.channel_check(&health, kind));
        }
        if checks.is_empty() {
            checks.push(Check::good("electrodes", format!("every {word} and channel is alive")));
        }
        checks
    }

    fn channel_check(&self, health: &Health<'_>, kind: ChannelFaultKind) -> Option<Check> {
        let of_kind = health.channels.iter().filter(|fault| fault.kind == kind);
        let channels: Vec<usize> = of_kind.map(|fault| fault.channel as usize).collect();
        let (what, advice) = match kind {
            ChannelFaultKind::Missing => {
                ("without a value", "look at the instrument's own messages for these channels")
            }
            ChannelFaultKind::Saturated => ("at the converter's limit", "lower the gain or the drive current"),
            ChannelFaultKind::Stuck => (
                "that read the same, frame after frame",
                "restart the instrument; then suspect its multiplexer or firmware",
            ),
            ChannelFaultKind::Dead => {
                ("without signal", "look for a drive that carries no current, or a measuring line that is cut")
            }
            ChannelFaultKind::Noisy => ("far too noisy", "press the connectors of their electrodes"),
            _ => (
                "that contradict their reciprocal ones",
                "press the connectors of their electrodes, and keep hands off the skin while this runs",
            ),
        };
        (!channels.is_empty()).then(|| Check::bad("channels", format!("{} {what}", self.named(&channels)), advice))
    }

    fn reciprocity(&self) -> Check {
        let prepared = self.pipeline.prepared();
        let partners = prepared.protocol.reciprocal_channels();
        let (baseline, _) = self.pipeline.baseline();
        let left_out = self.pipeline.health();
        let good = |c: usize| !left_out.channels.iter().any(|fault| fault.channel as usize == c);
        let mut apart: Vec<f64> = (0..baseline.len())
            .filter_map(|c| partners[c].map(|(other, ratio)| (c, other as usize, ratio)))
            .filter(|&(c, other, _)| good(c) && good(other))
            .map(|(c, other, ratio)| (baseline[c] - ratio * baseline[other]).abs() / baseline[c].abs())
            .filter(|apart| apart.is_finite())
            .collect();
        if apart.is_empty() || prepared.skin.modality == Modality::Mit {
            return Check::skipped("reciprocity", "no two channels of this protocol are reciprocal");
        }
        apart.sort_by(f64::total_cmp);
        let median = apart[apart.len() / 2];
        let found = format!("reciprocal channels differ by {:.2} % (median)", 100.0 * median);
        if median > MOST_MISMATCH {
            let advice = "unless the channels are in another order (below), let each channel settle longer after switching, \
                          and compare the gains of the measuring lines";
            return Check::bad("reciprocity", found, advice);
        }
        Check::good("reciprocity", found)
    }

    /// Detects different units of readings and model: a factor of a thousand means millivolts read as volts, or the
    /// other way round.
    fn scale(&self) -> Check {
        const NAME: &str = "scale";
        let (prepared, (baseline, _)) = (self.pipeline.prepared(), self.pipeline.baseline());
        let mut ratios: Vec<f64> = baseline
            .iter()
            .zip(&prepared.voltages)
            .map(|(reading, model)| (reading / model).abs())
            .filter(|ratio| ratio.is_finite() && *ratio > 0.0)
            .collect();
        if ratios.is_empty() || !prepared.skin.backend.wiring.is_known() {
            return Check::skipped(NAME, "no readings to compare with the model");
        }
        let middle = ratios.len() / 2;
        let ratio = *ratios.select_nth_unstable_by(middle, f64::total_cmp).1;
        let found = format!("readings are {ratio:.3} times the model's (median)");
        let is_thousand = |ratio: f64| (THOUSAND[0]..THOUSAND[1]).contains(&ratio);
        if is_thousand(ratio) || is_thousand(1.0 / ratio) {
            let unit = if ratio > 1.0 { "millivolts read as volts" } else { "volts read as millivolts" };
            let advice =
                format!("a factor of about 1,000: these look like {unit}; name the columns with their unit, `ch1_mV`");
            return Check::bad(NAME, found, advice);
        }
        Check::good(NAME, found)
    }

    /// The lines of a skin file that describe the order of the readings, if the order is clear. Frames with more
    /// numbers than the skin has channels have already been reordered.
    fn order_lines(&self) -> Option<String> {
        let found = self.searched()?;
        let best = found.candidates.first().filter(|_| found.is_clear)?;
        Some(best.lines().trim_end().replace('\n', "; "))
    }

    /// Result of a search over all orders.
    fn searched(&self) -> Option<FoundOrder> {
        let Layout::Channels { count } = self.layout else { return None };
        let (rest, _) = self.pipeline.baseline();
        if count != rest.len() {
            return None;
        }
        let table = FrameTable::new(self.layout.clone(), rest.to_vec(), "baseline").ok()?;
        find_order(&table, Some(&self.pipeline.prepared().skin)).ok()
    }

    fn order(&self) -> Check {
        let Some(reference) = self.pipeline.reference() else {
            return Check::skipped("channel order", "no baseline");
        };
        let order = &reference.order;
        let stated = format!("the baseline correlates {:.3} with the model", order.correlation);
        if let Some(better) = &order.better {
            let found = format!("{stated}, but {:.3} with: {}", better.correlation, better.description);
            let advice = self.order_lines().map_or_else(
                || "change the order, start or sign in the skin file or the instrument".to_string(),
                |lines| format!("write this into [backend] of the skin file: {lines}"),
            );
            return Check::bad("channel order", found, advice);
        }
        if let Some(swap) = self.swapped(order.correlation) {
            let [a, b] = swap.electrodes.map(|e| e + 1);
            let found = format!("{stated}, but {:.3} with electrodes {a} and {b} swapped", swap.correlation);
            return Check::bad("channel order", found, format!("swap the wires of electrodes {a} and {b}"));
        }
        if order.correlation < LEAST_CORRELATION {
            let found = self.searched();
            if let Some(found) = &found
                && found.is_clear
                && let Some(best) = found.candidates.first()
            {
                let lines = best.lines().trim_end().replace('\n', "; ");
                let advice = format!("write this into [backend] of the skin file: {lines}");
                return Check::bad("channel order", format!("{stated}; {}", found.verdict()), advice);
            }
            let found = found.map_or(stated.clone(), |found| format!("{stated}; {}", found.verdict()));
            let advice = "check that skin file and instrument agree in electrodes and in every pair that drives and reads; \
                          a list of channels (backend.channels) can state any order";
            return Check::bad("channel order", found, advice);
        }
        Check::good("channel order", stated)
    }
}

/// Contacts that are open, or far more resistive than the rest.
fn contact_impedance(skin: &Skin, contacts_ohm: Option<&[f32]>) -> Check {
    const NAME: &str = "contact impedance";
    let Some(contacts_ohm) = contacts_ohm else {
        return Check::skipped(
            NAME,
            match skin.modality {
                Modality::Mit => "coils have none",
                Modality::Eit => "this instrument does not report it; lost electrodes are found by their channels",
            },
        );
    };
    let mut sorted: Vec<f32> = contacts_ohm.iter().copied().filter(|ohm| ohm.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let Some(median) = sorted.get(sorted.len() / 2).copied() else {
        return Check::bad(NAME, "every electrode is open", "look at the cable between skin and instrument");
    };
    let listed = |is_poor: &dyn Fn(f32) -> bool| {
        let numbers = (1..).zip(contacts_ohm).filter(|(_, ohm)| is_poor(**ohm)).map(|(number, _): (usize, _)| number);
        numbers.map(|number| number.to_string()).collect::<Vec<_>>().join(", ")
    };
    let open = listed(&|ohm| !ohm.is_finite());
    let poor = listed(&|ohm| ohm.is_finite() && f64::from(ohm) > POOR_TIMES * f64::from(median));
    let usual = format!("median {median:.1} ohm of {} electrodes", contacts_ohm.len());
    match (open.as_str(), poor.as_str()) {
        ("", "") => Check::good(NAME, usual),
        (open, "") => {
            Check::bad(NAME, format!("{usual}; open: {open}"), format!("fasten electrode {open} and its wire"))
        }
        ("", poor) => {
            let found = format!("{usual}; more than {POOR_TIMES} times that: {poor}");
            Check::bad(NAME, found, format!("clean, wet or tighten electrode {poor}"))
        }
        (open, poor) => Check::bad(
            NAME,
            format!("{usual}; open: {open}; more than {POOR_TIMES} times that: {poor}"),
            format!("fasten electrode {open} and its wire; clean, wet or tighten electrode {poor}"),
        ),
    }
}

fn electrode_check(word: &str, fault: &dermis_touch::health::ElectrodeFault) -> Option<Check> {
    let number = fault.electrode + 1;
    match fault.kind {
        ElectrodeFaultKind::Lost => Some(Check::bad(
            "electrodes",
            format!("{word} {number} is lost: its channels are dead or wild"),
            format!("fasten {word} {number} and its wire; until then the skin works without it"),
        )),
        // Report each pair once.
        ElectrodeFaultKind::Shorted { with } if with > fault.electrode => Some(Check::bad(
            "electrodes",
            format!("{word}s {number} and {} are shorted", with + 1),
            format!("look for solder, water or a crushed cable between {word}s {number} and {}", with + 1),
        )),
        ElectrodeFaultKind::Shorted { .. } => None,
    }
}

/// Counts saturated channels. A converter's limit shows as a largest magnitude that at least two channels share
/// exactly and that is unchanged since the frame before (kept in `last`).
fn count_ends(raw: &[f64], last: &mut f64, ends: &mut [usize]) {
    let largest = raw.iter().map(|v| v.abs()).filter(|v| v.is_finite()).fold(0.0, f64::max);
    let before = std::mem::replace(last, largest);
    let at_end = |v: &f64| largest > 0.0 && v.abs() == largest;
    if before == largest && raw.iter().filter(|v| at_end(v)).count() >= 2 {
        raw.iter().zip(ends).filter(|(v, _)| at_end(v)).for_each(|(_, count)| *count += 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faulty_contacts_are_named_with_their_fault() {
        let skin = Skin::open("healing-square").unwrap();
        let of = |ohms: &[f32]| contact_impedance(&skin, Some(ohms));
        assert_eq!(of(&[2.0, 3.0, 2.5]).answer, Answer::Good);
        let check = of(&[2.0, f32::NAN, 2.5, 30.0, 2.2, f32::INFINITY]);
        assert_eq!(check.answer, Answer::Bad);
        assert!(check.found.contains("open: 2, 6; more than 5 times that: 4"), "{}", check.found);
        assert_eq!(of(&[f32::NAN; 4]).found, "every electrode is open");
        assert_eq!(contact_impedance(&skin, None).answer, Answer::Skipped);
    }
}
