//! H4 to H6: the skin is cut, pressed next to and on the cut, and healed, followed by the live pipeline.

use dermis_tomo::mesh::Point;
use dermis_touch::Touch;
use dermis_touch::damage::{DamageEvent, DamageState};

use super::bench::{mean, row};
use super::live::Line;
use crate::Error;
use crate::report::Row;
use crate::report::{Curve, Experiment, Figure, ImagePanel, Kind, Look, Report};
use crate::twin_bench::{distance_mm, panel_of};
use dermis_skin::TwinAction;

/// A 20 mm cut in the first quadrant.
const FROM_MM: Point = [15.0, 18.0];
const TO_MM: Point = [31.0, 30.0];
const MIDDLE_MM: Point = [23.0, 24.0];
/// Places next to the cut.
const BESIDE_MM: [[f64; 2]; 6] = [[-25.0, 0.0], [0.0, -25.0], [-20.0, -20.0], [25.0, -15.0], [-12.0, 28.0], [0.0, 0.0]];
/// How long a press is held before it is read, and how long the skin then rests, seconds.
const HELD_S: f64 = 0.8;
/// Time for a damage to be confirmed, seconds.
const BELIEF_S: f64 = 4.0;
/// Hours to follow after heat is applied, one per step.
const STEPS: u32 = 60;
/// Speed-up of healing while frames keep their pace.
const LAPSE: f64 = 1200.0;

fn cut(line: &mut Line) -> Result<(), Error> {
    line.treat(TwinAction::Cut { from_mm: FROM_MM, to_mm: TO_MM })?;
    line.run(BELIEF_S)
}

/// Distance to the nearest touch, millimetres; infinite without touches.
fn error_mm(touches: &[Touch], place_mm: Point) -> f64 {
    let place = place_mm.map(|v| 1e-3 * v);
    touches.iter().map(|touch| distance_mm(touch.position_m, place)).fold(f64::INFINITY, f64::min)
}

fn panel(line: &Line, name: &str, values: &[f32], places_mm: &[Point]) -> ImagePanel {
    let places: Vec<Point> = places_mm.iter().map(|place| place.map(|v| 1e-3 * v)).collect();
    panel_of(line.pipeline.prepared(), name, values, &places)
}

fn images(line: &Line, name: &'static str, [title, caption]: [&str; 2], panels: Vec<ImagePanel>) -> Figure {
    let columns = line.pipeline.prepared().map.grid().columns;
    Figure::Images { name, title: title.into(), caption: caption.into(), columns, panels }
}

/// Mean error of touches next to the cut, and the number of presses that gave no touch or several.
fn beside(line: &mut Line) -> Result<(f64, usize), Error> {
    let (mut errors, mut odd) = (Vec::new(), 0);
    for place in BESIDE_MM {
        let touches = line.touched(place, HELD_S)?;
        odd += usize::from(touches.len() != 1);
        let error = error_mm(&touches, place);
        if error.is_finite() {
            errors.push(error);
        }
    }
    Ok((mean(errors), odd))
}

pub(super) const CUT_AND_TOUCHES: Experiment =
    Experiment { id: "H4", title: "a cut of 20 mm, and touches next to it", run: cut_and_touches };

/// H4: a cut is found, and touches next to it are placed as before.
fn cut_and_touches() -> Result<Report, Error> {
    let mut line = Line::new()?;
    let (intact_mm, intact_odd) = beside(&mut line)?;
    cut(&mut line)?;
    let mut panels = vec![panel(&line, "cut, against the intact skin", &line.damage_image, &[FROM_MM, TO_MM])];
    let found = line.open();
    let (cut_mm, cut_odd) = beside(&mut line)?;
    line.press(BESIDE_MM[0])?;
    line.run(HELD_S)?;
    panels.push(panel(&line, "touch next to it, against the cut skin", &line.image, &BESIDE_MM[..1]));
    let begun = line.events.iter().find_map(|event| match event {
        DamageEvent::Begin(damage) => Some((damage.confirmed_ns - damage.since_ns) as f64 * 1e-9),
        _ => None,
    });
    let direction = (TO_MM[1] - FROM_MM[1]).atan2(TO_MM[0] - FROM_MM[0]);
    let mut rows = vec![row("damage sites found, of one", "", Some(1.0), found.len() as f64, Kind::Algorithm)];
    if let Some(damage) = found.first() {
        let shape = &damage.shape;
        let turned = (shape.direction_rad - direction).to_degrees();
        rows.extend([
            row(
                "cut: error of its centre",
                "mm",
                None,
                distance_mm(shape.centre_m, MIDDLE_MM.map(|v| 1e-3 * v)),
                Kind::Algorithm,
            ),
            row("cut: length", "mm", Some(20.0), 1e3 * shape.length_m, Kind::Algorithm),
            row("cut: error of its direction", "deg", None, (turned + 90.0).rem_euclid(180.0) - 90.0, Kind::Algorithm),
            row("cut: time from detection to confirmation", "s", None, begun.unwrap_or(f64::NAN), Kind::Algorithm),
        ]);
    }
    rows.extend([
        row("mean error of six touches, intact", "mm", None, intact_mm, Kind::Algorithm),
        row("mean error of the same, cut", "mm", None, cut_mm, Kind::Algorithm),
        row("touches missed or split, intact", "", Some(0.0), intact_odd as f64, Kind::Algorithm),
        row("touches missed or split, cut", "", Some(0.0), cut_odd as f64, Kind::Algorithm),
    ]);
    let words = [
        "H4: a cut of 20 mm, and a touch while it is there",
        "Images of the self-healing sandwich's twin with a cut of 20 mm, whose ends the crosses mark: against the \
         intact skin, and of a disc of 20 mm pressed at 80 kPa beside it, against the cut skin.",
    ];
    let figures = vec![images(&line, "cut", words, panels)];
    let notes = vec!["The length is the paper's, which shows place and shape but gives no numbers.".into()];
    Ok(Report { id: CUT_AND_TOUCHES.id, title: CUT_AND_TOUCHES.title, rows, figures, notes })
}

pub(super) const HEALING: Experiment =
    Experiment { id: "H5", title: "healing: heat, two days, a new baseline", run: healing };

/// H5: heated, left alone for 48 h, then given a new baseline.
fn healing() -> Result<Report, Error> {
    let mut line = Line::new()?;
    let intact = line.touched(MIDDLE_MM, HELD_S)?;
    cut(&mut line)?;
    let mut panels = vec![panel(&line, "cut", &line.damage_image, &[FROM_MM, TO_MM])];
    line.frame_s = 0.25;
    line.treat(TwinAction::TimeLapse(LAPSE))?;
    line.treat(TwinAction::Heal { at_mm: MIDDLE_MM, radius_mm: 20.0, temperature_c: 90.0, hours: 2.0 })?;
    let (mut truth, mut seen) = (Vec::new(), Vec::new());
    let mut worst = 0.0_f64;
    for step in 1..=STEPS {
        line.run(3.0)?;
        let hours = f64::from(step) * 3.0 * LAPSE / 3600.0;
        let healed = line.wounds().first().map_or(f64::NAN, |wound| wound.healed);
        let share = line.pipeline.damage().healing.first().map_or(f64::NAN, |state| state.joined.min(1.0));
        truth.push([hours, healed]);
        seen.push([hours, share]);
        if share.is_finite() {
            worst = worst.max((healed - share).abs());
        }
    }
    line.treat(TwinAction::TimeLapse(0.0))?;
    let state = line.pipeline.damage().damages.first().map(|damage| damage.state);
    panels.push(panel(&line, "healed, against the intact skin", &line.damage_image, &[FROM_MM, TO_MM]));
    line.run(35.0)?;
    let proposed = line.pipeline.damage().proposal.is_some();
    line.frame_s = 0.04;
    let old = line.touched(MIDDLE_MM, HELD_S)?;
    line.pipeline.tare(true, "after healing")?;
    // The scarred sheet becomes the model three seconds after the baseline.
    line.run(5.0)?;
    line.press(MIDDLE_MM)?;
    line.run(HELD_S)?;
    let new = line.touches.clone();
    panels.push(panel(&line, "pressed there, new baseline", &line.image, &[MIDDLE_MM]));
    let is = |yes: bool| f64::from(u8::from(yes));
    let rows: Vec<Row> = vec![
        row(format!("cut: true healed share after {STEPS} h"), "", None, truth[STEPS as usize - 1][1], Kind::Fitted),
        row("cut: healed share according to the monitor", "", None, seen[STEPS as usize - 1][1], Kind::Algorithm),
        row("largest difference between the two over time", "", None, worst, Kind::Algorithm),
        row("the damage counts as healed", "", Some(1.0), is(state == Some(DamageState::Healed)), Kind::Algorithm),
        row("a new baseline is proposed", "", None, is(proposed), Kind::Algorithm),
        row("error there before the cut", "mm", None, error_mm(&intact, MIDDLE_MM), Kind::Algorithm),
        row("error there, healed, old baseline", "mm", None, error_mm(&old, MIDDLE_MM), Kind::Algorithm),
        row("error there, healed, new baseline", "mm", Some(2.41), error_mm(&new, MIDDLE_MM), Kind::Algorithm),
    ];
    let words = [
        "H5: cut, healed, pressed with a new baseline",
        "Images of the self-healing sandwich's twin: cut, and healed by 2 h at 90 °C and two days of rest, both \
         against the intact skin; and pressed on the healed place against a new baseline.",
    ];
    let curve = |name: &str, points: Vec<[f64; 2]>| Curve { name: name.into(), points, look: Look::Line };
    let figures = vec![
        images(&line, "healing", words, panels),
        Figure::Curves {
            name: "progress",
            title: "H5: share of the cut that has healed".into(),
            caption:
                "Share of the cut's faces that has rejoined over time: the twin's true value, and the estimate of the \
                      live pipeline's monitor. Heat of 90 °C is applied for the first two hours."
                    .into(),
            x_label: "time (h)",
            y_label: "share healed",
            curves: vec![curve("twin", truth), curve("monitor", seen)],
        },
    ];
    let notes = vec![
        "90 degrees for 2 h and 48 h of rest are the paper's; the twin's scar follows from the paper's bars (2.07 to \
         2.15 kohm)."
            .into(),
        "The monitor fits the cut's closing and the rise of conductivity around it separately.".into(),
    ];
    Ok(Report { id: HEALING.id, title: HEALING.title, rows, figures, notes })
}

pub(super) const ON_THE_CUT: Experiment = Experiment { id: "H6", title: "pressing on the cut", run: on_the_cut };

/// H6: pressed on the cut, then released.
fn on_the_cut() -> Result<Report, Error> {
    let mut line = Line::new()?;
    cut(&mut line)?;
    let mut panels = vec![panel(&line, "cut", &line.damage_image, &[MIDDLE_MM])];
    let before = line.open();
    line.press(MIDDLE_MM)?;
    line.run(2.0)?;
    let touches = line.touches.clone();
    let covered = line.open().first().is_some_and(|damage| damage.state == DamageState::Covered);
    panels.push(panel(&line, "pressed", &line.damage_image, &[MIDDLE_MM]));
    line.release();
    line.run(3.0)?;
    let after = line.open();
    panels.push(panel(&line, "released", &line.damage_image, &[MIDDLE_MM]));
    let is = |yes: bool| f64::from(u8::from(yes));
    let same = matches!((before.first(), after.first()), (Some(a), Some(b)) if a.id == b.id && a.since_ns == b.since_ns
        && b.state == DamageState::Confirmed);
    let rows = vec![
        row("touches while the cut is pressed", "", Some(1.0), touches.len() as f64, Kind::Predicted),
        row("error of the touch", "mm", None, error_mm(&touches, MIDDLE_MM), Kind::Algorithm),
        row("the damage is remembered while covered", "", None, is(covered), Kind::Algorithm),
        row("the same damage is seen again after release", "", Some(1.0), is(same), Kind::Predicted),
        row("touches after release", "", Some(0.0), line.touches.len() as f64, Kind::Algorithm),
    ];
    let words = [
        "H6: pressing on the cut",
        "Images of the self-healing sandwich's twin against the intact skin: cut, while a disc of 20 mm presses the \
         cut at 80 kPa, and after its release.",
    ];
    let figures = vec![images(&line, "on-the-cut", words, panels)];
    let notes = vec!["Against the intact skin, as in the paper's figure 12. 1 is yes.".into()];
    Ok(Report { id: ON_THE_CUT.id, title: ON_THE_CUT.title, rows, figures, notes })
}
