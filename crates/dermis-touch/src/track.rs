//! Tracks the contacts of successive images as touches with stable identities.
//!
//! Every touch has a Kalman filter with nearly constant velocity. Contacts are assigned to touches by the least total
//! Mahalanobis distance, within a gate. Touches whose contacts merge into one are kept as merged, and resume their
//! identities when the contact splits. Identities count up from 1 and are never reused.

use crate::assignment::{Assignment, FORBIDDEN};
use crate::blob::{Blob, Merge, Rider, Stage, merge_blobs, seconds_between, settle_riders};
use crate::contact::{Contact, ContactStrength};
use crate::error::TouchError;
use crate::kalman::{Mat2, plus_diagonal};
use crate::plane::{Point, Vec2, add, distance, norm, scale, sub};
use crate::touch::{Observation, Touch, TouchPhase};
use crate::tracker_params::TrackerParams;

/// Maximum detour via a merged contact: the path from one touch's expected position over the contact to the other's
/// may be this many times the direct distance, plus the contact's radius.
const DETOUR: f64 = 1.2;

/// Tracks contacts over frames.
#[derive(Debug, Clone)]
pub struct Tracker {
    params: TrackerParams,
    riders: Vec<Rider>,
    blobs: Vec<Blob>,
    touches: Vec<Touch>,
    last_time_ns: Option<u64>,
    next_id: u64,
    next_key: u64,
    assignment: Assignment,
    /// Contacts not assigned to a blob yet.
    free: Vec<usize>,
    taken: Vec<bool>,
    rows: Vec<usize>,
    members: Vec<usize>,
    candidates: Vec<Contact>,
    columns: Vec<usize>,
}

impl Tracker {
    /// A tracker without touches.
    ///
    /// # Errors
    /// [`TouchError::Parameter`] when a parameter is out of range.
    pub fn new(params: TrackerParams) -> Result<Self, TouchError> {
        params.validate()?;
        Ok(Self {
            params,
            riders: Vec::new(),
            blobs: Vec::new(),
            touches: Vec::new(),
            last_time_ns: None,
            next_id: 1,
            next_key: 0,
            assignment: Assignment::default(),
            free: Vec::new(),
            taken: Vec::new(),
            rows: Vec::new(),
            members: Vec::new(),
            candidates: Vec::new(),
            columns: Vec::new(),
        })
    }

    /// The parameters.
    #[must_use]
    pub fn params(&self) -> &TrackerParams {
        &self.params
    }

    /// From now on, no touch merges into a contact that is known to be a single touch.
    pub fn keep_single_alone(&mut self) {
        self.params.max_merged_single_frames = 0;
    }

    /// The touches on the skin after the last frame, by id.
    #[must_use]
    pub fn touches(&self) -> &[Touch] {
        &self.touches
    }

    /// True if anything is being tracked, including tentative contacts. Freeze the baseline while this is true.
    #[must_use]
    pub fn is_following(&self) -> bool {
        !self.blobs.is_empty()
    }

    /// Takes one frame's contacts, and replaces `ended` by the touches that end with this frame, by id. The others
    /// are in [`Tracker::touches`].
    ///
    /// `time_ns` is on any axis that does not run backwards. Without times, use frame number times frame period.
    /// Memory is allocated only when there are more contacts than ever before.
    ///
    /// # Errors
    /// [`TouchError::TimeReversed`]; [`TouchError::NonFinite`] for a contact whose tracked position, covariance or
    /// area is not finite. The tracker is then unchanged and `ended` empty.
    pub fn update(&mut self, time_ns: u64, contacts: &[Contact], ended: &mut Vec<Touch>) -> Result<(), TouchError> {
        ended.clear();
        let dt = self.elapsed(time_ns)?;
        self.check(contacts)?;
        self.last_time_ns = Some(time_ns);
        for blob in &mut self.blobs {
            blob.predict(dt, &self.params);
        }
        self.free.clear();
        self.free.extend(0..contacts.len());
        self.match_stage(contacts, true);
        self.part_merged(contacts, time_ns);
        self.match_stage(contacts, false);
        self.merge_vanished(time_ns);
        self.begin_tentative(contacts, time_ns);
        self.drop_unseen_tentative();
        self.confirm(time_ns);
        self.publish(time_ns, ended);
        Ok(())
    }

    /// Ends every touch now, as when a source stops, and replaces `ended` by them. Identities keep
    /// counting.
    pub fn end_all(&mut self, time_ns: u64, ended: &mut Vec<Touch>) {
        ended.clear();
        for rider in &mut self.riders {
            rider.touch.phase = TouchPhase::End;
            rider.touch.observation = Observation::Missed;
            rider.touch.time_ns = time_ns;
            ended.push(rider.touch);
        }
        self.riders.clear();
        self.blobs.clear();
        self.touches.clear();
        self.last_time_ns = None;
    }

    fn elapsed(&self, time_ns: u64) -> Result<f64, TouchError> {
        match self.last_time_ns {
            Some(previous_ns) if time_ns < previous_ns => Err(TouchError::TimeReversed { time_ns, previous_ns }),
            Some(previous_ns) => Ok(seconds_between(previous_ns, time_ns)),
            None => Ok(0.0),
        }
    }

    fn check(&self, contacts: &[Contact]) -> Result<(), TouchError> {
        for (index, contact) in contacts.iter().enumerate() {
            let [[xx, xy], [yx, yy]] = contact.covariance_m2;
            let [x, y] = self.params.position.of(contact);
            for value in [x, y, xx, xy, yx, yy, contact.area_m2, contact.amplitude] {
                if !value.is_finite() {
                    return Err(TouchError::NonFinite { what: "contact", index, value });
                }
            }
        }
        Ok(())
    }

    /// Assigns free contacts to the confirmed blobs, or to the tentative ones.
    fn match_stage(&mut self, contacts: &[Contact], confirmed: bool) {
        self.rows.clear();
        let stage = |blob: &Blob| (blob.stage == Stage::Confirmed) == confirmed && blob.missed > 0;
        self.rows.extend(self.blobs.iter().enumerate().filter(|(_, blob)| stage(blob)).map(|(index, _)| index));
        if self.rows.is_empty() || self.free.is_empty() {
            return;
        }
        let (rows, free, blobs, params) = (&self.rows, &self.free, &self.blobs, &self.params);
        let alone = params.gate_sigma * params.gate_sigma;
        let result = self.assignment.solve(rows.len(), free.len(), alone, |row, column| {
            blobs[rows[row]].gate(&contacts[free[column]], params).unwrap_or(FORBIDDEN)
        });
        self.taken.clear();
        self.taken.resize(contacts.len(), false);
        for (row, column) in result.iter().enumerate() {
            let Some(column) = *column else { continue };
            let contact = &contacts[self.free[column]];
            self.taken[self.free[column]] = true;
            self.blobs[self.rows[row]].measure(contact, &self.params);
        }
        let taken = &self.taken;
        self.free.retain(|&index| !taken[index]);
    }

    /// When a merged contact has split, assigns its parts to the touches that rode on it.
    fn part_merged(&mut self, contacts: &[Contact], time_ns: u64) {
        for index in 0..self.blobs.len() {
            let blob = self.blobs[index];
            self.members.clear();
            let riding = self.riders.iter().enumerate().filter(|(_, rider)| rider.blob == blob.key);
            self.members.extend(riding.map(|(member, _)| member));
            if self.members.len() < 2 || self.free.is_empty() {
                continue;
            }
            self.collect_candidates(&blob, contacts, time_ns);
            if self.candidates.len() < 2 {
                // One contact and a blob that was not seen: they belong together, although the contact is outside the
                // gate.
                if blob.missed > 0 && self.candidates.len() == 1 {
                    self.blobs[index].measure(&self.candidates[0], &self.params);
                    let column = self.columns[0];
                    self.free.retain(|&contact| contact != column);
                }
                continue;
            }
            self.reassign_members(index, time_ns);
        }
    }

    /// Collects the blob's own contact, if seen, and the free ones within its members' reach.
    fn collect_candidates(&mut self, blob: &Blob, contacts: &[Contact], time_ns: u64) {
        self.candidates.clear();
        self.columns.clear();
        if blob.missed == 0 {
            self.candidates.push(blob.contact);
            self.columns.push(usize::MAX);
        }
        let spread = self
            .members
            .iter()
            .filter_map(|&member| self.riders[member].merge)
            .map(|merge| norm(merge.offset_at(time_ns, self.params.velocity_memory_s)).max(norm(merge.offset)));
        let spread = spread.fold(0.0, f64::max);
        for &column in &self.free {
            let contact = &contacts[column];
            let reach = 2.0 * spread + contact.radius_m() + self.params.gate_sigma * self.params.position_floor_m;
            let distance_m = distance(self.params.position.of(contact), blob.predicted.0);
            if contact.sign == blob.sign && distance_m <= reach.min(self.params.gate_max_m) {
                self.candidates.push(*contact);
                self.columns.push(column);
            }
        }
    }

    /// Assigns the members of blob `index` to the candidates by their remembered offsets from the group's centre.
    fn reassign_members(&mut self, index: usize, time_ns: u64) {
        let (params, candidates, members, riders) = (&self.params, &self.candidates, &self.members, &self.riders);
        let sum = candidates.iter().fold([0.0; 2], |sum, contact| add(sum, params.position.of(contact)));
        let middle = scale(sum, 1.0 / candidates.len() as f64);
        let offset = |member: usize| {
            riders[member].merge.map_or([0.0; 2], |merge| merge.offset_at(time_ns, params.velocity_memory_s))
        };
        let distance = |row: usize, column: usize| {
            let away = sub(sub(params.position.of(&candidates[column]), middle), offset(members[row]));
            away[0] * away[0] + away[1] * away[1]
        };
        // Costs more than any set of pairs, so that every member that can have a contact gets one.
        let largest = (0..members.len())
            .flat_map(|row| (0..candidates.len()).map(move |column| (row, column)))
            .fold(0.0f64, |largest, (row, column)| largest.max(distance(row, column)));
        let alone = (largest + 1e-12) * (members.len() + 1) as f64;
        let result = self.assignment.solve(members.len(), candidates.len(), alone, distance);
        self.rows.clear();
        self.rows.extend(result.iter().map(|column| column.unwrap_or(usize::MAX)));
        self.move_members(index, time_ns);
    }

    /// Gives every assigned member its own blob; the rest ride with the nearest.
    fn move_members(&mut self, index: usize, time_ns: u64) {
        let old = self.blobs[index];
        // Copied, because the loops below change the originals.
        for row in 0..self.members.len() {
            let column = self.rows[row];
            if column == usize::MAX {
                continue;
            }
            let rider = self.riders[self.members[row]];
            let remembered =
                rider.merge.filter(|m| seconds_between(m.since_ns, time_ns) <= self.params.velocity_memory_s);
            let velocity = add(old.filter.velocity, remembered.map_or([0.0; 2], |m| m.velocity));
            let contact = self.candidates[column];
            let key = self.new_key();
            let mut blob = Blob::new(key, &contact, old.first_time_ns, velocity, &self.params);
            (blob.stage, blob.age) = (Stage::Confirmed, old.age);
            self.blobs.push(blob);
            let rider = &mut self.riders[self.members[row]];
            (rider.blob, rider.merge) = (key, None);
            let given = self.columns[column];
            self.free.retain(|&contact| contact != given);
        }
        self.seat_leftover(&old, time_ns);
        // The old blob has no riders now; `publish` removes it.
    }

    /// Members without their own contact stay merged, on the assigned contact nearest to their expected position.
    fn seat_leftover(&mut self, old: &Blob, time_ns: u64) {
        for row in 0..self.members.len() {
            if self.rows[row] != usize::MAX {
                continue;
            }
            let offset = self.riders[self.members[row]]
                .merge
                .map_or([0.0; 2], |merge| merge.offset_at(time_ns, self.params.velocity_memory_s));
            let expected = add(old.predicted.0, offset);
            let Some(host) = self.nearest_new_blob(expected) else { continue };
            let host_offset = sub(self.blobs[host].filter.position, expected);
            let key = self.blobs[host].key;
            let merge =
                |offset: Vec2| Merge { since_ns: time_ns, frames: 0, single_frames: 0, offset, velocity: [0.0; 2] };
            for rider in self.riders.iter_mut().filter(|rider| rider.blob == key && rider.merge.is_none()) {
                rider.merge = Some(merge(scale(host_offset, 0.5)));
            }
            let rider = &mut self.riders[self.members[row]];
            (rider.blob, rider.merge) = (key, Some(merge(scale(host_offset, -0.5))));
        }
    }

    /// The blob nearest to `position` among those just assigned to members of the split group.
    fn nearest_new_blob(&self, position: Point) -> Option<usize> {
        let given = |blob: &Blob| {
            self.members
                .iter()
                .zip(&self.rows)
                .any(|(&member, &column)| column != usize::MAX && self.riders[member].blob == blob.key)
        };
        let distance_m = |index: usize| distance(self.blobs[index].filter.position, position);
        (0..self.blobs.len())
            .filter(|&i| given(&self.blobs[i]))
            .min_by(|&a, &b| distance_m(a).total_cmp(&distance_m(b)))
    }

    /// Merges a touch that lost its contact with a nearby touch that has one. Both must have been seen together in
    /// one of the last 64 frames, and the contact must be where a merged contact would be. Contacts that alternate,
    /// or jump elsewhere, are successive presses.
    fn merge_vanished(&mut self, time_ns: u64) {
        for index in 0..self.blobs.len() {
            let from = self.blobs[index];
            if from.stage != Stage::Confirmed || from.missed == 0 || !self.has_riders(from.key) {
                continue;
            }
            let (params, blobs) = (&self.params, &self.blobs);
            let distance_m = |other: usize| distance(params.position.of(&blobs[other].contact), from.predicted.0);
            let host = (0..blobs.len())
                .filter(|&other| {
                    let blob = &blobs[other];
                    other != index
                        && blob.stage == Stage::Confirmed
                        && blob.missed == 0
                        && blob.seen & from.seen != 0
                        && blob.sign == from.sign
                        && !(params.max_merged_single_frames == 0 && blob.contact.is_single)
                        && distance_m(other) <= params.merge_radii * blob.contact.radius_m()
                        && may_be_of_both(blob, &from, params)
                        && self.has_riders(blob.key)
                })
                .min_by(|&a, &b| distance_m(a).total_cmp(&distance_m(b)));
            if let Some(host) = host {
                merge_blobs(&mut self.riders, &from, &mut self.blobs[host], time_ns, &self.params);
            }
        }
    }

    fn has_riders(&self, key: u64) -> bool {
        self.riders.iter().any(|rider| rider.blob == key)
    }

    fn begin_tentative(&mut self, contacts: &[Contact], time_ns: u64) {
        for position in 0..self.free.len() {
            let contact = &contacts[self.free[position]];
            if contact.strength == ContactStrength::Strong {
                let key = self.new_key();
                let mut blob = Blob::new(key, contact, time_ns, [0.0; 2], &self.params);
                blob.age = 1;
                self.blobs.push(blob);
            }
        }
    }

    fn drop_unseen_tentative(&mut self) {
        self.blobs.retain(|blob| blob.stage == Stage::Confirmed || blob.missed == 0);
    }

    /// Counts strong contacts of tentative blobs and gives an identity to those that have enough.
    fn confirm(&mut self, time_ns: u64) {
        for index in 0..self.blobs.len() {
            let blob = &mut self.blobs[index];
            let Stage::Tentative { strong_frames } = blob.stage else { continue };
            let strong_frames = strong_frames.saturating_add(blob.contact.strong_frames());
            if strong_frames < self.params.min_age_frames {
                blob.stage = Stage::Tentative { strong_frames };
                continue;
            }
            blob.stage = Stage::Confirmed;
            let blob = *blob;
            let mut touch = first_touch(self.next_id, &blob);
            touch.time_ns = time_ns;
            self.riders.push(Rider { touch, blob: blob.key, merge: None, filtered_time_ns: None });
            self.next_id += 1;
        }
    }

    /// Writes the touches of this frame and removes those that ended.
    fn publish(&mut self, time_ns: u64, ended: &mut Vec<Touch>) {
        self.expire_merges();
        for rider in &mut self.riders {
            let blob = self.blobs.iter().find(|blob| blob.key == rider.blob);
            refresh(rider, blob, time_ns, &self.params);
            if rider.touch.phase == TouchPhase::End {
                ended.push(rider.touch);
            }
        }
        self.riders.retain(|rider| rider.touch.phase != TouchPhase::End);
        let riders = &self.riders;
        self.blobs.retain(|blob| blob.stage != Stage::Confirmed || riders.iter().any(|rider| rider.blob == blob.key));
        self.touches.clear();
        self.touches.extend(self.riders.iter().map(|rider| rider.touch));
    }

    /// Ends merged touches that have exceeded their time, except the oldest of each group.
    fn expire_merges(&mut self) {
        for index in 0..self.riders.len() {
            let key = self.riders[index].blob;
            let blob = self.blobs.iter().find(|blob| blob.key == key);
            let Some(merge) = self.riders[index].merge.as_mut() else { continue };
            merge.count(blob);
            let expired = merge.is_over(&self.params);
            // Riders are sorted by id, so an earlier one of the same blob began earlier.
            if expired && self.riders[..index].iter().any(|rider| rider.blob == key) {
                self.riders[index].touch.phase = TouchPhase::End;
                // No blob has this key.
                self.riders[index].blob = u64::MAX;
                settle_riders(&mut self.riders, key);
            }
        }
    }

    fn new_key(&mut self) -> u64 {
        self.next_key += 1;
        self.next_key
    }
}

/// True if the contact of `host` in this frame may belong to both, `from` having none: it is roughly between their
/// expected positions. A host seen without `from` in the previous frame is no candidate any more.
fn may_be_of_both(host: &Blob, from: &Blob, params: &TrackerParams) -> bool {
    let was_there_alone = from.missed > 1 && host.seen & 2 != 0;
    let (at, own, other) = (params.position.of(&host.contact), host.predicted.0, from.predicted.0);
    let way = distance(at, own) + distance(at, other);
    !was_there_alone && way <= DETOUR * distance(own, other) + host.contact.radius_m()
}

/// Covariance from noise and model error.
fn whole_covariance_m2(contact: &Contact) -> Mat2 {
    plus_diagonal(contact.covariance_m2, contact.model_variance_m2)
}

fn first_touch(id: u64, blob: &Blob) -> Touch {
    Touch {
        id,
        phase: TouchPhase::Begin,
        observation: Observation::Measured,
        sign: blob.sign,
        position_m: blob.filter.position,
        covariance_m2: whole_covariance_m2(&blob.contact),
        filtered_position_m: blob.filter.position,
        velocity_m_per_s: blob.filter.velocity,
        amplitude: blob.contact.amplitude,
        area_m2: blob.contact.area_m2,
        force: blob.contact.force,
        radius_m: blob.contact.radius_m,
        load: blob.contact.load,
        other_place: blob.contact.other_place,
        age_frames: blob.age.saturating_sub(1),
        begin_time_ns: blob.first_time_ns,
        time_ns: blob.first_time_ns,
    }
}

/// Updates a rider's touch for this frame.
fn refresh(rider: &mut Rider, blob: Option<&Blob>, time_ns: u64, params: &TrackerParams) {
    let touch = &mut rider.touch;
    touch.age_frames = touch.age_frames.saturating_add(1);
    touch.time_ns = time_ns;
    let Some(blob) = blob.filter(|blob| blob.missed <= params.max_missed_frames) else {
        touch.phase = TouchPhase::End;
        touch.observation = Observation::Missed;
        return;
    };
    if rider.filtered_time_ns.is_some() {
        touch.phase = TouchPhase::Move;
    }
    touch.filtered_position_m = blob.filter.position;
    touch.velocity_m_per_s = blob.filter.velocity;
    touch.observation = match (blob.missed, rider.merge) {
        (0, None) => Observation::Measured,
        (0, Some(_)) => Observation::Merged,
        _ => Observation::Missed,
    };
    if blob.missed > 0 {
        return;
    }
    touch.position_m = params.position.of(&blob.contact);
    touch.covariance_m2 = whole_covariance_m2(&blob.contact);
    touch.area_m2 = blob.contact.area_m2;
    touch.force = blob.contact.force;
    touch.radius_m = blob.contact.radius_m;
    touch.load = blob.contact.load;
    touch.other_place = blob.contact.other_place;
    let keep = match (params.amplitude_time_constant_s, rider.filtered_time_ns) {
        (Some(tau), Some(before_ns)) => (-seconds_between(before_ns, time_ns) / tau).exp(),
        _ => 0.0,
    };
    touch.amplitude = keep * touch.amplitude + (1.0 - keep) * blob.contact.amplitude;
    rider.filtered_time_ns = Some(time_ns);
}
