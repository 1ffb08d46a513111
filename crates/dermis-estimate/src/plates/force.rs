//! The force under a press on plates. Where contact saturates, a frame determines the conductance and the extent of the
//! contact, but hardly the pressure: a hard press on a small disc looks like a soft one on a large disc. The force is
//! therefore the median over all presses that look alike, weighted by the prior of pressure and radius.

use super::law::Conductance;
use super::model::SizePrior;
use super::pressure::Pressed;
use crate::press::BuiltVariance;

/// Error of the force as a share of it, from the meshes, on twins of three skins with patches.
const FORCE_SHARE: f64 = 0.09;
/// Steps between presses that look alike, in standard deviations of the logarithm of the pressure, and their limits.
const STEP: f64 = 0.5;
const STEPS_IN_LOG: [f64; 2] = [0.02, 0.3];
/// Largest number of steps to either side.
const MOST_STEPS: usize = 24;
/// Presses whose logarithm of the probability density is lower than the highest by more than this are left out.
const MOST_BELOW: f64 = 6.0;
/// Largest deviation of the pressure from the usual one, in standard deviations of its prior.
const MOST_OFF: f64 = 3.5;
/// Steps to the most probable radius for a pressure.
const RADIUS_STEPS: usize = 2;
/// Largest change of the logarithm of the radius in one of them.
const LONGEST: f64 = 0.3;

/// A 2x2 matrix of the logarithms of load and radius, or of pressure and radius.
type Square = [[f64; 2]; 2];

fn dot(a: [f64; 2], b: [f64; 2]) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}

fn product(matrix: &Square, b: [f64; 2]) -> [f64; 2] {
    matrix.map(|row| dot(row, b))
}

/// `None` if the matrix is singular.
fn inverse([[a, b], [c, d]]: &Square) -> Option<Square> {
    let determinant = a * d - b * c;
    let inverse = [[d / determinant, -b / determinant], [-c / determinant, a / determinant]];
    inverse.iter().flatten().all(|value| value.is_finite()).then_some(inverse)
}

/// The nearest matrix without negative curvature: rounding errors may leave a little.
fn definite([[a, b], [_, c]]: Square) -> Square {
    let (a, c) = (a.max(0.0), c.max(0.0));
    let most = (a * c).sqrt();
    let b = b.clamp(-most, most);
    [[a, b], [b, c]]
}

/// Uncertainties of one press besides its covariance.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PressDoubt {
    /// Changes of the logarithms of pressure and radius by the step that would come next.
    pub to_go: [f64; 2],
    /// Products of the whitened change of the channels with its derivatives by these logarithms.
    pub by_gain: [f64; 2],
}

/// The presses that look like a fitted one, with their probability: the likelihood is normal in the logarithms of the
/// reported load and radius, and the prior in those of pressure and radius.
pub(super) struct Alike<'a> {
    conductance: &'a Conductance,
    prior: &'a SizePrior,
    fitted: Pressed,
    /// Logarithms of its reported load and radius, and their derivatives by those of pressure and radius.
    reported: [f64; 2],
    by_size: Square,
    /// Slope of the log-likelihood there, and its curvature downwards, by the reported logarithms.
    slope: [f64; 2],
    curvature: Square,
}

impl<'a> Alike<'a> {
    /// The presses that look like a fitted one, given the covariance of its reported logarithms by noise and prior.
    /// Errors of the model count as noise of `inflation` times the variance. `None` without a covariance.
    pub fn new(
        conductance: &'a Conductance,
        prior: &'a SizePrior,
        fitted: Pressed,
        covariance: &Square,
        inflation: f64,
        PressDoubt { to_go, by_gain }: PressDoubt,
        built: BuiltVariance,
    ) -> Option<Self> {
        let (reported, by_size) = conductance.reported(fitted.log_pressure, fitted.log_radius);
        let (all, back) = (inverse(covariance)?, inverse(&by_size)?);
        // The covariance, and the slope that follows from it and the step to go, include the prior.
        let column = |k: usize| [back[0][k], back[1][k]];
        let [of_pressure, of_radius] = prior.precisions();
        let precision = [[of_pressure, 0.0], [0.0, of_radius]];
        let of_prior = |j: usize, k: usize| dot(column(j), product(&precision, column(k)));
        let curvature = definite([0, 1].map(|j| [0, 1].map(|k| (all[j][k] - of_prior(j, k)) / inflation)));
        let of_prior = prior.slopes(&fitted);
        let of_all = product(&all, product(&by_size, to_go));
        let slope = [0, 1].map(|k| (of_all[k] + dot(column(k), of_prior)) / inflation);
        let by_gain = [0, 1].map(|k| dot(column(k), by_gain) / inflation);
        let along_gain = inverse(&curvature).map_or([0.0; 2], |covariance| product(&covariance, by_gain));
        let alike = Self { conductance, prior, fitted, reported, by_size, slope, curvature };
        // Another gain looks like a step that keeps the shape of the response; another law, like another load.
        Some(alike.with_error(along_gain, built.gain).with_error([1.0, 0.0], built.law))
    }

    /// The same with an unknown error along this direction of the reported logarithms, by Woodbury's identity.
    fn with_error(mut self, along: [f64; 2], variance: f64) -> Self {
        let bent = product(&self.curvature, along);
        let share = variance / (1.0 + variance * dot(along, bent).max(0.0));
        let to_go = dot(along, self.slope);
        let less = |j: usize, k: usize| self.curvature[j][k] - share * bent[j] * bent[k];
        self.slope = [0, 1].map(|k| self.slope[k] - share * to_go * bent[k]);
        self.curvature = definite([0, 1].map(|j| [0, 1].map(|k| less(j, k))));
        self
    }

    /// Logarithm of the density at a pressure, and the press with the most probable radius there, searched from this
    /// one. Frames determine the radius about equally well at all pressures, so the density is not integrated over it.
    fn at(&self, log_pressure: f64, from: &Pressed) -> (f64, Pressed) {
        let mut press = Pressed { log_pressure, ..*from };
        let mut density = f64::NEG_INFINITY;
        for step in 0..=RADIUS_STEPS {
            let (reported, by_size) = self.conductance.reported(press.log_pressure, press.log_radius);
            let off = [0, 1].map(|k| reported[k] - self.reported[k]);
            let bent = product(&self.curvature, off);
            let [of_pressure, of_radius] = self.prior.off(&press);
            let likelihood = dot(self.slope, off) - 0.5 * dot(off, bent);
            density = likelihood - 0.5 * (of_pressure * of_pressure + of_radius * of_radius);
            let by_radius = [by_size[0][1], by_size[1][1]];
            if step < RADIUS_STEPS {
                let curvature = dot(by_radius, product(&self.curvature, by_radius)) + self.prior.precisions()[1];
                let slope = dot(self.slope, by_radius) - dot(bent, by_radius) - self.prior.slopes(&press)[1];
                press.log_radius += (slope / curvature).clamp(-LONGEST, LONGEST);
            }
        }
        (density, press)
    }

    /// Standard deviation of the logarithm of the pressure, near the fitted press.
    fn log_deviation(&self) -> Option<f64> {
        let column = |k: usize| [self.by_size[0][k], self.by_size[1][k]];
        let precisions = self.prior.precisions();
        let entry = |j: usize, k: usize| {
            let of_prior = if j == k { precisions[k] } else { 0.0 };
            dot(column(j), product(&self.curvature, column(k))) + of_prior
        };
        let covariance = inverse(&[0, 1].map(|j| [0, 1].map(|k| entry(j, k))))?;
        Some(covariance[0][0].max(0.0).sqrt())
    }

    /// Median of the force, and the root mean square of its deviation from it, newtons.
    pub fn force_n(&self) -> Option<[f64; 2]> {
        let step = (STEP * self.log_deviation()?).clamp(STEPS_IN_LOG[0], STEPS_IN_LOG[1]);
        let (density, middle) = self.at(self.fitted.log_pressure, &self.fitted);
        let mut presses = vec![(density, middle)];
        let mut highest = density;
        for side in [-step, step] {
            let mut press = middle;
            for k in 1..=MOST_STEPS {
                let (density, next) = self.at(self.fitted.log_pressure + side * k as f64, &press);
                highest = highest.max(density);
                if density < highest - MOST_BELOW || self.prior.off(&next)[0].abs() > MOST_OFF {
                    break;
                }
                presses.push((density, next));
                press = next;
            }
        }
        let weigh = |(density, press): (f64, Pressed)| (self.conductance.force_n(&press), (density - highest).exp());
        let weighted: Vec<(f64, f64)> = presses.into_iter().map(weigh).collect();
        let median = median(&weighted)?;
        let weights: f64 = weighted.iter().map(|(_, weight)| weight).sum();
        let squares: f64 = weighted.iter().map(|(force, weight)| weight * (force - median).powi(2)).sum();
        let deviation = (squares / weights).sqrt().hypot(FORCE_SHARE * median);
        (median.is_finite() && deviation.is_finite()).then_some([median, deviation])
    }
}

/// Median of values with weights: each weight spreads evenly up to the middles between neighbours.
fn median(weighted: &[(f64, f64)]) -> Option<f64> {
    let mut weighted = weighted.to_vec();
    weighted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let half = 0.5 * weighted.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut below = 0.0;
    let mut last: Option<(f64, f64)> = None;
    for (value, weight) in weighted {
        let at = below + 0.5 * weight;
        if at >= half {
            let (other, before) = last.unwrap_or((value, at));
            let share = if at > before { (half - before) / (at - before) } else { 1.0 };
            return Some(other + share * (value - other));
        }
        below += weight;
        last = Some((value, at));
    }
    last.map(|(value, _)| value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plates::law::PlateLaw;

    const LAW: PlateLaw =
        PlateLaw { threshold_pa: 3e3, reference_pa: 6e4, exponent: 1.5, saturation_s_per_m2: 1500.0, spread_m: 1.5e-3 };
    const AS_DRAWN: BuiltVariance = BuiltVariance { gain: 0.0, law: 0.0 };
    const PRIOR: SizePrior = SizePrior { middle: [11.3, -4.8], deviations: [1.0, 0.35] };

    /// The force if frames determine the reported logarithms with these deviations, and the prior is in it.
    fn force_n(press: Pressed, deviations: [f64; 2], doubt: PressDoubt, built: BuiltVariance) -> [f64; 2] {
        let conductance = Conductance::new(LAW);
        let (_, by_size) = conductance.reported(press.log_pressure, press.log_radius);
        let column = |k: usize| [by_size[0][k], by_size[1][k]];
        let precision = |j: usize, k: usize| {
            let of_frames: f64 = (0..2).map(|row| column(j)[row] * column(k)[row] / deviations[row].powi(2)).sum();
            of_frames + if j == k { PRIOR.deviations[k].powi(-2) } else { 0.0 }
        };
        let covariance = inverse(&[0, 1].map(|j| [0, 1].map(|k| precision(j, k)))).unwrap();
        let reported = [0, 1].map(|j| [0, 1].map(|k| dot(by_size[j], product(&covariance, by_size[k]))));
        Alike::new(&conductance, &PRIOR, press, &reported, 1.0, doubt, built).unwrap().force_n().unwrap()
    }

    fn press(log_pressure: f64, log_radius: f64) -> Pressed {
        Pressed { position_m: [0.0; 2], log_pressure, log_radius, has_ended: false }
    }

    #[test]
    fn the_force_of_a_press_that_frames_determine_is_that_of_the_fit() {
        let conductance = Conductance::new(LAW);
        for (log_pressure, log_radius) in [(10.2, -4.6), (11.3, -4.8), (11.0, -5.4)] {
            let press = press(log_pressure, log_radius);
            let [force, sigma] = force_n(press, [1e-4, 1e-4], PressDoubt::default(), AS_DRAWN);
            let exact = conductance.force_n(&press);
            assert!((force / exact - 1.0).abs() < 0.01, "{force} {exact}");
            assert!((sigma / force - FORCE_SHARE).abs() < 0.01, "{sigma} {force}");
        }
    }

    #[test]
    fn a_skin_that_is_not_as_drawn_makes_the_force_of_a_saturated_contact_uncertain() {
        let conductance = Conductance::new(LAW);
        let (deviation, error) = (1e-4_f64, 0.02);
        for log_pressure in [10.2, 11.3, 12.0] {
            let press = press(log_pressure, -4.8);
            // The force along a change of the load alone.
            let (_, by_size) = conductance.reported(press.log_pressure, press.log_radius);
            let back = inverse(&by_size).unwrap();
            let moved = |step: f64| {
                let [of_pressure, of_radius] = [back[0][0], back[1][0]].map(|slope| step * slope);
                conductance.force_n(&Pressed {
                    log_pressure: press.log_pressure + of_pressure,
                    log_radius: press.log_radius + of_radius,
                    ..press
                })
            };
            let steepness = (moved(1e-3) / moved(-1e-3)).ln() / 2e-3;
            let expected = (steepness * error).hypot(FORCE_SHARE);
            // Two channels that are the reported logarithms over their deviation. Only the load's is not zero, so that
            // another gain is another load.
            let by_gain = [0, 1].map(|k| by_size[0][k] / deviation.powi(2));
            let doubt = PressDoubt { by_gain, ..PressDoubt::default() };
            for [gain, law] in [[error * error, 0.0], [0.0, error * error]] {
                let [force, sigma] = force_n(press, [deviation; 2], doubt, BuiltVariance { gain, law });
                let share = sigma / force;
                assert!((share / expected - 1.0).abs() < 0.1, "{log_pressure} {gain} {law}: {share} {expected}");
            }
        }
    }

    #[test]
    fn without_frames_the_force_is_a_usual_one_within_the_prior() {
        // The radius is that of the prior's middle at every pressure, so the force follows the pressure: log-normal,
        // with its median at the middle.
        let usual = press(PRIOR.middle[0], PRIOR.middle[1]);
        let exact = Conductance::new(LAW).force_n(&usual);
        // From elsewhere too, if the step that is left leads to the middle.
        for (fitted, to_go) in [(usual, [0.0; 2]), (press(10.5, -4.7), [0.8, -0.1])] {
            let doubt = PressDoubt { to_go, ..PressDoubt::default() };
            let [force, sigma] = force_n(fitted, [1e3, 1e3], doubt, AS_DRAWN);
            assert!((force / exact - 1.0).abs() < 0.05, "{force} {exact}");
            // The root mean square of exp(z) - 1 for a normal z of deviation 1 is 2.26; the last 0.1 % are cut off.
            assert!((1.5..2.3).contains(&(sigma / force)), "{sigma} {force}");
        }
    }

    #[test]
    fn a_saturated_contact_leaves_the_force_open() {
        let [light, hard] = [10.2, 12.4].map(|log_pressure| {
            let [force, sigma] = force_n(press(log_pressure, -4.8), [0.05, 0.01], PressDoubt::default(), AS_DRAWN);
            sigma / force
        });
        assert!(light < 0.15 && hard > 2.0 * light, "{light} {hard}");
    }
}
