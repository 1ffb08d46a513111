//! The measured gelatin skin through the public path: reconstruct without labels, calibrate, reconstruct calibrated.
//! Data: DSHardman/HydrogelEIT (the set `hydrogel`); positions are used to calibrate where it says so, and to
//! measure errors.

use dermis::live::calibration::Calibration;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use dermis::lab::reconstruct::{Request, reconstruct};
use dermis::live::calibration::{CalibratedImager, Pokes, find_circuit, read_pokes, relative_changes};
use dermis::live::channels::ChannelReader;
use dermis::live::prepare::Prepared;
use dermis::live::reference::Reference;
use dermis::skin::{CircuitChoice, Skin};
use dermis_device::FileSpec;

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

fn write(path: &Path, rows: &[&Vec<f64>]) {
    let mut text = String::new();
    for row in rows {
        let cells: Vec<String> = row.iter().map(f64::to_string).collect();
        writeln!(text, "{}", cells.join(",")).unwrap();
    }
    std::fs::write(path, text).unwrap();
}

/// Rows of touches: frame, x_mm, y_mm, sigma_x_mm, sigma_y_mm.
fn touches(path: &Path) -> Vec<[f64; 5]> {
    let text = std::fs::read_to_string(path).unwrap();
    let row = |line: &str| {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        [cells[0], cells[2], cells[3], cells[6], cells[7]]
    };
    text.lines().skip(1).map(row).collect()
}

struct Outcome {
    median_mm: f64,
    p90_mm: f64,
    found: usize,
    /// Share of errors within one sigma, x and y.
    within: [f64; 2],
}

fn run(data: &Data, test: &[usize], calibration: Option<PathBuf>) -> Outcome {
    let place = tempfile::tempdir().unwrap();
    let path = |name: &str| place.path().join(name);
    write(&path("b.csv"), &test.iter().map(|&i| &data.before[i]).collect::<Vec<_>>());
    write(&path("f.csv"), &test.iter().map(|&i| &data.pressed[i]).collect::<Vec<_>>());
    let request = Request {
        skin: Skin::open("hydrogel-disc").unwrap(),
        baseline: Some(FileSpec::all(path("b.csv"))),
        frames: FileSpec::all(path("f.csv")),
        format: None,
        calibration,
        forces: None,
        hyperparameter: None,
        touches: Some(path("t.csv")),
        images: Some(path("i.npy")),
    };
    reconstruct(&request, |_, _| {}).unwrap();
    let mut errors = Vec::new();
    let mut within = [0.0; 2];
    for [frame, x, y, sigma_x, sigma_y] in touches(&path("t.csv")) {
        let [true_x, true_y] = data.pokes.positions_m[test[frame as usize]].map(|v| v * 1e3);
        errors.push((x - true_x).hypot(y - true_y));
        within[0] += f64::from(u8::from((x - true_x).abs() <= sigma_x));
        within[1] += f64::from(u8::from((y - true_y).abs() <= sigma_y));
    }
    let found = errors.len();
    errors.sort_by(f64::total_cmp);
    let at = |share: f64| errors[((found as f64 * share) as usize).min(found - 1)];
    Outcome { median_mm: at(0.5), p90_mm: at(0.9), found, within: within.map(|n| n / found as f64) }
}

fn calibrate(data: &Data, train: &[usize], path: &Path) {
    let prepared = Prepared::new(Skin::open("hydrogel-disc").unwrap()).unwrap();
    let pick = |rows: &[Vec<f64>]| train.iter().map(|&i| rows[i].clone()).collect::<Vec<_>>();
    let (quantity, loads) = data.pokes.loads.clone().unwrap();
    let pokes = Pokes {
        positions_m: train.iter().map(|&i| data.pokes.positions_m[i]).collect(),
        loads: Some((quantity, train.iter().map(|&i| loads[i]).collect())),
    };
    let calibration = Calibration::fit(&prepared, &pick(&data.before), &pick(&data.pressed), &pokes).unwrap();
    let report = calibration.leave_one_out();
    println!("leave-one-out of {} pokes: median {:.2} mm", train.len(), report.median_error_m * 1e3);
    assert!(calibration.suggest_pokes(3).unwrap().iter().all(|poke| poke.sigma_m > 0.0));
    calibration.save(path).unwrap();
}

#[test]
fn touches_are_located_without_labels() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let data = load(&folder);
    let all: Vec<usize> = (0..data.pressed.len()).collect();
    let outcome = run(&data, &all, None);
    println!(
        "without labels: {} of 500 found, median {:.2} mm, p90 {:.2} mm",
        outcome.found, outcome.median_mm, outcome.p90_mm
    );
    // The skin's channels are calibrated on differences of successive baselines: no pressed frame, no label. What was
    // asked for is 11 and 21 mm; 5.1 and 11.2 were measured when this was written.
    assert!(outcome.found >= 495 && outcome.found <= 500, "{}", outcome.found);
    assert!(outcome.median_mm <= 7.0, "{}", outcome.median_mm);
    assert!(outcome.p90_mm <= 15.0, "{}", outcome.p90_mm);
}

/// Every fifth poke is tested, the others train; or every tenth trains (50), a different hundred is tested.
#[test]
fn pokes_make_it_precise() {
    let Some(folder) = dermis_testdata::set("hydrogel") else { return };
    let data = load(&folder);
    let place = tempfile::tempdir().unwrap();
    let test: Vec<usize> = (0..500).filter(|i| i % 5 == 2).collect();
    for (train, median_mm, p90_mm) in [
        ((0..500).filter(|i| i % 5 != 2).collect::<Vec<_>>(), 2.0, 5.5),
        ((0..500).filter(|i| i % 10 == 0).collect::<Vec<_>>(), 6.0, 15.0),
    ] {
        let path = place.path().join(format!("c{}.json", train.len()));
        calibrate(&data, &train, &path);
        let outcome = run(&data, &test, Some(path));
        println!(
            "{} pokes: {} of 100 found, median {:.2} mm, p90 {:.2} mm, within 1 sigma {:.2} {:.2}",
            train.len(),
            outcome.found,
            outcome.median_mm,
            outcome.p90_mm,
            outcome.within[0],
            outcome.within[1]
        );
        assert!(outcome.found >= 98 && outcome.found <= 100, "{}", outcome.found);
        assert!(outcome.median_mm <= median_mm, "{}", outcome.median_mm);
        assert!(outcome.p90_mm <= p90_mm, "{}", outcome.p90_mm);
        // Asked for are 60 to 76 % over many splits; one split of 100 scatters by 5 % about its mean,
        // and with 50 pokes by the choice of the pokes as well.
        assert!(outcome.within.iter().all(|share| (0.5..=0.85).contains(share)), "{:?}", outcome.within);
    }
}

/// From a skin file without a circuit: found from the presses themselves, no label taking part.
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
        // The finder as `reconstruct` makes it: of these frames, and tested on all.
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
                let [x, y] = finder.place(&difference).unwrap()?.position_m;
                Some(1e3 * (x - data.pokes.positions_m[i][0]).hypot(y - data.pokes.positions_m[i][1]))
            })
            .collect();
        errors.sort_by(f64::total_cmp);
        let at = |share: f64| errors[(errors.len() as f64 * share) as usize];
        println!("{} presses: {fit:?}, {} found, {:.2} / {:.2} mm", rows.len(), errors.len(), at(0.5), at(0.9));
        assert!(fit.score > fit.score_before + 0.05 && fit.is_trusted(), "{fit:?}");
        if rows.len() == all.len() {
            // Weak presses are left to the image by the finder's threshold.
            assert!(errors.len() >= 450, "{}", errors.len());
            assert!(at(0.5) <= 5.0 && at(0.9) <= 10.0, "{} {}", at(0.5), at(0.9));
        }
    }
}
