//! Diagnoses the channel order. A measured baseline is compared with the model's voltages in the stated order and in
//! the orders that instruments are known to confuse it with.
//!
//! The baseline of a rotationally symmetric body cannot reveal a rotated *body*. This finds rotated, reversed or
//! re-sorted *lists*, and flipped signs.

use super::protocol::Protocol;

/// A rearrangement of a protocol's channels: entry `i` of the file is channel `source[i]` of the protocol, times
/// `sign`.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelMap {
    /// Channel of the protocol for each position in the file.
    pub source: Vec<u32>,
    /// +1 or -1, common to all channels.
    pub sign: f64,
}

impl ChannelMap {
    /// Reorders a frame from the file's order to the protocol's order.
    pub fn to_protocol(&self, frame: &[f64]) -> Vec<f64> {
        let mut ordered = vec![f64::NAN; frame.len()];
        for (value, &channel) in frame.iter().zip(&self.source) {
            ordered[channel as usize] = self.sign * value;
        }
        ordered
    }
}

/// A hypothesis about the order and how well it fits.
#[derive(Clone, Debug, PartialEq)]
pub struct OrderFit {
    /// Description for the user.
    pub description: String,
    /// Pearson correlation with the model under this hypothesis.
    pub correlation: f64,
    /// The rearrangement.
    pub map: ChannelMap,
}

/// Outcome of [`diagnose_order`].
#[derive(Clone, Debug, PartialEq)]
pub struct OrderReport {
    /// Correlation with the model in the stated order.
    pub correlation: f64,
    /// The best other hypothesis, if it fits clearly better (by 0.05 or more).
    pub better: Option<OrderFit>,
}

/// Minimum gain in correlation for a more complex hypothesis to be preferred.
const MARGIN: f64 = 0.05;
/// Minimum correlation of an acceptable hypothesis. With shuffled channels, the best of all hypotheses reaches 0.5.
const LEAST: f64 = 0.8;

/// Compares measured baseline voltages with the model's, both in channels of `protocol`. `NaN` channels are left out.
/// With `magnitudes`, absolute values are compared and the sign is not checked.
pub fn diagnose_order(protocol: &Protocol, model: &[f64], measured: &[f64], magnitudes: bool) -> OrderReport {
    let prepare = |values: &[f64]| -> Vec<f64> {
        values.iter().map(|value| if magnitudes { value.abs() } else { *value }).collect()
    };
    let (model, measured) = (prepare(model), prepare(measured));
    let stated = correlation(&model, &measured);
    let mut best: Option<OrderFit> = None;
    for (description, source) in hypotheses(protocol) {
        let predicted: Vec<f64> = source.iter().map(|&channel| model[channel as usize]).collect();
        let fit = correlation(&predicted, &measured);
        let flipped = !magnitudes && fit < 0.0;
        let (value, sign) = if flipped { (-fit, -1.0) } else { (fit, 1.0) };
        let bar = best.as_ref().map_or(stated, |fit: &OrderFit| fit.correlation);
        if value > bar + MARGIN {
            let description = match (flipped, description.is_empty()) {
                (true, true) => "sign reversed".to_string(),
                (true, false) => format!("{description}, sign reversed"),
                (false, _) => description,
            };
            best = Some(OrderFit { description, correlation: value, map: ChannelMap { source, sign } });
        }
    }
    OrderReport { correlation: stated, better: best.filter(|fit| fit.correlation >= LEAST) }
}

/// Pearson correlation over the positions where both values are finite; 0 if either is constant.
pub fn correlation(a: &[f64], b: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> =
        a.iter().zip(b).map(|(x, y)| (*x, *y)).filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let count = pairs.len() as f64;
    let (mean_a, mean_b) =
        (pairs.iter().map(|p| p.0).sum::<f64>() / count, pairs.iter().map(|p| p.1).sum::<f64>() / count);
    let sum = |f: &dyn Fn(f64, f64) -> f64| pairs.iter().map(|p| f(p.0 - mean_a, p.1 - mean_b)).sum::<f64>();
    let scale = (sum(&|x, _| x * x) * sum(&|_, y| y * y)).sqrt();
    if scale > 0.0 { sum(&|x, y| x * y) / scale } else { 0.0 }
}

/// Sort key for the channels of one drive.
type SortKey = fn(&Protocol, u32) -> i64;

/// Ordered from simple to complex, so that the simplest of equally good ones wins. The first is the stated order.
fn hypotheses(protocol: &Protocol) -> Vec<(String, Vec<u32>)> {
    let groups = channels_by_stimulation(protocol);
    let mut list = Vec::new();
    let orders: [(&str, SortKey); 4] = [
        ("", |_, channel| channel as i64),
        ("measurements sorted by absolute electrode number", |p, c| first_electrode(p, c)),
        ("measurements rotating from the drive pair", |p, c| {
            (first_electrode(p, c) - drive_electrode(p, c)).rem_euclid(count(p))
        }),
        ("measurements in reverse order", |_, channel| -(channel as i64)),
    ];
    let bases: Vec<(&str, Vec<Vec<u32>>)> = orders
        .iter()
        .map(|(name, key)| {
            let sorted = groups.iter().map(|group| {
                let mut group = group.clone();
                group.sort_by_key(|&channel| key(protocol, channel));
                group
            });
            (*name, sorted.collect())
        })
        .collect();
    for (name, base) in &bases {
        list.push((name.to_string(), base.concat()));
    }
    for (name, base) in &bases {
        let longest = base.iter().map(Vec::len).max().unwrap_or(0);
        let prefix = if name.is_empty() { String::new() } else { format!("{name}, ") };
        for shift in 1..longest {
            let rotated = base.iter().flat_map(|group| {
                let by = shift % group.len().max(1);
                group[by..].iter().chain(&group[..by]).copied()
            });
            list.push((format!("{prefix}measurement list rotated by {shift}"), rotated.collect()));
        }
        for shift in 1..base.len() {
            if base.iter().all(|group| group.len() == base[0].len()) {
                let rotated = base[shift..].iter().chain(&base[..shift]).flatten().copied();
                list.push((format!("{prefix}drive list rotated by {shift}"), rotated.collect()));
            }
        }
    }
    list
}

fn channels_by_stimulation(protocol: &Protocol) -> Vec<Vec<u32>> {
    let mut groups = vec![Vec::new(); protocol.stimulations().len()];
    for (channel, measurement) in protocol.measurements().iter().enumerate() {
        groups[measurement.stimulation as usize].push(channel as u32);
    }
    groups
}

fn count(protocol: &Protocol) -> i64 {
    protocol.electrode_count() as i64
}

/// First electrode of a pattern: the positive one of a measuring pair.
fn first_electrode(protocol: &Protocol, channel: u32) -> i64 {
    let entries = protocol.pattern_of(channel as usize).entries();
    entries.iter().max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |entry| entry.0 as i64)
}

/// First electrode of a drive pair: the sink.
fn drive_electrode(protocol: &Protocol, channel: u32) -> i64 {
    let entries = protocol.stimulation_of(channel as usize).entries();
    entries.iter().min_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |entry| entry.0 as i64)
}

impl Protocol {
    /// The reciprocal of each channel, with drive and measurement swapped, and the factor that makes its voltage
    /// equal (the ratio of the drive amplitudes, with sign); `None` if it is not measured. Geselowitz (1971):
    /// transfer impedances do not change when drive and measurement are swapped.
    pub fn reciprocal_channels(&self) -> Vec<Option<(u32, f64)>> {
        let first = |pattern: &super::Pattern| pattern.entries().first().map_or(1.0, |entry| entry.1);
        let known: std::collections::HashMap<_, u32> = (0..self.channel_count())
            .map(|c| ((unsigned(self.stimulation_of(c)).0, unsigned(self.pattern_of(c)).0), c as u32))
            .collect();
        (0..self.channel_count())
            .map(|channel| {
                let (drive, read) = (self.stimulation_of(channel), self.pattern_of(channel));
                let &other = known.get(&(unsigned(read).0, unsigned(drive).0))?;
                let (other_drive, other_read) = (self.stimulation_of(other as usize), self.pattern_of(other as usize));
                let ratio = first(drive) * first(read) / (first(other_drive) * first(other_read));
                (other as usize != channel).then_some((other, ratio))
            })
            .collect()
    }

    /// For each channel of `file`, the channel of this protocol with the same reading, and the factor between the two
    /// (-1 if drive or reading is reversed). Reciprocal channels have the same reading. `None` unless the channels of
    /// the two protocols match one to one.
    pub fn same_channels(&self, file: &Self) -> Option<(Vec<u32>, Vec<f64>)> {
        if self.channel_count() != file.channel_count() {
            return None;
        }
        let mut known: std::collections::HashMap<_, Vec<(u32, f64)>> = std::collections::HashMap::new();
        for channel in (0..self.channel_count()).rev() {
            let (drive, a) = unsigned(self.stimulation_of(channel));
            let (read, b) = unsigned(self.pattern_of(channel));
            known.entry((drive, read)).or_default().push((channel as u32, a * b));
        }
        let (mut source, mut signs) = (vec![u32::MAX; file.channel_count()], vec![1.0; file.channel_count()]);
        // Match channels as they are first; the rest may match with drive and measurement swapped.
        for reciprocal in [false, true] {
            for channel in 0..file.channel_count() {
                if source[channel] != u32::MAX {
                    continue;
                }
                let (drive, a) = unsigned(file.stimulation_of(channel));
                let (read, b) = unsigned(file.pattern_of(channel));
                let key = if reciprocal { (read, drive) } else { (drive, read) };
                if let Some((own, sign)) = known.get_mut(&key).and_then(Vec::pop) {
                    (source[channel], signs[channel]) = (own, sign * a * b);
                }
            }
        }
        source.iter().all(|own| *own != u32::MAX).then_some((source, signs))
    }

    /// The channels after renaming electrode `k` to `relabel[k]`: channel `i` becomes channel `source[i]` times
    /// `sign[i]`, if the renamed protocol has the same channels. Symmetries of a skin are such renamings.
    pub fn relabelled(&self, relabel: &[u32]) -> Option<(Vec<u32>, Vec<f64>)> {
        let rename = |pattern: &super::Pattern| {
            super::Pattern::new(pattern.entries().iter().map(|&(e, w)| (relabel[e as usize], w)).collect())
        };
        let key = |stimulation: &super::Pattern, pattern: &super::Pattern| {
            let (stimulation, first) = unsigned(stimulation);
            let (pattern, second) = unsigned(pattern);
            ((stimulation, pattern), first * second)
        };
        let known: std::collections::HashMap<_, (u32, f64)> = (0..self.channel_count())
            .map(|channel| {
                let (key, sign) = key(self.stimulation_of(channel), self.pattern_of(channel));
                (key, (channel as u32, sign))
            })
            .collect();
        let mut source = Vec::with_capacity(self.channel_count());
        let mut signs = Vec::with_capacity(self.channel_count());
        for channel in 0..self.channel_count() {
            let (key, sign) = key(&rename(self.stimulation_of(channel)), &rename(self.pattern_of(channel)));
            let &(target, target_sign) = known.get(&key)?;
            source.push(target);
            signs.push(sign * target_sign);
        }
        Some((source, signs))
    }
}

/// A pattern divided by its first weight, so that opposite patterns look alike, and the sign of that weight.
fn unsigned(pattern: &super::Pattern) -> (Vec<(u32, i64)>, f64) {
    let first = pattern.entries().first().map_or(1.0, |entry| entry.1);
    let rounded = pattern.entries().iter().map(|&(e, w)| (e, (w / first * 1e9).round() as i64)).collect();
    (rounded, first.signum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::eit::{Drive, Driven, Measure, Order, ProtocolSpec};

    fn protocol(order: Order) -> Protocol {
        let spec = ProtocolSpec {
            electrode_count: 16,
            drive: Drive::Adjacent,
            measure: Measure::Adjacent,
            order,
            driven: Driven::Drop,
            amplitude_a: 1.0,
        };
        Protocol::generate(&spec).unwrap()
    }

    /// The field of a current dipole on the rim of a half-plane, a sufficient imitation of a tank.
    fn voltages(protocol: &Protocol) -> Vec<f64> {
        let position = |e: u32| (std::f64::consts::TAU * e as f64 / 16.0).sin_cos();
        let green = |a: u32, b: u32| {
            let ((s1, c1), (s2, c2)) = (position(a), position(b));
            -(((s1 - s2).powi(2) + (c1 - c2).powi(2)).max(1e-3)).ln()
        };
        (0..protocol.channel_count())
            .map(|channel| {
                let mut sum = 0.0;
                for &(e, w) in protocol.pattern_of(channel).entries() {
                    for &(d, i) in protocol.stimulation_of(channel).entries() {
                        sum += w * i * green(e, d);
                    }
                }
                sum
            })
            .collect()
    }

    #[test]
    fn rotating_files_read_as_absolute_are_found() {
        let (absolute, rotating) = (protocol(Order::Absolute), protocol(Order::Rotating));
        let (model, file) = (voltages(&absolute), voltages(&rotating));
        let report = diagnose_order(&absolute, &model, &file, false);
        assert!(report.correlation < 0.5, "{}", report.correlation);
        let better = report.better.unwrap();
        assert_eq!(better.description, "measurements rotating from the drive pair");
        assert!(better.correlation > 0.999);
        assert_eq!(better.map.to_protocol(&file), model);
    }

    #[test]
    fn sign_and_rotation_of_the_list_are_found() {
        let absolute = protocol(Order::Absolute);
        let model = voltages(&absolute);
        let negative: Vec<f64> = model.iter().map(|v| -v).collect();
        assert_eq!(diagnose_order(&absolute, &model, &negative, false).better.unwrap().description, "sign reversed");
        let mut late = model.clone();
        late.rotate_left(13 * 3);
        assert!(diagnose_order(&absolute, &model, &late, false).better.is_some());
        assert!(diagnose_order(&absolute, &model, &model, false).better.is_none());
    }

    #[test]
    fn shuffled_channels_fit_no_order() {
        let absolute = protocol(Order::Absolute);
        let model = voltages(&absolute);
        // 101 and 208 are coprime.
        let shuffled: Vec<f64> = (0..208).map(|k| model[k * 101 % 208]).collect();
        let report = diagnose_order(&absolute, &model, &shuffled, false);
        assert!(report.correlation < 0.5 && report.better.is_none(), "{report:?}");
    }

    #[test]
    fn the_same_channels_are_found_in_any_order_and_either_way_round() {
        let absolute = protocol(Order::Absolute);
        let model = voltages(&absolute);
        let mut channels: Vec<_> = (0..208)
            .map(|k| {
                let stimulation = absolute.measurements()[k].stimulation as usize;
                let turned = absolute.pattern_of(k).entries().iter().map(|&(e, w)| (e, -w)).collect();
                (crate::eit::Pattern::new(turned), stimulation)
            })
            .collect();
        channels.reverse();
        let file = Protocol::from_patterns(16, absolute.stimulations().to_vec(), channels).unwrap();
        let (source, signs) = absolute.same_channels(&file).unwrap();
        for (k, value) in voltages(&file).into_iter().enumerate() {
            assert!((signs[k] * value - model[source[k] as usize]).abs() < 1e-12);
        }
        assert!(absolute.same_channels(&protocol(Order::Rotating)).is_some());
        let mut twice: Vec<_> = (0..208).map(|k| (file.pattern_of(k).clone(), 0)).collect();
        twice[1] = twice[0].clone();
        let twice = Protocol::from_patterns(16, absolute.stimulations().to_vec(), twice).unwrap();
        assert!(absolute.same_channels(&twice).is_none());
    }

    #[test]
    fn reciprocal_channels_swap_drive_and_measurement() {
        let absolute = protocol(Order::Absolute);
        let model = voltages(&absolute);
        for (channel, partner) in absolute.reciprocal_channels().into_iter().enumerate() {
            let (other, ratio) = partner.expect("adjacent channels all have a partner");
            assert!((model[channel] - ratio * model[other as usize]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_rotation_of_the_electrodes_permutes_the_channels() {
        let absolute = protocol(Order::Absolute);
        let rotated: Vec<u32> = (0..16).map(|k| (k + 3) % 16).collect();
        let (source, sign) = absolute.relabelled(&rotated).unwrap();
        let model = voltages(&absolute);
        for channel in 0..208 {
            assert!((sign[channel] * model[source[channel] as usize] - model[channel]).abs() < 1e-9);
        }
        let broken: Vec<u32> = (0..16)
            .map(|k| {
                if k == 0 {
                    5
                } else if k == 5 {
                    0
                } else {
                    k
                }
            })
            .collect();
        assert!(absolute.relabelled(&broken).is_none());
    }
}
