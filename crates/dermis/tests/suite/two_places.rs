//! A skin that cannot tell two places apart. On a disc whose drive and measuring pairs are all of opposite electrodes, a
//! press reads as one at the point opposite: half a turn only exchanges the electrodes of every pair, which changes the
//! sign of current and voltage both.

use dermis::live::calibration::{CalibratedImager, PlacementFinder};
use dermis::live::prepare::Prepared;
use dermis::live::reference::Reference;
use dermis::skin::{Electronics, Preset, Skin, builtin_text};
use dermis::twin::AnyTwin;

/// The gel skin with opposite pairs and a board that loads next to nothing.
fn ambiguous() -> Skin {
    let text = builtin_text("hydrogel-disc").unwrap();
    let lines = text.lines().map(|line| match line.split(['=', ' ']).next() {
        Some("circuit") => "circuit = { load = 1e-3, idle = 0.0, reading = [1.0, -1.0, 0.0] }",
        Some("drive") => "drive = \"opposite\"",
        Some("measure") => "measure = \"opposite\"",
        _ => line,
    });
    Skin::parse(&lines.collect::<Vec<_>>().join("\n"), "test").unwrap()
}

fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    1e3 * (a[0] - b[0]).hypot(a[1] - b[1])
}

#[test]
fn a_press_that_reads_as_one_opposite_is_told_at_both_places_and_does_not_jump() {
    let skin = ambiguous();
    let prepared = Prepared::new(skin.clone()).unwrap();
    let mut of_twin = skin;
    of_twin.backend.electronics = Electronics { preset: Preset::Ideal, ..Electronics::default() };
    (of_twin.twin.element_mm, of_twin.twin.electrode_element_mm) = (Some(8.0), Some(4.0));
    let mut twin = AnyTwin::from_skin(&of_twin).unwrap();
    let (mut rest, mut time_s) = (Vec::new(), 0.0);
    twin.step(time_s, &mut rest).unwrap();
    // Presses at all angles, from the middle to three quarters of the radius.
    let places: Vec<[f64; 2]> = (0..40)
        .map(|n| {
            let (r, angle) = (0.064 * ((f64::from(n) + 0.5) / 40.0).sqrt(), 2.399_963 * f64::from(n));
            [r * angle.cos(), r * angle.sin()]
        })
        .collect();
    let frames: Vec<Vec<f64>> = places
        .iter()
        .map(|[x, y]| {
            twin.scene_mut().press(1, *x, *y, 9e-3, 30e3).unwrap();
            let mut frame = Vec::new();
            for _ in 0..2 {
                time_s += 0.5;
                twin.step(time_s, &mut frame).unwrap();
            }
            frame
        })
        .collect();
    let reference = Reference::of(&prepared, &[rest]).unwrap();
    let data: Vec<Vec<f64>> = frames.iter().map(|frame| reference.difference(frame, None)).collect();
    let CalibratedImager { reference, placement, .. } =
        CalibratedImager::new(&prepared, None, reference, &data).unwrap();
    let mut finder = placement.unwrap();
    let (mut both, mut near) = (0, 0);
    for (place, frame) in places.iter().zip(&frames) {
        finder.forget();
        let found = finder.place(0, &reference.difference(frame, None)).unwrap().unwrap();
        let opposite = place.map(|v| -v);
        let off = |at: [f64; 2]| distance_mm(at, *place).min(distance_mm(at, opposite));
        near += usize::from(off(found.position_m) < 10.0);
        // Nearer to the middle both places overlap.
        if place[0].hypot(place[1]) > 0.035 {
            let other = found.other_place.unwrap_or_else(|| panic!("no other place for {place:?}: {found:?}"));
            assert!(off(other.position_m) < 10.0, "{place:?}: {found:?}");
            assert!(distance_mm(other.position_m, found.position_m) > 26.0, "{place:?}: {found:?}");
            // The twin's mesh is not symmetric, so that neither is exactly a half.
            assert!((0.3..=0.5).contains(&other.probability), "{place:?}: {found:?}");
            both += 1;
        }
    }
    println!("{both} told at both places, {near} of {} within 10 mm of one", places.len());
    assert!(both >= 26 && near >= 38, "{both} {near}");
    held_in_place(&mut finder, &reference, &frames[25], places[25]);
}

/// A press that lasts, each frame with noise of its own that turns the balance.
fn held_in_place(finder: &mut PlacementFinder, reference: &Reference, frame: &[f64], place: [f64; 2]) {
    finder.forget();
    let mut at: Option<[f64; 2]> = None;
    for number in 0..100_u64 {
        let noisy: Vec<f64> = frame
            .iter()
            .zip(&reference.baseline)
            .enumerate()
            .map(|(channel, (value, baseline))| {
                let hash = (number << 16 | channel as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
                let uniform = ((hash ^ hash >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 40) as f64;
                value + 0.3 * (value - baseline) * (uniform / f64::from(1 << 23) - 1.0)
            })
            .collect();
        let found = finder.place(number * 20_000_000, &reference.difference(&noisy, None)).unwrap().unwrap();
        let before = at.replace(found.position_m);
        let step_mm = before.map_or(0.0, |before| distance_mm(before, found.position_m));
        assert!(step_mm < 20.0, "frame {number} of the press at {place:?} jumps by {step_mm} mm");
        assert!(found.other_place.is_some(), "frame {number}: {found:?}");
    }
}
