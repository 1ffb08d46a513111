//! The plates above a sheet that touch it where pressed: one layer over the whole sheet (the sandwich), or separate
//! patches; and the model of presses on them, on a sheet as built and with its cuts.

use std::sync::Arc;

use dermis_estimate::{PlateLaw, PlateModel, PlateOptions};
use dermis_skin::{ContactLaw, Layer, PatchesLayer, SandwichLayer, Skin, SkinBody};
use dermis_tomo::eit::contacts::PlatedSheet;
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{PixelGrid, Point, SlitEdge, SlitMesh, distance};

use crate::Error;
use crate::as_built::Build;
use crate::prepare::{Prepared, sheet_as_built};
use crate::stages::spot_model::{LARGEST_RADIUS, MOST_SPOTS, SMALLEST_RADIUS, TYPICAL_RADIUS, may_look_beyond};

/// Share of a frame's energy that the model of contact leaves unexplained, on twins: 0 to 0.00016 on six sandwiches,
/// and no more than noise hides on seven skins with patches.
const CONTACT_ERROR: f64 = 1e-4;
/// Number of elements of the mesh for fits, at least and at most.
const ELEMENTS: [f64; 2] = [4000.0, 8000.0];
/// The same under patches, whose edges the mesh doesn't follow: with 4,000, forces on a rectangle of 200 mm x 100 mm
/// are off by 14 % instead of 9 %.
const ELEMENTS_UNDER_PATCHES: [f64; 2] = [6000.0, 8000.0];
/// Elements that a square with the side of a usual press's radius should have. With 6 on a sandwich of 435 mm x
/// 174 mm, a twin leaves 15 times as much of a press unexplained as with 26 on one of 120 mm.
const ELEMENTS_UNDER_PRESS: f64 = 25.0;
/// Number of elements of the mesh on which explanations are compared, where that for fits has its least number.
const COARSE_ELEMENTS: f64 = 1500.0;
/// Largest numbers of channels, and of patches, for fits of contact with patches. Skins with more keep smooth spots.
const MOST_CHANNELS: usize = 2000;
const MOST_PATCHES: f64 = 2000.0;
/// Contact under presses as they are proposed, as a share of the saturated contact.
const PROPOSED_CONTACT: f64 = 0.8;
/// Distance between the positions at which presses are proposed, on patches, in pitches.
const PROPOSED_EVERY: f64 = 0.5;
/// The same elsewhere, as a share of the shorter side.
const PROPOSED_SHARE: f64 = 0.1;
/// Least spread of pressure, in pitches.
const LEAST_SPREAD: f64 = 0.05;
/// Share of the conductance left in an element that is crossed by a cut which no slit can follow. It blocks the
/// current but keeps the matrices regular.
const LEFT_BY_A_CUT: f64 = 1e-4;

/// Both ends of a segment, metres.
type Ends = [[f64; 2]; 2];

/// A cut in a sheet, or its scar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SheetCut {
    pub ends_m: Ends,
    /// Conductance across the cut per length, over the sheet's conductance, 1/m; 0 if it is open.
    pub joined_per_m: f64,
}

/// Square plates on a grid, centred on the sheet.
#[derive(Clone, Copy, Debug)]
struct Squares {
    /// Distance between the middles of neighbours, and side of a plate, metres.
    pitch_m: f64,
    side_m: f64,
    /// Lower left corner of the grid, metres, and number of columns.
    corner_m: Point,
    columns: u32,
}

/// The plates of a skin, and what is needed to model presses on them.
#[derive(Clone, Debug)]
pub(crate) struct Plates {
    /// `None` if one plate covers the whole sheet.
    squares: Option<Squares>,
    contact: ContactLaw,
    /// Contact under a usual press, as a share of the saturated contact.
    usual_contact: f64,
    spread_m: f64,
    skin: Skin,
    body: SkinBody,
    protocol: Protocol,
    built: Option<Arc<Build>>,
    grid: PixelGrid,
    inside: Vec<bool>,
    half_width_m: f64,
}

/// True if presses are fitted as contacts between a sheet and plates above it; otherwise they are smooth spots.
pub(crate) fn fits_contacts(prepared: &Prepared) -> bool {
    match &prepared.skin.frontend.layer {
        Layer::Sandwich(_) => true,
        Layer::Patches(layer) => {
            let patches = prepared.skin.outline().area_m2() / (1e-3 * layer.pitch_mm).powi(2);
            may_look_beyond(prepared) && prepared.channels() <= MOST_CHANNELS && patches <= MOST_PATCHES
        }
        Layer::Sheet(_) | Layer::Liquid(_) | Layer::Elements(_) => false,
    }
}

/// Least and largest number of elements for fits.
fn limits_of_elements(skin: &Skin) -> [f64; 2] {
    if matches!(skin.frontend.layer, Layer::Patches(_)) { ELEMENTS_UNDER_PATCHES } else { ELEMENTS }
}

/// Number of elements that resolves a usual press.
fn wanted_elements(skin: &Skin) -> f64 {
    ELEMENTS_UNDER_PRESS * skin.outline().area_m2() / skin.fingertip_m().powi(2)
}

/// Number of elements for fits.
fn elements_for_fits(skin: &Skin) -> f64 {
    let [least, most] = limits_of_elements(skin);
    wanted_elements(skin).clamp(least, most)
}

/// Size of the elements for fits, metres.
pub(crate) fn element_m(skin: &Skin) -> f64 {
    (skin.outline().area_m2() / elements_for_fits(skin)).sqrt()
}

/// Area of the elements for fits, relative to the largest that resolve a usual press; at least 1. The error of channels
/// and places grows with it.
pub(crate) fn coarseness(skin: &Skin) -> f64 {
    let [_, most] = limits_of_elements(skin);
    (wanted_elements(skin) / most).max(1.0)
}

impl Plates {
    /// The plates of a skin whose presses are fitted as contacts.
    pub fn of(prepared: &Prepared) -> Option<Self> {
        if !fits_contacts(prepared) {
            return None;
        }
        let (squares, contact, usual_contact, spread_m) = match &prepared.skin.frontend.layer {
            Layer::Sandwich(layer) => (None, layer.contact, SandwichLayer::USUAL_CONTACT, 1e-3 * layer.smoothing_mm),
            Layer::Patches(layer) => {
                let (low, high) = prepared.skin.outline().bounds_m();
                let pitch_m = 1e-3 * layer.pitch_mm;
                // Patches are centred on the sheet; rounding must not add one.
                let count = [0, 1].map(|axis| ((high[axis] - low[axis]) / pitch_m - 1e-6).ceil().max(1.0));
                let squares = Squares {
                    pitch_m,
                    side_m: pitch_m - 1e-3 * layer.gap_mm,
                    corner_m: [0, 1].map(|axis| 0.5 * (low[axis] + high[axis] - count[axis] * pitch_m)),
                    columns: count[0] as u32,
                };
                let spread_m = (1e-3 * layer.smoothing_mm).max(LEAST_SPREAD * pitch_m);
                (Some(squares), layer.contact, PatchesLayer::USUAL_CONTACT, spread_m)
            }
            Layer::Sheet(_) | Layer::Liquid(_) | Layer::Elements(_) => return None,
        };
        Some(Self {
            squares,
            contact,
            usual_contact,
            spread_m,
            skin: prepared.skin.clone(),
            body: prepared.body.clone(),
            protocol: prepared.protocol.clone(),
            built: prepared.build().cloned(),
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
            half_width_m: prepared.half_width_m(),
        })
    }

    /// True if one plate connects all contacts, and sheet and plate can be cut.
    pub fn is_one(&self) -> bool {
        self.squares.is_none()
    }

    /// Number of the plate above a position; `None` between plates.
    fn above(&self, place_m: Point) -> Option<u32> {
        let Some(squares) = &self.squares else { return Some(0) };
        let along = [0, 1].map(|axis| (place_m[axis] - squares.corner_m[axis]) / squares.pitch_m);
        let is_on = |at: f64| (at - at.floor() - 0.5).abs() * squares.pitch_m <= 0.5 * squares.side_m;
        let [column, row] = along.map(|at| at.floor().max(0.0) as u32);
        along.iter().all(|at| is_on(*at)).then_some(row * squares.columns + column)
    }

    fn law(&self) -> PlateLaw {
        PlateLaw {
            threshold_pa: 1e3 * self.contact.threshold_kpa,
            reference_pa: 1e3 * self.contact.reference_kpa,
            exponent: self.contact.exponent,
            saturation_s_per_m2: self.contact.saturation_s_per_m2,
            spread_m: self.spread_m,
        }
    }

    /// The model of presses on a sheet with these cuts; `None` once `go_on` says that it is no longer wanted.
    ///
    /// # Errors
    /// A mesh that cannot be made, or contacts that cannot be solved.
    pub fn model(&self, cuts: &[SheetCut], go_on: impl Fn() -> bool) -> Result<Option<PlateModel>, Error> {
        self.model_on(self.elements(), cuts, go_on)
    }

    /// Numbers of elements that a coarse and a fine mesh should have.
    fn elements(&self) -> [usize; 2] {
        let ([least, _], fine) = (limits_of_elements(&self.skin), elements_for_fits(&self.skin));
        [COARSE_ELEMENTS * fine / least, fine].map(|count| count as usize)
    }

    fn model_on(
        &self,
        elements: [usize; 2],
        cuts: &[SheetCut],
        go_on: impl Fn() -> bool,
    ) -> Result<Option<PlateModel>, Error> {
        let law = self.law();
        let typical_radius_m = TYPICAL_RADIUS * self.half_width_m;
        let options = PlateOptions {
            typical_radius_m,
            typical_pa: 1e3 * self.contact.pressure_at_kpa(PROPOSED_CONTACT),
            usual_radius_m: self.skin.fingertip_m(),
            usual_pa: 1e3 * self.contact.pressure_at_kpa(self.usual_contact),
            radii_m: [SMALLEST_RADIUS * self.half_width_m, LARGEST_RADIUS * self.half_width_m],
            spacing_m: self
                .squares
                .map_or(2.0 * PROPOSED_SHARE * self.half_width_m, |squares| PROPOSED_EVERY * squares.pitch_m),
            most_presses: MOST_SPOTS,
            error_share: CONTACT_ERROR * coarseness(&self.skin).powi(2),
        };
        let mut sheets = Vec::new();
        for elements in elements {
            if !go_on() {
                return Ok(None);
            }
            sheets.push(self.sheet(elements, cuts)?);
        }
        let (Some(fine), Some(coarse)) = (sheets.pop(), sheets.pop()) else { return Ok(None) };
        let is_wanted = go_on();
        let model = is_wanted.then(|| PlateModel::new([coarse, fine], law, options, self.grid, self.inside.clone()));
        Ok(model.transpose()?)
    }

    fn sheet(&self, elements: usize, cuts: &[SheetCut]) -> Result<PlatedSheet, Error> {
        let lines: Vec<Ends> = cuts.iter().map(|cut| cut.ends_m).collect();
        let (SlitMesh { mesh, slits }, is_slit) = self.skin.slit_mesh(elements, &lines)?;
        let (mesh, mut sheet_s) = sheet_as_built(&self.skin, &self.body, self.built.as_deref(), mesh)?;
        let rest_s = self.skin.sheet_conductance_s();
        let slit_cuts = cuts.iter().zip(&is_slit).filter(|(_, is_slit)| **is_slit).map(|(cut, _)| cut);
        let joints: Vec<(SlitEdge, f64)> = slit_cuts
            .zip(&slits)
            .filter(|(cut, _)| cut.joined_per_m > 0.0)
            .flat_map(|(cut, edges)| edges.iter().map(|edge| (*edge, rest_s * cut.joined_per_m)))
            .collect();
        let model = ForwardModel::with_joints(mesh, self.protocol.clone(), &joints)?;
        let mesh = &model.body().mesh;
        let corner = |node: u32| [mesh.nodes()[node as usize][0], mesh.nodes()[node as usize][1]];
        // Blocking whole elements makes a cut longer by about half an element at each end. A scar that no slit can
        // follow is left out.
        let blocking = cuts.iter().zip(&is_slit).filter(|(cut, is_slit)| !**is_slit && cut.joined_per_m == 0.0);
        let blocking: Vec<Ends> = blocking.map(|(cut, _)| shortened(cut.ends_m, 0.5 * mesh.element_size_m())).collect();
        for (conductance_s, cell) in sheet_s.iter_mut().zip(mesh.elements()) {
            let corners = [corner(cell[0]), corner(cell[1]), corner(cell[2])];
            if blocking.iter().any(|cut| crosses(corners, *cut)) {
                *conductance_s *= LEFT_BY_A_CUT;
            }
        }
        Ok(PlatedSheet::new(&model, &sheet_s, |place_m| self.above(place_m))?)
    }
}

/// A segment shortened by this length at each end, or what is left of it around its middle.
fn shortened([a, b]: Ends, by_m: f64) -> Ends {
    let length = distance(a, b);
    let share = (by_m / length.max(f64::MIN_POSITIVE)).min(0.499);
    let at = |share: f64| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    [at(share), at(1.0 - share)]
}

/// True if a segment meets a triangle.
fn crosses(corners: [Point; 3], [a, b]: Ends) -> bool {
    let side = |p: Point, q: Point, r: Point| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let meets = |p: Point, q: Point| side(p, q, a) * side(p, q, b) <= 0.0 && side(a, b, p) * side(a, b, q) <= 0.0;
    let edges = [(0, 1), (1, 2), (2, 0)];
    let inside = edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) >= 0.0)
        || edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) <= 0.0);
    inside || edges.iter().any(|&(i, j)| meets(corners[i], corners[j]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_estimate::{PlateFit, Press, PressFit};

    const PATCHES: &str = "name = 'patches'\ntitle = 'patches'\nmodality = 'eit'\n[frontend]\n\
        shape = { square = { side_mm = 120.0 } }\n\
        layer = { kind = 'patches', thickness_mm = 1.0, conductivity_s_per_m = 5.0 }\n\
        electrodes = { rim = { count = 16, width_mm = 6.0 } }\ncontact_impedance_ohm_m2 = 1e-4\n\
        [backend]\ncurrent_ma = 1.0\ndrive = 'adjacent'\nmeasure = 'adjacent'\n\
        [imaging]\ngrid = 32\nhyperparameter = { relative = 0.03 }";

    #[test]
    fn presses_that_lie_apart_are_solved_alone_almost_as_accurately_as_together() {
        let prepared = Prepared::new(Skin::parse(PATCHES, "patches").unwrap()).unwrap();
        let plates = Plates::of(&prepared).unwrap();
        let press = |x_mm: f64, y_mm: f64| Press {
            position_m: [1e-3 * x_mm, 1e-3 * y_mm],
            radius_m: 8e-3,
            load: 0.7,
            ..Press::default()
        };
        let presses = [press(-31.0, 22.0), press(17.0, 35.0), press(4.0, -28.0)];
        let deviations = vec![1e-6; prepared.channels()];
        let change = |elements: [usize; 2]| {
            let model = plates.model_on(elements, &[], || true).unwrap().unwrap();
            let mut volts = Vec::new();
            PlateFit::new(Arc::new(model), &deviations, &[]).channels_of(&presses, &mut volts);
            volts
        };
        let [coarse, fine] = plates.elements();
        // On two equal sheets, the corrections of the presses alone cancel, and all are solved together.
        let together = change([fine, fine]);
        let error = |volts: &[f64]| {
            let off: f64 = volts.iter().zip(&together).map(|(a, b)| (a - b).powi(2)).sum();
            (off / together.iter().map(|v| v * v).sum::<f64>()).sqrt()
        };
        let (alone, apart) = (error(&change([coarse; 2])), error(&change([coarse, fine])));
        println!("the coarse sheet is off by {alone:.4}, its correction by {apart:.5}");
        // The share of the error of the fine mesh itself: the first order in 1 over the number of elements.
        assert!(apart < 0.1 * alone, "{apart} {alone}");
    }
}
