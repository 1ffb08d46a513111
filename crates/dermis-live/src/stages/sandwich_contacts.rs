//! Touches of a sandwich skin by its own physics: patches of contact with the layer above, which joins them to each
//! other. Linear images show several touches as one bar between them; here places, radii and conductances of all
//! patches are fitted to the frame ([`dermis_tomo::eit::contacts`]), from those of the frame before, or from a search
//! on a coarser mesh where these do not do. A fit takes the better part of a millisecond: of frames that come faster
//! than every 5 ms, the mean is fitted.

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

/// Whether touches make contact with a layer above.
pub(crate) fn is_sandwich(prepared: &Prepared) -> bool {
    matches!(prepared.skin.frontend.layer, dermis_skin::Layer::Sandwich(_))
}
