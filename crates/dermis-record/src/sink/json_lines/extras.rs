//! Fields that others add to a line.

use dermis_touch::Touch;
use serde::Serialize;

/// Fields to add to the objects of a line.
pub trait LineExtras {
    /// Fields of the line's object.
    type Line: Serialize;
    /// Fields of a touch's object.
    type Touch: Serialize;

    /// Fields to add to the line.
    fn line(&self) -> Self::Line;

    /// Fields to add to a touch.
    fn touch(&self, touch: &Touch) -> Self::Touch;
}

/// Adds nothing.
pub(super) struct Plain;

/// No fields.
#[derive(Serialize)]
#[cfg_attr(test, derive(schemars::JsonSchema))]
pub struct NoFields {}

impl LineExtras for Plain {
    type Line = NoFields;
    type Touch = NoFields;

    fn line(&self) -> NoFields {
        NoFields {}
    }

    fn touch(&self, _touch: &Touch) -> NoFields {
        NoFields {}
    }
}
