//! Where patches may be, before they are fitted: all ones and twos of places on a coarse grid, and threes and more that
//! extend the best of those, each judged by a model of ports. A port is a patch of typical radius and conductance whose
//! current keeps its shape; ports are joined by the layer above, as patches are.

use super::{ContactPatch, ContactSheet};
use crate::eit::EitError;

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
    /// Ports x channels: what a port does by itself, volts.
    alone_v: Vec<Vec<f64>>,
    /// Ports closer than this are not taken together, metres.
    apart_m: f64,
}

/// A set of ports and how much of the data it leaves.
#[derive(Clone, Debug)]
struct Candidate {
    ports: Vec<usize>,
    left: f64,
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
        Ok(Self { patches, fields, resistance, alone_v, apart_m: 1.5 * typical.radius_m })
    }

    /// The best sets of one, two, ... `most` patches for changes of the channels (volts, not finite where missing) with
    /// these standard deviations: starts for [`ContactSheet::fit`].
    ///
    /// # Errors
    /// Lengths that are not the number of channels.
    pub fn starts(
        &self,
        sheet: &ContactSheet,
        change_v: &[f64],
        deviation_v: &[f64],
        most: usize,
    ) -> Result<Vec<Vec<ContactPatch>>, EitError> {
        sheet.check_frame(change_v, deviation_v)?;
        let scaled: Vec<f64> = change_v
            .iter()
            .zip(deviation_v)
            .map(|(change, sigma)| if change.is_finite() { change / sigma } else { 0.0 })
            .collect();
        let weight: Vec<f64> = change_v
            .iter()
            .zip(deviation_v)
            .map(|(change, sigma)| if change.is_finite() { 1.0 / sigma } else { 0.0 })
            .collect();
        let judge = |ports: Vec<usize>| {
            let left = self.left(sheet, &ports, &scaled, &weight);
            Candidate { ports, left }
        };
        let count = self.patches.len();
        let mut starts = Vec::with_capacity(most);
        let mut best: Vec<Candidate> = (0..count).map(|port| judge(vec![port])).collect();
        for size in 1..=most {
            if size > 1 {
                // All pairs are looked at, since one port between two touches explains much and leads nowhere.
                let extend = if size == 2 { &best[..] } else { &best[..best.len().min(EXTENDED)] };
                let mut sets: Vec<Vec<usize>> = Vec::new();
                for candidate in extend {
                    let last = if size == 2 { candidate.ports[0] + 1 } else { 0 };
                    let near = |port: &usize| candidate.ports.iter().any(|p| self.distance(*p, *port) < self.apart_m);
                    sets.extend((last..count).filter(|port| !near(port)).map(|port| {
                        let mut ports = candidate.ports.clone();
                        ports.push(port);
                        ports
                    }));
                }
                best = sets.into_iter().map(judge).collect();
            }
            best.sort_by(|a, b| a.left.total_cmp(&b.left));
            let Some(first) = best.first() else { break };
            starts.push(first.ports.iter().map(|&port| self.patches[port]).collect());
        }
        Ok(starts)
    }

    fn distance(&self, a: usize, b: usize) -> f64 {
        let (p, q) = (self.patches[a].position_m, self.patches[b].position_m);
        (p[0] - q[0]).hypot(p[1] - q[1])
    }

    /// Share of the whitened energy that a set leaves, at the scale that suits it best.
    fn left(&self, sheet: &ContactSheet, ports: &[usize], scaled: &[f64], weight: &[f64]) -> f64 {
        let exchange = self.exchange(ports, sheet.patterns());
        let (mut along, mut square, mut energy) = (0.0, 0.0, 0.0);
        for (channel, (measurement, (data, weight))) in
            sheet.measurements.iter().zip(scaled.iter().zip(weight)).enumerate()
        {
            let mut value: f64 = ports.iter().map(|&port| self.alone_v[port][channel]).sum();
            let measured = sheet.stimulations + measurement.pattern as usize;
            for (row, &port) in ports.iter().enumerate() {
                value -= self.fields[port][measured] * exchange[row][measurement.stimulation as usize];
            }
            let value = value * weight;
            along += value * data;
            square += value * value;
            energy += data * data;
        }
        if square > 0.0 && along > 0.0 { energy - along * along / square } else { energy }
    }

    /// Ports x patterns: currents of the ports into the layer, by Gauss and Jordan on the few unknowns (the ports' currents
    /// and the layer's potential).
    fn exchange(&self, ports: &[usize], patterns: usize) -> Vec<Vec<f64>> {
        let count = ports.len();
        let mut rows: Vec<Vec<f64>> = Vec::with_capacity(count + 1);
        for &a in ports {
            let mut row: Vec<f64> = ports.iter().map(|&b| self.resistance[a][b]).collect();
            row.push(1.0);
            row.extend(&self.fields[a]);
            rows.push(row);
        }
        let mut closing = vec![1.0; count];
        closing.resize(count + 1 + patterns, 0.0);
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
