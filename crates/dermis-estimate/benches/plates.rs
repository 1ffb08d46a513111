//! Speed of the fits of presses on a sandwich: one fit, and the search for presses from nothing.

use std::sync::Arc;

use criterion::{Criterion, criterion_group, criterion_main};
use dermis_estimate::{Effort, Estimator, Evidence, PlateFit, PlateLaw, PlateModel, PlateOptions, Press, PressFit};
use dermis_tomo::eit::contacts::PlatedSheet;
use dermis_tomo::eit::{Drive, Driven, ForwardModel, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline, PixelGrid, SheetSpec};

/// Noise of a channel, volts.
const NOISE_V: f64 = 1e-5;
const SIDE_M: f64 = 0.1;

/// A square of 100 mm with 16 pads.
fn sheet(element_m: f64) -> PlatedSheet {
    let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: 6e-3, height_m: 6e-3, angle_rad: 0.0 };
    let pads = pad.ring(5, 5, [23.5e-3; 2], Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Rectangle { width_m: SIDE_M, height_m: SIDE_M }, pads, element_m);
    let protocol = Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::PseudoPolar,
        measure: Measure::PseudoPolar,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 3.5e-4,
    });
    let body = spec.build(&[5e-4]).expect("the square is sound").0;
    let model = ForwardModel::new(body, protocol.expect("the protocol is sound")).expect("both fit");
    let elements = model.body().mesh.element_count();
    PlatedSheet::new(&model, &vec![5e-3; elements], |_| Some(0)).expect("the square can be solved")
}

/// The model on two meshes with elements of these sizes.
fn model(element_m: [f64; 2]) -> Arc<PlateModel> {
    let law =
        PlateLaw { threshold_pa: 3e3, reference_pa: 6e4, exponent: 1.5, saturation_s_per_m2: 1500.0, spread_m: 1.5e-3 };
    let options = PlateOptions {
        typical_radius_m: 6e-3,
        typical_pa: 1.5e5,
        usual_radius_m: 8e-3,
        usual_pa: 8e4,
        radii_m: [2.5e-3, 30e-3],
        spacing_m: 0.1 * SIDE_M,
        most_presses: 8,
        error_share: 5e-4,
    };
    let grid = PixelGrid { columns: 32, rows: 32, left_m: -0.5 * SIDE_M, top_m: 0.5 * SIDE_M, pixel_m: SIDE_M / 32.0 };
    let inside = vec![true; grid.len()];
    Arc::new(PlateModel::new(element_m.map(sheet), law, options, grid, inside).expect("presses can be solved"))
}

fn press(x_mm: f64, y_mm: f64, radius_mm: f64) -> Press {
    Press { position_m: [1e-3 * x_mm, 1e-3 * y_mm], radius_m: 1e-3 * radius_mm, load: 0.7, ..Press::default() }
}

fn plates(c: &mut Criterion) {
    // Frames come from a mesh of their own.
    let twin = model([4e-3, 1.7e-3]);
    let model = model([3.65e-3, 2.2e-3]);
    let deviations = vec![NOISE_V; model.bare_v().len()];
    let fit = |model: &Arc<PlateModel>| PlateFit::new(model.clone(), &deviations, &[]);
    let all = [press(-25.0, 12.0, 6.0), press(21.0, 17.0, 5.0), press(-6.0, -26.0, 7.0)];
    let mut group = c.benchmark_group("sandwich, 208 channels");
    for count in 1..=3 {
        let (mut frame, presses) = (Vec::new(), &all[..count]);
        fit(&twin).channels_of(presses, &mut frame);
        let mut fitted = fit(&model);
        fitted.take_frame(&frame);
        let away: Vec<Press> =
            presses.iter().map(|p| Press { position_m: p.position_m.map(|at| at + 2e-3), ..*p }).collect();
        for effort in [Effort::Quick, Effort::Full] {
            let name = format!("fit of {count}, {effort:?}");
            group.bench_function(name.to_lowercase(), |b| b.iter(|| fitted.fit(&away, effort)));
        }
        group.bench_function(format!("residual of {count}"), |b| b.iter(|| fitted.left_by(presses)));
        let evidence = Evidence { begin: 8.0, hold: 5.0 };
        let mut estimator = Estimator::new(Box::new(fit(&model)), evidence, false);
        let found = estimator.explain(&frame, &[]).map_or(0, |estimate| estimate.presses.len());
        println!("{found} presses of {count} found by {:.1e} operations", estimator.fit_mut().work());
        group.bench_function(format!("search for {count}"), |b| {
            b.iter(|| {
                estimator.forget();
                estimator.explain(&frame, &[])
            });
        });
    }
    group.finish();
}

criterion_group!(benches, plates);
criterion_main!(benches);
