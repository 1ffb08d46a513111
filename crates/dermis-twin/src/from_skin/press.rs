//! Range of presses on a skin and the demonstration of its twin: derived from size and layer, unless the file sets
//! them.

use std::f64::consts::PI;

use dermis_skin::{
    Demonstration, Elements, ElementsLayer, Layer, LiquidLayer, PatchesLayer, PressSettings, SandwichLayer, Skin,
};
use dermis_tomo::mesh::{Outline, Point};

use crate::scene::{Event, Script};

/// Range of presses available to users, and the initial values of the sliders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressRange {
    /// Minimum and maximum radius of the indenter.
    pub radius_m: [f64; 2],
    /// Minimum and maximum pressure under it.
    pub pressure_pa: [f64; 2],
    /// Initial radius.
    pub initial_radius_m: f64,
    /// Initial pressure.
    pub initial_pressure_pa: f64,
}

/// Half width of the square that the demonstration was designed for.
const DEMO_HALF_WIDTH_M: f64 = 0.05;
/// Pressure that the demonstration was designed for.
const DEMO_PRESSURE_PA: f64 = 80e3;

impl PressRange {
    /// A range around the radius and pressure that a skin is designed for.
    fn about(radius_m: f64, pressure_pa: f64) -> Self {
        Self {
            radius_m: [0.3 * radius_m, 3.0 * radius_m],
            pressure_pa: [0.0, 2.5 * pressure_pa],
            initial_radius_m: radius_m,
            initial_pressure_pa: pressure_pa,
        }
    }

    fn written(press: &PressSettings) -> Self {
        Self {
            radius_m: press.radius_mm.map(|mm| mm * 1e-3),
            pressure_pa: press.pressure_kpa.map(|kpa| kpa * 1e3),
            initial_radius_m: press.initial_radius_mm * 1e-3,
            initial_pressure_pa: press.initial_pressure_kpa * 1e3,
        }
    }
}

/// Range of presses available to users: the file's `[twin] press`, otherwise derived from size and layer. The initial
/// press closes a gap to about 60 % of saturation, changes a sheet's conductance by a third, dents a liquid by a
/// quarter of its depth, or moves an element by half its travel.
pub fn press_range(skin: &Skin) -> PressRange {
    if let Some(press) = &skin.twin.press {
        return PressRange::written(press);
    }
    let outline = skin.outline();
    let (low, high) = outline.bounds_m();
    let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
    let finger_m = skin.fingertip_m();
    match (&skin.frontend.layer, &skin.frontend.elements) {
        (Layer::Sheet(layer), _) => PressRange::about(finger_m, 1e3 * 0.35 / layer.response_per_kpa().abs()),
        (Layer::Sandwich(layer), _) => {
            PressRange::about(finger_m, 1e3 * layer.contact.pressure_at_kpa(SandwichLayer::USUAL_CONTACT))
        }
        (Layer::Patches(layer), _) => {
            PressRange::about(finger_m, 1e3 * layer.contact.pressure_at_kpa(PatchesLayer::USUAL_CONTACT))
        }
        (Layer::Liquid(layer), _) => PressRange::about(finger_m, denting_pa(layer, finger_m, shorter_m)),
        (Layer::Elements(layer), Some(elements)) => {
            let radius_m = 0.44 * elements.pitch_m();
            PressRange::about(radius_m, moving_pa(layer, elements, radius_m))
        }
        (Layer::Elements(_), None) => PressRange::about(finger_m, 1e4),
    }
}

/// Pressure under a disc that dents a liquid by a quarter of its depth, against the membrane
/// (`p r^2 (1 + 2 ln(R/r)) / (4 T)` in the middle of a round tray) and the liquid's own weight.
fn denting_pa(layer: &LiquidLayer, radius_m: f64, shorter_m: f64) -> f64 {
    let depth_m = layer.depth_mm * 1e-3;
    let spread = 1.0 + 2.0 * (0.5 * shorter_m / radius_m).max(1.0).ln();
    let membrane = 4.0 * layer.tension_n_per_m / (radius_m * radius_m * spread);
    let weight = layer.density_kg_per_m3 * (-layer.gravity_m_per_s2[2]).max(0.0);
    0.25 * depth_m * (membrane + weight)
}

/// Approximate share of its travel by which the initial press moves an element; `None` without elements.
pub fn usual_travel_share(skin: &Skin) -> Option<f64> {
    let (Layer::Elements(layer), Some(elements)) = (&skin.frontend.layer, &skin.frontend.elements) else { return None };
    let PressRange { initial_radius_m: radius_m, initial_pressure_pa: pressure_pa, .. } = press_range(skin);
    // A wider disc also presses other elements.
    let [width_m, height_m] = elements.cell_m();
    let of_cell = (width_m * height_m / (PI * radius_m * radius_m)).min(1.0);
    Some((0.5 * of_cell * pressure_pa / moving_pa(layer, elements, radius_m)).clamp(0.0, 1.0))
}

/// Pressure under a disc over one element that moves it by half its travel.
fn moving_pa(layer: &ElementsLayer, elements: &Elements, radius_m: f64) -> f64 {
    0.58 * layer.stiffness_n_per_m * elements.travel_mm * 1e-3 / (PI * radius_m * radius_m)
}

/// Demonstration of a twin: one touch wanders, others press and slide. Centred in the largest circle that fits into
/// the skin, unless the file says otherwise.
pub fn demonstration(skin: &Skin, press: &PressRange) -> Script {
    let softness = press.initial_pressure_pa / DEMO_PRESSURE_PA;
    match skin.twin.demonstration {
        Some(Demonstration::None) => Script { duration_s: 1.0, repeat: true, events: Vec::new() },
        Some(Demonstration::Scale(scale)) => Script::demo().scaled(scale, softness),
        None => {
            let (middle_m, radius_m) = largest_circle(&skin.outline());
            let mut script = Script::demo().scaled(radius_m / DEMO_HALF_WIDTH_M, softness);
            for event in &mut script.events {
                if let Event::Press { x_mm, y_mm, .. } | Event::Move { x_mm, y_mm, .. } = event {
                    (*x_mm, *y_mm) = (*x_mm + 1e3 * middle_m[0], *y_mm + 1e3 * middle_m[1]);
                }
            }
            script
        }
    }
}

/// Centre and radius of the largest circle in an outline, to about a hundredth of its extent.
fn largest_circle(outline: &Outline) -> ([f64; 2], f64) {
    const STEPS: usize = 64;
    let (low, high) = outline.bounds_m();
    let rings: Vec<Vec<Point>> = match outline {
        Outline::Disc { radius_m } => return ([0.0; 2], *radius_m),
        Outline::Rectangle { width_m, height_m } => return ([0.0; 2], 0.5 * width_m.min(*height_m)),
        Outline::Polygon { outer, holes } => std::iter::once(outer).chain(holes).cloned().collect(),
    };
    let clearance = |p: Point| {
        let edges = rings.iter().flat_map(|ring| (0..ring.len()).map(move |k| (ring[k], ring[(k + 1) % ring.len()])));
        edges.map(|(a, b)| dermis_tomo::mesh::to_segment(p, a, b).0).fold(f64::INFINITY, f64::min)
    };
    let mut best = ([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])], 0.0);
    for k in 0..STEPS * STEPS {
        let at = |axis: usize, step: usize| low[axis] + (high[axis] - low[axis]) * (step as f64 + 0.5) / STEPS as f64;
        let place = [at(0, k % STEPS), at(1, k / STEPS)];
        if outline.contains(place) {
            let radius = clearance(place);
            if radius > best.1 {
                best = (place, radius);
            }
        }
    }
    best
}
