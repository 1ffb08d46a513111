//! Turns pokes into the calibration that locates touches best. Touches are located by the pokes alone, or by pokes
//! fused with model signatures ([`Calibration`]), or by everything that the running skin does without a calibration,
//! including refinement, corrected by the pokes ([`dermis_touch::locator::PlaceCorrection`]). Left-out pokes decide.

use std::sync::Arc;

use dermis_skin::budget::Budget;
use dermis_tomo::mesh::Point;
use dermis_touch::locator::{FusedOptions, LeftOut, PlaceCorrection, PokeSight, SeenPoke};
use dermis_touch::{Contact, ContactStrength};

use crate::Error;
use crate::as_built::{self, BuildFit, Built};
use crate::calibration::{
    AsBuilt, CalibratedImager, Calibration, CalibrationOptions, PokeFrames, Pokes, differences_of, load_shares,
};
use crate::prepare::Prepared;
use crate::reconstructor::Reconstructor;
use crate::stages::workshop_error::WorkshopError;

/// Maximum number of pokes, evenly drawn, that the model is tested on.
const MOST_LOOKED_AT: usize = 200;
/// Give up early if more than the first number plus the second times n of the first n frames show several touches, or
/// none.
const SEVERAL_BEFORE_GIVING_UP: (f64, f64) = (2.0, 0.1);
const UNSEEN_BEFORE_GIVING_UP: (f64, f64) = (2.0, 0.5);
/// Lower bound on the variance of a position, m^2: a micrometre squared.
const LEAST_VARIANCE_M2: f64 = 1e-12;
/// Minimum number of pokes for learning how a skin was built.
const FEWEST_FOR_BUILD: usize = 8;
/// Number of parts in which these pokes are left out.
const FOLDS: usize = 4;
/// Largest number of pokes, evenly drawn, for learning how a skin was built: they determine a hundred parameters many
/// times.
const MOST_FOR_BUILD: usize = 120;
/// Share of coordinates within one standard deviation.
const ONE_SIGMA: f64 = 0.683;
/// Time between unrelated frames, nanoseconds.
const APART_NS: u64 = 1_000_000_000;

/// Fits a calibration to pokes: see [`Calibration::fit_with`]. Also tries the model, if
/// [`CalibrationOptions::physics`] allows it and the skin's wiring is known.
///
/// # Errors
/// More memory or time than allowed; as [`Calibration::fit_with`].
pub fn calibrate(
    prepared: &Prepared,
    measured: PokeFrames<'_>,
    pokes: &Pokes,
    options: &CalibrationOptions<'_>,
) -> Result<Calibration, Error> {
    let landmarks = FusedOptions::default().landmarks;
    Budget::of_pokes(&prepared.skin, pokes.positions_m.len(), landmarks).check(&prepared.skin, "its calibration")?;
    let mut calibration = Calibration::fit_with(prepared, measured, pokes, options)?;
    let backend = &prepared.skin.backend;
    if options.physics && backend.wiring.is_known() && backend.circuit.is_none() {
        let all: Vec<usize> = (0..pokes.positions_m.len()).collect();
        // If the model cannot read the frames, for example because of a different channel order, the pokes alone
        // locate touches.
        match seen_by_model(prepared, measured, pokes, &all) {
            Ok(seen) => {
                calibration.try_model(&seen, prepared)?;
            }
            Err(error) => tracing::debug!("the model places no pokes: {error}"),
        }
        match learned_as_built(prepared, measured, pokes, options, &calibration) {
            Ok(Some(learned)) => calibration = learned,
            Ok(None) => {}
            Err(error) => tracing::debug!("how the skin was built is not learned: {error}"),
        }
    }
    Ok(calibration)
}

/// A calibration by the model of the skin as built, if left-out pokes are more probable under it than under `other`.
/// Three quarters of the pokes place the others in turn. The variance that they leave is scaled to the errors found.
fn learned_as_built(
    prepared: &Prepared,
    measured: PokeFrames<'_>,
    pokes: &Pokes,
    options: &CalibrationOptions<'_>,
    other: &Calibration,
) -> Result<Option<Calibration>, Error> {
    let count = pokes.positions_m.len();
    let is_single = pokes.further_m.iter().all(Vec::is_empty);
    let (teaches, by_rest) = (as_built::is_wanted(prepared), as_built::learns_from_rest(prepared));
    if !(teaches || by_rest) || count < FEWEST_FOR_BUILD || !is_single {
        return Ok(None);
    }
    let (reference, mut differences) = differences_of(prepared, measured)?;
    if !teaches && !as_built::is_off(prepared, reference.misfit) {
        return Ok(None);
    }
    let chosen: Vec<usize> = (0..count).step_by(count.div_ceil(MOST_FOR_BUILD)).collect();
    let count = chosen.len();
    let places_m: Vec<Point> = chosen.iter().map(|&i| pokes.positions_m[i]).collect();
    differences = chosen.iter().map(|&i| std::mem::take(&mut differences[i])).collect();
    // If pokes aren't spots, only their baseline teaches; they then show how good the resulting skin is.
    let taught = if teaches { count } else { 0 };
    let learned = BuildFit::new(prepared, &reference, &differences[..taught], &places_m[..taught])?;
    let teachers = |rows: &[usize]| if teaches { rows.to_vec() } else { Vec::new() };
    let mut left_out = Vec::new();
    for fold in 0..FOLDS {
        let (out, kept): (Vec<usize>, Vec<usize>) = (0..count).partition(|i| i % FOLDS == fold);
        let Built { build, errors, .. } = learned.fit(&teachers(&kept))?;
        let skin = prepared.as_built(build)?.with_errors(Arc::new(errors.clone()));
        let rows: Vec<usize> = out.iter().map(|&i| chosen[i]).collect();
        let seen = seen_by_model(&skin, measured, pokes, &rows)?;
        let sights = seen.into_iter().zip(&out);
        left_out.extend(sights.map(|(sight, &row)| LeftOutPoke::of(&sight, places_m[row], &errors)));
    }
    let scale = built_scale(&left_out);
    let examples: Vec<LeftOut> = left_out.iter().map(|poke| poke.example(scale)).collect();
    let all: Vec<usize> = (0..count).collect();
    let Built { build, errors, .. } = learned.fit(&teachers(&all))?;
    let skin = prepared.as_built(build.clone())?;
    let seen = seen_by_model(&skin, measured, pokes, &chosen)?;
    let single: Vec<SeenPoke> = seen.iter().filter_map(PokeSight::single).copied().collect();
    let correction = PlaceCorrection::without_shifts(&single, examples, prepared.half_width_m())?;
    let (by_build, by_others) = (correction.leave_one_out(), other.leave_one_out());
    tracing::debug!(
        "as built: {:.3} mm, log density {:.2}; otherwise {:.3} mm, {:.2}; variance x {scale:.2}",
        1e3 * by_build.median_error_m,
        by_build.mean_log_density(),
        1e3 * by_others.median_error_m,
        by_others.mean_log_density(),
    );
    if by_build.mean_log_density() <= by_others.mean_log_density() {
        return Ok(None);
    }
    let mut calibration = Calibration::fit_with(&skin, measured, pokes, options)?;
    calibration.set_as_built(AsBuilt { build, errors: errors.scaled(scale) }, correction);
    Ok(Some(calibration))
}

/// A poke as placed by a model that had not learned from it.
struct LeftOutPoke {
    truth_m: Point,
    located_m: Point,
    /// Variance of each coordinate by noise, and by what the other pokes leave unknown, m^2.
    noise_m2: f64,
    built_m2: f64,
}

impl LeftOutPoke {
    /// `errors` are part of what the model states. A poke that is not seen counts as placed in the middle of the skin.
    fn of(sight: &PokeSight, truth_m: Point, errors: &WorkshopError) -> Self {
        let (located_m, noise_m2) = match sight {
            PokeSight::Single(poke) | PokeSight::Several(poke) => (poke.seen_m, poke.variance_m2),
            PokeSight::Nothing(_) => ([0.0; 2], truth_m[0].powi(2) + truth_m[1].powi(2)),
        };
        let built_m2 = errors.variance_m2(located_m);
        Self { truth_m, located_m, noise_m2: (noise_m2 - built_m2).max(LEAST_VARIANCE_M2), built_m2 }
    }

    fn sigma_m(&self, scale: f64) -> f64 {
        (self.noise_m2 + scale * self.built_m2).sqrt()
    }

    fn example(&self, scale: f64) -> LeftOut {
        let error_m = [0, 1].map(|axis| self.truth_m[axis] - self.located_m[axis]);
        LeftOut {
            position_m: self.truth_m,
            located_m: self.located_m,
            sigma_m: [self.sigma_m(scale); 2],
            error_m: error_m[0].hypot(error_m[1]),
            novelty: 1.0,
        }
    }
}

/// Factor on the variance of the errors that remain with which 68 % of the coordinates are within one sigma.
fn built_scale(pokes: &[LeftOutPoke]) -> f64 {
    let within = |scale: f64| {
        let is_within =
            |poke: &LeftOutPoke, axis: usize| (poke.truth_m[axis] - poke.located_m[axis]).abs() <= poke.sigma_m(scale);
        let count = pokes.iter().flat_map(|poke| [is_within(poke, 0), is_within(poke, 1)]).filter(|is| *is).count();
        count as f64 / (2 * pokes.len()).max(1) as f64
    };
    // Half a decade is finer than twenty pokes can resolve.
    (-10..=20)
        .map(|step| 10.0_f64.powf(0.1 * f64::from(step)))
        .find(|scale| within(*scale) >= ONE_SIGMA)
        .unwrap_or(100.0)
}

/// Pokes as the model sees them.
fn seen_by_model(
    prepared: &Prepared,
    measured: PokeFrames<'_>,
    pokes: &Pokes,
    rows: &[usize],
) -> Result<Vec<PokeSight>, Error> {
    let (reference, differences) = differences_of(prepared, measured)?;
    let CalibratedImager { imager, reference, placement } =
        CalibratedImager::new(prepared, None, reference, &differences)?;
    let mut reconstructor = Reconstructor::offline(prepared, &reference.noise, imager, placement, None)?;
    if prepared.is_as_built() {
        reconstructor.take_reference(prepared, &reference);
    }
    let step = rows.len().div_ceil(MOST_LOOKED_AT).max(1);
    let load_share = load_shares(pokes.loads.as_ref().map(|(_, loads)| &loads[..]));
    let is_single = |i: &usize| pokes.further_m.get(*i).is_none_or(Vec::is_empty);
    let looked_at = rows.iter().copied().step_by(step).filter(is_single);
    let poked = looked_at.map(|i| MeasuredPoke {
        difference: &differences[i],
        truth_m: pokes.positions_m[i],
        load_share: load_share(i),
    });
    seen_pokes(&mut reconstructor, prepared, poked)
}

/// A measured poke with its true position and load.
#[derive(Clone, Copy, Debug)]
pub struct MeasuredPoke<'a> {
    /// Difference data, model volts.
    pub difference: &'a [f64],
    /// True position, metres.
    pub truth_m: Point,
    /// Load relative to a typical poke.
    pub load_share: f64,
}

/// Pokes as the model sees them. Frames that are not touches take long to search. Once it is clear that many are not,
/// the rest are skipped ([`PokeSight::Nothing`]).
///
/// # Errors
/// Frames whose length is not the skin's number of channels.
pub fn seen_pokes<'a>(
    reconstructor: &mut Reconstructor,
    prepared: &Prepared,
    pokes: impl Iterator<Item = MeasuredPoke<'a>>,
) -> Result<Vec<PokeSight>, Error> {
    let too_many = |count: usize, of: usize, (first, share): (f64, f64)| count as f64 > first + share * of as f64;
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let mut seen = Vec::new();
    let (mut several, mut unseen) = (0, 0);
    for (number, MeasuredPoke { difference, truth_m, load_share }) in pokes.enumerate() {
        if too_many(several, number, SEVERAL_BEFORE_GIVING_UP) || too_many(unseen, number, UNSEEN_BEFORE_GIVING_UP) {
            seen.push(PokeSight::Nothing(truth_m));
            continue;
        }
        let time_ns = (number as u64 + 1) * APART_NS;
        reconstructor.forget(time_ns);
        reconstructor.image(difference, &mut image)?;
        reconstructor.follow_touches(time_ns, &image, None)?;
        let mut strong =
            reconstructor.touches.contacts().iter().filter(|contact| contact.strength == ContactStrength::Strong);
        let strongest = strong.next().map(|contact| SeenPoke {
            seen_m: contact.centroid_m,
            variance_m2: variance_m2(contact),
            amplitude: contact.amplitude,
            truth_m,
            load_share,
        });
        let is_alone = strong.next().is_none();
        seen.push(match strongest {
            Some(poke) if is_alone => PokeSight::Single(poke),
            Some(poke) => PokeSight::Several(poke),
            None => PokeSight::Nothing(truth_m),
        });
        several += usize::from(!is_alone);
        unseen += usize::from(strongest.is_none());
    }
    Ok(seen)
}

/// Variance of a contact's coordinates, averaged over both: noise plus model error, m^2.
fn variance_m2(contact: &Contact) -> f64 {
    let [[x, _], [_, y]] = contact.covariance_m2;
    (0.5 * (x + y) + contact.model_variance_m2).max(LEAST_VARIANCE_M2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    /// Positions on a grid six columns wide, starting at `first_m`.
    fn grid(count: u32, pitch_m: f64, first_m: Point) -> Vec<Point> {
        (0..count).map(|i| [pitch_m * f64::from(i % 6) + first_m[0], pitch_m * f64::from(i / 6) + first_m[1]]).collect()
    }

    /// Frames that the model itself predicts for presses at these positions, each with its strength.
    fn pressed(prepared: &Prepared, positions_m: &[Point], share: impl Fn(usize) -> f64) -> Vec<Vec<f64>> {
        let rest = &prepared.voltages;
        let press = |(poke, signature): (usize, &[f64])| {
            rest.iter().zip(signature).map(|(v, s)| v + share(poke) * s).collect::<Vec<f64>>()
        };
        prepared.signatures(positions_m).chunks_exact(rest.len()).enumerate().map(press).collect()
    }

    #[test]
    fn frames_that_are_no_touches_are_soon_left_to_the_pokes() {
        let prepared = Prepared::new(Skin::open("ionic-disc").unwrap()).unwrap();
        let rest = prepared.voltages.clone();
        // A different random factor for every channel and poke, which no model can explain.
        let wild = |poke: usize| {
            let factor = |k: usize| 1.0 + 0.01 * (((poke * 7919 + k * 104_729) % 997) as f64 / 498.5 - 1.0);
            rest.iter().enumerate().map(|(k, v)| v * factor(k)).collect::<Vec<f64>>()
        };
        let frames: Vec<Vec<f64>> = (0..30).map(wild).collect();
        let pokes = Pokes { positions_m: grid(30, 0.01, [-0.03, -0.02]), further_m: Vec::new(), loads: None };
        let measured = PokeFrames::Readings { baselines: std::slice::from_ref(&rest), frames: &frames };
        let calibration = calibrate(&prepared, measured, &pokes, &CalibrationOptions::default()).unwrap();
        assert!(calibration.correction().is_none());
        // The model locates touches that it produced itself.
        let frames = pressed(&prepared, &pokes.positions_m, |_| 0.1);
        let measured = PokeFrames::Readings { baselines: std::slice::from_ref(&rest), frames: &frames };
        let calibration = calibrate(&prepared, measured, &pokes, &CalibrationOptions::default()).unwrap();
        assert!(calibration.leave_one_out().median_error_m < 2e-3, "{:?}", calibration.leave_one_out().median_error_m);
    }

    #[test]
    fn channels_that_read_nothing_and_gaps_are_kept_through_a_file() {
        let prepared = Prepared::new(Skin::open("ionic-disc").unwrap()).unwrap();
        let rest = prepared.voltages.clone();
        let positions_m = grid(30, 0.01, [-0.03, -0.02]);
        let mut frames = pressed(&prepared, &positions_m, |_| 0.1);
        // One channel reads nothing at all, another misses a few pokes.
        frames.iter_mut().for_each(|frame| frame[7] = f64::NAN);
        frames[3..6].iter_mut().for_each(|frame| frame[40] = f64::NAN);
        let measured = PokeFrames::Readings { baselines: std::slice::from_ref(&rest), frames: &frames };
        let pokes = Pokes { positions_m, further_m: Vec::new(), loads: None };
        let calibration = calibrate(&prepared, measured, &pokes, &CalibrationOptions::default()).unwrap();
        assert!(calibration.review().dead_channels.contains(&7));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("c.json");
        calibration.save(&path).unwrap();
        let opened = Calibration::load(&path).unwrap();
        assert_eq!(opened.pokes(), 30);
        opened.measured_jacobian(&prepared).unwrap();
    }

    #[test]
    fn pokes_far_below_the_weakest_touch_are_not_detected() {
        let prepared = Prepared::new(Skin::open("em-8").unwrap()).unwrap();
        let rest = prepared.voltages.clone();
        let positions_m = grid(36, 0.02, [-0.05, -0.05]);
        let frames = pressed(&prepared, &positions_m, |poke| if poke % 9 == 4 { 0.1 } else { 30.0 });
        let measured = PokeFrames::Readings { baselines: std::slice::from_ref(&rest), frames: &frames };
        let pokes = Pokes { positions_m, further_m: Vec::new(), loads: None };
        let rows: Vec<usize> = (0..36).collect();
        let seen = seen_by_model(&prepared, measured, &pokes, &rows).unwrap();
        for (poke, sight) in seen.iter().enumerate() {
            assert_eq!(matches!(sight, PokeSight::Nothing(_)), poke % 9 == 4, "{poke}: {sight:?}");
        }
    }
}
