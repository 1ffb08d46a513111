//! Touches on a skin of elements over coils, located by a model of presses. Each press is a round face of uniform
//! pressure that moves the elements beneath it, and all presses are fitted together to the readings of the coils. The
//! travels of the elements, which outnumber the readings' information, serve only as a starting point.

mod fit;
mod mechanics;
mod seek;

use std::f64::consts::PI;

use dermis_skin::Layer;
use dermis_tomo::mesh::{Point, distance};
use dermis_touch::{Contact, ContactSign, ContactStrength};

use self::fit::{
    Covariance, FittedPresses, MOST_TRIALS, SCANNED_CELLS, Usual, cost_of, covariances, fit, moments_along,
};
use self::mechanics::{Mechanics, Press};
use self::seek::PressFilter;
use crate::Error;
use crate::imager::ElementFrame;
use crate::prepare::Prepared;
use crate::stages::element_contacts::beside;

/// Radius of a usual press in cells, and the share of the travel by which it moves an element beneath it.
const USUAL_RADIUS_CELLS: f64 = 0.44;
const USUAL_SHARE: f64 = 0.5;
/// Maximum number of presses.
const MOST_PRESSES: usize = 6;
/// Minimum drop in cost to accept another press.
const WORTH: f64 = 16.0;
/// Keep a press without refitting the others if removing it raises the cost by more than this.
const SURELY_WORTH: f64 = 160.0;
/// Two presses closer than this many cells may be a single one.
const NEAR_CELLS: f64 = 2.5;
/// Distance from the centre, in cells, at which the halves of a divided press start.
const HALF_APART_CELLS: f64 = 0.6;
/// Maximum number of trials of a fit while such divisions are compared.
const FEW_TRIALS: usize = 5;
/// Accept a fit if its residual is at most this share of the frame's energy plus `BELIEVED` per channel, in units of
/// noise and model error squared. Noise estimated from few frames at rest is itself uncertain.
const MOST_LEFT: f64 = 0.02;
const BELIEVED: f64 = 2.0;
/// Maximum residual from noise, in standard deviations above its mean.
const NOISE_DEVIATIONS: f64 = 1.5;
/// A contact starts from a press of the last frame if that is within this many cells.
const SAME_CELLS: f64 = 0.5;
/// If a position is less certain than this many cells, use the mean of all possible positions.
const UNSURE_CELLS: f64 = 0.15;
/// Also do so within this many cells of the edge of the elements.
const RIM_CELLS: f64 = 0.75;

/// Fits presses to frames.
#[derive(Debug)]
pub(crate) struct ElementPresses {
    mechanics: Mechanics,
    usual: Usual,
    filter: PressFilter,
    /// The presses of the last frame.
    last: Vec<Press>,
}

impl ElementPresses {
    /// A fitter for a skin whose images are solved for elements and whose contacts are merged.
    ///
    /// # Errors
    /// Springs with invalid parameters.
    pub fn new(prepared: &Prepared) -> Result<Option<Self>, Error> {
        let skin = &prepared.skin;
        let (Layer::Elements(layer), Some(elements)) = (&skin.frontend.layer, &skin.frontend.elements) else {
            return Ok(None);
        };
        let mechanics = Mechanics::new(elements, layer, &beside(&elements.places_m(), elements.cell_m()))?;
        let radius_m = USUAL_RADIUS_CELLS * elements.pitch_m();
        let pressure_pa =
            USUAL_SHARE * layer.stiffness_n_per_m * elements.travel_mm * 1e-3 / (PI * radius_m * radius_m);
        let (low_m, high_m) = skin.outline().bounds_m();
        let usual = Usual { log_radius: radius_m.ln(), log_pressure: pressure_pa.ln(), low_m, high_m };
        let filter = PressFilter::new(&mechanics, &usual);
        Ok(Some(Self { mechanics, usual, filter, last: Vec::new() }))
    }

    /// Locates the contacts of a frame, and splits or merges them if another number of presses explains it better.
    ///
    /// # Errors
    /// Readings that the model of the coils rejects.
    pub fn place(&mut self, mut frame: ElementFrame<'_>, contacts: &mut Vec<Contact>) -> Result<(), Error> {
        let centres: Vec<Point> = contacts
            .iter()
            .filter(|contact| contact.sign == ContactSign::Positive)
            .map(|contact| contact.centroid_m)
            .collect();
        if centres.is_empty() || centres.len() > MOST_PRESSES {
            self.last.clear();
            return Ok(());
        }
        let energy: f64 = frame.differences_h.iter().zip(&frame.weights).map(|(d, w)| w * d * d).sum();
        let found = self.explain(&mut frame, &centres)?;
        self.last.clone_from(&found.presses);
        let all_press = found.forces_n.iter().all(|force| *force > 0.0);
        if all_press && found.left <= MOST_LEFT * energy + BELIEVED * frame.weights.len() as f64 {
            let (found, covariance_m2) = self.with_moments(&mut frame, found)?;
            self.turn_into(&found, &covariance_m2, contacts);
        }
        Ok(())
    }

    /// Forgets the last frame: the next one is unrelated.
    pub fn forget(&mut self) {
        self.last.clear();
    }

    fn start_at(&self, centre_m: Point) -> Press {
        Press { centre_m, log_radius: self.usual.log_radius, log_pressure: self.usual.log_pressure }
    }

    fn fit(&self, frame: &mut ElementFrame<'_>, starts: &[Press], most_trials: usize) -> Result<FittedPresses, Error> {
        Ok(fit(&self.mechanics, &self.usual, frame, starts, most_trials)?)
    }

    /// Maximum residual of a correct fit, in units of noise and model error squared.
    fn noise_leaves(&self, frame: &ElementFrame<'_>) -> f64 {
        let channels = frame.weights.len() as f64;
        channels + NOISE_DEVIATIONS * (2.0 * channels).sqrt()
    }

    /// Finds the number of presses that explains a frame with contacts at these positions, and their parameters.
    fn explain(&self, frame: &mut ElementFrame<'_>, centres: &[Point]) -> Result<FittedPresses, Error> {
        let mut best = self.fit(frame, &self.starts(centres), MOST_TRIALS)?;
        while let Some(fewer) = self.with_fewer(frame, &best)? {
            best = fewer;
        }
        while best.presses.len() < MOST_PRESSES {
            let Some(more) = self.with_more(frame, &best)? else { break };
            let count = best.presses.len();
            best = more;
            while let Some(fewer) = self.with_fewer(frame, &best)? {
                best = fewer;
            }
            if best.presses.len() <= count {
                break;
            }
        }
        Ok(best)
    }

    /// The presses of the last frame, if each contact is one of them; otherwise usual ones at the contacts.
    fn starts(&self, centres: &[Point]) -> Vec<Press> {
        let is_known = |centre: &Point| {
            let at = self.start_at(*centre);
            self.last.iter().filter(|press| self.mechanics.cells_between(press, &at) <= SAME_CELLS).count() == 1
        };
        if self.last.len() >= centres.len() && centres.iter().all(is_known) {
            return self.last.clone();
        }
        centres.iter().map(|centre| self.start_at(*centre)).collect()
    }

    /// Moves uncertain positions to the mean of all possible ones, and computes the covariance of x and y of each
    /// press, square metres.
    fn with_moments(
        &self,
        frame: &mut ElementFrame<'_>,
        mut found: FittedPresses,
    ) -> Result<(FittedPresses, Vec<Covariance>), Error> {
        let mut covariance_m2 = covariances(&self.mechanics, &self.usual, frame, &found.presses)?;
        let cell_m = self.mechanics.cell_m[0].min(self.mechanics.cell_m[1]);
        let [unsure_m2, step_m2] = [UNSURE_CELLS, SCANNED_CELLS].map(|cells| (cells * cell_m).powi(2));
        for (number, covariance_m2) in covariance_m2.iter_mut().enumerate() {
            let ((major, minor), direction) = principal(*covariance_m2);
            let (mut variances, mut moved) = ([major, minor], [0.0; 2]);
            let across = [-direction[1], direction[0]];
            for (k, along) in [direction, across].into_iter().enumerate() {
                if variances[k] > unsure_m2 || self.is_at_rim(found.presses[number].centre_m, along) {
                    let (mean_m, variance_m2) =
                        moments_along(&self.mechanics, &self.usual, frame, &found, number, along)?;
                    // A position more certain than the step size lies between two steps.
                    if variance_m2 > step_m2 {
                        variances[k] = variance_m2;
                        (0..2).for_each(|axis| moved[axis] += mean_m * along[axis]);
                    } else {
                        variances[k] = variances[k].min(step_m2);
                    }
                }
            }
            (0..2).for_each(|axis| found.presses[number].centre_m[axis] += moved[axis]);
            *covariance_m2 = [0, 1].map(|a| {
                [0, 1].map(|b| variances[0] * direction[a] * direction[b] + variances[1] * across[a] * across[b])
            });
        }
        Ok((found, covariance_m2))
    }

    /// A fit with one press less, or with two merged, that explains the frame as well.
    fn with_fewer(&self, frame: &mut ElementFrame<'_>, best: &FittedPresses) -> Result<Option<FittedPresses>, Error> {
        let presses = &best.presses;
        if presses.len() < 2 {
            return Ok(None);
        }
        // Drop a press that explains nothing the others leave.
        for number in 0..presses.len() {
            let mut others = presses.clone();
            others.remove(number);
            if cost_of(&self.mechanics, &self.usual, frame, &others)? > best.cost + SURELY_WORTH {
                continue;
            }
            let fewer = self.fit(frame, &others, MOST_TRIALS)?;
            if fewer.cost < best.cost + WORTH {
                return Ok(Some(fewer));
            }
        }
        for a in 0..presses.len() {
            for b in a + 1..presses.len() {
                if self.mechanics.cells_between(&presses[a], &presses[b]) > NEAR_CELLS {
                    continue;
                }
                let mut joined = presses.clone();
                let other = joined.swap_remove(b);
                joined[a].centre_m = [0, 1].map(|axis| 0.5 * (presses[a].centre_m[axis] + other.centre_m[axis]));
                let fewer = self.fit(frame, &joined, MOST_TRIALS)?;
                if fewer.cost < best.cost + WORTH {
                    return Ok(Some(fewer));
                }
            }
        }
        Ok(None)
    }

    /// A fit with one more press, if that is worth it. The press starts where it would explain most of the residual.
    /// If the residual exceeds noise, the halves of a divided press are tried too.
    fn with_more(&self, frame: &mut ElementFrame<'_>, best: &FittedPresses) -> Result<Option<FittedPresses>, Error> {
        let proposed = self.filter.seek(&self.mechanics, &self.usual, frame, &best.presses, self.worth_anywhere())?;
        let mut starts: Vec<Vec<Press>> =
            proposed.into_iter().map(|press| best.presses.iter().copied().chain([press]).collect()).collect();
        if best.left > self.noise_leaves(frame) {
            let halves = (0..best.presses.len()).flat_map(|number| (0..4).map(move |quarter| (number, quarter)));
            starts.extend(halves.map(|(number, quarter)| self.divided(&best.presses, number, quarter)));
        }
        let mut begun: Option<FittedPresses> = None;
        for starts in &starts {
            let found = self.fit(frame, starts, FEW_TRIALS)?;
            if begun.as_ref().is_none_or(|other| found.cost < other.cost) {
                begun = Some(found);
            }
        }
        let Some(begun) = begun else { return Ok(None) };
        let more = self.fit(frame, &begun.presses, MOST_TRIALS)?;
        Ok((more.cost < best.cost - WORTH).then_some(more))
    }

    /// Minimum drop in cost to start another press anywhere. Noise lowers the cost somewhere: the maximum of n squared
    /// normal variables exceeds a single one by about 2 ln n. Readings depend on the travels of the elements alone, so
    /// n is the number of elements.
    fn worth_anywhere(&self) -> f64 {
        WORTH + 2.0 * (self.mechanics.count() as f64).ln()
    }

    /// These presses with one of them divided into usual ones along a direction, in quarters of a half turn.
    fn divided(&self, presses: &[Press], number: usize, quarter: u32) -> Vec<Press> {
        let (sine, cosine) = (0.25 * PI * f64::from(quarter)).sin_cos();
        let half = |sign: f64| {
            let by = [cosine, sine].map(|share| sign * HALF_APART_CELLS * share);
            self.start_at([0, 1].map(|axis| presses[number].centre_m[axis] + by[axis] * self.mechanics.cell_m[axis]))
        };
        let mut divided = presses.to_vec();
        divided[number] = half(1.0);
        divided.push(half(-1.0));
        divided
    }

    /// True if a position is close to the edge of the elements, in either sense along a direction.
    fn is_at_rim(&self, at_m: Point, along: [f64; 2]) -> bool {
        let cell_m = self.mechanics.cell_m;
        [-RIM_CELLS, RIM_CELLS].iter().any(|cells| {
            let there = [0, 1].map(|axis| at_m[axis] + cells * along[axis] * cell_m[axis]);
            !self.mechanics.is_felt(there)
        })
    }

    /// Turns these presses into contacts. Each takes the nearest contact in the image. If none is left, it takes a
    /// share of the strongest in proportion to its force. One strong contact in the image makes every press strong,
    /// because the fit needs all of them.
    fn turn_into(&self, found: &FittedPresses, covariance_m2: &[Covariance], contacts: &mut Vec<Contact>) {
        let (mut of_image, mut kept): (Vec<Contact>, Vec<Contact>) =
            contacts.drain(..).partition(|contact| contact.sign == ContactSign::Positive);
        let strongest = of_image.iter().copied().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
        let is_strong = of_image.iter().any(|contact| contact.strength == ContactStrength::Strong);
        let most_n = found.forces_n.iter().copied().fold(0.0, f64::max);
        let excess = (found.left / found.degrees_of_freedom.max(1) as f64).max(1.0);
        for (number, press) in found.presses.iter().enumerate() {
            let away = |contact: &Contact| distance(contact.centroid_m, press.centre_m);
            let nearest = (0..of_image.len()).min_by(|&a, &b| away(&of_image[a]).total_cmp(&away(&of_image[b])));
            let share = || strongest.map(|contact| contact.share_at(press.centre_m, found.forces_n[number] / most_n));
            let Some(contact) = nearest.map(|k| of_image.swap_remove(k)).or_else(share) else { continue };
            kept.push(Contact {
                centroid_m: press.centre_m,
                radius_m: Some(press.radius_m()),
                covariance_m2: covariance_m2[number].map(|row| row.map(|value| excess * value)),
                strength: if is_strong { ContactStrength::Strong } else { contact.strength },
                is_single: true,
                ..contact
            });
        }
        kept.sort_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
        *contacts = kept;
    }
}

/// Variances along the principal axes of a covariance, the larger first, and the direction of the larger.
fn principal([[xx, xy], [_, yy]]: [[f64; 2]; 2]) -> ((f64, f64), [f64; 2]) {
    let (middle, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    ((middle + half, (middle - half).max(0.0)), [angle.cos(), angle.sin()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_mit::{LiftOff, LiftOffOptions};
    use dermis_skin::Skin;

    use crate::imager::ElementImager;

    /// The presses of a skin, its coils, and the noise of their readings (henries).
    fn bench(name: &str) -> (ElementPresses, LiftOff, Vec<f64>) {
        let prepared = Prepared::new(Skin::open(name).unwrap()).unwrap();
        let presses = ElementPresses::new(&prepared).unwrap().unwrap();
        let noise: Vec<f64> = prepared.voltages.iter().map(|v| 3e-4 * v.abs()).collect();
        let (coils, noise_h) = ElementImager::new(&prepared, &noise).unwrap().into_coils();
        (presses, coils, noise_h)
    }

    fn contact(centroid_m: Point) -> Contact {
        Contact {
            covariance_m2: [[1e-6, 0.0], [0.0, 1e-6]],
            significance: 30.0,
            ..Contact::even(centroid_m, 0.5, 1e-4)
        }
    }

    /// The contacts found if the image showed these, under presses with these positions and radii (mm) and pressures
    /// (kPa).
    fn found(name: &str, pressed: &[[f64; 4]], shown_mm: &[Point]) -> Vec<Contact> {
        found_in_noise(name, pressed, shown_mm, 0.0)
    }

    /// As `found`, with `noise` times the stated noise of the readings.
    fn found_in_noise(name: &str, pressed: &[[f64; 4]], shown_mm: &[Point], noise: f64) -> Vec<Contact> {
        let (mut stage, mut coils, noise_h) = bench(name);
        let press = |[x, y, radius, pressure]: &[f64; 4]| Press {
            centre_m: [1e-3 * x, 1e-3 * y],
            log_radius: (1e-3 * radius).ln(),
            log_pressure: (1e3 * pressure).ln(),
        };
        let presses: Vec<Press> = pressed.iter().map(press).collect();
        let mut travels = mechanics::Travels::default();
        stage.mechanics.travels(&presses, false, &mut travels);
        let mut differences_h = coils.differences_h(&travels.travel_m).unwrap();
        for (channel, (difference_h, noise_h)) in differences_h.iter_mut().zip(&noise_h).enumerate() {
            let sign = if (channel * 7919) % 997 % 2 == 0 { 1.0 } else { -1.0 };
            *difference_h += sign * noise * noise_h;
        }
        let weights = coils.weights(&differences_h, &noise_h, &LiftOffOptions::default()).unwrap();
        let frame = ElementFrame { coils: &mut coils, differences_h: &differences_h, weights };
        let mut contacts: Vec<Contact> = shown_mm.iter().map(|at| contact(at.map(|v| 1e-3 * v))).collect();
        stage.place(frame, &mut contacts).unwrap();
        contacts
    }

    fn nearest_mm(contacts: &[Contact], [x, y, ..]: [f64; 4]) -> f64 {
        let away = |c: &Contact| distance(c.centroid_m.map(|m| 1e3 * m), [x, y]);
        contacts.iter().map(away).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn a_press_between_elements_is_placed_where_it_is_whatever_its_size() {
        for press in [[7.0, -12.0, 9.0, 10.0], [-18.0, 22.0, 12.0, 6.0], [11.0, 9.0, 7.0, 15.0]] {
            let near = [0, 1].map(|axis| 20.0 * f64::round(press[axis] / 20.0));
            let contacts = found("em-8", &[press], &[near]);
            assert_eq!(contacts.len(), 1);
            let off = nearest_mm(&contacts, press);
            // The prior of the radius has as much influence as the model error allows.
            assert!(off < 1.5, "{press:?}: {off} mm");
            assert!(contacts[0].covariance_m2[0][0].sqrt() < 2e-3 && contacts[0].radius_m.is_some());
        }
    }

    #[test]
    fn a_press_on_the_outermost_cells_rim_is_sought_beyond_the_elements_with_a_wide_sigma() {
        let press = [52.0, 3.0, 9.0, 10.0];
        let contacts = found("em-8", &[press], &[[40.0, 0.0]]);
        let (off, sigma_mm) = (nearest_mm(&contacts, press), 1e3 * contacts[0].covariance_m2[0][0].sqrt());
        assert!(off < 8.0 && off < 2.5 * sigma_mm, "{off} mm, sigma {sigma_mm} mm");
        assert!(contacts[0].centroid_m[0] > 0.044, "{:?}", contacts[0].centroid_m);
    }

    /// With 32 frames at rest the noise of a channel is known to an eighth, and readings may be noisier than before.
    #[test]
    fn a_faint_press_is_fitted_though_noise_is_a_quarter_more_than_it_was() {
        let press = [7.0, 4.0, 15.0, 1.5];
        let contacts = found_in_noise("em-16-circular", &[press], &[[17.5, 17.5]], 1.25);
        assert_eq!(contacts.len(), 1);
        let (off, sigma_mm) = (nearest_mm(&contacts, press), 1e3 * contacts[0].covariance_m2[0][0].sqrt());
        assert!(contacts[0].radius_m.is_some() && off < 3.0 * sigma_mm, "{off} mm, sigma {sigma_mm} mm");
    }

    #[test]
    fn two_presses_that_the_image_shows_as_one_are_told_apart() {
        let (one, other) = ([-14.0, 3.0, 9.0, 10.0], [17.0, 12.0, 9.0, 8.0]);
        let contacts = found("em-8", &[one, other], &[[0.0, 8.0]]);
        assert_eq!(contacts.len(), 2);
        for press in [one, other] {
            let off = nearest_mm(&contacts, press);
            assert!(off < 1.5, "{press:?}: {off} mm");
        }
    }

    /// Most of the other press lies beyond the elements, so it moves the outermost ones by little.
    #[test]
    fn a_press_at_the_edge_of_the_elements_is_found_though_the_image_does_not_show_it() {
        let (one, other) = ([-12.0, 5.0, 9.0, 10.0], [28.0, 54.0, 9.0, 10.0]);
        let contacts = found("em-8", &[one, other], &[[-20.0, 0.0]]);
        assert_eq!(contacts.len(), 2);
        let off = nearest_mm(&contacts, other);
        let covariance_m2 = contacts[1].covariance_m2;
        let sigma_mm = 1e3 * (covariance_m2[0][0] + covariance_m2[1][1]).sqrt();
        assert!(off < 8.0 && off < 2.5 * sigma_mm, "{off} mm, sigma {sigma_mm} mm");
        assert!(contacts.iter().all(|contact| contact.is_single && contact.strength == ContactStrength::Strong));
        assert!(contacts[1].amplitude < 0.5 * contacts[0].amplitude);
    }

    #[test]
    fn one_press_that_the_image_shows_as_two_is_one() {
        let press = [10.0, 0.0, 9.0, 10.0];
        let contacts = found("em-8", &[press], &[[0.0, 0.0], [20.0, 0.0]]);
        assert_eq!(contacts.len(), 1);
        assert!(nearest_mm(&contacts, press) < 0.7);
    }

    #[test]
    fn what_no_round_press_explains_stays_as_the_image_has_it() {
        let (mut stage, mut coils, noise_h) = bench("em-8");
        // Every other element at full travel.
        let travel: Vec<f64> = (0..25).map(|k| if k % 2 == 0 { 10e-3 } else { 0.0 }).collect();
        let differences_h = coils.differences_h(&travel).unwrap();
        let weights = coils.weights(&differences_h, &noise_h, &LiftOffOptions::default()).unwrap();
        let frame = ElementFrame { coils: &mut coils, differences_h: &differences_h, weights };
        let mut contacts = vec![contact([0.0; 2])];
        stage.place(frame, &mut contacts).unwrap();
        assert_eq!(contacts, vec![contact([0.0; 2])]);
    }
}
