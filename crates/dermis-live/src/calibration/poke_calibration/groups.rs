//! Pokes with several touches at once. They teach how touches add up, and nothing else.

use dermis_tomo::mesh::Point;
use serde::{Deserialize, Serialize};

use super::frames::{PokeFrames, differences_of, frame_with_gaps};
use crate::Error;
use crate::calibration::pokes::Pokes;
use crate::prepare::Prepared;
use crate::reference::are_pairs;

/// A poke with several touches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PokeGroup {
    /// Difference data, model volts.
    #[serde(deserialize_with = "frame_with_gaps")]
    pub frame: Vec<f64>,
    /// Positions of all touches, metres.
    pub touches_m: Vec<Point>,
}

/// Pokes divided into those of one touch and those of several.
pub(super) struct Parts<'a> {
    /// The pokes of one touch.
    pub pokes: Pokes,
    singles: Selection<'a>,
    several: Selection<'a>,
    touches_m: Vec<Vec<Point>>,
}

/// Some of the measured frames.
struct Selection<'a> {
    are_differences: bool,
    baselines: Cow<'a>,
    frames: Vec<Vec<f64>>,
}

type Cow<'a> = std::borrow::Cow<'a, [Vec<f64>]>;

impl<'a> Selection<'a> {
    fn of(measured: PokeFrames<'a>, rows: &[usize]) -> Self {
        let pick = |frames: &[Vec<f64>]| rows.iter().map(|&i| frames[i].clone()).collect::<Vec<_>>();
        match measured {
            PokeFrames::Differences(frames) => {
                Self { are_differences: true, baselines: Cow::Borrowed(&[]), frames: pick(frames) }
            }
            PokeFrames::Readings { baselines, frames } => {
                let baselines =
                    if are_pairs(baselines, frames) { Cow::Owned(pick(baselines)) } else { Cow::Borrowed(baselines) };
                Self { are_differences: false, baselines, frames: pick(frames) }
            }
        }
    }

    fn frames(&self) -> PokeFrames<'_> {
        if self.are_differences {
            PokeFrames::Differences(&self.frames)
        } else {
            PokeFrames::Readings { baselines: &self.baselines, frames: &self.frames }
        }
    }
}

impl Parts<'_> {
    /// The frames of one touch.
    pub fn singles(&self) -> PokeFrames<'_> {
        self.singles.frames()
    }

    /// The pokes of several touches.
    pub fn groups(self, prepared: &Prepared) -> Result<Vec<PokeGroup>, Error> {
        let (_, differences) = differences_of(prepared, self.several.frames())?;
        Ok(differences
            .into_iter()
            .zip(self.touches_m)
            .map(|(frame, touches_m)| PokeGroup { frame, touches_m })
            .collect())
    }
}

/// Divides pokes by their number of touches. `None` if all have one.
pub(super) fn split<'a>(measured: PokeFrames<'a>, pokes: &Pokes) -> Result<Option<Parts<'a>>, Error> {
    if pokes.further_m.iter().all(Vec::is_empty) {
        return Ok(None);
    }
    let (count, frames) = (pokes.positions_m.len(), measured.frames().len());
    if frames != count {
        return Err(Error::Frames {
            what: "pokes".into(),
            expected: format!("{count} frames, as many as groups of positions"),
            got: frames.to_string(),
        });
    }
    let (several, single): (Vec<usize>, Vec<usize>) = (0..count).partition(|&i| !pokes.further_m[i].is_empty());
    let all_of = |i: usize| std::iter::once(pokes.positions_m[i]).chain(pokes.further_m[i].iter().copied()).collect();
    Ok(Some(Parts {
        pokes: Pokes {
            positions_m: single.iter().map(|&i| pokes.positions_m[i]).collect(),
            further_m: Vec::new(),
            loads: pokes
                .loads
                .as_ref()
                .map(|(quantity, loads)| (*quantity, single.iter().map(|&i| loads[i]).collect())),
        },
        singles: Selection::of(measured, &single),
        touches_m: several.iter().map(|&i| all_of(i)).collect(),
        several: Selection::of(measured, &several),
    }))
}
