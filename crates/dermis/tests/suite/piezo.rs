//! The piezoresistive skins from twin to touches: their noisy twins are pressed, and the whole pipeline locates the
//! presses. One backend file serves all three.

use dermis_skin::{Layer, Skin};
use dermis_tomo::mesh::{ElectrodeShape, Surface};
use dermis_twin::from_skin::patched_options;
use dermis_twin::physics::PatchLayout;

use crate::bench::Bench;

/// Frames until a press is established: the fade-in, and the minimum duration of a touch.
const SETTLE: usize = 12;
/// The paper's indenter.
const RADIUS_M: f64 = 0.011;

/// A built-in skin, with a baseline.
fn bench(name: &str) -> Bench {
    let mut skin = Skin::open(name).unwrap();
    // Coarser images than the file's 32 pixels per side, which halves the time for the operator.
    skin.imaging.grid = 24;
    Bench::of(skin)
}

fn press(bench: &mut Bench, pointer: u64, [x_mm, y_mm]: [f64; 2], pressure_pa: f64) {
    bench.twin.scene_mut().press(pointer, x_mm * 1e-3, y_mm * 1e-3, RADIUS_M, pressure_pa).unwrap();
}

/// Largest and mean error of single touches.
fn errors_mm(bench: &mut Bench, places: &[[f64; 2]], pressure_pa: f64) -> (f64, f64) {
    let mut errors = Vec::new();
    for &place in places {
        press(bench, 0, place, pressure_pa);
        bench.run(SETTLE);
        assert_eq!(bench.touches.len(), 1, "pressed at {place:?} mm: {:?}", bench.touches);
        errors.push(bench.error_mm(place));
        bench.release(SETTLE);
    }
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    (errors.iter().copied().fold(0.0, f64::max), mean)
}

#[test]
fn one_backend_serves_three_frontends() {
    let [square, disc, cylinder] = ["piezo-square", "piezo-disc", "piezo-cylinder"].map(|n| Skin::open(n).unwrap());
    assert_eq!(square.backend, disc.backend);
    assert_eq!(square.backend, cylinder.backend);
    assert_eq!(cylinder.surface(), Surface::Cylinder { radius_m: 0.095 });
    assert_eq!(square.surface(), Surface::Flat);
    for skin in [square, disc, cylinder] {
        let options = patched_options(&skin).unwrap();
        assert_eq!(skin.protocol().unwrap(), options.layer.protocol, "{}", skin.name);
        assert_eq!(skin.protocol().unwrap().channel_count(), 4096);
        assert!((skin.sheet_conductance_s() / options.sheet_s - 1.0).abs() < 1e-12);
        assert!((skin.sheet_conductance_s() * 2e3 - 1.0).abs() < 1e-12, "2 kohm");
        let pads = skin.electrode_shapes();
        assert_eq!(pads, options.layer.electrodes);
        assert_eq!(options.layer.contact_impedances_ohm_m2, [skin.frontend.contact_impedance_ohm_m2; 64]);
        for pad in &pads {
            let ElectrodeShape::PadCircle { radius_m, .. } = pad else { panic!("{pad:?} is not round") };
            assert_eq!(*radius_m, 1.5e-3);
        }
        let Layer::Patches(layer) = &skin.frontend.layer else { panic!("{} has no patches", skin.name) };
        let PatchLayout { pitch_m, gap_m, cells_per_side } = options.patches;
        assert!((1e3 * pitch_m - layer.pitch_mm).abs() < 1e-12 && (1e3 * gap_m - layer.gap_mm).abs() < 1e-12);
        assert!(layer.cells_per_side.is_none() && (3..=5).contains(&cells_per_side), "{cells_per_side}");
        assert!((1e3 * options.cover.smoothing_m - layer.smoothing_mm).abs() < 1e-12);
        assert!((1e-3 * options.contact.threshold_pa - layer.contact.threshold_kpa).abs() < 1e-12);
        assert!((1e-3 * options.contact.reference_pa - layer.contact.reference_kpa).abs() < 1e-12);
        assert_eq!(options.contact.exponent, layer.contact.exponent);
        assert_eq!(options.contact.saturation_s_per_m2, layer.contact.saturation_s_per_m2);
        // The written file is self-contained, so a recording needs no other file.
        assert_eq!(Skin::parse(&skin.to_toml(), "written").unwrap(), skin);
    }
}

#[test]
fn single_touches_on_the_disc_are_found_in_their_places() {
    let mut bench = bench("piezo-disc");
    let places: Vec<[f64; 2]> = (0..12)
        .map(|k| {
            let (angle, radius) = (2.4 * f64::from(k), 13.0 * f64::from(k).sqrt());
            [radius * angle.cos(), radius * angle.sin()]
        })
        .collect();
    let (largest, mean) = errors_mm(&mut bench, &places, 5e3);
    println!("disc: mean {mean:.2} mm, largest {largest:.2} mm");
    // A patch is shorted as a whole, so its pitch of 10 mm shows in the positions.
    assert!(mean < 3.0 && largest < 6.0, "mean {mean:.2} mm, largest {largest:.2} mm");
}

/// P3: a light touch, a hard one at the same place, and two at once, on the skin bent around the cylinder.
#[test]
fn the_cylinder_tells_light_from_hard_and_one_from_two() {
    let mut bench = bench("piezo-cylinder");
    let places = [[-37.0, 34.0], [29.0, -21.0]];
    press(&mut bench, 0, places[0], 1e3);
    bench.run(SETTLE);
    let light = bench.strongest;
    let error = bench.error_mm(places[0]);
    assert!(error < 4.0, "light touch {error:.1} mm off");
    press(&mut bench, 0, places[0], 10e3);
    bench.run(SETTLE);
    let hard = bench.strongest;
    assert!(hard > 1.5 * light, "hard {hard:.3}, light {light:.3}");
    press(&mut bench, 1, places[1], 10e3);
    bench.run(SETTLE);
    assert_eq!(bench.touches.len(), 2, "{:?}", bench.touches);
    let errors = places.map(|place| bench.error_mm(place));
    println!("cylinder: light {light:.3}, hard {hard:.3}, two touches {errors:.2?} mm off");
    assert!(errors.iter().all(|error| *error < 5.0), "{errors:?} mm");
    bench.release(SETTLE);
    let places: Vec<[f64; 2]> =
        (0..9).map(|k| [-52.0 + 50.0 * f64::from(k % 3), -47.0 + 51.0 * f64::from(k / 3)]).collect();
    let (largest, mean) = errors_mm(&mut bench, &places, 5e3);
    println!("cylinder: mean {mean:.2} mm, largest {largest:.2} mm");
    assert!(mean < 2.5 && largest < 5.0, "mean {mean:.2} mm, largest {largest:.2} mm");
}
