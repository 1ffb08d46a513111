//! Warmth around damage: heat heals, and makes the sheet more conductive, which looks like a touch. A change there
//! that has developed steadily, or that stays low for long, is warmth and belongs in the baseline.

use dermis_tomo::mesh::{Point, distance};
use dermis_touch::Touch;
use dermis_touch::damage::Damage;

use super::frame::{Adoption, DamageFrame};
use super::readings::Readings;

/// Interval between estimates of healing, seconds.
const HEALING_S: f64 = 0.5;
/// A contact on damage that stays this long, no higher than `WARM_HEIGHT` in the image and within `WARM_TRAVEL_M`,
/// is warmth rather than touch. Published indenters reach 0.7 and more on a cut.
const WARM_S: f64 = 20.0;
const WARM_HEIGHT: f64 = 0.45;
const WARM_TRAVEL_M: f64 = 3e-3;
/// Maximum distance from the damage, metres. A contact that stays there this long and begins no touch is warmth too.
const WARM_REACH_M: f64 = 20e-3;
/// A change that developed steadily is warmth too, whatever its height and movement. Between two looks
/// ([`HEALING_S`]) the readings must change by less than this share of the open cut's response. A press develops
/// within one interval.
const STEADY: f64 = 0.25;

/// Data for the next estimate of healing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Look {
    /// No estimate in this frame.
    None,
    /// The mean readings of the free skin.
    Free,
    /// The readings of a steady change around the damage: [`Warmth::course`].
    Course,
}

/// A contact that rests on damage.
#[derive(Debug)]
struct Resting {
    at_m: Point,
    since_ns: u64,
    readings: Readings,
}

/// A change that has developed steadily around damage.
#[derive(Debug, Default)]
struct Course {
    since_ns: u64,
    readings: Readings,
    /// Change against the intact skin at the last look, model volts.
    last: Vec<f64>,
    /// True if it continued unsteadily, or elsewhere.
    broken: bool,
}

impl Course {
    /// Starts a new course with the current load.
    fn restart(&mut self, time_ns: u64) {
        (self.since_ns, self.readings.frames, self.broken) = (time_ns, 0, false);
    }

    /// True if a change is close to the last look's, compared with a change whose sum of squares is `square`.
    fn goes_on(&self, change: &[f64], square: f64) -> bool {
        if self.last.len() != change.len() {
            return false;
        }
        let both = change.iter().zip(&self.last).map(|(now, last)| now - last);
        let moved: f64 = both.filter(|moved| moved.is_finite()).map(|moved| moved * moved).sum();
        moved <= STEADY * STEADY * square
    }
}

/// Detects warmth.
#[derive(Debug, Default)]
pub(super) struct Warmth {
    resting: Option<Resting>,
    course: Course,
    looked_ns: u64,
}

impl Warmth {
    /// Collects readings while something lies on damage and nowhere else.
    pub fn gather(&mut self, frame: &DamageFrame<'_>, damages: &[Damage]) {
        if !frame.loaded {
            self.course.restart(frame.time_ns);
            return;
        }
        let places = frame.touches.iter().map(|touch| touch.position_m);
        let mut places = places.chain(frame.contacts.iter().map(|contact| contact.centroid_m));
        self.course.broken |= !places.all(|at_m| lies_on_damage(damages, at_m));
        self.course.readings.add(frame.time_ns, frame.baseline.raw());
    }

    /// Readings to adopt as a baseline because of warmth around damage.
    pub fn adoption(&mut self, frame: &DamageFrame<'_>, damages: &[Damage]) -> Option<Adoption> {
        let has_lasted = |since_ns: u64| frame.time_ns.saturating_sub(since_ns) as f64 * 1e-9 >= WARM_S;
        let adopted = |readings: &Readings| Adoption {
            readings: readings.mean.clone(),
            frames: readings.frames,
            reason: "warmth about a damage".to_owned(),
        };
        if frame.loaded && !self.course.broken && has_lasted(self.course.since_ns) {
            let adoption = adopted(&self.course.readings);
            self.course.restart(frame.time_ns);
            self.resting = None;
            return Some(adoption);
        }
        let near = |at_m: Point| lies_on_damage(damages, at_m);
        let low = |touch: &Touch| touch.amplitude <= WARM_HEIGHT && near(touch.position_m);
        let here = match (frame.touches, frame.contacts) {
            // Something was there a moment ago; wait for the next frames.
            ([], []) if frame.loaded => return None,
            ([], contacts) if contacts.iter().all(|contact| near(contact.centroid_m)) => {
                contacts.first().map(|contact| contact.centroid_m)
            }
            (touches, _) if touches.iter().all(low) => touches.first().map(|touch| touch.position_m),
            _ => None,
        };
        let Some(here) = here else {
            self.resting = None;
            return None;
        };
        let stays = |warm: &Resting| distance(warm.at_m, here) <= WARM_TRAVEL_M;
        if !self.resting.as_ref().is_some_and(stays) {
            self.resting = Some(Resting { at_m: here, since_ns: frame.time_ns, readings: Readings::default() });
        }
        let warm = self.resting.as_mut()?;
        warm.readings.add(frame.time_ns, frame.baseline.raw());
        if !has_lasted(warm.since_ns) {
            return None;
        }
        let adoption = adopted(&warm.readings);
        self.resting = None;
        Some(adoption)
    }

    /// Decides whether to estimate healing in this frame, and from which data. `change` is the frame's change against
    /// the intact skin, and `open_square` the sum of squares of an open cut's response, if healing is followed at
    /// all.
    pub fn look(&mut self, frame: &DamageFrame<'_>, change: &[f64], open_square: Option<f64>) -> Look {
        let Some(open_square) = open_square else {
            self.course.broken = true;
            self.course.last.clear();
            return Look::None;
        };
        if frame.time_ns.saturating_sub(self.looked_ns) as f64 * 1e-9 < HEALING_S {
            return Look::None;
        }
        self.looked_ns = frame.time_ns;
        if frame.loaded {
            self.course.broken |= !self.course.goes_on(change, open_square);
            if self.course.broken {
                return Look::None;
            }
        }
        self.course.last.clear();
        self.course.last.extend_from_slice(change);
        if frame.loaded { Look::Course } else { Look::Free }
    }

    /// Readings of the steady change.
    pub fn course(&self) -> &Readings {
        &self.course.readings
    }
}

/// True if a position lies on damage, open or healed: a scar stays warm for longer than the cut is open.
fn lies_on_damage(damages: &[Damage], at_m: Point) -> bool {
    damages.iter().any(|damage| damage.shape.distance_m(at_m) <= WARM_REACH_M)
}
