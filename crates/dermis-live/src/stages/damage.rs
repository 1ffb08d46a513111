//! Damage in the live pipeline. Each frame is imaged a second time, against the intact skin, and
//! [`dermis_touch::damage`] detects damage in that image. Once damage is confirmed, touches are measured against a
//! baseline that includes it. The intact reference stays unchanged until no damage is left. If the skin has rested
//! for long enough at values other than its baseline's, a new baseline is proposed, never adopted automatically. On
//! skins that conduct less where they are pressed, damage is detected by levels instead.

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
