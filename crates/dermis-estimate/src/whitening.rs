//! Weights of the channels under independent noise and a few causes of common change.

use dermis_tomo::inner_product;

/// Scales channels so that noise and nuisances together have unit covariance: the symmetric square root of
/// `(D^2 + N N')^-1` up to a rotation, with the deviations D and the nuisances N.
#[derive(Clone, Debug)]
pub(crate) struct Whitening {
    /// 1/volts; 0 for channels that are left out.
    inverse: Vec<f64>,
    /// Orthonormal directions of the scaled channels, and the share by which each is shortened.
    directions: Vec<(Vec<f64>, f64)>,
}

impl Whitening {
    /// Weights for these deviations (volts, infinite for channels that are left out). `nuisances` are changes of the
    /// channels by one standard deviation of each cause, volts.
    pub fn new(deviations: &[f64], nuisances: &[Vec<f64>]) -> Self {
        let inverse: Vec<f64> = deviations.iter().map(|deviation| deviation.recip()).collect();
        let mut whitening = Self { inverse, directions: Vec::new() };
        // Causes are added one by one. Each step is exact, because it whitens what the steps before it have left.
        let mut left = Vec::new();
        for nuisance in nuisances {
            whitening.apply(nuisance, &mut left);
            let square: f64 = left.iter().map(|v| v * v).sum();
            if square > 0.0 && square.is_finite() {
                let length = square.sqrt();
                let direction = left.iter().map(|v| v / length).collect();
                whitening.directions.push((direction, 1.0 - (1.0 + square).sqrt().recip()));
            }
        }
        whitening
    }

    /// Number of channels that count.
    pub fn present(&self) -> usize {
        self.inverse.iter().filter(|inverse| **inverse > 0.0).count()
    }

    /// Whitens a change of the channels, volts.
    pub fn apply(&self, change: &[f64], whitened: &mut Vec<f64>) {
        whitened.clear();
        whitened.extend(change.iter().zip(&self.inverse).map(|(value, inverse)| value * inverse));
        for (direction, share) in &self.directions {
            let along = inner_product(direction, whitened);
            whitened.iter_mut().zip(direction).for_each(|(value, d)| *value -= share * along * d);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_and_nuisances_get_unit_covariance() {
        let deviations = [0.5, 2.0, 1.0, f64::INFINITY];
        let nuisances = [vec![1.0, 2.0, -1.0, 5.0], vec![0.3, 0.0, 4.0, 0.0]];
        let whitening = Whitening::new(&deviations, &nuisances);
        // W C W' = 1, where C is the covariance of the channels that count.
        let covariance = |a: usize, b: usize| {
            let own = if a == b { deviations[a] * deviations[a] } else { 0.0 };
            own + nuisances.iter().map(|nuisance| nuisance[a] * nuisance[b]).sum::<f64>()
        };
        let column = |k: usize| {
            let mut unit = vec![0.0; 4];
            unit[k] = 1.0;
            let mut whitened = Vec::new();
            whitening.apply(&unit, &mut whitened);
            whitened
        };
        let columns: Vec<Vec<f64>> = (0..4).map(column).collect();
        for (a, b) in (0..3).flat_map(|a| (0..3).map(move |b| (a, b))) {
            let value: f64 = (0..3)
                .flat_map(|j| (0..3).map(move |k| (j, k)))
                .map(|(j, k)| columns[j][a] * covariance(j, k) * columns[k][b])
                .sum();
            assert!((value - f64::from(u8::from(a == b))).abs() < 1e-12, "{a} {b} {value}");
        }
        assert_eq!(whitening.present(), 3);
    }
}
