//! A press that stays where it is: the position and radius it had before the baseline aged.
//!
//! A fit of position, radius and load to a frame that has drifted can trade one for the other. As long as the frame
//! is consistent with the position and radius from when the baseline was fresh, these are kept, and only the load is
//! estimated: the posterior of its logarithm given them, `ln l + C_la C_aa^-1 (a - x_a) / l`. Load and radius trade off
//! as powers of each other.

use dermis_tomo::mesh::{Point, distance};

use crate::press::Press;

/// Largest squared Mahalanobis distance between an anchor and its press: the 99 % quantile of chi-squared with three
/// degrees of freedom.
const SAME: f64 = 11.3;
/// Largest number of frames averaged in an anchor.
const MOST_FRAMES: f64 = 50.0;
/// A press that moves by more than this share of its radius gets a new anchor.
const MOVED_RADII: f64 = 0.3;

/// Position and radius of a press while its baseline was fresh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    position_m: Point,
    log_radius: f64,
    frames: f64,
}

impl Anchor {
    /// A new anchor at a press.
    pub fn at(press: &Press) -> Self {
        Self { position_m: press.position_m, log_radius: press.radius_m.ln(), frames: 1.0 }
    }

    /// True if a press could be this one.
    pub fn is_near(&self, press: &Press) -> bool {
        distance(press.position_m, self.position_m) <= press.radius_m.max(self.log_radius.exp())
    }

    /// Updates the anchor with a press from a frame with a fresh baseline.
    pub fn learn(&mut self, press: &Press) {
        if distance(press.position_m, self.position_m) > MOVED_RADII * press.radius_m {
            *self = Self::at(press);
            return;
        }
        self.frames = (self.frames + 1.0).min(MOST_FRAMES);
        let share = 1.0 / self.frames;
        (0..2).for_each(|axis| self.position_m[axis] += share * (press.position_m[axis] - self.position_m[axis]));
        self.log_radius += share * (press.radius_m.ln() - self.log_radius);
    }

    /// The press given its anchor, if the frame is consistent with it.
    pub fn hold(&self, press: &Press) -> Option<Press> {
        let c = &press.covariance;
        // x, y and the logarithm of the radius.
        let kept = [0, 1, 3];
        let off = [
            self.position_m[0] - press.position_m[0],
            self.position_m[1] - press.position_m[1],
            self.log_radius - press.radius_m.ln(),
        ];
        let weights = solve(kept.map(|a| kept.map(|b| c[a][b])), off)?;
        let distance: f64 = weights.iter().zip(&off).map(|(w, d)| w * d).sum();
        if !(0.0..=SAME).contains(&distance) {
            return None;
        }
        let log_factor = kept.iter().zip(&weights).map(|(&a, w)| c[2][a] * w).sum::<f64>() / press.load;
        let load = press.load * log_factor.exp();
        load.is_finite().then_some(Press {
            position_m: self.position_m,
            radius_m: self.log_radius.exp(),
            load,
            ..*press
        })
    }
}

/// `A^-1 b` for a symmetric matrix, by cofactors; `None` if it is singular.
fn solve(a: [[f64; 3]; 3], b: [f64; 3]) -> Option<[f64; 3]> {
    let minor = |r: usize, c: usize| {
        let (r1, r2, c1, c2) = ((r + 1) % 3, (r + 2) % 3, (c + 1) % 3, (c + 2) % 3);
        a[r1][c1] * a[r2][c2] - a[r1][c2] * a[r2][c1]
    };
    let determinant: f64 = (0..3).map(|c| a[0][c] * minor(0, c)).sum();
    let x = [0, 1, 2].map(|k| (0..3).map(|r| minor(r, k) * b[r]).sum::<f64>() / determinant);
    x.iter().all(|value| value.is_finite()).then_some(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn systems_are_solved() {
        let a = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let x = solve(a, [1.0, 2.0, 3.0]).unwrap();
        for row in 0..3 {
            let product: f64 = (0..3).map(|column| a[row][column] * x[column]).sum();
            assert!((product - [1.0, 2.0, 3.0][row]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_wide_and_weak_press_is_the_narrow_and_strong_one_that_it_was() {
        let fresh = Press { position_m: [0.01, 0.0], radius_m: 0.01, load: 1.0, ..Press::default() };
        // Load and radius trade off: the load times the square of the radius is constant.
        let mut covariance = [[0.0; 4]; 4];
        (0..2).for_each(|axis| covariance[axis][axis] = 1e-8);
        let load = (-0.4_f64).exp();
        (covariance[3][3], covariance[2][3], covariance[3][2]) = (0.04, -0.08 * load, -0.08 * load);
        covariance[2][2] = 0.161 * load * load;
        let wide = Press { radius_m: 0.01 * 0.2_f64.exp(), load, covariance, ..fresh };
        let held = Anchor::at(&fresh).hold(&wide).unwrap();
        assert!((held.load - 1.0).abs() < 1e-9 && (held.radius_m - 0.01).abs() < 1e-12, "{held:?}");
        let elsewhere = Press { position_m: [0.012, 0.0], ..wide };
        assert!(Anchor::at(&fresh).hold(&elsewhere).is_none());
    }
}
