//! Costs paid once per skin (forward model, Jacobian, operator) and costs per frame, on one core unless the name says
//! otherwise. `benches/peers` measures the same cases in SciPy and pyEIT; `benches/compare` prints the ratios.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use dermis_tomo::eit::{Drive, Driven, ForwardModel, Jacobian, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::inverse::{DataPrecision, ImageBasis, LinearProblem, Operator, Prior, QuantisedOperator, Weighting};
use dermis_tomo::mesh::{
    Direction, ElectrodeShape, ElectrodedMesh, MeshError, Outline, PixelGrid, PixelMap, PrismElectrode, PrismSpec,
    SheetSpec,
};
use faer::Mat;

/// The allocator of the `dermis` command, which reuses the pages of large matrices.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

type Outcome = Result<(), Box<dyn std::error::Error>>;

const ELECTRODES: usize = 16;
const RADIUS_M: f64 = 0.1;
const WIDTH_M: f64 = 0.01;

/// Adjacent drive, adjacent measurement, without driven electrodes: 208 channels.
fn protocol() -> Result<Protocol, Box<dyn std::error::Error>> {
    Ok(Protocol::generate(&ProtocolSpec {
        electrode_count: ELECTRODES,
        drive: Drive::Adjacent,
        measure: Measure::Adjacent,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    })?)
}

fn disc(elements: usize) -> Result<ElectrodedMesh, MeshError> {
    let arcs = Outline::rim_arcs(ELECTRODES, WIDTH_M, 0.0, Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Disc { radius_m: RADIUS_M }, arcs, 3e-3).with_target_elements(elements)?;
    Ok(spec.build(&[1e-3])?.0)
}

/// A square with all 64 x 64 pixels inside.
fn square(elements: usize) -> Result<ElectrodedMesh, MeshError> {
    let outline = Outline::Rectangle { width_m: 2.0 * RADIUS_M, height_m: 2.0 * RADIUS_M };
    let rim = outline.rim_per_side(ELECTRODES / 4, WIDTH_M, Direction::CounterClockwise);
    let spec = SheetSpec::new(outline, rim, 3e-3).with_target_elements(elements)?;
    Ok(spec.build(&[1e-3])?.0)
}

/// A cylinder with the electrodes as patches half-way up its wall.
fn cylinder(element_size_m: f64, layers: usize) -> Result<ElectrodedMesh, MeshError> {
    let patch = |rim: ElectrodeShape| PrismElectrode::Side { rim, low_m: 0.04, high_m: 0.06 };
    let arcs = Outline::rim_arcs(ELECTRODES, WIDTH_M, 0.0, Direction::CounterClockwise);
    let electrodes = arcs.into_iter().map(patch).collect();
    PrismSpec::cylinder(RADIUS_M, 0.1, element_size_m, layers, electrodes).build(&[1e-4])
}

/// One to three round inclusions of 0.2 to 5 times the background's conductivity.
fn random_inclusions(body: &ElectrodedMesh, seed: u64) -> Vec<f64> {
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1;
    let mut uniform = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1_u64 << 53) as f64
    };
    let mut sigma = vec![1.0; body.mesh.element_count()];
    for _ in 0..1 + (uniform() * 3.0) as usize {
        let (angle, reach) = (uniform() * std::f64::consts::TAU, 0.8 * RADIUS_M * uniform().sqrt());
        let (radius, value) = (RADIUS_M * (0.05 + 0.2 * uniform()), 0.2 * 25.0_f64.powf(uniform()));
        for (element, sigma) in sigma.iter_mut().enumerate() {
            let centre = body.mesh.centroid(element);
            if (centre[0] - reach * angle.cos()).hypot(centre[1] - reach * angle.sin()) < radius {
                *sigma = value;
            }
        }
    }
    sigma
}

fn forward_and_jacobian(c: &mut Criterion) -> Outcome {
    for elements in [5_000, 20_000] {
        let model = ForwardModel::new(disc(elements)?, protocol()?)?;
        let sigma = random_inclusions(model.body(), 1);
        println!("disc of {} elements", sigma.len());
        c.bench_function(&format!("forward, {elements} elements"), |b| {
            b.iter(|| model.solve(black_box(&sigma)).map(|solution| solution.voltages()));
        });
        // Reuses memory, as every iteration does; fresh pages are a cost of the system, not of the solver.
        let mut jacobian = Jacobian::default();
        c.bench_function(&format!("forward and Jacobian, {elements} elements"), |b| {
            b.iter(|| {
                model.solve(black_box(&sigma)).map(|solution| {
                    solution.jacobian_into(&mut jacobian);
                    solution.voltages()
                })
            });
        });
        c.bench_function(&format!("forward and Jacobian, {elements} elements, fresh memory"), |b| {
            b.iter(|| model.solve(black_box(&sigma)).map(|solution| (solution.voltages(), solution.jacobian())));
        });
    }
    Ok(())
}

fn tetrahedra(c: &mut Criterion) -> Outcome {
    let model = ForwardModel::new(cylinder(4.65e-3, 20)?, protocol()?)?;
    let sigma = random_inclusions(model.body(), 1);
    println!("cylinder of {} tetrahedra", sigma.len());
    let mut group = c.benchmark_group("solid");
    group.sample_size(10).measurement_time(Duration::from_secs(20));
    group.bench_function("forward, 200000 tetrahedra", |b| {
        b.iter(|| model.solve(black_box(&sigma)).map(|solution| solution.voltages()));
    });
    group.bench_function("forward and Jacobian, 200000 tetrahedra", |b| {
        b.iter(|| model.solve(black_box(&sigma)).map(|solution| (solution.voltages(), solution.jacobian())));
    });
    group.finish();
    Ok(())
}

fn many_solves(c: &mut Criterion) -> Outcome {
    const SAMPLES: usize = 100;
    let model = ForwardModel::new(disc(5_000)?, protocol()?)?;
    let sigmas: Vec<Vec<f64>> = (0..SAMPLES as u64).map(|seed| random_inclusions(model.body(), seed + 1)).collect();
    let mut group = c.benchmark_group("samples");
    group.sample_size(10).measurement_time(Duration::from_secs(8)).throughput(Throughput::Elements(SAMPLES as u64));
    group.bench_function("100 forward solves, 5000 elements, all cores", |b| {
        b.iter(|| model.voltages_of_many(black_box(&sigmas)));
    });
    group.finish();
    Ok(())
}

fn operators(c: &mut Criterion) -> Outcome {
    let body = square(5_000)?;
    let map = PixelMap::new(PixelGrid::over_mesh(&body.mesh, 64)?, &body.mesh)?;
    let positions = map.inside_centres_m().into_iter().map(|[x, y]| [x, y, 0.0]).collect();
    // NOSER does not use neighbours.
    let basis = ImageBasis { positions, neighbours: Vec::new() };
    let model = ForwardModel::new(body, protocol()?)?;
    let sigma = vec![1.0; model.body().mesh.element_count()];
    let solution = model.solve(&sigma)?;
    c.bench_function("Jacobian of 5000 elements summed into 4096 pixels", |b| {
        b.iter(|| solution.jacobian_to_pixels(black_box(&map)));
    });
    let jacobian = solution.jacobian_to_pixels(&map);
    let operator = || -> Result<Operator, dermis_tomo::inverse::InverseError> {
        let prior = Prior::Noser { exponent: 0.5 }.matrix(jacobian.as_mat(), &Weighting::Identity, &basis)?;
        LinearProblem::new(jacobian.as_mat(), Weighting::Identity, prior)?.operator(1e-2)
    };
    c.bench_function("operator, 208 channels to 4096 pixels, NOSER", |b| b.iter(operator));
    live(c, "frame, 208 channels to 64 x 64", &operator()?);
    let large = Operator {
        // No two columns are alike, as with a full noise covariance, so channels cannot be merged.
        matrix: Mat::from_fn(4096, 4096, |row, column| {
            let mixed = ((row * 4096 + column) as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            (mixed >> 40) as f64 / (1_u64 << 24) as f64 - 0.5
        }),
        data_precision: DataPrecision::Whole(Mat::zeros(0, 0)),
        hyperparameter: 1.0,
        noise_deviation: Vec::new(),
    };
    live(c, "frame, 4096 channels to 64 x 64", &large);
    Ok(())
}

fn live(c: &mut Criterion, name: &str, operator: &Operator) {
    let mut live = QuantisedOperator::new(operator, 1.0);
    let frame: Vec<f32> = (0..live.channels()).map(|channel| (channel as f32).sin() * 1e-3).collect();
    let mut image = vec![0.0; live.unknowns()];
    c.bench_function(name, |b| b.iter(|| live.apply(black_box(&frame), &mut image)));
}

fn all(c: &mut Criterion) {
    for part in [forward_and_jacobian, many_solves, operators, tetrahedra] {
        if let Err(error) = part(c) {
            eprintln!("a case could not be set up: {error}");
            std::process::exit(1);
        }
    }
}

criterion_group!(benches, all);
criterion_main!(benches);
