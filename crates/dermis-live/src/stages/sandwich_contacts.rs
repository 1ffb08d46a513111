//! Touches on a sandwich skin by its own physics: patches of contact with the layer above, which connects them to
//! each other. Linear images show several touches as a single bar between them. Here the positions, radii and
//! conductances of all patches are fitted to the frame ([`dermis_tomo::eit::contacts`]), starting from those of the
//! previous frame, or from a search on a coarser mesh if these do not fit. A fit takes most of a millisecond. If
//! frames arrive faster than every 5 ms, their mean is fitted.

mod gathered;
mod plausible;
mod seek;
mod sheets;
mod stage;
mod touch_rule;
mod whitening;

pub(crate) use sheets::SheetCut;
pub(crate) use stage::{PatchStage, ReleaseLook, Released};

use crate::prepare::Prepared;

/// True if touches make contact with a layer above.
pub(crate) fn is_sandwich(prepared: &Prepared) -> bool {
    matches!(prepared.skin.frontend.layer, dermis_skin::Layer::Sandwich(_))
}
