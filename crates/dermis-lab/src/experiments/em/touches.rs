//! Position: single touches, neighbours, several touches, the two kinds of coils, a line and a ring.

use dermis_touch::measure::pearson;
use dermis_twin::mechanics::Indenter;

use super::array::{Bench, CIRCULAR, EIGHT, SQUARE, row, solve_name};
use crate::Error;
use crate::report::{Experiment, Figure, Kind, Report, Row};
use crate::twin_bench::distance_mm;
use dermis_live::magnetic_model::{ELEMENT_WIDTH, MagneticModel};
use dermis_skin::Solve;

pub(super) const SINGLE: Experiment =
    Experiment { id: "E1", title: "single touch at every element, eight and sixteen coils", run: single };

/// E1: presses every element and takes one frame after the mechanics have settled; with eight coils also 100 frames
/// each.
fn single() -> Result<Report, Error> {
    let (mut rows, mut figures) = (Vec::new(), Vec::new());
    for (array, solve, frames) in [
        (EIGHT, Solve::Pixels, 100),
        (EIGHT, Solve::LiftOff, 4),
        (CIRCULAR, Solve::LiftOff, 1),
        (SQUARE, Solve::LiftOff, 1),
    ] {
        let mut bench = array.bench(solve)?;
        let (mut right, mut alone, mut total, mut distance) = (0, 0, 0, 0.0);
        let mut panels = Vec::new();
        for element in 0..bench.places.len() {
            let settled = bench.settled(&[element], 1)?;
            let indenter = [bench.press(element, bench.press_n)];
            let more = bench.rig.frames(&indenter, frames - 1)?;
            for (k, frame) in std::iter::once(&settled).chain(&more).enumerate() {
                let (image, found) = bench.finds(frame, &[element])?;
                let peak = bench.rig.peak(&image).0;
                right += usize::from(bench.nearest(peak) == element);
                alone += usize::from(found);
                distance += distance_mm(peak, bench.places[element]);
                total += 1;
                if k == 0 && panels.len() < 4 && element % 6 == 0 {
                    panels.push(bench.rig.panel(format!("element {}", element + 1), &image, &bench.at(&[element])));
                }
            }
        }
        let name = format!("{}, {}", array.name, solve_name(solve));
        let share = |count: usize| count as f64 / f64::from(total);
        rows.push(row(format!("{name}: frames"), "", None, f64::from(total), Kind::Algorithm));
        rows.push(row(
            format!("{name}: share whose peak is at the element"),
            "",
            Some(1.0),
            share(right),
            Kind::Algorithm,
        ));
        rows.push(row(format!("{name}: share with one touch, there"), "", None, share(alone), Kind::Algorithm));
        let mean = distance / f64::from(total);
        rows.push(row(format!("{name}: distance of the peak, mean"), "mm", None, mean, Kind::Algorithm));
        let (title, columns) = (format!("E1: {name}, {} N on one element", array.press_n), bench.rig.columns());
        let file = match (array.skin, solve) {
            ("em-8", Solve::Pixels) => "single-8",
            ("em-8", Solve::LiftOff) => "single-8-heights",
            ("em-16-circular", _) => "single-16-circular",
            _ => "single-16-square",
        };
        let caption = format!(
            "Images of the EM-skin's twin ({name}), one frame each, with {} N on one element at a time; four of {} \
            elements.",
            array.press_n, array.elements
        );
        figures.push(Figure::Images { name: file, title, caption, columns, panels });
    }
    rows.extend(jacobians()?);
    let notes = vec!["The paper shows images, and states that all elements are located.".into()];
    Ok(Report { id: SINGLE.id, title: SINGLE.title, rows, figures, notes })
}

/// Compares the Jacobian of the images with one measured as published, by poking each element once: the correlation
/// over channels for each element.
fn jacobians() -> Result<Vec<Row>, Error> {
    let mut bench = EIGHT.bench(Solve::Pixels)?;
    let pitch_m = MagneticModel::of(&bench.rig.prepared().skin)?.elements.pitch_m();
    let mut alike = Vec::new();
    for element in 0..bench.places.len() {
        let frame = bench.settled(&[element], 10)?;
        let measured = bench.rig.reference().difference(&frame, None);
        let prepared = bench.rig.prepared();
        let [x, y] = bench.places[element];
        let weight =
            |p: &[f64; 3]| (-0.5 * ((p[0] - x).powi(2) + (p[1] - y).powi(2)) / (ELEMENT_WIDTH * pitch_m).powi(2)).exp();
        let weights: Vec<f64> = prepared.basis.positions.iter().map(weight).collect();
        let reading = |channel| prepared.jacobian.row(channel).iter().zip(&weights).map(|(j, w)| j * w).sum();
        let modelled: Vec<f64> = (0..prepared.channels()).map(reading).collect();
        alike.push(pearson(&measured, &modelled)?);
    }
    alike.sort_by(f64::total_cmp);
    let quantity = |which: &str| format!("8 coils: model's against measured Jacobian, correlation, {which} of 25");
    Ok(vec![
        row(quantity("median"), "", None, alike[alike.len() / 2], Kind::Predicted),
        row(quantity("least"), "", None, alike[0], Kind::Predicted),
    ])
}

pub(super) const ADJACENT: Experiment = Experiment { id: "E2", title: "two adjacent elements", run: adjacent };

/// E2: every pair of adjacent elements in a row.
fn adjacent() -> Result<Report, Error> {
    let (mut rows, mut figures) = (Vec::new(), Vec::new());
    for (array, solve) in
        [(EIGHT, Solve::Pixels), (EIGHT, Solve::LiftOff), (CIRCULAR, Solve::LiftOff), (SQUARE, Solve::LiftOff)]
    {
        let mut bench = array.bench(solve)?;
        let pairs: Vec<[usize; 2]> =
            (0..bench.places.len()).filter(|k| (k + 1) % bench.per_side != 0).map(|k| [k, k + 1]).collect();
        let name = format!("{}, {}", array.name, solve_name(solve));
        let (apart, panels) = told_apart(&mut bench, &pairs)?;
        rows.push(row(
            format!("{name}: pairs resolved of {}", pairs.len()),
            "",
            Some(pairs.len() as f64),
            apart,
            Kind::Algorithm,
        ));
        if array.skin == "em-8" {
            let file = if solve == Solve::Pixels { "pairs" } else { "pairs-heights" };
            let title = format!("E2: {name}, neighbours");
            let caption = format!(
                "Images of the EM-skin's twin ({name}), one frame each, with two neighbouring elements pressed."
            );
            figures.push(Figure::Images { name: file, title, caption, columns: bench.rig.columns(), panels });
        }
    }
    let notes = vec![
        "The paper shows one pair. In the linear image neighbours are one blob.".into(),
        "Single frames of the eight coils, means of ten of the sixteen.".into(),
    ];
    Ok(Report { id: ADJACENT.id, title: ADJACENT.title, rows, figures, notes })
}

/// Number of groups in which every element has exactly one touch and no other appears, with images of the first four.
fn told_apart<const N: usize>(
    bench: &mut Bench,
    groups: &[[usize; N]],
) -> Result<(f64, Vec<crate::experiments::ImagePanel>), Error> {
    let (mut apart, mut panels) = (0, Vec::new());
    for group in groups {
        let frame = bench.settled(group, bench.frames)?;
        let (image, found) = bench.finds(&frame, group)?;
        apart += usize::from(found);
        if panels.len() < 4 {
            let numbers: Vec<String> = group.iter().map(|k| (k + 1).to_string()).collect();
            panels.push(bench.rig.panel(numbers.join(", "), &image, &bench.at(group)));
        }
    }
    Ok((apart as f64, panels))
}

pub(super) const SEVERAL: Experiment = Experiment { id: "E3", title: "three and four touches", run: several };

/// E3: groups of three and four, close together and far apart.
fn several() -> Result<Report, Error> {
    let (mut rows, mut figures) = (Vec::new(), Vec::new());
    for (array, file) in [(EIGHT, "several-8"), (CIRCULAR, "several-16")] {
        let mut bench = array.bench(Solve::LiftOff)?;
        let n = bench.per_side;
        let at = |column: usize, line: usize| line * n + column;
        let last = n - 1;
        let threes = [
            [at(0, 0), at(last, 0), at(n / 2, last)],
            [at(1, 1), at(3, 1), at(2, 3)],
            [at(0, 1), at(1, 1), at(3, 3)],
            [at(1, 1), at(2, 1), at(1, 2)],
        ];
        let fours = [
            [at(0, 0), at(last, 0), at(0, last), at(last, last)],
            [at(1, 1), at(3, 1), at(1, 3), at(3, 3)],
            [at(1, 0), at(2, 2), at(0, 3), at(3, 4)],
            [at(1, 1), at(2, 1), at(1, 2), at(2, 2)],
        ];
        let (three, mut panels) = told_apart(&mut bench, &threes)?;
        let (four, more) = told_apart(&mut bench, &fours)?;
        panels.extend(more);
        rows.push(row(
            format!("{}: sets of three fully found, of 4", array.name),
            "",
            Some(4.0),
            three,
            Kind::Algorithm,
        ));
        rows.push(row(format!("{}: sets of four fully found, of 4", array.name), "", Some(4.0), four, Kind::Algorithm));
        rows.push(travel_error(&mut bench, array.name, &fours)?);
        let title = format!("E3: {}, three and four touches", array.name);
        let caption = format!(
            "Images of heights of the EM-skin's twin with {} coils, three and four elements pressed at once, near \
             each other and far apart; the names are the elements' numbers.",
            array.name.replace(" coils", "")
        );
        figures.push(Figure::Images { name: file, title, caption, columns: bench.rig.columns(), panels });
    }
    let notes = vec![
        "The last group of each four consists of adjacent elements.".into(),
        "Single frames of the eight coils, means of ten of the sixteen. Travels are those of the mean of ten \
        frames, compared with the twin's mechanics."
            .into(),
    ];
    Ok(Report { id: SEVERAL.id, title: SEVERAL.title, rows, figures, notes })
}

/// Largest error of any element's travel when four are pressed half as hard, from the mean of ten frames.
fn travel_error(bench: &mut Bench, name: &str, groups: &[[usize; 4]]) -> Result<Row, Error> {
    let skin = bench.rig.prepared().skin.clone();
    let options = dermis_twin::from_skin::element_options(&skin)?;
    let mut truth = dermis_twin::mechanics::SpringGrid::new(options.springs, options.places_m, options.cell_m)?;
    let mut worst: f64 = 0.0;
    for group in groups {
        bench.rig.frames(&[], 10)?;
        let indenters: Vec<Indenter> = group.iter().map(|k| bench.press(*k, 0.5 * bench.press_n)).collect();
        bench.rig.frames(&indenters, 40)?;
        let frame = bench.rig.mean_frame(&indenters, 10)?;
        bench.rig.image(&frame)?;
        let (mut forces, mut travel) = (vec![0.0; bench.places.len()], vec![0.0; bench.places.len()]);
        truth.forces_n(&indenters, &mut forces);
        truth.travel_m(&forces, &mut travel);
        if let Some(fit) = bench.rig.heights() {
            worst = fit.travel_m.iter().zip(&travel).map(|(a, b)| (a - b).abs()).fold(worst, f64::max);
        }
    }
    Ok(row(format!("{name}: travel of any element, largest error in fours"), "mm", None, 1e3 * worst, Kind::Algorithm))
}

pub(super) const COILS: Experiment = Experiment { id: "E4", title: "circular against square coils", run: coils };

/// E4: the width of one element in the linear image, made for both arrays with the same prior and noise.
fn coils() -> Result<Report, Error> {
    let (mut rows, mut figures) = (Vec::new(), Vec::new());
    for (array, file) in [(CIRCULAR, "circular"), (SQUARE, "square")] {
        let mut bench = array.bench(Solve::Pixels)?;
        let (mut widths, mut panels, mut right) = (Vec::new(), Vec::new(), 0);
        for element in 0..bench.places.len() {
            bench.rig.frames(&[], 4)?;
            let indenters = [bench.press(element, bench.press_n)];
            bench.rig.frames(&indenters, 3)?;
            let frame = bench.rig.mean_frame(&indenters, 16)?;
            let image = bench.rig.image(&frame)?;
            right += usize::from(bench.nearest(bench.rig.peak(&image).0) == element);
            widths.push(bench.rig.spread_mm(&image, bench.places[element]));
            if [9, 28, 36, 54].contains(&element) {
                panels.push(bench.rig.panel(format!("element {}", element + 1), &image, &bench.at(&[element])));
            }
        }
        widths.sort_by(f64::total_cmp);
        let median = widths[widths.len() / 2];
        let mean = widths.iter().sum::<f64>() / widths.len() as f64;
        rows.push(row(
            format!("{}: spread of an element in the image, median", array.name),
            "mm",
            None,
            median,
            Kind::Predicted,
        ));
        rows.push(row(format!("{}: the same, mean", array.name), "mm", None, mean, Kind::Predicted));
        rows.push(row(
            format!("{}: peaks at the element, of {}", array.name, array.elements),
            "",
            None,
            right as f64,
            Kind::Algorithm,
        ));
        let title = format!("E4: {} coils", array.name);
        let caption = format!(
            "Linear images of the EM-skin's twin with {} coils, one element pressed; means of 16 frames.",
            array.name
        );
        figures.push(Figure::Images { name: file, title, caption, columns: bench.rig.columns(), panels });
    }
    let notes = vec![
        "Spread: root mean square distance from the element, weighted with the image squared; means of 16 frames. \
        The paper finds square coils sharper."
            .into(),
    ];
    Ok(Report { id: COILS.id, title: COILS.title, rows, figures, notes })
}

pub(super) const SHAPES: Experiment = Experiment { id: "E5", title: "a line and a ring", run: shapes };

/// E5: the middle row, and the eight elements around the centre.
fn shapes() -> Result<Report, Error> {
    let (mut rows, mut panels, mut columns) = (Vec::new(), Vec::new(), 0);
    let line: Vec<usize> = (10..15).collect();
    let ring = vec![6, 7, 8, 11, 13, 16, 17, 18];
    for solve in [Solve::Pixels, Solve::LiftOff] {
        let mut bench = EIGHT.bench(solve)?;
        columns = bench.rig.columns();
        for (name, shape) in [("line", &line), ("ring", &ring)] {
            let frame = bench.settled(shape, 1)?;
            let image = bench.rig.image(&frame)?;
            let found: Vec<f64> = bench.places.iter().map(|place| bench.rig.mean_around(&image, *place)).collect();
            let truth: Vec<f64> = (0..bench.places.len()).map(|k| f64::from(u8::from(shape.contains(&k)))).collect();
            let title = format!("{name}, {}", solve_name(solve));
            rows.push(row(
                format!("{title}: correlation of the 25 elements with the truth"),
                "",
                None,
                pearson(&found, &truth)?,
                Kind::Algorithm,
            ));
            panels.push(bench.rig.panel(title, &image, &bench.at(shape)));
        }
    }
    let figures = vec![Figure::Images {
        name: "shapes",
        title: "E5: a line and a ring, 2 N on each element".into(),
        caption:
            "Images of the EM-skin's twin with eight coils, the five elements of the middle row pressed and the eight \
                  around the middle, by the linear image and by the fit of heights; single frames."
                .into(),
        columns,
        panels,
    }];
    let notes = vec!["The paper shows both as images of its eight coils.".into()];
    Ok(Report { id: SHAPES.id, title: SHAPES.title, rows, figures, notes })
}
