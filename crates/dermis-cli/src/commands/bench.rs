//! `dermis bench`: times the numerical work on one core of this machine. Criterion's benches in the repository
//! measure the same with statistics, and against other packages.

use dermis_live::imager::Imager;
use dermis_live::reference::Reference;
use std::io::Write;
use std::time::{Duration, Instant};

use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::stages::refinement::Refinement;
use dermis_skin::Skin;
use dermis_tomo::eit::{Drive, Driven, ForwardModel, Jacobian, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::inverse::{ImageBasis, LinearProblem, Prior, QuantisedOperator, Weighting};
use dermis_tomo::mesh::{Direction, Outline, PixelGrid, PixelMap, SheetSpec};

use crate::exit::Outcome;

const EXAMPLE: &str = "\
Example:
  dermis bench --seconds 0.2";

/// Number of forward solves in the line that runs many in parallel.
const MANY: usize = 256;

/// Arguments of `dermis bench`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
pub struct Arguments {
    /// Time spent on each line.
    #[arg(long, default_value_t = 1.0)]
    seconds: f64,
    /// Print JSON instead of a table.
    #[arg(long)]
    json: bool,
}

/// Lines of the table, printed as they come or kept for JSON.
struct Lines<'a> {
    out: &'a mut dyn Write,
    json: Option<Vec<serde_json::Value>>,
}

impl Arguments {
    /// Times everything and prints a table.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if !(self.seconds > 0.0 && self.seconds <= 600.0) {
            let text = format!("--seconds {}: expected more than 0 and at most 600", self.seconds);
            return Err(crate::exit::UsageError(text).into());
        }
        let time =
            |work: &mut dyn FnMut() -> anyhow::Result<()>| median_of(work, Duration::from_secs_f64(self.seconds));
        if !self.json {
            writeln!(out, "{:<58} {:>12} {:>12}", "one core unless stated", "median", "best")?;
        }
        let mut lines = Lines { out, json: self.json.then(Vec::new) };
        for elements in [5_000, 20_000] {
            let model = disc(elements)?;
            let sigma = vec![1.0; model.body().mesh.element_count()];
            let mut jacobian = Jacobian::default();
            let took = time(&mut || {
                model.solve(&sigma)?.jacobian_into(std::hint::black_box(&mut jacobian));
                Ok(())
            })?;
            lines.add(&format!("{} elements, 16 electrodes: forward + Jacobian", sigma.len()), took)?;
        }
        many(&mut lines, &time)?;
        self.images(&mut lines, &time)?;
        self.frames(&mut lines, &time)?;
        if let Some(json) = lines.json {
            super::print_json(&json, lines.out)?;
        }
        Ok(Outcome::Done)
    }

    fn images(&self, lines: &mut Lines<'_>, time: &Timer<'_>) -> anyhow::Result<()> {
        let model = disc(5_000)?;
        let grid = PixelGrid::covering([-0.0625; 2], [0.0625; 2], 64).map_err(anyhow::Error::from)?;
        let map = PixelMap::new(grid, &model.body().mesh)?;
        let jacobian = model.solve(&vec![1.0; model.body().mesh.element_count()])?.jacobian_to_pixels(&map);
        let basis = ImageBasis {
            positions: map.inside_centres_m().into_iter().map(|p| [p[0], p[1], 0.0]).collect(),
            neighbours: Vec::new(),
        };
        let operator = || -> anyhow::Result<_> {
            let weighting = Weighting::Identity;
            let prior = Prior::Noser { exponent: 0.5 }.matrix(jacobian.as_mat(), &weighting, &basis)?;
            Ok(LinearProblem::new(jacobian.as_mat(), weighting, prior)?.operator(1e-2)?)
        };
        let took = time(&mut || {
            std::hint::black_box(operator()?);
            Ok(())
        })?;
        lines.add(&format!("operator of 208 channels to {} pixels of 64 x 64", map.inside_count()), took)?;
        let mut live = QuantisedOperator::new(&operator()?, 1.0);
        let (frame, mut image) = (vec![1e-3_f32; live.channels()], vec![0.0_f32; live.unknowns()]);
        let took = time(&mut || {
            live.apply(std::hint::black_box(&frame), &mut image);
            Ok(())
        })?;
        lines.add("frame of 208 channels to image", took)
    }

    fn frames(&self, lines: &mut Lines<'_>, time: &Timer<'_>) -> anyhow::Result<()> {
        let prepared = Prepared::new(Skin::open("healing-square")?)?;
        let reference = Reference::from_baseline(&prepared, &prepared.voltages, None)?;
        let imager = Imager::new(&prepared, &reference, &[])?;
        let touched = prepared.signatures(&[[0.02, 0.01], [-0.02, -0.02]]);
        let difference: Vec<f64> = (0..prepared.channels())
            .map(|channel| 0.2 * (touched[channel] + touched[prepared.channels() + channel]))
            .collect();
        let mut reconstructor = Reconstructor::new(&prepared, imager, None, Refinement::none())?;
        let mut image = vec![f32::NAN; prepared.map.grid().len()];
        let mut clock = 0;
        let took = time(&mut || {
            clock += 1_000_000;
            reconstructor.image(&difference, &mut image)?;
            Ok(reconstructor.follow_touches(clock, &image, None)?)
        })?;
        lines.add("frame of 208 channels to image to touches (64 x 64, two)", took)?;
        reconstructor.refinement = Refinement::new(&prepared, &reference.noise)?;
        let took = time(&mut || {
            clock += 1_000_000;
            reconstructor.image(&difference, &mut image)?;
            Ok(reconstructor.follow_touches(clock, &image, None)?)
        })?;
        lines.add("the same, both refined by the forward model", took)
    }
}

/// A disc of about 5,000 elements, solved for many conductivities.
fn many(lines: &mut Lines<'_>, time: &Timer<'_>) -> anyhow::Result<()> {
    let mut skin = Skin::open("ionic-disc")?;
    skin.imaging.elements = 5_000;
    let prepared = Prepared::new(skin)?;
    let model = ForwardModel::new(prepared.body.mesh.clone(), prepared.protocol.clone())?;
    let elements = model.body().mesh.element_count();
    let conductance = prepared.skin.sheet_conductance_s();
    let sigmas: Vec<Vec<f64>> = (0..MANY)
        .map(|row| (0..elements).map(|element| conductance * (1.0 + 0.5 * ((row + element) as f64).sin())).collect())
        .collect();
    let took = time(&mut || {
        std::hint::black_box(model.voltages_of_many(&sigmas)?);
        Ok(())
    })?;
    lines.add(&format!("{MANY} forward solves, {elements} elements, all cores"), took)
}

type Timer<'a> = dyn Fn(&mut dyn FnMut() -> anyhow::Result<()>) -> anyhow::Result<(Duration, Duration)> + 'a;

/// Median and shortest time of a call, over as many calls as fit into `budget` (at least three).
fn median_of(work: &mut dyn FnMut() -> anyhow::Result<()>, budget: Duration) -> anyhow::Result<(Duration, Duration)> {
    let started = Instant::now();
    let mut times = Vec::new();
    while times.len() < 3 || started.elapsed() < budget {
        let start = Instant::now();
        work()?;
        times.push(start.elapsed());
    }
    times.sort_unstable();
    Ok((times[times.len() / 2], times[0]))
}

impl Lines<'_> {
    fn add(&mut self, what: &str, (median, best): (Duration, Duration)) -> anyhow::Result<()> {
        let [median_us, best_us] = [median, best].map(|time| time.as_secs_f64() * 1e6);
        if let Some(json) = &mut self.json {
            json.push(serde_json::json!({ "what": what, "median_us": median_us, "best_us": best_us }));
            return Ok(());
        }
        writeln!(self.out, "{what:<58} {median_us:>9.1} us {best_us:>9.1} us")?;
        Ok(self.out.flush()?)
    }
}

/// A 125 mm disc with 16 electrodes, adjacent drive and measurement: 208 channels.
fn disc(elements: usize) -> anyhow::Result<ForwardModel> {
    let electrodes = Outline::rim_arcs(16, 0.01, 0.0, Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Disc { radius_m: 0.0625 }, electrodes, 2e-3).with_target_elements(elements)?;
    let protocol = Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::Adjacent,
        measure: Measure::Adjacent,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    })?;
    Ok(ForwardModel::new(spec.build(&[1e-3])?.0, protocol)?)
}
