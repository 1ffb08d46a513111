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
use crate::reference::Reference;

pub use build::Build;
pub(crate) use fit::BuildFit;

/// True if pokes can tell how a skin was built: presses are spots on its sheet, read without a circuit between.
pub(crate) fn is_wanted(prepared: &Prepared) -> bool {
    let skin = &prepared.skin;
    let has_spots = matches!(skin.frontend.layer, Layer::Sheet(_) | Layer::Liquid(_));
    has_spots && skin.fits_touches() && skin.backend.wiring.is_known()
}

/// The skin as built, as far as its baseline tells; `None` if the skin is as drawn.
///
/// # Errors
/// A skin that cannot be solved.
pub fn from_rest(prepared: &Prepared, reference: &Reference) -> Result<Option<Prepared>, Error> {
    if !is_wanted(prepared) || prepared.is_as_built() {
        return Ok(None);
    }
    let (build, errors) = BuildFit::new(prepared, reference, &[], &[])?.fit(&[])?;
    Ok(Some(prepared.as_built(build)?.with_errors(Arc::new(errors))))
}
