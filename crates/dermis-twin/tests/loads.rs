//! Loads over time on every twin (ramp, tap, sine, script, random), and loads that no skin can carry.

mod published;

use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::scene::{Place, RandomTouches, SceneOptions, Script};
use dermis_twin::{Frontend, LiquidOptions, LiquidSkin, PatchedSkin, Sandwich, Twin, TwinError, TwinOptions};
use published::{healing_square, ionic_disc, piezo_disc};

type Any = Twin<Box<dyn Frontend>>;

/// Builds a skin's twin with a script.
type Make = fn(Option<Script>) -> Result<Any, TwinError>;

fn healing(script: Option<Script>) -> Result<Any, TwinError> {
    let scene = SceneOptions { script_waits_s: 0.0, ..Default::default() };
    let options = healing_square().meshed(6e-3, 3e-3);
    Ok(Twin::of(Sandwich::new(options)?, &TwinOptions { scene, script, ..TwinOptions::default() })?.boxed())
}

fn ionic(script: Option<Script>) -> Result<Any, TwinError> {
    let options = LiquidOptions { memory: None, ..ionic_disc().meshed(9e-3, 1.2e-3) };
    Ok(Twin::of(LiquidSkin::new(options)?, &TwinOptions { script, ..TwinOptions::default() })?.boxed())
}

fn piezo(script: Option<Script>) -> Result<Any, TwinError> {
    let options = piezo_disc().meshed(7e-3, 3e-3);
    Ok(Twin::of(PatchedSkin::new(options)?, &TwinOptions { script, ..TwinOptions::default() })?.boxed())
}

const SKINS: [(&str, Make, f64); 3] =
    [("healing-square", healing, 80e3), ("ionic-disc", ionic, 800.0), ("piezo-disc", piezo, 2e3)];
const PLACE: Place = Place { x_m: 0.013, y_m: -0.008, radius_m: 0.01 };
const RATE_HZ: f64 = 20.0;

/// Pressure and signal (norm of the change from the frame before the script) in each frame.
fn run(make: Make, script: Script, frames: usize) -> Vec<(f64, f64)> {
    let (mut twin, mut frame) = (make(None).unwrap(), Vec::new());
    twin.step(0.0, &mut frame).unwrap();
    let rest = frame.clone();
    twin.scene_mut().set_script(Some(script)).unwrap();
    (1..=frames)
        .map(|k| {
            let truth = twin.step(k as f64 / RATE_HZ, &mut frame).unwrap();
            let pressure = truth.touches.iter().map(|touch| touch.pressure_pa).sum();
            let change = frame.iter().zip(&rest).map(|(v, v0)| (v - v0) * (v - v0)).sum::<f64>().sqrt();
            (pressure, change)
        })
        .collect()
}

#[test]
fn a_ramp_raises_the_signal_of_every_twin() {
    for (name, make, pressure) in SKINS {
        let seen = run(make, Script::ramp(PLACE, [0.0, pressure], 0.8, 0.2).unwrap(), 19);
        // Frame k is at k / 20 s of the script; the fade of 80 ms ends after two frames.
        for (k, (now, _)) in seen.iter().enumerate().skip(2).take(13) {
            let exact = pressure * (k + 1) as f64 / RATE_HZ / 0.8;
            assert!((now / exact - 1.0).abs() < 1e-5, "{name} frame {k}: {now} Pa, {exact}");
        }
        let changes: Vec<f64> = seen.iter().map(|(_, change)| *change).collect();
        assert!(changes[..16].windows(2).all(|pair| pair[1] >= pair[0]), "{name}: {changes:?}");
        assert!(changes[15] > 0.0 && changes[15] == changes[18], "{name}: {changes:?}");
    }
}

#[test]
fn taps_and_sines_show_in_every_twin() {
    for (name, make, pressure) in SKINS {
        let seen = run(make, Script::taps(PLACE, pressure, 2.0, 0.5, 3).unwrap(), 29);
        let most = seen.iter().map(|(_, change)| *change).fold(0.0, f64::max);
        let ups = seen.windows(2).filter(|pair| pair[0].1 < 0.5 * most && pair[1].1 >= 0.5 * most).count();
        // The first tap starts before the first frame.
        assert_eq!(ups + usize::from(seen[0].1 >= 0.5 * most), 3, "{name}");
        let seen = run(make, Script::sine(PLACE, pressure, 0.5 * pressure, 2.0, 2.0).unwrap(), 39);
        for (k, (now, _)) in seen.iter().enumerate().skip(2) {
            let exact = pressure * (1.0 + 0.5 * (std::f64::consts::TAU * 2.0 * (k + 1) as f64 / RATE_HZ).sin());
            assert!((now / exact - 1.0).abs() < 2e-3, "{name} frame {k}: {now} {exact}");
        }
        // Ten frames per period: the signal repeats, and is larger at higher pressure.
        let changes: Vec<f64> = seen.iter().map(|(_, change)| *change).collect();
        assert!((10..29).all(|k| (changes[k] / changes[k + 10] - 1.0).abs() < 1e-3), "{name}: {changes:?}");
        assert!(changes[12] > 1.05 * changes[17], "{name}: {changes:?}");
    }
}

#[test]
fn random_touches_press_every_twin() {
    for (name, make, pressure) in SKINS {
        let mut random = RandomTouches::new(3);
        (random.pressure_pa, random.half_width_m) = ([0.5 * pressure, pressure], 0.03);
        let seen = run(make, random.script(3, 2, 0.25).unwrap(), 29);
        let most = seen.iter().map(|(_, change)| *change).fold(0.0, f64::max);
        let pressed = seen.iter().filter(|(_, change)| *change > 0.05 * most).count();
        assert!((12..=25).contains(&pressed), "{name}: {pressed}");
    }
}

#[test]
fn unbearable_loads_are_refused_at_the_call() {
    for (name, make, pressure) in SKINS {
        let mut twin = make(None).unwrap();
        let good = Indenter::disc([0.01, 0.0], 0.01, pressure);
        let mut refused = |indenter: Indenter| twin.scene_mut().press_with(1, indenter).unwrap_err().to_string();
        let off = refused(Indenter { centre_m: [0.2, 0.0], ..good });
        assert!(off.contains("0.2 refused") && off.contains("skin's rim"), "{name}: {off}");
        let huge = refused(Indenter { shape: Shape::Disc { radius_m: 0.5 }, ..good });
        assert!(huge.starts_with("area of the indenter, m^2: 0.78"), "{name}: {huge}");
        for load in [Load::ForceN(f64::NAN), Load::ForceN(1e9), Load::ForceN(-1.0), Load::PressurePa(f64::INFINITY)] {
            let error = refused(Indenter { load, ..good });
            assert!(error.contains("refused; expected 0 to"), "{name}: {error}");
        }
        // A large force that is otherwise valid, on a face of a micrometre.
        let needle = refused(Indenter { shape: Shape::Disc { radius_m: 1e-6 }, load: Load::ForceN(1e3), ..good });
        assert!(needle.starts_with("pressure_pa: 318"), "{name}: {needle}");
        twin.scene_mut().press_with(1, good).unwrap();
        assert!(twin.scene_mut().move_to(1, 0.0, -0.3).is_err(), "{name}");
        let script = Script::ramp(Place { x_m: 0.3, ..PLACE }, [0.0, pressure], 1.0, 0.0).unwrap();
        let error = twin.scene_mut().set_script(Some(script.clone())).unwrap_err().to_string();
        assert!(error.starts_with("script event 0: ") && error.contains("0.3"), "{name}: {error}");
        assert!(make(Some(script)).is_err(), "{name}");
        // The refused presses changed nothing: the good press continues.
        let mut frame = Vec::new();
        assert_eq!(twin.step(0.0, &mut frame).unwrap().touches[0].x_m, 0.01, "{name}");
    }
}

#[test]
fn a_membrane_on_the_bottom_is_reported() {
    let mut twin = ionic(None).unwrap();
    let mut frame = Vec::new();
    twin.step(0.0, &mut frame).unwrap();
    assert_eq!(twin.frontend().outside_validity(), None);
    let heavy = Indenter { load: Load::ForceN(6.0), ..Indenter::disc([0.01, 0.0], 0.01, 0.0) };
    twin.scene_mut().press_with(1, heavy).unwrap();
    twin.step(1.0, &mut frame).unwrap();
    let text = twin.frontend().outside_validity().unwrap();
    assert!(text.starts_with("the membrane touches the bottom"), "{text}");
    assert!(frame.iter().all(|voltage| voltage.is_finite()));
}
