//! The measured gelatin skin through the public path: reconstruct without labels, calibrate, reconstruct with the
//! calibration. Data: DSHardman/HydrogelEIT (the set `hydrogel`). Positions are used for calibration only where
//! stated, and to measure errors.

use std::path::Path;

use dermis_device::FileSpec;
use dermis_lab::evidence::hydrogel::presses;
use dermis_live::calibration::{CalibratedImager, Pokes, find_circuit, read_pokes, relative_changes};
use dermis_live::channels::ChannelReader;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::{CircuitChoice, Skin};
use dermis_tomo::mesh::distance;

struct Data {
    before: Vec<Vec<f64>>,
    pressed: Vec<Vec<f64>>,
    pokes: Pokes,
}

fn load(folder: &Path) -> Data {
    let prepared = Prepared::new(Skin::open("hydrogel-disc").unwrap()).unwrap();
    let read = |name: &str| {
        let table = dermis_device::read(&FileSpec::all(folder.join(name)), None).unwrap();
        let reads = prepared.skin.backend.reads;
        ChannelReader::new(table.layout(), &prepared.protocol, reads, name).unwrap().read_table(&table).unwrap()
    };
    Data {
        before: read("ohmc16_before.csv"),
        pressed: read("ohmc16_pressed.csv"),
        pokes: read_pokes(&folder.join("ohmc16_positions.csv")).unwrap(),
    }
}

#[test]
fn touches_are_located_without_labels() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let presses = presses(&folder).unwrap();
    let all: Vec<usize> = (0..presses.count()).collect();
    let outcome = presses.judge(&all, None).unwrap();
    let (found, median_mm, p90_mm) = (outcome.errors_mm.len(), outcome.quantile_mm(0.5), outcome.quantile_mm(0.9));
    println!("without labels: {} of 500 found, median {:.2} mm, p90 {:.2} mm", found, median_mm, p90_mm);
    // The channels are calibrated on differences of successive baselines, without pressed frames or labels. The
    // requirement is 11 and 21 mm; 5.1 and 11.2 mm were measured.
    assert!(found >= 495 && outcome.extra == 0, "{found}, {} too many", outcome.extra);
    assert!(median_mm <= 6.0, "{median_mm}");
    assert!(p90_mm <= 13.0, "{p90_mm}");
}

/// Every fifth poke is for testing. The rest are for training, or three times every tenth (50).
#[test]
fn pokes_make_it_precise() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let presses = presses(&folder).unwrap();
    let test: Vec<usize> = (0..500).filter(|i| i % 5 == 2).collect();
    let every_tenth = |first: usize| (0..500).filter(|i| i % 10 == first).collect::<Vec<_>>();
    let rest = (0..500).filter(|i| i % 5 != 2).collect::<Vec<_>>();
    let fifties = [0, 3, 6].map(every_tenth);
    let judge = |train: &Vec<usize>, [median_mm, p90_mm]: [f64; 2]| {
        let calibration = presses.calibrate(train).unwrap();
        assert!(calibration.suggest_pokes(3).unwrap().iter().all(|poke| poke.sigma_m > 0.0));
        let outcome = presses.judge(&test, Some(&calibration)).unwrap();
        let (found, errors) = (outcome.errors_mm.len(), [0.5, 0.9].map(|share| outcome.quantile_mm(share)));
        println!(
            "{} pokes: left out {:.2} mm; {found} of 100 found, {} too many, {errors:.2?} mm, within one sigma {:.2?}",
            train.len(),
            calibration.leave_one_out().median_error_m * 1e3,
            outcome.extra,
            outcome.within
        );
        assert!(errors[0] <= median_mm && errors[1] <= p90_mm, "{errors:?}");
        (found, outcome.extra, outcome.within)
    };
    // Two presses in a hundred may be missed or look like two, and 60 to 76 % are required inside one sigma over many splits. One
    // split of 100 scatters by 5 % about its mean, and with 50 pokes the choice of pokes adds to that.
    let is_right = |share: f64| (0.5..=0.85).contains(&share);
    let (found, extra, within) = judge(&rest, [2.0, 5.5]);
    assert!(found >= 98 && extra <= 2 && within.into_iter().all(is_right), "{found}, {extra} too many, {within:?}");
    let few = fifties.each_ref().map(|train| judge(train, [6.0, 15.0]));
    let found: usize = few.iter().map(|(found, ..)| found).sum();
    let extra: usize = few.iter().map(|(_, extra, _)| extra).sum();
    let within = [0, 1].map(|axis| few.iter().map(|(.., within)| within[axis]).sum::<f64>() / few.len() as f64);
    assert!(found >= 297 && extra <= 6 && within.into_iter().all(is_right), "{found}, {extra} too many, {within:?}");
}

/// Starts from a skin file without a circuit, and finds it from the presses themselves without any labels.
#[test]
fn the_circuit_is_found_from_unknown_presses() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let data = load(&folder);
    let mut skin = Skin::open("hydrogel-disc").unwrap();
    skin.backend.circuit = None;
    let ignorant = Prepared::new(skin.clone()).unwrap();
    let all: Vec<usize> = (0..500).collect();
    let few: Vec<usize> = (0..500).step_by(25).collect();
    for rows in [&all, &few] {
        let pick = |frames: &[Vec<f64>]| rows.iter().map(|&i| frames[i].clone()).collect::<Vec<_>>();
        let (before, pressed) = (pick(&data.before), pick(&data.pressed));
        let changes = relative_changes(&ignorant, &before, &pressed).unwrap();
        let fit = find_circuit(&ignorant, &changes, |_| {}).unwrap();
        let mut found = skin.clone();
        found.backend.circuit = fit.circuit.map(CircuitChoice::Known);
        let prepared = Prepared::new(found).unwrap();
        // A finder made as in `reconstruct`, from these frames, and tested on all.
        let reference = Reference::of(&prepared, &pick(&data.before)).unwrap();
        let differences = |rows: &[usize]| -> Vec<Vec<f64>> {
            rows.iter().map(|&i| reference.difference(&data.pressed[i], Some(&data.before[i]))).collect()
        };
        let single = Reference { successive: Vec::new(), ..reference.clone() };
        let made = CalibratedImager::new(&prepared, None, single, &differences(rows)).unwrap();
        let mut finder = made.placement.unwrap();
        let mut errors: Vec<f64> = all
            .iter()
            .filter_map(|&i| {
                let difference = made.reference.difference(&data.pressed[i], Some(&data.before[i]));
                finder.forget();
                let found = finder.place(0, &difference).unwrap()?;
                Some(1e3 * distance(found.position_m, data.pokes.positions_m[i]))
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors[(errors.len() as f64 * share) as usize];
        println!("{} presses: {fit:?}, {} found, {:.2} / {:.2} mm", rows.len(), errors.len(), at(0.5), at(0.9));
        assert!(fit.score > fit.score_before + 0.05 && fit.is_trusted(), "{fit:?}");
        if rows.len() == all.len() {
            // The finder leaves weak presses, below its threshold, to the image.
            assert!(errors.len() >= 450, "{}", errors.len());
            assert!(at(0.5) <= 5.0 && at(0.9) <= 10.0, "{} {}", at(0.5), at(0.9));
        }
    }
}
