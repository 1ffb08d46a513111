//! Finds the channel order of an unknown file. A baseline is compared with the readings that a skin's model predicts
//! under every protocol with the right number of readings, for every order of its lists, either sign, and electrodes
//! counted from any of them in either direction. The best match is reported as the lines of a skin file.
//!
//! Everything follows from one solution: with the transfer impedances Z, a drive (a, b) of current I (in at b, out at
//! a) and a reading (c, d) give `I (Z_cb - Z_ca - Z_db + Z_da)`. In a body with rotational symmetry the readings
//! don't depend on where the count starts; such candidates are merged into one, and their number is reported.

mod body_model;
mod hypothesis;

use dermis_device::FrameTable;
use dermis_skin::{
    DrivePattern, DrivenChannels, Layer, ListedChannel, MeasurePattern, ReadingOrder, Reads, SheetLayer, Skin,
};
use serde::Serialize;

use self::body_model::{BodyModel, Data, ELECTRODES};
use self::hypothesis::{Hypothesis, Shape, score};
use crate::Error;

/// Largest frame searched, in readings.
const MOST_READINGS: usize = 1 << 16;
/// Maximum number of candidates in the answer.
const LISTED: usize = 10;
/// Correlation above which two predictions count as the same, apart from mesh error.
const SAME: f64 = 0.9998;
/// Maximum number of fits considered for the answer.
const MOST_RANKED: usize = 2500;
/// Minimum correlation for a match.
pub const LEAST: f64 = 0.9;
/// Minimum lead over every other candidate for a clear answer.
const CLEAR: f64 = 0.02;

/// For each channel of a skin, its index in a file and the factor that converts the file's number to the skin's.
pub type ChannelMap = (Vec<u32>, Vec<f64>);

/// One interpretation of the file's numbers, and how well it fits.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct OrderCandidate {
    /// The interpretation in words.
    pub description: String,
    /// Number of electrodes.
    pub electrodes: usize,
    /// Pearson correlation of the baseline with the model.
    pub correlation: f64,
    /// The correlation less 0.003 for each departure from a plain protocol. Candidates are ranked by it.
    pub score: f64,
    /// Number of other candidates that predict the same readings for this body.
    pub same: usize,
    /// Every channel of the file by its electrodes, if no combination of drive and measuring patterns describes them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channels: Option<Vec<ListedChannel>>,
    /// As in a skin file; `Listed` if `channels` is given.
    #[serde(skip_serializing_if = "DrivePattern::is_listed")]
    pub drive: DrivePattern,
    /// As in a skin file; `Listed` if `channels` is given.
    #[serde(skip_serializing_if = "MeasurePattern::is_listed")]
    pub measure: MeasurePattern,
    /// As in a skin file.
    pub order: ReadingOrder,
    /// As in a skin file.
    pub driven: DrivenChannels,
    /// As in a skin file.
    pub reads: Reads,
    /// Signs of the readings, if the file holds magnitudes.
    #[serde(skip)]
    signs: Option<Vec<f64>>,
}

/// The result of a search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FoundOrder {
    /// Readings in a frame.
    pub readings: usize,
    /// Number of frames averaged.
    pub frames: usize,
    /// The candidates, best first; at most ten.
    pub candidates: Vec<OrderCandidate>,
    /// True if the best candidate fits, and clearly better than all others.
    pub is_clear: bool,
}

impl OrderCandidate {
    /// The skin with its backend changed to read the file in this order.
    pub fn on(&self, skin: &Skin) -> Skin {
        let mut skin = match &self.channels {
            Some(channels) => skin.clone().with_channels(channels.clone()),
            None => skin.clone().with_patterns(self.drive.clone(), self.measure.clone()),
        };
        (skin.backend.order, skin.backend.driven, skin.backend.reads) = (self.order, self.driven, self.reads);
        skin
    }

    /// Maps the file's numbers to the skin's channels: for each channel its index in the file, and the factor that
    /// converts that number to the skin's. `None` if the file holds other channels than the skin.
    ///
    /// # Errors
    /// The skin's protocol is invalid.
    pub fn to_skin(&self, skin: &Skin) -> Result<Option<ChannelMap>, Error> {
        let (own, file) = (skin.protocol()?, self.on(skin).protocol()?);
        let mut found = own.same_channels(&file);
        if let (Some((_, signs)), Some(of_file)) = (&mut found, &self.signs)
            && skin.backend.reads == Reads::Signed
        {
            signs.iter_mut().zip(of_file).for_each(|(sign, of_file)| *sign *= of_file);
        }
        Ok(found)
    }

    /// The lines of `[backend]` in a skin file that describe this order.
    pub fn lines(&self) -> String {
        let value = |value: serde_json::Result<serde_json::Value>| toml_of(&value.unwrap_or_default());
        let reads = match self.reads {
            Reads::Signed => String::new(),
            reads => format!("reads = {}\n", value(serde_json::to_value(reads))),
        };
        if let Some(channels) = &self.channels {
            return format!("channels = {}\n{reads}", value(serde_json::to_value(channels)));
        }
        let (drive, measure) = (serde_json::to_value(&self.drive), serde_json::to_value(&self.measure));
        let (order, driven) = (serde_json::to_value(self.order), serde_json::to_value(self.driven));
        let mut lines = format!("drive = {}\nmeasure = {}\n", value(drive), value(measure));
        lines += &format!("order = {}\ndriven = {}\n{reads}", value(order), value(driven));
        lines
    }
}

impl FoundOrder {
    /// The best candidate, if it fits well enough.
    pub fn fitting(&self) -> Option<&OrderCandidate> {
        self.candidates.first().filter(|best| best.correlation >= LEAST)
    }

    /// The result in one sentence.
    pub fn verdict(&self) -> String {
        let Some(best) = self.candidates.first() else {
            return format!("nothing fits: no protocol of 4 to 128 electrodes gives {} readings", self.readings);
        };
        let OrderCandidate { description, correlation, .. } = best;
        match self.candidates.get(1) {
            _ if *correlation < LEAST => {
                format!(
                    "nothing fits: the best of all orders, {description}, correlates {correlation:.3} with the model; \
                     the channels may be shuffled, or the frames may be of another skin"
                )
            }
            Some(next) if !self.is_clear => format!(
                "it may be {description} ({correlation:.4}), or {} ({:.4}): a press at a known place decides",
                next.description, next.correlation
            ),
            _ => format!("it is {description}: the baseline correlates {correlation:.4} with the model"),
        }
    }
}

/// A JSON value as TOML on one line.
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
/// The frames have too many readings or no two different ones; the skin has coils (all pairs are read in one order)
/// or a readout circuit, or its model cannot be solved.
pub fn find_order(baseline: &FrameTable, skin: Option<&Skin>) -> Result<FoundOrder, Error> {
    let (measured, is_complex) = mean_of(baseline);
    let readings = measured.len();
    let refuse = |what: &str, expected: &str, got: String| {
        Err(Error::Live(dermis_live::Error::Frames { what: what.into(), expected: expected.into(), got }))
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
    let data = Data::new(&measured, is_complex);
    let share_of_work = 1.0 / models.len().max(1) as f64;
    let fits = models.iter().enumerate().flat_map(|(number, model)| {
        let found = model.search(&data, share_of_work).into_iter();
        found.map(move |(correlation, hypothesis)| Fit { model: number, correlation, hypothesis })
    });
    let mut found = rank(fits.collect(), &models);
    if is_complex {
        found.iter_mut().for_each(|candidate| candidate.reads = Reads::Complex);
    }
    let is_clear = found.first().is_some_and(|best| best.correlation >= LEAST)
        && found.get(1).is_none_or(|next| found[0].score > next.score + CLEAR);
    Ok(FoundOrder { readings, frames: baseline.frames(), candidates: found, is_clear })
}

/// Mean of the frames per channel, ignoring values that are not finite. Complex readings are averaged as magnitudes.
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

fn models(skin: Option<&Skin>, readings: usize) -> Result<Vec<BodyModel>, Error> {
    if let Some(skin) = skin {
        return Ok(vec![BodyModel::of(skin)?]);
    }
    // There are as many drives as electrodes, or half as many, and no drive has more readings than there are
    // electrodes.
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

/// Pearson correlation over the finite values; 0 if either side is constant.
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

/// A hypothesis about one of several bodies, with its correlation.
struct Fit {
    model: usize,
    correlation: f64,
    hypothesis: Hypothesis,
}

impl Fit {
    fn candidate(&self, count: usize, same: usize, predicted: &[f64]) -> OrderCandidate {
        let hypothesis = &self.hypothesis;
        let order = if hypothesis.order.rotating { ReadingOrder::Rotating } else { ReadingOrder::Absolute };
        let driven = match hypothesis.shape {
            Shape::Grid { drop: false, .. } => DrivenChannels::Keep,
            _ => DrivenChannels::Drop,
        };
        let named = hypothesis.named(count);
        let channels = if named.is_none() { Some(hypothesis.listed(count)) } else { None };
        let (drive, measure) = named.unwrap_or((DrivePattern::Listed, MeasurePattern::Listed));
        OrderCandidate {
            description: hypothesis.in_words(count),
            electrodes: count,
            correlation: self.correlation,
            score: score(self.correlation, hypothesis),
            same,
            order: if channels.is_some() { ReadingOrder::default() } else { order },
            driven: if channels.is_some() { DrivenChannels::default() } else { driven },
            channels,
            drive,
            measure,
            reads: if hypothesis.rectified { Reads::Magnitude } else { Reads::Signed },
            signs: hypothesis.rectified.then(|| predicted.iter().map(|value| value.signum()).collect()),
        }
    }
}

/// Candidates, best first. Fits that predict the same readings are merged.
fn rank(mut fits: Vec<Fit>, models: &[BodyModel]) -> Vec<OrderCandidate> {
    fits.sort_by(|a, b| score(b.correlation, &b.hypothesis).total_cmp(&score(a.correlation, &a.hypothesis)));
    struct Group {
        fit: Fit,
        predicted: Vec<f64>,
        same: usize,
    }
    let mut groups: Vec<Group> = Vec::new();
    for fit in fits.into_iter().take(MOST_RANKED) {
        let Some(predicted) = models[fit.model].predict(&fit.hypothesis) else { continue };
        let known = groups.iter().position(|group| {
            // Fits that differ in the signs match by their magnitudes or not at all.
            let alike = correlation(&predicted, &group.predicted, |value| value);
            alike.abs() > SAME || (fit.hypothesis.rectified && (fit.correlation - group.fit.correlation).abs() < 1e-9)
        });
        match known {
            Some(known) => groups[known].same += usize::from(groups[known].fit.hypothesis != fit.hypothesis),
            None if groups.len() < LISTED => groups.push(Group { fit, predicted, same: 0 }),
            None => {}
        }
    }
    let candidate = |group: &Group| group.fit.candidate(models[group.fit.model].count, group.same, &group.predicted);
    groups.iter().map(candidate).collect()
}
