//! Which indenters a skin can bear: those whose middle lies on it and whose face is no larger than it.

use dermis_tomo::mesh::Outline;

use super::Indenter;
use crate::error::{TwinError, check};

/// Refuses an indenter that a skin of this outline cannot bear.
///
/// # Errors
/// A middle off the skin, a face larger than the skin, with the value; and as [`Indenter::check`].
pub fn check_on_skin(outline: &Outline, indenter: &Indenter) -> Result<(), TwinError> {
    indenter.check()?;
    let [x, y] = indenter.centre_m;
    match *outline {
        Outline::Disc { radius_m } => {
            let field = "distance of the indenter from the middle, m";
            check(field, x.hypot(y), 0.0, radius_m, "no farther out than the skin's rim")?;
        }
        _ => {
            let (low, high) = outline.bounds_m();
            check("x of the indenter, m", x, low[0], high[0], "no farther out than the skin's rim")?;
            check("y of the indenter, m", y, low[1], high[1], "no farther out than the skin's rim")?;
        }
    }
    let area = indenter.shape.area_m2();
    check("area of the indenter, m^2", area, 0.0, outline.area_m2(), "no larger than the skin's")
}
