//! Runs samples of every kind and summarises them.

use std::sync::atomic::{AtomicUsize, Ordering};

use dermis_skin::{Dice, Skin, Tolerances};
use dermis_tomo::mesh::{PixelGrid, Point};
use rayon::prelude::*;
use serde::Serialize;

use super::bench::{Bench, Press, Reader};
use super::cause::{Cause, causes};
use crate::Error;

/// Number of places over the skin. Each sample presses some of them.
const PLACES: usize = 64;
/// Pixels along the longer side of the map.
const MAP: usize = 32;
/// With more than [`ALL_CALIBRATED`] samples, only one in this many is calibrated.
const CALIBRATED_SHARE: usize = 10;
/// Up to this number, all samples are calibrated.
const ALL_CALIBRATED: usize = 20;
/// Sample number of the nominal twin, whose amplitudes are the reference.
const NOMINAL: u64 = u64::MAX;
/// Purpose of the random numbers that choose places.
const PLACES_DICE: u64 = 1000;

/// Size of the study.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Extent {
    /// Samples per row, 1 to 10,000.
    pub samples: usize,
    /// Presses per sample, 1 to 64.
    pub presses: usize,
    /// Numbers of calibration pokes, 3 to 1000 each; empty for no calibrated rows.
    pub pokes: Vec<usize>,
    /// Seed of all random numbers.
    pub seed: u64,
}

impl Default for Extent {
    fn default() -> Self {
        Self { samples: 200, presses: 5, pokes: vec![20, 50, 200], seed: 1 }
    }
}

impl Extent {
    fn check(&self) -> Result<(), Error> {
        let within = |what: &str, value: usize, [least, most]: [usize; 2]| {
            let expected = format!("{least} to {most}");
            if (least..=most).contains(&value) {
                return Ok(());
            }
            Err(Error::Live(dermis_live::Error::Frames { what: what.into(), expected, got: value.to_string() }))
        };
        within("samples", self.samples, [1, 10_000])?;
        within("presses of a sample", self.presses, [1, PLACES])?;
        within("numbers of pokes", self.pokes.len(), [0, 8])?;
        self.pokes.iter().try_for_each(|count| within("pokes", *count, [3, 1000]))
    }
}

/// Results for one kind of error.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ToleranceRow {
    /// Name of the cause.
    pub name: String,
    /// Number of samples.
    pub samples: usize,
    /// Number of presses.
    pub presses: usize,
    /// Position error of detected presses: median and 90th percentile, millimetres; NaN if none was detected.
    pub position_mm: Point,
    /// Amplitude error of detected presses, relative to the nominal twin at the same place read the same way: median
    /// and 90th percentile, per cent.
    pub amplitude_percent: [f64; 2],
    /// Presses without a touch within a quarter of the shorter side, per cent.
    pub misses_percent: f64,
    /// False touches per press.
    pub false_per_press: f64,
    /// Mean position error, millimetres, counting a miss as a quarter of the shorter side. Rows are compared by it.
    pub mean_mm: f64,
}

/// Position error at one place.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PlaceError {
    /// Position, metres.
    pub place_m: Point,
    /// Number of presses there, over all samples.
    pub presses: usize,
    /// Median position error of these presses, millimetres, counting a miss as a quarter of the shorter side; NaN
    /// without presses.
    pub median_mm: f64,
    /// Number of missed presses.
    pub misses: usize,
}

/// Results of a tolerance study.
#[derive(Clone, Debug)]
pub struct ToleranceReport {
    /// Name of the skin.
    pub skin: String,
    /// Size of the study.
    pub extent: Extent,
    /// The skin as drawn.
    pub nominal: ToleranceRow,
    /// Each cause alone.
    pub causes: Vec<ToleranceRow>,
    /// All causes together.
    pub together: ToleranceRow,
    /// All causes together, with each sample calibrated by pokes.
    pub calibrated: Vec<ToleranceRow>,
    /// Position error over the skin with all causes together.
    pub places: Vec<PlaceError>,
    /// The grid of the map.
    pub grid: PixelGrid,
    /// The map row by row from the top, millimetres; NaN off the skin.
    pub map_mm: Vec<f32>,
}

impl ToleranceReport {
    /// All rows, in table order.
    pub fn rows(&self) -> impl Iterator<Item = &ToleranceRow> {
        let alone = std::iter::once(&self.nominal).chain(&self.causes);
        alone.chain(std::iter::once(&self.together)).chain(&self.calibrated)
    }

    /// The causes that cost most, in a few sentences.
    pub fn verdict(&self) -> String {
        let own = self.nominal.mean_mm;
        let worst = |key: fn(&ToleranceRow) -> f64| self.causes.iter().max_by(|a, b| key(a).total_cmp(&key(b)));
        let mut said = match worst(|row| row.mean_mm) {
            Some(row) if row.mean_mm > 1.1 * own => format!(
                "For positions, {} costs most: {:.2} mm on average against {own:.2} mm as drawn. Build this carefully.",
                row.name, row.mean_mm
            ),
            _ => format!("No single cause costs a tenth of the {own:.2} mm of the skin as drawn."),
        };
        said += &format!(" All together cost {:.2} mm.", self.together.mean_mm);
        if let Some(row) = worst(|row| row.amplitude_percent[0]).filter(|row| row.amplitude_percent[0].is_finite()) {
            said += &format!(" For amplitudes it is {}: {:.1} % (median).", row.name, row.amplitude_percent[0]);
        }
        let best = self.calibrated.iter().min_by(|a, b| a.mean_mm.total_cmp(&b.mean_mm));
        match best {
            Some(row) if row.mean_mm < 0.9 * self.together.mean_mm => {
                said += &format!(" Calibration helps: {:.2} mm with {}.", row.mean_mm, row.name);
            }
            Some(_) => said += " Calibration by pokes places touches no better.",
            None => {}
        }
        said
    }
}

/// Samples to try, and the rows that they contribute to.
struct Task {
    rows: Vec<String>,
    causes: Vec<Cause>,
    reader: Reader,
    samples: usize,
}

/// Studies a skin with these tolerances. `progress` gets the number of samples done and the total, and returns whether
/// to continue.
///
/// # Errors
/// A number is out of range, the skin cannot be meshed or solved, or [`Error::Interrupted`] because `progress`
/// returned false.
pub fn run(
    skin: &Skin,
    tolerances: &Tolerances,
    extent: &Extent,
    progress: &(dyn Fn(usize, usize) -> bool + Sync),
) -> Result<ToleranceReport, Error> {
    let go_on = |done: usize, all: usize| if progress(done, all) { Ok(()) } else { Err(Error::Interrupted) };
    extent.check()?;
    let bench = Bench::new(skin, PLACES)?;
    let causes = causes(tolerances, &bench.skin);
    let tasks = tasks(&causes, extent);
    let all: usize = tasks.iter().map(|task| task.samples).sum();
    let done = AtomicUsize::new(0);
    let every: Vec<usize> = (0..PLACES).collect();
    // Reference amplitudes, one set for each reader that a task may use.
    let nominal: Vec<Vec<Vec<Press>>> = [Reader::Model, Reader::Pokes(extent.pokes.clone())]
        .par_iter()
        .map(|reader| {
            go_on(0, all)?;
            let seeds = [extent.seed, NOMINAL];
            bench.press(&bench.build(tolerances, &[], seeds)?, reader, &every, seeds, true)
        })
        .collect::<Result<_, Error>>()?;
    let jobs: Vec<(usize, u64)> = tasks
        .iter()
        .enumerate()
        .flat_map(|(k, task)| (0..task.samples as u64).map(move |sample| (k, sample)))
        .collect();
    let pressed: Vec<Vec<Vec<Press>>> = jobs
        .par_iter()
        .with_max_len(1)
        .map(|&(k, sample)| {
            let (task, seeds) = (&tasks[k], [extent.seed, sample]);
            let built = bench.build(tolerances, &task.causes, seeds)?;
            let presses = bench.press(&built, &task.reader, &some_places(extent, sample), seeds, false);
            go_on(done.fetch_add(1, Ordering::Relaxed) + 1, all)?;
            presses
        })
        .collect::<Result<_, Error>>()?;
    let presses_of = |k: usize, row: usize| -> Vec<Press> {
        let of_task = jobs.iter().zip(&pressed).filter(|(job, _)| job.0 == k);
        of_task.flat_map(|(_, presses)| presses[row].iter().copied()).collect()
    };
    let near_mm = bench.near_mm();
    let mut all_rows = Vec::new();
    for (k, task) in tasks.iter().enumerate() {
        let nominal = &nominal[usize::from(task.reader != Reader::Model)];
        for (r, name) in task.rows.iter().enumerate() {
            all_rows.push(row(name.clone(), task.samples, &presses_of(k, r), &nominal[r], near_mm));
        }
    }
    let mut rows = all_rows.into_iter();
    let nominal_row = rows.next();
    let mut causes_alone: Vec<ToleranceRow> = rows.by_ref().take(causes.len() + 1).collect();
    let (Some(nominal), Some(together)) = (nominal_row, causes_alone.pop()) else {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: "rows".into(),
            expected: "at least two".into(),
            got: "fewer".into(),
        }));
    };
    let calibrated: Vec<ToleranceRow> = rows.collect();
    let together_presses = presses_of(causes.len() + 1, 0);
    let places = by_place(&bench, &together_presses);
    let (grid, map_mm) = map(&bench, &places)?;
    Ok(ToleranceReport {
        skin: bench.skin.name.clone(),
        extent: extent.clone(),
        nominal,
        causes: causes_alone,
        together,
        calibrated,
        places,
        grid,
        map_mm,
    })
}

fn tasks(causes: &[Cause], extent: &Extent) -> Vec<Task> {
    let row = |name: &str, causes: &[Cause]| Task {
        rows: vec![name.to_string()],
        causes: causes.to_vec(),
        reader: Reader::Model,
        samples: extent.samples,
    };
    let mut tasks = vec![row("as drawn", &[])];
    tasks.extend(causes.iter().map(|cause| row(cause.name(), &[*cause])));
    tasks.push(row("all together", causes));
    if !extent.pokes.is_empty() {
        tasks.push(Task {
            rows: extent.pokes.iter().map(|count| format!("all, calibrated by {count} pokes")).collect(),
            causes: causes.to_vec(),
            reader: Reader::Pokes(extent.pokes.clone()),
            samples: (extent.samples / CALIBRATED_SHARE).max(ALL_CALIBRATED).min(extent.samples),
        });
    }
    tasks
}

/// The places at which a sample is pressed; the same in every row.
fn some_places(extent: &Extent, sample: u64) -> Vec<usize> {
    let mut dice = Dice::new(extent.seed, sample, PLACES_DICE);
    let mut places: Vec<usize> = (0..PLACES).collect();
    for k in 0..extent.presses {
        let other = k + dice.below(PLACES - k);
        places.swap(k, other);
    }
    places.truncate(extent.presses);
    places
}

fn row(name: String, samples: usize, presses: &[Press], nominal: &[Press], near_mm: f64) -> ToleranceRow {
    let errors: Vec<f64> = presses.iter().filter_map(|press| press.error_mm).collect();
    let amplitude = |press: &Press| {
        let (seen, drawn) = (press.amplitude?, nominal[press.place].amplitude?);
        Some(100.0 * (seen / drawn - 1.0).abs())
    };
    let count = presses.len() as f64;
    let misses = presses.iter().filter(|press| press.error_mm.is_none()).count();
    ToleranceRow {
        name,
        samples,
        presses: presses.len(),
        position_mm: median_and_p90(errors),
        amplitude_percent: median_and_p90(presses.iter().filter_map(amplitude).collect()),
        misses_percent: 100.0 * misses as f64 / count,
        false_per_press: presses.iter().map(|press| press.false_touches).sum::<usize>() as f64 / count,
        mean_mm: presses.iter().map(|press| press.error_mm.unwrap_or(near_mm)).sum::<f64>() / count,
    }
}

fn median_and_p90(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let at = |share: f64| match values.len() {
        0 => f64::NAN,
        count => values[(share * (count - 1) as f64).round() as usize],
    };
    [at(0.5), at(0.9)]
}

fn by_place(bench: &Bench, presses: &[Press]) -> Vec<PlaceError> {
    let place = |(index, place_m): (usize, &[f64; 2])| {
        let here = || presses.iter().filter(|press| press.place == index);
        let errors = here().map(|press| press.error_mm.unwrap_or(bench.near_mm())).collect();
        PlaceError {
            place_m: *place_m,
            presses: here().count(),
            median_mm: median_and_p90(errors)[0],
            misses: here().filter(|press| press.error_mm.is_none()).count(),
        }
    };
    bench.places_m.iter().enumerate().map(place).collect()
}

/// Interpolates errors between places by means weighted with a Gaussian of the distance.
fn map(bench: &Bench, places: &[PlaceError]) -> Result<(PixelGrid, Vec<f32>), Error> {
    let outline = bench.skin.outline();
    let (low, high) = outline.bounds_m();
    let grid = PixelGrid::covering(low, high, MAP)
        .map_err(|source| Error::Live(dermis_live::Error::Mesh { skin: bench.skin.name.clone(), source }))?;
    let width_m = 0.6 * (outline.area_m2() / PLACES as f64).sqrt();
    let seen: Vec<&PlaceError> = places.iter().filter(|place| place.median_mm.is_finite()).collect();
    let at = |pixel: usize| {
        let [x, y] = grid.centre_m(pixel);
        if !outline.contains([x, y]) {
            return f32::NAN;
        }
        let squares = |place: &PlaceError| (place.place_m[0] - x).powi(2) + (place.place_m[1] - y).powi(2);
        // Distances are relative to the nearest place, so that the weights don't vanish far from all places.
        let nearest = seen.iter().map(|place| squares(place)).fold(f64::INFINITY, f64::min);
        let (sum, total) = seen.iter().fold((0.0, 0.0), |(sum, total), place| {
            let weight = (-0.5 * (squares(place) - nearest) / (width_m * width_m)).exp();
            (sum + weight * place.median_mm, total + weight)
        });
        (sum / total) as f32
    };
    let values = (0..grid.len()).map(at).collect();
    Ok((grid, values))
}
