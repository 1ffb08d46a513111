//! Damage in the live pipeline: each frame is imaged a second time, against the intact skin, and
//! [`dermis_touch::damage`] tells from that image what is damaged. Once a damage is believed, touches are found against a
//! baseline that includes it; the intact reference stays as it was until nothing is damaged any more. When the skin has
//! rested for long enough at other values than its baseline's, a new baseline is proposed, never taken.

mod crack;
mod fit;
mod healing;
mod released;
mod stage;

use dermis_touch::ReferenceRecord;
use dermis_touch::damage::{Damage, DamageEvent, DamageShape, DamageState};

use crate::Error;
use crate::prepare::Prepared;
use crate::skin::Modality;

pub use crack::{Crack, CrackModel, CrackScratch};
pub use fit::CutEstimate;
pub use healing::Healing;
pub(crate) use stage::{DamageInput, DamageStage};

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

/// A new baseline would do the skin good: it has rested, without touch and without change of damage. Taking it is left to
/// a tare.
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
pub fn told(event: &DamageEvent) -> String {
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

/// Fits a cut to difference data against the intact skin (model volts, NaN where missing, of standard deviations `noise`):
/// its middle, direction and length with their covariance. `start` is where the image has it. None where none fits.
///
/// # Errors
/// Data or noise of another length than the skin's channels.
pub fn estimate_cut(
    prepared: &Prepared,
    model: &CrackModel,
    difference: &[f64],
    noise: &[f64],
    start: &DamageShape,
) -> Result<Option<CutEstimate>, Error> {
    let channels = prepared.channels();
    for (what, values) in [("difference data", difference), ("noise", noise)] {
        if values.len() != channels {
            let (expected, got) = (format!("{channels} values"), values.len().to_string());
            return Err(Error::Frames { what: what.into(), expected, got });
        }
    }
    let data = fit::CutData { model, difference, noise, rest: &prepared.voltages };
    // The image's middle is off by up to half a cut's length and some.
    Ok(fit::fit(&data, start.centre_m, 0.4 * prepared.half_width_m(), 0.0))
}

/// The shape of a fitted cut.
pub fn shape_of(estimate: &CutEstimate) -> DamageShape {
    let Crack { centre_m, length_m, direction_rad, .. } = estimate.crack;
    DamageShape { centre_m, length_m, width_m: 0.0, direction_rad, deviations: Some(estimate.deviations()) }
}

impl Prepared {
    /// Whether cuts can be fitted: on flat sheets that electrodes read as they are.
    fn has_cracks(&self) -> bool {
        self.skin.modality == Modality::Eit && self.skin.backend.circuit.is_none() && self.skin.frontend.bend.is_none()
    }
}
