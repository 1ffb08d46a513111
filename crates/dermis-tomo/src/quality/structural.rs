//! Structural similarity (SSIM) of two images: Wang, Bovik, Sheikh and Simoncelli, IEEE Trans. Image Processing 13
//! (2004) 600, equation 13; equation 8 of the paper on the self-healing skin. With the default options it equals
//! scikit-image's `structural_similarity` for the same `data_range`.

use super::error::{QualityError, check_length, check_positive};

/// The window for local means and variances.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SsimWindow {
    /// A square with this odd side, in pixels, with equal weights.
    Uniform(usize),
    /// A Gaussian with this standard deviation in pixels, truncated at 3.5 standard deviations: 11 x 11 for 1.5.
    Gaussian(f64),
}

/// Options of SSIM.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SsimOptions {
    /// The window; scikit-image's default is `Uniform(7)`, its `gaussian_weights=True` is `Gaussian(1.5)`.
    pub window: SsimWindow,
    /// Range of the values, in their unit: largest possible minus smallest possible.
    pub data_range: f64,
    /// Stabilises the means: `C1 = (k1 data_range)^2`.
    pub k1: f64,
    /// Stabilises the variances: `C2 = (k2 data_range)^2`.
    pub k2: f64,
    /// True for sample variances, `n / (n - 1)` with n pixels per window, as in scikit-image; Wang et al. do without
    /// the factor.
    pub sample_covariance: bool,
}

impl SsimOptions {
    /// scikit-image's defaults for this range: 7 x 7 uniform, K1 = 0.01, K2 = 0.03, sample covariance.
    #[must_use]
    pub fn new(data_range: f64) -> Self {
        Self { window: SsimWindow::Uniform(7), data_range, k1: 0.01, k2: 0.03, sample_covariance: true }
    }

    /// As [`SsimOptions::new`], with a Gaussian window of 1.5 pixels.
    #[must_use]
    pub fn gaussian(data_range: f64) -> Self {
        Self { window: SsimWindow::Gaussian(1.5), ..Self::new(data_range) }
    }

    /// One-dimensional weights of the window, which sum to 1.
    fn weights(&self) -> Result<Vec<f64>, QualityError> {
        match self.window {
            SsimWindow::Uniform(side) if side % 2 == 1 && side > 1 => Ok(vec![1.0 / side as f64; side]),
            SsimWindow::Uniform(side) => {
                Err(QualityError::Value { field: "window side", value: side as f64, expected: "odd, 3 or more" })
            }
            SsimWindow::Gaussian(sigma) => {
                check_positive("window sigma", sigma)?;
                if !(0.3..=1000.0).contains(&sigma) {
                    let expected = "0.3 to 1000 pixels";
                    return Err(QualityError::Value { field: "window sigma", value: sigma, expected });
                }
                let radius = (3.5 * sigma + 0.5) as i32;
                let raw: Vec<f64> = (-radius..=radius).map(|x| (-0.5 * (f64::from(x) / sigma).powi(2)).exp()).collect();
                let sum: f64 = raw.iter().sum();
                Ok(raw.into_iter().map(|weight| weight / sum).collect())
            }
        }
    }
}

/// Mean structural similarity of two row-major images with `columns` pixels per row; 1 for equal images.
///
/// The mean is over the windows that lie entirely in the image and contain only finite pixels (scikit-image crops in
/// the same way, but has no pixels outside the skin).
///
/// # Errors
/// Images of different or ragged length, an image smaller than the window, parameters out of range, or no window
/// without a pixel outside the skin.
pub fn ssim(truth: &[f64], image: &[f64], columns: usize, options: &SsimOptions) -> Result<f64, QualityError> {
    check_length("image", truth.len(), image.len())?;
    check_positive("data_range", options.data_range)?;
    check_positive("k1", options.k1)?;
    check_positive("k2", options.k2)?;
    let weights = options.weights()?;
    let side = weights.len();
    let rows = truth.len().checked_div(columns).unwrap_or(0);
    check_length("truth", rows * columns, truth.len())?;
    let shortest = rows.min(columns);
    if shortest < side {
        let expected = "at least the side of the window";
        return Err(QualityError::Value { field: "image side", value: shortest as f64, expected });
    }
    let filter = |value: &dyn Fn(f64, f64) -> f64| {
        let values: Vec<f64> = truth.iter().zip(image).map(|(&t, &i)| value(t, i)).collect();
        filter(&values, columns, &weights)
    };
    let mean_t = filter(&|t, i| if i.is_finite() { t } else { f64::NAN });
    let mean_i = filter(&|_, i| i);
    let square_t = filter(&|t, _| t * t);
    let square_i = filter(&|_, i| i * i);
    let cross = filter(&|t, i| t * i);
    let pixels = (side * side) as f64;
    let norm = if options.sample_covariance { pixels / (pixels - 1.0) } else { 1.0 };
    let c1 = (options.k1 * options.data_range).powi(2);
    let c2 = (options.k2 * options.data_range).powi(2);
    let (mut sum, mut count) = (0.0, 0usize);
    for window in 0..mean_t.len() {
        let (t, i) = (mean_t[window], mean_i[window]);
        let variance_t = norm * (square_t[window] - t * t);
        let variance_i = norm * (square_i[window] - i * i);
        let covariance = norm * (cross[window] - t * i);
        let similarity =
            (2.0 * t * i + c1) * (2.0 * covariance + c2) / ((t * t + i * i + c1) * (variance_t + variance_i + c2));
        if similarity.is_finite() {
            (sum, count) = (sum + similarity, count + 1);
        }
    }
    if count == 0 {
        return Err(QualityError::Undefined { what: "SSIM", reason: "no window lies wholly on the skin" });
    }
    Ok(sum / count as f64)
}

/// Weighted means over the windows that lie entirely inside, row by row; NaN if a window contains one.
fn filter(values: &[f64], columns: usize, weights: &[f64]) -> Vec<f64> {
    let side = weights.len();
    let (rows, kept) = (values.len() / columns, columns + 1 - side);
    let mut along = vec![0.0; rows * kept];
    for (out, line) in along.chunks_exact_mut(kept).zip(values.chunks_exact(columns)) {
        for (value, window) in out.iter_mut().zip(line.windows(side)) {
            *value = window.iter().zip(weights).map(|(v, w)| v * w).sum();
        }
    }
    let mut result = vec![0.0; (rows + 1 - side) * kept];
    for (row, out) in result.chunks_exact_mut(kept).enumerate() {
        for (offset, weight) in weights.iter().enumerate() {
            let line = &along[(row + offset) * kept..][..kept];
            out.iter_mut().zip(line).for_each(|(sum, value)| *sum += weight * value);
        }
    }
    result
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Row i, column j: `a = sin(0.3 i) cos(0.2 j) + 0.01 i`, `b = 0.8 sin(0.3 i + 0.1) cos(0.2 j) - 0.02 j + 0.1`.
    pub fn formula_images(rows: usize, columns: usize) -> (Vec<f64>, Vec<f64>) {
        (0..rows * columns)
            .map(|index| ((index / columns) as f64, (index % columns) as f64))
            .map(|(i, j)| {
                let a = (0.3 * i).sin() * (0.2 * j).cos() + 0.01 * i;
                (a, 0.8 * (0.3 * i + 0.1).sin() * (0.2 * j).cos() - 0.02 * j + 0.1)
            })
            .unzip()
    }

    /// scikit-image 0.26 on [`formula_images`]: rows, columns, `data_range`, default, `gaussian_weights=True`, and
    /// `gaussian_weights=True` with `use_sample_covariance=False`.
    const REFERENCE: [(usize, usize, f64, f64, f64, f64); 2] = [
        (24, 31, 2.5, 0.2141204392753887, 0.2691808087418625, 0.269187300842515),
        (40, 40, 3.0, 0.03909701353610576, 0.05155407135021488, 0.05155463931707714),
    ];

    #[test]
    fn equal_to_scikit_image() {
        for (rows, columns, range, uniform, gaussian, population) in REFERENCE {
            let (a, b) = formula_images(rows, columns);
            // Differences come only from rounding and the order of additions; 1e-6 is required.
            let close = |options: &SsimOptions, expected: f64| {
                let got = ssim(&a, &b, columns, options).unwrap();
                assert!((got - expected).abs() < 1e-11, "{options:?}: {got} {expected}");
            };
            close(&SsimOptions::new(range), uniform);
            close(&SsimOptions::gaussian(range), gaussian);
            close(&SsimOptions { sample_covariance: false, ..SsimOptions::gaussian(range) }, population);
        }
        let (a, b) = formula_images(7, 7);
        let single = ssim(&a, &b, 7, &SsimOptions::new(1.0)).unwrap();
        assert!((single - 0.9332908692786747).abs() < 1e-11, "{single}");
    }

    #[test]
    fn equal_images_are_one_and_outside_pixels_take_their_windows_out() {
        let (a, b) = formula_images(16, 14);
        let options = SsimOptions::new(2.0);
        assert!((ssim(&a, &a, 14, &options).unwrap() - 1.0).abs() < 1e-12);
        // With the two top rows outside in one image, the result is the SSIM of the remaining rows.
        let mut masked = b.clone();
        masked[..28].fill(f64::NAN);
        let below = ssim(&a[28..], &b[28..], 14, &options).unwrap();
        assert!((ssim(&a, &masked, 14, &options).unwrap() - below).abs() < 1e-13);
    }

    #[test]
    fn bad_arguments_are_named() {
        let image = vec![0.0; 36];
        let error = ssim(&image, &image, 6, &SsimOptions::new(1.0)).unwrap_err();
        assert_eq!(error.to_string(), "image side = 6: expected at least the side of the window");
        assert!(ssim(&image, &image, 0, &SsimOptions::new(1.0)).is_err());
        assert!(ssim(&image, &image, 6, &SsimOptions::new(0.0)).is_err());
        let even = SsimOptions { window: SsimWindow::Uniform(4), ..SsimOptions::new(1.0) };
        assert!(ssim(&image, &image, 6, &even).is_err());
        let outside = vec![f64::NAN; 64];
        assert!(matches!(ssim(&outside, &outside, 8, &SsimOptions::new(1.0)), Err(QualityError::Undefined { .. })));
    }
}
