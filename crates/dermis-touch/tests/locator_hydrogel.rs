//! The calibrated locator on a measured skin: 500 pokes of a round hydrogel skin with 16 electrodes. The physics is
//! the closed form for point electrodes on a homogeneous disc, computed here, so that this test needs no forward
//! model.

use std::path::Path;

use dermis_touch::locator::{Examples, LeaveOneOut, Locator, LocatorOptions, SignatureMap};

const RADIUS_M: f64 = 0.0855;

struct Pokes {
    /// ln(pressed / before), a row of 192 channels for each poke.
    frames: Vec<Vec<f64>>,
    positions_m: Vec<[f64; 2]>,
    depths_m: Vec<f64>,
    /// Standard deviation of each channel between successive baselines.
    noise: Vec<f64>,
    physics: SignatureMap,
}

fn read(path: &Path, header: usize) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).expect("the measured data are readable");
    let number = |cell: &str| cell.trim().parse().expect("a number");
    text.lines().skip(header).map(|line| line.split(',').map(number).collect()).collect()
}

fn load() -> Option<Pokes> {
    let folder = dermis_testdata::set("hydrogel")?;
    let before = read(&folder.join("ohmc16_before.csv"), 0);
    let pressed = read(&folder.join("ohmc16_pressed.csv"), 0);
    let poked = read(&folder.join("ohmc16_positions.csv"), 1);
    let lookup = read(&folder.join("lookup192.csv"), 1);
    let ratio = |(b, f): (&Vec<f64>, &Vec<f64>)| b.iter().zip(f).map(|(b, f)| (f / b).ln()).collect();
    let frames: Vec<Vec<f64>> = before.iter().zip(&pressed).map(ratio).collect();
    let noise = (0..lookup.len()).map(|k| {
        let steps = before.windows(2).map(|pair| (pair[1][k] / pair[0][k]).ln().powi(2));
        (steps.sum::<f64>() / (2 * (before.len() - 1)) as f64).sqrt()
    });
    Some(Pokes {
        frames,
        positions_m: poked.iter().map(|row| [row[0], row[1]]).collect(),
        depths_m: poked.iter().map(|row| row[2]).collect(),
        noise: noise.collect(),
        physics: point_electrode_signatures(&lookup),
    })
}

/// On a disc, a point electrode at e on the rim gives the potential -ln|p - e| / (pi sigma). A small touch at p
/// changes the measurement by -grad u_drive . grad u_measure, here relative to the measurement itself.
fn point_electrode_signatures(lookup: &[Vec<f64>]) -> SignatureMap {
    let electrode = |index: f64| {
        let angle = std::f64::consts::TAU * index / 32.0 + 22.5_f64.to_radians();
        [RADIUS_M * angle.sin(), -RADIUS_M * angle.cos()]
    };
    let log_distance = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]).ln();
    let pull = |p: [f64; 2], e: [f64; 2]| {
        let d = [p[0] - e[0], p[1] - e[1]];
        let square = d[0] * d[0] + d[1] * d[1];
        [d[0] / square, d[1] / square]
    };
    let mut positions = Vec::new();
    let mut signatures = Vec::new();
    for row in -26..=26 {
        for column in -26..=26 {
            let p = [0.003 * f64::from(column), 0.003 * f64::from(row)];
            if p[0].hypot(p[1]) > 0.078 {
                continue;
            }
            positions.push(p);
            for channel in lookup {
                let [a, b, plus, minus] = [0, 1, 2, 3].map(|i| electrode(channel[i]));
                let at = |m| log_distance(m, a) - log_distance(m, b);
                let (ga, gb, gp, gm) = (pull(p, a), pull(p, b), pull(p, plus), pull(p, minus));
                let product = (ga[0] - gb[0]) * (gp[0] - gm[0]) + (ga[1] - gb[1]) * (gp[1] - gm[1]);
                signatures.push(product / (at(plus) - at(minus)));
            }
        }
    }
    SignatureMap::new(lookup.len(), positions, signatures).expect("finite signatures")
}

impl Pokes {
    fn fit(&self, rows: &[usize]) -> Locator {
        let frames = rows.iter().flat_map(|&i| self.frames[i].iter().copied()).collect();
        let positions = rows.iter().map(|&i| self.positions_m[i]).collect();
        let examples = Examples::new(self.noise.len(), frames, positions)
            .and_then(|e| e.with_channel_noise(self.noise.clone()))
            .and_then(|e| e.with_loads(rows.iter().map(|&i| self.depths_m[i]).collect()))
            .expect("valid examples");
        Locator::fit(&examples, &self.physics, &LocatorOptions::default()).expect("a locator")
    }
}

#[derive(Default)]
struct Errors {
    distance_mm: Vec<f64>,
    within_sigma: [usize; 2],
    load_ratio: Vec<f64>,
    novelty: Vec<f64>,
}

impl Errors {
    fn test(&mut self, pokes: &Pokes, locator: &Locator, rows: &[usize]) {
        let mut scratch = locator.scratch();
        for &i in rows {
            let found = locator.predict_into(&pokes.frames[i], &mut scratch).expect("a located touch");
            let (dx, dy) = (found.x_m - pokes.positions_m[i][0], found.y_m - pokes.positions_m[i][1]);
            self.distance_mm.push(1e3 * dx.hypot(dy));
            self.within_sigma[0] += usize::from(dx.abs() <= found.sigma_x_m);
            self.within_sigma[1] += usize::from(dy.abs() <= found.sigma_y_m);
            self.load_ratio.push((found.load.expect("depth follows amplitude").value / pokes.depths_m[i]).ln().abs());
            self.novelty.push(found.novelty);
        }
    }

    fn quantile(values: &[f64], fraction: f64) -> f64 {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        sorted[(fraction * (sorted.len() - 1) as f64).round() as usize]
    }

    fn median_mm(&self) -> f64 {
        Self::quantile(&self.distance_mm, 0.5)
    }

    fn p90_mm(&self) -> f64 {
        Self::quantile(&self.distance_mm, 0.9)
    }

    fn coverage(&self) -> [f64; 2] {
        self.within_sigma.map(|count| count as f64 / self.distance_mm.len() as f64)
    }

    fn print(&self, what: &str) {
        println!(
            "{what}: median {:.2} mm, p90 {:.2} mm, within one sigma {:.2?}, depth off by {:.0} %, novelty p90 {:.2}",
            self.median_mm(),
            self.p90_mm(),
            self.coverage(),
            100.0 * Self::quantile(&self.load_ratio, 0.5),
            Self::quantile(&self.novelty, 0.9),
        );
    }
}

fn print_report(report: &LeaveOneOut) {
    println!(
        "  left out: median {:.2} mm, p90 {:.2} mm, coverage {:.2?}, physics cosine {:.2}, load error {:?}",
        1e3 * report.median_error_m,
        1e3 * report.p90_error_m,
        report.coverage,
        report.physics_cosine,
        report.load_error
    );
}

/// Indices in a fixed random order (Fisher-Yates on a linear congruential generator).
fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let mut order: Vec<usize> = (0..count).collect();
    for i in (1..count).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        order.swap(i, (state >> 33) as usize % (i + 1));
    }
    order
}

#[test]
fn four_hundred_pokes_locate_the_other_hundred() {
    let Some(pokes) = load() else { return };
    let order = shuffled(500, 1);
    let mut errors = Errors::default();
    for fold in 0..5 {
        let (test, train): (Vec<usize>, Vec<usize>) = (0..500).partition(|i| order[*i] % 5 == fold);
        let locator = pokes.fit(&train);
        println!("{:?}", locator.hyperparameters());
        print_report(locator.leave_one_out());
        errors.test(&pokes, &locator, &test);
    }
    errors.print("400 pokes, 5-fold");
    assert!(errors.median_mm() <= 2.0, "median {} mm", errors.median_mm());
    assert!(errors.p90_mm() <= 5.5, "p90 {} mm", errors.p90_mm());
    for coverage in errors.coverage() {
        assert!((0.60..=0.76).contains(&coverage), "one sigma covers {coverage}");
    }
}

#[test]
fn fifty_pokes_are_enough_for_millimetres() {
    let Some(pokes) = load() else { return };
    let mut errors = Errors::default();
    for seed in 0..10 {
        let order = shuffled(500, 100 + seed);
        let locator = pokes.fit(&order[..50]);
        println!("{:?}", locator.hyperparameters());
        print_report(locator.leave_one_out());
        errors.test(&pokes, &locator, &order[50..]);
    }
    errors.print("50 pokes, 10 draws");
    assert!(errors.median_mm() <= 6.0, "median {} mm", errors.median_mm());
    for coverage in errors.coverage() {
        assert!((0.60..=0.76).contains(&coverage), "one sigma covers {coverage}");
    }
}

#[test]
fn ten_pokes_are_worth_more_than_none() {
    let Some(pokes) = load() else { return };
    let mut errors = Errors::default();
    for seed in 0..10 {
        let order = shuffled(500, 200 + seed);
        let locator = pokes.fit(&order[..10]);
        for &i in &order[10..] {
            let found = locator.predict(&pokes.frames[i]).expect("a located touch");
            let at = pokes.positions_m[i];
            errors.distance_mm.push(1e3 * (found.x_m - at[0]).hypot(found.y_m - at[1]));
        }
    }
    // Physics alone, by templates, reaches about 13 mm here.
    assert!(errors.median_mm() <= 9.0, "median {} mm", errors.median_mm());
    assert!(errors.p90_mm() <= 25.0, "p90 {} mm", errors.p90_mm());
}

#[test]
fn sigma_grows_far_from_pokes() {
    let Some(pokes) = load() else { return };
    let mut unpoked = Errors::default();
    let (mut sigma_poked, mut sigma_unpoked) = (Vec::new(), Vec::new());
    for quarter in 0..4 {
        let along = |i: &usize| {
            let [x, y] = pokes.positions_m[*i];
            [x, y, -x, -y][quarter]
        };
        let train: Vec<usize> = (0..500).step_by(2).filter(|i| along(i) < 0.0).collect();
        let locator = pokes.fit(&train);
        print_report(locator.leave_one_out());
        let far: Vec<usize> = (0..500).filter(|i| along(i) > 0.01).collect();
        unpoked.test(&pokes, &locator, &far);
        let sigma = |i: &usize| locator.predict(&pokes.frames[*i]).expect("a located touch").sigma_x_m;
        sigma_poked.extend((1..500).step_by(2).filter(|i| along(i) < -0.01).map(|i| sigma(&i)));
        sigma_unpoked.extend(far.iter().map(sigma));
    }
    unpoked.print("half the skin never poked, that half");
    let ratio = Errors::quantile(&sigma_unpoked, 0.5) / Errors::quantile(&sigma_poked, 0.5);
    println!("sigma there over sigma among pokes: {ratio:.1}");
    assert!(ratio > 2.0, "sigma grows only {ratio} times");
    // The sectors that calibrate this sigma extend to the middle of the skin, where nothing is far, so sigma is too
    // wide rather than too narrow.
    for coverage in unpoked.coverage() {
        assert!(coverage > 0.60, "one sigma covers {coverage}");
    }
}
