//! Image objects that carry touches: one filtered contact each, with one touch or, while merged, several.

use crate::contact::{Contact, ContactSign};
use crate::kalman::{Kalman, Mat2, plus_diagonal};
use crate::plane::{Point, Vec2, add, distance, scale, sub};
use crate::touch::Touch;
use crate::tracker_params::TrackerParams;

/// A contact followed over time.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Blob {
    /// Identity, never reused.
    pub key: u64,
    pub filter: Kalman,
    pub stage: Stage,
    pub sign: ContactSign,
    /// Frames since the last contact; 0 = measured in this frame.
    pub missed: u32,
    /// Frames in which it was measured: bit k is set for the frame k frames ago, bit 0 for the current one.
    pub seen: u64,
    /// Frames since the first contact, counting that one.
    pub age: u32,
    pub first_time_ns: u64,
    /// The last contact.
    pub contact: Contact,
    /// Position and velocity predicted for this frame, before its contact was used.
    pub predicted: (Point, Vec2),
}

/// Stage in the life of a blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Stage {
    /// Seen in this many strong contacts; no identity yet.
    Tentative { strong_frames: u32 },
    /// Carries at least one touch.
    Confirmed,
}

/// An identity and the blob that carries it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rider {
    pub touch: Touch,
    pub blob: u64,
    pub merge: Option<Merge>,
    /// Time when the amplitude was last filtered; `None` before the first frame.
    pub filtered_time_ns: Option<u64>,
}

/// State of a rider before it merged, relative to the mean of the riders it merged with.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Merge {
    pub since_ns: u64,
    pub frames: u32,
    /// Consecutive frames in which the contact looked like a single touch.
    pub single_frames: u32,
    pub offset: Vec2,
    pub velocity: Vec2,
}

impl Merge {
    /// Counts one more frame. `blob` is the shared contact.
    pub(crate) fn count(&mut self, blob: Option<&Blob>) {
        self.frames += 1;
        match blob.filter(|blob| blob.missed == 0) {
            Some(blob) if blob.contact.is_single => self.single_frames += 1,
            Some(_) => self.single_frames = 0,
            None => {}
        }
    }

    pub(crate) fn is_over(&self, params: &TrackerParams) -> bool {
        self.frames > params.max_merged_frames || self.single_frames > params.max_merged_single_frames
    }

    /// Expected offset of the rider from the centre of its group. Extrapolates at constant velocity for `memory_s`,
    /// then returns to the offset at which the rider was last seen alone.
    pub(crate) fn offset_at(&self, time_ns: u64, memory_s: f64) -> Vec2 {
        let elapsed = seconds_between(self.since_ns, time_ns);
        if elapsed <= memory_s { add(self.offset, scale(self.velocity, elapsed)) } else { self.offset }
    }

    fn velocity_at(&self, time_ns: u64, memory_s: f64) -> Vec2 {
        if seconds_between(self.since_ns, time_ns) <= memory_s { self.velocity } else { [0.0; 2] }
    }
}

pub(crate) fn seconds_between(from_ns: u64, to_ns: u64) -> f64 {
    to_ns.saturating_sub(from_ns) as f64 * 1e-9
}

impl Blob {
    pub(crate) fn new(key: u64, contact: &Contact, time_ns: u64, velocity: Vec2, params: &TrackerParams) -> Self {
        let position = params.position.of(contact);
        let variance = measured_variance(contact, params);
        Self {
            key,
            filter: Kalman::new(position, variance, velocity, params.initial_speed_m_per_s),
            stage: Stage::Tentative { strong_frames: 0 },
            sign: contact.sign,
            missed: 0,
            seen: 1,
            age: 0,
            first_time_ns: time_ns,
            contact: *contact,
            predicted: (position, velocity),
        }
    }

    pub(crate) fn predict(&mut self, dt: f64, params: &TrackerParams) {
        self.filter.predict(dt, params.acceleration_density_m2_per_s3);
        self.predicted = (self.filter.position, self.filter.velocity);
        self.missed = self.missed.saturating_add(1);
        self.seen <<= 1;
        self.age = self.age.saturating_add(1);
    }

    pub(crate) fn measure(&mut self, contact: &Contact, params: &TrackerParams) {
        self.filter.update(params.position.of(contact), measured_variance(contact, params));
        self.contact = *contact;
        self.missed = 0;
        self.seen |= 1;
    }

    /// Squared gate distance of a contact, or `None` if it is out of the question.
    ///
    /// The gate is widened by half the contact's radius: an image cannot locate a contact more accurately than that,
    /// and touches that merge or separate jump by about as much.
    pub(crate) fn gate(&self, contact: &Contact, params: &TrackerParams) -> Option<f64> {
        let position = params.position.of(contact);
        if contact.sign != self.sign || distance(position, self.filter.position) > params.gate_max_m {
            return None;
        }
        let widened = plus_diagonal(measured_variance(contact, params), (0.5 * contact.radius_m()).powi(2));
        Some(self.filter.distance_squared(position, widened))
    }
}

/// Covariance of a contact, with the floor that keeps it positive definite.
fn measured_variance(contact: &Contact, params: &TrackerParams) -> Mat2 {
    plus_diagonal(contact.covariance_m2, params.position_floor_m * params.position_floor_m)
}

/// Moves the riders of blob `from` to blob `onto`, which is measured in this frame, and records where each one was.
pub(crate) fn merge_blobs(riders: &mut [Rider], from: &Blob, onto: &mut Blob, time_ns: u64, params: &TrackerParams) {
    let memory = params.velocity_memory_s;
    let (mut position_sum, mut velocity_sum, mut count) = ([0.0; 2], [0.0; 2], 0.0);
    for rider in riders.iter_mut() {
        let base = match rider.blob {
            key if key == from.key => from.predicted,
            key if key == onto.key => onto.predicted,
            _ => continue,
        };
        let offset = rider.merge.map_or([0.0; 2], |merge| merge.offset_at(time_ns, memory));
        let drift = rider.merge.map_or([0.0; 2], |merge| merge.velocity_at(time_ns, memory));
        // Absolute here; made relative to the mean below.
        let merge = Merge {
            since_ns: time_ns,
            frames: 0,
            single_frames: 0,
            offset: add(base.0, offset),
            velocity: add(base.1, drift),
        };
        position_sum = add(position_sum, merge.offset);
        velocity_sum = add(velocity_sum, merge.velocity);
        count += 1.0;
        rider.merge = Some(merge);
        rider.blob = onto.key;
    }
    if count == 0.0 {
        return;
    }
    let (position, velocity) = (scale(position_sum, 1.0 / count), scale(velocity_sum, 1.0 / count));
    for merge in riders.iter_mut().filter(|rider| rider.blob == onto.key).filter_map(|rider| rider.merge.as_mut()) {
        merge.offset = sub(merge.offset, position);
        merge.velocity = sub(merge.velocity, velocity);
    }
    let variance = measured_variance(&onto.contact, params);
    onto.filter = Kalman::new(params.position.of(&onto.contact), variance, velocity, params.initial_speed_m_per_s);
}

/// Cleans up after riders left a blob: a rider left alone is no longer merged.
pub(crate) fn settle_riders(riders: &mut [Rider], blob: u64) {
    if riders.iter().filter(|rider| rider.blob == blob).count() == 1 {
        for rider in riders.iter_mut().filter(|rider| rider.blob == blob) {
            rider.merge = None;
        }
    }
}
