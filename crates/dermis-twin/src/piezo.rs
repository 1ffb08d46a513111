//! The two published experiments on the piezoresistive skins of Sanchez-Delgado et al. (Intelligent Service Robotics
//! 17, 2024), for any pair of patched skins. P1 is the limit of detection: a 22 mm indenter in the middle under
//! increasing weights, with the change of the frame's V_rms compared to 3.3 standard deviations of V_rms at rest. P2
//! is the discernible distance: Pearson correlation of difference frames under 10 g, one of them shifted. One
//! parameter is fitted, to P1 of the square.

use serde::Serialize;

use crate::error::TwinError;
use crate::instrument::{Instrument, InstrumentOptions};
use crate::mechanics::{ContactLaw, Indenter, Load, STANDARD_GRAVITY_M_PER_S2, Shape};
use crate::patched::{PatchedOptions, PatchedSkin};
use crate::twin::Frontend;

/// Published limits of detection of the square and the disc, pascals.
pub const PUBLISHED_LIMITS_PA: [f64; 2] = [83.0, 119.0];
/// Published distances at correlations of 0.9 and 0.5 on the square and the disc, metres.
pub const PUBLISHED_DISTANCES_M: [[f64; 2]; 2] = [[2.51e-3, 16.92e-3], [3.42e-3, 15.53e-3]];

/// Radius of the paper's indenter, 380.13 mm^2.
const INDENTER_RADIUS_M: f64 = 11e-3;
/// Weights in the paper.
const MASSES_G: [f64; 9] = [1.8, 2.8, 3.8, 6.8, 8.8, 11.8, 16.8, 21.8, 31.8];
/// The shifted weight.
const SHIFTED_G: f64 = 10.0;
/// Number of frames at rest.
const REST_FRAMES: u64 = 30;
/// Number of standard deviations that count as detected.
const DETECTED: f64 = 3.3;

/// One weight of P1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ForcePoint {
    /// Mass of the weight.
    pub mass_g: f64,
    /// Force of the weight.
    pub force_n: f64,
    /// Mean pressure under the indenter.
    pub pressure_pa: f64,
    /// Change of V_rms of one noisy frame from its mean at rest, volts, in each repeat.
    pub change_v: [f64; 5],
}

/// P1 on one skin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DetectionCurve {
    /// Mean V_rms at rest, volts.
    pub rest_v: f64,
    /// Standard deviation of V_rms over 30 frames at rest, volts.
    pub noise_v: f64,
    /// The weights.
    pub points: Vec<ForcePoint>,
    /// Pressure at which the noise-free V_rms has changed by 3.3 `noise_v`, pascals; infinite if it never does.
    pub limit_pa: f64,
}

/// One shift of P2.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ShiftPoint {
    /// Shift along x from the middle of the skin.
    pub shift_m: f64,
    /// Pearson correlation of the difference frames, averaged over five repeats.
    pub correlation: f64,
}

/// P2 on one skin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CorrelationCurve {
    /// The shifts, in steps of 0.5 mm up to 40 mm.
    pub points: Vec<ShiftPoint>,
    /// Smallest shift at which the correlation has dropped to 0.9, metres; infinite if it never does.
    pub distance_09_m: f64,
    /// The same for 0.5.
    pub distance_05_m: f64,
}

/// Both experiments on one skin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PiezoFacts {
    /// P1.
    pub detection: DetectionCurve,
    /// P2.
    pub correlation: CorrelationCurve,
}

/// The experiments on two skins, called the square and the disc after the published ones.
#[derive(Clone, Debug)]
pub struct PaperP {
    skins: [PatchedSkin; 2],
    contact: ContactLaw,
    instrument: InstrumentOptions,
    seed: u64,
}

impl PaperP {
    /// The square and the disc with one instrument. Both use the square's contact law, and `seed` for the noise.
    ///
    /// # Errors
    /// As [`PatchedSkin::new`].
    pub fn new(
        square: PatchedOptions,
        disc: PatchedOptions,
        instrument: InstrumentOptions,
        seed: u64,
    ) -> Result<Self, TwinError> {
        let contact = square.contact;
        let skins = [PatchedSkin::new(square)?, PatchedSkin::new(PatchedOptions { contact, ..disc })?];
        Ok(Self { skins, contact, instrument, seed })
    }

    /// The current contact law.
    pub fn contact(&self) -> &ContactLaw {
        &self.contact
    }

    /// Fits the contact's reference pressure to the published limit of detection of the square and returns it
    /// (pascals). Nothing else is fitted: one number determines one parameter, and everything else about both skins
    /// is a prediction.
    ///
    /// # Errors
    /// A skin that cannot be solved, or no solution between 1 Pa and 1 GPa, for instance if the gap closes above the
    /// limit.
    pub fn fit(&mut self) -> Result<f64, TwinError> {
        let (mut low, mut high) = (0.0_f64, 9.0_f64);
        // A higher reference pressure weakens the contact and raises the limit.
        for _ in 0..30 {
            let middle = 0.5 * (low + high);
            self.set_reference(10_f64.powf(middle))?;
            if self.detection(0)?.limit_pa < PUBLISHED_LIMITS_PA[0] { low = middle } else { high = middle }
        }
        let reference_pa = 10_f64.powf(0.5 * (low + high));
        self.set_reference(reference_pa)?;
        let limit_pa = self.detection(0)?.limit_pa;
        crate::error::check("fitted limit_pa", limit_pa, 82.0, 84.0, "83 Pa for some reference pressure")?;
        Ok(reference_pa)
    }

    /// Both experiments on both skins, square first.
    ///
    /// # Errors
    /// Fields that cannot be solved.
    pub fn facts(&mut self) -> Result<[PiezoFacts; 2], TwinError> {
        let mut of = |skin| -> Result<PiezoFacts, TwinError> {
            Ok(PiezoFacts { detection: self.detection(skin)?, correlation: self.correlation(skin)? })
        };
        Ok([of(0)?, of(1)?])
    }

    fn set_reference(&mut self, reference_pa: f64) -> Result<(), TwinError> {
        self.contact.reference_pa = reference_pa;
        self.skins.iter_mut().try_for_each(|skin| skin.set_contact(self.contact))
    }

    /// P1 on the square (0) or the disc (1).
    fn detection(&mut self, skin: usize) -> Result<DetectionCurve, TwinError> {
        let at_rest = self.voltages(skin, &[])?;
        let mut instrument = self.instrument(skin, 0)?;
        let levels: Vec<f64> = (0..REST_FRAMES).map(|_| rms(&read(&mut instrument, &at_rest))).collect();
        let rest_v = levels.iter().sum::<f64>() / levels.len() as f64;
        let spread = levels.iter().map(|level| (level - rest_v).powi(2)).sum::<f64>();
        let noise_v = (spread / (levels.len() - 1) as f64).sqrt();
        let mut points = Vec::new();
        for mass_g in MASSES_G {
            let force_n = mass_g * 1e-3 * STANDARD_GRAVITY_M_PER_S2;
            let indenter = weight(force_n, 0.0);
            let pressed = self.voltages(skin, std::slice::from_ref(&indenter))?;
            let mut change_v = [0.0; 5];
            for (repeat, change) in change_v.iter_mut().enumerate() {
                let mut instrument = self.instrument(skin, 1 + repeat as u64)?;
                *change = (rms(&read(&mut instrument, &pressed)) - rest_v).abs();
            }
            points.push(ForcePoint { mass_g, force_n, pressure_pa: indenter.pressure_pa(), change_v });
        }
        let limit_pa = self.limit(skin, rms(&at_rest), DETECTED * noise_v)?;
        Ok(DetectionCurve { rest_v, noise_v, points, limit_pa })
    }

    /// Pressure that changes the noise-free V_rms by `threshold_v`, by bisection on its logarithm.
    fn limit(&mut self, skin: usize, rest_v: f64, threshold_v: f64) -> Result<f64, TwinError> {
        let area = Shape::Disc { radius_m: INDENTER_RADIUS_M }.area_m2();
        let (mut low, mut high) = (0.0_f64, 5.0_f64);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            let pressed = self.voltages(skin, &[weight(area * 10_f64.powf(middle), 0.0)])?;
            if (rms(&pressed) - rest_v).abs() < threshold_v { low = middle } else { high = middle }
        }
        Ok(if high < 5.0 { 10_f64.powf(high) } else { f64::INFINITY })
    }

    /// P2 on the square (0) or the disc (1).
    fn correlation(&mut self, skin: usize) -> Result<CorrelationCurve, TwinError> {
        let force_n = SHIFTED_G * 1e-3 * STANDARD_GRAVITY_M_PER_S2;
        let rest = self.voltages(skin, &[])?;
        let middle = self.voltages(skin, &[weight(force_n, 0.0)])?;
        let mut points = Vec::new();
        for step in 0..=80 {
            let shift_m = 0.5e-3 * f64::from(step);
            let shifted = self.voltages(skin, &[weight(force_n, shift_m)])?;
            let mut sum = 0.0;
            for repeat in 0..5 {
                let mut instrument = self.instrument(skin, 100 + repeat)?;
                let mut baseline = vec![0.0; rest.len()];
                for _ in 0..REST_FRAMES {
                    let frame = read(&mut instrument, &rest);
                    baseline.iter_mut().zip(frame).for_each(|(mean, v)| *mean += v / REST_FRAMES as f64);
                }
                let first = read(&mut instrument, &middle);
                let second = read(&mut instrument, &shifted);
                sum += pearson(&difference(&first, &baseline), &difference(&second, &baseline));
            }
            points.push(ShiftPoint { shift_m, correlation: sum / 5.0 });
        }
        let (distance_09_m, distance_05_m) = (crossing(&points, 0.9), crossing(&points, 0.5));
        Ok(CorrelationCurve { points, distance_09_m, distance_05_m })
    }

    fn voltages(&mut self, skin: usize, indenters: &[Indenter]) -> Result<Vec<f64>, TwinError> {
        let mut frame = vec![0.0; self.skins[skin].channel_count()];
        self.skins[skin].voltages(indenters, 0.0, &mut frame)?;
        Ok(frame)
    }

    fn instrument(&self, skin: usize, repeat: u64) -> Result<Instrument, TwinError> {
        Instrument::new(self.instrument, self.skins[skin].channel_count(), self.seed.wrapping_add(repeat))
    }
}

/// The paper's indenter under a force, shifted along x from the middle.
fn weight(force_n: f64, shift_m: f64) -> Indenter {
    Indenter {
        centre_m: [shift_m, 0.0],
        shape: Shape::Disc { radius_m: INDENTER_RADIUS_M },
        load: Load::ForceN(force_n),
    }
}

fn read(instrument: &mut Instrument, voltages_v: &[f64]) -> Vec<f64> {
    let mut frame = voltages_v.to_vec();
    instrument.read(0.0, &mut frame);
    frame
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn difference(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

fn pearson(a: &[f64], b: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let (mean_a, mean_b) = (mean(a), mean(b));
    let (mut ab, mut aa, mut bb) = (0.0, 0.0, 0.0);
    for (a, b) in a.iter().zip(b) {
        let (a, b) = (a - mean_a, b - mean_b);
        (ab, aa, bb) = (ab + a * b, aa + a * a, bb + b * b);
    }
    ab / (aa * bb).sqrt()
}

/// First shift at which the curve drops to a level, linear between its points.
fn crossing(points: &[ShiftPoint], level: f64) -> f64 {
    if points.first().is_some_and(|point| point.correlation <= level) {
        return 0.0;
    }
    let pair = points.windows(2).find(|pair| pair[1].correlation <= level);
    pair.map_or(f64::INFINITY, |pair| {
        let share = (pair[0].correlation - level) / (pair[0].correlation - pair[1].correlation);
        pair[0].shift_m + share * (pair[1].shift_m - pair[0].shift_m)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn correlation_is_pearsons() {
        let a = [1.0, 2.0, 4.0, 3.0];
        assert!((pearson(&a, &a.map(|v| 5.0 - 2.0 * v)) + 1.0).abs() < 1e-15);
        // Computed by hand: means 2.5 and 2, sums of products 2, 5 and 2.
        assert!((pearson(&a, &[1.0, 2.0, 2.0, 3.0]) - 2.0 / 10_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn crossings_are_interpolated() {
        let points = [1.0, 0.8, 0.4].map(|c| ShiftPoint { shift_m: 10.0 * (1.0 - c), correlation: c });
        assert!((crossing(&points, 0.9) - 1.0).abs() < 1e-12);
        assert!((crossing(&points, 0.5) - 5.0).abs() < 1e-12);
        assert_eq!(crossing(&points, 0.1), f64::INFINITY);
    }
}
