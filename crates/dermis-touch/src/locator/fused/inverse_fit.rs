//! Fits the inverse expert, and locates left-out rows with it.

use super::features::{Features, fill_from_neighbours, in_frame};
use super::inverse::{Guess, LeftOutPlaces, Memory, Regression};
use crate::locator::data::Examples;
use crate::locator::error::LocatorError;

/// Number of principal components of the inverse expert's features.
pub(super) const PLAIN_RANK: usize = 64;
/// Number for whitened frames, whose leading components separate positions best.
const WHITENED_RANK: usize = 40;

/// Unit frames of all examples, with missing channels filled.
pub(super) struct Units {
    units: Vec<Vec<f64>>,
    pub amplitude: Vec<f64>,
}

impl Units {
    pub(super) fn new(examples: &Examples, features: &Features) -> Result<Self, LocatorError> {
        let c = examples.channels;
        let mut units = vec![vec![0.0; c]; examples.len()];
        let mut amplitude = vec![0.0; examples.len()];
        let mut present = Vec::with_capacity(examples.len());
        for (i, frame) in examples.frames.chunks_exact(c).enumerate() {
            amplitude[i] = features.unit(frame, &mut units[i]).map_err(|error| in_frame(error, i))?.0;
            present.push((0..c).map(|k| frame[k].is_finite() || features.weights[k] == 0.0).collect::<Vec<bool>>());
        }
        if present.iter().flatten().any(|p| !p) {
            fill_from_neighbours(&mut units, &present, &examples.positions_m);
        }
        Ok(Self { units, amplitude })
    }
}

/// The inverse expert with its results for left-out rows.
pub(super) struct Inverse {
    pub plain: Regression,
    pub plain_rows: Vec<Vec<f64>>,
    pub whitened: Option<Regression>,
    pub share: f64,
    pub places: LeftOutPlaces,
    pub guesses: Vec<Guess>,
}

/// The inverse expert on unit frames alone.
pub(super) struct Plain {
    rows: Vec<Vec<f64>>,
    regression: Regression,
    places: LeftOutPlaces,
}

impl Plain {
    pub(super) fn fit(
        units: &Units,
        places_m: &[[f64; 2]],
        judged: &[usize],
        is_earlier: Option<&[bool]>,
    ) -> Result<Self, LocatorError> {
        let mut rows = vec![vec![0.0; 2 * units.units[0].len()]; units.units.len()];
        units.units.iter().zip(&mut rows).for_each(|(unit, row)| Features::inverse(unit, row));
        let (regression, places) = Regression::fit(&rows, places_m, PLAIN_RANK, judged, is_earlier)?;
        Ok(Self { rows, regression, places })
    }
}

impl Inverse {
    /// `whitened` holds the rows of the forward expert's whitened frames, if they should be used, and `misfits` the
    /// ratios of the left-out rows' misfits to the usual one.
    pub(super) fn fit(
        plain: Plain,
        whitened: Option<Vec<Vec<f64>>>,
        places_m: &[[f64; 2]],
        rows: &[usize],
        misfits: &[f64],
        is_earlier: Option<&[bool]>,
    ) -> Result<Self, LocatorError> {
        let truth: Vec<[f64; 2]> = rows.iter().map(|&i| places_m[i]).collect();
        let Plain { rows: plain_rows, regression: mut plain, places: of_plain } = plain;
        let (mut share, mut places, mut other) = (1.0, of_plain.clone(), None);
        if let Some(frames) = whitened {
            let (mut regression, found) = Regression::fit(&frames, places_m, WHITENED_RANK, rows, is_earlier)?;
            (share, places) = best_mix(&of_plain, &found, &truth);
            regression.set_residuals(&places.places_m, &truth);
            plain.set_residuals(&places.places_m, &truth);
            other = (share < 1.0).then_some((regression, frames, found));
        }
        let mut memory = Memory::default();
        let single = |row: &Vec<f64>| row.iter().map(|v| *v as f32).collect::<Vec<f32>>();
        let mut guesses = Vec::with_capacity(rows.len());
        for (place, (&i, misfit)) in rows.iter().zip(misfits).enumerate() {
            let guess = plain.guess(&single(&plain_rows[i]), &mut memory, Some(place));
            let mut guess = Guess { mean_m: of_plain.places_m[place], ..guess };
            if let Some((regression, frames, found)) = &other {
                let second = regression.guess(&single(&frames[i]), &mut memory, Some(place));
                guess = guess.mixed(plain_share(share, *misfit), Guess { mean_m: found.places_m[place], ..second });
            }
            guesses.push(guess);
        }
        Ok(Self { plain, plain_rows, whitened: other.map(|o| o.0), share, places, guesses })
    }
}

/// The share of the regression on unit frames in a frame with this misfit ratio, given that in frames like the pokes.
/// Whitening raises directions in which pokes hardly vary, and in which a changed skin differs most. On a skin measured
/// before and after damage, in both directions, the median error after 1,000 pokes is 5.7 and 3.7 mm instead of 6.3 and
/// 3.9 mm with a fixed share. On seven skins that have not changed, the two differ by less than 2 %.
pub(super) fn plain_share(usual: f64, misfit_ratio: f64) -> f64 {
    1.0 - (1.0 - usual) / misfit_ratio
}

/// The share of the first in the mean of both that gives the smallest error.
fn best_mix(first: &LeftOutPlaces, second: &LeftOutPlaces, truth: &[[f64; 2]]) -> (f64, LeftOutPlaces) {
    let mix = |share: f64| -> Vec<[f64; 2]> {
        let pairs = first.places_m.iter().zip(&second.places_m);
        pairs.map(|(a, b)| [0, 1].map(|axis| share * a[axis] + (1.0 - share) * b[axis])).collect()
    };
    let score = |places: &[[f64; 2]]| {
        let squares: Vec<f64> =
            places.iter().zip(truth).map(|(a, b)| (a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).collect();
        let middle = crate::statistics::median(&squares).max(f64::MIN_POSITIVE);
        squares.iter().map(|s| (s + middle).ln()).sum::<f64>()
    };
    let mut best = (f64::INFINITY, 1.0, Vec::new());
    for share in [1.0, 0.75, 0.5, 0.25, 0.0] {
        let places = mix(share);
        let reached = score(&places);
        if reached < best.0 {
            best = (reached, share, places);
        }
    }
    (best.1, LeftOutPlaces { places_m: best.2 })
}
