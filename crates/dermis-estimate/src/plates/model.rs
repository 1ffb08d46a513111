//! The change of the channels by presses on plates, and the press as reported.

use std::f64::consts::PI;
use std::ops::Range;

use dermis_tomo::eit::EitError;
use dermis_tomo::eit::contacts::{ContactPatch, PatchSearch, PatchSets, PlateContact, PlatedSheet};
use dermis_tomo::mesh::{PixelGrid, Point, distance};

use super::law::{Conductance, PlateLaw};
use super::pressure::{Field, OF_PRESS, Pressed};
use super::profile::Profile;
use crate::press::{Effort, Press};

/// Largest change of a logarithm in one step.
pub(super) const LONGEST_LOG: f64 = 0.7;
/// Prior standard deviations of the logarithms of pressure and radius, and of the radius of an indenter that is known.
const LOG_DEVIATIONS: [f64; 2] = [1.0, 0.35];
const LOG_INDENTER: f64 = 0.02;
/// Pressures beyond this many deviations from the usual one are not tried: contact is saturated, or open.
const MOST_DEVIATIONS: f64 = 4.0;
/// Number of steps from a reported press to the parameters of the fit.
const INVERSE_STEPS: usize = 30;
/// Largest area in contact, in areas of a typical press per press.
const MOST_TYPICAL: f64 = 6.0;
/// Least number of presses that this area allows for.
const FEWEST: usize = 3;
/// Operations of a solution and its derivatives: at least, per cell in contact, and per cell cubed. The last is for
/// the factorisation, in single precision. Fitted to the times of 18,000 solutions of up to 340 cells, when contact was
/// summed over 4 points per triangle. With 16, they take about 1.7 times as long.
const LEAST_WORK: f64 = 7e4;
const WORK_PER_CELL: f64 = 5e3;
const WORK_PER_CUBED_CELL: f64 = 0.03;

/// The contact that some presses make on one of the sheets.
#[derive(Clone, Debug)]
pub(super) struct Made {
    effort: Effort,
    /// Sign of the contact in the sum.
    sign: f64,
    contact: PlateContact,
    /// For each press, by its index: derivatives of the conductances of the cells in contact by its parameters.
    moves: Vec<(usize, Vec<Moves>)>,
}

/// Derivatives of the conductance of a cell by the parameters of a press, siemens per unit.
type Moves = [f64; OF_PRESS];

/// The contact under presses.
struct Touched {
    /// Conductance of each cell, siemens.
    conductance_s: Vec<f64>,
    /// For each press, by its index: the derivatives for each cell.
    moves: Vec<(usize, Vec<Moves>)>,
    /// Area in contact, m^2.
    area_m2: f64,
}

impl Touched {
    fn nothing(sheet: &PlatedSheet, presses: impl Iterator<Item = usize>) -> Self {
        let cells = sheet.cell_count();
        let moves = presses.map(|k| (k, vec![[0.0; OF_PRESS]; cells])).collect();
        Self { conductance_s: vec![0.0; cells], moves, area_m2: 0.0 }
    }
}

/// Sizes of presses on plates. SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlateOptions {
    /// Typical radius and pressure.
    pub typical_radius_m: f64,
    /// See `typical_radius_m`.
    pub typical_pa: f64,
    /// Most probable radius and pressure.
    pub usual_radius_m: f64,
    /// See `usual_radius_m`.
    pub usual_pa: f64,
    /// Smallest and largest radius.
    pub radii_m: [f64; 2],
    /// Distance between the positions at which presses are proposed.
    pub spacing_m: f64,
    /// Largest number of presses fitted to one frame.
    pub most_presses: usize,
    /// Share of a frame's energy that the model leaves unexplained of usual presses.
    pub error_share: f64,
}

/// The model of presses on one skin, shared by its fits.
#[derive(Debug)]
pub struct PlateModel {
    /// For comparing explanations, and for the final fit.
    sheets: [PlatedSheet; 2],
    conductance: Conductance,
    pub(super) options: PlateOptions,
    grid: PixelGrid,
    inside: Vec<bool>,
    /// Positions at which presses are proposed, with the change of the channels (volts) by a typical press there.
    pub(super) proposals: Vec<([f64; 2], Vec<f64>)>,
    /// Searches for sets of presses under a plate that connects all of them.
    search: Option<PatchSearch>,
}

impl PlateModel {
    /// A model on the pixels of a grid (row by row) that are on the skin. Explanations are compared on the first,
    /// coarser sheet and fitted on the second.
    ///
    /// # Errors
    /// Contacts that cannot be solved.
    pub fn new(
        sheets: [PlatedSheet; 2],
        law: PlateLaw,
        options: PlateOptions,
        grid: PixelGrid,
        inside: Vec<bool>,
    ) -> Result<Self, EitError> {
        let (conductance, proposals) = (Conductance::new(law), Vec::new());
        let mut model = Self { sheets, conductance, options, grid, inside, proposals, search: None };
        let (width_m, height_m) = (grid.pixel_m * grid.columns as f64, grid.pixel_m * grid.rows as f64);
        let count = |length_m: f64| (length_m / options.spacing_m).ceil().max(1.0) as usize;
        let (columns, rows) = (count(width_m), count(height_m));
        let at = |origin: f64, length: f64, k: usize, of: usize| origin + length * (k as f64 + 0.5) / of as f64;
        for place in (0..rows * columns).map(|k| {
            let (row, column) = (k / columns, k % columns);
            [at(grid.left_m, width_m, column, columns), at(grid.top_m, -height_m, row, rows)]
        }) {
            if model.is_inside(place) {
                let contact = model.contact(&[model.typical(place)], vec![0], 1.0, Effort::Quick)?;
                model.proposals.extend(contact.map(|made| (place, made.contact.change_v)));
            }
        }
        if model.sheets[0].has_one_plate() {
            let places: Vec<Point> = model.proposals.iter().map(|(place, _)| *place).collect();
            let patch = ContactPatch {
                position_m: [0.0; 2],
                radius_m: options.typical_radius_m,
                conductance_s_per_m2: model.conductance.at(options.typical_pa)[0],
            };
            model.search = Some(PatchSearch::new(model.sheets[0].sheet(), patch, &places)?);
        }
        Ok(model)
    }

    /// Begins a search for the positions at which presses together explain a frame best (volts).
    pub(super) fn begin_joint(&self, frame: &[f64], deviations: &[f64]) -> Option<PatchSets> {
        self.search.as_ref()?.begin(self.sheets[0].sheet(), frame, deviations).ok()
    }

    /// Most operations of the next call of [`PlateModel::next_joint`].
    pub(super) fn joint_operations(&self, sets: &PatchSets) -> f64 {
        self.search.as_ref().map_or(0.0, |search| search.operations(sets))
    }

    /// The best positions for one press more than before.
    pub(super) fn next_joint(&self, sets: &mut PatchSets) -> Option<Vec<[f64; 2]>> {
        Some(self.search.as_ref()?.look(sets)?.iter().map(|patch| patch.position_m).collect())
    }

    /// Conductance of the contact by pressure.
    pub(super) fn conductance(&self) -> &Conductance {
        &self.conductance
    }

    /// The law of contact.
    pub(super) fn law(&self) -> &PlateLaw {
        self.conductance.law()
    }

    fn sheet(&self, effort: Effort) -> &PlatedSheet {
        &self.sheets[usize::from(effort == Effort::Full)]
    }

    /// Channels without any press, volts.
    pub fn bare_v(&self) -> &[f64] {
        self.sheets[1].bare_v()
    }

    /// True if one plate connects the contacts of all presses.
    pub(super) fn is_joint(&self) -> bool {
        self.search.is_some()
    }

    pub(super) fn channels(&self) -> usize {
        self.sheets[1].channels()
    }

    fn typical(&self, position_m: Point) -> Pressed {
        let PlateOptions { typical_radius_m, typical_pa, .. } = self.options;
        Pressed { position_m, log_pressure: typical_pa.ln(), log_radius: typical_radius_m.ln(), has_ended: false }
    }

    pub(super) fn is_inside(&self, position_m: Point) -> bool {
        self.grid.pixel_at(position_m).is_some_and(|pixel| self.inside[pixel])
    }

    /// Contacts whose signed sum is the change of the channels. Presses that have ended count negative. The time of a
    /// solution grows with the cube of the area in contact. Under separate plates, presses that lie apart are therefore
    /// solved together on the coarse sheet, and each alone on both sheets, to add the difference.
    pub(super) fn contacts(&self, presses: &[Pressed], effort: Effort) -> Result<Vec<Made>, EitError> {
        let mut made = Vec::new();
        for (has_ended, sign) in [(false, 1.0), (true, -1.0)] {
            let all: Vec<usize> = (0..presses.len()).filter(|&k| presses[k].has_ended == has_ended).collect();
            let groups = self.groups(presses, &all);
            if effort == Effort::Quick || groups.len() < 2 || self.is_joint() {
                made.extend(self.contact(presses, all, sign, effort)?);
                continue;
            }
            made.extend(self.contact(presses, all, sign, Effort::Quick)?);
            for group in groups {
                made.extend(self.contact(presses, group.clone(), -sign, Effort::Quick)?);
                made.extend(self.contact(presses, group, sign, Effort::Full)?);
            }
        }
        Ok(made)
    }

    /// Groups of presses that lie apart.
    fn groups(&self, presses: &[Pressed], all: &[usize]) -> Vec<Vec<usize>> {
        let reach_m = |k: usize| presses[k].log_radius.exp() + self.law().spread_m;
        let are_near =
            |a: usize, b: usize| distance(presses[a].position_m, presses[b].position_m) < reach_m(a) + reach_m(b);
        let mut groups: Vec<Vec<usize>> = Vec::new();
        for &k in all {
            let (near, apart): (Vec<_>, Vec<_>) =
                groups.into_iter().partition(|group| group.iter().any(|&other| are_near(k, other)));
            groups = apart;
            groups.push(near.into_iter().flatten().chain([k]).collect());
        }
        groups
    }

    /// The contact of some presses; `None` without any.
    fn contact(
        &self,
        all: &[Pressed],
        presses: Vec<usize>,
        sign: f64,
        effort: Effort,
    ) -> Result<Option<Made>, EitError> {
        if presses.is_empty() {
            return Ok(None);
        }
        let Touched { conductance_s, moves, area_m2 } = self.touched(all, &presses, effort);
        // Presses as large as the skin would take the time of many frames.
        if area_m2 > MOST_TYPICAL * PI * self.options.typical_radius_m.powi(2) * presses.len().max(FEWEST) as f64 {
            return Err(EitError::Contact { radius_m: (area_m2 / PI).sqrt(), conductance_s_per_m2: 0.0 });
        }
        let contact = self.sheet(effort).contact(&conductance_s)?;
        let moves = moves.into_iter().map(|(k, moves)| (k, contact.of_cells(&moves))).collect();
        Ok((!contact.is_open()).then_some(Made { effort, sign, contact, moves }))
    }

    /// The contact under some of the presses before it is solved for.
    fn touched(&self, all: &[Pressed], presses: &[usize], effort: Effort) -> Touched {
        let fields: Vec<Field> = presses.iter().map(|&k| Field::new(&all[k], self.law().spread_m)).collect();
        // Faint pressures make contact only where they add to another's.
        let faint_pa = self.conductance.faint_pa();
        let contact_m: Vec<f64> = fields.iter().map(|field| field.reach_above_m(faint_pa)).collect();
        let are_apart = |a: usize, b: usize| {
            let distance_m = distance(all[presses[a]].position_m, all[presses[b]].position_m);
            distance_m > contact_m[a] + fields[b].reach_m() && distance_m > contact_m[b] + fields[a].reach_m()
        };
        let sheet = self.sheet(effort);
        let mut touched = Touched::nothing(sheet, presses.iter().copied());
        if !(1..fields.len()).all(|a| (0..a).all(|b| are_apart(a, b))) {
            self.touch_together(&mut touched, all, &fields, sheet);
            return touched;
        }
        let Touched { conductance_s, moves, area_m2 } = &mut touched;
        for (((k, moves), field), contact_m) in moves.iter_mut().zip(&fields).zip(contact_m) {
            let profile = Profile::new(&all[*k], field, contact_m, &self.conductance);
            for range in sheet.points_near(all[*k].position_m, contact_m) {
                for point in &sheet.points()[range] {
                    if let Some((conductance, by)) = profile.at(point.position_m) {
                        let cell = point.cell as usize;
                        conductance_s[cell] += point.area_m2 * conductance;
                        moves[cell].iter_mut().zip(by).for_each(|(sum, value)| *sum += point.area_m2 * value);
                        *area_m2 += point.area_m2;
                    }
                }
            }
        }
        touched
    }

    /// Adds the contact of presses that overlap: their pressures add up.
    fn touch_together(&self, touched: &mut Touched, all: &[Pressed], fields: &[Field], sheet: &PlatedSheet) {
        let Touched { conductance_s, moves, area_m2 } = touched;
        // Where all of them are below this pressure, their sum makes no contact.
        let least_pa = self.conductance.faint_pa() / fields.len() as f64;
        let near = |((k, _), field): (&(usize, Vec<Moves>), &Field)| {
            sheet.points_near(all[*k].position_m, field.reach_above_m(least_pa)).collect::<Vec<_>>()
        };
        let mut ranges: Vec<Range<usize>> = moves.iter().zip(fields).flat_map(near).collect();
        ranges.sort_unstable_by_key(|range| range.start);
        let mut done = 0;
        for range in ranges {
            let range = range.start.max(done)..range.end.max(done);
            done = range.end;
            for point in &sheet.points()[range] {
                let pressure_pa: f64 = fields.iter().map(|field| field.pressure_at(point.position_m)).sum();
                let [conductance, slope] = self.conductance.at(pressure_pa);
                if conductance == 0.0 {
                    continue;
                }
                let cell = point.cell as usize;
                conductance_s[cell] += point.area_m2 * conductance;
                *area_m2 += point.area_m2;
                for ((_, moves), field) in moves.iter_mut().zip(fields) {
                    let by = field.derivatives_at(point.position_m).unwrap_or_default();
                    let scale = point.area_m2 * slope;
                    moves[cell].iter_mut().zip(by).for_each(|(sum, value)| *sum += scale * value);
                }
            }
        }
    }

    /// Operations that solving for these contacts takes.
    pub(super) fn work(made: &[Made]) -> f64 {
        let of = |cells: f64| WORK_PER_CELL * cells + WORK_PER_CUBED_CELL * cells.powi(3);
        made.iter().map(|made| of(made.contact.cell_count() as f64)).sum::<f64>() + LEAST_WORK
    }

    /// Change of the channels, volts.
    pub(super) fn change(&self, made: &[Made], volts: &mut Vec<f64>) {
        volts.clear();
        volts.resize(self.channels(), 0.0);
        for Made { sign, contact, .. } in made {
            volts.iter_mut().zip(&contact.change_v).for_each(|(sum, value)| *sum += sign * value);
        }
    }

    /// Derivatives of the channels with respect to the parameters of each press, volts: one column after the other.
    pub(super) fn derivatives(&self, presses: &[Pressed], made: &[Made]) -> Vec<Vec<f64>> {
        let mut columns = vec![vec![0.0; self.channels()]; OF_PRESS * presses.len()];
        for Made { effort, sign, contact, moves } in made {
            for (k, moves) in moves {
                let jacobian = self.sheet(*effort).derivatives(contact, moves);
                for (parameter, column) in columns[OF_PRESS * k..].iter_mut().take(OF_PRESS).enumerate() {
                    let of_parameter = jacobian.iter().skip(parameter).step_by(OF_PRESS);
                    column.iter_mut().zip(of_parameter).for_each(|(sum, value)| *sum += sign * value);
                }
            }
        }
        columns
    }

    /// Load and radius (metres) reported of a proposed press.
    pub(super) fn reported_typical(&self) -> [f64; 2] {
        let PlateOptions { typical_pa, typical_radius_m, .. } = self.options;
        self.conductance.reported(typical_pa.ln(), typical_radius_m.ln()).0.map(f64::exp)
    }

    /// The press in the parameters of the fit, within their limits, by Newton's method on both logarithms.
    pub(super) fn pressed(&self, press: &Press) -> Pressed {
        let wanted = [press.load.abs().max(1e-6).ln(), press.radius_m.ln()];
        let has_ended = press.load < 0.0;
        let mut at = Pressed { has_ended, ..self.typical(press.position_m) };
        for _ in 0..INVERSE_STEPS {
            let (reported, [[a, b], [c, d]]) = self.conductance.reported(at.log_pressure, at.log_radius);
            let off = [wanted[0] - reported[0], wanted[1] - reported[1]];
            if off.iter().all(|off| off.abs() < 1e-9) {
                break;
            }
            let determinant = a * d - b * c;
            if determinant.abs() < 1e-9 {
                break;
            }
            let step = [(d * off[0] - b * off[1]) / determinant, (a * off[1] - c * off[0]) / determinant];
            let [by_pressure, by_radius] = step.map(|value| value.clamp(-LONGEST_LOG, LONGEST_LOG));
            at = self.limited(Pressed {
                log_pressure: at.log_pressure + by_pressure,
                log_radius: at.log_radius + by_radius,
                ..at
            });
        }
        at
    }

    pub(super) fn limited(&self, press: Pressed) -> Pressed {
        let PlateOptions { typical_pa, radii_m: [least, most], .. } = self.options;
        let reach = MOST_DEVIATIONS * LOG_DEVIATIONS[0];
        Pressed {
            log_pressure: press.log_pressure.clamp(typical_pa.ln() - reach, typical_pa.ln() + reach),
            log_radius: press.log_radius.clamp(least.ln(), most.ln()),
            ..press
        }
    }

    /// The prior of presses by any indenter, or by one of this radius (metres).
    pub(super) fn prior(&self, indenter_m: Option<f64>) -> SizePrior {
        let PlateOptions { usual_pa, usual_radius_m, .. } = self.options;
        let [of_pressure, of_radius] = LOG_DEVIATIONS;
        SizePrior {
            middle: [usual_pa.ln(), indenter_m.unwrap_or(usual_radius_m).ln()],
            deviations: [of_pressure, if indenter_m.is_some() { LOG_INDENTER } else { of_radius }],
        }
    }
}

/// Prior of the logarithms of pressure and radius: a hard press on a small disc may look like a soft one on a large
/// disc.
#[derive(Clone, Copy, Debug)]
pub(super) struct SizePrior {
    pub middle: [f64; 2],
    pub deviations: [f64; 2],
}

impl SizePrior {
    /// Deviations of pressure and radius from their middle, in standard deviations.
    pub fn off(&self, press: &Pressed) -> [f64; 2] {
        let logs = [press.log_pressure, press.log_radius];
        [0, 1].map(|k| (logs[k] - self.middle[k]) / self.deviations[k])
    }

    /// Slopes of half the penalty by both logarithms.
    pub fn slopes(&self, press: &Pressed) -> [f64; 2] {
        let off = self.off(press);
        [0, 1].map(|k| off[k] / self.deviations[k])
    }

    /// Curvatures of half the penalty by both logarithms.
    pub fn precisions(&self) -> [f64; 2] {
        self.deviations.map(|deviation| deviation.powi(-2))
    }

    /// Penalty of pressures and radii.
    pub fn penalty(&self, presses: &[Pressed]) -> f64 {
        presses.iter().flat_map(|press| self.off(press)).map(|off| off * off).sum()
    }
}
