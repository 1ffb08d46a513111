//! Two touches in one frame: the two templates that explain it best together.

use faer::Mat;

use super::batch::Batch;
use super::templates::square_distance;
use super::{InverseError, MatchedPair, PairSearch, SelfCalibration};

/// Number of times that one place is searched again while the other stays fixed.
const ROUNDS: usize = 4;
/// Minimum distance between places tried in pairs, as a share of the minimum distance between two touches.
const COARSE: f64 = 0.3;
/// Minimum independence (squared sine between them) for two templates to count as different.
const LEAST_INDEPENDENT: f64 = 0.02;

/// Two places, both amplitudes, and the energy explained by them.
#[derive(Clone, Copy)]
pub(super) struct Explained {
    pub(super) places: [usize; 2],
    pub(super) amplitudes: [f64; 2],
    energy: f64,
}

/// Products of a frame with the weighted templates of all places, without the channels missing from the frame.
pub(super) struct Projected {
    /// Product of the frame with every template, and the squared norms of the templates.
    products: Vec<f64>,
    squares: Vec<f64>,
    /// Squared norm of the frame.
    energy: f64,
}

impl Projected {
    /// Share of the frame's energy that two places leave unexplained.
    pub(super) fn left_by(&self, explained: &Explained) -> f64 {
        (1.0 - explained.energy / self.energy).max(0.0)
    }

    /// Joint explanation by two templates, both pressing; `gram` is their product.
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
    /// Prepares the search by [`SelfCalibration::locate_pair`] for two touches at least `apart_m` from each other.
    pub fn pair_search(&self, apart_m: f64) -> PairSearch {
        let coarse = self.coarse_places(COARSE * apart_m);
        let grams = self.grams(&coarse, None);
        PairSearch { apart_m, coarse, grams }
    }

    /// The two touches that together explain most of a frame of relative changes; `None` if no two do or no channel
    /// changed. `search` must belong to this calibration.
    ///
    /// # Errors
    /// As [`SelfCalibration::scores`].
    pub fn locate_pair(&self, frame: &[f64], search: &PairSearch) -> Result<Option<MatchedPair>, InverseError> {
        let batch = self.single(frame)?;
        let Some((projected, best)) = self.best_pair(&batch, search) else { return Ok(None) };
        let without = (!batch.complete).then_some(&batch);
        let mut positions_m = [0, 1].map(|index| self.centroid_beside(&projected, &best, index, without));
        let mut amplitudes = best.amplitudes;
        if amplitudes[1] > amplitudes[0] {
            positions_m.swap(0, 1);
            amplitudes.swap(0, 1);
        }
        Ok(Some(MatchedPair { positions_m, amplitudes, left: projected.left_by(&best) }))
    }

    /// The two places that explain most of the only frame in a batch.
    pub(super) fn best_pair(&self, batch: &Batch, search: &PairSearch) -> Option<(Projected, Explained)> {
        let (products, norms) = self.products(batch);
        let projected = Projected {
            products: products.col(0).iter().copied().collect(),
            squares: norms.template.col(0).iter().copied().collect(),
            energy: norms.frame[0] * norms.frame[0],
        };
        if projected.energy == 0.0 {
            return None;
        }
        let PairSearch { apart_m, coarse, .. } = search;
        let are_apart = |a: usize, b: usize| square_distance(self.places_m[a], self.places_m[b]) >= apart_m * apart_m;
        let without = (!batch.complete).then_some(batch);
        let incomplete = without.map(|_| self.grams(coarse, without));
        let grams = incomplete.as_ref().unwrap_or(&search.grams);
        let pairs = (0..coarse.len()).flat_map(|k| (0..k).map(move |l| (k, l)));
        let pairs = pairs.filter(|&(k, l)| are_apart(coarse[k], coarse[l]));
        let explained = pairs.filter_map(|(k, l)| projected.explained([coarse[k], coarse[l]], grams[(k, l)]));
        let mut best = explained.max_by(by_energy)?;
        for round in 0..ROUNDS {
            let kept = best.places[round % 2];
            let grams = self.grams_with(kept, without);
            let places = (0..self.places_m.len()).filter(|&place| are_apart(place, kept));
            let pair = |place: usize| if round % 2 == 0 { [kept, place] } else { [place, kept] };
            let found = places.filter_map(|place| projected.explained(pair(place), grams[(place, 0)]));
            best = found.chain([best]).max_by(by_energy).unwrap_or(best);
        }
        Some((projected, best))
    }

    /// Weighted templates of some places, channels x places, without the channels missing from a frame, if one is
    /// given.
    fn templates_of(&self, places: &[usize], without: Option<&Batch>) -> Mat<f64> {
        let present = |c: usize| without.map_or(1.0, |batch| batch.present[(c, 0)]);
        Mat::from_fn(self.filter.ncols(), places.len(), |c, k| present(c) * self.filter[(places[k], c)])
    }

    /// Products of the templates of these places with each other.
    fn grams(&self, places: &[usize], without: Option<&Batch>) -> Mat<f64> {
        self.templates_of(places, None).transpose() * self.templates_of(places, without)
    }

    /// Products of the templates of all places with one template, as one column.
    fn grams_with(&self, place: usize, without: Option<&Batch>) -> Mat<f64> {
        &self.filter * self.templates_of(&[place], without)
    }

    /// Places all over the skin with at least this distance between them.
    fn coarse_places(&self, apart_m: f64) -> Vec<usize> {
        let mut chosen: Vec<usize> = Vec::new();
        for (place, at) in self.places_m.iter().enumerate() {
            if chosen.iter().all(|&other| square_distance(*at, self.places_m[other]) >= apart_m * apart_m) {
                chosen.push(place);
            }
        }
        chosen
    }

    /// Refines one of two places: the centroid of the energy explained by alternatives, with the other place fixed.
    fn centroid_beside(
        &self,
        projected: &Projected,
        best: &Explained,
        index: usize,
        without: Option<&Batch>,
    ) -> [f64; 2] {
        let (moving, kept) = (best.places[index], best.places[1 - index]);
        let grams = self.grams_with(kept, without);
        let score = |place: usize| {
            let found = projected.explained([place, kept], grams[(place, 0)]);
            found.map_or(0.0, |found| (found.energy / projected.energy).max(0.0).sqrt())
        };
        let scores: Vec<f64> = (0..self.places_m.len()).map(score).collect();
        self.centroid(&scores, moving)
    }
}

fn by_energy(a: &Explained, b: &Explained) -> std::cmp::Ordering {
    a.energy.total_cmp(&b.energy)
}
