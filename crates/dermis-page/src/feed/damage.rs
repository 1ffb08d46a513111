//! Damage and baselines as listed on the page.

use dermis_live::stages::damage::DamageView as Known;
use dermis_touch::ReferenceOrigin;

use crate::update::{BaselineRow, DamageRow, DamageView, ProposalView};

/// Millimetres per metre.
const MM: f64 = 1e3;

/// Refills the damage shown on the page; `None` if the skin is not watched for damage.
pub(super) fn take(known: &Known<'_>, shown: &mut Option<DamageView>) {
    if !known.watched {
        *shown = None;
        return;
    }
    let for_s = |since_ns: u64| known.now_ns.saturating_sub(since_ns) as f64 * 1e-9;
    let shown = shown.get_or_insert_default();
    shown.list.clear();
    shown.list.extend(known.damages.iter().map(|damage| {
        DamageRow {
            id: damage.id,
            state: damage.state.name(),
            x_mm: damage.shape.centre_m[0] * MM,
            y_mm: damage.shape.centre_m[1] * MM,
            length_mm: damage.shape.length_m * MM,
            direction_deg: damage.shape.direction_rad.to_degrees(),
            ends_mm: damage.shape.ends_m().map(|end| end.map(|v| v * MM)),
            depth: damage.depth,
            // If the cut was fitted, the contact between its faces is tracked directly; the image would also show the
            // effects of heat.
            healed: known
                .healing
                .iter()
                .find(|state| state.id == damage.id)
                .map_or(1.0 - damage.share, |state| state.joined)
                .clamp(0.0, 1.0),
            for_s: for_s(damage.since_ns),
        }
    }));
    shown.baselines.clear();
    shown.baselines.extend(known.baselines.iter().map(|record| BaselineRow {
        origin: match record.origin {
            ReferenceOrigin::Startup => "start",
            ReferenceOrigin::Tare => "tare",
            ReferenceOrigin::ForcedTare => "forced tare",
            ReferenceOrigin::Given => "given",
            ReferenceOrigin::Damage => "damage taken in",
        },
        reason: record.reason.clone(),
        age_s: for_s(record.time_ns),
    }));
    shown.intact = known.intact;
    shown.proposal = known.proposal.map(|proposal| ProposalView {
        reason: proposal.reason.name(),
        for_s: for_s(proposal.since_ns),
        offset_sigma: proposal.offset_sigma,
    });
}
