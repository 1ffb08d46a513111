//! Patched skins as a whole, on the published piezoresistive ones: the low-rank update compared with a factorisation
//! of all unknowns, reciprocity, interaction between patches, and the small effect of bending even when solved on
//! chords.

mod published;

use dermis_tomo::eit::ForwardModel;
use dermis_tomo::mesh::Surface;
use dermis_twin::mechanics::Indenter;
use dermis_twin::physics::{PatchedSheet, direct_patched_impedance};
use dermis_twin::piezo::PUBLISHED_LIMITS_PA;
use dermis_twin::{Frontend, PaperP, PatchedOptions, PatchedSkin};
use faer::Mat;
use published::{piezo_disc, piezo_instrument, piezo_square};

/// A coarser mesh and 500 cells: enough for the behaviour, and fast.
fn coarse(options: PatchedOptions) -> PatchedOptions {
    let mut options = options.meshed(6e-3, 2e-3);
    options.patches.pitch_m = 15e-3;
    options.patches.cells_per_side = 2;
    options
}

fn voltages(skin: &mut PatchedSkin, indenters: &[Indenter]) -> Vec<f64> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.0, &mut frame).unwrap();
    frame
}

fn press(x_mm: f64, y_mm: f64, pressure_pa: f64) -> Indenter {
    Indenter::disc([x_mm * 1e-3, y_mm * 1e-3], 0.01, pressure_pa)
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
    norm(a.iter().zip(b).map(|(x, y)| x - y)) / norm(b.iter().copied())
}

fn change(skin: &mut PatchedSkin, indenters: &[Indenter]) -> Vec<f64> {
    let rest = voltages(skin, &[]);
    voltages(skin, indenters).iter().zip(&rest).map(|(v, v0)| v - v0).collect()
}

#[test]
fn frames_have_4096_channels_and_only_the_sinks_read_nothing() {
    for options in [piezo_square(), piezo_disc()] {
        let mut skin = PatchedSkin::new(coarse(options)).unwrap();
        let frame = voltages(&mut skin, &[]);
        assert_eq!(frame.len(), 4096);
        assert_eq!(frame.iter().filter(|v| **v == 0.0).count(), 64);
        // With a grounded sink, nothing is below it.
        assert!(frame.iter().all(|v| *v >= 0.0));
    }
}

#[test]
fn unpressed_skin_is_a_single_sheet() {
    let options = coarse(piezo_disc());
    let mut skin = PatchedSkin::new(options.clone()).unwrap();
    let model = ForwardModel::new(skin.body().clone(), skin.stimulation().clone()).unwrap();
    let sheet = vec![options.sheet_s; skin.body().mesh.element_count()];
    let expected = model.solve(&sheet).unwrap().voltages();
    // The same equations in other code: only rounding differs.
    assert!(relative_difference(&voltages(&mut skin, &[]), &expected) < 1e-9);
}

#[test]
fn the_update_is_the_factor_of_all_unknowns() {
    let options = coarse(piezo_square());
    let mut skin = PatchedSkin::new(options.clone()).unwrap();
    let presses = [press(-30.0, 5.0, 20e3), press(35.0, -42.0, 800.0), press(-12.0, 5.0, 3e3)];
    voltages(&mut skin, &presses);
    let contact = skin.contact_s_per_m2().to_vec();
    assert!(contact.iter().filter(|g| **g > 0.0).count() > 30);
    let flat = skin.body();
    let exact = direct_patched_impedance(flat, options.sheet_s, options.patches, &contact).unwrap();
    let mut sheet = PatchedSheet::new(flat, options.sheet_s, options.patches, &Default::default()).unwrap();
    let update = sheet.impedance(&contact).unwrap();
    let difference: Mat<f64> = &exact - update;
    assert!(difference.norm_l2() < 1e-9 * exact.norm_l2(), "{:e}", difference.norm_l2() / exact.norm_l2());
    // Without contact the impedances differ, so the update has an effect.
    let open = sheet.impedance(&vec![0.0; contact.len()]).unwrap().to_owned();
    assert!((&exact - &open).norm_l2() > 1e-3 * exact.norm_l2());
}

#[test]
fn the_matrix_of_impedances_is_reciprocal() {
    let options = coarse(piezo_disc());
    let mut skin = PatchedSkin::new(options.clone()).unwrap();
    let frame = voltages(&mut skin, &[press(10.0, 5.0, 5e3), press(-30.0, 10.0, 2e3)]);
    // Drive k sinks at k and sources at k+1; its reading of electrode j is (e_j - e_k)' Z (e_{k+1} - e_k).
    let reading = |drive: usize, electrode: usize| frame[64 * drive + electrode];
    let transfer = |drive: usize, pair: usize| reading(drive, (pair + 1) % 64) - reading(drive, pair);
    let largest = frame.iter().copied().fold(0.0, f64::max);
    for a in 0..64 {
        for b in 0..a {
            // Rounding of sums of voltages of this size.
            assert!((transfer(a, b) - transfer(b, a)).abs() < 1e-13 * largest, "{a} {b}");
        }
    }
}

#[test]
fn pressing_harder_always_lowers_the_power_of_the_drives() {
    // Rayleigh: closing contacts can only lower the power of given currents, here the voltage of each source.
    let mut skin = PatchedSkin::new(coarse(piezo_square())).unwrap();
    let sources = |frame: &[f64]| -> Vec<f64> { (0..64).map(|k| frame[64 * k + (k + 1) % 64]).collect() };
    let mut before = sources(&voltages(&mut skin, &[]));
    for pressure in [100.0, 300.0, 1e3, 5e3, 50e3] {
        let after = sources(&voltages(&mut skin, &[press(5.0, -3.0, pressure)]));
        assert!(after.iter().zip(&before).all(|(a, b)| *a <= b * (1.0 + 1e-13)), "{pressure} Pa");
        assert!(after.iter().sum::<f64>() < before.iter().sum::<f64>() - 1e-9, "{pressure} Pa");
        before = after;
    }
}

#[test]
fn below_the_gap_nothing_happens() {
    let mut skin = PatchedSkin::new(coarse(piezo_square())).unwrap();
    let gap = piezo_square().contact.threshold_pa;
    assert!(norm(change(&mut skin, &[press(0.0, 0.0, 0.9 * gap)]).into_iter()) == 0.0);
    assert!(norm(change(&mut skin, &[press(0.0, 0.0, 5.0 * gap)]).into_iter()) > 0.0);
}

#[test]
fn far_touches_on_different_patches_add() {
    let mut skin = PatchedSkin::new(coarse(piezo_square())).unwrap();
    let (one, other) = (press(-52.5, -52.5, 3e3), press(52.5, 52.5, 3e3));
    let first = change(&mut skin, &[one]);
    let second = change(&mut skin, &[other]);
    let both = change(&mut skin, &[one, other]);
    let sum: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
    // Only the sheet in between connects the two: the field of a dipole falls with the square of the distance, and so
    // does the field that it causes in turn. Continuous copper would short the two together.
    let error = relative_difference(&both, &sum);
    assert!(error < 0.01, "{error}");
    // Both touch the same patches, where they do not add up.
    let near = press(-47.5, -52.5, 3e3);
    let beside = change(&mut skin, &[near]);
    let both = change(&mut skin, &[one, near]);
    let sum: Vec<f64> = first.iter().zip(&beside).map(|(a, b)| a + b).collect();
    assert!(relative_difference(&both, &sum) > 5.0 * error);
}

#[test]
fn one_contact_of_a_floating_patch_carries_nothing() {
    let options = coarse(piezo_square());
    let skin = PatchedSkin::new(options.clone()).unwrap();
    let mut sheet = skin.sheet().clone();
    let patch = sheet.cells()[210].patch;
    let mut contact = vec![0.0; sheet.cells().len()];
    let open = sheet.impedance(&contact).unwrap().to_owned();
    contact[210] = 100.0;
    let single = sheet.impedance(&contact).unwrap().to_owned();
    assert!((&single - &open).norm_l2() < 1e-12 * open.norm_l2());
    // A second contact of the same patch closes a path around the sheet.
    let other = (0..contact.len()).find(|&k| k != 210 && sheet.cells()[k].patch == patch).unwrap();
    contact[other] = 100.0;
    let closed = sheet.impedance(&contact).unwrap().to_owned();
    assert!((&closed - &open).norm_l2() > 1e-6 * open.norm_l2());
}

#[test]
fn bending_changes_nothing() {
    let surface = Surface::Cylinder { radius_m: 0.095 };
    let options = coarse(piezo_square());
    let mut flat = PatchedSkin::new(options.clone()).unwrap();
    let bent = surface.bend(flat.body()).unwrap();
    let (low, high) = bent.mesh.bounds();
    assert!(high[0] - low[0] < 0.14 && high[2] - low[2] > 0.02, "it is bent: {low:?} {high:?}");
    // Laid flat again, lengths along the surface equal the sheet's up to rounding.
    voltages(&mut flat, &[press(40.0, 10.0, 5e3), press(-20.0, -33.0, 2e3)]);
    let contact = flat.contact_s_per_m2().to_vec();
    let mut unrolled =
        PatchedSheet::new(&surface.unroll(&bent).unwrap(), options.sheet_s, options.patches, &Default::default())
            .unwrap();
    let mut sheet = flat.sheet().clone();
    let expected = sheet.impedance(&contact).unwrap().to_owned();
    let difference = (&expected - unrolled.impedance(&contact).unwrap()).norm_l2() / expected.norm_l2();
    assert!(difference < 1e-12, "{difference:e}");
    // The same mesh solved on the chords between its nodes: elements of 6 mm are narrower by (6/95)^2 / 24 = 1.7e-4.
    let conductance = vec![options.sheet_s; bent.mesh.element_count()];
    let model = ForwardModel::new(bent, flat.stimulation().clone()).unwrap();
    let chords = model.solve(&conductance).unwrap().voltages();
    let difference = relative_difference(&chords, &voltages(&mut flat, &[]));
    assert!((1e-7..2e-4).contains(&difference), "{difference:e}");
}

#[test]
fn bad_input_is_refused() {
    let refused = |options: PatchedOptions| PatchedSkin::new(options).unwrap_err().to_string();
    let mut options = piezo_square();
    options.patches.pitch_m = 2e-3;
    let error = refused(options);
    assert!(error.starts_with("contact cells on the sheet: 5") && error.contains("larger pitch"), "{error}");
    let error = refused(PatchedOptions { sheet_s: -1.0, ..piezo_disc() });
    assert_eq!(error, "sheet_s: -1 refused; expected positive and finite");
}

#[test]
fn one_limit_of_detection_fixes_one_parameter() {
    let mut options = coarse(piezo_square());
    options.patches.pitch_m = 10e-3;
    let of = |square: &PatchedOptions| {
        let disc = PatchedOptions { patches: square.patches, ..coarse(piezo_disc()) };
        PaperP::new(square.clone(), disc, piezo_instrument(), 1).unwrap()
    };
    let mut paper = of(&options);
    let reference_pa = paper.fit().unwrap();
    assert!((100.0..1e5).contains(&reference_pa), "{reference_pa}");
    let [square, disc] = paper.facts().unwrap();
    assert!((square.detection.limit_pa - PUBLISHED_LIMITS_PA[0]).abs() < 1.0);
    for facts in [square, disc] {
        let changes = |k: usize| facts.detection.points[k].change_v;
        assert!((facts.detection.points[0].pressure_pa - 46.44).abs() < 0.01);
        // 31.8 g is far above the noise in each of the repeats.
        assert!(changes(8).iter().all(|change| *change > 10.0 * facts.detection.noise_v));
        assert!(facts.correlation.distance_09_m < facts.correlation.distance_05_m);
        assert!(facts.correlation.distance_05_m < 0.03);
    }
    // A gap that closes only above the limit cannot be fitted, which is reported.
    options.contact.threshold_pa = 200.0;
    assert!(of(&options).fit().unwrap_err().to_string().contains("fitted limit_pa"));
}

#[test]
fn the_published_instrument_keeps_its_time_and_steps() {
    let instrument = dermis_twin::instrument::Instrument::new(piezo_instrument(), 4096, 1).unwrap();
    assert!((instrument.frame_period_s() - 4096.0 * (1e-5 + 1.0 / 860.0)).abs() < 1e-9);
    assert!((piezo_instrument().drive.unwrap().actual_a() - 39e-6).abs() < 1e-18);
}
