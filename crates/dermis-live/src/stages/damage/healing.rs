//! Healing of a fitted cut, from difference data against the intact skin. Three components are fitted: the remaining
//! share of the open cut's response, a rise of conductivity around it (heat heals, and leaves the sheet more
//! conductive) and a change of the whole sheet. The remaining share gives the joining of the faces. A healed scar is
//! not an intact sheet, so the length of sheet that it is equivalent to sets the scale. Once the rise has settled, a
//! new baseline is due.

use dermis_tomo::inner_product;

use super::crack::{Crack, CrackModel, CrackScratch};
use crate::prepare::Prepared;

/// Radii tried for the region of raised conductivity, metres: distances from the cut, and radii of a round pad on its
/// centre.
const ABOUT_M: [f64; 5] = [6e-3, 10e-3, 14e-3, 18e-3, 25e-3];
const ROUND_M: [f64; 7] = [10e-3, 13e-3, 16e-3, 20e-3, 25e-3, 30e-3, 40e-3];
/// Joinings at which responses are tabulated, 1/m: number, first value, and factor between neighbours.
const JOININGS: usize = 48;
const LEAST_JOINED_PER_M: f64 = 1.0;
const STEP: f64 = 1.2;
/// Model error in addition to the noise, as a share of the data's RMS.
const MODEL_ERROR: f64 = 0.03;
/// Number of entries in the history at which every second one is dropped.
const MOST_HISTORY: usize = 512;
/// The rise has settled if it changes by less than this in half of the time since its maximum.
const SETTLED: f64 = 0.02;

/// Healing of a damage site.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Healing {
    /// The damage.
    pub id: u64,
    /// Remaining share of the open cut's response. A healed scar keeps some of it.
    pub left: f64,
    /// Joined share of the faces: conductance across them relative to a healed scar's, 0 to about 1.
    pub joined: f64,
    /// Relative rise of the conductivity around it.
    pub rise: f64,
    /// The rise has settled, so a baseline taken now remains valid.
    pub settled: bool,
}

/// One cut with its tabulated responses.
#[derive(Debug)]
struct Watched {
    state: Healing,
    /// Response of the open cut.
    open: Vec<f64>,
    /// Responses to a rise within each radius.
    rises: Vec<Vec<f64>>,
    /// Remaining share of the open response at each joining.
    left_at: Vec<f64>,
    history: Vec<(u64, f64)>,
    /// Its contribution to the data in the last fit.
    fitted: Vec<f64>,
}

/// Follows the healing of fitted cuts.
#[derive(Debug, Default)]
pub(super) struct HealingMonitor {
    watched: Vec<Watched>,
    states: Vec<Healing>,
    weights: Vec<f64>,
    rest_of: Vec<f64>,
}

impl HealingMonitor {
    /// The state of every cut being followed.
    pub fn states(&self) -> &[Healing] {
        &self.states
    }

    /// The largest sum of squares of an open cut's response, among those being followed.
    pub fn open_square(&self) -> f64 {
        self.watched.iter().map(|watched| inner_product(&watched.open, &watched.open)).fold(0.0, f64::max)
    }

    /// Starts following a cut, replacing any with the same identity.
    pub fn follow(&mut self, id: u64, crack: &Crack, model: &CrackModel, prepared: &Prepared) {
        self.forget(id);
        let mut scratch = CrackScratch::default();
        let mut open = vec![0.0; model.channel_count()];
        if !model.respond(&Crack { joined_per_m: 0.0, ..*crack }, &mut scratch, &mut open) {
            return;
        }
        let square = inner_product(&open, &open);
        let mut response = open.clone();
        let left_at = (0..JOININGS).map(|step| {
            let joined_per_m = joining(step as f64);
            model.respond(&Crack { joined_per_m, ..*crack }, &mut scratch, &mut response);
            inner_product(&response, &open) / square
        });
        let left_at = left_at.collect();
        let mut rises = rise_responses(prepared, crack, &ABOUT_M);
        rises.extend(rise_responses(prepared, &Crack { length_m: 0.0, ..*crack }, &ROUND_M));
        let state = Healing { id, left: 1.0, joined: 0.0, rise: 0.0, settled: true };
        let fitted = vec![0.0; open.len()];
        self.watched.push(Watched { state, open, rises, left_at, history: Vec::new(), fitted });
        self.publish();
    }

    /// Stops following a cut.
    pub fn forget(&mut self, id: u64) {
        self.watched.retain(|watched| watched.state.id != id);
        self.publish();
    }

    /// Keeps only the cuts accepted by `keep`.
    pub fn retain(&mut self, keep: impl Fn(u64) -> bool) {
        self.watched.retain(|watched| keep(watched.state.id));
        self.publish();
    }

    /// Estimates healing from difference data (model volts, NaN where missing) of a mean over free frames.
    /// `healed_per_m` is the joining of a healed scar: one over the equivalent length of sheet.
    pub fn estimate(&mut self, time_ns: u64, difference: &[f64], noise: &[f64], rest: &[f64], healed_per_m: f64) {
        let energy: f64 = difference.iter().filter(|d| d.is_finite()).map(|d| d * d).sum();
        let floor = MODEL_ERROR * (energy / difference.len().max(1) as f64).sqrt();
        self.weights.clear();
        let weight = |(d, sigma): (&f64, &f64)| if d.is_finite() { 1.0 / sigma.hypot(floor).max(1e-300) } else { 0.0 };
        self.weights.extend(difference.iter().zip(noise).map(weight));
        for index in 0..self.watched.len() {
            self.rest_of.clear();
            self.rest_of.extend(difference.iter().map(|d| if d.is_finite() { *d } else { 0.0 }));
            for other in (0..self.watched.len()).filter(|other| *other != index) {
                self.rest_of.iter_mut().zip(&self.watched[other].fitted).for_each(|(sum, value)| *sum -= value);
            }
            let (weights, data) = (&self.weights, &self.rest_of);
            let watched = &mut self.watched[index];
            let Some((left, rise, radius)) = watched.fit(data, weights, rest) else { continue };
            let columns = watched.open.iter().zip(&watched.rises[radius]);
            watched.fitted.iter_mut().zip(columns).for_each(|(fitted, (o, r))| *fitted = left * o + rise * r);
            watched.note(time_ns, left, rise, healed_per_m);
        }
        self.publish();
    }

    fn publish(&mut self) {
        self.states.clear();
        self.states.extend(self.watched.iter().map(|watched| watched.state));
    }
}

impl Watched {
    /// Best-fitting remaining share of the response, rise, and index of its radius; neither value is negative.
    fn fit(&self, data: &[f64], weights: &[f64], rest: &[f64]) -> Option<(f64, f64, usize)> {
        let mut best: Option<(f64, (f64, f64, usize))> = None;
        for (radius, rises) in self.rises.iter().enumerate() {
            for with_rise in [true, false] {
                let columns: [&[f64]; 3] = [&self.open, rises, rest];
                let Some(([left, rise, _], cost)) = least_squares(columns, data, weights, with_rise) else { continue };
                if rise < 0.0 {
                    continue;
                }
                if best.is_none_or(|(least, _)| cost < least) {
                    best = Some((cost, (left.max(0.0), rise, radius)));
                }
            }
        }
        best.map(|(_, found)| found)
    }

    fn note(&mut self, time_ns: u64, left: f64, rise: f64, healed_per_m: f64) {
        let joined = self.joining_for(left) / healed_per_m;
        self.history.push((time_ns, rise));
        if self.history.len() > MOST_HISTORY {
            let mut index = 0;
            self.history.retain(|_| {
                index += 1;
                index % 2 == 0
            });
        }
        let highest = self.history.iter().max_by(|a, b| a.1.total_cmp(&b.1)).copied().unwrap_or((time_ns, rise));
        let half_ns = time_ns - (time_ns - highest.0) / 2;
        let then = self.history.iter().rev().find(|entry| entry.0 <= half_ns).map_or(rise, |entry| entry.1);
        let has_risen = highest.1 > SETTLED;
        let settled = !has_risen || (time_ns > highest.0 && (rise - then).abs() < SETTLED && half_ns < time_ns);
        self.state = Healing { left, joined, rise, settled, ..self.state };
    }

    /// The joining with this remaining share of the response, 1/m, linear between tabulated values.
    fn joining_for(&self, left: f64) -> f64 {
        let Some(above) = self.left_at.iter().position(|at| *at <= left) else { return joining((JOININGS - 1) as f64) };
        if above == 0 {
            // Below the smallest joining the response falls linearly from the open one.
            return LEAST_JOINED_PER_M * ((1.0 - left) / (1.0 - self.left_at[0])).clamp(0.0, 1.0);
        }
        let (before, after) = (self.left_at[above - 1], self.left_at[above]);
        joining((above - 1) as f64 + (before - left) / (before - after))
    }
}

fn joining(step: f64) -> f64 {
    LEAST_JOINED_PER_M * STEP.powf(step)
}

/// Changes of every channel per relative rise of conductivity within each of these distances of the cut, in ascending
/// order, model volts.
fn rise_responses(prepared: &Prepared, crack: &Crack, radii_m: &[f64]) -> Vec<Vec<f64>> {
    let (sin, cos) = crack.direction_rad.sin_cos();
    // Pixels between one distance and the next.
    let mut rings = vec![Vec::new(); radii_m.len()];
    for (pixel, [x, y, _]) in prepared.basis.positions.iter().enumerate() {
        let (dx, dy) = (x - crack.centre_m[0], y - crack.centre_m[1]);
        let along = ((dx * cos + dy * sin).abs() - 0.5 * crack.length_m).max(0.0);
        let distance_m = (dy * cos - dx * sin).hypot(along);
        if let Some(ring) = radii_m.iter().position(|radius_m| distance_m <= *radius_m) {
            rings[ring].push(pixel);
        }
    }
    let mut responses = vec![vec![0.0; prepared.channels()]; radii_m.len()];
    for channel in 0..prepared.channels() {
        let row = prepared.jacobian.row(channel);
        let mut sum = 0.0;
        for (response, ring) in responses.iter_mut().zip(&rings) {
            sum += ring.iter().map(|&pixel| row[pixel]).sum::<f64>();
            response[channel] = sum;
        }
    }
    responses
}

/// Weighted least squares in three columns, the second optional. Returns the factors and the cost.
fn least_squares(columns: [&[f64]; 3], data: &[f64], weights: &[f64], second: bool) -> Option<([f64; 3], f64)> {
    let mut system = [[0.0; 4]; 3];
    let mut energy = 0.0;
    for (channel, value) in data.iter().enumerate() {
        let w2 = weights[channel] * weights[channel];
        let row: [f64; 3] = std::array::from_fn(|k| if k == 1 && !second { 0.0 } else { columns[k][channel] });
        for a in 0..3 {
            (0..3).for_each(|b| system[a][b] += w2 * row[a] * row[b]);
            system[a][3] += w2 * row[a] * value;
        }
        energy += w2 * value * value;
    }
    if !second {
        system[1][1] = 1.0;
    }
    let right = system.map(|row| row[3]);
    for pivot in 0..3 {
        let diagonal = system[pivot][pivot];
        if !(diagonal > 0.0 && diagonal.is_finite()) {
            return None;
        }
        let scaled = system[pivot].map(|value| value / diagonal);
        for row in 0..3 {
            if row != pivot {
                let factor = system[row][pivot];
                (0..4).for_each(|column| system[row][column] -= factor * scaled[column]);
            }
        }
        system[pivot] = scaled;
    }
    let found = system.map(|row| row[3]);
    Some((found, energy - inner_product(&found, &right)))
}
