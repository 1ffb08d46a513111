//! Search for starting positions of patches before a fit: all single positions and pairs on a coarse grid, then
//! triples and more that extend the best of those. Each set is judged by a model of ports. A port is a patch of
//! typical radius and conductance whose current distribution is fixed; ports are connected through the layer above,
//! like patches.

use pulp::{Arch, NullaryFnOnce};

use super::{ContactPatch, ContactSheet};
use crate::eit::EitError;
use crate::eit::protocol::Measurement;
use crate::mesh::{Point, distance};

/// Number of sets that are extended by one more port.
const EXTENDED: usize = 60;
/// Maximum number of ports in a set.
const MOST: usize = 4;
/// Number of channels processed in parallel.
const LANES: usize = 16;
/// Sets are first ranked on this many lanes of channels. Only the best are judged on all channels.
const RANKING_LANES: usize = 4;
const JUDGED: usize = 500;

/// Distribution of a port's current over its nodes.
type Shape = Vec<(usize, f64)>;

/// The ports of a sheet.
#[derive(Debug)]
pub struct PatchSearch {
    patches: Vec<ContactPatch>,
    /// Channels in the order of the lanes: the first lanes sample all stimulations and measuring patterns.
    order: Vec<usize>,
    /// Ports x ports, ohm. The diagonal holds each port's own resistance, including its contact.
    resistance: Vec<Vec<f64>>,
    /// Ports x channels: the effect of a single port, volts, and its potentials under the channel's stimulation and
    /// measuring pattern.
    alone_v: Vec<Vec<[f32; LANES]>>,
    driven: Vec<Vec<[f32; LANES]>>,
    measured: Vec<Vec<[f32; LANES]>>,
    /// Minimum distance between ports of a set, metres.
    apart_m: f64,
}

/// A set of ports and the energy of the data that it leaves unexplained.
#[derive(Clone, Debug)]
struct Candidate {
    ports: Ports,
    left: f64,
}

/// One to [`MOST`] ports.
#[derive(Clone, Copy, Debug)]
struct Ports {
    ports: [usize; MOST],
    count: usize,
}

impl Ports {
    fn one(port: usize) -> Self {
        Self { ports: [port; MOST], count: 1 }
    }

    fn list(&self) -> &[usize] {
        &self.ports[..self.count]
    }

    fn and(mut self, port: usize) -> Self {
        self.ports[self.count] = port;
        self.count += 1;
        self
    }
}

/// The sets for one frame, which grow by one patch at a time. [`PatchSearch::look`] searches one size after another,
/// since larger sets take longer and are rarely needed.
#[derive(Clone, Debug)]
pub struct PatchSets {
    /// Changes of the channels over their standard deviations, and the inverse standard deviations; 0 if missing.
    scaled: Vec<[f32; LANES]>,
    weight: Vec<[f32; LANES]>,
    /// Sets of the last size, best first.
    best: Vec<Candidate>,
    size: usize,
}

impl PatchSearch {
    /// Ports with this patch's radius and conductance at these positions (metres).
    ///
    /// # Errors
    /// As [`ContactSheet::change_v`].
    pub fn new(sheet: &ContactSheet, typical: ContactPatch, places_m: &[Point]) -> Result<Self, EitError> {
        let patches: Vec<ContactPatch> =
            places_m.iter().map(|&position_m| ContactPatch { position_m, ..typical }).collect();
        let mut shapes = Vec::with_capacity(patches.len());
        let (mut fields, mut alone_v, mut own) = (Vec::new(), Vec::new(), Vec::new());
        let order = scattered(sheet.channels());
        for patch in &patches {
            let touched = sheet.touch(&[*patch])?;
            let total: f64 = touched.common.iter().sum();
            let shape: Shape =
                touched.nodes.iter().zip(&touched.common).map(|(n, share)| (*n as usize, share / total)).collect();
            fields.push(
                (0..sheet.field_count())
                    .map(|t| shape.iter().map(|(n, share)| share * sheet.fields[(t, *n)]).sum())
                    .collect(),
            );
            alone_v.push(in_lanes(&order, &sheet.change_of(&touched)));
            own.push(1.0 / total);
            shapes.push(shape);
        }
        let resistance = resistances(sheet, &shapes, &own);
        let of_channels = |value: &dyn Fn(&Measurement, &[f64]) -> f64| -> Vec<Vec<[f32; LANES]>> {
            let of_port = |fields: &Vec<f64>| {
                in_lanes(&order, &sheet.measurements.iter().map(|m| value(m, fields)).collect::<Vec<_>>())
            };
            fields.iter().map(of_port).collect()
        };
        let driven = of_channels(&|m, fields| fields[m.stimulation as usize]);
        let measured = of_channels(&|m, fields| sheet.measured(m, |field| fields[field]));
        Ok(Self { patches, order, resistance, alone_v, driven, measured, apart_m: 1.5 * typical.radius_m })
    }

    /// Starts the search in changes of the channels (volts, non-finite if missing) with these standard deviations.
    ///
    /// # Errors
    /// Fails if a length is not the number of channels.
    pub fn begin(&self, sheet: &ContactSheet, change_v: &[f64], deviation_v: &[f64]) -> Result<PatchSets, EitError> {
        sheet.check_frame(change_v, deviation_v)?;
        let of_channels = |value: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
            let channels = change_v.iter().zip(deviation_v);
            channels.map(|(change, sigma)| if change.is_finite() { value(*change, *sigma) } else { 0.0 }).collect()
        };
        let (scaled, weight) = (of_channels(&|change, sigma| change / sigma), of_channels(&|_, sigma| 1.0 / sigma));
        let (scaled, weight) = (in_lanes(&self.order, &scaled), in_lanes(&self.order, &weight));
        Ok(PatchSets { scaled, weight, best: Vec::new(), size: 0 })
    }

    /// The best single patch, on later calls the best pair and so on up to four: starting points for a fit. `None` if
    /// there is no room for a larger set, or the set has four patches.
    pub fn look(&self, sets: &mut PatchSets) -> Option<Vec<ContactPatch>> {
        let mut grown = self.grow(sets);
        let lanes = sets.scaled.len();
        if grown.len() > JUDGED && lanes > RANKING_LANES {
            let mut ranked = self.judge(sets, &grown, RANKING_LANES);
            ranked.select_nth_unstable_by(JUDGED, |a, b| a.left.total_cmp(&b.left));
            grown = ranked[..JUDGED].iter().map(|candidate| candidate.ports).collect();
        }
        sets.best = self.judge(sets, &grown, lanes);
        sets.best.sort_by(|a, b| a.left.total_cmp(&b.left));
        sets.size += 1;
        let best = sets.best.first()?;
        Some(best.ports.list().iter().map(|&port| self.patches[port]).collect())
    }

    /// Most operations of the next call of [`PatchSearch::look`].
    pub fn operations(&self, sets: &PatchSets) -> f64 {
        let count = self.patches.len();
        let grown = match sets.size {
            0 => count,
            1 => count * count.saturating_sub(1) / 2,
            _ => EXTENDED * count,
        };
        let lanes = sets.scaled.len();
        let judged =
            if lanes > RANKING_LANES { RANKING_LANES * grown + lanes * JUDGED.min(grown) } else { lanes * grown };
        // Each port adds its effect, and each pair of them its part of the currents between them.
        (LANES * (sets.size + 1).pow(2) * judged) as f64
    }

    /// Judges sets of one size by the channels in the first lanes.
    fn judge(&self, sets: &PatchSets, grown: &[Ports], lanes: usize) -> Vec<Candidate> {
        let (scaled, weight) = (&sets.scaled[..lanes], &sets.weight[..lanes]);
        Arch::new().dispatch(Judge { search: self, scaled, weight, grown })
    }

    /// The sets of the next size.
    fn grow(&self, sets: &PatchSets) -> Vec<Ports> {
        let count = self.patches.len();
        if sets.size == 0 {
            return (0..count).map(Ports::one).collect();
        }
        let mut grown = Vec::new();
        // Try all pairs: one port between two touches explains much of the data but is a dead end.
        let extended = match sets.size {
            1 => count,
            MOST.. => 0,
            _ => EXTENDED,
        };
        for candidate in sets.best.iter().take(extended) {
            let first = if sets.size == 1 { candidate.ports.ports[0] + 1 } else { 0 };
            let list = candidate.ports.list();
            let room = |port: &usize| list.iter().all(|p| self.distance(*p, *port) >= self.apart_m);
            grown.extend((first..count).filter(room).map(|port| candidate.ports.and(port)));
        }
        grown
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        distance(self.patches[a].position_m, self.patches[b].position_m)
    }

    /// Whitened energy that a set leaves unexplained at its best scale. The currents of all ports but the last are
    /// the unknowns, since all currents sum to zero. With differences `d` of the fields from the last port's and
    /// `D_jk = R_jk - R_jn - R_nk + R_nn`, a channel changes by the sum of the single-port effects minus
    /// `d_m' D^-1 d_s`.
    #[inline(always)]
    fn left(&self, ports: &Ports, scaled: &[[f32; LANES]], weight: &[[f32; LANES]], energy: f64) -> f64 {
        let (ports, unknowns) = (ports.list(), ports.count - 1);
        let last = ports[unknowns];
        let mut loops = [[0.0; MOST - 1]; MOST - 1];
        for j in 0..unknowns {
            for k in 0..unknowns {
                let r = |a: usize, b: usize| self.resistance[a][b];
                loops[j][k] = r(ports[j], ports[k]) - r(ports[j], last) - r(last, ports[k]) + r(last, last);
            }
        }
        invert(&mut loops, unknowns);
        let loops = loops.map(|row| row.map(|value| value as f32));
        let mut sums = Sums::default();
        for (lane, (scaled, weight)) in scaled.iter().zip(weight).enumerate() {
            let mut values = self.alone_v[last][lane];
            for &port in &ports[..unknowns] {
                let alone = &self.alone_v[port][lane];
                for k in 0..LANES {
                    values[k] += alone[k];
                }
            }
            for (j, loops) in loops.iter().enumerate().take(unknowns) {
                let (mut driven, from) = ([0.0_f32; LANES], &self.driven[last][lane]);
                for (&port, by) in ports.iter().zip(loops).take(unknowns) {
                    let own = &self.driven[port][lane];
                    for k in 0..LANES {
                        driven[k] += by * (own[k] - from[k]);
                    }
                }
                let (own, from) = (&self.measured[ports[j]][lane], &self.measured[last][lane]);
                for k in 0..LANES {
                    values[k] -= (own[k] - from[k]) * driven[k];
                }
            }
            for k in 0..LANES {
                let value = values[k] * weight[k];
                sums.along[k] += value * scaled[k];
                sums.square[k] += value * value;
            }
        }
        sums.left(energy)
    }
}

/// Judges the sets in one loop, so that all of it is compiled for the vector instructions of the machine.
struct Judge<'a> {
    search: &'a PatchSearch,
    scaled: &'a [[f32; LANES]],
    weight: &'a [[f32; LANES]],
    grown: &'a [Ports],
}

impl NullaryFnOnce for Judge<'_> {
    type Output = Vec<Candidate>;

    #[inline(always)]
    fn call(self) -> Self::Output {
        let Self { search, scaled, weight, grown } = self;
        let energy = scaled.iter().flatten().map(|value| f64::from(*value).powi(2)).sum();
        let mut judged = Vec::with_capacity(grown.len());
        for &ports in grown {
            judged.push(Candidate { ports, left: search.left(&ports, scaled, weight, energy) });
        }
        judged
    }
}

/// Sums over the channels, by lane: projection of the values (volts) on the data, and the values' own square.
#[derive(Default)]
struct Sums {
    along: [f32; LANES],
    square: [f32; LANES],
}

impl Sums {
    /// Energy of the data that the values leave unexplained at their best scale.
    fn left(&self, energy: f64) -> f64 {
        let sum = |lanes: &[f32; LANES]| lanes.iter().copied().map(f64::from).sum::<f64>();
        let (along, square) = (sum(&self.along), sum(&self.square));
        if square > 0.0 && along > 0.0 { energy - along * along / square } else { energy }
    }
}

/// Ports x ports, with each port's own resistance on the diagonal.
fn resistances(sheet: &ContactSheet, shapes: &[Shape], own: &[f64]) -> Vec<Vec<f64>> {
    let green = sheet.green.whole();
    let mut resistance = vec![vec![0.0; shapes.len()]; shapes.len()];
    let mut potential = vec![0.0; sheet.positions_m.len()];
    for (a, shape) in shapes.iter().enumerate() {
        resistance[a][a] = own[a];
        potential.fill(0.0);
        for &(node, share) in shape {
            let column = green.col_as_slice(node);
            potential.iter_mut().zip(column).for_each(|(sum, value)| *sum += share * f64::from(*value));
        }
        for (b, other) in shapes[..a].iter().enumerate() {
            let mutual = other.iter().map(|&(node, share)| share * potential[node]).sum();
            (resistance[a][b], resistance[b][a]) = (mutual, mutual);
        }
    }
    resistance
}

/// Numbers below `count` in an order whose beginnings are spread evenly, by multiples of the golden ratio.
fn scattered(count: usize) -> Vec<usize> {
    const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by_key(|&channel| GOLDEN.wrapping_mul(channel as u64));
    order
}

/// Splits the channels into lanes in this order, padded with zeros.
fn in_lanes(order: &[usize], values: &[f64]) -> Vec<[f32; LANES]> {
    let lane = |channels: &[usize]| {
        let mut lane = [0.0; LANES];
        lane.iter_mut().zip(channels).for_each(|(lane, &channel)| *lane = values[channel] as f32);
        lane
    };
    order.chunks(LANES).map(lane).collect()
}

/// Inverts the leading block of this size in place by Gauss-Jordan elimination; it is positive definite.
fn invert(matrix: &mut [[f64; MOST - 1]; MOST - 1], size: usize) {
    for pivot in 0..size {
        let inverse = 1.0 / matrix[pivot][pivot];
        matrix[pivot][pivot] = 1.0;
        matrix[pivot][..size].iter_mut().for_each(|value| *value *= inverse);
        let lead = matrix[pivot];
        for (row, values) in matrix.iter_mut().enumerate().take(size) {
            if row != pivot {
                let factor = std::mem::replace(&mut values[pivot], 0.0);
                values[..size].iter_mut().zip(&lead).for_each(|(value, lead)| *value -= factor * lead);
            }
        }
    }
}
