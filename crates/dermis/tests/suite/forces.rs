//! Force calibrations on the liquid skin's twin, applied at positions and forces that were not used to make them.

use dermis_lab::forces::{PressPlan, fit_forces, press_twin};
use dermis_lab::twin_bench::Rig;
use dermis_live::forces::{load_forces, save_forces};
use dermis_skin::Skin;
use dermis_touch::force::{CalibrationScope, CurveKind, ForceReading, ForceSample};
use dermis_twin::mechanics::{Indenter, Load, Shape};

use crate::random_skins::{LAYERS, written};

fn scope(skin: &str, plan: &PressPlan) -> CalibrationScope {
    let indenter_area_m2 = 0.25 * std::f64::consts::PI * plan.indenter_m.powi(2);
    CalibrationScope { skin: skin.into(), indenter_area_m2, date: "2026-01-31".into() }
}

#[test]
fn forces_are_right_at_places_and_loads_that_were_not_calibrated() {
    let skin = Skin::open("ionic-disc").unwrap();
    let plan = PressPlan { steps: 4, most_n: 0.58, ..PressPlan::of(&skin).unwrap() };
    let mut seen = 0;
    let samples = press_twin(&skin, &plan, |done, _| seen = done).unwrap();
    assert_eq!((samples.len(), seen), (36, 36));
    let calibration = fit_forces(&samples, CurveKind::Quadratic, scope("ionic-disc", &plan)).unwrap();
    let range = calibration.valid_force_n[1] - calibration.valid_force_n[0];
    println!("residual {:.4} N of {range:.3} N", calibration.residual_n);
    // The published line fits all places within a twentieth (paper I, its single calibration line).
    assert!(calibration.residual_n < 0.05 * range, "{calibration:?}");

    let mut rig = Rig::new("ionic-disc").unwrap();
    rig.set_forces(Some(calibration.clone())).unwrap();
    let mut press = |place: [f64; 2], force_n: f64| {
        let shape = Shape::Disc { radius_m: 0.5 * plan.indenter_m };
        let indenter = Indenter { centre_m: place, shape, load: Load::ForceN(force_n) };
        let frame = rig.mean_frame(&[indenter], 10).unwrap();
        let image = rig.image(&frame).unwrap();
        rig.touches(&image).unwrap()[0].force.unwrap()
    };
    for (place, force_n) in [([0.01, 0.02], 0.3), ([-0.03, 0.015], 0.2), ([0.02, -0.04], 0.5)] {
        let reading = press(place, force_n);
        println!("{force_n} N at {place:?}: {reading:?}");
        // Four of its own standard deviations.
        let off = (reading.valid_n().unwrap() - force_n).abs();
        assert!(off < 4.0 * reading.sigma_n().unwrap() && off < 0.03 * force_n, "{force_n}: {reading:?}");
    }
    // Out of range, the law goes on, less certain.
    for force_n in [0.07, 1.2] {
        let reading = press([0.0, 0.0], force_n);
        assert_eq!(reading.range(), "law");
        assert!((reading.nearest_n().unwrap() / force_n - 1.0).abs() < 0.1, "{force_n}: {reading:?}");
    }
}

#[test]
fn five_presses_of_known_force_correct_the_law_of_a_layer_that_saturates() {
    let layer = "{ kind = \"sandwich\", thickness_mm = 1.0, conductivity_s_per_m = 5.0 }";
    let skin = written("{ square = { side_mm = 100.0 } }", layer, (16, 8.0), 0, "");
    let plan = PressPlan::of(&skin).unwrap();
    // From 0.3 to 3 times the usual force.
    let usual_n = plan.most_n / 1.5;
    let press = |[x, y]: [f64; 2], share: f64| {
        let shape = Shape::Disc { radius_m: 0.5 * plan.indenter_m };
        Indenter { centre_m: [x, y], shape, load: Load::ForceN(share * usual_n) }
    };
    let places = [[0.0, 0.0], [0.025, 0.02], [-0.03, 0.01], [0.01, -0.03], [-0.015, -0.02]];
    let known: Vec<Indenter> =
        places.into_iter().zip([0.4, 1.0, 2.5, 0.7, 1.6]).map(|(place, share)| press(place, share)).collect();
    let kit = dermis_twin::TwinKit::of(&skin).unwrap();
    let (frontend, instrument, _) = kit.twin.into_parts();
    let mut rig = Rig::from_parts(skin.clone(), frontend, instrument).unwrap();
    let read = |rig: &mut Rig, indenter: Indenter| {
        let frame = rig.mean_frame(&[indenter], 1).unwrap();
        let image = rig.image(&frame).unwrap();
        rig.touches(&image).unwrap()[0].force.unwrap()
    };
    rig.set_indenter(0.5 * plan.indenter_m).unwrap();
    let samples: Vec<ForceSample> = known
        .into_iter()
        .map(|indenter| {
            let ForceReading::FromLaw { force_n, sigma_n } = read(&mut rig, indenter) else { panic!("no law") };
            let by_law = Some([force_n, sigma_n]);
            ForceSample { position_m: indenter.centre_m, force_n: indenter.force_n(), signal: 1.0, by_law }
        })
        .collect();
    let calibration = fit_forces(&samples, CurveKind::Quadratic, scope(&skin.name, &plan)).unwrap();
    rig.set_forces(Some(calibration)).unwrap();
    let (mut errors, mut within) = (Vec::new(), 0);
    for k in 0..15 {
        let angle = 2.4 * f64::from(k);
        let place = [angle.cos(), angle.sin()].map(|share| 0.035 * (f64::from(k + 1) / 15.0).sqrt() * share);
        let indenter = press(place, 0.3 * 10.0_f64.powf(f64::from((4 * k) % 15) / 14.0));
        let reading = read(&mut rig, indenter);
        let off = reading.nearest_n().unwrap() - indenter.force_n();
        println!("{:.1} N at {place:?}: {reading:?}", indenter.force_n());
        errors.push((off / indenter.force_n()).abs());
        within += u32::from(off.abs() < 2.5 * reading.sigma_n().unwrap());
    }
    errors.sort_by(f64::total_cmp);
    // Without the five presses, radius and pressure cannot be distinguished, and the median error is 0.3.
    assert!(errors[7] < 0.1, "{errors:?}");
    assert!(within >= 13, "{within} of 15 within 2.5 sigma");
}

#[test]
fn a_hard_press_is_a_touch_with_a_least_force() {
    for layer in LAYERS.into_iter().filter(|layer| !layer.contains("sandwich")) {
        let gain = if layer.contains("liquid") { "gain = \"channel\"" } else { "" };
        let skin = written("{ disc = { diameter_mm = 100.0 } }", layer, (16, 8.0), 0, gain);
        let plan = PressPlan::of(&skin).unwrap();
        let (frontend, instrument, _) = dermis_twin::TwinKit::of(&skin).unwrap().twin.into_parts();
        let mut rig = Rig::from_parts(skin, frontend, instrument).unwrap();
        for (place, share) in [([0.01, 0.005], 6.0), ([-0.02, 0.015], 12.0), ([0.015, -0.02], 20.0)] {
            let shape = Shape::Disc { radius_m: 0.5 * plan.indenter_m };
            let indenter = Indenter { centre_m: place, shape, load: Load::ForceN(share * plan.most_n / 1.5) };
            let frame = rig.mean_frame(&[indenter], 1).unwrap();
            let image = rig.image(&frame).unwrap();
            let touches = rig.touches(&image).unwrap();
            let [touch] = &touches[..] else { panic!("{} touches at {place:?} on {layer}", touches.len()) };
            let off = [0, 1].map(|axis| touch.centroid_m[axis] - place[axis]);
            let off_m = off[0].hypot(off[1]);
            println!(
                "{share} times the usual press, {:.2} N: {:.2} mm off, {:?}: {layer}",
                indenter.force_n(),
                1e3 * off_m,
                touch.force
            );
            assert!(off_m < 5e-3, "{off:?}");
            match touch.force {
                None => {}
                Some(ForceReading::FromLaw { force_n, sigma_n }) => {
                    assert!((force_n - indenter.force_n()).abs() < 2.5 * sigma_n, "{:?}", touch.force);
                }
                Some(force) => {
                    assert_eq!(force.range(), "saturated");
                    assert!(force.nearest_n().unwrap() < 1.05 * indenter.force_n(), "{force:?}");
                }
            }
        }
    }
}

#[test]
fn bad_files_are_refused_with_the_cause() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("forces.json");
    let skin = Skin::open("ionic-disc").unwrap();
    let plan = PressPlan { steps: 2, ..PressPlan::of(&skin).unwrap() };
    let samples: Vec<_> = (1..=4)
        .map(|k| dermis_touch::force::ForceSample {
            position_m: [0.0; 2],
            force_n: 0.1 * f64::from(k),
            signal: f64::from(k),
            by_law: None,
        })
        .collect();
    let calibration = fit_forces(&samples, CurveKind::Linear, scope("ionic-disc", &plan)).unwrap();
    assert!(calibration.signal.as_ref().is_some_and(|signal| signal.gain.is_none()));
    save_forces(&calibration, &skin, &path).unwrap();
    assert_eq!(load_forces(&path, &skin).unwrap(), calibration);
    let other = load_forces(&path, &Skin::open("piezo-disc").unwrap()).unwrap_err().to_string();
    assert!(other.contains("forces.json") && other.contains("ionic-disc") && other.contains("piezo-disc"), "{other}");
    // A skin with the same name, but twice as large.
    let text = dermis_skin::builtin_text("ionic-disc").unwrap().replace("diameter_mm = 174.0", "diameter_mm = 348.0");
    let larger = Skin::parse(&text, "larger").unwrap();
    let error = load_forces(&path, &larger).unwrap_err().to_string();
    assert!(error.contains("fingerprint") && error.contains("--as-skin"), "{error}");
    let insisted = dermis_live::forces::parse_forces_as(&std::fs::read(&path).unwrap(), &path, &larger).unwrap();
    assert_eq!(insisted, calibration);
    std::fs::write(&path, "{\"scope\": 3}").unwrap();
    let broken = load_forces(&path, &skin).unwrap_err().to_string();
    assert!(broken.contains("line 1"), "{broken}");

    assert!(press_twin(&skin, &PressPlan { most_n: -1.0, ..plan.clone() }, |_, _| {}).is_err());
    assert!(press_twin(&skin, &PressPlan { indenter_m: f64::NAN, ..plan.clone() }, |_, _| {}).is_err());
    // A tank has a twin too, into which objects are dipped.
    assert!(PressPlan::of(&Skin::open("ktc-tank").unwrap()).is_ok());
}
