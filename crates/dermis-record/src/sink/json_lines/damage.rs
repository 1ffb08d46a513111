//! The part of a line that describes damage.

use dermis_live::stages::damage::DamageView;
use dermis_touch::damage::{Damage, DamageEvent, DamageState};
use serde::Serialize;

use super::each::{Each, seconds};

/// Known damage. Suspected damage is left out. Times are on the pipeline's clock.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub(super) struct DamageObject<'a> {
    #[cfg_attr(test, schemars(with = "Vec<Known>"))]
    list: Each<'a, Damage, Known>,
    #[cfg_attr(test, schemars(with = "Vec<News>"))]
    events: Each<'a, DamageEvent, News>,
    /// Number of baselines taken.
    baselines: usize,
    /// The baseline of the intact skin, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    intact: Option<usize>,
    /// A new baseline is proposed.
    #[serde(skip_serializing_if = "Option::is_none")]
    proposal: Option<Proposed>,
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Known {
    id: u64,
    state: &'static str,
    /// Centre.
    x_mm: f64,
    y_mm: f64,
    length_mm: f64,
    width_mm: f64,
    direction_deg: f64,
    depth: f64,
    /// Share that remains.
    share: f64,
    significance: f64,
    /// Standard deviations of x, y and length, if a model was fitted.
    #[serde(skip_serializing_if = "Option::is_none")]
    sigma_mm: Option<[f64; 3]>,
    confirmed_s: f64,
    since_s: f64,
}

impl Known {
    fn of(damage: &Damage) -> Option<Self> {
        let shape = &damage.shape;
        let known = Self {
            id: damage.id,
            state: damage.state.name(),
            x_mm: 1e3 * shape.centre_m[0],
            y_mm: 1e3 * shape.centre_m[1],
            length_mm: 1e3 * shape.length_m,
            width_mm: 1e3 * shape.width_m,
            direction_deg: shape.direction_rad.to_degrees(),
            depth: damage.depth,
            share: damage.share,
            significance: damage.significance,
            sigma_mm: shape.deviations.map(|[x, y, length, _]| [x, y, length].map(|metres| 1e3 * metres)),
            confirmed_s: seconds(damage.confirmed_ns),
            since_s: seconds(damage.since_ns),
        };
        (damage.state != DamageState::Suspected).then_some(known)
    }
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct News {
    id: u64,
    event: &'static str,
}

#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
struct Proposed {
    reason: &'static str,
    offset_sigma: f64,
    since_s: f64,
}

impl<'a> DamageObject<'a> {
    /// `None` if there is no news.
    pub fn of(view: &'a DamageView<'a>) -> Option<Self> {
        let news = |event: &DamageEvent| Some(News { id: event.damage().id, event: event.name() });
        let proposed = |proposal: dermis_live::stages::damage::Proposal| Proposed {
            reason: proposal.reason.name(),
            offset_sigma: proposal.offset_sigma,
            since_s: seconds(proposal.since_ns),
        };
        (!view.is_silent()).then(|| Self {
            list: Each(&view.damages, Known::of),
            events: Each(&view.events, news),
            baselines: view.baselines.len(),
            intact: view.intact.map(|intact| intact + 1),
            proposal: view.proposal.map(proposed),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::testing::output;
    use super::super::{JsonLines, LinesFor, Sink};
    use super::*;
    use dermis_live::skin_frame::SkinFrame;
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
            damages: (&damages).into(),
            events: (&events).into(),
            intact: Some(0),
            proposal,
            ..DamageView::default()
        };
        let line = |view, lines_for| {
            let mut bytes = Vec::new();
            let output = SkinFrame { damage: view, ..output(1, &[0.0; 6], &[], &[]) };
            JsonLines::new(&mut bytes, "test", lines_for).accept(&output).unwrap();
            bytes
        };
        let found: Value = serde_json::from_slice(&line(view, LinesFor::Touches)).unwrap();
        let expected = json!({"list": [{"id": 3, "state": "confirmed", "x_mm": 12.5, "y_mm": -25.0, "length_mm": 0,
            "width_mm": 0, "direction_deg": 0, "depth": 0.25, "share": 1, "significance": 20, "sigma_mm": [0.5, 0.25, 1],
            "confirmed_s": 4.0, "since_s": 2.5}], "events": [{"id": 3, "event": "begin"}], "baselines": 0, "intact": 1,
            "proposal": {"reason": "offset", "offset_sigma": 1.5, "since_s": 3.0}});
        let numbers = |value: &Value| value.to_string().replace(".0,", ",").replace(".0]", "]").replace(".0}", "}");
        assert_eq!(numbers(&found["damage"]), numbers(&expected));
        let silent = DamageView { damages: (&damages[1..]).into(), ..DamageView::default() };
        let found: Value = serde_json::from_slice(&line(silent.clone(), LinesFor::EveryFrame)).unwrap();
        assert!(found.get("damage").is_none(), "a suspicion is not told");
        assert!(line(silent, LinesFor::Touches).is_empty());
    }
}
