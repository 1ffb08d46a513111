//! Shows how a calibration improves with the number of pokes, on measured pokes:
//!
//! `cargo run -p dermis-touch --release --example calibration_curve -- DIR [SISTER_DIR] [POKES]...`
//!
//! DIR holds `positions.csv` (x_m, y_m, depth_m) and `differences.csv`, or files whose names end in `positions.csv`,
//! `before.csv` and `pressed.csv`. Each random order holds out its last fifth, at most 500 pokes. There are 16 orders
//! for 10 pokes and fewer for more. With a second folder of the same form, a calibration on the first 2,000 pokes
//! there (in random order) is the prior of the first lines. The numbers say how many pokes to fit; more than 2,000
//! are tried in one order only.

use std::path::{Path, PathBuf};
use std::time::Instant;

use dermis_touch::locator::{
    Examples, FusedLocator, FusedOptions, FusedReport, LocatorError, SessionDrift, SignatureMap,
};

type Failure = Box<dyn std::error::Error>;

struct Pokes {
    channels: usize,
    frames: Vec<Vec<f64>>,
    positions_m: Vec<[f64; 2]>,
    depths_m: Vec<f64>,
    noise: Option<Vec<f64>>,
}

fn read(path: &Path, header: usize) -> Result<Vec<Vec<f64>>, Failure> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()))?;
    let row = |line: &str| line.split(',').map(|cell| Ok(cell.trim().parse()?)).collect::<Result<Vec<f64>, Failure>>();
    text.lines().skip(header).map(row).collect()
}

fn find(folder: &Path, end: &str) -> Result<Option<PathBuf>, Failure> {
    for entry in std::fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))? {
        let path = entry?.path();
        if path.file_name().is_some_and(|name| name.to_string_lossy().ends_with(end)) {
            return Ok(Some(path));
        }
    }
    Ok(None)
}

fn load(folder: &Path) -> Result<Pokes, Failure> {
    let need = |end: &str| find(folder, end)?.ok_or_else(|| Failure::from(format!("{}: no {end}", folder.display())));
    let poked = read(&need("positions.csv")?, 1)?;
    let (frames, noise) = match find(folder, "differences.csv")? {
        Some(path) => (read(&path, 0)?, None),
        None => {
            let (before, pressed) = (read(&need("before.csv")?, 0)?, read(&need("pressed.csv")?, 0)?);
            let ratio = |(b, f): (&Vec<f64>, &Vec<f64>)| b.iter().zip(f).map(|(b, f)| (f / b).ln()).collect();
            let noise = |k: usize| {
                let steps = before.windows(2).map(|pair| (pair[1][k] / pair[0][k]).ln().powi(2));
                (steps.sum::<f64>() / (2 * (before.len() - 1)) as f64).sqrt()
            };
            let frames: Vec<Vec<f64>> = before.iter().zip(&pressed).map(ratio).collect();
            (frames, Some((0..before[0].len()).map(noise).collect()))
        }
    };
    Ok(Pokes {
        channels: frames[0].len(),
        frames,
        positions_m: poked.iter().map(|row| [row[0], row[1]]).collect(),
        depths_m: poked.iter().map(|row| row[2]).collect(),
        noise,
    })
}

impl Pokes {
    fn examples(&self, rows: &[usize]) -> Result<Examples, LocatorError> {
        let frames = rows.iter().flat_map(|&i| self.frames[i].iter().copied()).collect();
        let mut examples = Examples::new(self.channels, frames, rows.iter().map(|&i| self.positions_m[i]).collect())?
            .with_loads(rows.iter().map(|&i| self.depths_m[i]).collect())?;
        if let Some(noise) = &self.noise {
            examples = examples.with_channel_noise(noise.clone())?;
        }
        Ok(examples)
    }

    /// Positions on a 45 x 45 grid over the square that the pokes span, with a margin of an eighth.
    fn map(&self) -> Result<SignatureMap, LocatorError> {
        let side = 45;
        let reach = 1.125 * self.positions_m.iter().flatten().fold(0.0_f64, |most, v| most.max(v.abs()));
        let at = |i: usize| reach * (2.0 * i as f64 / (side - 1) as f64 - 1.0);
        let positions = (0..side * side).map(|p| [at(p % side), at(p / side)]).collect();
        SignatureMap::without_physics(self.channels, positions)
    }
}

/// A random order, the same in every run.
fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut state = 0x9e37_79b9_7f4a_7c15 ^ (seed + 1).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let mut order: Vec<usize> = (0..count).collect();
    for i in (1..count).rev() {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        order.swap(i, (state >> 11) as usize % (i + 1));
    }
    order
}

fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[(fraction * (sorted.len() - 1) as f64).round() as usize]
}

#[derive(Default)]
struct Line {
    errors_mm: Vec<f64>,
    within: [usize; 2],
    load_within: usize,
    loads: usize,
    fit_s: f64,
    locate_us: f64,
    note: String,
}

impl Line {
    fn add(
        &mut self,
        pokes: &Pokes,
        locator: &FusedLocator,
        fit_s: f64,
        held_out: &[usize],
    ) -> Result<(), LocatorError> {
        let mut scratch = locator.scratch();
        let mut quickest = f64::INFINITY;
        for &i in held_out {
            let start = Instant::now();
            locator.predict_into(&pokes.frames[i], &mut scratch)?;
            quickest = quickest.min(1e6 * start.elapsed().as_secs_f64());
            let found = locator.predict_into(&pokes.frames[i], &mut scratch)?;
            let (dx, dy) = (found.x_m - pokes.positions_m[i][0], found.y_m - pokes.positions_m[i][1]);
            self.errors_mm.push(1e3 * dx.hypot(dy));
            self.within[0] += usize::from(dx.abs() <= found.sigma_x_m);
            self.within[1] += usize::from(dy.abs() <= found.sigma_y_m);
            if let Some(load) = found.load {
                self.loads += 1;
                self.load_within += usize::from((load.value - pokes.depths_m[i]).abs() <= load.sigma);
            }
        }
        self.locate_us = quickest;
        self.fit_s = self.fit_s.max(fit_s);
        self.note = note(locator.report());
        Ok(())
    }

    fn print(&self, what: &str) {
        let count = self.errors_mm.len() as f64;
        let share = |n: usize| 100.0 * n as f64 / count;
        let load = if self.loads == 0 {
            "-".into()
        } else {
            format!("{:.0}", 100.0 * self.load_within as f64 / self.loads as f64)
        };
        println!(
            "{what:>16} | {:5.2} / {:5.2} | {:3.0} {:3.0} | {load:>3} | {:6.2} | {:5.0} | {}",
            quantile(&self.errors_mm, 0.5),
            quantile(&self.errors_mm, 0.9),
            share(self.within[0]),
            share(self.within[1]),
            self.fit_s,
            self.locate_us,
            self.note,
        );
    }
}

fn note(report: &FusedReport) -> String {
    let expert = |used: bool, a: &dermis_touch::locator::Accuracy| {
        format!("{}{:.2}/{:.2}", if used { "" } else { "unused " }, 1e3 * a.median_m, 1e3 * a.p90_m)
    };
    let mut text = format!(
        "left out: forward {}, inverse {}, both {:.2}/{:.2}",
        expert(report.forward_used, &report.forward),
        expert(report.inverse_used, &report.inverse),
        1e3 * report.fused.median_m,
        1e3 * report.fused.p90_m,
    );
    if report.companded {
        text.push_str(", companded");
    }
    for (what, part) in [
        ("sister's map", report.sister_map),
        ("sister's covariance", report.sister_covariance),
        ("sister's turn", report.sister_turn),
    ] {
        if let Some(part) = part {
            text.push_str(&format!(", {what} {} ({:+.2})", if part.used { "used" } else { "not used" }, part.gain));
        }
    }
    if !report.doubtful.is_empty() {
        text.push_str(&format!(", {} doubtful", report.doubtful.len()));
    }
    text
}

/// Number of random orders to try for this number of pokes.
fn orders(pokes: usize) -> u64 {
    match pokes {
        ..=10 => 16,
        11..=20 => 8,
        21..=2000 => 3,
        _ => 1,
    }
}

fn main() -> Result<(), Failure> {
    let (numbers, folders): (Vec<String>, Vec<String>) =
        std::env::args().skip(1).partition(|word| word.parse::<usize>().is_ok());
    let usage = "usage: calibration_curve DIR [SISTER_DIR] [POKES]...";
    let Some(folder) = folders.first() else { return Err(usage.into()) };
    let mut counts = vec![10, 20, 50, 100, 200, 400, 1000, 2000];
    if !numbers.is_empty() {
        counts = numbers.iter().map(|word| word.parse()).collect::<Result<_, _>>()?;
    }
    let pokes = load(Path::new(folder))?;
    let (count, map, options) = (pokes.frames.len(), pokes.map()?, FusedOptions::default());
    let test = 500.min(count / 5);
    println!("{folder}: {count} pokes, the last {test} of some random orders held out; mm: median / 90th percentile");
    println!("           pokes |  error, mm    | % in s. | dep | fit, s | us    | last fit");
    if let Some(other) = folders.get(1) {
        let sister = load(Path::new(other))?;
        let all = shuffled(sister.frames.len(), 0);
        let known = FusedLocator::fit(&sister.examples(&all[..all.len().min(2000)])?, &map, &options)?;
        for &n in counts.iter().filter(|n| **n <= 100) {
            let mut line = Line::default();
            for seed in 0..orders(n) {
                let order = shuffled(count, seed);
                let start = Instant::now();
                let examples = pokes.examples(&order[..n])?;
                let locator = FusedLocator::fit_with_prior(&examples, &map, &options, &known)?;
                line.add(&pokes, &locator, start.elapsed().as_secs_f64(), &order[count - test..])?;
            }
            line.print(&format!("{n} and a sister"));
        }
    }
    for n in counts.into_iter().filter(|n| *n <= count - test) {
        let mut line = Line::default();
        for seed in 0..orders(n) {
            let order = shuffled(count, seed);
            let examples = pokes.examples(&order[..n])?;
            let start = Instant::now();
            let locator = FusedLocator::fit(&examples, &map, &options)?;
            line.add(&pokes, &locator, start.elapsed().as_secs_f64(), &order[count - test..])?;
        }
        line.print(&n.to_string());
    }
    let session: Vec<usize> = (0..count).collect();
    let drift = SessionDrift::measure(&pokes.examples(&session)?)?;
    println!(
        "drift: first half locates the second {:.2} / {:.2}, every other poke those between {:.2} / {:.2}; z {:.1}",
        1e3 * drift.later.median_m,
        1e3 * drift.later.p90_m,
        1e3 * drift.interleaved.median_m,
        1e3 * drift.interleaved.p90_m,
        drift.z,
    );
    Ok(())
}
