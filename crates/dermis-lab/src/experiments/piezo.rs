//! Experiments P1 to P3 of the piezoresistive skins (paper P: one backend for frontends of several shapes). The
//! contact's one free parameter is fitted on P1 of the square; P1 of the disc and both P2 results are predictions.

use dermis_skin::Skin;
use dermis_tomo::mesh::Point;
use dermis_twin::from_skin::{instrument_options, patched_options};
use dermis_twin::piezo::{CorrelationCurve, DetectionCurve, PUBLISHED_DISTANCES_M, PUBLISHED_LIMITS_PA, PaperP};

use crate::Error;
use crate::report::{Curve, Experiment, Figure, Kind, Look, Report, Row};
use crate::twin_bench::Rig;
use crate::twin_bench::{disc, distance_mm};

/// All experiments of the paper.
pub(super) const EXPERIMENTS: [Experiment; 3] = [
    Experiment { id: "P1", title: "limit of detection, 22 mm indenter under 1.8 to 31.8 g", run: detection },
    Experiment { id: "P2", title: "minimum discernible distance, 10 g shifted by up to 40 mm", run: discernment },
    Experiment { id: "P3", title: "on the cylinder: light, hard, and two touches", run: cylinder },
];

const NAMES: [&str; 2] = ["square", "disc"];
/// Seed of the instrument's noise.
const SEED: u64 = 1;
const PA_TO_N_PER_MM2: f64 = 1e-6;

fn row(quantity: impl Into<String>, unit: &'static str, paper: Option<f64>, here: f64, kind: Kind) -> Row {
    Row { quantity: quantity.into(), unit, paper, here, kind }
}

/// The paper's protocol on the square and the disc.
fn published() -> Result<PaperP, Error> {
    let [square, disc] = [Skin::open("piezo-square")?, Skin::open("piezo-disc")?];
    let instrument = instrument_options(&square, 0.0);
    Ok(PaperP::new(patched_options(&square)?, patched_options(&disc)?, instrument, SEED)?)
}

/// P1 on both skins.
fn detection() -> Result<Report, Error> {
    let facts = published()?.facts()?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for ((fact, name), published) in facts.iter().zip(NAMES).zip(PUBLISHED_LIMITS_PA) {
        let DetectionCurve { noise_v, points, limit_pa, .. } = &fact.detection;
        let kind = if name == "square" { Kind::Fitted } else { Kind::Predicted };
        let [paper, here] = [published, *limit_pa].map(|pa| pa * PA_TO_N_PER_MM2);
        rows.push(row(format!("{name}: limit of detection"), "N/mm^2", Some(paper), here, kind));
        // Log scale, so that the repeats near the limit can be seen; no change at all is drawn as a hundredth of a
        // deviation.
        let decades = |change: f64| (change / noise_v).abs().max(0.01).log10();
        let repeats = points.iter().flat_map(|p| p.change_v.map(|change| [p.pressure_pa, decades(change)]));
        curves.push(Curve { name: name.into(), points: repeats.collect(), look: Look::Repeats });
    }
    let most = curves.iter().flat_map(|curve| &curve.points).map(|p| p[0]).fold(0.0, f64::max);
    curves.push(Curve {
        name: "3.3 deviations".into(),
        points: vec![[0.0, 3.3_f64.log10()], [most, 3.3_f64.log10()]],
        look: Look::Line,
    });
    let limits = PUBLISHED_LIMITS_PA.map(|limit_pa| [limit_pa, 3.3_f64.log10()]).to_vec();
    curves.push(Curve { name: "paper: limits of detection".into(), points: limits, look: Look::PaperPoints });
    let (x_label, y_label) = ("pressure (Pa)", "log₁₀ of change over deviation at rest");
    let title = "P1: change of the voltages against pressure".into();
    let caption = "Change of the root mean square of the voltages over its standard deviation at rest, as a power of \
                   ten, against the pressure of an indenter of 22 mm on the twins of the square and the round skin. \
                   Five repeats of each weight. A pressure is detected from 3.3 deviations on; the paper's limits \
                   lie on that line."
        .into();
    let figures = vec![Figure::Curves { name: "detection", title, caption, x_label, y_label, curves }];
    let notes = vec!["Fitted: the contact's reference pressure, on the square's limit alone.".into()];
    Ok(Report { id: "P1", title: EXPERIMENTS[0].title, rows, figures, notes })
}

/// P2 on both skins.
fn discernment() -> Result<Report, Error> {
    let facts = published()?.facts()?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for ((fact, name), published) in facts.iter().zip(NAMES).zip(PUBLISHED_DISTANCES_M) {
        let CorrelationCurve { points, distance_09_m, distance_05_m } = &fact.correlation;
        for ((level, here), paper) in [(0.9, distance_09_m), (0.5, distance_05_m)].into_iter().zip(published) {
            let quantity = format!("{name}: distance at a correlation of {level}");
            rows.push(row(quantity, "mm", Some(1e3 * paper), 1e3 * here, Kind::Predicted));
        }
        let points = points.iter().map(|p| [1e3 * p.shift_m, p.correlation]).collect();
        curves.push(Curve { name: name.into(), points, look: Look::Line });
    }
    for (name, distances_m) in NAMES.into_iter().zip(PUBLISHED_DISTANCES_M) {
        let points = distances_m.into_iter().zip([0.9, 0.5]).map(|(distance_m, level)| [1e3 * distance_m, level]);
        curves.push(Curve { name: format!("paper: {name}"), points: points.collect(), look: Look::PaperPoints });
    }
    let (x_label, y_label) = ("shift (mm)", "correlation of frames");
    let title = "P2: Pearson correlation of difference frames".into();
    let caption = "Correlation of the difference frames of two presses with 10 g against the distance between them, \
                   on the twins of the square and the round skin. The paper prints at which distance the \
                   correlation is 0.9 and 0.5."
        .into();
    let figures = vec![Figure::Curves { name: "correlation", title, caption, x_label, y_label, curves }];
    Ok(Report { id: "P2", title: EXPERIMENTS[1].title, rows, figures, notes: Vec::new() })
}

/// P3: positions are given on the unrolled sheet.
fn cylinder() -> Result<Report, Error> {
    let mut rig = Rig::new("piezo-cylinder")?;
    let place = [0.02, -0.015];
    let (mut rows, mut panels, mut peaks) = (Vec::new(), Vec::new(), Vec::new());
    for (name, force_n) in [("light", 0.5), ("hard", 2.0)] {
        let frame = rig.mean_frame(&[disc(place, 22.0, force_n)], 3)?;
        let image = rig.image(&frame)?;
        let error = rig.touches(&image)?.first().map_or(f64::NAN, |c| distance_mm(c.centroid_m, place));
        peaks.push(rig.peak(&image).1);
        rows.push(row(format!("{name} touch, {force_n} N: position error"), "mm", None, error, Kind::Algorithm));
        panels.push(rig.panel(format!("{name}, {force_n} N"), &image, &[place]));
    }
    rows.push(row("hard over light, largest pixel", "", None, peaks[1] / peaks[0], Kind::Predicted));
    let places = [[-0.035, 0.01], [0.035, 0.02]];
    let frame = rig.mean_frame(&places.map(|place| disc(place, 22.0, 1.0)), 3)?;
    let image = rig.image(&frame)?;
    let found = rig.touches(&image)?;
    let nearest = |place: Point| found.iter().map(|c| distance_mm(c.centroid_m, place)).fold(f64::INFINITY, f64::min);
    let worst = places.map(nearest).into_iter().fold(0.0, f64::max);
    rows.push(row("two touches: touches found", "", Some(2.0), found.len() as f64, Kind::Algorithm));
    rows.push(row("two touches: worse of the two positions", "mm", None, worst, Kind::Algorithm));
    panels.push(rig.panel("two touches, 1 N each", &image, &places));
    let title = "P3: sheet on a cylinder of 190 mm".into();
    let caption =
        "Images of the twin of the piezoresistive sheet on a cylinder of 190 mm, drawn as it is bent, under a light \
                   touch, a hard touch and two touches of an indenter of 22 mm. Means of three frames."
            .into();
    let figures = vec![Figure::Images { name: "cylinder", title, caption, columns: rig.columns(), panels }];
    let notes = vec!["The paper shows images and gives no numbers.".into()];
    Ok(Report { id: "P3", title: EXPERIMENTS[2].title, rows, figures, notes })
}
