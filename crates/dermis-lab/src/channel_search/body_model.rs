//! A body described by its transfer impedances, and the search over all orders in which its readings may come.

use dermis_skin::{DrivePattern, MeasurePattern, Modality, Skin};
use dermis_tomo::eit::ForwardModel;
use rayon::prelude::*;

use super::hypothesis::{Arrangement, Cell, DEPARTURE, Hypothesis, Nesting, Pairs, Read, Reading, Shape, score};
use crate::Error;

/// Numbers of electrodes to try when the skin is unknown.
pub(super) const ELECTRODES: std::ops::RangeInclusive<usize> = 4..=128;

/// A hypothesis with its correlation.
pub(super) type Scored = (f64, Hypothesis);

/// Limit on the readings compared in one search; takes a few seconds.
const MOST_WORK: usize = 4_000_000_000;
/// Number of hypotheses to keep from each stage.
const KEPT: usize = 24;
/// Number of shapes to try with renumbered electrodes as well.
const RENUMBERED: usize = 24;

/// The measured frame, prepared for comparison.
pub(super) struct Data {
    /// Readings less their mean, divided by their norm; 0 where nothing was measured. `magnitudes` holds the same for
    /// the absolute values.
    signed: Vec<f64>,
    magnitudes: Vec<f64>,
    is_measured: Vec<bool>,
    /// Sorted readings, and their sorted magnitudes.
    sorted: [Vec<f64>; 2],
    /// No reading is negative, so they may be magnitudes.
    rectified: bool,
    only_rectified: bool,
}

impl Data {
    /// Set `only_rectified` if the readings are known to be magnitudes.
    pub(super) fn new(measured: &[f64], only_rectified: bool) -> Self {
        let is_measured: Vec<bool> = measured.iter().map(|value| value.is_finite()).collect();
        let finite = || measured.iter().copied().filter(|value| value.is_finite());
        let sorted = |of: fn(f64) -> f64| {
            let mut values: Vec<f64> = finite().map(of).collect();
            values.sort_by(f64::total_cmp);
            values
        };
        Self {
            signed: normalised(measured, &is_measured, |value| value),
            magnitudes: normalised(measured, &is_measured, f64::abs),
            sorted: [sorted(|value| value), sorted(f64::abs)],
            rectified: only_rectified || finite().all(|value| value >= 0.0),
            only_rectified,
            is_measured,
        }
    }

    /// Returns the correlation, a flag for reversed sign, and a flag for a comparison of magnitudes.
    fn fit(&self, predicted: &[f64]) -> (f64, bool, bool) {
        let signed = correlation(predicted, &self.signed, &self.is_measured, |value| value);
        let (mut value, mut sign, mut rectified) = (signed.abs(), signed < 0.0, false);
        if self.rectified {
            let magnitude = correlation(predicted, &self.magnitudes, &self.is_measured, f64::abs);
            if self.only_rectified || magnitude > value + DEPARTURE {
                (value, sign, rectified) = (magnitude, false, true);
            }
        }
        (value, sign, rectified)
    }

    /// Upper bound on the correlation over all orders of these readings: the correlation with both sides sorted
    /// (rearrangement inequality).
    fn bound(&self, predicted: &[f64]) -> f64 {
        if self.sorted[0].len() != predicted.len() {
            // Missing readings could have any value.
            return 1.0;
        }
        let all = vec![true; predicted.len()];
        let of = |map: fn(f64) -> f64, measured: &[f64]| {
            let mut values: Vec<f64> = predicted.iter().map(|value| map(*value)).collect();
            values.sort_by(f64::total_cmp);
            correlation(&values, &normalised(measured, &all, |value| value), &all, |value| value)
        };
        let signed = of(|v| v, &self.sorted[0]).max(of(|v| -v, &self.sorted[0]));
        let magnitudes = if self.rectified { of(f64::abs, &self.sorted[1]) } else { 0.0 };
        if self.only_rectified { magnitudes } else { signed.max(magnitudes) }
    }
}

fn normalised(values: &[f64], is_measured: &[bool], of: fn(f64) -> f64) -> Vec<f64> {
    let finite = || values.iter().zip(is_measured).filter(|(_, is)| **is).map(|(value, _)| of(*value));
    let mean = finite().sum::<f64>() / finite().count().max(1) as f64;
    let norm = finite().map(|value| (value - mean).powi(2)).sum::<f64>().sqrt();
    let unit = |value: f64| if norm > 0.0 { (of(value) - mean) / norm } else { 0.0 };
    values.iter().zip(is_measured).map(|(value, is)| if *is { unit(*value) } else { 0.0 }).collect()
}

/// Pearson correlation with readings that are already centred and normalised; 0 if the prediction is constant.
fn correlation(predicted: &[f64], normalised: &[f64], is_measured: &[bool], of: impl Fn(f64) -> f64) -> f64 {
    let (mut count, mut sum, mut square, mut product) = (0.0, 0.0, 0.0, 0.0);
    for ((value, unit), is_measured) in predicted.iter().zip(normalised).zip(is_measured) {
        let value = if *is_measured { of(*value) } else { 0.0 };
        count += f64::from(u8::from(*is_measured));
        (sum, square, product) = (sum + value, square + value * value, product + value * unit);
    }
    let spread = square - sum * sum / f64::max(count, 1.0);
    if spread > 1e-14 * square { product / spread.sqrt() } else { 0.0 }
}

/// A body by its transfer impedances, ohm.
pub(super) struct BodyModel {
    pub(super) count: usize,
    impedance: Vec<f64>,
    /// The skin's own patterns, if they are not ring patterns.
    stated: Vec<Shape>,
}

impl BodyModel {
    pub(super) fn of(skin: &Skin) -> Result<Self, Error> {
        if skin.modality == Modality::Mit {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("order of the channels of {}", skin.name),
                expected: "a skin with electrodes".into(),
                got: "coils, whose pairs are all read in one order".into(),
            }));
        }
        if skin.backend.circuit.is_some() {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("order of the channels of {}, backend.circuit", skin.name),
                expected: "none: ideal voltmeters are what the search knows".into(),
                got: "a circuit".into(),
            }));
        }
        let count = skin.electrode_shapes().len();
        if !ELECTRODES.contains(&count) {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("electrodes of {}, whose order is looked for", skin.name),
                expected: format!("{} to {}", ELECTRODES.start(), ELECTRODES.end()),
                got: count.to_string(),
            }));
        }
        let body = skin.body()?;
        let sigma = vec![skin.sheet_conductance_s(); body.mesh.mesh.element_count()];
        let model = ForwardModel::new(body.mesh, skin.protocol()?)?;
        let solution = model.solve(&sigma)?;
        let z = solution.transfer_impedance();
        let impedance = (0..count * count).map(|k| z[(k / count, k % count)]).collect();
        Ok(Self { count, impedance, stated: stated_shapes(skin) })
    }

    /// Candidates worth ranking. `share_of_work` is this body's share of [`MOST_WORK`].
    pub(super) fn search(&self, data: &Data, share_of_work: f64) -> Vec<Scored> {
        let readings = data.is_measured.len();
        let mut shapes = self.stated.clone();
        shapes.extend(Shape::all(self.count));
        shapes.retain(|shape| shape.readings(self.count) == readings);
        let bound = |shape: Shape| {
            let predicted = self.predict(&Hypothesis::plain(&shape)).unwrap_or_default();
            (data.bound(&predicted), shape)
        };
        let mut bounded: Vec<(f64, Shape)> = shapes.into_par_iter().map(bound).collect();
        // The sort is stable, so the plainer pattern stays first among equal bounds.
        bounded.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut work_left = (share_of_work * MOST_WORK as f64) as usize;
        let mut found: Vec<Scored> = Vec::new();
        for (number, (bound, shape)) in bounded.iter().enumerate() {
            // No order of this shape can reach the current best.
            if found.len() >= KEPT && *bound < found[KEPT - 1].0 {
                break;
            }
            let arrangements = self.arrangements(shape);
            let work = arrangements.len() * readings;
            if number > 0 && work > work_left {
                break;
            }
            work_left = work_left.saturating_sub(work);
            found.extend(self.arranged(shape, &arrangements, data));
            if number < RENUMBERED {
                found.extend(self.renumbered(shape, data));
            }
            found.sort_by(|a, b| score(b.0, &b.1).total_cmp(&score(a.0, &a.1)));
            found.truncate(40 * KEPT.max(self.count));
        }
        found
    }

    /// All orders of a shape.
    fn arrangements(&self, shape: &Shape) -> Vec<Arrangement> {
        let (drives, reads) = shape.sides(self.count);
        let nestings: &[Nesting] = if drives > 1 && reads > 1 { &Nesting::ALL } else { &[Nesting::DriveMajor] };
        let mut all = Vec::new();
        for &nesting in nestings {
            for rotating in if drives > 1 && reads > 1 { &[false, true][..] } else { &[false] } {
                for drives_backwards in if drives > 1 { &[false, true][..] } else { &[false] } {
                    for backwards in if reads > 1 { &[false, true][..] } else { &[false] } {
                        for first_drive in 0..drives {
                            all.extend((0..reads).map(|first_read| Arrangement {
                                first_drive,
                                drives_backwards: *drives_backwards,
                                first_read,
                                backwards: *backwards,
                                rotating: *rotating,
                                nesting,
                            }));
                        }
                    }
                }
            }
        }
        all
    }

    /// The best orders of a shape, with electrodes numbered as in the skin file.
    fn arranged(&self, shape: &Shape, arrangements: &[Arrangement], data: &Data) -> Vec<Scored> {
        let sides = shape.sides(self.count);
        let lists = shape.lists(self.count, |e| e);
        let value = |place: usize| {
            shape.cell(&lists, place / sides.1, place % sides.1).map_or(f64::NAN, |cell| self.reading(cell))
        };
        let values: Vec<f64> = (0..sides.0 * sides.1).map(value).collect();
        let at = |drive: usize, read: usize| values[drive * sides.1 + read];
        let fit = |predicted: &mut Vec<f64>, order: &Arrangement| {
            predicted.clear();
            let is_possible = order.walk(sides, |d, r| !at(d, r).is_nan(), |d, r| predicted.push(at(d, r)));
            is_possible.then(|| (data.fit(predicted), *order))
        };
        let mut fits: Vec<_> = arrangements.par_iter().map_init(Vec::new, fit).flatten_iter().collect();
        fits.sort_by(|a, b| b.0.0.total_cmp(&a.0.0));
        // On a symmetric body many orders are equivalent. Keep enough of them to include the plainest.
        fits.truncate(16 * KEPT.max(self.count));
        let hypothesis = |((correlation, reversed_sign, rectified), order)| {
            (correlation, Hypothesis { order, reversed_sign, rectified, ..Hypothesis::plain(shape) })
        };
        fits.into_iter().map(hypothesis).collect()
    }

    /// The best orders of a shape, with the count starting at each electrode in both directions.
    fn renumbered(&self, shape: &Shape, data: &Data) -> Vec<Scored> {
        let (drives, reads) = shape.sides(self.count);
        let mut orders = vec![Arrangement::default()];
        if drives > 1 && reads > 1 {
            orders = Nesting::ALL
                .into_iter()
                .flat_map(|nesting| {
                    [false, true].map(|rotating| Arrangement { nesting, rotating, ..Arrangement::default() })
                })
                .collect();
        }
        let numbered = |k: usize| {
            let plain = Hypothesis { turn: k / 2, mirrored: k % 2 == 1, ..Hypothesis::plain(shape) };
            let fits = orders.iter().filter_map(|&order| {
                let hypothesis = Hypothesis { order, ..plain.clone() };
                let (correlation, reversed_sign, rectified) = data.fit(&self.predict(&hypothesis)?);
                Some((correlation, Hypothesis { reversed_sign, rectified, ..hypothesis }))
            });
            fits.collect::<Vec<_>>()
        };
        let mut fits: Vec<Scored> = (0..2 * self.count).into_par_iter().flat_map_iter(numbered).collect();
        fits.sort_by(|a, b| score(b.0, &b.1).total_cmp(&score(a.0, &a.1)));
        fits.truncate(16 * KEPT.max(self.count));
        fits
    }

    /// Readings for a current of 1 A; `None` if the grid cannot be listed in this order.
    pub(super) fn predict(&self, hypothesis: &Hypothesis) -> Option<Vec<f64>> {
        Some(hypothesis.cells(self.count)?.into_iter().map(|cell| self.reading(cell)).collect())
    }

    fn reading(&self, cell: Cell) -> f64 {
        let z = |row: usize, column: usize| self.impedance[row * self.count + column];
        let [sink, source] = cell.drive;
        let potential = |e: usize| z(e, source) - z(e, sink);
        match cell.read {
            Reading::Pair([plus, minus]) => potential(plus) - potential(minus),
            Reading::ToSink(electrode) => potential(electrode) - potential(sink),
            Reading::ToMean(electrode) => {
                potential(electrode) - (0..self.count).map(potential).sum::<f64>() / self.count as f64
            }
            Reading::Itself => potential(source) - potential(sink),
        }
    }
}

/// The skin file's patterns that are explicit lists.
fn stated_shapes(skin: &Skin) -> Vec<Shape> {
    if let Some(list) = &skin.backend.channels {
        return vec![Shape::Channels(list.channels().iter().map(Cell::of).collect())];
    }
    let (DrivePattern::Pairs(drives), MeasurePattern::Pairs(reads)) = (&skin.backend.drive, &skin.backend.measure)
    else {
        return Vec::new();
    };
    let zero_based = |pairs: &[[u32; 2]]| -> Vec<[usize; 2]> {
        pairs.iter().map(|pair| pair.map(|e| (e as usize).saturating_sub(1))).collect()
    };
    let (drives, reads) = (Pairs::Listed(zero_based(drives)), Read::Pairs(Pairs::Listed(zero_based(reads))));
    [true, false].map(|drop| Shape::Grid { drives: drives.clone(), reads: reads.clone(), drop }).to_vec()
}
