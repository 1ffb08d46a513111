//! Speed of the sandwich's contact model: the effect of patches, and patches searched from scratch.

use criterion::{Criterion, criterion_group, criterion_main};
use dermis_tomo::eit::contacts::{ContactPatch, ContactSheet, PatchSearch};
use dermis_tomo::eit::{Drive, Driven, ForwardModel, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, Outline, SheetSpec};

fn patch(x_mm: f64, y_mm: f64) -> ContactPatch {
    ContactPatch { position_m: [1e-3 * x_mm, 1e-3 * y_mm], radius_m: 9e-3, conductance_s_per_m2: 600.0 }
}

/// A square of 100 mm with 16 pads, about 4,000 elements.
fn sheet() -> ContactSheet {
    let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: 6e-3, height_m: 6e-3, angle_rad: 0.0 };
    let pads = pad.ring(5, 5, [23.5e-3; 2], Direction::CounterClockwise);
    let spec = SheetSpec::new(Outline::Rectangle { width_m: 0.1, height_m: 0.1 }, pads, 2.3e-3);
    let protocol = Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::PseudoPolar,
        measure: Measure::PseudoPolar,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    });
    let body = spec.build(&[5e-4]).expect("the square is sound").0;
    let model = ForwardModel::new(body, protocol.expect("the protocol is sound")).expect("both fit");
    let elements = model.body().mesh.element_count();
    ContactSheet::new(&model, &vec![5e-3; elements], 7e-3).expect("the square can be solved")
}

fn contacts(c: &mut Criterion) {
    let sheet = sheet();
    let places: Vec<[f64; 2]> =
        (0..100).map(|k| [f64::from(k % 10) - 4.5, f64::from(k / 10) - 4.5].map(|v| 10e-3 * v)).collect();
    let typical = ContactPatch { position_m: [0.0; 2], radius_m: 8e-3, conductance_s_per_m2: 700.0 };
    let search = PatchSearch::new(&sheet, typical, &places).expect("places are on the sheet");
    let all = [patch(-25.0, 12.0), patch(24.0, 20.0), patch(-20.0, -26.0), patch(22.0, -21.0)];
    let mut group = c.benchmark_group("sandwich, 208 channels");
    for count in [1, 2, 4] {
        let patches = &all[..count];
        let change = sheet.change_v(patches).expect("patches are sound");
        let size = (change.iter().map(|v| v * v).sum::<f64>() / change.len() as f64).sqrt();
        let deviation: Vec<f64> = change.iter().map(|v| (0.02 * v).hypot(0.005 * size)).collect();
        group.bench_function(format!("change by {count}"), |b| b.iter(|| sheet.change_v(patches)));
        group.bench_function(format!("best set of {count}"), |b| {
            b.iter(|| {
                let mut sets = search.begin(&sheet, &change, &deviation).ok()?;
                (0..count).map(|_| search.look(&mut sets)).last()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, contacts);
criterion_main!(benches);
