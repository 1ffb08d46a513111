//! Experiments I1 to I10 of the ionic liquid skin (paper I: fringing-field EIT under a latex membrane). Each weight
//! is 6.5 g on a 20 mm disc, which gives the paper's pressures: 64 mN on 314 mm^2 is 0.203 kPa.

mod bench;
mod noise;
mod tapping;

use dermis_tomo::mesh::Point;
use dermis_touch::measure::hysteresis as hysteresis_of;
use dermis_twin::AnyTwin;
use dermis_twin::mechanics::{Indenter, Load, Shape};

use self::bench::{DIAMETER_MM, SKIN, row};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, Kind, Look, Report};
use crate::twin_bench::{Rig, grams_n};
use crate::twin_bench::{disc, distance_mm};
use dermis_skin::{Layer, Skin};

/// All experiments of the paper.
pub(super) const EXPERIMENTS: [Experiment; 11] = [
    Experiment { id: "I1", title: "two to six touches of 0.255 N at equal radius", run: several_touches },
    Experiment { id: "I2", title: "position error at three radii, 1 to 9 weights, 4 repeats", run: positions },
    Experiment { id: "I3", title: "smallest force, 64 and 128 mN at three radii", run: smallest_force },
    Experiment { id: "I4", title: "ring, and a touch inside it, against three references", run: ring },
    Experiment { id: "I5", title: "upright skin, touches north, south, east and west", run: upright },
    Experiment { id: "I6", title: "square skin, 6.5, 13 and 39 g", run: square },
    Experiment { id: "I7", title: "force against the image, three places, three repeats", run: force_curves },
    Experiment { id: "I8", title: "one calibration line for all places", run: one_line },
    Experiment { id: "I9", title: "hysteresis, 1 to 9 weights and back", run: hysteresis },
    tapping::TAPPING,
    noise::NOISE,
];

const WEIGHT_G: f64 = 6.5;
/// Radii of the three places in the paper.
const RADII_MM: [f64; 3] = [0.0, 30.0, 60.0];

fn weights(centre_m: Point, count: usize) -> Indenter {
    disc(centre_m, DIAMETER_MM, grams_n(WEIGHT_G * count as f64))
}

/// `count` places evenly spaced on a circle, the first slightly off the x axis.
fn around(count: usize, radius_mm: f64) -> Vec<[f64; 2]> {
    let angle = |k: usize| 0.3 + std::f64::consts::TAU * k as f64 / count as f64;
    (0..count).map(|k| [1e-3 * radius_mm * angle(k).cos(), 1e-3 * radius_mm * angle(k).sin()]).collect()
}

/// I1: the paper distinguishes two, three and four touches; five and six are added here.
fn several_touches() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let (mut rows, mut panels) = (Vec::new(), Vec::new());
    for count in 2..=6 {
        let places = around(count, 50.0);
        let indenters: Vec<Indenter> = places.iter().map(|&place| disc(place, DIAMETER_MM, 0.255)).collect();
        let frame = rig.mean_frame(&indenters, 10)?;
        let image = rig.image(&frame)?;
        let found = rig.touches(&image)?;
        let nearest =
            |place: &Point| found.iter().map(|c| distance_mm(c.centroid_m, *place)).fold(f64::INFINITY, f64::min);
        let worst = places.iter().map(nearest).fold(0.0, f64::max);
        let paper = (count <= 4).then_some(count as f64);
        rows.push(row(format!("touches found of {count}"), "", paper, found.len() as f64, Kind::Algorithm));
        rows.push(row(format!("worst position of {count}"), "mm", None, worst, Kind::Algorithm));
        panels.push(rig.panel(format!("{count} touches"), &image, &places));
        rig.frames(&[], 20)?;
    }
    let title = "I1: touches of 0.255 N at a radius of 50 mm".into();
    let caption =
        "Images of the ionic disc's twin under two to six discs of 20 mm, each pressed with 0.255 N at 50 mm \
                   from the centre. Each image is of the mean of ten frames against the skin at rest."
            .into();
    let figures = vec![Figure::Images { name: "touches", title, caption, columns: rig.columns(), panels }];
    let notes = vec!["Five and six touches are not in the paper.".into()];
    Ok(Report { id: "I1", title: EXPERIMENTS[0].title, rows, figures, notes })
}

/// I2: error of the peak pixel (as published) and of the fitted touch.
fn positions() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let (mut by_peak, mut by_touch, mut curves, mut missed) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for radius in RADII_MM {
        let mut points = Vec::new();
        for repeat in 0..4 {
            let angle = 0.4 + 1.7 * f64::from(repeat);
            let place = [1e-3 * radius * angle.cos(), 1e-3 * radius * angle.sin()];
            for count in 1..=9 {
                let frame = rig.mean_frame(&[weights(place, count)], 4)?;
                let image = rig.image(&frame)?;
                let peak = distance_mm(rig.peak(&image).0, place);
                let found = rig.touches(&image)?;
                let Some(first) = found.first() else {
                    missed += 1;
                    continue;
                };
                let touch = distance_mm(first.centroid_m, place);
                points.push([count as f64, touch]);
                if count >= 2 {
                    by_peak.push(peak);
                    by_touch.push(touch);
                }
            }
            rig.frames(&[], 30)?;
        }
        curves.push(Curve { name: format!("{radius} mm from the centre"), points, look: Look::Repeats });
    }
    curves.push(Curve {
        name: "paper: largest error".into(),
        points: vec![[1.0, 6.0], [9.0, 6.0]],
        look: Look::PaperLine,
    });
    let most = |errors: &[f64]| errors.iter().copied().fold(0.0, f64::max);
    let mean = |errors: &[f64]| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    let rows = vec![
        row("largest error of the peak pixel, 2 to 9 weights", "mm", Some(6.0), most(&by_peak), Kind::Algorithm),
        row("mean error of the peak pixel", "mm", None, mean(&by_peak), Kind::Algorithm),
        row(
            "largest error of the touch (fitted to the forward model), 2 to 9 weights",
            "mm",
            Some(6.0),
            most(&by_touch),
            Kind::Algorithm,
        ),
        row("mean error of the touch", "mm", None, mean(&by_touch), Kind::Algorithm),
        row("presses without a touch, of 108", "", Some(0.0), f64::from(missed), Kind::Algorithm),
    ];
    let (x_label, y_label) = ("weights of 6.5 g", "error of the touch (mm)");
    let title = "I2: position error".into();
    let caption =
        "Distance from the place of a disc of 20 mm to the touch that is found, against the number of weights \
                   of 6.5 g on it, at three distances from the centre of the ionic disc's twin; four repeats at \
                   other angles, each of the mean of four frames. The paper gives 6 mm as its largest error from \
                   two weights on."
            .into();
    let figures = vec![Figure::Curves { name: "errors", title, caption, x_label, y_label, curves }];
    Ok(Report { id: "I2", title: EXPERIMENTS[1].title, rows, figures, notes: Vec::new() })
}

/// I3: the smallest weights relative to the image's noise.
fn smallest_force() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let (mut rows, mut panels) = (Vec::new(), Vec::new());
    for (count, name) in [(1, "64 mN"), (2, "128 mN")] {
        for radius in RADII_MM {
            let place = [1e-3 * radius, 0.0];
            let frame = rig.mean_frame(&[weights(place, count)], 1)?;
            let image = rig.image(&frame)?;
            let found = rig.touches(&image)?;
            let significance = found.first().map_or(0.0, |contact| contact.significance);
            rows.push(row(
                format!("{name} at {radius} mm: peak over noise, one frame"),
                "",
                None,
                significance,
                Kind::Predicted,
            ));
            panels.push(rig.panel(format!("{name}, {radius} mm"), &image, &[place]));
            rig.frames(&[], 30)?;
        }
    }
    let title = "I3: smallest forces, one frame each".into();
    let caption =
        "Images of single frames of the ionic disc's twin under one and two weights of 6.5 g (64 and 128 mN) on \
                   a disc of 20 mm, in the centre and at 30 and 60 mm from it."
            .into();
    let figures = vec![Figure::Images { name: "smallest", title, caption, columns: rig.columns(), panels }];
    let notes = vec!["The paper shows both forces at all three places; 5 is where a touch begins.".into()];
    Ok(Report { id: "I3", title: EXPERIMENTS[2].title, rows, figures, notes })
}

/// I4: an annular load, closed and with a hole, and a touch inside it, measured against rest, the unloaded ring and
/// the loaded ring.
fn ring() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let shape = Shape::Ring { inner_m: 35e-3, outer_m: 45e-3 };
    let loaded = |force_n: f64| Indenter { centre_m: [0.0; 2], shape, load: Load::ForceN(force_n) };
    let inside = [6e-3, -4e-3];
    let touch = weights(inside, 6);
    let (mut rows, mut panels) = (Vec::new(), Vec::new());

    let frame = rig.mean_frame(&[loaded(2.0)], 10)?;
    let image = rig.image(&frame)?;
    let on_ring: Vec<f64> = around(24, 40.0).iter().map(|&place| rig.mean_around(&image, place)).collect();
    let (mean, least) = (on_ring.iter().sum::<f64>() / 24.0, on_ring.iter().copied().fold(f64::INFINITY, f64::min));
    let hole = rig.mean_around(&image, [0.0; 2]);
    rows.push(row("ring: weakest place over its mean", "", None, least / mean, Kind::Algorithm));
    rows.push(row("ring: hole over its mean", "", None, hole / mean, Kind::Algorithm));
    panels.push(rig.panel("ring, from rest", &image, &[]));

    let references = [("rest", None), ("the light ring", Some(0.1)), ("the pressed ring", Some(2.0))];
    for (name, reference) in references {
        let load: Vec<Indenter> = reference.map(loaded).into_iter().collect();
        rig.tare(&load)?;
        let frame = rig.mean_frame(&[loaded(2.0), touch], 10)?;
        let image = rig.image(&frame)?;
        let error =
            rig.touches(&image)?.iter().map(|c| distance_mm(c.centroid_m, inside)).fold(f64::INFINITY, f64::min);
        rows.push(row(format!("touch inside, from {name}: nearest contact"), "mm", None, error, Kind::Algorithm));
        panels.push(rig.panel(format!("ring and touch, from {name}"), &image, &[inside]));
        rig.frames(&[], 30)?;
    }
    let title = "I4: ring of 80 mm, 2 N, and a touch of 0.38 N inside".into();
    let caption =
        "A ring from 35 to 45 mm in radius presses the ionic disc's twin with 2 N; inside it a disc of 20 mm \
                   presses with 0.38 N. The reference that the images are taken against is the skin at rest, the ring \
                   under 0.1 N, and the ring under 2 N. Means of ten frames."
            .into();
    let figures = vec![Figure::Images { name: "ring", title, caption, columns: rig.columns(), panels }];
    Ok(Report { id: "I4", title: EXPERIMENTS[3].title, rows, figures, notes: Vec::new() })
}

/// I5: the skin stands upright, +y up. The liquid's weight bulges its lower half; the baseline includes this.
fn upright() -> Result<Report, Error> {
    let skin = Skin::open(SKIN)?;
    let mut standing = skin.clone();
    if let Layer::Liquid(layer) = &mut standing.frontend.layer {
        layer.gravity_m_per_s2 = [0.0, -9.806_65, 0.0];
    }
    let (frontend, instrument, _) = AnyTwin::from_skin(&standing)?.into_parts();
    let mut rig = Rig::from_parts(skin, frontend, instrument)?;
    let (mut rows, mut panels) = (Vec::new(), Vec::new());
    for (name, place) in [("N", [0.0, 0.05]), ("S", [0.0, -0.05]), ("E", [0.05, 0.0]), ("W", [-0.05, 0.0])] {
        let frame = rig.mean_frame(&[weights(place, 4)], 10)?;
        let image = rig.image(&frame)?;
        let found = rig.touches(&image)?;
        let error = found.first().map_or(f64::NAN, |contact| distance_mm(contact.centroid_m, place));
        rows.push(row(format!("{name}: position error"), "mm", None, error, Kind::Algorithm));
        panels.push(rig.panel(name, &image, &[place]));
        rig.frames(&[], 30)?;
    }
    let title = "I5: upright, touches of 0.255 N at 50 mm".into();
    let caption =
        "The ionic disc's twin stands upright, so that its liquid bulges the lower half, and is pressed at 50 mm \
                   above, below, right and left of the centre. Means of ten frames against the standing skin at rest."
            .into();
    let figures = vec![Figure::Images { name: "upright", title, caption, columns: rig.columns(), panels }];
    Ok(Report { id: "I5", title: EXPERIMENTS[4].title, rows, figures, notes: Vec::new() })
}

/// I6: the larger square skin under the same weights.
fn square() -> Result<Report, Error> {
    let mut rig = Rig::new("ionic-square")?;
    let place = [25e-3, 15e-3];
    let (mut rows, mut panels, mut points) = (Vec::new(), Vec::new(), Vec::new());
    for grams in [6.5, 13.0, 39.0] {
        let frame = rig.mean_frame(&[disc(place, DIAMETER_MM, grams_n(grams))], 10)?;
        let image = rig.image(&frame)?;
        let found = rig.touches(&image)?;
        let error = found.first().map_or(f64::NAN, |contact| distance_mm(contact.centroid_m, place));
        points.push([1e3 * grams_n(grams), rig.peak(&image).1]);
        rows.push(row(format!("{grams} g: position error"), "mm", None, error, Kind::Algorithm));
        panels.push(rig.panel(format!("{grams} g"), &image, &[place]));
        rig.frames(&[], 30)?;
    }
    let rising = points.windows(2).all(|pair| pair[1][1] > pair[0][1]);
    rows.push(row("peak rises with the weight (1: yes)", "", Some(1.0), f64::from(u8::from(rising)), Kind::Predicted));
    let title = "I6: square skin of 212 mm".into();
    let caption =
        "Images of the square ionic skin's twin under 6.5, 13 and 39 g on a disc of 20 mm. Means of ten frames.".into();
    let figures = vec![Figure::Images { name: "square", title, caption, columns: rig.columns(), panels }];
    Ok(Report { id: "I6", title: EXPERIMENTS[5].title, rows, figures, notes: Vec::new() })
}

/// Force in newtons and, for each of three repeats, peak and mean of nine pixels, at one radius.
fn force_curve(rig: &mut Rig, radius_mm: f64) -> Result<Vec<[f64; 3]>, Error> {
    let place = [1e-3 * radius_mm, 0.0];
    let mut points = Vec::new();
    for _ in 0..3 {
        for count in 1..=9 {
            let frame = rig.mean_frame(&[weights(place, count)], 10)?;
            let image = rig.image(&frame)?;
            points.push([grams_n(WEIGHT_G * count as f64), rig.peak(&image).1, rig.mean_around(&image, place)]);
        }
        rig.frames(&[], 60)?;
    }
    Ok(points)
}

/// Slope through the origin, and the share of variance explained by the straight line (with offset).
fn straight(points: &[[f64; 2]]) -> (f64, f64) {
    let count = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|p| p[axis]).sum::<f64>() / count;
    let (mx, my) = (mean(0), mean(1));
    let sum = |f: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(f).sum::<f64>();
    let (xx, xy) = (sum(&|p| (p[0] - mx).powi(2)), sum(&|p| (p[0] - mx) * (p[1] - my)));
    let yy = sum(&|p| (p[1] - my).powi(2));
    (sum(&|p| p[0] * p[1]) / sum(&|p| p[0] * p[0]), xy * xy / (xx * yy))
}

/// I7: nearly linear at all three places.
fn force_curves() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for radius in RADII_MM {
        let points = force_curve(&mut rig, radius)?;
        let by_peak: Vec<[f64; 2]> = points.iter().map(|p| [p[0], p[1]]).collect();
        let by_mean: Vec<[f64; 2]> = points.iter().map(|p| [p[0], p[2]]).collect();
        rows.push(row(format!("{radius} mm: R^2 of the line, peak"), "", None, straight(&by_peak).1, Kind::Predicted));
        rows.push(row(format!("{radius} mm: R^2 of the line, 9 px"), "", None, straight(&by_mean).1, Kind::Predicted));
        rows.push(row(format!("{radius} mm: slope, 9 px"), "1/N", None, straight(&by_mean).0, Kind::Predicted));
        curves.push(Curve { name: format!("{radius} mm from the centre"), points: by_mean, look: Look::Repeats });
    }
    let (x_label, y_label) = ("force (N)", "mean of 9 pixels (relative change)");
    let title = "I7: force curves".into();
    let caption =
        "Mean of the nine pixels at the place of a disc of 20 mm against its force, at three distances from the \
                   centre of the ionic disc's twin; three repeats of one to nine weights of 6.5 g."
            .into();
    let figures = vec![Figure::Curves { name: "force", title, caption, x_label, y_label, curves }];
    let notes = vec!["The paper shows near linear curves without giving their slopes.".into()];
    Ok(Report { id: "I7", title: EXPERIMENTS[6].title, rows, figures, notes })
}

/// I8: dividing by the slope at the touch's radius, interpolated between the three places, collapses all curves onto
/// one line.
fn one_line() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let mut curves: Vec<Vec<[f64; 2]>> = Vec::new();
    for radius in RADII_MM {
        curves.push(force_curve(&mut rig, radius)?.iter().map(|p| [p[0], p[2]]).collect());
    }
    let slopes: Vec<f64> = curves.iter().map(|curve| straight(curve).0).collect();
    let mean = slopes.iter().sum::<f64>() / slopes.len() as f64;
    // Radii between the calibrated places, where nothing was fitted.
    let slope_at = |radius: f64| {
        let k = usize::from(radius > RADII_MM[1]);
        let share = (radius - RADII_MM[k]) / (RADII_MM[k + 1] - RADII_MM[k]);
        slopes[k] + share * (slopes[k + 1] - slopes[k])
    };
    let (mut errors, mut points) = (Vec::new(), Vec::new());
    for radius in [15.0, 45.0] {
        for [force, value] in force_curve(&mut rig, radius)?.iter().map(|p| [p[0], p[2]]) {
            errors.push(value / slope_at(radius) - force);
            points.push([force, value / slope_at(radius)]);
        }
    }
    let full_scale = grams_n(9.0 * WEIGHT_G);
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let rows = vec![
        row(
            "rms error of force at radii not calibrated",
            "% of full scale",
            None,
            100.0 * rms / full_scale,
            Kind::Algorithm,
        ),
        row("largest slope over the smallest before compensation", "", None, ratio(&slopes), Kind::Predicted),
        row("mean slope", "1/N", None, mean, Kind::Predicted),
    ];
    let ideal = Curve { name: "equal".into(), points: vec![[0.0; 2], [full_scale; 2]], look: Look::Line };
    let curves = vec![ideal, Curve { name: "15 and 45 mm from the centre".into(), points, look: Look::Repeats }];
    let (x_label, y_label) = ("force (N)", "force by the one line (N)");
    let title = "I8: location compensated".into();
    let caption = "Force that the image gives against the force that presses, at two distances from the centre of the \
                   ionic disc's twin that were not calibrated: the slope there is interpolated between those at 0, 30 \
                   and 60 mm. One to nine weights of 6.5 g, three repeats at each distance."
        .into();
    let figures = vec![Figure::Curves { name: "one-line", title, caption, x_label, y_label, curves }];
    Ok(Report { id: "I8", title: EXPERIMENTS[7].title, rows, figures, notes: Vec::new() })
}

fn ratio(values: &[f64]) -> f64 {
    let (low, high) = values.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
    high / low
}

/// I9: loading and unloading at the centre.
fn hysteresis() -> Result<Report, Error> {
    let mut rig = Rig::new(SKIN)?;
    let (mut up, mut down) = (Vec::new(), Vec::new());
    let counts = (1..=9).map(|count| (count, true)).chain((1..=8).rev().map(|count| (count, false)));
    for (count, rises) in counts {
        let frame = rig.mean_frame(&[weights([0.0; 2], count)], 10)?;
        let image = rig.image(&frame)?;
        let point = [grams_n(WEIGHT_G * count as f64), rig.peak(&image).1];
        if rises { up.push(point) } else { down.push(point) }
    }
    // Both branches share the top.
    down.insert(0, up[up.len() - 1]);
    let pairs = |points: &[[f64; 2]]| points.iter().map(|p| (p[0], p[1])).collect::<Vec<_>>();
    let loop_share = hysteresis_of(&pairs(&up), &pairs(&down))?.area_fraction.abs();
    let rows = vec![row("area of the loop", "% of full scale", None, 100.0 * loop_share, Kind::Predicted)];
    let curves = vec![
        Curve { name: "loading".into(), points: up, look: Look::Line },
        Curve { name: "unloading".into(), points: down, look: Look::Line },
    ];
    let (x_label, y_label) = ("force (N)", "peak of the image (relative change)");
    let title = "I9: hysteresis".into();
    let caption =
        "Peak of the image against force while weights of 6.5 g are put in the centre of the ionic disc's twin \
                   one by one and taken off again. Means of ten frames."
            .into();
    let figures = vec![Figure::Curves { name: "loop", title, caption, x_label, y_label, curves }];
    let notes = vec!["The paper calls its loop small and gives no number; the memory's size is an assumption.".into()];
    Ok(Report { id: "I9", title: EXPERIMENTS[8].title, rows, figures, notes })
}
