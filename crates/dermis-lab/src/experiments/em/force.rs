//! Force: force curves with their quadratic calibration, and the smallest force.

use super::array::{Array, CIRCULAR, EIGHT, row, solve_name};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, Kind, Look, Report};
use dermis_skin::Solve;

/// Detection limit, in standard deviations.
const DETECTED: f64 = 3.3;

pub(super) const RAMPS: Experiment = Experiment {
    id: "E10",
    title: "force ramps at three elements and their quadratic calibration (E9, E10)",
    run: ramps,
};

/// E9 and E10: the image at the element against force, with a quadratic fitted up to the given force.
fn ramps() -> Result<Report, Error> {
    let (mut rows, mut figures) = (Vec::new(), Vec::new());
    let eight = [("L1", 6), ("L2", 12), ("L3", 18)];
    let sixteen = [("L6", 18), ("L9", 27), ("L14", 45)];
    for (array, solve, most_n, mean_of, places, file) in [
        (EIGHT, Solve::Pixels, 6.0, 10, eight, "force-8-image"),
        (EIGHT, Solve::LiftOff, 6.0, 10, eight, "force-8"),
        (CIRCULAR, Solve::LiftOff, 5.0, 100, sixteen, "force-16"),
    ] {
        let (more, curves) = ramp(array, solve, most_n, mean_of, &places)?;
        rows.extend(more);
        let title = format!("E9, E10: {}, {} at the element against force", array.name, solve_name(solve));
        let caption = format!(
            "Image at three elements of the EM-skin's twin ({}, {}) against the force on each; means of {mean_of} \
            frames.",
            array.name,
            solve_name(solve)
        );
        let (x_label, y_label) = ("force (N)", "share of travel");
        figures.push(Figure::Curves { name: file, title, caption, x_label, y_label, curves });
    }
    let notes = vec![
        "Stiffness and travel of sponge and springs are assumed; their stiffening bends the curve.".into(),
        "Means of ten frames of the eight coils, of 100 of the sixteen at 50 dB. The paper does not say where its \
        L6, L9 and L14 lie; here they are in the 3rd, 4th and 6th row."
            .into(),
    ];
    Ok(Report { id: RAMPS.id, title: RAMPS.title, rows, figures, notes })
}

fn ramp(
    array: Array,
    solve: Solve,
    most_n: f64,
    mean_of: usize,
    places: &[(&str, usize)],
) -> Result<(Vec<crate::experiments::Row>, Vec<Curve>), Error> {
    let mut bench = array.bench(solve)?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for &(name, element) in places {
        let mut points = Vec::new();
        for step in 0..=12 {
            let force_n = most_n / 12.0 * f64::from(step);
            let indenters = if step == 0 { vec![] } else { vec![bench.press(element, force_n)] };
            bench.rig.frames(&indenters, 10)?;
            let frame = bench.rig.mean_frame(&indenters, mean_of)?;
            let image = bench.rig.image(&frame)?;
            points.push([force_n, bench.rig.mean_around(&image, bench.places[element])]);
        }
        let falls = points.windows(2).filter(|w| w[1][1] < w[0][1]).count();
        let name = format!("{}, {}: {name}", array.name, solve_name(solve));
        rows.push(row(format!("{name}: steps at which the curve falls"), "", Some(0.0), falls as f64, Kind::Predicted));
        rows.push(row(format!("{name}: R^2 of a quadratic"), "", None, quadratic_r2(&points), Kind::Predicted));
        let (first, last) = (points[3][1] - points[0][1], points[12][1] - points[9][1]);
        rows.push(row(
            format!("{name}: last quarter's rise over the first's"),
            "",
            None,
            last / first,
            Kind::Predicted,
        ));
        curves.push(Curve { name, points, look: Look::Line });
        bench.rig.frames(&[], 40)?;
    }
    Ok((rows, curves))
}

pub(super) const SMALLEST: Experiment =
    Experiment { id: "E11", title: "smallest force: 120 mN on one element", run: smallest };

/// E11: 120 mN on each element, frame by frame, compared with frames at rest.
fn smallest() -> Result<Report, Error> {
    let mut bench = EIGHT.bench(Solve::Pixels)?;
    let (mut ratios, mut limits) = (Vec::new(), Vec::new());
    for element in 0..bench.places.len() {
        let place = bench.places[element];
        bench.rig.frames(&[], 20)?;
        let mut at = |force_n: f64| -> Result<(f64, f64), Error> {
            let indenters = if force_n > 0.0 { vec![bench.press(element, force_n)] } else { Vec::new() };
            bench.rig.frames(&indenters, 20)?;
            let frames = bench.rig.frames(&indenters, 20)?;
            let values =
                frames.iter().map(|frame| bench.rig.image(frame).map(|image| bench.rig.mean_around(&image, place)));
            Ok(mean_and_deviation(&values.collect::<Result<Vec<_>, Error>>()?))
        };
        let ((rest, _), (pressed, deviation)) = (at(0.0)?, at(0.12)?);
        ratios.push((pressed - rest) / deviation);
        limits.push(0.12 * DETECTED * deviation / (pressed - rest));
    }
    let detected = ratios.iter().filter(|r| **r > DETECTED).count();
    let averaged = ratios.iter().filter(|r| **r * 10_f64.sqrt() > DETECTED).count();
    limits.sort_by(f64::total_cmp);
    let limit_n = limits[limits.len() / 2];
    let kpa = |force_n: f64, radius_m: f64| 1e-3 * force_n / (std::f64::consts::PI * radius_m * radius_m);
    let rows = vec![
        row("elements (of 25) at which 120 mN exceeds 3.3 deviations", "", None, detected as f64, Kind::Predicted),
        row("the same in means over one second", "", None, averaged as f64, Kind::Predicted),
        row("limit of detection of one frame, median of the elements", "N", Some(0.12), limit_n, Kind::Predicted),
        row("the same, smallest", "N", Some(0.12), limits[0], Kind::Predicted),
        row("its pressure on 1 cm diameter, median", "kPa", None, kpa(limit_n, 5e-3), Kind::Predicted),
        row("its pressure on 1 cm radius, median", "kPa", None, kpa(limit_n, 1e-2), Kind::Predicted),
        row("pressure of 120 mN on 1 cm diameter", "kPa", Some(0.38), kpa(0.12, 5e-3), Kind::Predicted),
        row("pressure of 120 mN on 1 cm radius", "kPa", Some(0.38), kpa(0.12, 1e-2), Kind::Predicted),
    ];
    let notes = vec![
        "The paper's 0.38 kPa is that of a radius of 1 cm; its element has 1 cm in diameter.".into(),
        "Single frames of 0.1 s, on sponge of an assumed stiffness (400 N/m: 120 mN are 0.3 mm).".into(),
    ];
    Ok(Report { id: SMALLEST.id, title: SMALLEST.title, rows, figures: Vec::new(), notes })
}

pub(super) fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}

/// Share of variance explained by the least-squares quadratic, computed with polynomials orthogonal on the points
/// themselves.
fn quadratic_r2(points: &[[f64; 2]]) -> f64 {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    let mut rest: Vec<f64> = points.iter().map(|p| p[1]).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut total = 0.0;
    for degree in 0..=2 {
        let mut next: Vec<f64> = points.iter().map(|p| p[0].powi(degree)).collect();
        for known in &basis {
            let share = dot(&next, known) / dot(known, known);
            next.iter_mut().zip(known).for_each(|(n, k)| *n -= share * k);
        }
        let share = dot(&rest, &next) / dot(&next, &next);
        rest.iter_mut().zip(&next).for_each(|(r, n)| *r -= share * n);
        if degree == 0 {
            total = dot(&rest, &rest);
        }
        basis.push(next);
    }
    1.0 - dot(&rest, &rest) / total
}
