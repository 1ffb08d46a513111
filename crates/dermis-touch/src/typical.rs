//! Medians, spacings and even choices.

/// Median; the mean of the two middle values for an even number, NaN for none.
///
/// ```
/// assert_eq!(dermis_touch::median(&[3.0, 1.0, 2.0, 10.0]), 2.5);
/// assert!(dermis_touch::median(&[]).is_nan());
/// ```
pub fn median(values: &[f64]) -> f64 {
    median_in_place(&mut values.to_vec())
}

/// At most `most` of `count` indices, evenly spread.
///
/// ```
/// assert_eq!(dermis_touch::evenly(10, 3), [0, 3, 6]);
/// assert_eq!(dermis_touch::evenly(2, 3), [0, 1]);
/// ```
pub fn evenly(count: usize, most: usize) -> Vec<usize> {
    let kept = count.min(most);
    (0..kept).map(|i| i * count / kept).collect()
}

/// As [`median`], without a copy: sorts `values`.
pub(crate) fn median_in_place(values: &mut [f64]) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => values[n / 2],
        n => 0.5 * (values[n / 2 - 1] + values[n / 2]),
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
