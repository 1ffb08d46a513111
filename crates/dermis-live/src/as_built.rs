//! The skin as it was built: how far it is from its file, learned from pokes at known positions.
//!
//! The file's `[tolerances]` are the prior: positions and widths of electrodes, contact impedances and a smooth random
//! conductivity, all normal with known deviations. Pokes condition it. The result is a skin whose model is used in
//! place of the file's, and what remains unknown is the covariance of its touches.

mod build;
mod errors;
mod fit;
mod spots;

use std::sync::Arc;

use dermis_skin::Layer;

use crate::Error;
use crate::prepare::Prepared;
use crate::reference::{Reference, baseline_is_known};

/// Baselines with a smaller relative misfit come from a twin as drawn: different meshes alone cause up to this much.
pub(crate) const AS_DRAWN: f64 = 0.004;
/// Largest difference between a baseline and the skin as built, root mean square, in standard deviations of gains and
/// meshes. Twins built within their tolerances reach 0.5 to 1.2.
const MOST_MISFIT: f64 = 2.0;

pub use build::Build;
pub(crate) use fit::{BuildFit, Built};

/// True if pokes can tell how a skin was built: presses are spots on its sheet, read without a circuit between.
pub(crate) fn is_wanted(prepared: &Prepared) -> bool {
    let skin = &prepared.skin;
    let has_spots = matches!(skin.frontend.layer, Layer::Sheet(_) | Layer::Liquid(_));
    has_spots && skin.fits_touches() && skin.backend.wiring.is_known()
}

/// True if the baseline of this skin, as drawn, tells how it was built.
pub(crate) fn learns_from_rest(drawn: &Prepared) -> bool {
    is_wanted(drawn) && !drawn.is_as_built() && baseline_is_known(drawn)
}

/// The skin as built, as far as its baseline tells. `None` if the baseline fits the skin as drawn, if no skin within the
/// tolerances explains it, or if presses on the skin are not spots.
///
/// # Errors
/// A skin that cannot be solved.
pub fn from_rest(prepared: &Prepared, reference: &Reference) -> Result<Option<Prepared>, Error> {
    // Without a baseline to compare, the misfit is not a number.
    let is_off = reference.misfit >= AS_DRAWN;
    if !learns_from_rest(prepared) || !is_off {
        return Ok(None);
    }
    let Built { build, errors, rest_misfit } = BuildFit::new(prepared, reference, &[], &[])?.fit(&[])?;
    if rest_misfit > MOST_MISFIT {
        tracing::debug!("no skin within the tolerances explains the baseline: {rest_misfit:.1} deviations off");
        return Ok(None);
    }
    Ok(Some(prepared.as_built(build)?.with_errors(Arc::new(errors))))
}
