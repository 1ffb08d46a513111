//! The words that fields of messages may have, for their schemas. Used only by tests.

use dermis_live::stages::damage::ProposalReason;
use dermis_touch::damage::DamageState;
use dermis_touch::force::ForceReading;
use dermis_touch::guard::GuardVerdict;
use dermis_touch::health::{ChannelFaultKind, FrameFaultKind};
use schemars::{Schema, SchemaGenerator, json_schema};

fn one_of(words: &[&str]) -> Schema {
    json_schema!({ "type": "string", "enum": words })
}

pub fn damage_states(_: &mut SchemaGenerator) -> Schema {
    use DamageState::{Confirmed, Covered, Healed, Healing, Suspected};
    one_of(&[Suspected, Confirmed, Covered, Healing, Healed].map(DamageState::name))
}

/// Faults of electrodes, then those of channels.
pub fn faults(_: &mut SchemaGenerator) -> Schema {
    use ChannelFaultKind::{Dead, Inconsistent, Missing, Noisy, Saturated, Stuck};
    let channels = [Inconsistent, Noisy, Dead, Stuck, Saturated, Missing].map(ChannelFaultKind::name);
    one_of(&[&["lost", "shorted"], &channels[..]].concat())
}

pub fn frame_faults(_: &mut SchemaGenerator) -> Schema {
    use FrameFaultKind::{Blank, Flipped, Frozen, OutOfRange, Saturated};
    one_of(&[Frozen, Saturated, Flipped, OutOfRange, Blank].map(FrameFaultKind::name))
}

/// A word or nothing.
pub fn force_ranges(_: &mut SchemaGenerator) -> Schema {
    use ForceReading::{AboveRange, BelowRange, FromLaw, NotFinite, Saturated, Valid};
    let (force_n, sigma_n) = (0.0, 0.0);
    let within = [Valid { force_n, sigma_n }, BelowRange { least_n: 0.0 }, AboveRange { most_n: 0.0 }];
    let others = [Saturated { from_n: 0.0 }, FromLaw { force_n, sigma_n }, NotFinite];
    let words = within.into_iter().chain(others).map(|force| Some(force.range()));
    let words: Vec<Option<&str>> = words.chain([None]).collect();
    json_schema!({ "type": ["string", "null"], "enum": words })
}

pub fn proposal_reasons(_: &mut SchemaGenerator) -> Schema {
    use ProposalReason::{Healed, Offset, Touched};
    one_of(&[Offset, Healed, Touched].map(ProposalReason::name))
}

pub fn guard_verdicts(_: &mut SchemaGenerator) -> Schema {
    one_of(&[GuardVerdict::Ok, GuardVerdict::Stale, GuardVerdict::Stop].map(GuardVerdict::name))
}
