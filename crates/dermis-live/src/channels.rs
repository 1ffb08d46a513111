//! Converts an instrument's data (single-ended potentials, full matrices, channels; real or complex) to real channels
//! in the order of a skin's protocol.

use dermis_device::{FrameTable, Layout};
use dermis_tomo::eit::{Pattern, Protocol};

use crate::Error;
use dermis_skin::{Reads, Skin};

/// A sparse linear map from a source's values to the protocol's channels.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelLayout {
    inputs: usize,
    /// The inputs that each channel adds up, with weights.
    terms: Vec<Vec<(u32, f64)>>,
}

impl ChannelLayout {
    /// Finds the protocol's channels in a layout.
    ///
    /// # Errors
    /// A layout that does not contain them: a different number of channels or electrodes, or a missing drive.
    pub fn new(layout: &Layout, protocol: &Protocol, name: &str) -> Result<Self, Error> {
        let refuse = |expected: String, got: String| Error::Frames { what: format!("frames of {name}"), expected, got };
        let inputs = layout.channels();
        let terms = match layout {
            Layout::Channels { count } if *count == protocol.channel_count() => {
                (0..*count as u32).map(|channel| vec![(channel, 1.0)]).collect()
            }
            Layout::Channels { count } => {
                let electrodes = protocol.electrode_count();
                if *count == electrodes * electrodes {
                    full_matrix(protocol, electrodes).ok_or_else(|| {
                        refuse(format!("{} channels", protocol.channel_count()), format!("{count} channels"))
                    })?
                } else {
                    return Err(refuse(format!("{} channels", protocol.channel_count()), format!("{count} channels")));
                }
            }
            Layout::FullMatrix { electrodes } if *electrodes == protocol.electrode_count() => {
                full_matrix(protocol, *electrodes).ok_or_else(|| {
                    refuse("a protocol of one pair per electrode".into(), "other drive or measuring patterns".into())
                })?
            }
            Layout::SingleEnded { electrodes, stimulations } if *electrodes == protocol.electrode_count() => {
                single_ended(protocol, *electrodes, stimulations).map_err(|label| {
                    refuse(format!("the drive of channel {label}"), drives_of(*electrodes, stimulations))
                })?
            }
            Layout::FullMatrix { electrodes } | Layout::SingleEnded { electrodes, .. } => {
                return Err(refuse(
                    format!("{} electrodes", protocol.electrode_count()),
                    format!("{electrodes} electrodes"),
                ));
            }
        };
        Ok(Self { inputs, terms })
    }

    /// Number of values in a frame of the source.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Number of channels of the protocol.
    pub fn channels(&self) -> usize {
        self.terms.len()
    }

    /// Fills `channels` from one frame of the source.
    pub fn apply(&self, values: &[f64], channels: &mut Vec<f64>) {
        channels.clear();
        channels.extend(
            self.terms.iter().map(|terms| terms.iter().map(|&(input, w)| w * values[input as usize]).sum::<f64>()),
        );
    }
}

/// Channel (drive pair k, measuring pair j) of a drive-major matrix whose rows and columns start at those electrodes.
/// `None` if a row or a column matches several of the protocol's pairs.
fn full_matrix(protocol: &Protocol, electrodes: usize) -> Option<Vec<Vec<(u32, f64)>>> {
    let is_one_each = |patterns: &[Pattern], sign: f64| {
        let mut begun: Vec<Option<u32>> = patterns.iter().map(|pattern| extreme(pattern, sign)).collect();
        begun.sort_unstable();
        begun.windows(2).all(|pair| pair[0] != pair[1])
    };
    // A reading against a driven electrode is determined by drive and electrode.
    let is_against_sink = protocol.measurements().iter().all(|measurement| {
        let drive = &protocol.stimulations()[measurement.stimulation as usize];
        let read = &protocol.patterns()[measurement.pattern as usize];
        read.entries().is_empty() || extreme(read, -1.0) == extreme(drive, -1.0)
    });
    if !is_one_each(protocol.stimulations(), -1.0) || !(is_one_each(protocol.patterns(), 1.0) || is_against_sink) {
        return None;
    }
    (0..protocol.channel_count())
        .map(|channel| {
            let drive = extreme(protocol.stimulation_of(channel), -1.0)?;
            let read = extreme(protocol.pattern_of(channel), 1.0)?;
            Some(vec![((drive as usize * electrodes + read as usize) as u32, 1.0)])
        })
        .collect()
}

/// The electrode with the largest weight of the given sign.
fn extreme(pattern: &Pattern, sign: f64) -> Option<u32> {
    pattern.entries().iter().max_by(|a, b| (sign * a.1).total_cmp(&(sign * b.1))).map(|entry| entry.0)
}

fn single_ended(
    protocol: &Protocol,
    electrodes: usize,
    stimulations: &[(usize, usize)],
) -> Result<Vec<Vec<(u32, f64)>>, String> {
    (0..protocol.channel_count())
        .map(|channel| {
            let stimulation = protocol.stimulation_of(channel);
            let (source, sink) = (extreme(stimulation, 1.0), extreme(stimulation, -1.0));
            let position = |from: Option<u32>, to: Option<u32>| {
                let (from, to) = (from? as usize, to? as usize);
                stimulations.iter().position(|pair| *pair == (from, to))
            };
            // The current enters at the first electrode of an injection pair.
            let (row, sign) = match (position(source, sink), position(sink, source)) {
                (Some(row), _) => (row, 1.0),
                (None, Some(row)) => (row, -1.0),
                (None, None) => return Err(protocol.channel_label(channel)),
            };
            let entries = protocol.pattern_of(channel).entries().iter();
            Ok(entries.map(|&(e, w)| ((row * electrodes + e as usize) as u32, sign * w)).collect())
        })
        .collect()
}

/// The drives of a file, and the matching line of a skin file: "drives 1-4, 2-5, ...: `drive = { skip = 2 }`".
fn drives_of(electrodes: usize, stimulations: &[(usize, usize)]) -> String {
    const SHOWN: usize = 3;
    const LISTED: usize = 8;
    let some: Vec<String> = stimulations.iter().take(SHOWN).map(|(a, b)| format!("{}-{}", a + 1, b + 1)).collect();
    let more = if stimulations.len() > SHOWN { ", ..." } else { "" };
    // Use the shorter direction round the ring: a pair and its reverse are one drive with opposite sign.
    let apart = |&(from, to): &(usize, usize)| {
        let forward = (to + electrodes - from) % electrodes;
        forward.min(electrodes - forward)
    };
    let first = stimulations.first().map_or(0, apart);
    let every = |count: usize| {
        let mut starts: Vec<usize> =
            stimulations.iter().map(|&(from, to)| from.min(to) * electrodes + from.max(to)).collect();
        starts.sort_unstable();
        starts.dedup();
        starts.len() == count
    };
    let is_even = stimulations.iter().all(|pair| apart(pair) == first);
    let opposite = electrodes.is_multiple_of(2) && first == electrodes / 2;
    let all = if opposite { electrodes / 2 } else { electrodes };
    let key = if is_even && first > 0 && every(all) {
        match first {
            1 => "`drive = \"adjacent\"`".to_string(),
            _ if opposite => "`drive = \"opposite\"`".to_string(),
            step => format!("`drive = {{ skip = {} }}`", step - 1),
        }
    } else {
        // The current enters at the first electrode of an injection; a skin file lists [sink, source].
        let pairs: Vec<String> =
            stimulations.iter().take(LISTED).map(|(from, to)| format!("[{}, {}]", to + 1, from + 1)).collect();
        let more = if stimulations.len() > LISTED { ", ..." } else { "" };
        format!("`drive = {{ pairs = [{}{more}] }}`", pairs.join(", "))
    };
    format!("no such injection: the file drives {}{more}: {key}", some.join(", "))
}

/// Converts an instrument's frames to channels of a protocol, as real numbers.
///
/// On a skin that reads magnitudes, complex readings become their magnitude. On other skins they become their
/// component along a common phase, taken from the first frame read. This phase comes from the instrument, not from
/// the body, so baselines and frames must go through the same reader, baseline first.
#[derive(Clone, Debug)]
pub struct ChannelReader {
    layout: ChannelLayout,
    reads: Reads,
    phase: Option<(f64, f64)>,
    imaginary: Vec<f64>,
}

impl ChannelReader {
    /// A reader for frames of this layout. `name` is the source's, for errors.
    ///
    /// # Errors
    /// A layout that does not contain the protocol's channels.
    pub fn new(layout: &Layout, protocol: &Protocol, reads: Reads, name: &str) -> Result<Self, Error> {
        let layout = ChannelLayout::new(layout, protocol, name)?;
        Ok(Self { layout, reads, phase: None, imaginary: Vec::new() })
    }

    /// Adopts the phase found by another reader, such as a baseline's for the frames that go with it.
    pub fn share_phase_of(&mut self, other: &Self) {
        self.phase = other.phase;
    }

    /// Fills `channels` from one frame; `imaginary` is empty for real instruments.
    ///
    /// # Errors
    /// A frame whose length does not match the layout.
    pub fn read(&mut self, values: &[f64], imaginary: &[f64], channels: &mut Vec<f64>) -> Result<(), Error> {
        if values.len() != self.layout.inputs() {
            return Err(Error::Frames {
                what: "values of a frame".into(),
                expected: self.layout.inputs().to_string(),
                got: values.len().to_string(),
            });
        }
        self.layout.apply(values, channels);
        if imaginary.len() == values.len() && !values.is_empty() {
            self.layout.apply(imaginary, &mut self.imaginary);
            if self.reads == Reads::Magnitude {
                channels.iter_mut().zip(&self.imaginary).for_each(|(re, im)| *re = re.hypot(*im));
                return Ok(());
            }
            let (cosine, sine) = *self.phase.get_or_insert_with(|| common_phase(channels, &self.imaginary));
            channels.iter_mut().zip(&self.imaginary).for_each(|(re, im)| *re = *re * cosine + im * sine);
        }
        Ok(())
    }

    /// Converts all frames of a table.
    ///
    /// # Errors
    /// As [`ChannelReader::read`].
    pub fn read_table(&mut self, table: &FrameTable) -> Result<Vec<Vec<f64>>, Error> {
        (0..table.frames())
            .map(|index| {
                let mut channels = Vec::new();
                let row = table.row(index).unwrap_or_default();
                self.read(row, table.imaginary_row(index).unwrap_or_default(), &mut channels)?;
                Ok(channels)
            })
            .collect()
    }
}

/// Possible numbers of readings in a frame of a skin: its channels, or the full matrix of its electrodes.
pub fn readings_of(skin: &Skin) -> Vec<usize> {
    let Ok(protocol) = skin.protocol() else { return Vec::new() };
    vec![protocol.channel_count(), protocol.electrode_count().pow(2)]
}

/// Sorts a table into the order of the skin's channels, if its header names the electrodes of every column: drive,
/// drive, plus, minus, as in `1-2 > 3-4`. The sign is flipped for a pair that the header names in reverse, unless all
/// are reversed (the position of the sink is a matter of convention) or the skin reads magnitudes. Other tables are
/// unchanged.
///
/// # Errors
/// A column of electrodes that is not a channel of the skin.
pub fn order_by_names(table: FrameTable, skin: &Skin) -> Result<FrameTable, Error> {
    let Some(named) = table.channel_names().and_then(electrodes_of) else { return Ok(table) };
    let Ok(protocol) = skin.protocol() else { return Ok(table) };
    let labels: Vec<String> = (0..protocol.channel_count()).map(|channel| protocol.channel_label(channel)).collect();
    let Some(wanted) = electrodes_of(&labels) else { return Ok(table) };
    if named.len() != wanted.len() {
        return Ok(table);
    }
    // The pair without its direction, and the direction.
    let undirected = |(a, b): (usize, usize)| if a < b { ((a, b), 1.0) } else { ((b, a), -1.0) };
    let key = |[a, b, c, d]: [usize; 4]| {
        let ((drive, first), (measure, second)) = (undirected((a, b)), undirected((c, d)));
        ((drive, measure), first * second)
    };
    let columns: std::collections::HashMap<_, _> =
        named.iter().enumerate().map(|(column, names)| (key(*names).0, (column, key(*names).1))).collect();
    let mut taken = Vec::with_capacity(wanted.len());
    for (channel, electrodes) in wanted.iter().enumerate() {
        let (place, sign) = key(*electrodes);
        let Some((column, its_sign)) = columns.get(&place) else {
            return Err(Error::Frames {
                what: format!("columns of {}, by the electrodes in their names", table.source().display()),
                expected: format!("one for channel {} of skin {}, {}", channel + 1, skin.name, labels[channel]),
                got: format!("{} and others", table.channel_names().map_or("", |names| names[channel].as_str())),
            });
        };
        taken.push((*column, sign * its_sign));
    }
    let all_reversed = taken.iter().all(|(_, sign)| *sign < 0.0);
    if all_reversed || skin.backend.reads == Reads::Magnitude {
        taken.iter_mut().for_each(|(_, sign)| *sign = 1.0);
    }
    let moved = taken.iter().enumerate().filter(|(channel, (column, _))| channel != column).count();
    let reversed = taken.iter().filter(|(_, sign)| *sign < 0.0).count();
    if moved + reversed == 0 {
        return Ok(table.with_notes(vec!["electrodes in the header are the skin's".to_owned()]));
    }
    let note =
        format!("columns put in the skin's order by the electrodes in the header ({moved} moved, {reversed} reversed)");
    Ok(table.rearranged(&taken).with_notes(vec![note]))
}

/// The four electrodes in every name, from 1; `None` if a name does not have four numbers.
fn electrodes_of(names: &[String]) -> Option<Vec<[usize; 4]>> {
    let numbers = |name: &String| -> Option<[usize; 4]> {
        let numbers: Vec<usize> = name
            .split(|c: char| !c.is_ascii_digit())
            .filter(|digits| !digits.is_empty())
            .map(|digits| digits.parse().ok())
            .collect::<Option<_>>()?;
        numbers.try_into().ok()
    };
    let mut all: Vec<[usize; 4]> = names.iter().map(numbers).collect::<Option<_>>()?;
    if all.iter().flatten().any(|electrode| *electrode == 0) {
        all.iter_mut().flatten().for_each(|electrode| *electrode += 1);
    }
    Some(all)
}

/// Direction (cos, sin) of the principal axis of complex channels, towards positive real parts: half the angle of the
/// sum of squares.
fn common_phase(real: &[f64], imaginary: &[f64]) -> (f64, f64) {
    let finite = || real.iter().zip(imaginary).filter(|(re, im)| re.is_finite() && im.is_finite());
    let sum_real: f64 = finite().map(|(re, im)| re * re - im * im).sum();
    let sum_imaginary: f64 = finite().map(|(re, im)| 2.0 * re * im).sum();
    let angle = 0.5 * sum_imaginary.atan2(sum_real);
    (angle.cos(), angle.sin())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_and_potentials_give_the_same_channels() {
        let protocol = Skin::open("sciospec-tank").unwrap().protocol().unwrap();
        let potential = |row: usize, electrode: usize| ((row * 31 + electrode * electrode * 7) % 97) as f64;
        let pairs: Vec<(usize, usize)> = (0..16).map(|k| ((k + 1) % 16, k)).collect();
        let single: Vec<f64> = (0..16).flat_map(|row| (0..16).map(move |e| potential(row, e))).collect();
        let full: Vec<f64> =
            (0..16).flat_map(|row| (0..16).map(move |j| potential(row, j) - potential(row, (j + 1) % 16))).collect();
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let layout = Layout::SingleEnded { electrodes: 16, stimulations: pairs };
        ChannelLayout::new(&layout, &protocol, "a").unwrap().apply(&single, &mut a);
        ChannelLayout::new(&Layout::FullMatrix { electrodes: 16 }, &protocol, "b").unwrap().apply(&full, &mut b);
        assert_eq!(a, b);
    }

    #[test]
    fn columns_are_put_in_order_by_the_electrodes_in_their_names() {
        let skin = Skin::open("sciospec-tank").unwrap();
        let protocol = skin.protocol().unwrap();
        let count = protocol.channel_count();
        let labels: Vec<String> = (0..count).map(|channel| protocol.channel_label(channel)).collect();
        let table = |names: Vec<String>, values: Vec<f64>| {
            let table = FrameTable::new(Layout::Channels { count }, values, "x.csv").unwrap();
            order_by_names(table.with_channel_names(names).unwrap(), &skin)
        };
        let values: Vec<f64> = (0..count).map(|channel| channel as f64).collect();
        let same = table(labels.clone(), values.clone()).unwrap();
        assert_eq!(same.values(), values);
        // In reverse order, counted from 0, with the first one's measuring pair reversed.
        let from_zero = |label: &String| {
            let numbers: Vec<usize> = label.split(['-', '>', ' ']).filter_map(|n| n.parse().ok()).collect();
            format!("d{}_{}_m{}_{}", numbers[0] - 1, numbers[1] - 1, numbers[2] - 1, numbers[3] - 1)
        };
        let mut names: Vec<String> = labels.iter().rev().map(from_zero).collect();
        let parts: Vec<String> = names[0].split('_').map(str::to_owned).collect();
        names[0] = format!("{}_{}_m{}_{}", parts[0], parts[1], parts[3], parts[2].trim_start_matches('m'));
        let mut backwards: Vec<f64> = values.iter().rev().copied().collect();
        backwards[0] = -backwards[0];
        let ordered = table(names.clone(), backwards.clone()).unwrap();
        assert_eq!(ordered.values(), values);
        assert!(ordered.understood().contains("1 reversed"), "{}", ordered.understood());
        names[5] = names[6].clone();
        let error = table(names, backwards).unwrap_err().to_string();
        assert!(error.contains("by the electrodes in their names"), "{error}");
        // Names without electrodes are ignored.
        assert_eq!(table((0..count).map(|k| format!("ch{k}")).collect(), values.clone()).unwrap().values(), values);
    }

    #[test]
    fn a_wrong_count_is_refused_with_both_numbers() {
        let protocol = Skin::open("sciospec-tank").unwrap().protocol().unwrap();
        let error = ChannelLayout::new(&Layout::Channels { count: 207 }, &protocol, "x.csv").unwrap_err();
        assert_eq!(error.to_string(), "frames of x.csv: expected 208 channels, got 207 channels");
    }

    #[test]
    fn a_file_with_other_drives_lists_them() {
        let protocol = Skin::open("sciospec-tank").unwrap().protocol().unwrap();
        let refused = |stimulations: Vec<(usize, usize)>| {
            let layout = Layout::SingleEnded { electrodes: 16, stimulations };
            ChannelLayout::new(&layout, &protocol, "run.eit").unwrap_err().to_string()
        };
        let skipped = |step: usize| refused((0..16).map(|k| (k, (k + step) % 16)).collect());
        let message = skipped(3);
        assert!(message.ends_with("the file drives 1-4, 2-5, 3-6, ...: `drive = { skip = 2 }`"), "{message}");
        // The opposite direction round the ring is the same drive.
        assert!(skipped(13).ends_with("`drive = { skip = 2 }`"), "{}", skipped(13));
        assert!(refused((0..8).map(|k| (k, k + 8)).collect()).ends_with("`drive = \"opposite\"`"));
        let message = refused(vec![(0, 3), (5, 1)]);
        assert!(message.ends_with("the file drives 1-4, 6-2: `drive = { pairs = [[4, 1], [2, 6]] }`"), "{message}");
    }

    #[test]
    fn the_common_phase_is_that_of_the_instrument() {
        let values = [1.0, -2.0, 0.5];
        let angle: f64 = 0.4;
        let real: Vec<f64> = values.iter().map(|v| v * angle.cos()).collect();
        let imaginary: Vec<f64> = values.iter().map(|v| v * angle.sin()).collect();
        let (cosine, sine) = common_phase(&real, &imaginary);
        assert!((cosine - angle.cos()).abs() < 1e-12 && (sine - angle.sin()).abs() < 1e-12);
    }
}
