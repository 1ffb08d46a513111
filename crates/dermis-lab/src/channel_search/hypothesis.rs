//! Protocols in their plain forms, and the ways in which a file may depart from them.

use dermis_skin::{AgainstWord, DrivePattern, ListedChannel, MeasurePattern, ReferenceChoice};

/// Penalty in correlation for each departure from a protocol's plain form. It breaks ties in favour of the plainer
/// one.
pub(super) const DEPARTURE: f64 = 0.003;

/// Pairs of electrodes.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pairs {
    /// Pairs (k, k + n), modulo the number of electrodes.
    Ring(usize),
    /// All pairs of electrodes: (1, 2), (1, 3), ..., (N-1, N).
    All,
    /// An explicit list, counted from 0.
    Listed(Vec<[usize; 2]>),
}

impl Pairs {
    fn list(&self, count: usize) -> Vec<[usize; 2]> {
        match self {
            Self::Ring(distance) => (0..count).map(|k| [k, (k + distance) % count]).collect(),
            Self::All => (0..count).flat_map(|a| (a + 1..count).map(move |b| [a, b])).collect(),
            Self::Listed(pairs) => pairs.clone(),
        }
    }

    fn in_words(&self, count: usize) -> String {
        match self {
            Self::Ring(1) => "adjacent".into(),
            Self::Ring(distance) if 2 * distance == count => "opposite".into(),
            Self::Ring(distance) if 2 * (distance + 1) == count => "pseudo-polar".into(),
            Self::Ring(distance) => format!("skip-{}", distance - 1),
            Self::All => "every pair as".into(),
            Self::Listed(_) => "listed".into(),
        }
    }
}

/// The readings taken for each drive.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Read {
    Pairs(Pairs),
    ToSink,
    ToMean,
    /// The driving pair.
    Itself,
}

/// One reading, by its electrodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reading {
    Pair([usize; 2]),
    ToSink(usize),
    ToMean(usize),
    Itself,
}

/// One number in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cell {
    /// Sink and source of the current.
    pub(super) drive: [usize; 2],
    pub(super) read: Reading,
}

/// A protocol in its plain form.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Shape {
    /// Every drive with the same readings.
    Grid {
        drives: Pairs,
        reads: Read,
        /// Omit readings at driven electrodes.
        drop: bool,
    },
    /// The skin file's own list of channels.
    Channels(Vec<Cell>),
}

impl Shape {
    /// All known protocols for this number of electrodes.
    pub(super) fn all(count: usize) -> Vec<Self> {
        let mut all = Vec::new();
        for drive in 1..=count / 2 {
            let drives = Pairs::Ring(drive);
            for read in 1..=count / 2 {
                for drop in [true, false] {
                    all.push(Self::Grid { drives: drives.clone(), reads: Read::Pairs(Pairs::Ring(read)), drop });
                }
            }
            for reads in [Read::ToMean, Read::ToSink, Read::Itself] {
                all.push(Self::Grid { drives: drives.clone(), reads, drop: false });
            }
        }
        all.push(Self::Grid { drives: Pairs::All, reads: Read::Itself, drop: false });
        all
    }

    /// Number of readings in a frame.
    pub(super) fn readings(&self, count: usize) -> usize {
        let (drives, reads, drop) = match self {
            Self::Grid { drives, reads, drop } => (drives, reads, *drop),
            Self::Channels(cells) => return cells.len(),
        };
        let list = drives.list(count);
        let pairs = match reads {
            Read::Pairs(pairs) => pairs,
            Read::Itself => return list.len(),
            Read::ToSink | Read::ToMean => return list.len() * count,
        };
        let reads = pairs.list(count);
        if !drop {
            return list.len() * reads.len();
        }
        let is_free = |drive: &[usize; 2], read: &[usize; 2]| !read.iter().any(|e| drive.contains(e));
        if let (Pairs::Ring(_), Pairs::Ring(_)) = (drives, pairs) {
            // On a ring every drive keeps the same number of readings.
            return count * reads.iter().filter(|read| is_free(&list[0], read)).count();
        }
        list.iter().map(|drive| reads.iter().filter(|read| is_free(drive, read)).count()).sum()
    }

    /// Numbers of drives and of readings in the grid. A list counts as one drive with all its channels.
    pub(super) fn sides(&self, count: usize) -> (usize, usize) {
        match self {
            Self::Grid { drives, reads: Read::Pairs(pairs), .. } => (drives.list(count).len(), pairs.list(count).len()),
            Self::Grid { drives, reads: Read::Itself, .. } => (drives.list(count).len(), 1),
            Self::Grid { drives, .. } => (drives.list(count).len(), count),
            Self::Channels(cells) => (1, cells.len()),
        }
    }

    /// The cell of a drive and a reading, with electrodes renumbered; `None` if the reading is omitted.
    pub(super) fn cell(&self, lists: &(Vec<[usize; 2]>, Vec<Reading>), drive: usize, read: usize) -> Option<Cell> {
        let drop = match self {
            Self::Grid { drop, .. } => *drop,
            Self::Channels(cells) => return Some(cells[read]),
        };
        let cell = Cell { drive: lists.0[drive], read: lists.1[read] };
        match cell.read {
            Reading::Pair(pair) if drop && pair.iter().any(|e| cell.drive.contains(e)) => None,
            _ => Some(cell),
        }
    }

    /// Drives as [sink, source] and readings, in plain order, with electrodes renumbered.
    pub(super) fn lists(&self, count: usize, renamed: impl Fn(usize) -> usize) -> (Vec<[usize; 2]>, Vec<Reading>) {
        let Self::Grid { drives, reads, .. } = self else { return (Vec::new(), Vec::new()) };
        let drives = drives.list(count).into_iter().map(|pair| pair.map(&renamed)).collect();
        let reads = match reads {
            Read::Pairs(pairs) => pairs.list(count).into_iter().map(|p| Reading::Pair(p.map(&renamed))).collect(),
            Read::ToSink => (0..count).map(|e| Reading::ToSink(renamed(e))).collect(),
            Read::ToMean => (0..count).map(|e| Reading::ToMean(renamed(e))).collect(),
            Read::Itself => vec![Reading::Itself],
        };
        (drives, reads)
    }
}

/// The order in which a file runs through the grid of drives and readings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Nesting {
    /// All readings of the first drive, then those of the second.
    #[default]
    DriveMajor,
    /// The first reading of every drive, then the second: a table of drives x readings stored by columns.
    Transposed,
    /// All drives for the first measuring pair, then for the second.
    MeasurementMajor,
}

impl Nesting {
    pub(super) const ALL: [Self; 3] = [Self::DriveMajor, Self::Transposed, Self::MeasurementMajor];
}

/// The order in which a file lists the cells of a grid.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Arrangement {
    /// Index of the drive that comes first.
    pub(super) first_drive: usize,
    /// The drives run backwards from there.
    pub(super) drives_backwards: bool,
    /// Index of the reading that comes first.
    pub(super) first_read: usize,
    /// The readings run backwards from there.
    pub(super) backwards: bool,
    /// Each drive's readings start one place later than the previous drive's.
    pub(super) rotating: bool,
    pub(super) nesting: Nesting,
}

impl Arrangement {
    /// Calls `put` with the drive and reading of each cell in the file's order, skipping cells that `kept` rejects.
    /// Returns false if the grid cannot be nested like this because its rows differ in length.
    pub(super) fn walk(
        &self,
        (drives, reads): (usize, usize),
        kept: impl Fn(usize, usize) -> bool,
        mut put: impl FnMut(usize, usize),
    ) -> bool {
        let step =
            |first: usize, back: bool, k: usize, of: usize| if back { (first + of - k) % of } else { (first + k) % of };
        let at = |i: usize, j: usize| {
            let shift = if self.rotating { i % reads } else { 0 };
            let drive = step(self.first_drive, self.drives_backwards, i, drives);
            (drive, step(self.first_read, self.backwards, (j + shift) % reads, reads))
        };
        match self.nesting {
            Nesting::DriveMajor => {
                for i in 0..drives {
                    for (drive, read) in (0..reads).map(|j| at(i, j)).filter(|&(d, r)| kept(d, r)) {
                        put(drive, read);
                    }
                }
            }
            Nesting::MeasurementMajor => {
                for j in 0..reads {
                    for (drive, read) in (0..drives).map(|i| at(i, j)).filter(|&(d, r)| kept(d, r)) {
                        put(drive, read);
                    }
                }
            }
            Nesting::Transposed => {
                let rows: Vec<Vec<(usize, usize)>> =
                    (0..drives).map(|i| (0..reads).map(|j| at(i, j)).filter(|&(d, r)| kept(d, r)).collect()).collect();
                let length = rows.first().map_or(0, Vec::len);
                if rows.iter().any(|row| row.len() != length) {
                    return false;
                }
                for column in 0..length {
                    rows.iter().for_each(|row| put(row[column].0, row[column].1));
                }
            }
        }
        true
    }

    fn departures(&self) -> usize {
        usize::from(self.first_drive != 0)
            + usize::from(self.drives_backwards)
            + usize::from(self.first_read != 0)
            + usize::from(self.backwards)
            + usize::from(self.rotating)
            + usize::from(self.nesting != Nesting::DriveMajor)
    }
}

/// A protocol, and the file's departures from its plain form.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) shape: Shape,
    /// Index of the electrode that the file counts as the first.
    pub(super) turn: usize,
    /// Electrodes are counted in the opposite direction.
    pub(super) mirrored: bool,
    pub(super) order: Arrangement,
    pub(super) reversed_sign: bool,
    pub(super) rectified: bool,
}

impl Hypothesis {
    pub(super) fn plain(shape: &Shape) -> Self {
        let order = Arrangement::default();
        Self { shape: shape.clone(), turn: 0, mirrored: false, order, reversed_sign: false, rectified: false }
    }

    /// The numbers of the file in order, by the model's electrodes; `None` if the grid cannot be listed in this
    /// order.
    pub(super) fn cells(&self, count: usize) -> Option<Vec<Cell>> {
        let renamed = |e: usize| if self.mirrored { (count + self.turn - e) % count } else { (e + self.turn) % count };
        let lists = self.shape.lists(count, renamed);
        let cell = |drive: usize, read: usize| {
            let cell = self.shape.cell(&lists, drive, read)?;
            // Channels from the skin file's own list still use the file's numbers.
            let is_list = matches!(self.shape, Shape::Channels(_));
            Some(if is_list { cell.map(renamed) } else { cell })
        };
        let mut cells = Vec::new();
        let is_possible = self.order.walk(
            self.shape.sides(count),
            |drive, read| cell(drive, read).is_some(),
            |drive, read| cells.extend(cell(drive, read)),
        );
        is_possible.then_some(cells)
    }

    fn departures(&self) -> usize {
        let own = [self.turn != 0, self.mirrored, self.reversed_sign, self.rectified];
        self.order.departures() + own.into_iter().filter(|departs| *departs).count()
    }

    pub(super) fn in_words(&self, count: usize) -> String {
        let mut text = match &self.shape {
            Shape::Channels(_) => "the skin file's list of channels".to_string(),
            Shape::Grid { drives, reads, .. } => {
                let reads = match reads {
                    Read::Pairs(pairs) => format!("{} measurement", pairs.in_words(count)),
                    Read::ToSink => "every electrode against the sink".into(),
                    Read::ToMean => "every electrode against the mean of all".into(),
                    Read::Itself => "each pair reading itself".into(),
                };
                format!("{} drive, {reads}", drives.in_words(count))
            }
        };
        let mut add = |is: bool, what: String| {
            if is {
                text += ", ";
                text += &what;
            }
        };
        let is_kept = matches!(&self.shape, Shape::Grid { reads: Read::Pairs(_), drop: false, .. });
        let order = &self.order;
        let listed = if matches!(self.shape, Shape::Channels(_)) { "list" } else { "measurement list" };
        add(is_kept, "driven electrodes read too".into());
        add(order.nesting == Nesting::Transposed, "the table of drives and measurements stored by columns".into());
        add(order.nesting == Nesting::MeasurementMajor, "all drives for the first measurement, then the next".into());
        add(order.rotating, "measurements rotating from the drive pair".into());
        add(self.turn != 0, format!("electrodes counted from number {}", self.turn + 1));
        add(self.mirrored, "electrodes counted the other way round".into());
        add(order.first_drive != 0, format!("the drive list started at pair {}", order.first_drive + 1));
        add(order.drives_backwards, "the drive list reversed".into());
        add(order.first_read != 0, format!("the {listed} started at number {}", order.first_read + 1));
        add(order.backwards, format!("the {listed} reversed"));
        add(self.reversed_sign, "sign reversed".into());
        add(self.rectified, "magnitudes".into());
        text
    }

    /// Drive and measurement patterns in a skin file's terms, if it has terms for them.
    pub(super) fn named(&self, count: usize) -> Option<(DrivePattern, MeasurePattern)> {
        let only = usize::from(self.order.rotating) + usize::from(self.rectified);
        let Shape::Grid { drives: Pairs::Ring(drive), reads, .. } = &self.shape else { return None };
        if self.departures() != only {
            return None;
        }
        let drive = match *drive {
            1 => DrivePattern::Adjacent,
            distance if 2 * distance == count => DrivePattern::Opposite,
            distance if 2 * (distance + 1) == count => DrivePattern::PseudoPolar,
            distance => DrivePattern::Skip(distance - 1),
        };
        let measure = match reads {
            Read::Pairs(Pairs::Ring(1)) => MeasurePattern::Adjacent,
            Read::Pairs(Pairs::Ring(distance)) if 2 * distance == count => MeasurePattern::Opposite,
            Read::Pairs(Pairs::Ring(distance)) if 2 * (distance + 1) == count => MeasurePattern::PseudoPolar,
            Read::Pairs(Pairs::Ring(distance)) => MeasurePattern::Skip(distance - 1),
            Read::ToSink => MeasurePattern::SingleEnded(ReferenceChoice::Sink),
            Read::ToMean => MeasurePattern::SingleEnded(ReferenceChoice::Mean),
            Read::Pairs(_) | Read::Itself => return None,
        };
        Some((drive, measure))
    }

    /// The channels as a list for a skin file. A reversed sign becomes a reversed drive.
    pub(super) fn listed(&self, count: usize) -> Vec<ListedChannel> {
        let cells = self.cells(count).unwrap_or_default();
        cells.into_iter().map(|cell| cell.listed(self.reversed_sign)).collect()
    }
}

impl Cell {
    fn map(self, renamed: impl Fn(usize) -> usize) -> Self {
        let read = match self.read {
            Reading::Pair(pair) => Reading::Pair(pair.map(&renamed)),
            Reading::ToSink(e) => Reading::ToSink(renamed(e)),
            Reading::ToMean(e) => Reading::ToMean(renamed(e)),
            Reading::Itself => Reading::Itself,
        };
        Self { drive: self.drive.map(&renamed), read }
    }

    fn listed(self, reversed: bool) -> ListedChannel {
        let number = |e: usize| e as u32 + 1;
        let [sink, source] = self.drive.map(number);
        let [low, high] = if reversed { [source, sink] } else { [sink, source] };
        match self.read {
            Reading::Pair([plus, minus]) => ListedChannel::Pairs([low, high, number(plus), number(minus)]),
            Reading::ToMean(e) => ListedChannel::SingleEnded(low, high, number(e), AgainstWord::Mean),
            // The sink against itself reads zero with either sign.
            Reading::ToSink(e) if number(e) == sink => ListedChannel::SingleEnded(low, high, low, AgainstWord::Sink),
            Reading::ToSink(e) if reversed => ListedChannel::Pairs([low, high, number(e), sink]),
            Reading::ToSink(e) => ListedChannel::SingleEnded(low, high, number(e), AgainstWord::Sink),
            Reading::Itself if reversed => ListedChannel::Pairs([low, high, source, sink]),
            Reading::Itself => ListedChannel::Itself([sink, source]),
        }
    }

    /// The cell of a channel in a skin file's list.
    pub(super) fn of(channel: &ListedChannel) -> Self {
        let index = |number: u32| (number as usize).saturating_sub(1);
        match *channel {
            ListedChannel::Pairs([sink, source, plus, minus]) => {
                Self { drive: [index(sink), index(source)], read: Reading::Pair([index(plus), index(minus)]) }
            }
            ListedChannel::Itself([a, b]) => Self { drive: [index(a), index(b)], read: Reading::Itself },
            ListedChannel::SingleEnded(sink, source, plus, against) => {
                let read = match against {
                    AgainstWord::Mean => Reading::ToMean(index(plus)),
                    AgainstWord::Sink => Reading::ToSink(index(plus)),
                };
                Self { drive: [index(sink), index(source)], read }
            }
        }
    }
}

/// The figure that hypotheses are ranked by.
pub(super) fn score(correlation: f64, hypothesis: &Hypothesis) -> f64 {
    correlation - DEPARTURE * hypothesis.departures() as f64
}
