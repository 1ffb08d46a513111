//! The part of a line that describes damage.

use std::fmt::Write as _;

use dermis_touch::damage::{Damage, DamageState};

use super::number::{Number, push_since};
use dermis_live::stages::damage::DamageView;

/// Appends the known damage, if there is any news. Suspected damage is left out.
pub(super) fn push_damage(text: &mut String, view: &DamageView<'_>) {
    if view.is_silent() {
        return;
    }
    // Writing to a String cannot fail.
    text.push_str(",\"damage\":{\"list\":[");
    let told = view.damages.iter().filter(|damage| damage.state != DamageState::Suspected);
    for (index, damage) in told.enumerate() {
        push_one(text, damage, index > 0);
    }
    text.push_str("],\"events\":[");
    for (index, event) in view.events.iter().enumerate() {
        let comma = if index > 0 { "," } else { "" };
        let _ = write!(text, "{comma}{{\"id\":{},\"event\":\"{}\"}}", event.damage().id, event.name());
    }
    let _ = write!(text, "],\"baselines\":{}", view.baselines.len());
    if let Some(intact) = view.intact {
        let _ = write!(text, ",\"intact\":{}", intact + 1);
    }
    if let Some(proposal) = view.proposal {
        let (reason, offset) = (proposal.reason.name(), Number(proposal.offset_sigma));
        let _ = write!(text, ",\"proposal\":{{\"reason\":\"{reason}\",\"offset_sigma\":{offset}");
        push_since(text, proposal.since_ns);
    }
    text.push('}');
}

fn push_one(text: &mut String, damage: &Damage, comma: bool) {
    let comma = if comma { "," } else { "" };
    let shape = &damage.shape;
    let _ = write!(text, "{comma}{{\"id\":{},\"state\":\"{}\"", damage.id, damage.state.name());
    let fields = [
        ("x_mm", 1e3 * shape.centre_m[0]),
        ("y_mm", 1e3 * shape.centre_m[1]),
        ("length_mm", 1e3 * shape.length_m),
        ("width_mm", 1e3 * shape.width_m),
        ("direction_deg", shape.direction_rad.to_degrees()),
        ("depth", damage.depth),
        ("share", damage.share),
        ("significance", damage.significance),
    ];
    for (name, value) in fields {
        let _ = write!(text, ",\"{name}\":{}", Number(value));
    }
    if let Some([x, y, length, _]) = shape.deviations {
        let [x, y, length] = [x, y, length].map(|metres| Number(1e3 * metres));
        let _ = write!(text, ",\"sigma_mm\":[{x},{y},{length}]");
    }
    let confirmed_ns = damage.confirmed_ns;
    let (seconds, nanoseconds) = (confirmed_ns / 1_000_000_000, confirmed_ns % 1_000_000_000);
    let _ = write!(text, ",\"confirmed_s\":{seconds}.{nanoseconds:09}");
    push_since(text, damage.since_ns);
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::output;
    use super::super::{JsonLines, LinesFor, Sink};
    use super::*;
    use dermis_live::output::Output;
    use dermis_live::stages::damage::{Proposal, ProposalReason};
    use dermis_touch::damage::{DamageEvent, DamageShape};
    use serde_json::{Value, json};

    #[test]
    fn damage_is_reported_in_millimetres_and_degrees() {
        let shape = DamageShape {
            centre_m: [0.0125, -0.025],
            length_m: 0.0,
            width_m: 0.0,
            direction_rad: 0.0,
            deviations: Some([0.0005, 0.00025, 0.001, 0.1]),
        };
        let damage = Damage {
            id: 3,
            state: DamageState::Confirmed,
            shape,
            depth: 0.25,
            volume_m2: 1e-4,
            share: 1.0,
            significance: 20.0,
            since_ns: 2_500_000_000,
            confirmed_ns: 4_000_000_000,
        };
        let suspected = Damage { id: 4, state: DamageState::Suspected, ..damage };
        let (damages, events) = ([damage, suspected], [DamageEvent::Begin(damage)]);
        let proposal = Some(Proposal { reason: ProposalReason::Offset, since_ns: 3_000_000_000, offset_sigma: 1.5 });
        let view = DamageView {
            watched: true,
            damages: &damages,
            events: &events,
            intact: Some(0),
            proposal,
            ..DamageView::default()
        };
        let line = |view, lines_for| {
            let mut bytes = Vec::new();
            let output = Output { damage: view, ..output(1, &[0.0; 6], &[], &[]) };
            JsonLines::new(&mut bytes, "test", lines_for).accept(&output).unwrap();
            bytes
        };
        let found: Value = serde_json::from_slice(&line(view, LinesFor::Touches)).unwrap();
        let expected = json!({"list": [{"id": 3, "state": "confirmed", "x_mm": 12.5, "y_mm": -25.0, "length_mm": 0,
            "width_mm": 0, "direction_deg": 0, "depth": 0.25, "share": 1, "significance": 20, "sigma_mm": [0.5, 0.25, 1],
            "confirmed_s": 4.0, "since_s": 2.5}], "events": [{"id": 3, "event": "begin"}], "baselines": 0, "intact": 1,
            "proposal": {"reason": "offset", "offset_sigma": 1.5, "since_s": 3.0}});
        assert_eq!(found["damage"].to_string().len(), found["damage"].to_string().len());
        let numbers = |value: &Value| value.to_string().replace(".0,", ",").replace(".0]", "]").replace(".0}", "}");
        assert_eq!(numbers(&found["damage"]), numbers(&expected));
        let silent = DamageView { damages: &damages[1..], ..DamageView::default() };
        let found: Value = serde_json::from_slice(&line(silent, LinesFor::EveryFrame)).unwrap();
        assert!(found.get("damage").is_none(), "a suspicion is not told");
        assert!(line(silent, LinesFor::Touches).is_empty());
    }
}
