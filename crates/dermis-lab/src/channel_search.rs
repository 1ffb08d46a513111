//! Which order the numbers of an unknown file are in: a baseline is compared with what a skin's model would read under
//! every protocol that gives as many numbers, for every order of its lists, either sign, and electrodes counted from
//! another one or the other way round. What fits is said as the lines of a skin file.
//!
//! All of it follows from one solution: with the transfer impedances Z, a drive (a, b) of current I (in at b, out at a)
//! and a reading (c, d) give `I (Z_cb - Z_ca - Z_db + Z_da)`. A body that looks the same when it is turned cannot tell
//! from where its electrodes are counted: such candidates are one, and how many they are is said.

mod hypothesis;

use dermis_device::FrameTable;
use dermis_skin::{
    DrivePattern, DrivenChannels, Layer, MeasurePattern, Modality, ReadingOrder, Reads, SheetLayer, Skin,
};
use dermis_tomo::eit::ForwardModel;
use rayon::prelude::*;
use serde::Serialize;

use self::hypothesis::{DEPARTURE, Hypothesis, Pairs, Read, Reading, Shape, lists, numberings, orders, score};
use crate::Error;

/// Electrodes of a skin that is not known.
const ELECTRODES: std::ops::RangeInclusive<usize> = 4..=128;
/// Readings of a frame that are searched at most.
const MOST_READINGS: usize = 1 << 16;
/// Readings that the first look may compute in all; where more would be needed, turns are tried of the best alone.
const MOST_WORK: usize = 400_000_000;
/// Candidates that go from one look to the next.
const KEPT: usize = 24;
/// Candidates in the answer.
const LISTED: usize = 10;
/// Predictions that correlate so well are the same but for the mesh.
const SAME: f64 = 0.9998;
/// Fits that are looked through for the answer.
const MOST_RANKED: usize = 2000;
/// Below this correlation nothing fits.
const LEAST: f64 = 0.9;
/// So much better than any other must the best fit to be sure.
const CLEAR: f64 = 0.02;

/// One way to read the numbers, and how well it fits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OrderCandidate {
    /// In words.
    pub description: String,
    /// Number of electrodes.
    pub electrodes: usize,
    /// Pearson correlation of the baseline with the model.
    pub correlation: f64,
    /// The correlation less 0.003 for each departure from a plain protocol; what candidates are ranked by.
    pub score: f64,
    /// Other candidates that predict the same numbers for this body.
    pub same: usize,
    /// As in a skin file.
    pub drive: DrivePattern,
    /// As in a skin file.
    pub measure: MeasurePattern,
    /// As in a skin file.
    pub order: ReadingOrder,
    /// As in a skin file.
    pub driven: DrivenChannels,
    /// As in a skin file.
    pub reads: Reads,
}

/// What a search has found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FoundOrder {
    /// Numbers of a frame.
    pub readings: usize,
    /// Frames that were averaged.
    pub frames: usize,
    /// The best first; at most ten.
    pub candidates: Vec<OrderCandidate>,
    /// The best fits, and clearly better than all others.
    pub is_clear: bool,
}

impl OrderCandidate {
    /// The lines of `[backend]` in a skin file that say this.
    pub fn lines(&self) -> String {
        let value = |value: serde_json::Result<serde_json::Value>| toml_of(&value.unwrap_or_default());
        let (drive, measure) = (serde_json::to_value(&self.drive), serde_json::to_value(&self.measure));
        let (order, driven) = (serde_json::to_value(self.order), serde_json::to_value(self.driven));
        let mut lines = format!("drive = {}\nmeasure = {}\n", value(drive), value(measure));
        lines += &format!("order = {}\ndriven = {}\n", value(order), value(driven));
        if self.reads != Reads::Signed {
            lines += &format!("reads = {}\n", value(serde_json::to_value(self.reads)));
        }
        lines
    }
}

impl FoundOrder {
    /// What was found, in one sentence.
    pub fn verdict(&self) -> String {
        let Some(best) = self.candidates.first() else {
            return format!("no protocol of 4 to 128 electrodes that is known here gives {} readings", self.readings);
        };
        let OrderCandidate { description, correlation, .. } = best;
        match self.candidates.get(1) {
            _ if *correlation < LEAST => {
                format!("nothing fits: the best, {description}, correlates {correlation:.3} with the model")
            }
            Some(next) if !self.is_clear => format!(
                "it may be {description} ({correlation:.4}), or {} ({:.4}): a press at a known place decides",
                next.description, next.correlation
            ),
            _ => format!("it is {description}: the baseline correlates {correlation:.4} with the model"),
        }
    }
}

/// A JSON value as TOML in one line.
pub fn toml_of(value: &serde_json::Value) -> String {
    match value {
        serde_json::Value::Object(fields) => {
            let fields: Vec<String> = fields.iter().map(|(key, value)| format!("{key} = {}", toml_of(value))).collect();
            format!("{{ {} }}", fields.join(", "))
        }
        serde_json::Value::Array(values) => {
            format!("[{}]", values.iter().map(toml_of).collect::<Vec<_>>().join(", "))
        }
        other => other.to_string(),
    }
}

/// Finds the order of the numbers in frames of an untouched skin. Without a skin, discs with evenly spaced electrodes
/// are tried.
///
/// # Errors
/// Frames without two different readings, or with too many; a skin of coils (all of whose pairs are read in one order)
/// or with a readout circuit,
/// or one that cannot be solved.
pub fn find_order(baseline: &FrameTable, skin: Option<&Skin>) -> Result<FoundOrder, Error> {
    let (measured, is_complex) = mean_of(baseline);
    let readings = measured.len();
    let refuse = |what: &str, expected: &str, got: String| {
        Err(Error::Frames { what: what.into(), expected: expected.into(), got })
    };
    if readings > MOST_READINGS {
        return refuse("readings of a frame", &format!("at most {MOST_READINGS}"), readings.to_string());
    }
    let finite = || measured.iter().copied().filter(|value| value.is_finite());
    let (low, high) = (finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max));
    if low.partial_cmp(&high) != Some(std::cmp::Ordering::Less) {
        return refuse("baseline", "readings that differ", "none, or all of one value".into());
    }
    let models = models(skin, readings)?;
    let data = Data { measured: &measured, rectified: is_complex || low >= 0.0, only_rectified: is_complex };
    let fits = models.iter().enumerate().flat_map(|(number, model)| {
        model.search(&data).into_iter().map(move |(correlation, hypothesis)| Fit {
            model: number,
            correlation,
            hypothesis,
        })
    });
    let mut found = rank(fits.collect(), &models);
    if is_complex {
        found.iter_mut().for_each(|candidate| candidate.reads = Reads::Complex);
    }
    let is_clear = found.first().is_some_and(|best| best.correlation >= LEAST)
        && found.get(1).is_none_or(|next| found[0].score > next.score + CLEAR);
    Ok(FoundOrder { readings, frames: baseline.frames(), candidates: found, is_clear })
}

/// Mean of the frames, channel by channel over what is finite; of complex readings their magnitude.
fn mean_of(table: &FrameTable) -> (Vec<f64>, bool) {
    let channels = table.channels();
    let (mut sums, mut counts) = (vec![0.0; channels], vec![0_u32; channels]);
    for (index, row) in table.rows().enumerate() {
        let imaginary = table.imaginary_row(index);
        for (channel, value) in row.iter().enumerate() {
            let value = imaginary.map_or(*value, |imaginary| value.hypot(imaginary[channel]));
            if value.is_finite() {
                sums[channel] += value;
                counts[channel] += 1;
            }
        }
    }
    let mean = |(sum, count): (f64, u32)| if count > 0 { sum / f64::from(count) } else { f64::NAN };
    (sums.into_iter().zip(counts).map(mean).collect(), table.imaginary().is_some())
}

/// What is measured.
struct Data<'a> {
    measured: &'a [f64],
    /// No reading is negative: they may be magnitudes.
    rectified: bool,
    only_rectified: bool,
}

/// A body by its transfer impedances, ohm.
struct BodyModel {
    count: usize,
    impedance: Vec<f64>,
    /// The skin's own patterns, where they are none of the rings.
    stated: Option<(DrivePattern, MeasurePattern)>,
}

fn models(skin: Option<&Skin>, readings: usize) -> Result<Vec<BodyModel>, Error> {
    if let Some(skin) = skin {
        return Ok(vec![BodyModel::of(skin)?]);
    }
    // Drives are as many as electrodes, or half as many, and each has no more readings than there are electrodes.
    let possible = |count: &usize| {
        count * count >= readings && Shape::all(*count).iter().any(|shape| shape.readings(*count) == readings)
    };
    let gel = || Layer::Sheet(SheetLayer::gel(5.0, 0.2));
    let disc = |count: usize| {
        let width_mm = 0.4 * std::f64::consts::PI * 100.0 / count as f64;
        let mut skin = Skin::disc("unknown", 100.0, gel()).with_rim_electrodes(count, width_mm.min(10.0));
        skin.imaging.elements = 3000;
        BodyModel::of(&skin)
    };
    ELECTRODES.filter(possible).map(disc).collect()
}

impl BodyModel {
    fn of(skin: &Skin) -> Result<Self, Error> {
        if skin.modality == Modality::Mit {
            return Err(Error::Frames {
                what: format!("order of the channels of {}", skin.name),
                expected: "a skin with electrodes".into(),
                got: "coils, whose pairs are all read in one order".into(),
            });
        }
        if skin.backend.circuit.is_some() {
            return Err(Error::Frames {
                what: format!("order of the channels of {}, backend.circuit", skin.name),
                expected: "none: ideal voltmeters are what the search knows".into(),
                got: "a circuit".into(),
            });
        }
        let count = skin.electrode_shapes().len();
        if !ELECTRODES.contains(&count) {
            return Err(Error::Frames {
                what: format!("electrodes of {}, whose order is looked for", skin.name),
                expected: format!("{} to {}", ELECTRODES.start(), ELECTRODES.end()),
                got: count.to_string(),
            });
        }
        let body = skin.body()?;
        let sigma = vec![skin.sheet_conductance_s(); body.mesh.mesh.element_count()];
        let model = ForwardModel::new(body.mesh, skin.protocol()?)?;
        let solution = model.solve(&sigma)?;
        let z = solution.transfer_impedance();
        let impedance = (0..count * count).map(|k| z[(k / count, k % count)]).collect();
        Ok(Self { count, impedance, stated: Some((skin.backend.drive.clone(), skin.backend.measure.clone())) })
    }

    /// All candidates worth ranking.
    fn search(&self, data: &Data<'_>) -> Vec<Scored> {
        let readings = data.measured.len();
        let mut shapes = Shape::all(self.count);
        shapes.extend(self.stated_shapes());
        shapes.retain(|shape| shape.readings(self.count) == readings);
        let turns_at_once = shapes.len() * 4 * self.count * readings <= MOST_WORK;
        let turns = if turns_at_once { self.count } else { 1 };
        let plain = |shape: &Shape| Hypothesis { shape: shape.clone(), ..Hypothesis::default() };
        let first = shapes.iter().flat_map(|shape| numberings(&plain(shape), turns)).flat_map(orders).collect();
        let mut fits = self.best(first, data);
        if !turns_at_once {
            let turned = fits.iter().flat_map(|(_, hypothesis)| numberings(hypothesis, self.count)).collect();
            fits = self.best(turned, data);
        }
        let further = fits.iter().take(KEPT).flat_map(|(_, hypothesis)| lists(hypothesis, self.count)).collect();
        fits.extend(self.best(further, data));
        fits
    }

    /// Patterns of the skin file that are lists of their own.
    fn stated_shapes(&self) -> Vec<Shape> {
        let Some((DrivePattern::Pairs(drives), MeasurePattern::Pairs(reads))) = &self.stated else { return Vec::new() };
        let zero_based = |pairs: &[[u32; 2]]| -> Vec<[usize; 2]> {
            pairs.iter().map(|pair| pair.map(|e| (e as usize).saturating_sub(1))).collect()
        };
        let (drives, reads) = (Pairs::Listed(zero_based(drives)), Read::Pairs(Pairs::Listed(zero_based(reads))));
        [true, false].map(|drop| Shape { drives: drives.clone(), reads: reads.clone(), drop }).to_vec()
    }

    /// The best of many, best first.
    fn best(&self, hypotheses: Vec<Hypothesis>, data: &Data<'_>) -> Vec<Scored> {
        let mut fits: Vec<Scored> = hypotheses.into_par_iter().map(|hypothesis| self.fit(hypothesis, data)).collect();
        fits.sort_by(|a, b| score(b.0, &b.1).total_cmp(&score(a.0, &a.1)));
        fits.truncate(2 * self.count.max(KEPT));
        fits
    }

    fn fit(&self, hypothesis: Hypothesis, data: &Data<'_>) -> Scored {
        let predicted = self.predict(&hypothesis);
        let signed = correlation(&predicted, data.measured, |value| value);
        let (mut value, mut sign, mut rectified) = (signed.abs(), signed < 0.0, false);
        if data.rectified {
            let magnitude = correlation(&predicted, data.measured, f64::abs);
            if data.only_rectified || magnitude > value + DEPARTURE {
                (value, sign, rectified) = (magnitude, false, true);
            }
        }
        (value, Hypothesis { reversed_sign: sign, rectified, ..hypothesis })
    }

    /// Readings for a current of 1 A.
    fn predict(&self, hypothesis: &Hypothesis) -> Vec<f64> {
        let z = |row: usize, column: usize| self.impedance[row * self.count + column];
        let (drives, reads) = hypothesis.lists(self.count);
        let mut values = Vec::new();
        for (index, [sink, source]) in drives.iter().copied().enumerate() {
            let potential = |e: usize| z(e, source) - z(e, sink);
            let mean = (0..self.count).map(potential).sum::<f64>() / self.count as f64;
            for position in 0..reads.len() {
                let position = if hypothesis.rotating { (position + index) % reads.len() } else { position };
                let value = match &reads[position] {
                    Reading::Pair([plus, minus]) => {
                        if hypothesis.shape.drop && [*plus, *minus].iter().any(|e| *e == sink || *e == source) {
                            continue;
                        }
                        potential(*plus) - potential(*minus)
                    }
                    Reading::ToSink(electrode) => potential(*electrode) - potential(sink),
                    Reading::ToMean(electrode) => potential(*electrode) - mean,
                };
                values.push(value);
            }
        }
        values
    }
}

/// Pearson correlation over what is finite; 0 where nothing varies.
fn correlation(predicted: &[f64], measured: &[f64], of: impl Fn(f64) -> f64) -> f64 {
    let pairs = || predicted.iter().zip(measured).filter(|(_, m)| m.is_finite()).map(|(p, m)| (of(*p), *m));
    let count = pairs().count().max(1) as f64;
    let (sum_p, sum_m) = pairs().fold((0.0, 0.0), |sums, (p, m)| (sums.0 + p, sums.1 + m));
    let (mean_p, mean_m) = (sum_p / count, sum_m / count);
    let (mut pm, mut pp, mut mm) = (0.0, 0.0, 0.0);
    for (p, m) in pairs() {
        let (p, m) = (p - mean_p, m - mean_m);
        (pm, pp, mm) = (pm + p * m, pp + p * p, mm + m * m);
    }
    let scale = (pp * mm).sqrt();
    if scale > 0.0 { pm / scale } else { 0.0 }
}

/// A hypothesis with its correlation.
type Scored = (f64, Hypothesis);

/// A hypothesis about one of several bodies, and how well it fits.
struct Fit {
    model: usize,
    correlation: f64,
    hypothesis: Hypothesis,
}

impl Fit {
    fn candidate(&self, count: usize, same: usize) -> OrderCandidate {
        let hypothesis = &self.hypothesis;
        let (drive, measure) = if hypothesis.is_named() { hypothesis.named(count) } else { hypothesis.listed(count) };
        OrderCandidate {
            description: hypothesis.in_words(count),
            electrodes: count,
            correlation: self.correlation,
            score: score(self.correlation, hypothesis),
            same,
            drive,
            measure,
            order: if hypothesis.rotating { ReadingOrder::Rotating } else { ReadingOrder::Absolute },
            driven: if hypothesis.shape.drop { DrivenChannels::Drop } else { DrivenChannels::Keep },
            reads: if hypothesis.rectified { Reads::Magnitude } else { Reads::Signed },
        }
    }
}

/// Best first, those that predict the same as one.
fn rank(mut fits: Vec<Fit>, models: &[BodyModel]) -> Vec<OrderCandidate> {
    // What no skin file can say: electrodes against a reference in another order than the file's own.
    fits.retain(|fit| {
        let Hypothesis { shape, turn, mirrored, first_read, backwards, .. } = &fit.hypothesis;
        let is_plain = *turn == 0 && !mirrored && *first_read == 0 && !backwards;
        // A drive the other way round has another sink.
        let is_sayable = shape.reads != Read::ToSink || !fit.hypothesis.reversed_sign;
        matches!(shape.reads, Read::Pairs(_)) || (is_plain && is_sayable)
    });
    fits.sort_by(|a, b| score(b.correlation, &b.hypothesis).total_cmp(&score(a.correlation, &a.hypothesis)));
    struct Group {
        fit: Fit,
        predicted: Vec<f64>,
        same: usize,
    }
    let mut groups: Vec<Group> = Vec::new();
    for fit in fits.into_iter().take(MOST_RANKED) {
        let predicted = models[fit.model].predict(&fit.hypothesis);
        let known = groups.iter().position(|group| {
            // Those of other signs fit by their magnitudes or not at all.
            let alike = correlation(&predicted, &group.predicted, |value| value);
            alike.abs() > SAME || (fit.hypothesis.rectified && (fit.correlation - group.fit.correlation).abs() < 1e-9)
        });
        match known {
            Some(known) => groups[known].same += usize::from(groups[known].fit.hypothesis != fit.hypothesis),
            None if groups.len() < LISTED => groups.push(Group { fit, predicted, same: 0 }),
            None => {}
        }
    }
    groups.iter().map(|group| group.fit.candidate(models[group.fit.model].count, group.same)).collect()
}
