//! The responses to spots that presses on sheets, separate patches and liquids are fitted with.

use dermis_skin::Layer;
use dermis_tomo::eit::ForwardModel;
use dermis_tomo::inverse::{ChangeResponse, SpotModel, SpotOptions};
use dermis_tomo::membrane::{Membrane as ThinMembrane, MembraneSpec};
use dermis_tomo::mesh::{Mesh, Point};
use faer::Mat;
use rayon::prelude::*;

use crate::Error;
use crate::beside::in_parallel;
use crate::prepare::Prepared;

/// Largest number of presses fitted to one frame.
pub(super) const MOST_SPOTS: usize = 8;
/// Largest radius of a spot, relative to half the shorter side.
pub(super) const LARGEST_RADIUS: f64 = 0.6;
/// Typical radius, relative to half the shorter side.
pub(crate) const TYPICAL_RADIUS: f64 = 0.12;
/// Smallest radius, relative to half the shorter side.
pub(super) const SMALLEST_RADIUS: f64 = 0.05;
/// Large changes are solved on half the elements, but on this many at least, if the skin has them.
const LEAST_BEYOND: usize = 1000;

/// The tabulated responses to spots for these channel deviations (volts).
///
/// # Errors
/// No positive deviation; a membrane that cannot be solved.
pub fn spot_model(prepared: &Prepared, deviations: &[f64]) -> Result<SpotModel, Error> {
    spot_model_under(prepared, deviations, Membrane::of(prepared)?.as_ref())
}

/// Like [`spot_model`], under this membrane.
///
/// # Errors
/// No positive deviation.
pub(crate) fn spot_model_under(
    prepared: &Prepared,
    deviations: &[f64],
    membrane: Option<&Membrane>,
) -> Result<SpotModel, Error> {
    let polarity = prepared.skin.imaging.polarity.sign();
    let jacobian = prepared.jacobian.as_mat();
    let pressed = Mat::from_fn(jacobian.nrows(), jacobian.ncols(), |c, p| polarity * jacobian[(c, p)]);
    let uniform = response_to_uniform(prepared);
    let response = membrane.map(|membrane| membrane.response(prepared)).transpose()?;
    let positions: Vec<Point> = prepared.basis.positions.iter().map(|p| [p[0], p[1]]).collect();
    let (half_width, pixel_m) = (prepared.half_width_m(), prepared.map.grid().pixel_m);
    let options = SpotOptions {
        smallest_radius_m: SMALLEST_RADIUS * half_width,
        largest_radius_m: LARGEST_RADIUS * half_width,
        typical_radius_m: TYPICAL_RADIUS * half_width,
        smoothing_m: smoothing_m(&prepared.skin.frontend.layer),
        most_spots: MOST_SPOTS,
    };
    let response = response.as_ref().unwrap_or(&pressed);
    let model = SpotModel::new(response.as_ref(), &uniform, deviations, &positions, pixel_m, options)?;
    // Usual presses remove a third of the layer or more, so a linear model isn't enough.
    let layer = &prepared.skin.frontend.layer;
    let is_continuous = matches!(layer, Layer::Liquid(_) | Layer::Sheet(_)) && !layer.is_open_tank();
    if is_continuous && may_look_beyond(prepared) {
        let (response, jacobian) = response_beyond(prepared)?;
        let spread = membrane.map(|membrane| membrane.spread.as_ref());
        return Ok(model.with_large_changes(response, jacobian.as_ref(), spread, &positions, polarity)?);
    }
    Ok(model)
}

/// Standard deviation by which the sheet smooths the edges of loads, metres. On other layers, spots are Gaussian: a
/// membrane spreads loads itself, and a patch conducts as a whole.
pub(crate) fn smoothing_m(layer: &Layer) -> Option<f64> {
    let Layer::Sheet(layer) = layer else { return None };
    Some(1e-3 * layer.spread_mm())
}

/// The response to large changes and its linear part: channels by pixels, in volts per relative change in the direction
/// of presses. Fits only use the difference of the two. It is small, so a coarser mesh suffices.
fn response_beyond(prepared: &Prepared) -> Result<(ChangeResponse, Mat<f64>), Error> {
    let elements = prepared.skin.imaging.elements;
    let coarse = prepared.with_elements((elements / 2).max(LEAST_BEYOND).min(elements))?;
    let pixels = prepared.map.inside_pixels();
    // At the rim, the two meshes may cover other pixels.
    let nearest: Vec<usize> = (coarse.map.inside_pixels().iter().zip(&coarse.basis.positions))
        .map(|(pixel, at)| {
            let square = |k: &usize| {
                let place = prepared.basis.positions[*k];
                (place[0] - at[0]).powi(2) + (place[1] - at[1]).powi(2)
            };
            let by_distance = |a: &usize, b: &usize| square(a).total_cmp(&square(b));
            pixels.binary_search(pixel).unwrap_or_else(|_| (0..pixels.len()).min_by(by_distance).unwrap_or(0))
        })
        .collect();
    let polarity = prepared.skin.imaging.polarity.sign();
    let mut jacobian = Mat::zeros(prepared.channels(), pixels.len());
    for (pixel, &at) in nearest.iter().enumerate() {
        let column = coarse.jacobian.as_mat().col(pixel);
        (0..column.nrows()).for_each(|channel| jacobian[(channel, at)] += polarity * column[channel]);
    }
    let response = change_response(&coarse)?;
    let operations = response.operations();
    let respond = move |changes: &[f64]| response.to(&nearest.iter().map(|&at| changes[at]).collect::<Vec<f64>>());
    Ok((ChangeResponse::new(operations, respond), jacobian))
}

/// Change of the channels per uniform relative change of the whole skin, volts.
pub(super) fn response_to_uniform(prepared: &Prepared) -> Vec<f64> {
    prepared.jacobian.as_mat().row_iter().map(|row| row.iter().sum()).collect()
}

/// True if fits can correct for large changes: no readout circuit lies between model and channels.
pub(super) fn may_look_beyond(prepared: &Prepared) -> bool {
    prepared.skin.backend.circuit.is_none()
}

/// The change of the model's voltages when the conductance of each pixel changes by the given shares, and about the
/// operations that computing it takes.
pub(crate) fn change_response(prepared: &Prepared) -> Result<ChangeResponse, Error> {
    let model = ForwardModel::new(prepared.body.mesh.clone(), prepared.protocol.clone())?;
    let (map, rest_s) = (prepared.map.clone(), prepared.conductances_s());
    let rest = prepared.voltages.clone();
    Ok(ChangeResponse::new(model.operations(), move |changes: &[f64]| {
        let mut conductances = map.to_elements(changes).ok()?;
        conductances.iter_mut().zip(&rest_s).for_each(|(value, rest_s)| *value = rest_s * (1.0 + *value));
        let mut differences = model.voltages(&conductances).ok()?;
        differences.iter_mut().zip(&rest).for_each(|(value, rest)| *value -= rest);
        Some(differences)
    }))
}

/// Channel deviations (volts) that are assumed before any noise has been measured.
pub(crate) fn assumed_deviations(prepared: &Prepared) -> Vec<f64> {
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    vec![prepared.skin.touch.assumed_noise_share * largest; prepared.channels()]
}

/// The closed membrane over a liquid.
#[derive(Debug)]
pub(crate) struct Membrane {
    /// Response of the depth of a liquid under a closed membrane at all pixels (rows) to a load on one (columns): `T
    /// lap w = -p + c - rho gz w`, with `w = 0` at the rim and constant volume. The unit is chosen so that a typical
    /// spot in the middle makes 1 there. The liquid's weight narrows dents that are wider than `sqrt(T / rho |gz|)`,
    /// 78 mm for water under 60 N/m; the depth is only a scale factor.
    pub spread: Mat<f64>,
    /// This unit over metres per pascal.
    unit: f64,
    spec: MembraneSpec,
    /// Pressure of a load of amplitude 1, pascal.
    pub pressure_pa: f64,
}

impl Membrane {
    /// The membrane of a skin; `None` without one.
    ///
    /// # Errors
    /// A membrane that cannot be solved.
    pub(crate) fn of(prepared: &Prepared) -> Result<Option<Self>, Error> {
        let Layer::Liquid(layer) = &prepared.skin.frontend.layer else { return Ok(None) };
        if layer.tension_n_per_m <= 0.0 {
            return Ok(None);
        }
        // Gravity along the skin changes the rest shape, not the response.
        let spec = MembraneSpec {
            tension_n_per_m: layer.tension_n_per_m,
            density_kg_per_m3: layer.density_kg_per_m3,
            gravity_m_per_s2: [0.0, 0.0, layer.gravity_m_per_s2[2]],
        };
        let mesh = &prepared.body.mesh.mesh;
        let spread = {
            let dents = under_each(mesh, spec, &pixel_loads(prepared), |deflection_m| {
                let named = |source| Error::Mesh { skin: prepared.skin.name.clone(), source };
                prepared.map.to_inside(&means(mesh, deflection_m)).map_err(named)
            })?;
            Mat::from_fn(dents.len(), dents.len(), |row, column| dents[column][row])
        };
        let radius = TYPICAL_RADIUS * prepared.half_width_m();
        let centre = |p: &[f64; 3]| (-(p[0] * p[0] + p[1] * p[1]) / (2.0 * radius * radius)).exp();
        let middle: Vec<f64> = prepared.basis.positions.iter().map(centre).collect();
        let shape = &spread * faer::ColRef::from_slice(&middle);
        let largest = shape.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let (unit, pressure_pa) = (1.0 / largest, 1e-3 * layer.depth_mm / largest);
        Ok(Some(Self { spread: faer::Scale(unit) * spread, unit, spec, pressure_pa }))
    }

    /// Change of the channels by a load on each pixel, in the direction of presses: channels x pixels, volts. Dents and
    /// sensitivities are multiplied on the mesh. Both vary within a pixel near the rim: the product of their averages
    /// misplaces presses by up to 1 % of half the shorter side. The membrane is self-adjoint, so its deflection under
    /// the sensitivities of a channel gives all responses of that channel.
    fn response(&self, prepared: &Prepared) -> Result<Mat<f64>, Error> {
        let (sensitivities, mesh) = (prepared.element_sensitivities()?, &prepared.body.mesh.mesh);
        let unit = prepared.skin.imaging.polarity.sign() * self.unit;
        let load_of = |channel: usize| {
            let mut load = vec![0.0; mesh.nodes().len()];
            for (nodes, volts) in mesh.elements().zip(sensitivities.row(channel)) {
                nodes.iter().for_each(|&node| load[node as usize] += unit * volts / nodes.len() as f64);
            }
            load
        };
        let loads: Vec<Vec<f64>> = (0..prepared.channels()).map(load_of).collect();
        let rows = under_each(mesh, self.spec, &loads, |deflection_m| {
            let mut row = vec![0.0; prepared.map.inside_count()];
            for (element, mean) in means(mesh, deflection_m).into_iter().enumerate() {
                for (pixel, share) in prepared.map.overlaps_of_element(element) {
                    row[pixel] += share * mesh.measures()[element] * mean;
                }
            }
            Ok(row)
        })?;
        Ok(Mat::from_fn(rows.len(), prepared.map.inside_count(), |channel, pixel| rows[channel][pixel]))
    }
}

/// Deflects a membrane by each of these nodal loads, in parallel, and evaluates every deflection.
fn under_each<T: Send>(
    mesh: &Mesh,
    spec: MembraneSpec,
    loads: &[Vec<f64>],
    of: impl Fn(&[f64]) -> Result<T, Error> + Send + Sync,
) -> Result<Vec<T>, Error> {
    let of_some = |loads: &[Vec<f64>]| {
        let mut membrane = factored(mesh, spec)?;
        let under = |load: &Vec<f64>| {
            membrane.deflect(load);
            of(membrane.deflection_m())
        };
        loads.iter().map(under).collect()
    };
    // Each thread factors a membrane of its own.
    let parts: Result<Vec<Vec<T>>, Error> = in_parallel(|| {
        let count = loads.len().div_ceil(rayon::current_num_threads()).max(1);
        loads.par_chunks(count).map(of_some).collect()
    });
    Ok(parts?.into_iter().flatten().collect())
}

/// A membrane, or one without its liquid's weight if it is too slack to hold that. It must then be held in some other
/// way, and only the shape of its response is needed.
fn factored(mesh: &Mesh, spec: MembraneSpec) -> Result<ThinMembrane, Error> {
    let weightless = MembraneSpec { density_kg_per_m3: 0.0, ..spec };
    Ok(ThinMembrane::new(mesh, spec).or_else(|_| ThinMembrane::new(mesh, weightless))?)
}

/// Nodal forces by a pressure of 1 on each inside pixel.
fn pixel_loads(prepared: &Prepared) -> Vec<Vec<f64>> {
    let mesh = &prepared.body.mesh.mesh;
    let mut loads = vec![vec![0.0; mesh.nodes().len()]; prepared.map.inside_count()];
    for (element, nodes) in mesh.elements().enumerate() {
        for (pixel, share) in prepared.map.overlaps_of_element(element) {
            let force = share * mesh.measures()[element] / nodes.len() as f64;
            nodes.iter().for_each(|&node| loads[pixel][node as usize] += force);
        }
    }
    loads
}

/// Mean of a nodal value over each element.
fn means(mesh: &Mesh, of_nodes: &[f64]) -> Vec<f64> {
    mesh.elements().map(|nodes| nodes.iter().map(|&n| of_nodes[n as usize]).sum::<f64>() / nodes.len() as f64).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::Skin;

    #[test]
    fn responses_to_loads_are_those_of_the_dents_that_they_make() {
        let prepared = Prepared::new(Skin::open("ionic-disc").unwrap()).unwrap();
        let membrane = Membrane::of(&prepared).unwrap().unwrap();
        let response = membrane.response(&prepared).unwrap();
        let sensitivities = prepared.element_sensitivities().unwrap();
        let mesh = &prepared.body.mesh.mesh;
        let (mut thin, loads) = (factored(mesh, membrane.spec).unwrap(), pixel_loads(&prepared));
        let largest = (0..response.ncols()).map(|pixel| response.col(pixel).norm_max()).fold(0.0, f64::max);
        for pixel in (0..loads.len()).step_by(97) {
            thin.deflect(&loads[pixel]);
            let dents = means(mesh, thin.deflection_m());
            for channel in (0..prepared.channels()).step_by(13) {
                let volts: f64 = sensitivities.row(channel).iter().zip(&dents).map(|(volts, dent)| volts * dent).sum();
                let volts = prepared.skin.imaging.polarity.sign() * membrane.unit * volts;
                assert!((response[(channel, pixel)] - volts).abs() < 1e-9 * largest, "{channel} {pixel}");
            }
        }
    }
}
