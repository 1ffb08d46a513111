//! Touches of the live pipeline refined by the forward model: each contact of the image becomes the start of a spot, all
//! spots of a frame are fitted together, and the contact gets the spot's place and covariance.

use dermis_skin::Layer;
use dermis_tomo::inverse::{FitScratch, Spot, SpotModel, SpotOptions};
use dermis_tomo::membrane::{Membrane, MembraneSpec};
use dermis_tomo::mesh::PixelGrid;
use dermis_touch::Contact;
use faer::Mat;

use crate::Error;
use crate::prepare::Prepared;

/// Contacts refined at most, the strongest.
const MOST_SPOTS: usize = 8;
/// Largest radius of a spot, relative to half the shorter side.
const LARGEST_RADIUS: f64 = 0.6;
/// Typical radius.
const TYPICAL_RADIUS: f64 = 0.12;
/// Smallest radius.
const SMALLEST_RADIUS: f64 = 0.05;
/// A fit that puts a touch farther than this from where the image has it, relative to half the shorter side, is believed only
/// where it explains the frame.
const FAR: f64 = 0.2;
/// It is not believed beyond this in any case.
const FARTHEST: f64 = 0.5;
/// A fit explains a frame of which it leaves no more than this share of the whitened energy.
const EXPLAINED: f64 = 0.05;
/// A fit that is less certain of the place than this, by the same measure, is not believed either.
const LEAST_CERTAIN: f64 = 0.1;

/// Refines the contacts of one frame after the other, in memory of its own.
#[derive(Debug)]
pub(crate) struct SpotStage {
    model: SpotModel,
    scratch: FitScratch,
    starts_m: Vec<[f64; 2]>,
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
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
            half_width_m: prepared.half_width_m(),
            model,
        }
    }

    /// Gives the strongest contacts, all of which are fitted together, the places of their spots. Contacts whose spot is not
    /// believed, and all of a frame that cannot be fitted, stay as the image has them. Allocates nothing.
    pub(crate) fn refine(&mut self, difference: &[f64], contacts: &mut [Contact]) {
        let count = contacts.len().min(MOST_SPOTS);
        self.starts_m.clear();
        self.starts_m.extend(contacts[..count].iter().map(|contact| contact.centroid_m));
        // A frame that is not all finite numbers, or a contact at the very rim: nothing to fit.
        let Ok(outcome) = self.model.fit(difference, &self.starts_m, &mut self.scratch) else { return };
        let explained = outcome.residual <= EXPLAINED * outcome.energy;
        for ((k, contact), spot) in contacts.iter_mut().enumerate().zip(self.scratch.spots()) {
            if self.is_believed(spot) && self.is_near(k, spot.position_m, explained) {
                let c = &spot.covariance;
                contact.centroid_m = spot.position_m;
                contact.covariance_m2 = [[c[0][0], c[0][1]], [c[1][0], c[1][1]]];
                contact.radius_m = Some(spot.radius_m);
            }
        }
    }

    fn is_believed(&self, spot: &Spot) -> bool {
        let variance = spot.covariance[0][0] + spot.covariance[1][1];
        spot.amplitude > 0.0
            && variance.sqrt() <= LEAST_CERTAIN * self.half_width_m
            && self.grid.pixel_at(spot.position_m).is_some_and(|pixel| self.inside[pixel])
    }

    /// Whether a spot is where the image has its contact. Channels that are left out draw the image's peak to one side: a fit
    /// that explains the frame then knows better, as long as the spot is not where the image has another contact.
    fn is_near(&self, contact: usize, [x, y]: [f64; 2], explained: bool) -> bool {
        let moved = |[from_x, from_y]: [f64; 2]| (x - from_x).hypot(y - from_y);
        let own = moved(self.starts_m[contact]);
        let allowed = if explained { FARTHEST } else { FAR };
        own <= FAR * self.half_width_m
            || own <= allowed * self.half_width_m && self.starts_m.iter().all(|start| own <= moved(*start))
    }
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
    let layer = &prepared.skin.frontend.layer;
    let closed = matches!(layer, Layer::Liquid(_)) && !layer.is_open_tank();
    let response = if closed { &pressed * membrane(prepared)? } else { pressed };
    let positions: Vec<[f64; 2]> = prepared.basis.positions.iter().map(|p| [p[0], p[1]]).collect();
    let (half_width, pixel_m) = (prepared.half_width_m(), prepared.map.grid().pixel_m);
    let options = SpotOptions {
        smallest_radius_m: SMALLEST_RADIUS * half_width,
        largest_radius_m: LARGEST_RADIUS * half_width,
        typical_radius_m: TYPICAL_RADIUS * half_width,
        most_spots: MOST_SPOTS,
    };
    Ok(SpotModel::new(response.as_ref(), &uniform, deviations, &positions, pixel_m, options)?)
}

/// As [`spot_model`], before any noise was measured.
pub(crate) fn assumed_spot_model(prepared: &Prepared) -> Result<SpotModel, Error> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    spot_model(prepared, &vec![prepared.skin.touch.assumed_noise_share * largest; prepared.channels()])
}

/// What a load on one pixel (columns) does to the depth of a liquid under a closed membrane in all (rows), in units in
/// which a typical spot in the middle makes 1 there: `lap w = -p + c`, `w = 0` at the rim, no volume lost. Tension and
/// depth only scale it.
fn membrane(prepared: &Prepared) -> Result<Mat<f64>, Error> {
    let mesh = &prepared.body.mesh.mesh;
    let spec = MembraneSpec { tension_n_per_m: 1.0, density_kg_per_m3: 0.0, gravity_m_per_s2: [0.0; 3] };
    let mut membrane = Membrane::new(mesh, spec)?;
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
