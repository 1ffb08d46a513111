//! How presses on a skin's layer change its channels: the model that touches are fitted with.

use std::sync::Arc;

use dermis_estimate::{PlateFit, PlateLaw, PlateModel, PlateOptions, PressFit, SpotFit};
use dermis_skin::{Layer, PatchesLayer};
use dermis_tomo::eit::ForwardModel;
use dermis_tomo::eit::contacts::PlatedSheet;
use dermis_tomo::inverse::SpotModel;
use dermis_tomo::mesh::PixelGrid;

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::drift::Drift;
use crate::stages::spot_model::{
    LARGEST_RADIUS, MOST_SPOTS, Membrane, SMALLEST_RADIUS, TYPICAL_RADIUS, may_look_beyond, spot_model_under,
};

/// Share of a frame's energy that the model of a press leaves unexplained, on twins. Up to 0.002 on gels, foams and
/// liquids; more for deep dents with the linear model; 0.002 to 0.006 in open tanks, whose surface takes the shape of
/// the indenter; 0.007 to 0.07 for smooth spots on separate patches, because a
/// patch conducts as a whole.
const SPOTS_ERROR: f64 = 0.001;
const IN_PROPORTION_ERROR: f64 = 0.005;
const TANK_ERROR: f64 = 0.005;
const PATCHES_ERROR: f64 = 0.04;
/// The same for the physics of contact with patches: 0 to 0.002.
const CONTACT_ERROR: f64 = 0.0005;

/// Number of elements of the mesh under patches, and of the one on which explanations are compared.
const ELEMENTS: usize = 4000;
const COARSE_ELEMENTS: usize = 1500;
/// Largest number of channels for fits of contact with patches. Skins with more keep smooth spots.
const MOST_CHANNELS: usize = 2000;
/// Contact under a usual press, as a share of the saturated contact.
const USUAL_CONTACT: f64 = 0.8;
/// Distance between the positions at which presses on patches are proposed, in pitches.
const PROPOSED_EVERY: f64 = 0.5;
/// Standard deviation of a uniform change of a sheet under patches.
const UNIFORM_DEVIATION: f64 = 0.2;

/// The model of one skin.
#[derive(Debug)]
pub(super) enum PressModel {
    /// Smooth spots of changed conductance.
    Spots {
        /// Responses with all channels.
        whole: Box<SpotModel>,
        /// Pressure of a load of amplitude 1, if presses act through a membrane.
        membrane_pa: Option<f64>,
        error_share: f64,
        grid: PixelGrid,
        inside: Vec<bool>,
    },
    /// Contacts with separate patches.
    Plates {
        model: Arc<PlateModel>,
        /// Change of the channels by one standard deviation of a uniform change, volts.
        uniform: Vec<f64>,
    },
}

/// True if presses on a skin's patches are fitted as contacts; otherwise they are smooth spots.
pub(super) fn fits_contacts(prepared: &Prepared) -> bool {
    let has_patches = matches!(prepared.skin.frontend.layer, Layer::Patches(_));
    has_patches && may_look_beyond(prepared) && prepared.channels() <= MOST_CHANNELS
}

impl PressModel {
    /// The model of a skin. `deviations` are those of its channels, volts.
    ///
    /// # Errors
    /// A membrane or contacts that cannot be solved; no positive deviation; a mesh that cannot be made.
    pub fn new(prepared: &Prepared, deviations: &[f64]) -> Result<Self, Error> {
        if let Layer::Patches(layer) = &prepared.skin.frontend.layer
            && fits_contacts(prepared)
        {
            return Self::of_patches(prepared, layer);
        }
        let membrane = Membrane::of(prepared)?;
        let whole = Box::new(spot_model_under(prepared, deviations, membrane.as_ref())?);
        Ok(Self::Spots {
            error_share: error_share(prepared, &whole),
            whole,
            membrane_pa: membrane.map(|membrane| membrane.pressure_pa),
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
        })
    }

    fn of_patches(prepared: &Prepared, layer: &PatchesLayer) -> Result<Self, Error> {
        let skin = &prepared.skin;
        let (low, high) = skin.outline().bounds_m();
        let (pitch_m, gap_m) = (1e-3 * layer.pitch_mm, 1e-3 * layer.gap_mm);
        // Patches are centred on the sheet; rounding must not add one.
        let count = [0, 1].map(|axis| ((high[axis] - low[axis]) / pitch_m - 1e-6).ceil().max(1.0));
        let corner = [0, 1].map(|axis| 0.5 * (low[axis] + high[axis] - count[axis] * pitch_m));
        let plate_at = |place: [f64; 2]| {
            let along = [0, 1].map(|axis| (place[axis] - corner[axis]) / pitch_m);
            let is_on = |at: f64| (at - at.floor() - 0.5).abs() * pitch_m <= 0.5 * (pitch_m - gap_m);
            let [column, row] = along.map(|at| at.floor().max(0.0) as u32);
            along.iter().all(|at| is_on(*at)).then_some(row * count[0] as u32 + column)
        };
        let sheet = |elements: usize| -> Result<PlatedSheet, Error> {
            let (slit, _) = skin.slit_mesh(elements, &[])?;
            let sheet_s = vec![skin.sheet_conductance_s(); slit.mesh.mesh.measures().len()];
            let model = ForwardModel::new(slit.mesh, prepared.protocol.clone())?;
            Ok(PlatedSheet::new(&model, &sheet_s, plate_at)?)
        };
        let sheets = [sheet(COARSE_ELEMENTS)?, sheet(ELEMENTS)?];
        let contact = &layer.contact;
        let law = PlateLaw {
            threshold_pa: 1e3 * contact.threshold_kpa,
            reference_pa: 1e3 * contact.reference_kpa,
            exponent: contact.exponent,
            saturation_s_per_m2: contact.saturation_s_per_m2,
            spread_m: (1e-3 * layer.smoothing_mm).max(0.05 * pitch_m),
        };
        let half_width_m = prepared.half_width_m();
        let options = PlateOptions {
            typical_radius_m: TYPICAL_RADIUS * half_width_m,
            typical_pa: law.pressure_at_pa(USUAL_CONTACT),
            radii_m: [SMALLEST_RADIUS * half_width_m, LARGEST_RADIUS * half_width_m],
            spacing_m: PROPOSED_EVERY * pitch_m,
            most_presses: MOST_SPOTS,
            error_share: CONTACT_ERROR,
        };
        let uniform = sheets[1].bare_v().iter().map(|volts| UNIFORM_DEVIATION * volts).collect();
        let model = PlateModel::new(sheets, law, options, *prepared.map.grid(), prepared.map.inside_mask())?;
        Ok(Self::Plates { model: Arc::new(model), uniform })
    }

    /// Pressure of a load of amplitude 1, if presses act through a membrane.
    pub fn membrane_pa(&self) -> Option<f64> {
        match self {
            Self::Spots { membrane_pa, .. } => *membrane_pa,
            Self::Plates { .. } => None,
        }
    }

    /// A fit with this noise of the channels (model volts) and their drift, without the channels left out.
    ///
    /// # Errors
    /// The wrong number of channels, or none left: see [`SpotModel::without`].
    pub fn fit(&self, noise: &[f64], left_out: &[u32], drift: &Drift) -> Result<Box<dyn PressFit>, Error> {
        let mut deviations = drift.deviations(noise);
        match self {
            Self::Spots { whole, error_share, grid, inside, .. } => {
                let model = match left_out {
                    [] => whole.marginalised(&deviations, &drift.nuisances())?,
                    _ => whole.without(left_out, &deviations)?,
                };
                Ok(Box::new(SpotFit::new(model, *grid, inside.clone(), *error_share)))
            }
            Self::Plates { model, uniform } => {
                left_out.iter().for_each(|&channel| deviations[channel as usize] = f64::INFINITY);
                let mut nuisances = drift.nuisances();
                nuisances.push(uniform.clone());
                Ok(Box::new(PlateFit::new(model.clone(), &deviations, &nuisances)))
            }
        }
    }
}

/// Share of a frame's energy that the model of presses is known to leave unexplained.
fn error_share(prepared: &Prepared, model: &SpotModel) -> f64 {
    let layer = &prepared.skin.frontend.layer;
    match layer {
        Layer::Patches(_) => PATCHES_ERROR,
        _ if layer.is_open_tank() => TANK_ERROR,
        _ if model.looks_beyond_proportion() => SPOTS_ERROR,
        _ => IN_PROPORTION_ERROR,
    }
}
