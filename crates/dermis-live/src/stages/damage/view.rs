//! What is known of damage and baselines in a frame, for what comes after the pipeline.

use dermis_touch::ReferenceRecord;
use dermis_touch::damage::{Damage, DamageEvent, DamageState};

use super::healing::Healing;

/// Why a new baseline is proposed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProposalReason {
    /// The skin rests at other values than its baseline's.
    Offset,
    /// So it does, after damage has healed or while it heals no further.
    Healed,
    /// The baseline was taken while something touched the skin, which has gone since.
    Touched,
}

impl ProposalReason {
    /// The word for it in files and streams.
    pub fn name(self) -> &'static str {
        match self {
            Self::Offset => "offset",
            Self::Healed => "healed",
            Self::Touched => "touched",
        }
    }
}

/// A new baseline would do the skin good: it has rested, without touch and without change of damage. Taking it is left
/// to a tare.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// Why.
    pub reason: ProposalReason,
    /// Since when the skin has rested, or since when the reason has been known, on the frames' axis, nanoseconds.
    pub since_ns: u64,
    /// How far the readings are from the baseline, in standard deviations of the channels (root mean square).
    pub offset_sigma: f64,
}

/// All that is known of damage and baselines in a frame. Empty where damage is not watched.
#[derive(Clone, Copy, Debug, Default)]
pub struct DamageView<'a> {
    /// True where damage is watched and there is a baseline.
    pub watched: bool,
    /// Time of the frame on the axis that all times here are on, nanoseconds.
    pub now_ns: u64,
    /// All damages, suspected and healed ones included.
    pub damages: &'a [Damage],
    /// What happened to them in this frame.
    pub events: &'a [DamageEvent],
    /// The image against the intact skin, as the image of touches; empty where not watched.
    pub image: &'a [f32],
    /// Baselines that were in use, oldest first; the last is in use now.
    pub baselines: &'a [ReferenceRecord],
    /// Which of them damage is judged against.
    pub intact: Option<usize>,
    /// How far the fitted cuts have healed.
    pub healing: &'a [Healing],
    /// A new baseline is proposed.
    pub proposal: Option<Proposal>,
    /// Change of the readings as a whole since the start that was followed as drift, a share.
    pub drift: f64,
}

impl DamageView<'_> {
    /// True where there is nothing to tell: no damage, event or proposal.
    pub fn is_silent(&self) -> bool {
        self.damages.iter().all(|damage| damage.state == DamageState::Suspected)
            && self.events.is_empty()
            && self.proposal.is_none()
    }
}

/// What happened to a damage, for people: `damage 1 (20 mm at 23, 24 mm, 37 degrees) is covered by a touch`.
pub fn describe(event: &DamageEvent) -> String {
    let damage = event.damage();
    let shape = &damage.shape;
    let [x_mm, y_mm] = shape.centre_m.map(|metres| 1e3 * metres);
    let (length_mm, degrees) = (1e3 * shape.length_m, shape.direction_rad.to_degrees());
    let left = 100.0 * damage.share;
    let what = match event {
        DamageEvent::Begin(_) => "is new".to_owned(),
        DamageEvent::Update(_) if damage.state == DamageState::Healing => format!("heals, {left:.0} % of it is left"),
        DamageEvent::Update(_) => "has grown or opened again".to_owned(),
        DamageEvent::Covered(_) => "is covered by a touch".to_owned(),
        DamageEvent::Uncovered(_) => "is free again".to_owned(),
        DamageEvent::Healed(_) => format!("is healed, {left:.0} % of it is left"),
    };
    format!("damage {} ({length_mm:.0} mm at {x_mm:.0}, {y_mm:.0} mm, {degrees:.0} degrees) {what}", damage.id)
}
