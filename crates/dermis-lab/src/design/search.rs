//! Searches for a better skin: varies what the user frees, and keeps the candidate with the smallest position bound
//! at its worst place. All candidates get the same frame time, so reading more channels makes each noisier: noise
//! power grows in proportion to the number of readings, starting from the skin file's assumed noise in volts.

use dermis_tomo::mesh::ElectrodeShape;

use super::SharedInstrument;
use super::maps::{Maps, Noise, Summary};
use crate::Error;
use dermis_live::prepare::Prepared;
use dermis_skin::{DrivePattern, Electrodes, MeasurePattern, Modality, Pad, Pair, RimElectrode, Skin};

/// A property that a search may change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// Spacing of the driving and the measuring pairs, in every combination.
    Protocol,
    /// Spacing of the driving pairs only.
    Drive,
    /// Number of electrodes, placed by the skin file's rule.
    Count,
    /// Position of each electrode.
    Electrodes,
}

/// A skin and its position bound.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// The skin file.
    pub skin: Skin,
    /// Bound on the position, metres.
    pub position_m: Summary,
}

/// Settings of a search.
#[derive(Clone, Debug)]
pub struct Search {
    /// Properties to vary, in this order; each starts from the best skin found before.
    pub freed: Vec<Freedom>,
    /// Amplitude of the touch: a relative change of conductivity.
    pub amplitude: f64,
    /// Places along the longer side of the maps.
    pub along: usize,
    /// Noise of a reading of the original skin.
    pub noise: Noise,
}

/// Minimum relative gain to accept a candidate. Anything smaller may come from the mesh, which differs between
/// candidates.
const LEAST_GAIN: f64 = 0.005;
/// First step of an electrode, relative to the mean spacing of neighbours; halved each round.
const FIRST_STEP: f64 = 0.25;
/// Rounds over all electrodes.
const ROUNDS: u32 = 3;
/// Numbers of rim electrodes to try.
const RIM_COUNTS: [usize; 10] = [6, 8, 10, 12, 14, 16, 20, 24, 28, 32];
/// Pads per side to try, or intervals per side for pads along a rim.
const PER_SIDE: std::ops::RangeInclusive<usize> = 2..=8;

/// Runs a search and returns the original skin and the best one. `progress` gets the number of candidates judged and
/// the total.
///
/// # Errors
/// The original skin is invalid, or nothing can be varied as requested. Invalid candidates (electrodes that overlap
/// or leave the skin, pairs of one electrode) are skipped.
pub fn improve(skin: &Skin, search: &Search, progress: impl FnMut(usize, usize)) -> Result<[Candidate; 2], Error> {
    if skin.modality == Modality::Mit {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: format!("protocol of {}, for --improve", skin.name),
            expected: "electrodes".into(),
            got: "coils, whose pairs are all read".into(),
        }));
    }
    if skin.backend.channels.is_some() && search.freed.contains(&Freedom::Drive) {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: format!("drives of {}, for --improve drive", skin.name),
            expected: "a measuring pattern".into(),
            got: "a list of channels; let the whole protocol vary (--improve protocol)".into(),
        }));
    }
    let prepared = Prepared::new(skin.clone())?;
    let instrument = SharedInstrument::of(&prepared, search.noise)?;
    let judge = Judge { instrument, amplitude: search.amplitude, along: search.along };
    let own = Candidate { position_m: judge.summary(&prepared)?, skin: skin.clone() };
    let mut state = State { judge, best: own.clone(), done: 0, all: 0, progress };
    state.all = search.freed.iter().map(|freedom| candidates(*freedom, skin)).sum::<Result<usize, Error>>()?;
    for freedom in &search.freed {
        match freedom {
            Freedom::Protocol | Freedom::Drive => state.patterns(*freedom == Freedom::Drive)?,
            Freedom::Count => state.counts()?,
            Freedom::Electrodes => state.places()?,
        }
    }
    Ok([own, state.best])
}

/// Evaluates candidates.
struct Judge {
    instrument: SharedInstrument,
    amplitude: f64,
    along: usize,
}

impl Judge {
    fn summary(&self, prepared: &Prepared) -> Result<Summary, Error> {
        let noise = self.instrument.noise_of(prepared);
        Ok(Summary::of(&Maps::new(prepared, noise, self.amplitude, self.along)?.position_m))
    }
}

struct State<P> {
    judge: Judge,
    best: Candidate,
    done: usize,
    all: usize,
    progress: P,
}

impl<P: FnMut(usize, usize)> State<P> {
    /// Keeps a candidate if it is better; returns whether it was.
    fn consider(&mut self, skin: Skin) -> bool {
        let judged =
            Prepared::new(skin.clone()).map_err(Error::from).and_then(|prepared| self.judge.summary(&prepared));
        self.done += 1;
        (self.progress)(self.done, self.all.max(self.done));
        match judged {
            Ok(position_m) if position_m.worst < (1.0 - LEAST_GAIN) * self.best.position_m.worst => {
                self.best = Candidate { skin, position_m };
                true
            }
            _ => false,
        }
    }

    fn patterns(&mut self, drive_only: bool) -> Result<(), Error> {
        let start = self.best.skin.clone();
        let electrodes = start.electrode_shapes().len();
        for (drive, measure) in patterns(electrodes, drive_only) {
            let mut skin = start.clone();
            skin.backend.drive = DrivePattern::Skip(drive);
            if let Some(measure) = measure {
                skin.backend.measure = MeasurePattern::Skip(measure);
            }
            self.consider(skin);
        }
        Ok(())
    }

    fn counts(&mut self) -> Result<(), Error> {
        let start = self.best.skin.clone();
        for electrodes in counts(&start)? {
            let mut skin = start.clone();
            skin.frontend.electrodes = electrodes;
            self.consider(skin);
        }
        Ok(())
    }

    /// Moves one electrode after the other, keeping every move that helps.
    fn places(&mut self) -> Result<(), Error> {
        let start = self.best.skin.clone();
        self.best.skin.frontend.electrodes = listed(&start)?;
        let count = start.electrode_shapes().len();
        for round in 0..ROUNDS {
            let step = FIRST_STEP * 0.5_f64.powi(round as i32);
            for electrode in 0..count {
                for direction in directions(&self.best.skin) {
                    let mut skin = self.best.skin.clone();
                    shift(&mut skin, electrode, step, *direction, count);
                    self.consider(skin);
                }
            }
        }
        Ok(())
    }
}

/// Number of candidates for a freedom.
fn candidates(freedom: Freedom, skin: &Skin) -> Result<usize, Error> {
    let electrodes = skin.electrode_shapes().len();
    Ok(match freedom {
        Freedom::Protocol | Freedom::Drive => patterns(electrodes, freedom == Freedom::Drive).len(),
        Freedom::Count => counts(skin)?.len(),
        Freedom::Electrodes => {
            let mut free = skin.clone();
            free.frontend.electrodes = listed(skin)?;
            ROUNDS as usize * electrodes * directions(&free).len()
        }
    })
}

/// Every spacing around the skin, of the driving pairs or of both kinds of pairs.
fn patterns(electrodes: usize, drive_only: bool) -> Vec<(usize, Option<usize>)> {
    let skips = 0..(electrodes / 2).max(1);
    let measure = |drive| {
        let all: Vec<_> = if drive_only { vec![None] } else { skips.clone().map(Some).collect() };
        all.into_iter().map(move |measure| (drive, measure))
    };
    skips.clone().flat_map(measure).collect()
}

/// The skin's electrodes placed by its own rule, in other numbers.
fn counts(skin: &Skin) -> Result<Vec<Electrodes>, Error> {
    let same = &skin.frontend.electrodes;
    let others: Vec<Electrodes> = match same {
        Electrodes::Rim { width_mm, start_deg, clockwise, .. } => {
            let rim =
                |count| Electrodes::Rim { count, width_mm: *width_mm, start_deg: *start_deg, clockwise: *clockwise };
            RIM_COUNTS.into_iter().map(rim).collect()
        }
        Electrodes::RimPads { per_side, pitch_mm, size_mm } => {
            let (per_side, pitch_mm) = (per_side.both(), pitch_mm.both());
            let sides_mm = [0, 1].map(|axis| per_side[axis] as f64 * pitch_mm[axis]);
            // As many pads on the other side as its length allows.
            let pads = |n: usize| {
                let other = ((sides_mm[1] / sides_mm[0] * n as f64).round() as usize).max(1);
                let pitch_mm = Pair::Two([sides_mm[0] / n as f64, sides_mm[1] / other as f64]);
                Electrodes::RimPads { per_side: Pair::Two([n, other]), pitch_mm, size_mm: *size_mm }
            };
            PER_SIDE.map(pads).collect()
        }
        Electrodes::PadGrid { diameter_mm, .. } => PER_SIDE
            .map(|per_side| Electrodes::PadGrid { per_side: Pair::One(per_side), diameter_mm: *diameter_mm })
            .collect(),
        Electrodes::RimList(_) | Electrodes::RimPlaces { .. } | Electrodes::Pads(_) | Electrodes::PadRings { .. } => {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("frontend.electrodes of {}, for --improve count", skin.name),
                expected: "rim, rim-pads or pad-grid, which place any number of electrodes".into(),
                got: "a list".into(),
            }));
        }
    };
    Ok(others.into_iter().filter(|other| other != same).collect())
}

/// The skin's electrodes as a list.
fn listed(skin: &Skin) -> Result<Electrodes, Error> {
    const MM: f64 = 1e3;
    let shapes = skin.electrode_shapes();
    let perimeter_m = skin.outline().perimeter_m();
    let rim = |shape: &ElectrodeShape| match *shape {
        ElectrodeShape::RimArc { centre_rad, width_m } => {
            Some(RimElectrode { at_deg: centre_rad.to_degrees(), width_mm: MM * width_m })
        }
        ElectrodeShape::RimSegment { centre_m, width_m } => {
            Some(RimElectrode { at_deg: 360.0 * centre_m / perimeter_m, width_mm: MM * width_m })
        }
        _ => None,
    };
    let pad = |shape: &ElectrodeShape| match *shape {
        ElectrodeShape::PadCircle { centre_m, radius_m } => {
            Some(Pad::Circle { centre_mm: centre_m.map(|c| MM * c), diameter_mm: 2.0 * MM * radius_m })
        }
        ElectrodeShape::PadRectangle { centre_m, width_m, height_m, angle_rad: 0.0 } => {
            let centre_mm = centre_m.map(|c| MM * c);
            Some(Pad::Rectangle { centre_mm, width_mm: MM * width_m, height_mm: MM * height_m })
        }
        ElectrodeShape::Point { position_m } => Some(Pad::Point { at_mm: position_m.map(|c| MM * c) }),
        _ => None,
    };
    let on_rim: Option<Vec<RimElectrode>> = shapes.iter().map(rim).collect();
    let under: Option<Vec<Pad>> = shapes.iter().map(pad).collect();
    on_rim.map(Electrodes::RimList).or(under.map(Electrodes::Pads)).ok_or_else(|| {
        Error::Live(dermis_live::Error::Frames {
            what: format!("frontend.electrodes of {}, for --improve electrodes", skin.name),
            expected: "stretches of the rim, or pads along the axes".into(),
            got: "something else".into(),
        })
    })
}

/// Directions to move in: along the rim, or along both axes.
fn directions(skin: &Skin) -> &'static [[f64; 2]] {
    match skin.frontend.electrodes {
        Electrodes::RimList(_) => &[[1.0, 0.0], [-1.0, 0.0]],
        _ => &[[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]],
    }
}

/// Moves a listed electrode by a share of the mean spacing of neighbours.
fn shift(skin: &mut Skin, electrode: usize, share: f64, direction: [f64; 2], count: usize) {
    let area_m2 = skin.outline().area_m2();
    match &mut skin.frontend.electrodes {
        Electrodes::RimList(list) => list[electrode].at_deg += direction[0] * share * 360.0 / count as f64,
        Electrodes::Pads(list) => {
            let step_mm = 1e3 * share * (area_m2 / count as f64).sqrt();
            let place = match &mut list[electrode] {
                Pad::Circle { centre_mm, .. } | Pad::Rectangle { centre_mm, .. } => centre_mm,
                Pad::Point { at_mm } => at_mm,
            };
            place.iter_mut().zip(direction).for_each(|(c, d)| *c += d * step_mm);
        }
        _ => {}
    }
}
