//! Protocols in their plain forms, and how a file may depart from them.

use dermis_skin::{DrivePattern, MeasurePattern, ReferenceChoice};

/// What each departure from the plain form of a protocol costs, in correlation: of two that fit alike the plainer is
/// named.
pub(super) const DEPARTURE: f64 = 0.003;

/// Pairs of electrodes: each with the one so many farther on, or a list.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Pairs {
    Ring(usize),
    Listed(Vec<[usize; 2]>),
}

impl Pairs {
    fn list(&self, count: usize) -> Vec<[usize; 2]> {
        match self {
            Self::Ring(distance) => (0..count).map(|k| [k, (k + distance) % count]).collect(),
            Self::Listed(pairs) => pairs.clone(),
        }
    }

    fn in_words(&self, count: usize) -> String {
        match self {
            Self::Ring(1) => "adjacent".into(),
            Self::Ring(distance) if 2 * distance == count => "opposite".into(),
            Self::Ring(distance) if 2 * (distance + 1) == count => "pseudo-polar".into(),
            Self::Ring(distance) => format!("skip-{}", distance - 1),
            Self::Listed(_) => "listed".into(),
        }
    }
}

/// What is read for each drive.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Read {
    Pairs(Pairs),
    ToSink,
    ToMean,
}

/// One reading, by electrodes.
#[derive(Clone, Debug)]
pub(super) enum Reading {
    Pair([usize; 2]),
    ToSink(usize),
    ToMean(usize),
}

/// A protocol in its plain form.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shape {
    pub(super) drives: Pairs,
    pub(super) reads: Read,
    /// Readings at driven electrodes are left out.
    pub(super) drop: bool,
}

impl Shape {
    /// All that are known, of so many electrodes.
    pub(super) fn all(count: usize) -> Vec<Self> {
        let mut all = Vec::new();
        for drive in 1..=count / 2 {
            let drives = Pairs::Ring(drive);
            for read in 1..=count / 2 {
                for drop in [true, false] {
                    all.push(Self { drives: drives.clone(), reads: Read::Pairs(Pairs::Ring(read)), drop });
                }
            }
            for reads in [Read::ToMean, Read::ToSink] {
                all.push(Self { drives: drives.clone(), reads, drop: false });
            }
        }
        all
    }

    /// Readings of a frame.
    pub(super) fn readings(&self, count: usize) -> usize {
        let drives = self.drives.list(count);
        let Read::Pairs(pairs) = &self.reads else { return drives.len() * count };
        let reads = pairs.list(count);
        if !self.drop {
            return drives.len() * reads.len();
        }
        let is_free = |drive: &[usize; 2], read: &[usize; 2]| !read.iter().any(|e| drive.contains(e));
        if let (Pairs::Ring(_), Pairs::Ring(_)) = (&self.drives, pairs) {
            // On a ring every drive leaves as many.
            return count * reads.iter().filter(|read| is_free(&drives[0], read)).count();
        }
        drives.iter().map(|drive| reads.iter().filter(|read| is_free(drive, read)).count()).sum()
    }
}

/// A protocol, and how the file departs from its plain form.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hypothesis {
    pub(super) shape: Shape,
    pub(super) rotating: bool,
    /// Electrode that the file counts as the first, from 0.
    pub(super) turn: usize,
    /// Counted the other way round.
    pub(super) mirrored: bool,
    /// Place in its list of the drive, and of the reading, that come first.
    pub(super) first_drive: usize,
    pub(super) first_read: usize,
    /// The list of readings runs backwards.
    pub(super) backwards: bool,
    pub(super) reversed_sign: bool,
    pub(super) rectified: bool,
}

impl Default for Hypothesis {
    fn default() -> Self {
        Self {
            shape: Shape { drives: Pairs::Ring(1), reads: Read::Pairs(Pairs::Ring(1)), drop: true },
            rotating: false,
            turn: 0,
            mirrored: false,
            first_drive: 0,
            first_read: 0,
            backwards: false,
            reversed_sign: false,
            rectified: false,
        }
    }
}

impl Hypothesis {
    /// Drives [sink, source] and readings, in the file's order, by the model's electrodes.
    pub(super) fn lists(&self, count: usize) -> (Vec<[usize; 2]>, Vec<Reading>) {
        let renamed = |e: usize| if self.mirrored { (count + self.turn - e) % count } else { (e + self.turn) % count };
        let mut drives: Vec<[usize; 2]> = self.shape.drives.list(count);
        drives.iter_mut().for_each(|pair| *pair = pair.map(renamed));
        let shift = self.first_drive % drives.len().max(1);
        drives.rotate_left(shift);
        let mut reads: Vec<Reading> = match &self.shape.reads {
            Read::Pairs(pairs) => pairs.list(count).into_iter().map(|pair| Reading::Pair(pair.map(renamed))).collect(),
            Read::ToSink => (0..count).map(|e| Reading::ToSink(renamed(e))).collect(),
            Read::ToMean => (0..count).map(|e| Reading::ToMean(renamed(e))).collect(),
        };
        let shift = self.first_read % reads.len().max(1);
        reads.rotate_left(shift);
        if self.backwards {
            reads.reverse();
        }
        (drives, reads)
    }

    fn departures(&self) -> usize {
        usize::from(self.rotating)
            + usize::from(self.turn != 0)
            + usize::from(self.mirrored)
            + usize::from(self.first_drive != 0)
            + usize::from(self.first_read != 0)
            + usize::from(self.backwards)
            + usize::from(self.reversed_sign)
            + usize::from(self.rectified)
    }

    /// True where a skin file has words for it.
    pub(super) fn is_named(&self) -> bool {
        let only_rotating = usize::from(self.rotating) + usize::from(self.rectified);
        let is_ring = matches!(self.shape.drives, Pairs::Ring(_));
        self.departures() == only_rotating && is_ring
    }

    pub(super) fn in_words(&self, count: usize) -> String {
        let reads = match &self.shape.reads {
            Read::Pairs(pairs) => format!("{} measurement", pairs.in_words(count)),
            Read::ToSink => "every electrode against the sink".into(),
            Read::ToMean => "every electrode against the mean of all".into(),
        };
        let mut text = format!("{} drive, {reads}", self.shape.drives.in_words(count));
        let mut add = |is: bool, what: String| {
            if is {
                text += ", ";
                text += &what;
            }
        };
        add(!self.shape.drop && matches!(self.shape.reads, Read::Pairs(_)), "driven electrodes read too".into());
        add(self.rotating, "measurements rotating from the drive pair".into());
        add(self.turn != 0, format!("electrodes counted from number {}", self.turn + 1));
        add(self.mirrored, "electrodes counted the other way round".into());
        add(self.first_drive != 0, format!("the drive list begun at pair {}", self.first_drive + 1));
        add(self.first_read != 0, format!("the measurement list begun at number {}", self.first_read + 1));
        add(self.backwards, "the measurement list run backwards".into());
        add(self.reversed_sign, "sign reversed".into());
        add(self.rectified, "magnitudes".into());
        text
    }
}

impl Hypothesis {
    pub(super) fn named(&self, count: usize) -> (DrivePattern, MeasurePattern) {
        let drive = match self.shape.drives {
            Pairs::Ring(1) => DrivePattern::Adjacent,
            Pairs::Ring(distance) if 2 * distance == count => DrivePattern::Opposite,
            Pairs::Ring(distance) if 2 * (distance + 1) == count => DrivePattern::PseudoPolar,
            Pairs::Ring(distance) => DrivePattern::Skip(distance - 1),
            Pairs::Listed(_) => self.listed(count).0,
        };
        let measure = match self.shape.reads {
            Read::Pairs(Pairs::Ring(1)) => MeasurePattern::Adjacent,
            Read::Pairs(Pairs::Ring(distance)) if 2 * distance == count => MeasurePattern::Opposite,
            Read::Pairs(Pairs::Ring(distance)) if 2 * (distance + 1) == count => MeasurePattern::PseudoPolar,
            Read::Pairs(Pairs::Ring(distance)) => MeasurePattern::Skip(distance - 1),
            _ => self.listed(count).1,
        };
        (drive, measure)
    }

    /// As lists of pairs, from 1; a reversed sign is a drive the other way round.
    pub(super) fn listed(&self, count: usize) -> (DrivePattern, MeasurePattern) {
        let (drives, reads) = self.lists(count);
        let number = |pair: [usize; 2]| pair.map(|e| e as u32 + 1);
        let drive =
            |[sink, source]: [usize; 2]| number(if self.reversed_sign { [source, sink] } else { [sink, source] });
        let pairs: Vec<[u32; 2]> = reads
            .iter()
            .filter_map(|read| if let Reading::Pair(pair) = read { Some(number(*pair)) } else { None })
            .collect();
        let measure = match self.shape.reads {
            Read::Pairs(_) => MeasurePattern::Pairs(pairs),
            Read::ToSink => MeasurePattern::SingleEnded(ReferenceChoice::Sink),
            Read::ToMean => MeasurePattern::SingleEnded(ReferenceChoice::Mean),
        };
        (DrivePattern::Pairs(drives.into_iter().map(drive).collect()), measure)
    }
}

pub(super) fn orders(plain: Hypothesis) -> [Hypothesis; 2] {
    [Hypothesis { rotating: false, ..plain.clone() }, Hypothesis { rotating: true, ..plain }]
}

/// The same with electrodes counted from each of the first so many, both ways round.
pub(super) fn numberings(plain: &Hypothesis, turns: usize) -> Vec<Hypothesis> {
    let numbered = |k: usize| Hypothesis { turn: k / 2, mirrored: k % 2 == 1, ..plain.clone() };
    (0..2 * turns).map(numbered).collect()
}

/// The same with the lists of drives and readings begun elsewhere, or run through backwards.
pub(super) fn lists(plain: &Hypothesis, count: usize) -> Vec<Hypothesis> {
    let mut all = Vec::with_capacity(4 * count);
    for backwards in [false, true] {
        for first in 0..count {
            all.push(Hypothesis { first_read: first, backwards, ..plain.clone() });
            all.push(Hypothesis { first_drive: first, backwards, ..plain.clone() });
        }
    }
    all.retain(|hypothesis| hypothesis != plain);
    all
}

/// What hypotheses are ranked by.
pub(super) fn score(correlation: f64, hypothesis: &Hypothesis) -> f64 {
    correlation - DEPARTURE * hypothesis.departures() as f64
}
