//! Position and width of the strongest response of an image. The response is taken in the direction of `sign`: `1.0`
//! for pressed (positive), `-1.0` for damage.

use super::error::{QualityError, check_length};
use crate::mesh::{PixelGrid, Point, distance};

/// Centre of the pixel with the largest value (times the sign of `sign`), metres. Ties go to the first in row-major
/// order.
///
/// # Errors
/// A length that does not match the grid, or no pixel with a value of that sign.
pub fn peak_m(image: &[f64], grid: &PixelGrid, sign: f64) -> Result<Point, QualityError> {
    Ok(grid.centre_m(peak(image, grid, sign)?.0))
}

/// Centroid (unweighted) of the region around the peak where the image is at least `fraction` of it, metres. The
/// region is connected through the sides of pixels. The papers use a fraction of 0.5.
///
/// # Errors
/// As [`peak_m`]; also fails if the fraction is not above 0 and at most 1.
pub fn centroid_above_m(image: &[f64], grid: &PixelGrid, sign: f64, fraction: f64) -> Result<Point, QualityError> {
    let region = region_above(image, grid, sign, fraction)?;
    Ok(centroid_m(grid, &region))
}

/// Distance from [`peak_m`] to the true position, metres.
///
/// # Errors
/// As [`peak_m`].
pub fn position_error_by_peak_m(
    image: &[f64],
    grid: &PixelGrid,
    sign: f64,
    true_m: Point,
) -> Result<f64, QualityError> {
    Ok(distance(peak_m(image, grid, sign)?, true_m))
}

/// Distance from [`centroid_above_m`] at half the peak to the true position, metres.
///
/// # Errors
/// As [`peak_m`].
pub fn position_error_by_centroid_m(
    image: &[f64],
    grid: &PixelGrid,
    sign: f64,
    true_m: Point,
) -> Result<f64, QualityError> {
    Ok(distance(centroid_above_m(image, grid, sign, 0.5)?, true_m))
}

/// Width of a point-spread function, metres: the diameter of a disc with the area of the region around the peak at
/// half its height or more, which is the full width at half maximum of a round peak. The area is in whole pixels.
///
/// # Errors
/// As [`peak_m`].
pub fn spread_width_m(image: &[f64], grid: &PixelGrid, sign: f64) -> Result<f64, QualityError> {
    let pixels = region_above(image, grid, sign, 0.5)?.len() as f64;
    Ok(2.0 * grid.pixel_m * (pixels / std::f64::consts::PI).sqrt())
}

/// Index and signed height of the largest pixel.
pub(super) fn peak(image: &[f64], grid: &PixelGrid, sign: f64) -> Result<(usize, f64), QualityError> {
    check_length("image", grid.len(), image.len())?;
    let factor = sign.signum();
    let mut best = (0, 0.0);
    for (index, value) in image.iter().enumerate().filter(|(_, value)| value.is_finite()) {
        if factor * value > best.1 {
            best = (index, factor * value);
        }
    }
    if best.1 > 0.0 {
        return Ok(best);
    }
    Err(QualityError::Undefined { what: "peak", reason: "no pixel has a value of the requested sign" })
}

/// Mean of the pixels' centres.
pub(super) fn centroid_m(grid: &PixelGrid, pixels: &[usize]) -> Point {
    let sum = pixels.iter().map(|&index| grid.centre_m(index)).fold([0.0; 2], |s, c| [s[0] + c[0], s[1] + c[1]]);
    sum.map(|value| value / pixels.len() as f64)
}

fn region_above(image: &[f64], grid: &PixelGrid, sign: f64, fraction: f64) -> Result<Vec<usize>, QualityError> {
    if !(fraction > 0.0 && fraction <= 1.0) {
        return Err(QualityError::Value { field: "fraction", value: fraction, expected: "above 0, at most 1" });
    }
    let (start, height) = peak(image, grid, sign)?;
    let level = fraction * height;
    let mut seen = vec![false; image.len()];
    let (mut region, mut next) = (vec![start], 0);
    seen[start] = true;
    while next < region.len() {
        let index = region[next];
        next += 1;
        let (row, column) = (index / grid.columns, index % grid.columns);
        let neighbours = [
            (row > 0).then(|| index - grid.columns),
            (row + 1 < grid.rows).then(|| index + grid.columns),
            (column > 0).then(|| index - 1),
            (column + 1 < grid.columns).then(|| index + 1),
        ];
        for neighbour in neighbours.into_iter().flatten() {
            // NaN compares false, so outside pixels end the region.
            if !seen[neighbour] && sign.signum() * image[neighbour] >= level {
                seen[neighbour] = true;
                region.push(neighbour);
            }
        }
    }
    Ok(region)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(centre: Point, sigma: f64) -> (PixelGrid, Vec<f64>) {
        let grid = PixelGrid { columns: 101, rows: 101, left_m: -0.0505, top_m: 0.0505, pixel_m: 1e-3 };
        let image = grid
            .centres_m()
            .iter()
            .map(|&c| (-0.5 * (distance(c, centre) / sigma).powi(2)).exp())
            .map(|value| if value < 1e-8 { f64::NAN } else { value })
            .collect();
        (grid, image)
    }

    #[test]
    fn a_gaussian_has_its_place_and_width() {
        let (grid, image) = gaussian([0.0104, -0.0047], 6e-3);
        let peak = peak_m(&image, &grid, 1.0).unwrap();
        assert!((peak[0] - 0.010).abs() < 1e-12 && (peak[1] + 0.005).abs() < 1e-12, "{peak:?}");
        // The centroid of 157 pixels above half is accurate to a tenth of a pixel.
        let error = position_error_by_centroid_m(&image, &grid, 1.0, [0.0104, -0.0047]).unwrap();
        assert!(error < 1e-4, "{error}");
        let by_peak = position_error_by_peak_m(&image, &grid, 1.0, [0.0104, -0.0047]).unwrap();
        assert!((by_peak - 0.5e-3).abs() < 1e-12, "{by_peak}");
        // Full width at half maximum: 2 sqrt(2 ln 2) sigma. The area in whole pixels is accurate to 1 %.
        let width = spread_width_m(&image, &grid, 1.0).unwrap();
        let exact = 2.0 * (2.0 * 2.0_f64.ln()).sqrt() * 6e-3;
        assert!((width / exact - 1.0).abs() < 0.01, "{width} {exact}");
    }

    #[test]
    fn only_the_peaks_own_region_counts_and_signs_are_kept_apart() {
        let grid = PixelGrid { columns: 5, rows: 1, left_m: 0.0, top_m: 1.0, pixel_m: 1.0 };
        let image = [4.0, 2.0, f64::NAN, 3.0, -9.0];
        assert_eq!(centroid_above_m(&image, &grid, 1.0, 0.5).unwrap(), [1.0, 0.5]);
        assert_eq!(peak_m(&image, &grid, -1.0).unwrap(), [4.5, 0.5]);
        assert!(peak_m(&[1.0; 5], &grid, -1.0).is_err());
        assert!(peak_m(&[1.0; 4], &grid, 1.0).is_err());
        assert!(centroid_above_m(&image, &grid, 1.0, 0.0).is_err());
    }
}
