//! The change of the channels by presses on plates, and the press as reported.

use std::f64::consts::PI;

use dermis_tomo::eit::EitError;
use dermis_tomo::eit::contacts::{ContactPatch, PatchSearch, PatchSets, PlateContact, PlatedSheet};
use dermis_tomo::mesh::{PixelGrid, Point, distance};

use super::law::{Conductance, PlateLaw};
use super::pressure::{Field, OF_PRESS, Pressed, normal, normal_exactly};
use super::profile::Profile;
use crate::press::{Effort, Press};

/// Largest change of a logarithm in one step.
pub(super) const LONGEST_LOG: f64 = 0.7;
/// Prior standard deviations of the logarithms of pressure and radius, and of the radius of an indenter that is known.
const LOG_DEVIATIONS: [f64; 2] = [1.0, 0.35];
const LOG_INDENTER: f64 = 0.02;
/// Pressures beyond this many deviations from the usual one are not tried: contact is saturated, or open.
const MOST_DEVIATIONS: f64 = 4.0;
/// Number of rings over which a contact is integrated.
const RINGS: usize = 48;
/// Number of steps from a reported press to the parameters of the fit.
const INVERSE_STEPS: usize = 30;
/// Largest area in contact, in areas of a typical press per press.
const MOST_TYPICAL: f64 = 6.0;
/// Least number of presses that this area allows for.
const FEWEST: usize = 3;
/// Operations of a solution and its derivatives: at least, per cell in contact, and per cell cubed. The last is for
/// the factorisation, in single precision. Fitted to the times of 18,000 solutions of up to 340 cells.
const LEAST_WORK: f64 = 7e4;
const WORK_PER_CELL: f64 = 5e3;
const WORK_PER_CUBED_CELL: f64 = 0.03;
/// Bisections for the radius of a contact: to a millionth of it.
const HALVINGS: usize = 20;

/// The contact that some presses make on one of the sheets.
#[derive(Clone, Debug)]
pub(super) struct Made {
    effort: Effort,
    /// Sign of the contact in the sum.
    sign: f64,
    contact: PlateContact,
    /// See [`Touched::moves`].
    moves: Vec<(usize, Vec<Moves>)>,
}

/// A point, and the derivatives of its conductance per area by the parameters of a press, S/m^2 per unit.
type Moves = (usize, [f64; OF_PRESS]);

/// The points under presses at which they make contact.
#[derive(Default)]
struct Touched {
    /// With their conductance per area, S/m^2.
    points: Vec<(usize, f64)>,
    /// For each press, by its index.
    moves: Vec<(usize, Vec<Moves>)>,
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
        let Touched { points, moves } = self.touched(all, &presses, effort);
        // Presses as large as the skin would take the time of many frames.
        let area_m2: f64 = points.iter().map(|(point, _)| self.sheet(effort).points()[*point].area_m2).sum();
        if area_m2 > MOST_TYPICAL * PI * self.options.typical_radius_m.powi(2) * presses.len().max(FEWEST) as f64 {
            return Err(EitError::Contact { radius_m: (area_m2 / PI).sqrt(), conductance_s_per_m2: 0.0 });
        }
        let contact = self.sheet(effort).contact(&points)?;
        Ok((!contact.is_open()).then_some(Made { effort, sign, contact, moves }))
    }

    /// The contact under some of the presses before it is solved for.
    fn touched(&self, all: &[Pressed], presses: &[usize], effort: Effort) -> Touched {
        let field = |&k: &usize| (k, Field::new(&all[k], self.law().spread_m));
        let fields: Vec<(usize, Field)> = presses.iter().map(field).collect();
        // Faint pressures make contact only where they add to another's.
        let contact_m: Vec<f64> =
            fields.iter().map(|(_, field)| field.reach_above_m(self.conductance.faint_pa())).collect();
        let are_apart = |a: usize, b: usize| {
            let distance_m = distance(all[presses[a]].position_m, all[presses[b]].position_m);
            distance_m > contact_m[a] + fields[b].1.reach_m() && distance_m > contact_m[b] + fields[a].1.reach_m()
        };
        if !(1..fields.len()).all(|a| (0..a).all(|b| are_apart(a, b))) {
            return self.touched_together(all, &fields, effort);
        }
        let sheet = self.sheet(effort);
        let mut touched = Touched::default();
        for ((k, field), contact_m) in fields.iter().zip(contact_m) {
            let profile = Profile::new(&all[*k], field, contact_m, &self.conductance);
            let mut moves = Vec::new();
            for range in sheet.points_near(all[*k].position_m, contact_m) {
                for (point, at) in range.clone().zip(&sheet.points()[range]) {
                    if let Some((conductance, by)) = profile.at(at.position_m) {
                        touched.points.push((point, conductance));
                        moves.push((point, by));
                    }
                }
            }
            touched.moves.push((*k, moves));
        }
        touched
    }

    /// As [`PlateModel::touched`], where presses overlap: their pressures add up.
    fn touched_together(&self, all: &[Pressed], fields: &[(usize, Field)], effort: Effort) -> Touched {
        let sheet = self.sheet(effort);
        let mut pressures: Vec<(usize, f64)> = Vec::new();
        for (k, field) in fields {
            for point in sheet.points_near(all[*k].position_m, field.reach_m()).flatten() {
                let pressure_pa = field.pressure_at(sheet.points()[point].position_m);
                pressures.extend((pressure_pa > 0.0).then_some((point, pressure_pa)));
            }
        }
        // The stable sort is quick, since the points of each press are in order.
        pressures.sort_by_key(|(point, _)| *point);
        pressures.dedup_by(|(point, pressure), (kept, sum)| {
            let is_same = point == kept;
            *sum += if is_same { *pressure } else { 0.0 };
            is_same
        });
        let mut touched = Touched::default();
        let mut slopes = Vec::new();
        for (point, pressure_pa) in pressures {
            let [conductance, slope] = self.conductance.at(pressure_pa);
            if conductance > 0.0 {
                touched.points.push((point, conductance));
                slopes.push((point, slope));
            }
        }
        for (k, field) in fields {
            let moved = |&(point, slope): &(usize, f64)| {
                let by = field.derivatives_at(sheet.points()[point].position_m)?;
                Some((point, by.map(|value| slope * value)))
            };
            touched.moves.push((*k, slopes.iter().filter_map(moved).collect()));
        }
        touched
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

    /// Logarithms of the load and the radius of a press as reported: those of a Gaussian spot of the same conductance
    /// and second moment. Frames determine the conductance far better than pressure and size of the indenter. The rows
    /// of the derivatives by both logarithms of the press are those of the reported ones.
    pub(super) fn reported(&self, log_pressure: f64, log_radius: f64) -> ([f64; 2], [[f64; 2]; 2]) {
        let (pressure_pa, disc_m, spread_m) = (log_pressure.exp(), log_radius.exp(), self.law().spread_m);
        let reach_m = disc_m + Field::REACH * spread_m;
        // The conductance and its second moment, each followed by its derivatives by both logarithms.
        let (mut total, mut second) = ([f64::MIN_POSITIVE, 0.0, 0.0], [0.0; 3]);
        for k in 0..RINGS {
            let share_of_reach = (k as f64 + 0.5) / RINGS as f64;
            let at_m = reach_m * share_of_reach;
            let [share, density] = normal((disc_m - at_m) / spread_m);
            let [g, slope] = self.conductance.at(pressure_pa * share);
            if g == 0.0 {
                continue;
            }
            // Rings move outwards as the disc grows.
            let moved_m = disc_m * share_of_reach;
            let by_pressure = slope * pressure_pa * share;
            let by_radius = slope * pressure_pa * density * (disc_m - moved_m) / spread_m;
            let ring = [at_m * g, at_m * by_pressure, at_m * by_radius + moved_m * g];
            let square = at_m * at_m;
            let ring_square = [ring[0], ring[1], ring[2] + 2.0 * moved_m * g].map(|value| square * value);
            for j in 0..3 {
                total[j] += ring[j];
                second[j] += ring_square[j];
            }
        }
        // A spot exp(-d^2 / (2 r^2)) has the second moment 2 r^2 and the integral 2 pi r^2.
        let square = (0.5 * second[0] / total[0]).max(f64::MIN_POSITIVE);
        let load = total[0] * reach_m / RINGS as f64 / (square * self.law().saturation_s_per_m2);
        let relative = |sums: [f64; 3], j: usize| if sums[0] > 0.0 { sums[j] / sums[0] } else { 0.0 };
        let of_square = [1, 2].map(|j| relative(second, j) - relative(total, j));
        let of_load = [relative(total, 1) - of_square[0], relative(total, 2) + disc_m / reach_m - of_square[1]];
        ([load.ln(), 0.5 * square.ln()], [of_load, of_square.map(|slope| 0.5 * slope)])
    }

    /// Force under a press, newtons: the integral of its pressure, `p pi ((R^2 + s^2) Phi(R/s) + R s phi(R/s))` with
    /// the normal distribution Phi and its density phi.
    pub(super) fn force_n(&self, press: &Pressed) -> f64 {
        let (radius_m, spread_m) = (press.log_radius.exp(), self.law().spread_m);
        let [below, density] = normal_exactly(radius_m / spread_m);
        let area_m2 = PI * ((radius_m * radius_m + spread_m * spread_m) * below + radius_m * spread_m * density);
        press.log_pressure.exp() * area_m2
    }

    /// Radius at which the contact under a press is half that in its middle, metres.
    pub(super) fn contact_radius_m(&self, press: &Pressed) -> f64 {
        let field = Field::new(press, self.law().spread_m);
        let middle_pa = field.pressure_at(press.position_m);
        let half = 0.5 * self.conductance.at(middle_pa)[0];
        let at = |distance_m: f64| field.pressure_at([press.position_m[0] + distance_m, press.position_m[1]]);
        let is_more = |distance_m: f64| self.conductance.at(at(distance_m))[0] > half;
        let (mut low, mut high) = (0.0, field.reach_m());
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if is_more(middle) { low = middle } else { high = middle }
        }
        0.5 * (low + high)
    }

    /// Derivative of the logarithm of the force with respect to the logarithm of the radius.
    pub(super) fn log_force_by_log_radius(&self, press: &Pressed) -> f64 {
        let h = 1e-4;
        let at = |step: f64| self.force_n(&Pressed { log_radius: press.log_radius + step, ..*press }).ln();
        (at(h) - at(-h)) / (2.0 * h)
    }

    /// Load and radius (metres) reported of a proposed press.
    pub(super) fn reported_typical(&self) -> [f64; 2] {
        let PlateOptions { typical_pa, typical_radius_m, .. } = self.options;
        self.reported(typical_pa.ln(), typical_radius_m.ln()).0.map(f64::exp)
    }

    /// The press in the parameters of the fit, within their limits, by Newton's method on both logarithms.
    pub(super) fn pressed(&self, press: &Press) -> Pressed {
        let wanted = [press.load.abs().max(1e-6).ln(), press.radius_m.ln()];
        let has_ended = press.load < 0.0;
        let mut at = Pressed { has_ended, ..self.typical(press.position_m) };
        for _ in 0..INVERSE_STEPS {
            let (reported, [[a, b], [c, d]]) = self.reported(at.log_pressure, at.log_radius);
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
    middle: [f64; 2],
    pub deviations: [f64; 2],
}

impl SizePrior {
    /// Deviations of pressure and radius from their middle, in standard deviations.
    pub fn off(&self, press: &Pressed) -> [f64; 2] {
        let logs = [press.log_pressure, press.log_radius];
        [0, 1].map(|k| (logs[k] - self.middle[k]) / self.deviations[k])
    }

    /// Penalty of pressures and radii.
    pub fn penalty(&self, presses: &[Pressed]) -> f64 {
        presses.iter().flat_map(|press| self.off(press)).map(|off| off * off).sum()
    }
}
