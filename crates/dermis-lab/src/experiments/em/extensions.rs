//! Experiments that the paper could not do: finding the best frequency, and metal nearby.

use dermis_mit::Sphere;
use dermis_mit::sheet::SheetMaterial;
use dermis_tomo::mesh::Point;
use dermis_touch::measure::pearson;
use dermis_twin::from_skin::{element_options, instrument_options, resting_voltage_v};
use dermis_twin::instrument::Instrument;
use dermis_twin::{Conductor, ElementOptions, ElementSkin, FoilOptions, FoilSkin, Frontend, NearbyMetal};

use super::array::{Array, Bench, CIRCULAR, EIGHT, row};
use crate::Error;
use crate::report::{Curve, Experiment, Figure, Kind, Look, Report};
use crate::twin_bench::Rig;
use crate::twin_bench::disc;
use dermis_live::magnetic_model::MagneticModel;
use dermis_mit::catalogue::SWEEP_HZ;
use dermis_skin::{Skin, Solve};

pub(super) const SWEEP: Experiment =
    Experiment { id: "E12", title: "which frequency is best, 1 to 100 kHz", run: sweep };

/// E12: the change of the readings when the middle element is pressed by half its travel. The measure is the root
/// mean square over channels of the relative change, which is the signal-to-noise ratio if noise is proportional to
/// the reading.
fn sweep() -> Result<Report, Error> {
    let (mut rows, mut curves) = (Vec::new(), Vec::new());
    for array in [EIGHT, CIRCULAR] {
        let skin = Skin::open(array.skin)?;
        let element = MagneticModel::of(&skin)?.element;
        let mut points = Vec::new();
        for frequency_hz in SWEEP_HZ {
            let body = Conductor::Body(dermis_mit::catalogue::body_of(&element, frequency_hz)?);
            let options = ElementOptions {
                frequency_hz,
                element: body,
                tolerance_m: 0.0,
                memory: None,
                ..element_options(&skin)?
            };
            let limit_m = options.springs.limit_m;
            let mut frontend = ElementSkin::new(options)?;
            let mut travel_m = vec![0.0; frontend.places_m().len()];
            let (mut rest, mut pressed) = (vec![0.0; frontend.channel_count()], vec![0.0; frontend.channel_count()]);
            frontend.read_at(&travel_m, &mut rest)?;
            let per_side = (travel_m.len() as f64).sqrt() as usize;
            let middle = (per_side / 2) * per_side + per_side / 2;
            travel_m[middle] = 0.5 * limit_m;
            frontend.read_at(&travel_m, &mut pressed)?;
            let square: f64 = pressed.iter().zip(&rest).map(|(p, r)| (p / r - 1.0).powi(2)).sum();
            points.push([1e-3 * frequency_hz, 1e3 * (square / rest.len() as f64).sqrt()]);
        }
        let best = points.iter().copied().fold([0.0, 0.0], |best, p| if p[1] > best[1] { p } else { best });
        let at = |khz: f64| points.iter().find(|p| (p[0] - khz).abs() < 1e-9).map_or(f64::NAN, |p| p[1]);
        rows.push(row(
            format!("{}: frequency of the largest change", array.name),
            "kHz",
            None,
            best[0],
            Kind::Predicted,
        ));
        for khz in [1.0, 10.0, 20.0, 55.0, 100.0] {
            rows.push(row(format!("{}: change at {khz} kHz", array.name), "per mille", None, at(khz), Kind::Predicted));
        }
        curves.push(Curve { name: array.name.into(), points, look: Look::Line });
    }
    let title = "E12: change of the readings by one element halfway down".into();
    let caption = "Root mean square over the channels of the relative change of the readings when the middle element \
                   is pressed by half its travel, against frequency, for the twins with eight and with sixteen \
                   coils. No noise."
        .into();
    let figures = vec![Figure::Curves {
        name: "sweep",
        title,
        caption,
        x_label: "frequency (kHz)",
        y_label: "rms relative change (per mille)",
        curves,
    }];
    let notes = vec![
        "Noise is taken as the same share of a reading at every frequency; an instrument's own noise decides \
        between frequencies that differ little."
            .into(),
    ];
    Ok(Report { id: SWEEP.id, title: SWEEP.title, rows, figures, notes })
}

pub(super) const FOIL: Experiment =
    Experiment { id: "E14", title: "a copper foil in place of the elements", run: foil };

/// E14: the paper's first membrane, a copper foil on sponge, which it abandoned because a touch doesn't deform it
/// locally. Measures how similar the readings are for presses at neighbouring places, and how far the neighbour moves
/// along with the pressed place.
fn foil() -> Result<Report, Error> {
    let skin = Skin::open(EIGHT.skin)?;
    let elements = MagneticModel::of(&skin)?.elements;
    let places = elements.places_m();
    let still = ElementOptions { tolerance_m: 0.0, memory: None, ..element_options(&skin)? };
    let coils = still.coils.clone();
    let (current_a, frequency_hz) = (still.current_a, still.frequency_hz);
    let mut cylinders = ElementSkin::new(still)?;
    let mut foil = FoilSkin::new(FoilOptions {
        coils,
        side_m: 0.14,
        cells: 24,
        material: SheetMaterial { thickness_m: 35e-6, conductivity_s_per_m: 5.8e7 },
        rest_m: 0.018,
        tension_n_per_m: 300.0,
        stiffness_pa_per_m: 1e6,
        limit_m: 0.011,
        current_a,
        frequency_hz,
    })?;
    let per_side = (places.len() as f64).sqrt() as usize;
    let mut rows = Vec::new();
    let mut add = |name: &str, responses: Vec<Vec<f64>>, neighbour: f64| -> Result<(), Error> {
        let mut alike = Vec::new();
        for k in (0..places.len()).filter(|k| (k + 1) % per_side != 0) {
            alike.push(pearson(&responses[k], &responses[k + 1])?);
        }
        alike.sort_by(f64::total_cmp);
        let median = alike[alike.len() / 2];
        rows.push(row(
            format!("{name}: correlation of neighbours' readings, median"),
            "",
            None,
            median,
            Kind::Predicted,
        ));
        rows.push(row(
            format!("{name}: travel of the neighbour over that of the pressed element"),
            "",
            None,
            neighbour,
            Kind::Predicted,
        ));
        Ok(())
    };
    let (middle, beside) = (places.len() / 2, places.len() / 2 + 1);
    let mut neighbour = 0.0;
    let responses = responses(&mut cylinders, &places, |skin: &ElementSkin, k| {
        if k == middle {
            neighbour = skin.travel_m()[beside] / skin.travel_m()[middle];
        }
    })?;
    add("cylinders", responses, neighbour)?;
    let responses = self::responses(&mut foil, &places, |skin: &FoilSkin, k| {
        if k == middle {
            neighbour = skin.way_m(places[beside]) / skin.way_m(places[middle]);
        }
    })?;
    add("copper foil", responses, neighbour)?;
    let notes = vec![
        "35 um of copper under an assumed tension of 300 N/m on the sponge of the cylinders; readings without \
        noise, 2 N on discs of 10 mm."
            .into(),
    ];
    Ok(Report { id: FOIL.id, title: FOIL.title, rows, figures: Vec::new(), notes })
}

/// Relative changes of the readings under 2 N at each place in turn; `look` gets the skin during each press.
fn responses<F: Frontend>(
    skin: &mut F,
    places: &[Point],
    mut look: impl FnMut(&F, usize),
) -> Result<Vec<Vec<f64>>, Error> {
    let mut rest = vec![0.0; skin.channel_count()];
    skin.voltages(&[], 1.0, &mut rest)?;
    let mut all = Vec::with_capacity(places.len());
    for (k, place) in places.iter().enumerate() {
        let mut pressed = vec![0.0; rest.len()];
        skin.voltages(&[disc(*place, 10.0, EIGHT.press_n)], 1.0, &mut pressed)?;
        look(skin, k);
        all.push(pressed.iter().zip(&rest).map(|(p, r)| p / r - 1.0).collect());
    }
    Ok(all)
}

/// Metal near the skin.
#[derive(Clone, Copy)]
struct Metal {
    name: &'static str,
    plate_mm: Option<f64>,
    /// The model includes the plate.
    known: bool,
    ball: Option<NearbyMetal>,
}

pub(super) const METAL: Experiment = Experiment { id: "E13", title: "metal under and next to the array", run: metal };

/// E13: every element is pressed with metal present from the start, included in the model or not. Then the same metal
/// arrives only after the baseline.
fn metal() -> Result<Report, Error> {
    let plate = |name, z_mm, known| Metal { name, plate_mm: Some(z_mm), known, ball: None };
    let ball = |name, x_m| {
        let sphere = Sphere { radius_m: 0.03, conductivity_s_per_m: 3.5e7, relative_permeability: 1.0 };
        let ball = Some(NearbyMetal { sphere, centre_m: [x_m, 0.0, 0.03] });
        Metal { name, plate_mm: None, known: false, ball }
    };
    let cases = [
        plate("plate 80 mm below", -80.0, false),
        plate("plate 40 mm below", -40.0, false),
        plate("plate 20 mm below", -20.0, false),
        plate("plate 40 mm below, known", -40.0, true),
        plate("plate 20 mm below, known", -20.0, true),
        plate("plate 10 mm below, known", -10.0, true),
        ball("ball of 60 mm, 60 mm to the side", 0.155),
        ball("ball of 60 mm, 20 mm to the side", 0.115),
    ];
    let mut clear = bench(EIGHT, Metal { name: "nothing", plate_mm: None, known: false, ball: None })?;
    let mut rows = Vec::new();
    let number = |name: &str, what: &str, unit, here| row(format!("{name}: {what}"), unit, None, here, Kind::Algorithm);
    rows.push(number("nothing", "elements located, of 25", "", located(&mut clear)?));
    let (mut changed, mut misfits) = (Vec::new(), Vec::new());
    for case in cases {
        let mut bench = bench(EIGHT, case)?;
        rows.push(number(case.name, "elements located after a tare, of 25", "", located(&mut bench)?));
        if case.known {
            continue;
        }
        let (now, before) = (&bench.rig.reference().baseline, &clear.rig.reference().baseline);
        let square: f64 = now.iter().zip(before).map(|(n, b)| (n / b - 1.0).powi(2)).sum();
        changed.push(100.0 * (square / now.len() as f64).sqrt());
        // The metal arrives after the baseline: image without a new tare.
        bench.rig.set_reference(clear.rig.reference().clone());
        let frame = bench.rig.frames(&[], 1)?.swap_remove(0);
        let image = bench.rig.image(&frame)?;
        let touches = bench.rig.touches(&image)?.len() as f64;
        misfits.push(bench.rig.heights().map_or(f64::NAN, |fit| fit.misfit));
        let last = changed.len() - 1;
        rows.push(number(case.name, "readings at rest change by", "%", changed[last]));
        rows.push(number(case.name, "arriving after the baseline: false touches", "", touches));
        rows.push(number(case.name, "arriving after the baseline: misfit", "", misfits[last]));
    }
    let frame = clear.settled(&[12], 1)?;
    clear.rig.image(&frame)?;
    let misfit = clear.rig.heights().map_or(f64::NAN, |fit| fit.misfit);
    rows.push(number("a touch, for comparison", "misfit", "", misfit));
    let points = changed.iter().zip(&misfits).map(|(c, m)| [*c, m.log10()]).collect();
    let curves = vec![Curve { name: "metal".into(), points, look: Look::Points }];
    let title = "E13: metal that arrived after the baseline".into();
    let caption =
        "Misfit of the elements' heights, as a power of ten, against the change of the readings at rest, for plates \
                   and a ball of metal that came near the twin with eight coils after its baseline."
            .into();
    let (x_label, y_label) = ("change of the readings (%)", "log₁₀ of the misfit");
    let figures = vec![Figure::Curves { name: "metal", title, caption, x_label, y_label, curves }];
    let notes = vec![
        "Plates conduct perfectly; the ball is of aluminium. A known plate is shield_mm in the skin file.".into(),
        "Misfit: mean squared residual in units of noise and model error; far above a touch's, it shows that no \
        element moved."
            .into(),
    ];
    Ok(Report { id: METAL.id, title: METAL.title, rows, figures, notes })
}

fn bench(array: Array, metal: Metal) -> Result<Bench, Error> {
    let mut skin = Skin::open(array.skin)?;
    skin.imaging.solve = Solve::LiftOff;
    skin.touch.join_cells = 0.0;
    let mut true_skin = skin.clone();
    if let Some(coils) = &mut true_skin.frontend.coils {
        coils.shield_mm = metal.plate_mm;
    }
    let options = ElementOptions { nearby: metal.ball, ..element_options(&true_skin)? };
    if metal.known {
        skin.frontend.coils = true_skin.frontend.coils;
    }
    let seed = options.seed;
    let mut frontend = ElementSkin::new(options)?;
    let options = instrument_options(&skin, resting_voltage_v(&mut frontend)?);
    let instrument = Instrument::new(options, frontend.channel_count(), seed)?;
    array.bench_from(Rig::from_parts(skin, Box::new(frontend), instrument)?)
}

/// Number of elements located by a single touch, and no other, in one frame.
fn located(bench: &mut Bench) -> Result<f64, Error> {
    let mut count = 0;
    for element in 0..bench.places.len() {
        let frame = bench.settled(&[element], 1)?;
        count += usize::from(bench.finds(&frame, &[element])?.1);
    }
    Ok(count as f64)
}
