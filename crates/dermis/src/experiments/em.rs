//! Experiments of the EM-skins (paper E) on the twin of the eight coils: single touches, stability, force curves with their
//! quadratic calibration, and the smallest force. The paper shows images and gives few numbers.

use super::rig::{disc, distance_mm};
use super::{Curve, Experiment, Figure, Kind, Report, Rig, Row};
use crate::Error;
use crate::skin::Skin;

/// All of them.
pub(super) const EXPERIMENTS: [Experiment; 4] = [
    Experiment { id: "E1", title: "single touch at each of 25 elements, eight coils", run: single },
    Experiment { id: "E6", title: "one element held for 100 frames", run: stability },
    Experiment { id: "E10", title: "force ramps at three elements and their quadratic calibration", run: ramps },
    Experiment { id: "E11", title: "smallest force: 120 mN on one element", run: smallest },
];

/// Diameter of an element and of what presses on it, millimetres.
const ELEMENT_MM: f64 = 10.0;

fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}

fn rig() -> Result<(Rig, Vec<[f64; 2]>), Error> {
    let elements = Skin::open("em-8")?.magnetic()?.elements;
    Ok((Rig::new("em-8")?, elements.places_m()))
}

/// E1: 2 N on every element, one frame each after the mechanics settled.
fn single() -> Result<Report, Error> {
    let (mut rig, places) = rig()?;
    let (mut panels, mut errors, mut touches) = (Vec::new(), Vec::new(), 0);
    for (k, place) in places.iter().enumerate() {
        let frame = rig.mean_frame(&[disc(*place, ELEMENT_MM, 2.0)], 3)?;
        let image = rig.image(&frame)?;
        errors.push(distance_mm(rig.peak(&image).0, *place));
        touches += rig.touches(&image)?.len();
        if k % 6 == 0 {
            panels.push(rig.panel(format!("element {}", k + 1), &image, &[*place]));
        }
    }
    let right = errors.iter().filter(|e| **e < ELEMENT_MM).count();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let worst = errors.iter().copied().fold(0.0, f64::max);
    let rows = vec![
        row("elements whose image peaks nearest to them", "", Some(25.0), right as f64, Kind::Algorithm),
        row("touches found in 25 images", "", Some(25.0), touches as f64, Kind::Algorithm),
        row("distance of the peak, mean", "mm", None, mean, Kind::Algorithm),
        row("distance of the peak, largest", "mm", None, worst, Kind::Algorithm),
    ];
    let title = "E1: one element pressed with 2 N".into();
    let figures = vec![Figure::Images { name: "single", title, columns: rig.columns(), panels }];
    let notes = vec!["The paper shows images; that all elements are located is its statement.".into()];
    Ok(Report { id: "E1", title: EXPERIMENTS[0].title, rows, figures, notes })
}

/// E6: 100 frames of one element pressed.
fn stability() -> Result<Report, Error> {
    let (mut rig, places) = rig()?;
    let place = places[6];
    rig.frames(&[disc(place, ELEMENT_MM, 2.0)], 20)?;
    let frames = rig.frames(&[disc(place, ELEMENT_MM, 2.0)], 100)?;
    let (mut values, mut farthest) = (Vec::new(), 0.0_f64);
    for frame in &frames {
        let image = rig.image(frame)?;
        farthest = farthest.max(distance_mm(rig.peak(&image).0, place));
        values.push(rig.mean_around(&image, place));
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    let rows = vec![
        row("scatter of the image there over its mean", "", None, variance.sqrt() / mean, Kind::Predicted),
        row("largest distance of the peak in 100 frames", "mm", Some(0.0), farthest, Kind::Algorithm),
    ];
    let points = values.iter().enumerate().map(|(k, v)| [k as f64, *v]).collect();
    let curves = vec![Curve { name: "element 7".into(), points, joined: true }];
    let title = "E6: image at the element".into();
    let figures =
        vec![Figure::Curves { name: "stability", title, x_label: "frame", y_label: "share of travel", curves }];
    let notes = vec!["A pixel is 3 mm: the peak of an element between pixel centres lies up to 2 mm off.".into()];
    Ok(Report { id: "E6", title: EXPERIMENTS[1].title, rows, figures, notes })
}

/// E9 and E10: the image at the element against force, and a quadratic fitted to it.
fn ramps() -> Result<Report, Error> {
    let (mut rig, places) = rig()?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for (name, element) in [("L1", 6), ("L2", 12), ("L3", 18)] {
        let mut points = Vec::new();
        for step in 0..=12 {
            let force_n = 0.5 * f64::from(step);
            let indenters = if step == 0 { vec![] } else { vec![disc(places[element], ELEMENT_MM, force_n)] };
            rig.frames(&indenters, 10)?;
            let frame = rig.mean_frame(&indenters, 10)?;
            let image = rig.image(&frame)?;
            points.push([force_n, rig.mean_around(&image, places[element])]);
        }
        let falls = points.windows(2).filter(|w| w[1][1] <= w[0][1]).count();
        rows.push(row(
            format!("{name}: steps at which the curve does not rise"),
            "",
            Some(0.0),
            falls as f64,
            Kind::Predicted,
        ));
        rows.push(row(format!("{name}: R^2 of a quadratic"), "", None, quadratic_r2(&points), Kind::Predicted));
        curves.push(Curve { name: name.into(), points, joined: true });
    }
    let title = "E9, E10: image at the element against force".into();
    let figures =
        vec![Figure::Curves { name: "force", title, x_label: "force (N)", y_label: "share of travel", curves }];
    let notes = vec!["Stiffness and travel of the sponge are assumed; that it stiffens bends the curve.".into()];
    Ok(Report { id: "E10", title: EXPERIMENTS[2].title, rows, figures, notes })
}

/// E11: 120 mN on each element, frame by frame, against frames at rest.
fn smallest() -> Result<Report, Error> {
    let (mut rig, places) = rig()?;
    let mut ratios = Vec::new();
    for place in &places {
        rig.frames(&[], 20)?;
        let mut at = |indenters: &[_]| -> Result<Vec<f64>, Error> {
            let frames = rig.frames(indenters, 20)?;
            frames.iter().map(|frame| rig.image(frame).map(|image| rig.mean_around(&image, *place))).collect()
        };
        let (rest, _) = mean_and_deviation(&at(&[])?);
        let indenters = [disc(*place, ELEMENT_MM, 0.12)];
        at(&indenters)?;
        let (pressed, deviation) = mean_and_deviation(&at(&indenters)?);
        ratios.push((pressed - rest) / deviation);
    }
    let detected = ratios.iter().filter(|r| **r > 3.3).count();
    let pressure_kpa = |radius_m: f64| 0.12e-3 / (std::f64::consts::PI * radius_m * radius_m);
    let rows = vec![
        row("elements at which 120 mN stand out by 3.3 deviations", "", None, detected as f64, Kind::Predicted),
        row(
            "signal over deviation, least of 25",
            "",
            None,
            ratios.iter().copied().fold(f64::INFINITY, f64::min),
            Kind::Predicted,
        ),
        row(
            "signal over deviation, largest of 25",
            "",
            None,
            ratios.iter().copied().fold(0.0, f64::max),
            Kind::Predicted,
        ),
        row("pressure of 120 mN on 1 cm diameter", "kPa", Some(0.38), pressure_kpa(5e-3), Kind::Predicted),
        row("pressure of 120 mN on 1 cm radius", "kPa", Some(0.38), pressure_kpa(1e-2), Kind::Predicted),
    ];
    let notes = vec![
        "The paper's 0.38 kPa is that of a radius of 1 cm; its element has 1 cm in diameter.".into(),
        "Single frames of 0.1 s, on sponge of an assumed stiffness; means of n frames stand out sqrt(n) times as much."
            .into(),
    ];
    Ok(Report { id: "E11", title: EXPERIMENTS[3].title, rows, figures: Vec::new(), notes })
}

fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64;
    (mean, variance.sqrt())
}

/// Share of the variance that the least-squares quadratic explains, by orthogonal polynomials on the points themselves.
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
