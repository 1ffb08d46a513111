//! Minimum discernible distance as defined in the paper on the frontend/backend skin: the distance a contact must
//! move before its vector of channel differences correlates with that of the first position by no more than 0.9, or
//! 0.5.

use crate::error::{TouchError, require, require_finite, require_length};

/// Pearson's correlation coefficient of two vectors of channels.
///
/// # Errors
/// [`TouchError::Length`]; values that are not finite; fewer than 2 values; a constant vector.
pub fn pearson(a: &[f64], b: &[f64]) -> Result<f64, TouchError> {
    require_length("second vector", a.len(), b.len())?;
    require(a.len() >= 2, "channels", a.len() as f64, "at least 2")?;
    require_finite("first vector", a)?;
    require_finite("second vector", b)?;
    let count = a.len() as f64;
    let (mean_a, mean_b) = (a.iter().sum::<f64>() / count, b.iter().sum::<f64>() / count);
    let (mut cross, mut square_a, mut square_b) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        cross += (a - mean_a) * (b - mean_b);
        square_a += (a - mean_a).powi(2);
        square_b += (b - mean_b).powi(2);
    }
    require(square_a > 0.0, "variance of the first vector", square_a, "above 0")?;
    require(square_b > 0.0, "variance of the second vector", square_b, "above 0")?;
    Ok(cross / (square_a.sqrt() * square_b.sqrt()))
}

/// The first displacement (metres) at which `correlations` drops to `level`, linearly between neighbours; `None` if
/// it stays above. Displacements ascend.
///
/// # Errors
/// [`TouchError::Length`]; values that are not finite; displacements that do not ascend.
pub fn crossing_distance_m(
    displacements_m: &[f64],
    correlations: &[f64],
    level: f64,
) -> Result<Option<f64>, TouchError> {
    require_length("correlations", displacements_m.len(), correlations.len())?;
    require_finite("displacements_m", displacements_m)?;
    require_finite("correlations", correlations)?;
    require(level.is_finite(), "level", level, "finite")?;
    if let Some(pair) = displacements_m.windows(2).find(|pair| pair[1] <= pair[0]) {
        return Err(TouchError::Parameter { name: "displacements_m", value: pair[1], expected: "ascending" });
    }
    let Some(first) = correlations.iter().position(|&correlation| correlation <= level) else { return Ok(None) };
    if first == 0 {
        return Ok(Some(displacements_m[0]));
    }
    let (before, after) = (correlations[first - 1], correlations[first]);
    let share = (before - level) / (before - after);
    Ok(Some(displacements_m[first - 1] + share * (displacements_m[first] - displacements_m[first - 1])))
}

/// Minimum discernible distance (metres) at a correlation `level` (0.9 and 0.5 in the paper), from the channel
/// vectors (differences from the untouched skin) at each displacement. The others are compared with the first. `None`
/// if the correlation stays above the level.
///
/// # Errors
/// As [`pearson`] and [`crossing_distance_m`]; no vectors.
pub fn minimum_discernible_distance_m(
    displacements_m: &[f64],
    vectors: &[Vec<f64>],
    level: f64,
) -> Result<Option<f64>, TouchError> {
    require_length("vectors", displacements_m.len(), vectors.len())?;
    let Some(first) = vectors.first() else {
        return Err(TouchError::TooFewFrames { what: "minimum discernible distance", expected: 1, got: 0 });
    };
    let correlations = vectors.iter().map(|vector| pearson(first, vector)).collect::<Result<Vec<_>, _>>()?;
    crossing_distance_m(displacements_m, &correlations, level)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_of_rotated_vectors_is_the_cosine() {
        // Zero-mean orthogonal vectors: the correlation of cos(a) u + sin(a) w with u is cos(a).
        let (u, w) = ([1.0, -1.0, 1.0, -1.0], [1.0, 1.0, -1.0, -1.0]);
        let displacements: Vec<f64> = (0..=16).map(|step| f64::from(step) * 1e-3).collect();
        let angle = |d: f64| d / 16e-3 * std::f64::consts::FRAC_PI_2;
        let turn = |d: &f64| (0..4).map(|i| 3.0 + angle(*d).cos() * u[i] + angle(*d).sin() * w[i]).collect();
        let vectors: Vec<Vec<f64>> = displacements.iter().map(turn).collect();
        for level in [0.9_f64, 0.5] {
            let exact = level.acos() / std::f64::consts::FRAC_PI_2 * 16e-3;
            let got = minimum_discernible_distance_m(&displacements, &vectors, level).unwrap().unwrap();
            // Linear interpolation of the cosine in steps of 5.6 degrees: the error h^2 / 8 / slope is below 0.03 mm.
            assert!((got - exact).abs() < 3e-5, "{level}: {got} {exact}");
        }
        assert_eq!(minimum_discernible_distance_m(&displacements, &vectors, -0.1).unwrap(), None);
    }

    #[test]
    fn bad_data_are_named() {
        assert!(matches!(pearson(&[1.0, 1.0], &[1.0, 2.0]), Err(TouchError::Parameter { .. })));
        assert!(pearson(&[1.0], &[1.0]).is_err());
        assert!(crossing_distance_m(&[0.0, 0.0], &[1.0, 0.5], 0.9).is_err());
        assert_eq!(crossing_distance_m(&[0.0, 2.0], &[1.0, 0.5], 0.75).unwrap(), Some(1.0));
        assert!(minimum_discernible_distance_m(&[], &[], 0.9).is_err());
    }
}
