//! Images of conducting elements by their heights. The travel of every element is solved for directly
//! ([`dermis_mit::LiftOff`]) and painted around its position, so that neighbours remain separate. The model keeps
//! degrees 1 to 3 of an element's response, couples neighbours by dipoles, and assumes equal heights at rest.

use dermis_mit::{CoilTables, Coupling, LiftOff, LiftOffFit, LiftOffOptions, MultipoleArray};
use dermis_tomo::mesh::{Point, distance};

use crate::Error;
use crate::magnetic_model::{ELEMENT_WIDTH, MagneticModel};
use crate::prepare::Prepared;

const MM: f64 = 1e-3;
/// Degrees kept of an element's response.
const DEGREE: usize = 3;
/// Neighbours within this many pitches excite each other.
const REACH: f64 = 1.5;
/// Mean travel in the sparse prior, as a share of the full travel.
const MEAN: f64 = 0.25;
/// Mean squared residual above which a fit is repeated from rest.
const BAD_MISFIT: f64 = 2.0;
/// Factor on the noise of a channel without a reading.
const ABSENT: f64 = 1e6;
/// A travel that changes by less than this has converged, metres.
const TOLERANCE_M: f64 = 1e-5;
/// Margin beyond rest and full travel over which fields are tabulated, metres.
const SLACK_M: f64 = 1e-4;

/// A frame of changes of magnitudes, and the model for interpreting it.
pub(crate) struct ElementFrame<'a> {
    /// Predicts the readings for elements at other heights.
    pub coils: &'a mut LiftOff,
    /// Changes from rest, henries.
    pub differences_h: &'a [f64],
    /// Inverse variances of these changes, from noise and model error.
    pub weights: Vec<f64>,
}

/// Solves one frame after another.
#[derive(Clone, Debug)]
pub(crate) struct ElementImager {
    heights: LiftOff,
    options: LiftOffOptions,
    /// Henries of this model per volt of difference data, for each channel.
    h_per_volt: Vec<f64>,
    /// Standard deviations of the channels, henries.
    noise_h: Vec<f64>,
    /// For every inside pixel, the nearest element and the share of its travel to show.
    paint: Vec<(u32, f32)>,
    limit_m: f64,
    differences_h: Vec<f64>,
    /// Like `noise_h`, for the current frame.
    deviations_h: Vec<f64>,
    /// Zero travel.
    rest_m: Vec<f64>,
    /// The last frame's fit.
    fit: Option<LiftOffFit>,
}

impl ElementImager {
    /// Solves for heights at this noise of the channels (model volts).
    pub(crate) fn new(prepared: &Prepared, noise: &[f64]) -> Result<Self, Error> {
        let model = MagneticModel::of(&prepared.skin)?;
        let elements = model.elements;
        let places = elements.places_m();
        let (rest_m, limit_m, pitch_m) = (elements.rest_mm * MM, elements.travel_mm * MM, elements.pitch_m());
        let body = dermis_mit::catalogue::body_of(&model.element, model.frequency_hz)?.truncated(DEGREE);
        let range = [rest_m - limit_m - SLACK_M, rest_m + SLACK_M];
        let tables = CoilTables::new(&model.array, &places, range, body.radius_m)?;
        let coupling = Coupling { degree: 1, reach_m: REACH * pitch_m, sweeps: 1 };
        let bodies = MultipoleArray::new(vec![body; places.len()], tables, Some(coupling))?;
        let heights = LiftOff::new(bodies, model.array.mutuals_h(), vec![rest_m; places.len()], limit_m)?;
        // Difference data are in volts of the imaging model, whose readings at rest differ slightly from these. The
        // measured quantity is each channel's relative change.
        let h_per_volt: Vec<f64> = heights.rest_h().iter().zip(&prepared.voltages).map(|(h, v)| h / v).collect();
        let paint =
            prepared.map.inside_centres_m().iter().map(|at| nearest(&places, *at, ELEMENT_WIDTH * pitch_m)).collect();
        let mut imager = Self {
            heights,
            options: LiftOffOptions { tolerance_m: TOLERANCE_M, mean_m: MEAN * limit_m, ..LiftOffOptions::default() },
            rest_m: vec![0.0; places.len()],
            noise_h: Vec::new(),
            paint,
            limit_m,
            differences_h: Vec::with_capacity(h_per_volt.len()),
            deviations_h: Vec::with_capacity(h_per_volt.len()),
            h_per_volt,
            fit: None,
        };
        imager.set_noise(noise);
        Ok(imager)
    }

    /// Replaces the noise of the channels, model volts.
    pub(crate) fn set_noise(&mut self, noise: &[f64]) {
        self.noise_h = noise.iter().zip(&self.h_per_volt).map(|(sigma, h)| (sigma * h).abs()).collect();
    }

    /// Solves for a frame of difference data (model volts; absent channels are ignored but must be finite) and paints
    /// the inside pixels with shares of the full travel.
    pub(crate) fn image(&mut self, difference: &[f64], absent: &[u32], inside: &mut [f32]) -> Result<(), Error> {
        self.deviations_h.clone_from(&self.noise_h);
        for channel in absent {
            self.deviations_h[*channel as usize] *= ABSENT;
        }
        self.differences_h.clear();
        self.differences_h.extend(difference.iter().zip(&self.h_per_volt).map(|(d, h)| d * h));
        let start = self.fit.as_ref().map_or(&self.rest_m[..], |fit| &fit.travel_m);
        let mut fit = self.heights.solve_from(start, &self.differences_h, &self.deviations_h, &self.options)?;
        // A fit that starts from other pressed elements may end in a local minimum.
        if fit.misfit > BAD_MISFIT && self.fit.is_some() {
            let again = self.heights.solve(&self.differences_h, &self.deviations_h, &self.options)?;
            if again.misfit < fit.misfit {
                fit = again;
            }
        }
        for (pixel, (element, share)) in inside.iter_mut().zip(&self.paint) {
            *pixel = share * (fit.travel_m[*element as usize] / self.limit_m) as f32;
        }
        self.fit = Some(fit);
        Ok(())
    }

    /// Noise of the inside pixels on a skin at rest, as if each element alone could move.
    pub(crate) fn noise_of_pixels(&mut self) -> Result<Vec<f32>, Error> {
        let rest = self.heights.solve(&vec![0.0; self.noise_h.len()], &self.noise_h, &self.options)?;
        let share = |(element, share): &(u32, f32)| share * (rest.deviation_m[*element as usize] / self.limit_m) as f32;
        Ok(self.paint.iter().map(share).collect())
    }

    /// The frame solved last, for other fits to it.
    pub(crate) fn frame(&mut self) -> Result<ElementFrame<'_>, Error> {
        let weights = self.heights.weights(&self.differences_h, &self.deviations_h, &self.options)?;
        Ok(ElementFrame { coils: &mut self.heights, differences_h: &self.differences_h, weights })
    }

    /// Travel of every element in the last frame and its standard deviation.
    pub(crate) fn fit(&self) -> Option<&LiftOffFit> {
        self.fit.as_ref()
    }
}

#[cfg(test)]
impl ElementImager {
    /// The model of the coils, and the noise of their readings in henries.
    pub(crate) fn into_coils(self) -> (LiftOff, Vec<f64>) {
        (self.heights, self.noise_h)
    }
}

/// The nearest of the positions, and a Gaussian of the distance to it.
fn nearest(places: &[Point], at: Point, width_m: f64) -> (u32, f32) {
    let distances = places.iter().map(|place| distance(*place, at));
    let found = distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
    found.map_or((0, 0.0), |(k, distance)| (k as u32, (-0.5 * (distance / width_m).powi(2)).exp() as f32))
}
