//! Cuts and heat over time, with the material of the published self-healing skin.

mod published;

use dermis_twin::physics::Cut;
use dermis_twin::{Heating, Treatment, TwinError, Wear};
use published::healing_law;

/// Resistance of a 100 x 10 mm bar that had `new_ohm` when new, after treatments, with or without a cut across its
/// middle.
fn bar_ohm(wear: &Wear, new_ohm: f64) -> f64 {
    let per_m = new_ohm / 0.1 / wear.share_at([0.0; 2]);
    let scars: f64 = wear.cuts().flatten().take(1).map(|cut| cut.width_m * (1.0 / cut.residual - 1.0)).sum();
    per_m * (0.1 + scars)
}

fn healed_for(hours: f64, cut: bool) -> Wear {
    let mut wear = Wear::new(Some(healing_law()));
    if cut {
        wear.treat(&Treatment::Cut(Cut::open([0.0, -0.005], [0.0, 0.005]))).unwrap();
    }
    wear.treat(&Treatment::Heat(published::heating([0.0; 2], 0.03))).unwrap();
    (0..100).for_each(|_| {
        wear.advance(hours * 36.0);
    });
    wear
}

#[test]
fn bars_end_at_the_published_resistances() {
    // 48 h after the heating, 1.8 % of the relaxation remains: 0.26 x 0.018 = 0.5 % of the resistance.
    let (intact, cut) = (healed_for(50.0, false), healed_for(50.0, true));
    assert!((bar_ohm(&intact, 2010.0) - 1920.0).abs() < 0.006 * 1920.0, "{}", bar_ohm(&intact, 2010.0));
    assert!((bar_ohm(&cut, 2070.0) - 2150.0).abs() < 0.006 * 2150.0, "{}", bar_ohm(&cut, 2070.0));
    let (intact, cut) = (healed_for(500.0, false), healed_for(500.0, true));
    assert!((bar_ohm(&intact, 2010.0) - 1920.0).abs() < 1e-6 && (bar_ohm(&cut, 2070.0) - 2150.0).abs() < 0.05);
}

#[test]
fn conductivity_rises_while_heated_and_falls_after() {
    let share = |hours: f64| healed_for(hours, false).share_at([0.0; 2]);
    assert!((share(2.0) - 1.3).abs() < 1e-9);
    let course = [1.0, 2.0, 6.0, 24.0, 50.0].map(share);
    assert!(course[0] < course[1] && course[1..].windows(2).all(|pair| pair[1] < pair[0]), "{course:?}");
    assert!(course[4] > 1.0 + healing_law().lasting_rise);
}

#[test]
fn cuts_outside_the_pad_or_cool_ones_do_not_heal() {
    let mut wear = Wear::new(Some(healing_law()));
    wear.treat(&Treatment::Cut(Cut::open([-0.01, 0.0], [0.01, 0.0]))).unwrap();
    // The right half is under the pad.
    wear.treat(&Treatment::Heat(published::heating([0.02, 0.0], 0.02))).unwrap();
    wear.advance(7200.0);
    let healed = wear.wounds().next().unwrap().healed;
    assert!((healed - 0.5).abs() < 0.1, "{healed}");
    assert!(wear.share_at([-0.02, 0.0]) < 1.001);
    let mut cool = Wear::new(Some(healing_law()));
    cool.treat(&Treatment::Cut(Cut::open([-0.01, 0.0], [0.01, 0.0]))).unwrap();
    let warm = Heating { temperature_c: 40.0, ..published::heating([0.0; 2], 0.03) };
    cool.treat(&Treatment::Heat(warm)).unwrap();
    cool.advance(7200.0);
    assert!(cool.wounds().next().unwrap().healed < 0.02);
}

#[test]
fn time_lapse_speeds_up_healing_only() {
    let mut wear = Wear::new(Some(healing_law()));
    for treatment in [Treatment::TimeLapse(3600.0), Treatment::Warm(1e-3)] {
        wear.treat(&treatment).unwrap();
    }
    wear.treat(&Treatment::Heat(published::heating([0.0; 2], 0.03))).unwrap();
    assert!(wear.advance(1.0));
    // Half of the heating in one second; the room warms up at its own rate.
    assert!((wear.share_at([0.0; 2]) - 1.001 * (1.0 + 0.5 * healing_law().peak_rise)).abs() < 1e-9);
    wear.treat(&Treatment::Renew).unwrap();
    assert!(!wear.advance(1.0) && wear.share_at([0.0; 2]) == 1.0);
}

#[test]
fn bad_input_is_refused() {
    let mut wear = Wear::new(Some(healing_law()));
    let pad = published::heating([0.0; 2], 0.02);
    for treatment in [
        Treatment::Heat(Heating { temperature_c: 400.0, ..pad }),
        Treatment::Heat(Heating { radius_m: 0.0, ..pad }),
        Treatment::Heat(Heating { duration_s: f64::NAN, ..pad }),
        Treatment::TimeLapse(-1.0),
        Treatment::Warm(1.0),
        Treatment::Cut(Cut::open([0.0; 2], [0.0; 2])),
    ] {
        assert!(wear.treat(&treatment).is_err(), "{treatment:?}");
    }
}

#[test]
fn a_sheet_that_does_not_heal_can_still_be_cut_and_renewed() {
    let mut wear = Wear::new(None);
    wear.treat(&Treatment::Cut(Cut::open([0.0; 2], [0.01, 0.0]))).unwrap();
    let heat = Treatment::Heat(published::heating([0.0; 2], 0.02));
    assert!(matches!(wear.treat(&heat), Err(TwinError::NotTreatable)));
    wear.advance(1e6);
    assert_eq!(wear.wounds().next().unwrap().healed, 0.0);
    wear.treat(&Treatment::Renew).unwrap();
    assert_eq!(wear.wounds().count(), 0);
}
