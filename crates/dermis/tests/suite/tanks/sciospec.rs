//! A cup is lowered into a tank, moved once around it by hand and taken out again.

use dermis_lab::evidence::sciospec::{largest_step_mm, run};

use super::measured;

#[test]
fn the_cup_is_followed_from_the_frame_it_enters() {
    let Some(directory) = measured("sciospec", "run1/setup") else { return };
    let outcome = run(&directory).unwrap();
    let touches = &outcome.touches;
    assert_eq!(outcome.report.frames, 255);
    assert_eq!(outcome.report.noise_source, dermis_live::reference::NoiseSource::Baseline);
    assert!(outcome.report.order.correlation >= 0.99, "{}", outcome.report.order.correlation);
    assert!(outcome.report.order.better.is_none());
    let (first, last) = (touches[0], touches[touches.len() - 1]);
    let largest = largest_step_mm(&outcome);
    println!(
        "sciospec order {:.4}, frames {} to {}, {} rows, largest step {largest:.1} mm",
        outcome.report.order.correlation,
        first.frame,
        last.frame,
        touches.len()
    );
    // Measured: correlation 0.9968, frames 59 to 225, largest step 5.9 mm. Frames count from 0; the cup is said to
    // enter at frame 60 +- 2.
    assert!((58..=62).contains(&first.frame), "{first:?}");
    // The cup is out of the water from frame 226 on.
    assert!((220..=230).contains(&last.frame), "{last:?}");
    assert!(touches.iter().all(|touch| touch.id == first.id), "one cup, one identity");
    assert_eq!(touches.len(), last.frame - first.frame + 1, "seen in every frame");
    // The cup insulates, so it removes all of the conductivity: 1 in relative terms, within the resolution.
    let deepest = touches.iter().map(|touch| touch.amplitude).fold(0.0, f64::max);
    assert!((0.8..2.0).contains(&deepest), "{deepest}");
    // Frames are 50 ms apart, and the tank is shown as a 200 mm disc: a hand moves the cup by a few per cent of the
    // radius.
    assert!(largest < 8.0, "{largest}");
    // Once around: the angle passes through all quadrants.
    let quadrants: std::collections::BTreeSet<(bool, bool)> =
        touches.iter().map(|touch| (touch.at_mm[0] > 0.0, touch.at_mm[1] > 0.0)).collect();
    assert_eq!(quadrants.len(), 4);
}
