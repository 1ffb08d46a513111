//! Correlation and relative error of an image against a known truth, as in equations 6 and 7 of the paper on the
//! self-healing skin (Chen, Wang et al.). Pixels that are not finite in both images are left out.

use super::error::{QualityError, check_length};

/// Image correlation coefficient, equation 6: the Pearson correlation of image and truth, from -1 to 1. Independent
/// of scale and offset.
///
/// # Errors
/// Images of different length, no pixel that is finite in both, or a constant image.
pub fn icc(truth: &[f64], image: &[f64]) -> Result<f64, QualityError> {
    check_length("image", truth.len(), image.len())?;
    let count = pairs(truth, image).count() as f64;
    if count == 0.0 {
        return Err(undefined("ICC", "no pixel is finite in both images"));
    }
    let (sum_t, sum_i) = pairs(truth, image).fold((0.0, 0.0), |(t, i), (truth, image)| (t + truth, i + image));
    let (mean_t, mean_i) = (sum_t / count, sum_i / count);
    let (mut cross, mut square_t, mut square_i) = (0.0, 0.0, 0.0);
    for (truth, image) in pairs(truth, image) {
        let (t, i) = (truth - mean_t, image - mean_i);
        cross += t * i;
        square_t += t * t;
        square_i += i * i;
    }
    // A constant image leaves at most the rounding error of its mean.
    let rounding = |mean: f64| count * (4.0 * f64::EPSILON * mean).powi(2);
    if square_t <= rounding(mean_t) || square_i <= rounding(mean_i) {
        return Err(undefined("ICC", "an image is the same everywhere"));
    }
    Ok(cross / (square_t.sqrt() * square_i.sqrt()))
}

/// Relative image error, equation 7: `|image - truth| / |truth|` in the Euclidean norm; 0 is perfect. Both must have
/// the same scale.
///
/// # Errors
/// Images of different length, or a truth that is zero everywhere or has no pixel that is finite in both images.
pub fn rie(truth: &[f64], image: &[f64]) -> Result<f64, QualityError> {
    check_length("image", truth.len(), image.len())?;
    let (error, size) = pairs(truth, image)
        .fold((0.0, 0.0), |(error, size), (truth, image)| (error + (image - truth).powi(2), size + truth * truth));
    if size == 0.0 {
        return Err(undefined("RIE", "the truth is zero everywhere, or no pixel is finite in both images"));
    }
    Ok((error / size).sqrt())
}

fn pairs<'a>(truth: &'a [f64], image: &'a [f64]) -> impl Iterator<Item = (f64, f64)> + 'a {
    truth.iter().copied().zip(image.iter().copied()).filter(|(t, i)| t.is_finite() && i.is_finite())
}

fn undefined(what: &'static str, reason: &'static str) -> QualityError {
    QualityError::Undefined { what, reason }
}

#[cfg(test)]
mod tests {
    use super::super::structural::tests::formula_images;
    use super::*;

    #[test]
    fn agree_with_numpy() {
        let (truth, image) = formula_images(24, 31);
        // numpy 2: corrcoef(a, b)[0, 1] and norm(b - a) / norm(a); sums of 744 terms round below 1e-12.
        assert!((icc(&truth, &image).unwrap() - 0.8905983538185863).abs() < 1e-12);
        assert!((rie(&truth, &image).unwrap() - 0.7774716844074328).abs() < 1e-12);
    }

    #[test]
    fn scale_and_offset_leave_the_correlation_and_outside_pixels_count_nothing() {
        let truth = [1.0, 2.0, 4.0, f64::NAN, 7.0];
        let image = [5.0, 3.0, -1.0, 8.0, f64::NAN];
        // 7 - 2 x on the three common pixels.
        assert!((icc(&truth, &image).unwrap() + 1.0).abs() < 1e-14);
        // (16 + 1 + 25) / (1 + 4 + 16) = 2.
        assert!((rie(&truth, &image).unwrap() - 2.0_f64.sqrt()).abs() < 1e-14);
    }

    #[test]
    fn undefined_figures_are_refused() {
        assert!(matches!(icc(&[1.0, 2.0], &[0.3, 0.3]), Err(QualityError::Undefined { what: "ICC", .. })));
        assert!(matches!(icc(&[f64::NAN], &[1.0]), Err(QualityError::Undefined { .. })));
        assert!(matches!(rie(&[0.0, 0.0], &[1.0, 2.0]), Err(QualityError::Undefined { what: "RIE", .. })));
        assert_eq!(rie(&[1.0], &[1.0, 2.0]).unwrap_err(), QualityError::Length { what: "image", expected: 1, got: 2 });
    }
}
