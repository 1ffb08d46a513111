//! Two touches in one frame: the two templates that explain it together.

use std::borrow::Cow;

use faer::Mat;

use super::batch::Batch;
use super::templates::square_distance;
use super::{InverseError, MatchedPair, PairSearch, SelfCalibration};

/// Times that one place is looked for anew while the other stays.
const ROUNDS: usize = 4;
/// Places that are tried in pairs are at least this share of the least distance of two touches apart.
const COARSE: f64 = 0.3;
/// Templates that are less independent than this (the sine squared between them) are one.
const LEAST_INDEPENDENT: f64 = 0.02;

/// Two places, both amplitudes, and the energy that they explain.
#[derive(Clone, Copy)]
struct Explained {
    places: [usize; 2],
    amplitudes: [f64; 2],
    energy: f64,
}

/// A frame and the templates, weighted, without the channels that the frame lacks.
struct Projected<'a> {
    filter: Cow<'a, Mat<f64>>,
    /// Products of the frame with every template, and the squared norms of these.
    products: Vec<f64>,
    squares: Vec<f64>,
    /// Squared norm of the frame.
    energy: f64,
}

impl Projected<'_> {
    fn gram(&self, a: usize, b: usize) -> f64 {
        self.filter.row(a) * self.filter.row(b).transpose()
    }

    /// What two templates explain together, both pressing; `gram` is their product.
    fn explained(&self, [a, b]: [usize; 2], gram: f64) -> Option<Explained> {
        let (p, q, m, n) = (self.products[a], self.products[b], self.squares[a], self.squares[b]);
        let determinant = m * n - gram * gram;
        if determinant <= LEAST_INDEPENDENT * m * n || m * n <= 0.0 {
            return None;
        }
        let amplitudes = [(p * n - q * gram) / determinant, (q * m - p * gram) / determinant];
        let energy = p * amplitudes[0] + q * amplitudes[1];
        (amplitudes[0] > 0.0 && amplitudes[1] > 0.0).then_some(Explained { places: [a, b], amplitudes, energy })
    }
}

impl SelfCalibration {
    /// What [`SelfCalibration::locate_pair`] looks for two touches at least `apart_m` from each other with.
    pub fn pair_search(&self, apart_m: f64) -> PairSearch {
        let coarse = self.coarse_places(COARSE * apart_m);
        let grams = grams(&self.filter, &coarse);
        PairSearch { apart_m, coarse, grams }
    }

    /// The two touches that explain most of a frame of relative changes together; `None` where no two do, or no channel
    /// changed. `search` must be of this calibration.
    ///
    /// # Errors
    /// As [`SelfCalibration::scores`].
    pub fn locate_pair(&self, frame: &[f64], search: &PairSearch) -> Result<Option<MatchedPair>, InverseError> {
        let batch = self.single(frame)?;
        let projected = self.projected(&batch);
        if projected.energy == 0.0 {
            return Ok(None);
        }
        let PairSearch { apart_m, coarse, .. } = search;
        let are_apart = |a: usize, b: usize| square_distance(self.places_m[a], self.places_m[b]) >= apart_m * apart_m;
        let grams = match batch.complete {
            true => Cow::Borrowed(&search.grams),
            false => Cow::Owned(grams(&projected.filter, coarse)),
        };
        let mut best: Option<Explained> = None;
        let better = |best: &mut Option<Explained>, found: Option<Explained>| {
            if let Some(found) = found.filter(|found| best.is_none_or(|best| found.energy > best.energy)) {
                *best = Some(found);
            }
        };
        for (k, &a) in coarse.iter().enumerate() {
            for (l, &b) in coarse[..k].iter().enumerate().filter(|(_, b)| are_apart(a, **b)) {
                better(&mut best, projected.explained([a, b], grams[(k, l)]));
            }
        }
        let Some(mut best) = best else { return Ok(None) };
        for round in 0..ROUNDS {
            let kept = best.places[round % 2];
            for place in (0..self.places_m.len()).filter(|&place| are_apart(place, kept)) {
                let pair = if round % 2 == 0 { [kept, place] } else { [place, kept] };
                let mut found = Some(best);
                better(&mut found, projected.explained(pair, projected.gram(place, kept)));
                best = found.unwrap_or(best);
            }
        }
        let mut positions_m = [0, 1].map(|index| self.centroid_beside(&projected, &best, index));
        let mut amplitudes = best.amplitudes;
        if amplitudes[1] > amplitudes[0] {
            positions_m.swap(0, 1);
            amplitudes.swap(0, 1);
        }
        let left = (1.0 - best.energy / projected.energy).max(0.0);
        Ok(Some(MatchedPair { positions_m, amplitudes, left }))
    }

    fn projected(&self, batch: &Batch) -> Projected<'_> {
        let weighted: Vec<f64> = (0..self.weights.len()).map(|c| self.weights[c] * batch.values[(c, 0)]).collect();
        let present = |place: usize, c: usize| if batch.present[(c, 0)] > 0.0 { self.filter[(place, c)] } else { 0.0 };
        let filter = match batch.complete {
            true => Cow::Borrowed(&self.filter),
            false => Cow::Owned(Mat::from_fn(self.filter.nrows(), self.filter.ncols(), present)),
        };
        let products = filter.row_iter().map(|row| row.iter().zip(&weighted).map(|(f, d)| f * d).sum()).collect();
        let squares = filter.row_iter().map(|row| row.iter().map(|f| f * f).sum()).collect();
        Projected { filter, products, squares, energy: weighted.iter().map(|d| d * d).sum() }
    }

    /// Places at least so far apart, all over the skin.
    fn coarse_places(&self, apart_m: f64) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::new();
        for (place, at) in self.places_m.iter().enumerate() {
            if chosen.iter().all(|&other| square_distance(*at, self.places_m[other]) >= apart_m * apart_m) {
                chosen.push(place);
            }
        }
        chosen
    }

    /// The centroid of one of two places by what others beside it would explain, the other place staying.
    fn centroid_beside(&self, projected: &Projected, best: &Explained, index: usize) -> [f64; 2] {
        let (moving, kept) = (best.places[index], best.places[1 - index]);
        let reach = self.options.centroid_radius_m.powi(2);
        let scores: Vec<f64> = (0..self.places_m.len())
            .map(|place| {
                if square_distance(self.places_m[place], self.places_m[moving]) >= reach {
                    return 0.0;
                }
                let found = projected.explained([place, kept], projected.gram(place, kept));
                found.map_or(0.0, |found| (found.energy / projected.energy).max(0.0).sqrt())
            })
            .collect();
        self.centroid(&scores, moving)
    }
}

/// Products of the templates of these places with each other.
fn grams(filter: &Mat<f64>, places: &[usize]) -> Mat<f64> {
    let rows = Mat::from_fn(places.len(), filter.ncols(), |k, c| filter[(places[k], c)]);
    &rows * rows.transpose()
}
