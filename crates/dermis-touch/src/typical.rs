//! Medians and spacings.

/// Median; the mean of the two middle values for an even number, NaN for none.
pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => 0.5 * (sorted[n / 2 - 1] + sorted[n / 2]),
    }
}

/// Median distance from a position to its nearest neighbour, over at most 200 of them: the step of a lattice.
pub(crate) fn spacing(places_m: &[[f64; 2]]) -> f64 {
    let sampled = places_m.len().min(200);
    let nearest = |s: usize| {
        let here = places_m[s * places_m.len() / sampled];
        let d2 = places_m.iter().map(|q| (q[0] - here[0]).powi(2) + (q[1] - here[1]).powi(2)).filter(|d| *d > 0.0);
        d2.fold(f64::INFINITY, f64::min).sqrt()
    };
    median(&(0..sampled).map(nearest).collect::<Vec<_>>())
}
