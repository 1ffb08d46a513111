//! H1 to H3: the intact skin under one to three round indenters.

use dermis_tomo::mesh::Point;
use dermis_tomo::quality::centroid_above_m;
use dermis_twin::mechanics::Indenter;

use super::bench::{Bench, PRESSURE_PA, Seen, Step, indenter, mean, radius_m, row};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, ImagePanel, Kind, Look, Report, Row};
use crate::twin_bench::distance_mm;

/// Diameters of the two indenters, millimetres.
const DIAMETERS_MM: [f64; 2] = [20.0, 25.0];
/// Places pressed in the paper.
const PLACES_MM: [Point; 3] = [[0.0, 0.0], [0.0, 25.0], [25.0, 25.0]];
/// ICC, RIE and SSIM of the paper's U-Net with one, two and three touches.
const PUBLISHED: [[f64; 3]; 3] = [[0.80, 0.59, 0.92], [0.85, 0.54, 0.86], [0.70, 0.78, 0.70]];

/// Caption that explains the images of each step and the truth.
const STEPS: &str = "Truth is what the indenters cover; the first step is the linear image over its own peak; the \
                     U-Net's image is its probability of compressed less that of damaged; fitted discs are the \
                     touches of the live pipeline. Single frames.";
const COMPRESSED: &str = "compressed (0: not, 1: fully)";

/// Scores of all steps over several cases, with images of each.
struct Scores {
    /// ICC, RIE and SSIM for each step and case.
    by_step: [Vec<[f64; 3]>; Step::ALL.len()],
    panels: Vec<ImagePanel>,
}

impl Scores {
    fn new() -> Self {
        Self { by_step: Default::default(), panels: Vec::new() }
    }

    fn add(&mut self, bench: &Bench, name: &str, indenters: &[Indenter], seen: &Seen) -> Result<(), Error> {
        let truth = bench.truth(indenters);
        let places: Vec<Point> = indenters.iter().map(|indenter| indenter.centre_m).collect();
        let mut show = |what: &str, image: &[f64]| {
            let values: Vec<f32> = image.iter().map(|value| *value as f32).collect();
            let panel = bench.rig.panel(format!("{name}, {what}"), &values, &places);
            self.panels.push(ImagePanel { quantity: COMPRESSED, ..panel });
        };
        show("truth", &truth);
        for ((step, image), scores) in Step::ALL.iter().zip(&seen.images).zip(&mut self.by_step) {
            scores.push(bench.scores(&truth, image)?);
            // Show four panels per row. The classes look like the probabilities with hard edges, so skip them.
            if *step != Step::Classes {
                show(step.name(), image);
            }
        }
        Ok(())
    }

    fn rows(&self, published: [f64; 3], name: &str) -> Vec<Row> {
        let mut rows = Vec::new();
        for (step, scores) in Step::ALL.iter().zip(&self.by_step) {
            for (k, figure) in ["ICC", "RIE", "SSIM"].into_iter().enumerate() {
                let paper = matches!(step, Step::Network | Step::Classes).then_some(published[k]);
                let here = mean(scores.iter().map(|score| score[k]));
                rows.push(row(format!("{name}, {}: mean {figure}", step.name()), "", paper, here, Kind::Algorithm));
            }
        }
        rows
    }
}

pub(super) const SINGLE: Experiment =
    Experiment { id: "H1", title: "single touches of 20 and 25 mm at 80 kPa", run: single };

/// H1: both indenters at three places.
fn single() -> Result<Report, Error> {
    let mut bench = Bench::new()?;
    let mut scores = Scores::new();
    let mut diameters = Vec::new();
    for place in PLACES_MM {
        for diameter in DIAMETERS_MM {
            let indenters = [indenter(place, diameter)];
            let seen = bench.see(&indenters)?;
            let found = seen.contacts.first().map_or(f64::NAN, |contact| 2e3 * radius_m(contact));
            diameters.push((place, diameter, found));
            scores.add(&bench, &format!("{diameter} mm at ({}, {})", place[0], place[1]), &indenters, &seen)?;
        }
    }
    let mut rows = scores.rows(PUBLISHED[0], "one touch");
    for (place, diameter, found) in &diameters {
        let what = format!("diameter of {diameter} mm at ({}, {})", place[0], place[1]);
        rows.push(row(what, "mm", Some(*diameter), *found, Kind::Algorithm));
    }
    let nearer = |(_, diameter, found): &&([f64; 2], f64, f64)| {
        let other = DIAMETERS_MM[0] + DIAMETERS_MM[1] - diameter;
        (found - diameter).abs() < (found - other).abs()
    };
    let identified = diameters.iter().filter(nearer).count() as f64;
    rows.push(row(
        "cases (of six) in which the indenter is identified by its size",
        "",
        Some(5.0),
        identified,
        Kind::Algorithm,
    ));
    let title = format!("H1: single touches at {} kPa", PRESSURE_PA * 1e-3);
    let caption = format!("One touch of 20 or 25 mm on the self-healing sandwich's twin at three places. {STEPS}");
    let (columns, panels) = (bench.rig.columns(), scores.panels);
    let figures = vec![Figure::Images { name: "single", title, caption, columns, panels }];
    let notes = vec![
        "In the paper, one of six cases, 25 mm in the middle, could not be distinguished from the smaller size.".into(),
        "Truth is what the indenter covers. The first step is scored over its own peak.".into(),
    ];
    Ok(Report { id: SINGLE.id, title: SINGLE.title, rows, figures, notes })
}

pub(super) const POSITIONS: Experiment =
    Experiment { id: "H2", title: "position error at nine places of the first quadrant", run: positions };

/// H2: nine places 12.5 mm apart, with the 20 mm indenter.
fn positions() -> Result<Report, Error> {
    let mut bench = Bench::new()?;
    let grid = *bench.grid();
    let mut errors: [Vec<f64>; Step::ALL.len()] = Default::default();
    let mut points: [Vec<[f64; 2]>; Step::ALL.len()] = Default::default();
    let mut truth = Vec::new();
    for (x, y) in (0..3).flat_map(|r| (0..3).map(move |c| (12.5 * f64::from(c), 12.5 * f64::from(r)))) {
        let pressed = indenter([x, y], DIAMETERS_MM[0]);
        let seen = bench.see(&[pressed])?;
        truth.push([x, y]);
        for (k, step) in Step::ALL.into_iter().enumerate() {
            let place = match step {
                Step::Fit => seen.contacts.first().map(|contact| contact.centroid_m),
                Step::First | Step::Network | Step::Classes => centroid_above_m(&seen.images[k], &grid, 1.0, 0.5).ok(),
            };
            let place = place.unwrap_or([f64::NAN; 2]);
            errors[k].push(distance_mm(place, pressed.centre_m));
            points[k].push(place.map(|v| 1e3 * v));
        }
    }
    let published = |step: Step| if step == Step::First { [3.75, 1.12, 2.52] } else { [3.44, 0.92, 1.84] };
    let mut rows = Vec::new();
    for (step, errors) in Step::ALL.into_iter().zip(&errors) {
        let most = errors.iter().copied().fold(0.0, f64::max);
        let least = errors.iter().copied().fold(f64::INFINITY, f64::min);
        for ((word, here), paper) in ["largest", "smallest", "mean"]
            .into_iter()
            .zip([most, least, mean(errors.iter().copied())])
            .zip(published(step))
        {
            rows.push(row(format!("{}: {word} error", step.name()), "mm", Some(paper), here, Kind::Algorithm));
        }
    }
    let curve =
        |name: &str, points: &[[f64; 2]]| Curve { name: name.into(), points: points.to_vec(), look: Look::Points };
    let mut curves = vec![curve("truth", &truth)];
    curves.extend(Step::ALL.iter().zip(&points).map(|(step, points)| curve(step.name(), points)));
    let title = "H2: nine places of the first quadrant".into();
    let caption = "Nine places, 12.5 mm apart, at which a 20 mm disc pressed the self-healing sandwich's twin, and \
                   the places found by the linear image (first step) and the U-Net, each by the centroid above half \
                   of its peak, and by the contact fitted to the forward model. Single frames."
        .into();
    let (x_label, y_label) = ("x (mm)", "y (mm)");
    let figures = vec![Figure::Curves { name: "places", title, caption, x_label, y_label, curves }];
    let notes = vec!["The first step's place is the centroid above half of the peak, as in the paper.".into()];
    Ok(Report { id: POSITIONS.id, title: POSITIONS.title, rows, figures, notes })
}

pub(super) const SEVERAL: Experiment = Experiment { id: "H3", title: "two and three touches at once", run: several };

/// H3: two and three 20 mm touches.
fn several() -> Result<Report, Error> {
    let two: [&[[f64; 2]]; 4] = [
        &[[-25.0, 0.0], [25.0, 0.0]],
        &[[0.0, -25.0], [0.0, 25.0]],
        &[[-20.0, -20.0], [20.0, 20.0]],
        &[[-25.0, 12.5], [12.5, -25.0]],
    ];
    let three: [&[[f64; 2]]; 2] =
        [&[[-25.0, -20.0], [25.0, -20.0], [0.0, 25.0]], &[[-28.0, 0.0], [22.0, 22.0], [22.0, -22.0]]];
    let mut bench = Bench::new()?;
    let (mut rows, mut panels) = (Vec::new(), Vec::new());
    for (cases, published, name) in
        [(&two[..], PUBLISHED[1], "two touches"), (&three[..], PUBLISHED[2], "three touches")]
    {
        let mut scores = Scores::new();
        let (mut counted, mut worst) = (0, 0.0_f64);
        for (case, places) in cases.iter().enumerate() {
            let indenters: Vec<Indenter> = places.iter().map(|place| indenter(*place, DIAMETERS_MM[0])).collect();
            let seen = bench.see(&indenters)?;
            counted += usize::from(seen.contacts.len() == places.len());
            for pressed in &indenters {
                let distance = |contact: &dermis_touch::Contact| distance_mm(contact.centroid_m, pressed.centre_m);
                worst = worst.max(seen.contacts.iter().map(distance).fold(f64::INFINITY, f64::min));
            }
            scores.add(&bench, &format!("{name}, case {}", case + 1), &indenters, &seen)?;
        }
        rows.extend(scores.rows(published, name));
        let all = cases.len() as f64;
        rows.push(row(
            format!("{name}: cases where all are found"),
            "",
            Some(all),
            f64::from(counted as u32),
            Kind::Algorithm,
        ));
        rows.push(row(format!("{name}: largest position error"), "mm", None, worst, Kind::Algorithm));
        panels.extend(scores.panels);
    }
    let title = "H3: two and three touches".into();
    let caption = format!("Two and three touches of 20 mm on the self-healing sandwich's twin. {STEPS}");
    let figures = vec![Figure::Images { name: "several", title, caption, columns: bench.rig.columns(), panels }];
    let notes = vec!["The paper does not give the places of its several touches; these are spread similarly.".into()];
    Ok(Report { id: SEVERAL.id, title: SEVERAL.title, rows, figures, notes })
}
