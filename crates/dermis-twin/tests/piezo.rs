//! The piezoresistive skins as a whole: the low-rank update against a factor of all unknowns, reciprocity, what patches do
//! and do not do to each other, and that bending changes nothing.

use dermis_tomo::eit::ForwardModel;
use dermis_twin::instrument::InstrumentOptions;
use dermis_twin::mechanics::Indenter;
use dermis_twin::physics::{PatchedSheet, direct_patched_impedance};
use dermis_twin::piezo::PUBLISHED_LIMITS_PA;
use dermis_twin::{Frontend, PaperP, PiezoOptions, PiezoSkin};
use faer::Mat;

/// A coarser mesh and 500 cells: enough for behaviour, quick to test.
fn coarse(options: PiezoOptions) -> PiezoOptions {
    let mut options = PiezoOptions {
        element_size_m: 6e-3,
        electrode_element_size_m: 2e-3,
        instrument: InstrumentOptions::ideal(),
        ..options
    };
    options.patches.pitch_m = 15e-3;
    options.patches.cells_per_side = 2;
    options
}

fn voltages(skin: &mut PiezoSkin, indenters: &[Indenter]) -> Vec<f64> {
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

fn change(skin: &mut PiezoSkin, indenters: &[Indenter]) -> Vec<f64> {
    let rest = voltages(skin, &[]);
    voltages(skin, indenters).iter().zip(&rest).map(|(v, v0)| v - v0).collect()
}

#[test]
fn frames_have_4096_channels_and_only_the_sinks_read_nothing() {
    for options in [PiezoOptions::square(), PiezoOptions::disc()] {
        let mut skin = PiezoSkin::new(&coarse(options)).unwrap();
        let frame = voltages(&mut skin, &[]);
        assert_eq!(frame.len(), 4096);
        assert_eq!(frame.iter().filter(|v| **v == 0.0).count(), 64);
        // Grounded sink: nothing lies below it.
        assert!(frame.iter().all(|v| *v >= 0.0));
    }
}

#[test]
fn unpressed_skin_is_a_single_sheet() {
    let options = coarse(PiezoOptions::disc());
    let mut skin = PiezoSkin::new(&options).unwrap();
    let model = ForwardModel::new(skin.body().clone(), skin.stimulation().clone()).unwrap();
    let sheet = vec![options.sheet_s(); skin.body().mesh.element_count()];
    let expected = model.solve(&sheet).unwrap().voltages();
    // The same equations by other code: rounding only.
    assert!(relative_difference(&voltages(&mut skin, &[]), &expected) < 1e-9);
}

#[test]
fn the_update_is_the_factor_of_all_unknowns() {
    let options = coarse(PiezoOptions::square());
    let mut skin = PiezoSkin::new(&options).unwrap();
    let presses = [press(-30.0, 5.0, 20e3), press(35.0, -42.0, 800.0), press(-12.0, 5.0, 3e3)];
    voltages(&mut skin, &presses);
    let contact = skin.contact_s_per_m2().to_vec();
    assert!(contact.iter().filter(|g| **g > 0.0).count() > 30);
    let flat = skin.surface().unroll(skin.body()).unwrap();
    let exact = direct_patched_impedance(&flat, options.sheet_s(), options.patches, &contact).unwrap();
    let mut sheet = PatchedSheet::new(&flat, options.sheet_s(), options.patches).unwrap();
    let update = sheet.impedance(&contact).unwrap();
    let difference: Mat<f64> = &exact - update;
    assert!(difference.norm_l2() < 1e-9 * exact.norm_l2(), "{:e}", difference.norm_l2() / exact.norm_l2());
    // Without contact the impedances are others: the update is not idle.
    let open = sheet.impedance(&vec![0.0; contact.len()]).unwrap().to_owned();
    assert!((&exact - &open).norm_l2() > 1e-3 * exact.norm_l2());
}

#[test]
fn the_matrix_of_impedances_is_reciprocal() {
    let options = coarse(PiezoOptions::disc());
    let mut skin = PiezoSkin::new(&options).unwrap();
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
fn pressing_harder_always_lowers_what_the_drives_spend() {
    // Rayleigh: closing contacts can only lower the power of given currents, here the voltage of each source.
    let mut skin = PiezoSkin::new(&coarse(PiezoOptions::square())).unwrap();
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
    let mut skin = PiezoSkin::new(&coarse(PiezoOptions::square())).unwrap();
    let gap = PiezoOptions::square().contact.threshold_pa;
    assert!(norm(change(&mut skin, &[press(0.0, 0.0, 0.9 * gap)]).into_iter()) == 0.0);
    assert!(norm(change(&mut skin, &[press(0.0, 0.0, 5.0 * gap)]).into_iter()) > 0.0);
}

#[test]
fn far_touches_on_different_patches_add() {
    let mut skin = PiezoSkin::new(&coarse(PiezoOptions::square())).unwrap();
    let (one, other) = (press(-52.5, -52.5, 3e3), press(52.5, 52.5, 3e3));
    let first = change(&mut skin, &[one]);
    let second = change(&mut skin, &[other]);
    let both = change(&mut skin, &[one, other]);
    let sum: Vec<f64> = first.iter().zip(&second).map(|(a, b)| a + b).collect();
    // Nothing joins the two but the sheet between: a dipole's field falls with the square of the distance, and that of
    // the field it causes again. Under continuous copper the two would be shorted together.
    let error = relative_difference(&both, &sum);
    assert!(error < 0.01, "{error}");
    // Both touch the same patches: there they do not add.
    let near = press(-47.5, -52.5, 3e3);
    let beside = change(&mut skin, &[near]);
    let both = change(&mut skin, &[one, near]);
    let sum: Vec<f64> = first.iter().zip(&beside).map(|(a, b)| a + b).collect();
    assert!(relative_difference(&both, &sum) > 5.0 * error);
}

#[test]
fn one_contact_of_a_floating_patch_carries_nothing() {
    let options = coarse(PiezoOptions::square());
    let skin = PiezoSkin::new(&options).unwrap();
    let mut sheet = skin.sheet().clone();
    let patch = sheet.cells()[210].patch;
    let mut contact = vec![0.0; sheet.cells().len()];
    let open = sheet.impedance(&contact).unwrap().to_owned();
    contact[210] = 100.0;
    let single = sheet.impedance(&contact).unwrap().to_owned();
    assert!((&single - &open).norm_l2() < 1e-12 * open.norm_l2());
    // A second contact of the same patch closes a way around the sheet.
    let other = (0..contact.len()).find(|&k| k != 210 && sheet.cells()[k].patch == patch).unwrap();
    contact[other] = 100.0;
    let closed = sheet.impedance(&contact).unwrap().to_owned();
    assert!((&closed - &open).norm_l2() > 1e-6 * open.norm_l2());
}

#[test]
fn bending_changes_nothing() {
    let presses = [press(40.0, 10.0, 5e3), press(-20.0, -33.0, 2e3)];
    let mut flat = PiezoSkin::new(&coarse(PiezoOptions::square())).unwrap();
    let mut bent = PiezoSkin::new(&coarse(PiezoOptions::cylinder())).unwrap();
    let expected = voltages(&mut flat, &presses);
    // Lengths along the surface are the sheet's: rounding only.
    assert!(relative_difference(&voltages(&mut bent, &presses), &expected) < 1e-10);
    let (low, high) = bent.body().mesh.bounds();
    assert!(high[0] - low[0] < 0.14 && high[2] - low[2] > 0.02, "it is bent: {low:?} {high:?}");
    // The same mesh solved by the chords between its nodes: elements of 6 mm are narrower by (6/95)^2 / 24 = 1.7e-4.
    let options = coarse(PiezoOptions::cylinder());
    let model = ForwardModel::new(bent.body().clone(), bent.stimulation().clone()).unwrap();
    let sheet = vec![options.sheet_s(); bent.body().mesh.element_count()];
    let chords = model.solve(&sheet).unwrap().voltages();
    let difference = relative_difference(&chords, &voltages(&mut bent, &[]));
    assert!((1e-7..2e-4).contains(&difference), "{difference:e}");
}

#[test]
fn nonsense_is_refused() {
    let refused = |options: PiezoOptions| PiezoSkin::new(&options).unwrap_err().to_string();
    let mut options = PiezoOptions::square();
    options.patches.pitch_m = 2e-3;
    assert!(refused(options).starts_with("contact cells on the sheet"));
    let error = refused(PiezoOptions { sheet_resistance_ohm: -1.0, ..PiezoOptions::disc() });
    assert_eq!(error, "sheet_resistance_ohm: -1 refused; expected positive and finite");
    // The sheet would reach round this cylinder entirely.
    let tight = dermis_twin::physics::Surface::Cylinder { radius_m: 0.02 };
    assert!(refused(PiezoOptions { surface: tight, ..PiezoOptions::square() }).contains("radius"));
}

#[test]
fn one_limit_of_detection_fixes_one_parameter() {
    let instrument = PiezoOptions::square().instrument;
    let mut options = PiezoOptions { instrument, ..coarse(PiezoOptions::square()) };
    options.patches.pitch_m = 10e-3;
    let mut paper = PaperP::new(&options).unwrap();
    let reference_pa = paper.fit().unwrap();
    assert!((100.0..1e5).contains(&reference_pa), "{reference_pa}");
    let [square, disc] = paper.facts().unwrap();
    assert!((square.detection.limit_pa - PUBLISHED_LIMITS_PA[0]).abs() < 1.0);
    for facts in [square, disc] {
        let changes = |k: usize| facts.detection.points[k].change_v;
        assert!((facts.detection.points[0].pressure_pa - 46.44).abs() < 0.01);
        // 31.8 g stands far above the noise, in each of the repeats.
        assert!(changes(8).iter().all(|change| *change > 10.0 * facts.detection.noise_v));
        assert!(facts.correlation.distance_09_m < facts.correlation.distance_05_m);
        assert!(facts.correlation.distance_05_m < 0.03);
    }
    // A gap that closes only above the limit cannot be fitted, and says so.
    options.contact.threshold_pa = 200.0;
    assert!(PaperP::new(&options).unwrap().fit().unwrap_err().to_string().contains("fitted limit_pa"));
}
