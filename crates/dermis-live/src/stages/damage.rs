//! Damage in the live pipeline: each frame is imaged a second time, against the intact skin, and
//! [`dermis_touch::damage`] tells from that image what is damaged. Once a damage is believed, touches are found against
//! a baseline that includes it; the intact reference stays as it was until nothing is damaged any more. When the skin
//! has rested for long enough at other values than its baseline's, a new baseline is proposed, never taken. Of skins
//! that conduct less where they are pressed, damage is told by levels instead.

mod crack;
mod cuts;
mod fit;
mod frame;
mod healing;
mod intact;
mod levels;
mod readings;
mod release_test;
mod rest;
mod stage;
mod unexplained;
mod view;
mod warmth;

pub use crack::{Crack, CrackModel, CrackScratch};
pub use fit::{CutEstimate, estimate_cut};
pub(crate) use frame::{DamageDecision, DamageFrame};
pub use healing::Healing;
pub(crate) use levels::LevelStage;
pub(crate) use stage::{DamageStage, lobe_floor};
pub use view::{DamageView, Proposal, ProposalReason, describe};
