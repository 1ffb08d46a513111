//! Events of a running pipeline: gaps, faults and recoveries, damage, new verdicts of the guard, results of a search
//! for the readout's circuit.

use dermis_device::Frame;
use dermis_live::skin_frame::SkinFrame;
use dermis_live::stages::health::HealthWatch;
use dermis_skin::Skin;
use dermis_touch::damage::DamageEvent;
use dermis_touch::guard::{GuardReason, GuardReport, GuardVerdict};

/// Event of missing frames; its number is their count.
pub(crate) const GAP: &str = "gap";

/// Finds the events in a stream of frames and their results. Each event goes to a closure that takes its name, a
/// description and its numbers.
#[derive(Debug)]
pub(crate) struct EventWatch {
    last_sequence: Option<u64>,
    health: HealthWatch,
    /// The guard's last verdict.
    verdict: Option<GuardVerdict>,
}

impl EventWatch {
    /// A watch that has seen no frame.
    pub fn new(skin: &Skin) -> Self {
        Self { last_sequence: None, health: HealthWatch::new(skin), verdict: None }
    }

    /// Takes a raw frame. A gap in the sequence numbers is an event.
    pub fn frame(&mut self, frame: &Frame, mut tell: impl FnMut(&str, &str, &[f64])) {
        let missing = self.last_sequence.map_or(0, |last| frame.sequence.saturating_sub(last).saturating_sub(1));
        if missing > 0 {
            let detail = format!("{missing} frames missing before frame {}", frame.sequence);
            tell(GAP, &detail, &[missing as f64]);
        }
        self.last_sequence = Some(frame.sequence);
    }

    /// Takes a frame's results. The first call also reports earlier faults and the current verdict.
    pub fn results(&mut self, output: &SkinFrame<'_>, mut tell: impl FnMut(&str, &str, &[f64])) {
        for event in output.damage.events.iter() {
            let (name, detail, values) = damage_event(event);
            tell(name, &detail, &values);
        }
        for change in self.health.changes(&output.health) {
            tell(change.event, &change.detail, &change.numbers);
        }
        if let Some(report) = output.guard.filter(|report| self.verdict != Some(report.verdict)) {
            self.verdict = Some(report.verdict);
            tell("guard", &verdict_text(&report), &[output.sequence as f64]);
        }
        if let Some(news) = output.circuit {
            let numbers = [news.fit.score_before, news.fit.score, news.fit.frames as f64];
            tell("circuit", &news.describe(), &numbers);
        }
    }
}

/// A guard's verdict with its reasons: `stop: force`.
fn verdict_text(report: &GuardReport) -> String {
    let reasons: Vec<&str> = report.reasons.iter().map(GuardReason::name).collect();
    let name = report.verdict.name();
    if reasons.is_empty() { name.to_owned() } else { format!("{name}: {}", reasons.join(", ")) }
}

/// The fields of a damage event: its name, a description, and id, x, y, length (metres), direction (radians), depth
/// and remaining share.
fn damage_event(event: &DamageEvent) -> (&'static str, String, [f64; 7]) {
    let damage = event.damage();
    let shape = &damage.shape;
    let [x, y] = shape.centre_m;
    let name = match event {
        DamageEvent::Begin(_) => "damage-begin",
        DamageEvent::Update(_) => "damage-update",
        DamageEvent::Covered(_) => "damage-covered",
        DamageEvent::Uncovered(_) => "damage-uncovered",
        DamageEvent::Healed(_) => "damage-healed",
    };
    let values = [damage.id as f64, x, y, shape.length_m, shape.direction_rad, damage.depth, damage.share];
    (name, dermis_live::stages::damage::describe(event), values)
}
