//! Conductivity that varies over the sheet. White noise on a grid, smoothed with a Gaussian of width `L / sqrt(2)`,
//! has the correlation `exp(-d^2 / (2 L^2))`; its exponential is the conductivity factor.

use dermis_tomo::mesh::Outline;
use dermis_twin::physics::ConductanceMap;

use dermis_skin::Dice;

/// Grid steps per correlation length.
const STEPS: f64 = 3.0;
/// Cut-off of the smoothing, in its standard deviations.
const REACH: f64 = 3.0;

/// A random map with this standard deviation (of the logarithm) and correlation length.
pub(super) fn map(outline: &Outline, deviation: f64, length_m: f64, dice: &mut Dice) -> ConductanceMap {
    if deviation == 0.0 {
        return ConductanceMap::Even;
    }
    let step_m = length_m / STEPS;
    let (low_m, high_m) = outline.bounds_m();
    let count = |axis: usize| ((high_m[axis] - low_m[axis]) / step_m).ceil() as usize + 1;
    let (columns, rows) = (count(0), count(1));
    let width = STEPS / std::f64::consts::SQRT_2;
    let reach = (REACH * width).ceil() as usize;
    let kernel: Vec<f64> =
        (0..=2 * reach).map(|k| (-0.5 * ((k as f64 - reach as f64) / width).powi(2)).exp()).collect();
    // The normalisation along both axes makes the standard deviation 1 everywhere.
    let norm: f64 = kernel.iter().map(|w| w * w).sum();
    let (wide, high) = (columns + 2 * reach, rows + 2 * reach);
    let white: Vec<f64> = (0..wide * high).map(|_| dice.normal()).collect();
    let along_x: Vec<f64> = (0..high * columns)
        .map(|k| {
            let (row, column) = (k / columns, k % columns);
            kernel.iter().enumerate().map(|(j, w)| w * white[row * wide + column + j]).sum()
        })
        .collect();
    let factors = (0..rows * columns)
        .map(|k| {
            let (row, column) = (k / columns, k % columns);
            let value: f64 = kernel.iter().enumerate().map(|(j, w)| w * along_x[(row + j) * columns + column]).sum();
            (deviation * value / norm).exp()
        })
        .collect();
    ConductanceMap::Grid { low_m, step_m: [step_m; 2], columns, factors }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_their_deviation_and_correlation_length() {
        let outline = Outline::Rectangle { width_m: 0.1, height_m: 0.1 };
        let (mut squares, mut products) = (0.0, 0.0);
        const MAPS: u32 = 600;
        for seed in 0..MAPS {
            let map = map(&outline, 0.1, 0.02, &mut Dice::new(u64::from(seed), 0, 0));
            // Two points on the grid, whose first value is at the bottom left corner. Steps are 20/3 mm, so they are
            // three steps apart.
            let (a, b) = (map.at([-0.05, -0.05]).ln(), map.at([-0.03, -0.05]).ln());
            squares += (a * a + b * b) / 2.0 / f64::from(MAPS);
            products += a * b / f64::from(MAPS);
        }
        // 600 maps determine the deviation within 3 %, and the correlation exp(-1/2) = 0.607 within 0.03.
        assert!((squares.sqrt() / 0.1 - 1.0).abs() < 0.1, "{squares}");
        assert!((products / squares - 0.607).abs() < 0.1, "{}", products / squares);
    }
}
