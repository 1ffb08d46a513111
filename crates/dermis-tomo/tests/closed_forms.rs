//! Compares the forward model with closed forms: point electrodes on the rim of a disc, homogeneous and with a
//! concentric anomaly. A unit current at angle a raises the rim's potential at angle t by
//! `1 / (pi s) sum_n (1/n) (1 - k rho^2n) / (1 + k rho^2n) cos n (t - a)`, where rho is the anomaly's radius relative
//! to the disc's and `k = (s1 - s) / (s1 + s)` (separation of variables; Isaacson, IEEE TMI 5, 1986, eq. 4.9 has the
//! same factors).

use std::f64::consts::{PI, TAU};

use dermis_tomo::eit::{Drive, Driven, ForwardModel, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Contact, Direction, ElectrodeShape, ElectrodedMesh, Outline, SheetSpec};

const RADIUS_M: f64 = 0.1;
const ANOMALY: f64 = 0.5;
const SIGMA: f64 = 0.3;
const SIGMA_INSIDE: f64 = 2.0;

/// The disc's mesh, and the elements of the concentric anomaly. A pad of its size puts the anomaly's rim into the
/// mesh.
fn disc(elements: usize) -> (ElectrodedMesh, Vec<u32>) {
    let outline = Outline::Disc { radius_m: RADIUS_M };
    let mut electrodes = outline.rim_points(16, 0.0, Direction::CounterClockwise);
    electrodes.push(ElectrodeShape::PadCircle { centre_m: [0.0, 0.0], radius_m: ANOMALY * RADIUS_M });
    let spec = SheetSpec::new(outline, electrodes, 5e-3).with_target_elements(elements).unwrap();
    let (body, quality) = spec.build(&[1.0]).unwrap();
    assert!(quality.refinement_complete);
    let mut electrodes = body.electrodes;
    let Some(Contact::Area(inside)) = electrodes.pop().map(|e| e.contact) else { panic!("the pad comes last") };
    (ElectrodedMesh::new(body.mesh, electrodes).unwrap(), inside)
}

fn protocol() -> Protocol {
    Protocol::generate(&ProtocolSpec {
        electrode_count: 16,
        drive: Drive::Opposite,
        measure: Measure::Adjacent,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1.0,
    })
    .unwrap()
}

fn exact(protocol: &Protocol, contrast: f64) -> Vec<f64> {
    let series = |angle: f64| {
        if contrast == 0.0 {
            // sum cos(n t) / n = -ln(2 sin(t / 2)), the limit of the slowly converging series.
            return -(2.0 * (0.5 * angle).sin().abs()).ln() / (PI * SIGMA);
        }
        let plain = -(2.0 * (0.5 * angle).sin().abs()).ln();
        let corrections = (1..60).map(|n| {
            let damped = contrast * ANOMALY.powi(2 * n);
            ((1.0 - damped) / (1.0 + damped) - 1.0) / f64::from(n) * (f64::from(n) * angle).cos()
        });
        (plain + corrections.sum::<f64>()) / (PI * SIGMA)
    };
    let angle = |electrode: u32| TAU * f64::from(electrode) / 16.0;
    (0..protocol.channel_count())
        .map(|channel| {
            let mut sum = 0.0;
            for &(read, weight) in protocol.pattern_of(channel).entries() {
                for &(driven, current) in protocol.stimulation_of(channel).entries() {
                    sum += weight * current * series(angle(read) - angle(driven));
                }
            }
            sum
        })
        .collect()
}

fn relative_error(found: &[f64], expected: &[f64]) -> f64 {
    let difference: f64 = found.iter().zip(expected).map(|(a, b)| (a - b) * (a - b)).sum();
    (difference / expected.iter().map(|v| v * v).sum::<f64>()).sqrt()
}

/// Errors of the voltages on successively finer meshes, and the orders of convergence between them.
fn study(inside: f64) -> (Vec<f64>, Vec<f64>) {
    let protocol = protocol();
    let expected = exact(&protocol, (inside - SIGMA) / (inside + SIGMA));
    let mut errors = Vec::new();
    let mut sizes = Vec::new();
    for elements in [1_000, 4_000, 16_000, 64_000] {
        let (body, anomaly) = disc(elements);
        let mut sigma = vec![SIGMA; body.mesh.element_count()];
        anomaly.iter().for_each(|&element| sigma[element as usize] = inside);
        sizes.push((body.mesh.element_count() as f64).powf(-0.5));
        let model = ForwardModel::new(body, protocol.clone()).unwrap();
        errors.push(relative_error(&model.solve(&sigma).unwrap().voltages(), &expected));
    }
    let orders = (1..errors.len()).map(|k| (errors[k - 1] / errors[k]).ln() / (sizes[k - 1] / sizes[k]).ln()).collect();
    (errors, orders)
}

#[test]
fn voltages_of_a_homogeneous_disc_converge_with_order_two() {
    let (errors, orders) = study(SIGMA);
    println!("homogeneous disc: relative errors {errors:.6?}, orders {orders:.2?}");
    // Linear elements converge with order 2 away from point sources; on graded meshes single steps scatter.
    let mean = orders.iter().sum::<f64>() / orders.len() as f64;
    assert!((1.7..2.4).contains(&mean), "{orders:?}");
    assert!(errors[3] < 5e-4, "{errors:?}");
}

#[test]
fn a_concentric_anomaly_converges_to_its_fourier_series() {
    let (errors, orders) = study(SIGMA_INSIDE);
    println!("concentric anomaly: relative errors {errors:.6?}, orders {orders:.2?}");
    let mean = orders.iter().sum::<f64>() / orders.len() as f64;
    assert!((1.7..2.4).contains(&mean), "{orders:?}");
    assert!(errors[3] < 1e-3, "{errors:?}");
}
