//! Knowledge about damage and baselines in a frame, for users of the pipeline.

use std::borrow::Cow;

use dermis_touch::ReferenceRecord;
use dermis_touch::damage::{Damage, DamageEvent, DamageState};

use super::healing::Healing;

/// Reason for proposing a new baseline.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProposalReason {
    /// The skin rests at values other than its baseline's.
    Offset,
    /// The same, after damage has healed or once it heals no further.
    Healed,
    /// The baseline was taken while something touched the skin that is now gone.
    Touched,
}

impl ProposalReason {
    /// Name of the reason in files and streams.
    pub fn name(self) -> &'static str {
        match self {
            Self::Offset => "offset",
            Self::Healed => "healed",
            Self::Touched => "touched",
        }
    }
}

/// A proposal of a new baseline: the skin has rested, without touch and without change of damage. Only a tare adopts
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Proposal {
    /// The reason.
    pub reason: ProposalReason,
    /// Start of the rest, or time when the reason became known, on the frames' time axis, nanoseconds.
    pub since_ns: u64,
    /// Distance of the readings from the baseline, in standard deviations of the channels (RMS).
    pub offset_sigma: f64,
}

/// Everything known about damage and baselines in a frame. Empty if damage is not monitored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DamageView<'a> {
    /// True if damage is monitored and there is a baseline.
    pub watched: bool,
    /// Time of the frame on the axis of all times here, nanoseconds.
    pub now_ns: u64,
    /// All damage sites, including suspected and healed ones.
    pub damages: Cow<'a, [Damage]>,
    /// Their events in this frame.
    pub events: Cow<'a, [DamageEvent]>,
    /// The image against the intact skin, in the form of touch images; empty if not monitored.
    pub image: Cow<'a, [f32]>,
    /// All baselines used, oldest first; the last is current.
    pub baselines: Cow<'a, [ReferenceRecord]>,
    /// Index of the baseline that damage is judged against.
    pub intact: Option<usize>,
    /// Healing of the fitted cuts.
    pub healing: Cow<'a, [Healing]>,
    /// The proposed baseline, if any.
    pub proposal: Option<Proposal>,
    /// Relative change of all readings since the start that was followed as drift.
    pub drift: f64,
}

impl DamageView<'_> {
    /// The same view, in memory of its own.
    pub fn into_owned(self) -> DamageView<'static> {
        DamageView {
            damages: Cow::Owned(self.damages.into_owned()),
            events: Cow::Owned(self.events.into_owned()),
            image: Cow::Owned(self.image.into_owned()),
            baselines: Cow::Owned(self.baselines.into_owned()),
            healing: Cow::Owned(self.healing.into_owned()),
            ..self
        }
    }

    /// True if there is nothing to report: no damage, event or proposal.
    pub fn is_silent(&self) -> bool {
        self.damages.iter().all(|damage| damage.state == DamageState::Suspected)
            && self.events.is_empty()
            && self.proposal.is_none()
    }
}

/// Description of an event for users: `damage 1 (20 mm at 23, 24 mm, 37 degrees) is covered by a touch`.
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
