//! Builds the scene of a skin.

use dermis_device::Layout;
use dermis_live::calibration::{CalibratedImager, Calibration};
use dermis_live::channels::ChannelReader;
use dermis_live::imager::Imager;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_skin::{Bend, Layer};
use dermis_tomo::mesh::{Contact, Outline, Point, distance};
use dermis_twin::from_skin::usual_travel_share;
use dermis_twin::{PressRange, TypicalPress};

use crate::scene::{ElectrodeView, GridView, PressLimits, Scene};

/// Millimetres per metre.
const MM: f64 = 1e3;
/// Peak of the image under a usual press, if nothing more is known about the skin.
const USUAL_AMPLITUDE: f32 = 0.25;
/// Places on the skin where a typical poke's image is computed; enough for a median.
const POKED_PLACES: usize = 20;
/// Peaks below this are too small to set the colour range.
const LEAST_AMPLITUDE: f32 = 1e-4;

/// The constant properties of a running skin. `press` gives the limits for pressing its twin, if it is one. The
/// `calibration` is the one that its touches are located by.
pub fn scene(prepared: &Prepared, press: Option<PressRange>, calibration: Option<&Calibration>) -> Scene {
    let grid = prepared.map.grid();
    let correction = calibration.and_then(Calibration::correction);
    // Without a model, images are made with the Jacobian that the pokes measured, and count in typical pokes.
    let measured = calibration.filter(|_| correction.is_none());
    let typical = match (measured, press, correction) {
        (Some(calibration), _, _) => poked_amplitude(prepared, calibration),
        (None, Some(_), _) => typical_amplitude(prepared),
        (None, None, Some(correction)) => Some(correction.typical_amplitude([0.0, 0.0]) as f32),
        (None, None, None) => None,
    };
    let (image_quantity, image_unit) = match measured {
        Some(_) => ("touch strength", "typical pokes per pixel"),
        None => (prepared.skin.modality.image_quantity(), ""),
    };
    let mm = |p: Point| [p[0] * MM, p[1] * MM];
    let lambda = typical_hyperparameter(prepared);
    Scene {
        skin: prepared.skin.name.clone(),
        modality: prepared.skin.modality.name().into(),
        is_twin: press.is_some(),
        watches_damage: prepared.skin.damage.watch,
        is_treatable: press.is_some() && matches!(prepared.skin.frontend.layer, Layer::Sandwich(_)),
        outline_mm: rings(&prepared.body.outline).into_iter().map(|ring| ring.into_iter().map(mm).collect()).collect(),
        bend_diameter_mm: prepared.skin.frontend.bend.map(|Bend::Cylinder { diameter_mm }| diameter_mm),
        electrodes: electrodes(prepared),
        grid: GridView {
            rows: grid.rows,
            cols: grid.columns,
            x_min_mm: grid.left_m * MM,
            x_max_mm: (grid.left_m + grid.columns as f64 * grid.pixel_m) * MM,
            y_min_mm: (grid.top_m - grid.rows as f64 * grid.pixel_m) * MM,
            y_max_mm: grid.top_m * MM,
        },
        channel_labels: (0..prepared.channels()).map(|channel| prepared.protocol.channel_label(channel)).collect(),
        channel_unit: "V".into(),
        image_quantity: image_quantity.into(),
        image_unit: image_unit.into(),
        amplitude_unit: calibration.map_or_else(String::new, |_| "typical pokes".into()),
        range_hint: Some(range_about(2.0 * typical.unwrap_or(USUAL_AMPLITUDE), prepared.skin.touch.both_signs)),
        hyperparameter_range: [lambda * 1e-2, lambda * 1e2],
        press: press.map_or_else(PressLimits::default, limits),
    }
}

/// Colours from zero up or, for skins whose changes have both signs, on both sides of zero.
fn range_about(most: f32, both_signs: bool) -> [f32; 2] {
    if both_signs { [-most, most] } else { [0.0, most] }
}

/// Peak of the image under the skin's usual press, from its twin; `None` if it cannot be determined.
fn typical_amplitude(prepared: &Prepared) -> Option<f32> {
    // With coils the fields would have to be computed twice, delaying the page by a second or more. Their images are
    // shares of the elements' travel, which follows from mechanics alone. No colour goes beyond the full travel.
    if let Some(share) = usual_travel_share(&prepared.skin) {
        return Some(share.min(0.5) as f32).filter(|share| *share > LEAST_AMPLITUDE);
    }
    let TypicalPress { rest_v, pressed_v } = TypicalPress::of(&prepared.skin).ok()??;
    let layout = Layout::Channels { count: rest_v.len() };
    let mut reader = ChannelReader::new(&layout, &prepared.protocol, prepared.skin.backend.reads, "the twin").ok()?;
    let mut read = |values: &[f64]| {
        let mut channels = Vec::new();
        reader.read(values, &vec![0.0; values.len()], &mut channels).map(|()| channels)
    };
    let (rest, pressed) = (read(&rest_v).ok()?, read(&pressed_v).ok()?);
    let reference = Reference::from_baseline(prepared, &rest, None).ok()?;
    let mut imager = Imager::new(prepared, &reference, &[]).ok()?;
    let scaled = pressed.iter().zip(&rest).zip(&reference.scale);
    let difference: Vec<f64> = scaled.map(|((pressed, rest), scale)| (pressed - rest) * scale).collect();
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    imager.image(&difference, &mut image).ok()?;
    let height = |value: &f32| if prepared.skin.touch.both_signs { value.abs() } else { *value };
    // `max` ignores the NaN outside the skin.
    let peak = image.iter().map(height).fold(0.0, f32::max);
    (peak > LEAST_AMPLITUDE).then_some(peak)
}

/// Median over the skin of the image's peak under a typical poke, for a calibration that measured the Jacobian; `None`
/// if it cannot be determined.
fn poked_amplitude(prepared: &Prepared, calibration: &Calibration) -> Option<f32> {
    let measured = calibration.measured_jacobian(prepared).ok()?;
    let columns = measured.jacobian.as_mat();
    let reference = Reference::from_baseline(prepared, &prepared.voltages, None).ok()?;
    let mut imager = CalibratedImager::new(prepared, Some(calibration), reference, &[]).ok()?.imager;
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let step = (columns.ncols() / POKED_PLACES).max(1);
    let mut peaks: Vec<f32> = Vec::new();
    for place in (0..columns.ncols()).step_by(step) {
        let difference: Vec<f64> = (0..columns.nrows()).map(|channel| columns[(channel, place)]).collect();
        imager.image(&difference, &mut image).ok()?;
        peaks.push(image.iter().copied().fold(0.0, f32::max));
    }
    peaks.sort_by(f32::total_cmp);
    peaks.get(peaks.len() / 2).copied().filter(|peak| *peak > LEAST_AMPLITUDE)
}

fn limits(range: PressRange) -> PressLimits {
    PressLimits {
        radius_mm: range.radius_m.map(|m| m * MM),
        pressure_kpa: range.pressure_pa.map(|pa| pa * 1e-3),
        initial_radius_mm: range.initial_radius_m * MM,
        initial_pressure_kpa: range.initial_pressure_pa * 1e-3,
    }
}

/// Middle of the slider: lambda from the skin file's own rule if that needs no data, else 1.
fn typical_hyperparameter(prepared: &Prepared) -> f64 {
    let reference = Reference::from_baseline(prepared, &prepared.voltages, None);
    reference.and_then(|r| Imager::new(prepared, &r, &[])).map_or(1.0, |imager| imager.hyperparameter())
}

/// Closed rings of an outline, metres, without repeating the first point: the outer boundary first, then holes. A
/// circle becomes a polygon.
pub fn rings(outline: &Outline) -> Vec<Vec<Point>> {
    match outline {
        Outline::Disc { radius_m } => {
            let corner = |k: usize| {
                let angle = std::f64::consts::TAU * k as f64 / 120.0;
                [radius_m * angle.cos(), radius_m * angle.sin()]
            };
            vec![(0..120).map(corner).collect()]
        }
        Outline::Rectangle { width_m, height_m } => {
            let (x, y) = (0.5 * width_m, 0.5 * height_m);
            vec![vec![[-x, -y], [x, -y], [x, y], [-x, y]]]
        }
        Outline::Polygon { outer, holes } => std::iter::once(outer).chain(holes).cloned().collect(),
    }
}

/// Rim electrodes as the segment between their ends, pads as the corners of their bounding rectangle, points without
/// outline.
fn electrodes(prepared: &Prepared) -> Vec<ElectrodeView> {
    let body = &prepared.body.mesh;
    (0..body.electrodes.len())
        .map(|index| {
            let centre = body.electrode_centre(index);
            let nodes: Vec<[f64; 3]> =
                body.electrode_nodes(index).iter().map(|&node| body.mesh.nodes()[node as usize]).collect();
            let outline_mm = match body.electrodes[index].contact {
                Contact::Point(_) => Vec::new(),
                Contact::Faces(_) => ends(&nodes),
                Contact::Area(_) => corners(&nodes),
            };
            let number = index as u32 + 1;
            ElectrodeView { number, position_mm: [centre[0] * MM, centre[1] * MM], outline_mm }
        })
        .collect()
}

/// The two nodes farthest apart.
fn ends(nodes: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let points: Vec<Point> = nodes.iter().map(|node| [node[0], node[1]]).collect();
    let pairs = points.iter().flat_map(|a| points.iter().map(move |b| (*a, *b)));
    let farthest = pairs.max_by(|x, y| distance(x.0, x.1).total_cmp(&distance(y.0, y.1)));
    farthest.map_or(Vec::new(), |(a, b)| vec![[a[0] * MM, a[1] * MM], [b[0] * MM, b[1] * MM]])
}

fn corners(nodes: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let fold = |axis: usize| {
        nodes.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), n| (l.min(n[axis] * MM), h.max(n[axis] * MM)))
    };
    let ((left, right), (bottom, top)) = (fold(0), fold(1));
    vec![[left, bottom], [right, bottom], [right, top], [left, top]]
}
