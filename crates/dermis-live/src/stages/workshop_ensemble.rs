//! Errors of touches on a skin that isn't built exactly as its file says.
//!
//! The prior is an ensemble of skins with random errors within the `[tolerances]` of the file: contact impedances,
//! conductivity, thickness, gains, and the positions and widths of electrodes. Each member's response to a spot
//! differs from the nominal one by `d`. A fit with the nominal model mistakes `d` for a change of the spot's
//! parameters, `(A^T A)^-1 A^T d` with the nominal derivatives `A`, so the ensemble gives a covariance of position
//! and load at every position (the approximation-error approach: Kaipio and Somersalo, Statistical and Computational
//! Inverse Problems, 2005, section 5.8). Both `d` and `A` are proportional to the load, so the covariance doesn't
//! depend on it.
//!
//! The size of the errors comes from the skin itself: the covariance is scaled by the squared misfit of its baseline
//! against the model, over the ensemble's mean squared misfit.

use std::sync::Arc;

use dermis_skin::{Dice, Tolerances, built_electrodes};
use dermis_tomo::eit::ForwardModel;
use dermis_tomo::mesh::{PixelMap, Point};
use faer::linalg::solvers::Solve;
use faer::{Mat, Side};
use rayon::prelude::*;

use crate::Error;
use crate::as_built::{self, LOAD, PARAMETERS, RADIUS, RADIUS_UNKNOWN, Spots, places};
use crate::beside::in_parallel;
use crate::prepare::Prepared;
use crate::reference::{misfit, scale_to_model};
use crate::stages::spot_model::TYPICAL_RADIUS;
use crate::stages::workshop_error::{BuiltError, WorkshopError};

/// Number of skins in the ensemble. Their root mean square has a relative error of `1 / sqrt(2 * 24)` = 14 %.
const MEMBERS: u64 = 24;
/// Largest number of elements of their meshes. Members are compared with a nominal skin on an equally coarse mesh.
const ELEMENTS: usize = 2500;
/// Number of cosines in a random conductivity.
const COSINES: usize = 64;

/// A skin with errors: voltages at rest, and model volts per relative change of each inside pixel.
struct Member {
    voltages: Vec<f64>,
    jacobian: Mat<f64>,
}

/// Errors of touches on a skin whose baseline has this relative misfit; NaN if there is no baseline to compare.
/// `None` if the skin is as drawn, or if touches aren't fitted to its model.
pub(crate) fn built_error(prepared: &Prepared, misfit: f64) -> Option<BuiltError> {
    if prepared.is_as_built() {
        // What the pokes leave unknown, whatever the baseline.
        let remaining = prepared.workshop_error(|| None)?;
        return Some(BuiltError::new(remaining, f64::NAN));
    }
    if !is_off(prepared, misfit) {
        return None;
    }
    let ensemble = prepared.workshop_error(|| match draw(prepared) {
        Ok(ensemble) => Some(Arc::new(ensemble)),
        Err(error) => {
            tracing::warn!("sigmas don't include manufacturing errors: {error}");
            None
        }
    });
    Some(BuiltError::new(ensemble?, misfit))
}

/// True if touches are fitted to the model of a skin whose baseline has this misfit, and the skin is not as drawn.
fn is_off(prepared: &Prepared, misfit: f64) -> bool {
    prepared.skin.fits_touches() && prepared.skin.backend.wiring.is_known() && as_built::is_off(prepared, misfit)
}

/// True if [`built_error`] must first draw the ensemble, which takes the time of many frames.
pub(crate) fn must_draw(prepared: &Prepared, misfit: f64) -> bool {
    !prepared.is_as_built() && is_off(prepared, misfit) && !prepared.knows_workshop_error()
}

/// Draws the ensemble of a skin whose touches are fitted.
///
/// # Errors
/// A nominal skin that cannot be meshed or solved at the ensemble's resolution.
fn draw(prepared: &Prepared) -> Result<WorkshopError, Error> {
    let tolerances = &prepared.skin.tolerances;
    let nominal = member(prepared, &Tolerances::none(), 0)?;
    let (places_m, spacing_m) = places(&prepared.skin.outline());
    let radius_m = TYPICAL_RADIUS * prepared.half_width_m();
    let at: Vec<(Point, f64)> = places_m.iter().map(|place| (*place, radius_m)).collect();
    let spots = Spots::new(prepared)?.columns(&at);
    let responses = &nominal.jacobian * &spots;
    let uniform: Vec<f64> = nominal.jacobian.row_iter().map(|row| row.iter().sum()).collect();
    let of_member = |number| {
        // Skip combinations of errors that cannot be built.
        let member = member(prepared, tolerances, number).ok()?;
        let errors = member_errors(&member, &spots, &responses, &uniform);
        Some((errors, misfit(&nominal.voltages, &member.voltages)))
    };
    let drawn: Vec<_> = in_parallel(|| (1..=MEMBERS).into_par_iter().filter_map(of_member).collect());
    let count = drawn.len().max(1) as f64;
    let misfit_2 = drawn.iter().map(|(_, misfit)| misfit * misfit).sum::<f64>() / count;
    let squares = (0..places_m.len())
        .map(|place| {
            let mut mean = [0.0; 5];
            for (errors, _) in &drawn {
                let [x, y, load, radius, left] = errors[place];
                // Opposite errors of load and radius cancel in the strength of a press.
                let strength = load + 2.0 * radius;
                let squares = [x * x, x * y, y * y, strength * strength, left];
                mean.iter_mut().zip(squares).for_each(|(mean, square)| *mean += square / count);
            }
            mean
        })
        .collect();
    let law = (0.01 * tolerances.contact_law_percent).powi(2);
    Ok(WorkshopError { places_m, spacing_m, squares, misfit_2, law })
}

/// Apparent changes of x, y (m), load and the logarithm of the radius for a spot of load 1 at each position, and
/// the share of its energy that remains.
fn member_errors(member: &Member, spots: &Mat<f64>, responses: &Mat<f64>, uniform: &[f64]) -> Vec<[f64; 5]> {
    let places = spots.ncols() / PARAMETERS;
    let channels = member.voltages.len();
    // One of every PARAMETERS columns is the spot itself; the others are its derivatives.
    let alone = Mat::from_fn(spots.nrows(), places, |pixel, place| spots[(pixel, PARAMETERS * place + LOAD)]);
    let built = &member.jacobian * &alone;
    (0..places)
        .map(|place| {
            let first = PARAMETERS * place;
            let error = Mat::from_fn(channels, 1, |c, _| built[(c, place)] - responses[(c, first + LOAD)]);
            let derivatives = Mat::from_fn(channels, PARAMETERS + 1, |c, k| {
                if k < PARAMETERS { responses[(c, first + k)] } else { uniform[c] }
            });
            let variance = error.col(0).squared_norm_l2() / channels as f64;
            let mut normal = derivatives.transpose() * &derivatives;
            normal[(RADIUS, RADIUS)] += variance / (RADIUS_UNKNOWN * RADIUS_UNKNOWN);
            let right = derivatives.transpose() * &error;
            // Scale the columns, whose units differ widely.
            let units: Vec<f64> = (0..=PARAMETERS).map(|k| normal[(k, k)].sqrt().max(f64::MIN_POSITIVE)).collect();
            let scaled = Mat::from_fn(PARAMETERS + 1, PARAMETERS + 1, |a, b| normal[(a, b)] / (units[a] * units[b]));
            let right = Mat::from_fn(PARAMETERS + 1, 1, |a, _| right[(a, 0)] / units[a]);
            match scaled.llt(Side::Lower) {
                Ok(factor) => {
                    let found = factor.solve(&right);
                    let found: Vec<f64> = units.iter().enumerate().map(|(k, unit)| found[(k, 0)] / unit).collect();
                    let left = &error - &derivatives * Mat::from_fn(PARAMETERS + 1, 1, |k, _| found[k]);
                    let share = left.squared_norm_l2() / derivatives.col(LOAD).squared_norm_l2();
                    [found[0], found[1], found[LOAD], found[RADIUS], share]
                }
                Err(_) => [0.0; 5],
            }
        })
        .collect()
}

/// Skin number `number` of the ensemble.
fn member(prepared: &Prepared, tolerances: &Tolerances, number: u64) -> Result<Member, Error> {
    let skin = &prepared.skin;
    let outline = skin.outline();
    let dice = |purpose: u64| Dice::new(0, number, purpose);
    let drawn = skin.electrode_shapes();
    let (place_m, width) = (1e-3 * tolerances.electrode_place_mm, 0.01 * tolerances.electrode_width_percent);
    let electrodes = match number {
        0 => drawn,
        _ => built_electrodes(&outline, &drawn, place_m, width, [&mut dice(1), &mut dice(2)]),
    };
    let mut contacts = dice(3);
    let spread = tolerances.contact_impedance_factor.ln();
    let factors: Vec<f64> = electrodes.iter().map(|_| (spread * contacts.normal()).exp()).collect();
    let body = skin.body_with_electrodes(ELEMENTS.min(skin.imaging.elements), electrodes, &factors)?;
    let named = |source| Error::Mesh { skin: skin.name.clone(), source };
    let map = PixelMap::new(skin.grid()?, &body.mesh.mesh).map_err(named)?;
    let length_m = 2.0 * prepared.half_width_m() * tolerances.conductivity_length_share;
    let field = Field::new(0.01 * tolerances.conductivity_percent, length_m, &mut dice(4));
    let thickness = (1.0 + 0.01 * tolerances.thickness_percent * dice(5).normal()).max(0.1);
    let conductance = skin.sheet_conductance_s() * thickness;
    let mesh = &body.mesh.mesh;
    let centroid = |nodes: &[u32]| {
        let share = 1.0 / nodes.len() as f64;
        [0, 1].map(|axis| nodes.iter().map(|&node| share * mesh.nodes()[node as usize][axis]).sum::<f64>())
    };
    let sigma: Vec<f64> = mesh.elements().map(|nodes| conductance * field.at(centroid(nodes))).collect();
    let model = ForwardModel::new(body.mesh.clone(), prepared.protocol.clone())?;
    let solution = model.solve(&sigma)?;
    let (mut voltages, pixels) = (solution.voltages(), solution.jacobian_to_pixels(&map));
    let mut columns = vec![usize::MAX; map.grid().len()];
    for (column, &pixel) in map.inside_pixels().iter().enumerate() {
        columns[pixel as usize] = column;
    }
    let centres = &prepared.basis.positions;
    let inside = prepared.map.inside_pixels();
    let local: Vec<f64> = centres.iter().map(|centre| conductance * field.at([centre[0], centre[1]])).collect();
    let mut jacobian = Mat::from_fn(voltages.len(), inside.len(), |channel, pixel| {
        let column = columns[inside[pixel] as usize];
        if column == usize::MAX { 0.0 } else { local[pixel] * pixels.row(channel)[column] }
    });
    let mut dice = dice(6);
    let gains: Vec<f64> = voltages.iter().map(|_| 1.0 + 0.01 * tolerances.gain_percent * dice.normal()).collect();
    voltages.iter_mut().zip(&gains).for_each(|(voltage, gain)| *voltage *= gain);
    let scale = scale_to_model(prepared, &voltages)?;
    for (channel, (gain, scale)) in gains.iter().zip(scale).enumerate() {
        jacobian.row_mut(channel).iter_mut().for_each(|value| *value *= gain * scale);
    }
    Ok(Member { voltages, jacobian })
}

/// A random factor on the conductivity, log-normal with Gaussian correlation: the exponential of a sum of cosines
/// whose wave vectors are drawn from the correlation's spectrum (Rahimi and Recht, Random features for large-scale
/// kernel machines, 2007).
struct Field {
    deviation: f64,
    waves: Vec<[f64; 3]>,
}

impl Field {
    fn new(deviation: f64, length_m: f64, dice: &mut Dice) -> Self {
        let wave = |dice: &mut Dice| {
            let phase = std::f64::consts::TAU * dice.below(1 << 16) as f64 / f64::from(1 << 16);
            [dice.normal() / length_m, dice.normal() / length_m, phase]
        };
        let waves = if deviation > 0.0 { (0..COSINES).map(|_| wave(dice)).collect() } else { Vec::new() };
        Self { deviation, waves }
    }

    fn at(&self, place_m: Point) -> f64 {
        let sum: f64 = self.waves.iter().map(|[x, y, phase]| (x * place_m[0] + y * place_m[1] + phase).cos()).sum();
        (self.deviation * sum * (2.0 / COSINES as f64).sqrt()).exp()
    }
}
