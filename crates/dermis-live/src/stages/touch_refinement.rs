//! Touches of the live pipeline refined by the forward model: each contact of the image becomes the start of a spot,
//! all spots of a frame are fitted together, and the contact gets the spot's place and covariance. Where the frame
//! holds more than one spot for each contact can explain, two touches may stand so near that the image shows one; they
//! are then told apart by a fit of two.

use std::sync::Arc;

use dermis_skin::{Layer, LiquidLayer};
use dermis_tomo::eit::ForwardModel;
use dermis_tomo::inverse::{ChangeResponse, FitOutcome, FitScratch, Spot, SpotModel, SpotOptions};
use dermis_tomo::membrane::{Membrane, MembraneSpec};
use dermis_tomo::mesh::PixelGrid;
use dermis_touch::{Contact, ContactSign, ContactStrength};
use faer::Mat;

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::model_error::SpotError;

/// Contacts refined at most, the strongest.
const MOST_SPOTS: usize = 8;
/// Largest radius of a spot, relative to half the shorter side.
const LARGEST_RADIUS: f64 = 0.6;
/// Typical radius.
const TYPICAL_RADIUS: f64 = 0.12;
/// Smallest radius.
const SMALLEST_RADIUS: f64 = 0.05;
/// A fit that puts a touch farther than this from where the image has it, relative to half the shorter side, is
/// believed only where it explains the frame.
const FAR: f64 = 0.2;
/// It is not believed beyond this in any case.
const FARTHEST: f64 = 0.5;
/// A fit explains a frame of which it leaves no more than this share of the whitened energy.
const EXPLAINED: f64 = 0.05;
/// A fit that is less certain of the place than this, by the same measure, is not believed either.
const LEAST_CERTAIN: f64 = 0.1;
/// Of two touches in place of one, which explain what one does not, less is asked: where, they may be less certain.
const LEAST_CERTAIN_OF_TWO: f64 = 0.2;
/// A frame of which a fit leaves more than so many times the noise's energy may hold two touches that the image shows
/// as one.
const UNEXPLAINED_BY_NOISE: f64 = 2.0;
/// Spots nearer to each other than this share of half the shorter side are one, as contacts of an image are.
const MEETING: f64 = 0.1;
/// Two touches have radii within this factor: a wider spot makes up for what one spot cannot explain.
const MOST_UNLIKE_RADII: f64 = 3.0;
/// A spot below this share of the strongest (amplitude times area) is a lobe of the image, where the fit explains the
/// frame.
const LOBE: f64 = 0.2;
/// Two touches in place of one are believed where they leave, beyond the noise, no more than this share of what one
/// left, and as [`PartingRule`] says.
const LEFT_BY_TWO: f64 = 0.3;
/// Beyond proportion spots are fitted where frames are no more frequent: a fit takes 2 ms with 16 electrodes, 13 with
/// 32 and three touches.
const MOST_FRAMES_PER_S: f64 = 60.0;
/// Where spots beyond proportion are to be fitted, two in proportion must leave no more than this share of what one
/// did.
const WORTH_A_LOOK: f64 = 0.7;
/// Directions in which two touches are looked for from where the image has one, and how far from it, relative to half
/// the shorter side.
const DIRECTIONS: usize = 4;
const LOOKED_FOR_AT: f64 = 0.3;
/// A start off the skin is drawn back towards the contact by this factor, so many times at most.
const DRAWN_BACK: f64 = 0.6;
const MOST_DRAWN_BACK: usize = 4;
/// Contacts that are looked at so in a frame, the strongest, and frames before the next look after one in vain.
const MOST_JOINED: usize = 3;
const FRAMES_TO_NEXT_LOOK: u32 = 8;

/// When two touches are looked for in place of one, and what makes them two beside [`LEFT_BY_TWO`].
#[derive(Clone, Copy, Debug)]
struct PartingRule {
    /// One spot for each contact leaves more than this share of the frame's energy beyond the noise.
    unexplained: f64,
    /// The two stand apart by this share of half the shorter side and by so many times the sum of their radii,
    least_apart: f64,
    least_apart_radii: f64,
    /// and press alike within this factor (amplitude times area).
    most_unlike: f64,
}

/// Where touches are smooth spots, one leaves up to 0.0019 beyond the noise (twins of gels and liquids, 40 presses
/// each), two a quarter of the longer side apart that the image joins 0.0038 or more.
const SMOOTH: PartingRule =
    PartingRule { unexplained: 0.003, least_apart: 0.3, least_apart_radii: 1.0, most_unlike: 10.0 };
/// A patch that conducts as a whole is no spot: one touch leaves 0.007 to 0.07, two that are joined 0.02 to 0.3 (twins
/// of discs of 64 patches), and only what two spots come to tells them apart.
const PATCHES: PartingRule =
    PartingRule { unexplained: 0.015, least_apart: 0.36, least_apart_radii: 1.2, most_unlike: 4.0 };

/// Refines the contacts of one frame after the other, in memory of its own.
#[derive(Debug)]
pub(crate) struct SpotStage {
    model: SpotModel,
    scratch: FitScratch,
    starts_m: Vec<[f64; 2]>,
    /// The spots that contacts are given.
    spots: Vec<Spot>,
    /// Starts and spots of an attempt to part a contact.
    tried_m: Vec<[f64; 2]>,
    parted: Vec<Spot>,
    /// Where the two touches of a parted contact were in the last frame.
    last_parted_m: Option<[[f64; 2]; 2]>,
    /// Frames before the next attempt; none where frames wait for as much work as they take.
    wait: u32,
    is_unhurried: bool,
    /// Where touches are smooth spots; a patch that conducts as a whole is none.
    error: Option<SpotError>,
    /// The largest share of a frame that a fit may leave beyond the noise.
    most_unexplained: f64,
    /// The contacts as the image has them.
    seen: Vec<Contact>,
    grid: PixelGrid,
    inside: Vec<bool>,
    half_width_m: f64,
}

impl SpotStage {
    /// With responses of the prepared skin.
    pub(crate) fn new(prepared: &Prepared, model: SpotModel) -> Self {
        Self {
            scratch: model.scratch(),
            starts_m: Vec::with_capacity(MOST_SPOTS),
            spots: Vec::with_capacity(MOST_SPOTS),
            tried_m: Vec::with_capacity(MOST_SPOTS),
            parted: Vec::with_capacity(MOST_SPOTS),
            last_parted_m: None,
            wait: 0,
            is_unhurried: false,
            error: SpotError::of(prepared),
            most_unexplained: prepared.skin.touch.most_unexplained,
            seen: Vec::with_capacity(MOST_SPOTS),
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
            half_width_m: prepared.half_width_m(),
            model,
        }
    }

    /// Gives the strongest contacts, all of which are fitted together, the places of their spots. Contacts whose spot
    /// is not believed, and all of a frame that cannot be fitted, or of which the fit leaves more than
    /// `touch.most_unexplained`, stay as the image has them. A contact that two spots explain and one does not becomes
    /// two. Allocates nothing once `contacts` has grown to size, unless dents are deep.
    pub(crate) fn refine(&mut self, difference: &[f64], contacts: &mut Vec<Contact>) {
        self.seen.clear();
        self.seen.extend_from_slice(contacts);
        if !self.place(difference, contacts).is_some_and(|left| left <= self.most_unexplained) {
            contacts.clear();
            contacts.extend_from_slice(&self.seen);
        } else if self.most_unexplained < 1.0 {
            self.drop_lobes(contacts);
        }
        contacts.sort_unstable_by(|a, b| b.amplitude.total_cmp(&a.amplitude));
    }

    /// Removes what the image shows beside the touches that explain the frame: contacts whose spots have the other
    /// sign, are far weaker than the strongest, or were not needed to explain it. Where a touch begins, the strongest
    /// does.
    fn drop_lobes(&self, contacts: &mut Vec<Contact>) {
        let press_of = |contact: &Contact, spot: &Spot| match contact.sign.factor() * spot.amplitude > 0.0 {
            true => press(spot),
            false => 0.0,
        };
        let presses = contacts.iter().zip(&self.spots).map(|(contact, spot)| press_of(contact, spot));
        let Some((strongest, most)) = presses.enumerate().max_by(|a, b| a.1.total_cmp(&b.1)) else { return };
        if most == 0.0 {
            return;
        }
        if contacts.iter().any(|contact| contact.strength == ContactStrength::Strong) {
            contacts[strongest].strength = ContactStrength::Strong;
        }
        let mut spots = self.spots.iter();
        contacts.retain(|contact| spots.next().is_some_and(|spot| press_of(contact, spot) >= LOBE * most));
    }

    /// As [`SpotStage::refine`]. The share of the frame that the fit leaves beyond the noise; `None` where the frame
    /// cannot be fitted.
    fn place(&mut self, difference: &[f64], contacts: &mut Vec<Contact>) -> Option<f64> {
        let count = contacts.len().min(MOST_SPOTS);
        self.starts_m.clear();
        self.starts_m.extend(contacts[..count].iter().map(|contact| contact.centroid_m));
        // A frame that is not all finite numbers, or a contact at the very rim: nothing to fit.
        let mut outcome = self.model.fit(difference, &self.starts_m, &mut self.scratch).ok()?;
        while let Some(weaker) = self.meeting() {
            contacts.remove(weaker);
            self.starts_m.remove(weaker);
            outcome = self.model.fit(difference, &self.starts_m, &mut self.scratch).ok()?;
        }
        self.spots.clear();
        self.spots.extend_from_slice(self.scratch.spots());
        let parted = self.part(difference, contacts, &outcome);
        let is_parted = parted.is_some();
        if let Some((joined, better)) = parted {
            outcome = better;
            std::mem::swap(&mut self.spots, &mut self.parted);
            let two = [self.spots[joined], self.spots[joined + 1]];
            self.last_parted_m = Some(two.map(|spot| spot.position_m));
            contacts.insert(joined + 1, contacts[joined]);
            self.starts_m.insert(joined + 1, two[1].position_m);
            self.starts_m[joined] = two[0].position_m;
            let largest = press(&two[0]).max(press(&two[1]));
            for (contact, spot) in contacts[joined..joined + 2].iter_mut().zip(two) {
                *contact = contact.share_at(spot.position_m, press(&spot) / largest);
            }
        }
        let explained = outcome.residual <= EXPLAINED * outcome.energy;
        let leaves_another = self.leaves_another(&outcome);
        let certain = if is_parted { LEAST_CERTAIN_OF_TWO } else { LEAST_CERTAIN };
        for (k, (contact, spot)) in contacts.iter_mut().zip(&self.spots).enumerate() {
            if self.is_believed(spot, contact.sign, certain) && self.is_near(k, spot.position_m, explained) {
                let c = &spot.covariance;
                contact.centroid_m = spot.position_m;
                contact.covariance_m2 = [[c[0][0], c[0][1]], [c[1][0], c[1][1]]];
                contact.radius_m = Some(spot.radius_m);
                contact.is_single = !leaves_another;
                let error = self.error;
                contact.model_variance_m2 =
                    error.map_or(0.0, |error| error.variance_m2(spot, &outcome, leaves_another));
            }
        }
        // What is left of a weak frame is noise, whose energy is known to so much.
        let unexplained = if outcome.residual > UNEXPLAINED_BY_NOISE { beyond_noise(&outcome) } else { 0.0 };
        Some((unexplained / outcome.energy).min(1.0))
    }

    /// The weaker of two contacts whose spots have met in one place: lobes of one touch in the image.
    fn meeting(&self) -> Option<usize> {
        let spots = self.scratch.spots();
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < MEETING * self.half_width_m;
        let met = |k: &usize| spots[..*k].iter().any(|spot| near(spot.position_m, spots[*k].position_m));
        if self.error.is_some() { (1..spots.len()).find(met) } else { None }
    }

    fn rule(&self) -> PartingRule {
        if self.error.is_some() { SMOOTH } else { PATCHES }
    }

    /// Whether a fit leaves so much that there may be one touch more.
    fn leaves_another(&self, outcome: &FitOutcome) -> bool {
        outcome.residual > UNEXPLAINED_BY_NOISE && beyond_noise(outcome) > self.rule().unexplained * outcome.energy
    }

    /// From now on each frame is looked at for touches that the image shows as one.
    pub(crate) fn take_time(&mut self) {
        self.is_unhurried = true;
    }

    /// The next frame has nothing to do with the last.
    pub(crate) fn forget(&mut self) {
        (self.last_parted_m, self.wait) = (None, 0);
    }

    /// Which contact is two touches, and the fit that says so, whose spots are then in `parted`: a frame that one spot
    /// for each contact leaves unexplained is fitted with one more, from several starts about each of the strongest
    /// contacts.
    fn part(&mut self, difference: &[f64], contacts: &[Contact], single: &FitOutcome) -> Option<(usize, FitOutcome)> {
        let last = self.last_parted_m.take();
        if !self.leaves_another(single) || self.starts_m.len() >= MOST_SPOTS {
            self.wait = 0;
            return None;
        }
        if let Some(last) = last {
            let middle = [0, 1].map(|axis| 0.5 * (last[0][axis] + last[1][axis]));
            let away = |start: &[f64; 2]| (start[0] - middle[0]).hypot(start[1] - middle[1]);
            let nearest = self.starts_m.iter().enumerate().min_by(|a, b| away(a.1).total_cmp(&away(b.1)));
            let joined = nearest.map_or(0, |(k, _)| k);
            if let Some(outcome) = self.try_two(difference, (joined, contacts[joined].sign), last, single) {
                return Some((joined, outcome));
            }
        }
        if self.wait > 0 {
            self.wait -= 1;
            return None;
        }
        for joined in 0..self.starts_m.len().min(MOST_JOINED) {
            let [x, y] = self.starts_m[joined];
            for direction in 0..DIRECTIONS {
                let angle = std::f64::consts::PI * direction as f64 / DIRECTIONS as f64;
                let reach = LOOKED_FOR_AT * self.half_width_m;
                let [dx, dy] = [reach * angle.cos(), reach * angle.sin()];
                let two = [[dx, dy], [-dx, -dy]].map(|offset| self.drawn_back([x, y], offset));
                if let Some(outcome) = self.try_two(difference, (joined, contacts[joined].sign), two, single) {
                    return Some((joined, outcome));
                }
            }
        }
        self.wait = if self.is_unhurried { 0 } else { FRAMES_TO_NEXT_LOOK };
        None
    }

    /// A fit with two spots in place of one of this sign, where it is believed.
    fn try_two(
        &mut self,
        difference: &[f64],
        (joined, sign): (usize, ContactSign),
        two_m: [[f64; 2]; 2],
        single: &FitOutcome,
    ) -> Option<FitOutcome> {
        self.tried_m.clear();
        self.tried_m.extend_from_slice(&self.starts_m[..joined]);
        self.tried_m.extend_from_slice(&two_m);
        self.tried_m.extend_from_slice(&self.starts_m[joined + 1..]);
        // A start off the skin: nothing to fit from there.
        let outcome = self.model.fit_in_proportion(difference, &self.tried_m, &mut self.scratch).ok()?;
        // Each look beyond proportion is a forward solution.
        if above_one(outcome.in_proportion) > WORTH_A_LOOK * above_one(single.in_proportion) {
            return None;
        }
        let outcome = self.model.go_beyond_proportion(outcome, &mut self.scratch).ok()?;
        let spots = self.scratch.spots();
        let (a, b) = (&spots[joined], &spots[joined + 1]);
        let apart_m = (a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]);
        let rule = self.rule();
        let within = |factor: f64, [a, b]: [f64; 2]| a < factor * b && b < factor * a;
        let alike =
            within(rule.most_unlike, [press(a), press(b)]) && within(MOST_UNLIKE_RADII, [a.radius_m, b.radius_m]);
        let certain = if self.leaves_another(&outcome) { LEAST_CERTAIN } else { LEAST_CERTAIN_OF_TWO };
        let is_better = beyond_noise(&outcome) <= LEFT_BY_TWO * beyond_noise(single);
        let are_two = apart_m >= rule.least_apart * self.half_width_m
            && apart_m >= rule.least_apart_radii * (a.radius_m + b.radius_m);
        if !(is_better && are_two && alike && [a, b].iter().all(|spot| self.is_believed(spot, sign, certain))) {
            return None;
        }
        self.parted.clear();
        self.parted.extend_from_slice(spots);
        Some(outcome)
    }

    /// A place that far from a contact, or nearer to it where that is off the skin.
    fn drawn_back(&self, [x, y]: [f64; 2], [mut dx, mut dy]: [f64; 2]) -> [f64; 2] {
        for _ in 0..MOST_DRAWN_BACK {
            if self.is_inside([x + dx, y + dy]) {
                break;
            }
            (dx, dy) = (DRAWN_BACK * dx, DRAWN_BACK * dy);
        }
        [x + dx, y + dy]
    }

    fn is_inside(&self, position_m: [f64; 2]) -> bool {
        self.grid.pixel_at(position_m).is_some_and(|pixel| self.inside[pixel])
    }

    fn is_believed(&self, spot: &Spot, sign: ContactSign, least_certain: f64) -> bool {
        let variance = spot.covariance[0][0] + spot.covariance[1][1];
        sign.factor() * spot.amplitude > 0.0
            && variance.sqrt() <= least_certain * self.half_width_m
            && self.is_inside(spot.position_m)
    }

    /// Whether a spot is where the image has its contact. Channels that are left out draw the image's peak to one side:
    /// a fit that explains the frame then knows better, as long as the spot is not where the image has another contact.
    fn is_near(&self, contact: usize, [x, y]: [f64; 2], explained: bool) -> bool {
        let moved = |[from_x, from_y]: [f64; 2]| (x - from_x).hypot(y - from_y);
        let own = moved(self.starts_m[contact]);
        let allowed = if explained { FARTHEST } else { FAR };
        own <= FAR * self.half_width_m
            || own <= allowed * self.half_width_m && self.starts_m.iter().all(|start| own <= moved(*start))
    }
}

/// What an image that is wider than the spot shows of it: magnitude times area, up to a factor. Radius and amplitude
/// alone trade with each other.
fn press(spot: &Spot) -> f64 {
    spot.amplitude.abs() * spot.radius_m * spot.radius_m
}

/// Whitened energy that a fit leaves beyond the noise's own.
fn beyond_noise(outcome: &FitOutcome) -> f64 {
    above_one(outcome.residual)
}

fn above_one(residual: f64) -> f64 {
    (residual - 1.0).max(0.0)
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
        Layer::Liquid(layer) if layer.tension_n_per_m > 0.0 => Some(membrane(prepared, layer)?),
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
    // A membrane's dents take a third of the liquid away and more.
    match &spread {
        Some(spread) if may_look_beyond(prepared) => {
            let spread = Some(spread.as_ref());
            let response = change_response(prepared)?;
            Ok(model.with_large_changes(response, pressed.as_ref(), spread, &positions, polarity)?)
        }
        _ => Ok(model),
    }
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

/// As [`spot_model`], before any noise was measured.
pub(crate) fn assumed_spot_model(prepared: &Prepared) -> Result<SpotModel, Error> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    spot_model(prepared, &vec![prepared.skin.touch.assumed_noise_share * largest; prepared.channels()])
}

/// What a load on one pixel (columns) does to the depth of a liquid under a closed membrane in all (rows), in units in
/// which a typical spot in the middle makes 1 there: `T lap w = -p + c - rho gz w`, `w = 0` at the rim, no volume lost.
/// The liquid's weight narrows a dent beyond `sqrt(T / rho |gz|)`, 78 mm of water under 60 N/m; the depth only scales
/// it.
fn membrane(prepared: &Prepared, layer: &LiquidLayer) -> Result<Mat<f64>, Error> {
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
    Ok(faer::Scale(1.0 / largest) * spread)
}
