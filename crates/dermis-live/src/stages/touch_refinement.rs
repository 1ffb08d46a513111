//! Touches on sheets, separate patches and liquids: the presses that explain a frame, as contacts.

use std::sync::Arc;

use dermis_estimate::{Anchor, Estimate, Estimator, Evidence, Press, SpotFit};
use dermis_skin::{Layer, LiquidLayer};
use dermis_tomo::eit::ForwardModel;
use dermis_tomo::inverse::{ChangeResponse, SpotModel, SpotOptions};
use dermis_tomo::membrane::{Membrane, MembraneSpec};
use dermis_tomo::mesh::PixelGrid;
use dermis_touch::Contact;
use dermis_touch::force::ForceReading;
use faer::Mat;

use crate::Error;
use crate::imager::Imager;
use crate::prepare::Prepared;
use crate::stages::force_law::ForceLaw;
use crate::stages::gone::Gone;
use crate::stages::model_error::SpotError;

/// Most presses fitted to one frame.
const MOST_SPOTS: usize = 8;
/// Largest radius of a spot, relative to half the shorter side.
const LARGEST_RADIUS: f64 = 0.6;
/// Typical radius.
const TYPICAL_RADIUS: f64 = 0.12;
/// Smallest radius.
const SMALLEST_RADIUS: f64 = 0.05;
/// A frame of which presses leave less than this share of the energy holds nothing that has gone from the baseline.
const CLEARLY_EXPLAINED: f64 = 0.005;
/// What has gone explains a frame where it leaves less than this share of the energy: real gels and wrong geometries
/// leave up to a third of a press. And less than this share of what other presses leave, unless it is fewer presses.
const GONE_UNEXPLAINED: f64 = 0.3;
const BETTER: f64 = 0.5;
/// Presses have gone from the baseline once this many frames in a row say so; after looking in vain, at most this many
/// frames pass before the next look.
const GONE_FRAMES: u32 = 3;
const MOST_GONE_WAIT: u32 = 64;
/// A press that leaves more than this share of its frame and lies farther from the image's contact than this share of half
/// the shorter side is not believed: the contact stays where the image has it. On patches, where the model does not know
/// where they end, that is half a pitch.
const EXPLAINED: f64 = 0.05;
const FAR: f64 = 0.2;
const PATCHES_EXPLAINED: f64 = 0.01;
const FAR_PITCHES: f64 = 0.5;
/// In a tank, a press below this share of the strongest is a lobe of it.
const LOBE: f64 = 0.2;
/// Less than this share of a press's own greatest amplitude is no press but what it leaves behind: layers creep, and set
/// by a few per cent. The peak is remembered for this long, nanoseconds.
const REMNANT_SHARE: f64 = 0.1;
const REMEMBERED_NS: u64 = 5_000_000_000;
/// Share of a frame's energy that the model of a press leaves, on twins: of gels, foams and liquids up to 0.002; in
/// proportion, where dents are deep; in open tanks, whose surface takes the shape of what presses, 0.002 to 0.006; on
/// separate patches, which conduct as a whole, 0.007 to 0.07.
const SPOTS_ERROR: f64 = 0.001;
const IN_PROPORTION_ERROR: f64 = 0.005;
const TANK_ERROR: f64 = 0.005;
const PATCHES_ERROR: f64 = 0.04;
/// Beyond proportion spots are fitted where frames are no more frequent: a fit takes 2 ms with 16 electrodes, 13 with
/// 32 and three touches.
const MOST_FRAMES_PER_S: f64 = 60.0;

/// The strongest that a press has been.
#[derive(Clone, Copy, Debug)]
struct Peak {
    position_m: [f64; 2],
    radius_m: f64,
    amplitude: f64,
    seen_ns: u64,
}

/// Explains one frame after the other by presses, in memory of its own.
#[derive(Debug)]
pub(crate) struct SpotStage {
    estimator: Estimator<SpotFit>,
    /// What a fit says of its own error; a patch that conducts as a whole is no smooth spot.
    error: Option<SpotError>,
    /// The largest share of a frame that a fit may leave beyond the noise.
    most_unexplained: f64,
    both_signs: bool,
    /// From presses to forces, where the file states how the layer answers.
    law: Option<ForceLaw>,
    polarity: f64,
    grid: PixelGrid,
    /// Number of each pixel among the image's unknowns; none outside.
    unknowns: Vec<Option<u32>>,
    typical_radius_m: f64,
    error_share: f64,
    explained: f64,
    far_m: f64,
    hints: Vec<Press>,
    /// Contacts as the image has them.
    of_image: Vec<Contact>,
    /// The presses that are shown.
    shown: Vec<Press>,
    /// Places and radii of presses while the baseline was fresh.
    anchors: Vec<Anchor>,
    is_aged: bool,
    /// The strongest that each press has been, for what remains of it.
    peaks: Vec<Peak>,
    /// What remains of presses that have gone, to be taken into the baseline.
    remnants: Vec<Press>,
    /// Presses that the baseline holds and that have gone, in so many frames in a row.
    gone: Vec<Press>,
    gone_alone: bool,
    gone_frames: u32,
    /// Frames before they are looked for again.
    wait: u32,
    waited: u32,
    is_unhurried: bool,
    volts: Vec<f64>,
}

impl SpotStage {
    /// With responses of the prepared skin.
    /// `membrane_pa`: the pressure of a load of amplitude 1, where presses act through a membrane.
    pub(crate) fn new(prepared: &Prepared, model: SpotModel, membrane_pa: Option<f64>) -> Self {
        let touch = &prepared.skin.touch;
        let grid = *prepared.map.grid();
        let mut unknowns = vec![None; grid.len()];
        for (unknown, &pixel) in (0..).zip(prepared.map.inside_pixels()) {
            unknowns[pixel as usize] = Some(unknown);
        }
        let pitch_m = match &prepared.skin.frontend.layer {
            Layer::Patches(layer) => Some(1e-3 * layer.pitch_mm),
            _ => None,
        };
        let error_share = error_share(prepared, &model);
        let fit = SpotFit::new(model, grid, prepared.map.inside_mask(), error_share);
        let evidence = Evidence { begin: touch.begin_sigma, hold: touch.hold_sigma };
        Self {
            estimator: Estimator::new(fit, evidence, touch.both_signs),
            error: SpotError::of(prepared),
            most_unexplained: touch.most_unexplained,
            both_signs: touch.both_signs,
            law: ForceLaw::of(prepared, membrane_pa),
            polarity: prepared.skin.imaging.polarity.sign(),
            grid,
            unknowns,
            typical_radius_m: TYPICAL_RADIUS * prepared.half_width_m(),
            error_share,
            explained: if pitch_m.is_some() { PATCHES_EXPLAINED } else { EXPLAINED },
            far_m: pitch_m.map_or(FAR * prepared.half_width_m(), |pitch_m| FAR_PITCHES * pitch_m),
            hints: Vec::with_capacity(MOST_SPOTS),
            of_image: Vec::with_capacity(MOST_SPOTS),
            shown: Vec::with_capacity(MOST_SPOTS),
            anchors: Vec::new(),
            is_aged: false,
            peaks: Vec::new(),
            remnants: Vec::new(),
            gone: Vec::new(),
            gone_alone: false,
            gone_frames: 0,
            wait: 0,
            waited: 0,
            is_unhurried: false,
            volts: Vec::new(),
        }
    }

    /// From now on every frame is looked at for as long as it takes.
    pub(crate) fn take_time(&mut self) {
        self.is_unhurried = true;
        self.estimator.take_time();
    }

    /// Goes on with another weighting of the same responses: of a fresh baseline, or of one that has aged.
    pub(crate) fn set_model(&mut self, model: SpotModel, is_aged: bool) {
        self.is_aged = is_aged;
        self.estimator.fit_mut().set_model(model, self.error_share);
    }

    /// Whether presses are followed.
    pub(crate) fn is_touched(&self) -> bool {
        !self.shown.is_empty()
    }

    /// The next frame has nothing to do with the last.
    pub(crate) fn forget(&mut self) {
        self.estimator.forget();
        (self.gone_frames, self.wait) = (0, 0);
        self.peaks.clear();
        self.anchors.clear();
        self.remnants.clear();
    }

    /// Looks for presses of negative load where others do not explain the frame: they were in the baseline. What is left
    /// of the estimate where they are found.
    fn look_for_gone(&mut self, estimate: &Estimate) -> Option<Estimate> {
        if estimate.is_at_rest || estimate.unexplained < CLEARLY_EXPLAINED || self.both_signs {
            (self.gone_frames, self.wait, self.waited) = (0, 0, 0);
            return None;
        }
        if self.wait > 0 {
            self.wait -= 1;
            return None;
        }
        let found = self.estimator.explain_with_gone().filter(|found| {
            let has_gone = found.presses.iter().any(|press| press.load < 0.0);
            let is_simpler = found.presses.len() < estimate.presses.len();
            let most = if is_simpler { estimate.unexplained } else { BETTER * estimate.unexplained };
            has_gone && found.unexplained < most.min(GONE_UNEXPLAINED)
        });
        let Some(mut found) = found else {
            // Frames that nothing explains go on: looks become rare.
            self.waited = (2 * self.waited).clamp(1, MOST_GONE_WAIT);
            (self.gone_frames, self.wait) = (0, if self.is_unhurried { 0 } else { self.waited });
            return None;
        };
        self.gone.clear();
        self.gone.extend(found.presses.iter().filter(|press| press.load < 0.0));
        self.gone_alone = self.gone.len() == found.presses.len();
        self.gone_frames += 1;
        let pairs = found.presses.into_iter().zip(found.evidence);
        (found.presses, found.evidence) = pairs.filter(|(press, _)| press.load > 0.0).unzip();
        Some(found)
    }

    /// Keeps presses where they were when the baseline was fresh, as long as the frame allows that.
    fn hold(&mut self, presses: &mut [Press]) {
        self.anchors.retain(|anchor| presses.iter().any(|press| anchor.is_near(press)));
        for press in presses {
            match self.anchors.iter_mut().find(|anchor| anchor.is_near(press)) {
                Some(anchor) if !self.is_aged => anchor.learn(press),
                Some(anchor) => match anchor.hold(press) {
                    Some(held) => *press = held,
                    None => *anchor = Anchor::at(press),
                },
                None => self.anchors.push(Anchor::at(press)),
            }
        }
    }

    /// Whether a press is what remains of one that has been far stronger: a layer's set, which the baseline takes in.
    fn is_remnant(&mut self, time_ns: u64, press: &Press, amplitude: f64) -> bool {
        let is_there = |peak: &&mut Peak| {
            let reach_m = peak.radius_m.max(press.radius_m) + 2.0 * press.place_sigma_m();
            distance(peak.position_m, press.position_m) <= reach_m
        };
        let Press { position_m, radius_m, .. } = *press;
        if let Some(peak) = self.peaks.iter_mut().find(is_there) {
            peak.seen_ns = time_ns;
            if amplitude > peak.amplitude {
                *peak = Peak { position_m, radius_m, amplitude, seen_ns: time_ns };
            }
            return amplitude < REMNANT_SHARE * peak.amplitude;
        }
        self.peaks.push(Peak { position_m, radius_m, amplitude, seen_ns: time_ns });
        false
    }

    /// Presses that have gone from the baseline, once they have been missing for some frames.
    pub(crate) fn gone(&mut self) -> Option<Gone<'_>> {
        if !self.remnants.is_empty() {
            self.estimator.fit_mut().channels_of(&self.remnants, &mut self.volts);
            self.remnants.clear();
            return Some(Gone::BesideOthers(&self.volts));
        }
        if self.gone_frames < GONE_FRAMES {
            return None;
        }
        self.gone_frames = 0;
        if self.gone_alone {
            return Some(Gone::Alone);
        }
        self.estimator.fit_mut().channels_of(&self.gone, &mut self.volts);
        Some(Gone::BesideOthers(&self.volts))
    }

    /// Replaces the contacts of an image by the presses that explain its frame (model volts). They stay as the image has
    /// them where the frame cannot be fitted, or presses leave more of it than `touch.most_unexplained`.
    pub(crate) fn refine(&mut self, time_ns: u64, difference: &[f64], imager: &Imager, contacts: &mut Vec<Contact>) {
        self.shown.clear();
        self.peaks.retain(|peak| time_ns.saturating_sub(peak.seen_ns) < REMEMBERED_NS);
        self.hints.clear();
        self.hints.extend(contacts.iter().map(|contact| Press {
            position_m: contact.centroid_m,
            radius_m: self.typical_radius_m,
            load: contact.peak_value,
            ..Press::default()
        }));
        let Some(mut estimate) = self.estimator.explain(difference, &self.hints) else { return };
        self.hold(&mut estimate.presses);
        if let Some(without_gone) = self.look_for_gone(&estimate) {
            contacts.clear();
            estimate = without_gone;
        }
        if estimate.unexplained > self.most_unexplained {
            return;
        }
        self.of_image.clear();
        self.of_image.append(contacts);
        // In a tank all that explains dents may be lobes of a strong one.
        let strongest = estimate.presses.first().map_or(0.0, Press::strength);
        for (press, sigma) in estimate.presses.iter().zip(&estimate.evidence) {
            if self.most_unexplained < 1.0 && press.strength() / strongest < LOBE {
                continue;
            }
            self.estimator.fit_mut().channels_of(std::slice::from_ref(press), &mut self.volts);
            let value = self.image_value(imager, press.position_m);
            if value == 0.0 || !value.is_finite() {
                continue;
            }
            if !self.both_signs && self.is_remnant(time_ns, press, value.abs()) {
                self.remnants.push(*press);
                continue;
            }
            let away = |contact: &&Contact| distance(contact.centroid_m, press.position_m);
            let nearest = self.of_image.iter().min_by(|a, b| away(a).total_cmp(&away(b))).copied();
            let area_m2 = nearest.map_or(std::f64::consts::PI * press.radius_m.powi(2), |contact| contact.area_m2);
            let c = &press.covariance;
            let is_far = |contact: &Contact| distance(contact.centroid_m, press.position_m) > self.far_m;
            if estimate.unexplained > self.explained
                && let Some(contact) = nearest.filter(is_far)
            {
                contacts.push(contact);
                continue;
            }
            contacts.push(Contact {
                covariance_m2: [[c[0][0], c[0][1]], [c[1][0], c[1][1]]],
                significance: *sigma,
                radius_m: Some(press.radius_m),
                force: self.law.and_then(|law| law.read(press, self.polarity)).map(from_law),
                model_variance_m2: self.error.map_or(0.0, |error| error.variance_m2(press, estimate.unexplained)),
                is_single: true,
                ..Contact::even(press.position_m, value, area_m2)
            });
            self.shown.push(*press);
        }
        contacts.sort_unstable_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
    }

    /// The image's peak by a press alone, whose response is in `volts`.
    fn image_value(&mut self, imager: &Imager, position_m: [f64; 2]) -> f64 {
        imager.fill_in_left_out(&mut self.volts);
        let reach = (self.typical_radius_m / self.grid.pixel_m).ceil().max(1.0) as isize;
        let Some(middle) = self.grid.pixel_at(position_m) else { return 0.0 };
        let (row, column) = ((middle / self.grid.columns) as isize, (middle % self.grid.columns) as isize);
        let mut most: f64 = 0.0;
        for r in row - reach..=row + reach {
            for c in column - reach..=column + reach {
                let on_grid = r >= 0 && c >= 0 && (r as usize) < self.grid.rows && (c as usize) < self.grid.columns;
                let Some(unknown) =
                    on_grid.then(|| self.unknowns[r as usize * self.grid.columns + c as usize]).flatten()
                else {
                    continue;
                };
                let value = imager.value_at(unknown as usize, &self.volts);
                if value.abs() > most.abs() {
                    most = value;
                }
            }
        }
        most
    }
}

/// What the model of presses is known to leave of a frame.
fn error_share(prepared: &Prepared, model: &SpotModel) -> f64 {
    let layer = &prepared.skin.frontend.layer;
    match layer {
        Layer::Patches(_) => PATCHES_ERROR,
        _ if layer.is_open_tank() => TANK_ERROR,
        _ if model.looks_beyond_proportion() => SPOTS_ERROR,
        _ => IN_PROPORTION_ERROR,
    }
}

fn from_law((force_n, sigma_n): (f64, f64)) -> ForceReading {
    ForceReading::FromLaw { force_n, sigma_n }
}

fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// The tabulated responses to spots at these channel deviations (volts).
///
/// # Errors
/// Deviations none of which is positive; a membrane that cannot be solved.
pub fn spot_model(prepared: &Prepared, deviations: &[f64]) -> Result<SpotModel, Error> {
    let polarity = prepared.skin.imaging.polarity.sign();
    let jacobian = prepared.jacobian.as_mat();
    let pressed = Mat::from_fn(jacobian.nrows(), jacobian.ncols(), |c, p| polarity * jacobian[(c, p)]);
    let uniform: Vec<f64> = jacobian.row_iter().map(|row| row.iter().sum()).collect();
    let spread = match &prepared.skin.frontend.layer {
        Layer::Liquid(layer) if layer.tension_n_per_m > 0.0 => Some(membrane(prepared, layer)?.0),
        _ => None,
    };
    let response = spread.as_ref().map(|spread| &pressed * spread);
    let positions: Vec<[f64; 2]> = prepared.basis.positions.iter().map(|p| [p[0], p[1]]).collect();
    let (half_width, pixel_m) = (prepared.half_width_m(), prepared.map.grid().pixel_m);
    let options = SpotOptions {
        smallest_radius_m: SMALLEST_RADIUS * half_width,
        largest_radius_m: LARGEST_RADIUS * half_width,
        typical_radius_m: TYPICAL_RADIUS * half_width,
        most_spots: MOST_SPOTS,
    };
    let response = response.as_ref().unwrap_or(&pressed);
    let model = SpotModel::new(response.as_ref(), &uniform, deviations, &positions, pixel_m, options)?;
    // Usual presses take a third of a layer away and more.
    let layer = &prepared.skin.frontend.layer;
    let is_continuous = matches!(layer, Layer::Liquid(_) | Layer::Sheet(_)) && !layer.is_open_tank();
    if is_continuous && may_look_beyond(prepared) {
        let response = change_response(prepared)?;
        let spread = spread.as_ref().map(|spread| spread.as_ref());
        return Ok(model.with_large_changes(response, pressed.as_ref(), spread, &positions, polarity)?);
    }
    Ok(model)
}

/// Whether there is time to look beyond proportion, and a model of the channels as they are.
fn may_look_beyond(prepared: &Prepared) -> bool {
    let backend = &prepared.skin.backend;
    backend.circuit.is_none() && backend.frame_rate_hz() <= MOST_FRAMES_PER_S
}

/// What the model's own voltages change by where the conductance of each pixel changes by these shares.
fn change_response(prepared: &Prepared) -> Result<Arc<ChangeResponse>, Error> {
    let model = ForwardModel::new(prepared.body.mesh.clone(), prepared.protocol.clone())?;
    let (map, conductance_s) = (prepared.map.clone(), prepared.skin.sheet_conductance_s());
    let rest = prepared.voltages.clone();
    Ok(Arc::new(move |changes: &[f64]| {
        let mut conductances = map.to_elements(changes).ok()?;
        conductances.iter_mut().for_each(|value| *value = conductance_s * (1.0 + *value));
        let mut differences = model.voltages(&conductances).ok()?;
        differences.iter_mut().zip(&rest).for_each(|(value, rest)| *value -= rest);
        Some(differences)
    }))
}

/// See [`membrane`].
pub(crate) fn membrane_spread(prepared: &Prepared, layer: &LiquidLayer) -> Result<Mat<f64>, Error> {
    Ok(membrane(prepared, layer)?.0)
}

/// The pressure of a load of amplitude 1 on the skin's membrane, pascal; none without one.
///
/// # Errors
/// A membrane that cannot be solved.
pub(crate) fn membrane_pressure_pa(prepared: &Prepared) -> Result<Option<f64>, Error> {
    match &prepared.skin.frontend.layer {
        Layer::Liquid(layer) if layer.tension_n_per_m > 0.0 => Ok(Some(membrane(prepared, layer)?.1)),
        _ => Ok(None),
    }
}

/// As [`spot_model`], before any noise was measured.
pub(crate) fn assumed_spot_model(prepared: &Prepared) -> Result<SpotModel, Error> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    spot_model(prepared, &vec![prepared.skin.touch.assumed_noise_share * largest; prepared.channels()])
}

/// What a load on one pixel (columns) does to the depth of a liquid under a closed membrane in all (rows), in units in
/// which a typical spot in the middle makes 1 there: `T lap w = -p + c - rho gz w`, `w = 0` at the rim, no volume lost.
/// The liquid's weight narrows a dent beyond `sqrt(T / rho |gz|)`, 78 mm of water under 60 N/m; the depth only scales
/// it.
/// The pressure of a load of amplitude 1 (pascal) beside it.
fn membrane(prepared: &Prepared, layer: &LiquidLayer) -> Result<(Mat<f64>, f64), Error> {
    let mesh = &prepared.body.mesh.mesh;
    // Gravity along the skin changes how it rests, not how it answers.
    let spec = MembraneSpec {
        tension_n_per_m: layer.tension_n_per_m,
        density_kg_per_m3: layer.density_kg_per_m3,
        gravity_m_per_s2: [0.0, 0.0, layer.gravity_m_per_s2[2]],
    };
    // One that would be too slack for what hangs beneath it holds it somehow: only its shape is asked for.
    let weightless = MembraneSpec { density_kg_per_m3: 0.0, ..spec };
    let mut membrane = Membrane::new(mesh, spec).or_else(|_| Membrane::new(mesh, weightless))?;
    let pixels = prepared.map.inside_count();
    let mut loads = vec![vec![0.0; mesh.nodes().len()]; pixels];
    for (element, nodes) in mesh.elements().enumerate() {
        for (pixel, share) in prepared.map.overlaps_of_element(element) {
            let force = share * mesh.measures()[element] / nodes.len() as f64;
            nodes.iter().for_each(|&node| loads[pixel][node as usize] += force);
        }
    }
    let mut spread = Mat::zeros(pixels, pixels);
    for (column, load) in loads.iter().enumerate() {
        membrane.deflect(load);
        let at = membrane.deflection_m();
        let per_element: Vec<f64> = mesh
            .elements()
            .map(|nodes| nodes.iter().map(|&node| at[node as usize]).sum::<f64>() / nodes.len() as f64)
            .collect();
        let named = |source| Error::Mesh { skin: prepared.skin.name.clone(), source };
        for (row, value) in prepared.map.to_inside(&per_element).map_err(named)?.into_iter().enumerate() {
            spread[(row, column)] = value;
        }
    }
    let radius = TYPICAL_RADIUS * prepared.half_width_m();
    let centre = |p: &[f64; 3]| (-(p[0] * p[0] + p[1] * p[1]) / (2.0 * radius * radius)).exp();
    let middle: Vec<f64> = prepared.basis.positions.iter().map(centre).collect();
    let shape = &spread * faer::ColRef::from_slice(&middle);
    let largest = shape.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
    Ok((faer::Scale(1.0 / largest) * spread, 1e-3 * layer.depth_mm / largest))
}
