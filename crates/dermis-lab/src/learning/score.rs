//! The score of the Kuopio Tomography Challenge 2023. It is the mean over both classes of the structural similarity
//! (Wang et al., IEEE Trans. Image Processing 13, 2004, eq. 13) between true and found mask, averaged over all
//! pixels. Local means and variances are weighted by a Gaussian of 80 pixels, cut off at 160 and normalised by its
//! sum inside the image.

use dermis_learn::scene::{LOWERED, RAISED};

const SIGMA_PIXELS: f64 = 80.0;
const REACH_PIXELS: isize = 160;
const C1: f64 = 1e-4;
const C2: f64 = 9e-4;

/// The score; 1 for equal labels. `columns` is the number of pixels per row. `None` for images of different or ragged
/// length.
pub fn challenge_score(truth: &[u8], found: &[u8], columns: usize) -> Option<f64> {
    let rows = truth.len().checked_div(columns)?;
    if rows * columns != truth.len() || truth.len() != found.len() || truth.is_empty() {
        return None;
    }
    let of_class = |class: u8| {
        let mask = |labels: &[u8]| labels.iter().map(|label| f64::from(u8::from(*label == class))).collect::<Vec<_>>();
        similarity(&mask(truth), &mask(found), rows, columns)
    };
    Some(0.5 * (of_class(LOWERED) + of_class(RAISED)))
}

fn similarity(truth: &[f64], found: &[f64], rows: usize, columns: usize) -> f64 {
    let product: Vec<f64> = truth.iter().zip(found).map(|(t, f)| t * f).collect();
    // Masks are 0 or 1, so they equal their squares.
    let [mean_t, mean_f, cross] = [truth, found, &product].map(|values| local_mean(values, rows, columns));
    let sum: f64 = (0..truth.len())
        .map(|k| {
            let (t, f) = (mean_t[k], mean_f[k]);
            let covariance = cross[k] - t * f;
            let variances = t - t * t + f - f * f;
            (2.0 * t * f + C1) * (2.0 * covariance + C2) / ((t * t + f * f + C1) * (variances + C2))
        })
        .sum();
    sum / truth.len() as f64
}

fn local_mean(values: &[f64], rows: usize, columns: usize) -> Vec<f64> {
    let along = |source: &[f64], lines: usize, length: usize, stride: usize, step: usize| {
        let mut out = vec![0.0; source.len()];
        for line in 0..lines {
            for at in 0..length as isize {
                let range = (at - REACH_PIXELS).max(0)..(at + REACH_PIXELS + 1).min(length as isize);
                let (mut sum, mut total) = (0.0, 0.0);
                for k in range {
                    let weight = WEIGHTS.with(|weights| weights[(k - at).unsigned_abs()]);
                    sum += weight * source[line * stride + k as usize * step];
                    total += weight;
                }
                out[line * stride + at as usize * step] = sum / total;
            }
        }
        out
    };
    // The window is separable, and so is its sum inside the image.
    let rows_done = along(values, rows, columns, columns, 1);
    along(&rows_done, columns, rows, 1, columns)
}

thread_local! {
    static WEIGHTS: Vec<f64> =
        (0..=REACH_PIXELS).map(|k| (-0.5 * (k as f64 / SIGMA_PIXELS).powi(2)).exp()).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc(class: u8, x: f64, y: f64, radius: f64) -> Vec<u8> {
        let inside = |k: usize| ((k % 256) as f64 - x).hypot((k / 256) as f64 - y) < radius;
        (0..65536).map(|k| if inside(k) { class } else { 0 }).collect()
    }

    #[test]
    fn equal_labels_score_one_and_a_missed_class_at_most_half() {
        let truth = disc(1, 100.0, 120.0, 30.0);
        assert!((challenge_score(&truth, &truth, 256).unwrap() - 1.0).abs() < 1e-12);
        // The other class is rightly absent and scores 1; this one is missed and scores nearly 0.
        let nothing = vec![0; 65536];
        let missed = challenge_score(&truth, &nothing, 256).unwrap();
        assert!((0.5..0.53).contains(&missed), "{missed}");
        let shifted = challenge_score(&truth, &disc(1, 110.0, 120.0, 30.0), 256).unwrap();
        assert!(shifted > 0.75 && shifted < 0.97, "{shifted}");
        assert_eq!(challenge_score(&truth, &nothing[..100], 256), None);
    }

    #[test]
    fn local_means_agree_with_the_double_sum() {
        let (rows, columns) = (5, 7);
        let values: Vec<f64> = (0..35).map(|k| f64::from(k * k % 11)).collect();
        let found = local_mean(&values, rows, columns);
        for place in [0, 9, 34] {
            let (mut sum, mut total) = (0.0, 0.0);
            for (k, value) in values.iter().enumerate() {
                let [dr, dc] = [(k / 7) as f64 - (place / 7) as f64, (k % 7) as f64 - (place % 7) as f64];
                let weight = (-0.5 * (dr * dr + dc * dc) / 6400.0).exp();
                (sum, total) = (sum + weight * value, total + weight);
            }
            assert!((found[place] - sum / total).abs() < 1e-12);
        }
    }
}
