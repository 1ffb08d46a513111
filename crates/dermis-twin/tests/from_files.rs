//! The files of the built-in skins must give the twins of the published skins, number by number.

mod published;

use dermis_mit::Coupling;
use dermis_skin::Skin;
use dermis_tomo::mesh::{ElectrodeShape, distance};
use dermis_twin::from_skin::{element_options, instrument_options, patched_options};
use dermis_twin::instrument::{Converter, InstrumentOptions};
use dermis_twin::mechanics::Indenter;
use dermis_twin::physics::PatchLayout;
use dermis_twin::{AnyTwin, ElectrodedLayer, ElementOptions, Frontend, LiquidSkin, Sandwich};
use published::*;

fn open(name: &str) -> Skin {
    Skin::open(name).unwrap()
}

/// True if two numbers differ only by rounding.
fn same(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

/// The converter's range and gain combine into one number at the skin; the rest is identical up to rounding.
fn same_instrument(file: InstrumentOptions, published: InstrumentOptions) {
    let at_skin =
        |options: InstrumentOptions| options.converter.map(|Converter { bits, range_v, gain }| (bits, range_v / gain));
    assert_eq!(at_skin(file), at_skin(published));
    let noise = |options: InstrumentOptions| [options.noise.floor_v, options.noise.proportional];
    assert!(noise(file).iter().zip(noise(published)).all(|(a, b)| same(*a, b)), "{file:?} {published:?}");
    let rest = |options: InstrumentOptions| {
        (options.drift, options.multiplexer, options.gain_ranges, options.timing, options.reading, options.mains)
    };
    assert_eq!(rest(file), rest(published));
    match (file.drive, published.drive) {
        (Some(a), Some(b)) => {
            assert!(same(a.wanted_a, b.wanted_a) && same(a.step_a, b.step_a) && same(a.most_a, b.most_a));
        }
        (a, b) => assert_eq!(a, b),
    }
}

/// Readings at rest, pressed, and one second later.
fn frames(frontend: &mut dyn Frontend, press: Indenter) -> Vec<f64> {
    let mut all = Vec::new();
    for (indenters, dt_s) in [(&[][..], 0.0), (&[press][..], 0.1), (&[press][..], 1.0)] {
        let mut frame = vec![0.0; frontend.channel_count()];
        frontend.voltages(indenters, dt_s, &mut frame).unwrap();
        all.extend(frame);
    }
    all
}

fn same_frames(name: &str, published: &mut dyn Frontend, press: Indenter) {
    let (mut twin, ..) = AnyTwin::from_skin(&open(name)).unwrap().into_parts();
    let (file, published) = (frames(&mut *twin, press), frames(published, press));
    let largest = published.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let apart = file.iter().zip(&published).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
    assert!(file.len() == published.len() && apart < 1e-9 * largest, "{name}: {apart} of {largest}");
}

#[test]
fn elements_over_coils() {
    for (name, options, snr_db, rate_hz) in [
        ("em-8", em_8(), 83.0, 10.0),
        ("em-16-circular", em_16_circular(), 50.0, 1.0),
        ("em-16-square", em_16_square(), 53.0, 1.0),
    ] {
        let skin = open(name);
        let made = element_options(&skin).unwrap();
        // Cylinders in the file; balls of equal volume in the published options.
        let radius_m = skin.element().unwrap().shape.volume_radius_m();
        assert!(same(radius_m, options.body().unwrap().radius_m), "{name}: {radius_m}");
        for (a, b) in made.places_m.iter().zip(&options.places_m) {
            assert!(distance(*a, *b) < 1e-15, "{name}: {a:?} {b:?}");
        }
        // Neighbours along sides and diagonals excite each other; elements two cells apart do not.
        for coupling in [made.coupling, options.coupling] {
            let cells = coupling.unwrap().reach_m / made.cell_m[0];
            assert!((2_f64.sqrt()..2.0).contains(&cells), "{name}: {cells}");
        }
        let reach_m = options.coupling.unwrap().reach_m;
        let coupling = made.coupling.map(|coupling| Coupling { reach_m, ..coupling });
        let (element, places_m) = (options.element.clone(), options.places_m.clone());
        assert_eq!(made.places_m.len(), places_m.len());
        assert_eq!(ElementOptions { coupling, element, places_m, ..made }, options, "{name}");
        same_instrument(instrument_options(&skin, 1.0), em_instrument(snr_db));
        assert_eq!(skin.backend.frames_per_s, Some(rate_hz));
    }
}

#[test]
fn patches() {
    for (name, options) in [("piezo-square", piezo_square()), ("piezo-disc", piezo_disc())] {
        let skin = open(name);
        let made = patched_options(&skin).unwrap();
        assert!(same(made.sheet_s, options.sheet_s) && same(made.cover.smoothing_m, options.cover.smoothing_m));
        assert_eq!(made.layer.contact_impedances_ohm_m2, [options.layer.contact_impedances_ohm_m2[0]; 64]);
        assert_eq!(made.layer.outline, options.layer.outline, "{name}");
        assert_eq!(made.layer.protocol, options.layer.protocol, "{name}");
        // The file leaves the number of cells to the twin.
        let layout = PatchLayout { cells_per_side: made.patches.cells_per_side, ..options.patches };
        assert_eq!((made.patches, made.contact, made.memory), (layout, options.contact, options.memory));
        let sizes = |layer: &ElectrodedLayer| [layer.element_size_m, layer.electrode_element_size_m];
        assert!(sizes(&made.layer).iter().zip(sizes(&options.layer)).all(|(a, b)| same(*a, b)));
        let pad = |shape: &ElectrodeShape| match *shape {
            ElectrodeShape::PadCircle { centre_m, radius_m } => (centre_m, radius_m),
            _ => panic!("{shape:?} is not round"),
        };
        for (a, b) in made.layer.electrodes.iter().zip(&options.layer.electrodes) {
            let ((centre, radius), (wanted, expected)) = (pad(a), pad(b));
            assert!(distance(centre, wanted) < 1e-15 && radius == expected, "{a:?} {b:?}");
        }
        same_instrument(instrument_options(&skin, 1.0), piezo_instrument());
        assert_eq!(skin.backend.frames_per_s, Some(PIEZO_RATE_HZ));
    }
}

#[test]
fn liquids() {
    let press = Indenter::weight([0.02, -0.03], 0.01, 26.0);
    for (name, options) in [("ionic-disc", ionic_disc()), ("ionic-square", ionic_square())] {
        let skin = open(name);
        let mut published = LiquidSkin::new(options).unwrap();
        let model = skin.body().unwrap().mesh.mesh.element_count();
        assert!(published.fields().element_count() > model, "{name}: finer than the model of images");
        same_frames(name, &mut published, press);
        same_instrument(instrument_options(&skin, 1.0), ionic_instrument());
        assert_eq!(skin.backend.frames_per_s, Some(IONIC_RATE_HZ));
    }
}

#[test]
fn the_sandwich() {
    let mut published = Sandwich::new(healing_square()).unwrap();
    same_frames("healing-square", &mut published, Indenter::disc([0.01, -0.02], 0.01, 80e3));
    let skin = open("healing-square");
    same_instrument(instrument_options(&skin, 1.0), healing_instrument());
    assert_eq!(skin.backend.frames_per_s, Some(HEALING_RATE_HZ));
}
