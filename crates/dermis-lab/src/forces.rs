//! Force calibration: turns presses of known force, on a twin or from recorded frames, into a file that live and
//! offline runs use to report forces. It corrects the forces by the layer's law, if the skin file states one. Otherwise
//! the signal is the height of the touch's peak in the image; if several places were pressed, a gain map over the
//! surface brings them onto one calibration line (as in paper I).

use dermis_live::imager::Imager;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::reference::{are_pairs, check_frames};
use dermis_tomo::mesh::Point;
use dermis_touch::force::{CalibrationScope, CurveKind, ForceCalibration, ForceReading, ForceSample, GainMap};
use dermis_touch::{Contact, TouchError};
use dermis_twin::mechanics::{Indenter, Load, Shape};

use crate::Error;
use crate::reconstruct::{learn_from_rest, reference_of};
use crate::twin_bench::Rig;
use dermis_live::calibration::{LoadQuantity, Pokes};
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_twin::TwinKit;

/// Frames averaged for each press of a twin.
const FRAMES: usize = 10;
/// Minimum number of places for a smooth gain map.
const SMOOTH_GAIN: usize = 6;

/// A plan for pressing a twin: the same forces at several places.
#[derive(Clone, Debug, PartialEq)]
pub struct PressPlan {
    /// Diameter of the round indenter, metres.
    pub indenter_m: f64,
    /// Largest force, newtons.
    pub most_n: f64,
    /// Number of forces at each place, evenly spaced starting from a share of the largest.
    pub steps: usize,
}

impl PressPlan {
    /// The default plan: the initial indenter of the twin's sliders, and 1.5 times their initial force.
    ///
    /// # Errors
    /// The skin has no twin.
    pub fn of(skin: &Skin) -> Result<Self, Error> {
        let press = TwinKit::of(skin)?.press;
        let area_m2 = std::f64::consts::PI * press.initial_radius_m.powi(2);
        Ok(Self {
            indenter_m: 2.0 * press.initial_radius_m,
            most_n: 1.5 * press.initial_pressure_pa * area_m2,
            steps: 8,
        })
    }
}

/// Presses the twin of a skin at its centre and on two rings around it (nine places), and reads the strongest
/// touch of each image. Presses that are not detected are left out. `progress` gets the number of presses done and
/// the total.
///
/// # Errors
/// The skin has no twin, the forces or the indenter are invalid, or no press is detected.
pub fn press_twin(
    skin: &Skin,
    plan: &PressPlan,
    mut progress: impl FnMut(usize, usize),
) -> Result<Vec<ForceSample>, Error> {
    let positive = |field: &str, value: f64| {
        let refused = || {
            Error::Live(dermis_live::Error::Frames {
                what: field.into(),
                expected: "above 0".into(),
                got: value.to_string(),
            })
        };
        if value.is_finite() && value > 0.0 { Ok(()) } else { Err(refused()) }
    };
    positive("indenter diameter (m)", plan.indenter_m)?;
    positive("largest force (N)", plan.most_n)?;
    positive("forces at a place", plan.steps as f64)?;
    let (frontend, instrument, _) = TwinKit::of(skin)?.twin.into_parts();
    let mut rig = Rig::from_parts(skin.clone(), frontend, instrument)?;
    rig.set_indenter(0.5 * plan.indenter_m)?;
    let places = places(rig.prepared().half_width_m());
    let all = places.len() * plan.steps;
    let mut samples = Vec::with_capacity(all);
    for (k, place) in places.iter().enumerate() {
        for step in 1..=plan.steps {
            let force_n = plan.most_n * step as f64 / plan.steps as f64;
            let shape = Shape::Disc { radius_m: 0.5 * plan.indenter_m };
            let frame = rig.mean_frame(&[Indenter { centre_m: *place, shape, load: Load::ForceN(force_n) }], FRAMES)?;
            let image = rig.image(&frame)?;
            samples.extend(rig.touches(&image)?.first().map(|contact| sample(*place, force_n, contact)));
            progress(k * plan.steps + step, all);
        }
    }
    seen(samples, all)
}

/// The centre and eight places on two rings, one rotated against the other.
fn places(half_width_m: f64) -> Vec<Point> {
    let ring = |radius: f64, first: f64| {
        (0..4).map(move |k| {
            let angle = first + f64::from(k) * std::f64::consts::FRAC_PI_2;
            [radius * half_width_m * angle.cos(), radius * half_width_m * angle.sin()]
        })
    };
    std::iter::once([0.0, 0.0]).chain(ring(0.3, 0.3)).chain(ring(0.6, 0.3 + std::f64::consts::FRAC_PI_4)).collect()
}

/// Samples of pokes with known force: the strongest touch of each frame. `baselines` holds one frame for all pokes or
/// one for each. Frames are in the protocol's order. `indenter_m` is the indenter's diameter, metres.
///
/// # Errors
/// The pokes have no forces, the counts disagree, or no frame shows a touch.
pub fn force_samples(
    prepared: &Prepared,
    baselines: &[Vec<f64>],
    frames: &[Vec<f64>],
    pokes: &Pokes,
    indenter_m: f64,
) -> Result<Vec<ForceSample>, Error> {
    check_frames("poke", frames, prepared.channels())?;
    let Some((LoadQuantity::ForceN, forces)) = &pokes.loads else {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: "loads of the pokes".into(),
            expected: "forces (a column force_n)".into(),
            got: if pokes.loads.is_some() { "depths".into() } else { "none".into() },
        }));
    };
    if forces.len() != frames.len() {
        let (expected, got) = (format!("{}, one per frame", frames.len()), forces.len().to_string());
        return Err(Error::Live(dermis_live::Error::Frames { what: "forces of pokes".into(), expected, got }));
    }
    // Every frame counts by itself.
    let mut skin = prepared.skin.clone();
    skin.touch.least_frames = 1;
    let mut prepared = Prepared::new(skin)?;
    let paired = are_pairs(baselines, frames);
    let mut reference = reference_of(&prepared, baselines, paired)?;
    learn_from_rest(&mut prepared, &mut reference, baselines, paired)?;
    let own = |index: usize| paired.then(|| baselines[index].as_slice());
    let differences: Vec<Vec<f64>> =
        frames.iter().enumerate().map(|(k, frame)| reference.difference(frame, own(k))).collect();
    if !paired {
        reference.estimate_noise(&differences);
    }
    let imager = Imager::new(&prepared, &reference, &differences)?;
    let mut reconstructor = Reconstructor::offline(&prepared, &reference.noise, imager, None, None)?;
    reconstructor.take_reference(&prepared, &reference);
    reconstructor.set_indenter(Some(0.5 * indenter_m))?;
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let mut samples = Vec::with_capacity(frames.len());
    for (k, difference) in differences.iter().enumerate() {
        let time_ns = k as u64 * 1_000_000_000;
        reconstructor.image(difference, &mut image)?;
        reconstructor.forget(time_ns);
        reconstructor.follow_touches(time_ns, &image, None)?;
        let (position_m, force_n) = (pokes.positions_m[k], forces[k]);
        let strongest = reconstructor.touches.contacts().first();
        samples.extend(strongest.map(|contact| sample(position_m, force_n, contact)));
    }
    seen(samples, frames.len())
}

/// A press of known force that shows as this contact.
fn sample(position_m: Point, force_n: f64, contact: &Contact) -> ForceSample {
    let by_law = contact.force.and_then(ForceReading::by_law);
    ForceSample { position_m, force_n, signal: contact.peak_value, by_law }
}

fn seen(samples: Vec<ForceSample>, presses: usize) -> Result<Vec<ForceSample>, Error> {
    if samples.is_empty() {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: format!("touches in the images of {presses} presses"),
            expected: "at least two".into(),
            got: "none: presses are too weak for the skin file's thresholds".into(),
        }));
    }
    Ok(samples)
}

/// Fits a calibration: a correction of the layer's law, if most presses have a force by it, and a curve. With presses
/// at several places, the curve has a gain map over the surface: smooth from six places on, otherwise interpolated. The
/// gain at a place is the slope of its signals through the origin.
///
/// # Errors
/// Too few samples. Without a law: the curve doesn't rise.
pub fn fit_forces(
    samples: &[ForceSample],
    kind: CurveKind,
    scope: CalibrationScope,
) -> Result<ForceCalibration, Error> {
    let curve = gain_of(samples).and_then(|gain| ForceCalibration::fit(kind, samples, gain, scope.clone()));
    let with_law = samples.iter().filter(|sample| sample.by_law.is_some()).count();
    if 2 * with_law <= samples.len() {
        return Ok(curve?);
    }
    Ok(ForceCalibration::fit_law(samples, curve.ok(), scope)?)
}

/// Gain over the places of presses.
fn gain_of(samples: &[ForceSample]) -> Result<Option<GainMap>, TouchError> {
    let mut slopes: Vec<([f64; 2], f64, f64)> = Vec::new();
    for sample in samples {
        let known = slopes.iter().position(|(place, ..)| *place == sample.position_m).unwrap_or(slopes.len());
        if known == slopes.len() {
            slopes.push((sample.position_m, 0.0, 0.0));
        }
        slopes[known].1 += sample.signal * sample.force_n;
        slopes[known].2 += sample.force_n.powi(2);
    }
    let (positions, gains): (Vec<[f64; 2]>, Vec<f64>) =
        slopes.iter().map(|(place, product, square)| (*place, product / square)).unzip();
    Ok(match positions.len() {
        0 | 1 => None,
        // If all places lie on one conic, the smooth map is undetermined.
        SMOOTH_GAIN.. => {
            Some(GainMap::quadratic(&positions, &gains).or_else(|_| GainMap::inverse_distance(&positions, &gains))?)
        }
        _ => Some(GainMap::inverse_distance(&positions, &gains)?),
    })
}
