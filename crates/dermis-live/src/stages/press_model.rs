//! How presses on a skin's layer change its channels: the model that touches are fitted with.

use std::sync::Arc;

use dermis_estimate::{PlateFit, PlateModel, PressFit, SpotFit};
use dermis_skin::Layer;
use dermis_tomo::inner_product;
use dermis_tomo::inverse::SpotModel;
use dermis_tomo::mesh::PixelGrid;

use crate::Error;
use crate::prepare::Prepared;
use crate::stages::drift::Weights;
use crate::stages::plates::{Plates, SheetCut};
use crate::stages::spot_model::{Membrane, response_to_uniform, spot_model_under};

/// Share of a frame's energy that the model of a press leaves unexplained, on twins. On gels, foams and liquids with 32
/// electrodes it is up to 0.0017, near the rim. It grows with the square of their number, since electrodes that are
/// close together see more of a press's shape: it was up to 0.0004 with 16, and less than noise hides with 8. It is
/// more for deep dents with the linear model; 0.002 to 0.006 in open tanks, whose surface takes the shape of the
/// indenter; 0.007 to 0.07 for smooth spots on separate patches, because a patch conducts as a whole.
const SPOTS_ERROR: f64 = 0.001;
const SPOTS_ELECTRODES: f64 = 32.0;
const IN_PROPORTION_ERROR: f64 = 0.005;
const TANK_ERROR: f64 = 0.005;
const PATCHES_ERROR: f64 = 0.04;
/// Standard deviation of a uniform change of a sheet under plates.
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
        /// Relative change of the channels per uniform change of the skin.
        gain_of_uniform: f64,
        grid: PixelGrid,
        inside: Vec<bool>,
    },
    /// Contacts with the plates above the sheet.
    Plates {
        model: Arc<PlateModel>,
        /// Change of the channels by one standard deviation of a uniform change, volts.
        uniform: Vec<f64>,
    },
}

impl PressModel {
    /// The model of a skin. `deviations` are those of its channels, volts.
    ///
    /// # Errors
    /// A membrane or contacts that cannot be solved; no positive deviation; a mesh that cannot be made.
    pub fn new(prepared: &Prepared, deviations: &[f64]) -> Result<Self, Error> {
        if let Some(plates) = Plates::of(prepared)
            && let Some(model) = Self::of_plates(&plates, &[], || true)?
        {
            return Ok(model);
        }
        let membrane = Membrane::of(prepared)?;
        let whole = Box::new(spot_model_under(prepared, deviations, membrane.as_ref())?);
        Ok(Self::Spots {
            error_share: error_share(prepared, &whole),
            gain_of_uniform: gain_of_uniform(prepared),
            whole,
            membrane_pa: membrane.map(|membrane| membrane.pressure_pa),
            grid: *prepared.map.grid(),
            inside: prepared.map.inside_mask(),
        })
    }

    /// The model of presses on these plates, above a sheet with these cuts; `None` once `go_on` says that it is no
    /// longer wanted.
    ///
    /// # Errors
    /// As [`Plates::model`].
    pub fn of_plates(plates: &Plates, cuts: &[SheetCut], go_on: impl Fn() -> bool) -> Result<Option<Self>, Error> {
        let Some(model) = plates.model(cuts, go_on)? else { return Ok(None) };
        let uniform = model.bare_v().iter().map(|volts| UNIFORM_DEVIATION * volts).collect();
        Ok(Some(Self::Plates { model: Arc::new(model), uniform }))
    }

    /// Pressure of a load of amplitude 1, if presses act through a membrane.
    pub fn membrane_pa(&self) -> Option<f64> {
        match self {
            Self::Spots { membrane_pa, .. } => *membrane_pa,
            Self::Plates { .. } => None,
        }
    }

    /// A fit under these weights, without the channels left out. Forces are those of an indenter of this radius
    /// (metres), if it is known.
    ///
    /// # Errors
    /// The wrong number of channels, or none left: see [`SpotModel::without`].
    pub fn fit(&self, weights: Weights, left_out: &[u32], indenter_m: Option<f64>) -> Result<Box<dyn PressFit>, Error> {
        let Weights { mut deviations, mut nuisances } = weights;
        match self {
            Self::Spots { whole, error_share, gain_of_uniform, grid, inside, .. } => {
                let model = match left_out {
                    [] => whole.marginalised(&deviations, &nuisances)?,
                    _ => whole.without(left_out, &deviations)?,
                };
                Ok(Box::new(SpotFit::new(model, *grid, inside.clone(), *error_share, *gain_of_uniform)))
            }
            Self::Plates { model, uniform } => {
                left_out.iter().for_each(|&channel| deviations[channel as usize] = f64::INFINITY);
                nuisances.push(uniform.clone());
                let fit = PlateFit::new(model.clone(), &deviations, &nuisances);
                Ok(Box::new(fit.with_indenter(indenter_m)))
            }
        }
    }
}

/// Relative change of the channels per uniform change of the skin.
fn gain_of_uniform(prepared: &Prepared) -> f64 {
    let volts = &prepared.voltages;
    let gain = inner_product(&response_to_uniform(prepared), volts) / inner_product(volts, volts);
    if gain.is_finite() { gain } else { 0.0 }
}

/// Share of a frame's energy that the model of presses is known to leave unexplained.
fn error_share(prepared: &Prepared, model: &SpotModel) -> f64 {
    let layer = &prepared.skin.frontend.layer;
    match layer {
        Layer::Patches(_) => PATCHES_ERROR,
        _ if layer.is_open_tank() => TANK_ERROR,
        _ if model.looks_beyond_proportion() => {
            let electrodes = prepared.skin.electrode_shapes().len() as f64;
            SPOTS_ERROR * (electrodes / SPOTS_ELECTRODES).powi(2)
        }
        _ => IN_PROPORTION_ERROR,
    }
}
