//! How a skin was built, as far as its baseline shows.

use std::sync::Arc;

use dermis_skin::Layer;

use super::fit::BuildFit;
use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, baseline_is_known, misfit};
use crate::stages::plates::fits_contacts;

/// A baseline fits the skin as drawn if its misfit is below this many times the change of the voltages on half the
/// elements, since meshes alone differ by that much. Twins as drawn of 44 skins (gel, foam, liquid, sandwich; 8 to 32
/// electrodes; 50 to 300 mm; misfits of 0.04 to 1.8 %) reach 1.5. On any of them the limit is at most 3.2 %, while
/// fifteen skins built with the default tolerances are off by 6 to 16 %.
const OF_MESH: f64 = 2.0;
/// Largest difference between a baseline and the skin as built, root mean square, in standard deviations of gains and
/// meshes. Fifteen twins built with the default tolerances reach 0.35 to 0.87.
const MOST_MISFIT: f64 = 2.0;

/// Largest number of channels. With more, the changes of all responses would take gigabytes.
const MOST_CHANNELS: usize = 2000;

/// True if pokes can show how a skin was built: presses are spots on its sheet, read without a circuit between.
pub(crate) fn is_wanted(prepared: &Prepared) -> bool {
    let has_spots = matches!(prepared.skin.frontend.layer, Layer::Sheet(_) | Layer::Liquid(_));
    has_spots && is_electric(prepared)
}

/// True if the responses of a skin follow from a sheet that is solved as built.
fn is_electric(prepared: &Prepared) -> bool {
    let skin = &prepared.skin;
    prepared.channels() <= MOST_CHANNELS && skin.fits_touches() && skin.backend.wiring.is_known()
}

/// True if the baseline of this skin, as drawn, shows how it was built.
pub(crate) fn learns_from_rest(drawn: &Prepared) -> bool {
    (is_wanted(drawn) || is_electric(drawn) && fits_contacts(drawn)) && !drawn.is_as_built() && baseline_is_known(drawn)
}

/// True if the misfit of a baseline is too large for the skin as drawn. It is NaN, and this is true, if the baseline
/// can't be compared with the model.
pub(crate) fn is_off(drawn: &Prepared, of_baseline: f64) -> bool {
    let by_mesh = drawn.change_by_mesh(|drawn| match drawn.voltages_with(drawn.skin.imaging.elements / 2) {
        Ok(coarse) => misfit(&drawn.voltages, &coarse),
        Err(error) => {
            tracing::debug!("no baseline counts as that of the skin as drawn: {error}");
            0.0
        }
    });
    of_baseline.is_nan() || of_baseline >= OF_MESH * by_mesh
}

/// The skin as built, as far as its baseline shows. `None` if the baseline fits the skin as drawn, if no skin within
/// the tolerances explains it, or if presses on the skin are not spots.
///
/// The size of the errors comes from the skin itself: where its baseline is nearer to the file than the tolerances
/// allow, the covariance that remains is scaled by the squared ratio of the misfits.
///
/// # Errors
/// A skin that cannot be solved as drawn.
pub fn from_rest(prepared: &Prepared, reference: &Reference) -> Result<Option<Prepared>, Error> {
    if !learns_from_rest(prepared) || !is_off(prepared, reference.misfit) {
        return Ok(None);
    }
    let learned = BuildFit::new(prepared, reference, &[], &[])?;
    let built =
        learned.fit(&[]).and_then(|built| Ok((prepared.as_built(built.build)?, built.errors, built.rest_misfit)));
    let (skin, errors, rest_misfit) = match built {
        Ok(built) => built,
        Err(error) => {
            tracing::debug!("no skin within the tolerances has this baseline: {error}");
            return Ok(None);
        }
    };
    tracing::debug!(
        "the baseline is {:.4} off the skin as drawn, and {rest_misfit:.2} deviations off the skin as built",
        reference.misfit
    );
    if rest_misfit > MOST_MISFIT {
        return Ok(None);
    }
    let ratio = (reference.misfit / learned.usual_misfit()).min(1.0);
    Ok(Some(skin.with_errors(Arc::new(errors.scaled(ratio * ratio)))))
}
