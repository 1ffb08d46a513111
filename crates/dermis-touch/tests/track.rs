//! Touches keep their identities: crossing, merging, flicker, lost frames.

mod common;

use common::{Noise, bell, contact, distance_mm, paint, square};
use dermis_touch::{
    Contact, ContactFinder, ContactParams, ContactSign, ContactStrength, Observation, PixelNoise, Touch, TouchError,
    TouchPhase, Tracker, TrackerParams,
};
use proptest::prelude::*;

const FRAME_NS: u64 = 20_000_000;

fn tracker() -> Tracker {
    Tracker::new(TrackerParams::default()).unwrap()
}

/// Feeds one frame a list of (x, y) in mm and returns its touches by id, with those that ended.
fn step(tracker: &mut Tracker, frame: u64, places: &[(f64, f64)]) -> Vec<Touch> {
    let contacts: Vec<_> = places.iter().map(|&(x, y)| contact(x, y, ContactStrength::Strong)).collect();
    feed(tracker, frame, &contacts)
}

fn feed(tracker: &mut Tracker, frame: u64, contacts: &[Contact]) -> Vec<Touch> {
    let mut touches = Vec::new();
    tracker.update(frame * FRAME_NS, contacts, &mut touches).unwrap();
    assert!(touches.iter().all(|touch| touch.phase == TouchPhase::End), "{touches:?}");
    touches.extend(tracker.touches());
    touches.sort_by_key(|touch| touch.id);
    touches
}

/// Numbers of touches that begin, go on and end.
fn count(touches: &[Touch]) -> (usize, usize, usize) {
    let of = |phase| touches.iter().filter(|touch| touch.phase == phase).count();
    (of(TouchPhase::Begin), of(TouchPhase::Move), of(TouchPhase::End))
}

fn near(touches: &[Touch], x_mm: f64, y_mm: f64) -> u64 {
    let to = |touch: &Touch| distance_mm(touch.position_m, [x_mm * 1e-3, y_mm * 1e-3]);
    touches.iter().min_by(|a, b| to(a).total_cmp(&to(b))).unwrap().id
}

#[test]
fn a_touch_begins_moves_and_ends() {
    let mut tracker = tracker();
    assert_eq!(count(&step(&mut tracker, 0, &[(0.0, 0.0)])), (0, 0, 0));
    assert!(tracker.is_following());
    let begin = step(&mut tracker, 1, &[(1.0, 0.0)]);
    assert_eq!(count(&begin), (1, 0, 0));
    let touch = begin[0];
    assert_eq!((touch.id, touch.age_frames, touch.begin_time_ns, touch.time_ns), (1, 2, 0, FRAME_NS));
    assert_eq!(count(&step(&mut tracker, 2, &[(2.0, 0.0)])), (0, 1, 0));
    for frame in 3..6 {
        let touches = step(&mut tracker, frame, &[]);
        assert_eq!(count(&touches), (0, 1, 0));
        assert_eq!(touches[0].observation, Observation::Missed);
        assert_eq!(touches[0].position_m, [0.002, 0.0]);
    }
    assert_eq!(count(&step(&mut tracker, 6, &[])), (0, 0, 1));
    assert!(tracker.touches().is_empty() && !tracker.is_following());
    // A later touch in the same place is a new one.
    step(&mut tracker, 7, &[(2.0, 0.0)]);
    assert_eq!(step(&mut tracker, 8, &[(2.0, 0.0)])[0].id, 2);
}

#[test]
fn one_frame_is_enough_when_allowed() {
    let mut tracker = Tracker::new(TrackerParams { min_age_frames: 1, ..Default::default() }).unwrap();
    let touches = step(&mut tracker, 0, &[(0.0, 0.0)]);
    assert_eq!(count(&touches), (1, 0, 0));
    assert_eq!(touches[0].age_frames, 1);
    // The same time again is another frame of the same touch.
    assert_eq!(count(&step(&mut tracker, 0, &[(0.0, 0.0)])), (0, 1, 0));
}

#[test]
fn velocity_is_found() {
    let mut tracker = tracker();
    for frame in 0..60 {
        step(&mut tracker, frame, &[(-30.0 + frame as f64, 10.0 - 0.5 * frame as f64)]);
    }
    // 1 mm and 0.5 mm in 20 ms: 50 and 25 mm/s; the filter has settled to a few percent after 60 frames.
    let velocity = tracker.touches()[0].velocity_m_per_s;
    assert!((velocity[0] - 0.05).abs() < 2e-3 && (velocity[1] + 0.025).abs() < 2e-3, "{velocity:?}");
}

#[test]
fn crossing_paths_keep_their_identities() {
    let mut tracker = tracker();
    // Two touches cross at right angles through the same point, one slightly ahead, so their contacts never merge.
    for frame in 0..80 {
        let t = frame as f64;
        step(&mut tracker, frame, &[(-40.0 + t, 0.0), (0.0, -52.0 + t)]);
        if frame == 1 {
            assert_eq!((near(tracker.touches(), -40.0, 0.0), near(tracker.touches(), 0.0, -52.0)), (1, 2));
        }
    }
    assert_eq!((near(tracker.touches(), 40.0, 0.0), near(tracker.touches(), 0.0, 28.0)), (1, 2));
}

/// A touch's (x, y) in mm at a frame.
type Path = fn(f64) -> (f64, f64);

/// Runs touches through images and the finder. Returns the ids nearest to the paths at the end, the number of begins,
/// and whether any touches merged.
fn through_images(paths: &[Path], frames: u64, noise_sigma: f64) -> (Vec<u64>, usize, bool) {
    let geometry = square();
    let mut finder = ContactFinder::new(geometry, ContactParams::default()).unwrap();
    let (mut tracker, mut noise, mut contacts) = (tracker(), Noise::new(11), Vec::new());
    let (mut begins, mut merged) = (0, false);
    for frame in 0..frames {
        let bells: Vec<_> = paths.iter().map(|path| path(frame as f64)).map(|(x, y)| bell(x, y, 7.0, 1.0)).collect();
        let mut image = paint(&geometry, &bells);
        image.iter_mut().for_each(|value| *value += (noise_sigma * noise.normal()) as f32);
        finder.find(&image, PixelNoise::Uniform(noise_sigma as f32), &mut contacts).unwrap();
        begins += count(&feed(&mut tracker, frame, &contacts)).0;
        merged |= tracker.touches().iter().any(|touch| touch.observation == Observation::Merged);
    }
    let end = |path: &Path| path((frames - 1) as f64);
    (paths.iter().map(end).map(|(x, y)| near(tracker.touches(), x, y)).collect(), begins, merged)
}

#[test]
fn touches_that_cross_while_merged_continue_on_their_paths() {
    // Head on, with 4 mm between their paths: a single contact while they pass.
    let paths: [Path; 2] = [|t| (-40.0 + t, 2.0), |t| (40.0 - t, -2.0)];
    let (ids, begins, merged) = through_images(&paths, 80, 0.02);
    assert!(merged, "the touches never merged: the test shows nothing");
    assert_eq!(begins, 2);
    // The finder lists the larger first, so either may have become number 1. At the start they are far apart.
    let (start, _, _) = through_images(&paths, 4, 0.02);
    assert_eq!(ids, start);
}

#[test]
fn touches_that_meet_and_rest_part_in_their_places() {
    // They approach, rest as one contact for 2 s (longer than the velocity is remembered), and go back.
    fn ramp(t: f64) -> f64 {
        let way = if t < 32.0 {
            t
        } else if t < 132.0 {
            32.0
        } else {
            164.0 - t
        };
        40.0 - way
    }
    let paths: [Path; 2] = [|t| (-ramp(t), 0.0), |t| (ramp(t), 0.0)];
    let (mut geometry_ids, mut begins) = (Vec::new(), 0);
    let params = TrackerParams { max_merged_frames: 200, ..Default::default() };
    let geometry = square();
    let mut finder = ContactFinder::new(geometry, ContactParams::default()).unwrap();
    let mut tracker = Tracker::new(params).unwrap();
    let mut contacts = Vec::new();
    for frame in 0..160 {
        let places: Vec<_> = paths.iter().map(|path| path(frame as f64)).collect();
        let bells: Vec<_> = places.iter().map(|&(x, y)| bell(x, y, 7.0, 1.0)).collect();
        finder.find(&paint(&geometry, &bells), PixelNoise::Uniform(0.02), &mut contacts).unwrap();
        begins += count(&feed(&mut tracker, frame, &contacts)).0;
        if frame == 5 || frame == 159 {
            geometry_ids.push((near(tracker.touches(), places[0].0, 0.0), near(tracker.touches(), places[1].0, 0.0)));
        }
        if frame == 80 {
            assert!(tracker.touches().iter().all(|touch| touch.observation == Observation::Merged));
            assert_eq!(tracker.touches().len(), 2);
        }
    }
    assert_eq!(begins, 2);
    assert_eq!(geometry_ids[0], geometry_ids[1]);
}

#[test]
fn a_merge_in_a_contact_of_one_touch_ends_soon() {
    let mut tracker = tracker();
    for frame in 0..10 {
        let gap = 12.0 - frame as f64;
        step(&mut tracker, frame, &[(-gap, 0.0), (gap, 0.0)]);
    }
    let mut touches = Vec::new();
    for frame in 10..30 {
        // In one frame of ten it is not known whether the contact is single.
        let contact = Contact { is_single: frame % 10 != 5, ..contact(0.0, 0.0, ContactStrength::Strong) };
        feed(&mut tracker, frame, &[contact]);
        touches.push(tracker.touches().len());
    }
    // Known to be single in frames 16 to 22, the seventh in a row; before the gap there were only five.
    assert_eq!(touches.iter().position(|count| *count == 1), Some(12), "{touches:?}");
}

#[test]
fn a_touch_that_is_kept_single_merges_with_no_other() {
    let mut tracker = tracker();
    tracker.keep_single_alone();
    let single = |x_mm: f64| Contact { is_single: true, ..contact(x_mm, 0.0, ContactStrength::Strong) };
    for frame in 0..10 {
        feed(&mut tracker, frame, &[single(-3.0), single(3.0)]);
    }
    feed(&mut tracker, 10, &[single(3.0)]);
    let seen: Vec<u64> =
        tracker.touches().iter().filter(|touch| touch.observation != Observation::Missed).map(|t| t.id).collect();
    assert_eq!(seen, [2], "{:?}", tracker.touches());
}

#[test]
fn a_merge_that_never_parts_ends_the_younger_touch() {
    let mut tracker = tracker();
    for frame in 0..10 {
        let gap = 12.0 - frame as f64;
        step(&mut tracker, frame, &[(-gap, 0.0), (gap, 0.0)]);
    }
    let mut ends = Vec::new();
    for frame in 10..80 {
        let touches = step(&mut tracker, frame, &[(0.0, 0.0)]);
        ends.extend(touches.iter().filter(|touch| touch.phase == TouchPhase::End).map(|touch| (frame, touch.id)));
    }
    assert_eq!(ends.len(), 1);
    assert_eq!(ends[0].1, 2);
    assert!(ends[0].0 > 50, "merged for 50 frames first: {ends:?}");
    assert_eq!(tracker.touches()[0].observation, Observation::Measured);
}

#[test]
fn presses_one_after_the_other_never_merge() {
    // The contact alternates every frame between two places, too far apart for one touch to have moved and too close
    // together for both contacts to be complete.
    let mut tracker =
        Tracker::new(TrackerParams { min_age_frames: 1, gate_max_m: 0.004, ..Default::default() }).unwrap();
    for frame in 0..40 {
        step(&mut tracker, frame, &[(if frame % 2 == 0 { 0.0 } else { 6.0 }, 0.0)]);
        let seen = |touch: &&Touch| touch.observation != Observation::Missed;
        assert_eq!(tracker.touches().iter().filter(seen).count(), 1, "frame {frame}: {:?}", tracker.touches());
    }
    // Once seen together, they may merge.
    step(&mut tracker, 40, &[(0.0, 0.0), (6.0, 0.0)]);
    step(&mut tracker, 41, &[(0.0, 0.0)]);
    assert_eq!(tracker.touches().iter().filter(|touch| touch.observation == Observation::Merged).count(), 2);
}

#[test]
fn a_contact_that_jumps_between_two_touches_belongs_to_one_of_them() {
    let mut tracker = tracker();
    for frame in 0..10 {
        step(&mut tracker, frame, &[(-3.0, 0.0), (3.0, 0.0)]);
    }
    // A merged contact would be between them. Here one touch has moved or was pressed again, and the other was
    // released.
    for frame in 10..40 {
        step(&mut tracker, frame, &[(3.0, 10.0)]);
        let merged = tracker.touches().iter().any(|touch| touch.observation == Observation::Merged);
        assert!(!merged, "frame {frame}: {:?}", tracker.touches());
    }
    assert_eq!(tracker.touches().len(), 1, "{:?}", tracker.touches());
}

#[test]
fn flicker_at_the_threshold_holds_one_identity() {
    let geometry = square();
    let mut finder = ContactFinder::new(geometry, ContactParams::default()).unwrap();
    let (mut tracker, mut noise, mut contacts) = (tracker(), Noise::new(5), Vec::new());
    let (mut begins, mut ends, mut weak) = (0, 0, 0);
    for frame in 0..500 {
        // The peak wanders between 3.6 and 6.4 sigma, around the threshold of 5.
        let height = 5.0 + 1.2 * (frame as f64 * 0.7).sin() + 0.2 * (noise.uniform() - 0.5);
        let image = paint(&geometry, &[bell(10.0, 10.0, 8.0, height)]);
        finder.find(&image, PixelNoise::Uniform(1.0), &mut contacts).unwrap();
        weak += contacts.iter().filter(|contact| contact.strength == ContactStrength::Weak).count();
        let (begun, _, ended) = count(&feed(&mut tracker, frame, &contacts));
        (begins, ends) = (begins + begun, ends + ended);
    }
    assert!(weak > 100, "the threshold was hardly crossed: {weak}");
    assert_eq!((begins, ends), (1, 0));
}

#[test]
fn weak_contacts_begin_nothing() {
    let mut tracker = tracker();
    for frame in 0..10 {
        assert!(feed(&mut tracker, frame, &[contact(0.0, 0.0, ContactStrength::Weak)]).is_empty());
    }
}

#[test]
fn a_contact_also_found_in_an_earlier_frame_begins_at_once() {
    let found = |strength| Contact { was_found: true, ..contact(0.0, 0.0, strength) };
    assert_eq!(count(&feed(&mut tracker(), 0, &[found(ContactStrength::Strong)])), (1, 0, 0));
    assert!(feed(&mut tracker(), 0, &[found(ContactStrength::Weak)]).is_empty());
}

#[test]
fn a_lost_frame_does_no_harm() {
    let mut tracker = tracker();
    let mut begins = 0;
    for frame in 0..60u64 {
        // 2 mm per frame; frame 20 is missing, frame 40 is empty.
        let places = [(-55.0 + 2.0 * frame as f64, 0.0)];
        let touches = match frame {
            20 => continue,
            40 => step(&mut tracker, frame, &[]),
            _ => step(&mut tracker, frame, &places),
        };
        begins += count(&touches).0;
    }
    assert_eq!(begins, 1);
    assert_eq!(tracker.touches().len(), 1);
}

#[test]
fn signs_are_not_mixed_up() {
    let mut tracker = tracker();
    step(&mut tracker, 0, &[(0.0, 0.0)]);
    step(&mut tracker, 1, &[(0.0, 0.0)]);
    let mut negative = contact(0.0, 0.0, ContactStrength::Strong);
    negative.sign = ContactSign::Negative;
    let touches = feed(&mut tracker, 2, &[negative]);
    assert_eq!(touches[0].observation, Observation::Missed);
}

#[test]
fn the_amplitude_filter_has_its_time_constant() {
    let params = TrackerParams { amplitude_time_constant_s: Some(0.2), ..Default::default() };
    let mut tracker = Tracker::new(params).unwrap();
    let mut seen = contact(0.0, 0.0, ContactStrength::Strong);
    feed(&mut tracker, 0, &[seen]);
    feed(&mut tracker, 1, &[seen]);
    seen.amplitude = 2.0;
    for frame in 2..12 {
        feed(&mut tracker, frame, &[seen]);
    }
    // 10 frames are one time constant: the step from 1 to 2 has reached 1 - 1/e, exactly for a sampled step.
    assert!((tracker.touches()[0].amplitude - (2.0 - (-1.0f64).exp())).abs() < 1e-12);
}

#[test]
fn ending_all_ends_all() {
    let mut tracker = tracker();
    step(&mut tracker, 0, &[(0.0, 0.0), (40.0, 0.0)]);
    step(&mut tracker, 1, &[(0.0, 0.0), (40.0, 0.0)]);
    let mut ended = Vec::new();
    tracker.end_all(2 * FRAME_NS, &mut ended);
    assert_eq!(count(&ended), (0, 0, 2));
    assert!(tracker.touches().is_empty());
    // A new recording may start at time 0; identities continue.
    step(&mut tracker, 0, &[(0.0, 0.0)]);
    assert_eq!(step(&mut tracker, 1, &[(0.0, 0.0)])[0].id, 3);
}

#[test]
fn bad_input_changes_nothing() {
    let mut tracker = tracker();
    step(&mut tracker, 5, &[(0.0, 0.0)]);
    let mut ended = Vec::new();
    let error = tracker.update(0, &[], &mut ended).unwrap_err();
    assert_eq!(error, TouchError::TimeReversed { time_ns: 0, previous_ns: 5 * FRAME_NS });
    let broken = contact(f64::NAN, 0.0, ContactStrength::Strong);
    assert!(matches!(tracker.update(6 * FRAME_NS, &[broken], &mut ended), Err(TouchError::NonFinite { index: 0, .. })));
    assert_eq!(count(&step(&mut tracker, 6, &[(0.0, 0.0)])), (1, 0, 0));
    assert!(Tracker::new(TrackerParams { gate_sigma: 0.0, ..Default::default() }).is_err());
}

proptest! {
    #[test]
    fn begins_are_ends_plus_alive(
        frames in proptest::collection::vec(
            proptest::collection::vec((-60.0..60.0f64, -60.0..60.0f64, any::<bool>()), 0..6), 1..60),
        min_age_frames in 1u32..4,
        max_missed_frames in 0u32..4,
        max_merged_frames in 0u32..6,
        pull in 0.05..1.0f64,
    ) {
        let params = TrackerParams { min_age_frames, max_missed_frames, max_merged_frames, ..Default::default() };
        let mut tracker = Tracker::new(params).unwrap();
        let (mut begins, mut ends, mut last_id) = (0, 0, 0);
        let mut alive = std::collections::BTreeSet::new();
        for (frame, places) in frames.iter().enumerate() {
            // Scaled towards the centre, so that they meet, merge and separate often.
            let contacts: Vec<_> = places
                .iter()
                .map(|&(x, y, strong)| {
                    let strength = if strong { ContactStrength::Strong } else { ContactStrength::Weak };
                    contact(x * pull, y * pull, strength)
                })
                .collect();
            for Touch { id, phase, .. } in feed(&mut tracker, frame as u64, &contacts) {
                match phase {
                    TouchPhase::Begin => {
                        prop_assert!(id > last_id, "ids count up");
                        last_id = id;
                        begins += 1;
                        prop_assert!(alive.insert(id));
                    }
                    TouchPhase::Move => prop_assert!(alive.contains(&id)),
                    TouchPhase::End => {
                        ends += 1;
                        prop_assert!(alive.remove(&id), "ended once, after beginning");
                    }
                }
            }
            prop_assert_eq!(begins, ends + tracker.touches().len());
            let ids: Vec<_> = tracker.touches().iter().map(|touch| touch.id).collect();
            prop_assert!(ids.iter().eq(alive.iter()), "touches() lists the living by id");
            for touch in tracker.touches() {
                prop_assert!(touch.filtered_position_m.iter().chain(&touch.velocity_m_per_s).all(|v| v.is_finite()));
            }
        }
    }
}
