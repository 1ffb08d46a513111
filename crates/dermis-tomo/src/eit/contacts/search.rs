//! Where patches may be, before they are fitted: all ones and twos of places on a coarse grid, and threes and more that
//! extend the best of those, each judged by a model of ports. A port is a patch of typical radius and conductance whose
//! current keeps its shape; ports are joined by the layer above, as patches are.

use super::{ContactPatch, ContactSheet};
use crate::eit::EitError;
use crate::eit::protocol::Measurement;

/// Sets that are extended by one more port.
const EXTENDED: usize = 12;

/// The ports of a sheet.
#[derive(Debug)]
pub struct PatchSearch {
    patches: Vec<ContactPatch>,
    /// Ports x patterns: potential of the bare sheet at a port.
    fields: Vec<Vec<f64>>,
    /// Ports x ports, ohm: on the diagonal a port's own resistance, contact included.
    resistance: Vec<Vec<f64>>,
    /// Ports x channels: what a port does by itself, volts, and its potentials under the channel's stimulation and measuring
    /// pattern.
    alone_v: Vec<Vec<f64>>,
    driven: Vec<Vec<f64>>,
    measured: Vec<Vec<f64>>,
    /// Ports closer than this are not taken together, metres.
    apart_m: f64,
}

/// A set of ports and how much of the data it leaves.
#[derive(Clone, Debug)]
struct Candidate {
    ports: Vec<usize>,
    left: f64,
}

/// The sets of one frame, larger by a patch each time: [`PatchSearch::next`] looks for them one size after the other, since
/// larger sets take longer and are seldom needed.
#[derive(Clone, Debug)]
pub struct PatchSets {
    /// Changes of the channels over their standard deviations, and one over these; 0 where missing.
    scaled: Vec<f64>,
    weight: Vec<f64>,
    /// Those of the last size, best first.
    best: Vec<Candidate>,
    size: usize,
}

impl PatchSearch {
    /// Ports of this patch's radius and conductance at these places (metres).
    ///
    /// # Errors
    /// As [`ContactSheet::change_v`].
    pub fn new(sheet: &ContactSheet, typical: ContactPatch, places_m: &[[f64; 2]]) -> Result<Self, EitError> {
        let patches: Vec<ContactPatch> =
            places_m.iter().map(|&position_m| ContactPatch { position_m, ..typical }).collect();
        let mut shapes = Vec::with_capacity(patches.len());
        let (mut fields, mut alone_v, mut own) = (Vec::new(), Vec::new(), Vec::new());
        for patch in &patches {
            let touched = sheet.touch(&[*patch])?;
            let total: f64 = touched.common.iter().sum();
            let shape: Vec<(usize, f64)> =
                touched.nodes.iter().zip(&touched.common).map(|(n, share)| (*n as usize, share / total)).collect();
            fields.push(
                (0..sheet.patterns())
                    .map(|t| shape.iter().map(|(n, share)| share * sheet.fields[(t, *n)]).sum())
                    .collect(),
            );
            alone_v.push(sheet.change_of(&touched));
            own.push(1.0 / total);
            shapes.push(shape);
        }
        let count = patches.len();
        let mut resistance = vec![vec![0.0; count]; count];
        for a in 0..count {
            resistance[a][a] = own[a];
            for b in 0..a {
                let green = |p: &(usize, f64)| -> f64 {
                    shapes[b].iter().map(|q| q.1 * f64::from(sheet.green[(p.0, q.0)])).sum::<f64>() * p.1
                };
                let mutual = shapes[a].iter().map(green).sum();
                (resistance[a][b], resistance[b][a]) = (mutual, mutual);
            }
        }
        let of_channels = |pattern: &dyn Fn(&Measurement) -> usize| -> Vec<Vec<f64>> {
            let of_port = |fields: &Vec<f64>| sheet.measurements.iter().map(|m| fields[pattern(m)]).collect();
            fields.iter().map(of_port).collect()
        };
        let driven = of_channels(&|m| m.stimulation as usize);
        let measured = of_channels(&|m| sheet.stimulations + m.pattern as usize);
        Ok(Self { patches, fields, resistance, alone_v, driven, measured, apart_m: 1.5 * typical.radius_m })
    }

    /// Begins the search in changes of the channels (volts, not finite where missing) with these standard deviations.
    ///
    /// # Errors
    /// Lengths that are not the number of channels.
    pub fn begin(&self, sheet: &ContactSheet, change_v: &[f64], deviation_v: &[f64]) -> Result<PatchSets, EitError> {
        sheet.check_frame(change_v, deviation_v)?;
        let of_channels = |value: &dyn Fn(f64, f64) -> f64| -> Vec<f64> {
            let channels = change_v.iter().zip(deviation_v);
            channels.map(|(change, sigma)| if change.is_finite() { value(*change, *sigma) } else { 0.0 }).collect()
        };
        let (scaled, weight) = (of_channels(&|change, sigma| change / sigma), of_channels(&|_, sigma| 1.0 / sigma));
        Ok(PatchSets { scaled, weight, best: Vec::new(), size: 0 })
    }

    /// The best set of one patch, at the next call of two, and so on: starts for [`ContactSheet::fit`]. `None` where no more
    /// patches find room.
    pub fn next(&self, sheet: &ContactSheet, sets: &mut PatchSets) -> Option<Vec<ContactPatch>> {
        let count = self.patches.len();
        let grown: Vec<Vec<usize>> = match sets.size {
            0 => (0..count).map(|port| vec![port]).collect(),
            size => {
                // All pairs are looked at, since one port between two touches explains much and leads nowhere.
                let extended = if size == 1 { count } else { EXTENDED.min(sets.best.len()) };
                let grown = |candidate: &Candidate| {
                    let ports = candidate.ports.clone();
                    let first = if size == 1 { ports[0] + 1 } else { 0 };
                    let room = |port: &usize| ports.iter().all(|p| self.distance(*p, *port) >= self.apart_m);
                    let free: Vec<usize> = (first..count).filter(room).collect();
                    free.into_iter().map(move |port| ports.iter().copied().chain([port]).collect())
                };
                sets.best.iter().take(extended).flat_map(grown).collect()
            }
        };
        let judge = |ports: Vec<usize>| {
            let left = self.left(sheet, &ports, &sets.scaled, &sets.weight);
            Candidate { ports, left }
        };
        sets.best = grown.into_iter().map(judge).collect();
        sets.best.sort_by(|a, b| a.left.total_cmp(&b.left));
        sets.size += 1;
        Some(sets.best.first()?.ports.iter().map(|&port| self.patches[port]).collect())
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        let (p, q) = (self.patches[a].position_m, self.patches[b].position_m);
        (p[0] - q[0]).hypot(p[1] - q[1])
    }

    /// Whitened energy that a set leaves, at the scale that suits it best.
    fn left(&self, sheet: &ContactSheet, ports: &[usize], scaled: &[f64], weight: &[f64]) -> f64 {
        match *ports {
            [a] => left_by(self.alone_v[a].iter().copied(), scaled, weight),
            // What current flows between two is one unknown.
            [a, b] => {
                let loops = self.resistance[a][a] + self.resistance[b][b] - 2.0 * self.resistance[a][b];
                let alone = self.alone_v[a].iter().zip(&self.alone_v[b]);
                let driven = self.driven[a].iter().zip(&self.driven[b]);
                let measured = self.measured[a].iter().zip(&self.measured[b]);
                let value = |((alone, driven), measured): (((&f64, &f64), (&f64, &f64)), (&f64, &f64))| {
                    alone.0 + alone.1 - (driven.0 - driven.1) * (measured.0 - measured.1) / loops
                };
                left_by(alone.zip(driven).zip(measured).map(value), scaled, weight)
            }
            _ => {
                let exchange = self.exchange(ports, sheet.stimulations);
                let value = |(channel, measurement): (usize, &Measurement)| {
                    let of_port = |(row, &port): (usize, &usize)| {
                        let current = exchange[row][measurement.stimulation as usize];
                        self.alone_v[port][channel] - self.measured[port][channel] * current
                    };
                    ports.iter().enumerate().map(of_port).sum()
                };
                left_by(sheet.measurements.iter().enumerate().map(value), scaled, weight)
            }
        }
    }

    /// Ports x stimulations: currents of the ports into the layer, by Gauss and Jordan on the few unknowns (the ports' currents
    /// and the layer's potential).
    fn exchange(&self, ports: &[usize], stimulations: usize) -> Vec<Vec<f64>> {
        let count = ports.len();
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(count + 1);
        for &a in ports {
            let mut row: Vec<f64> = ports.iter().map(|&b| self.resistance[a][b]).collect();
            row.push(1.0);
            row.extend(&self.fields[a][..stimulations]);
            rows.push(row);
        }
        let mut closing = vec![1.0; count];
        closing.resize(count + 1 + stimulations, 0.0);
        rows.push(closing);
        for pivot in 0..=count {
            // Resistances are positive definite, and the last pivot is then negative: no exchange of rows is needed.
            let inverse = 1.0 / rows[pivot][pivot];
            rows[pivot].iter_mut().for_each(|value| *value *= inverse);
            let lead = rows[pivot].clone();
            for (index, row) in rows.iter_mut().enumerate() {
                let factor = row[pivot];
                if index != pivot && factor != 0.0 {
                    row.iter_mut().zip(&lead).for_each(|(value, lead)| *value -= factor * lead);
                }
            }
        }
        rows.truncate(count);
        rows.iter_mut().for_each(|row| {
            row.drain(..=count);
        });
        rows
    }
}

/// Whitened energy that values of the channels (volts) leave of the data, at the scale that suits them best.
fn left_by(values: impl Iterator<Item = f64>, scaled: &[f64], weight: &[f64]) -> f64 {
    let (mut along, mut square, mut energy) = (0.0, 0.0, 0.0);
    for (value, (data, weight)) in values.zip(scaled.iter().zip(weight)) {
        let value = value * weight;
        along += value * data;
        square += value * value;
        energy += data * data;
    }
    if square > 0.0 && along > 0.0 { energy - along * along / square } else { energy }
}
