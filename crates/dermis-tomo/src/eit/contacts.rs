//! A resistive sheet under a floating, perfectly conducting layer that touches it under pressure: the sandwich. All
//! touches connect the sheet to the same layer and therefore to each other, which no change of the sheet's own
//! conductivity can describe. Touches are patches of contact; their effect on the channels is a low-rank change of
//! the bare sheet, whose Green's function between all nodes is computed once.
//!
//! Let the bare sheet have potentials `f` (one column per pattern of electrode currents) and Green's function `G` at
//! the touched nodes, with contact conductances `g`. The currents that leave the sheet into the layer (potential `u`)
//! are `i = P f` with `(diag(1/g) + G) i = f - u 1` and `1' i = 0`, that is
//! `P = M^-1 - M^-1 1 1' M^-1 / (1' M^-1 1)`, `M = diag(1/g) + G`. A channel's voltage changes by `-f_m' P f_s` for
//! stimulation s and measuring pattern m (reciprocity), and `dV/dg_p = -w_mp w_sp` where `w = diag(1/g) P f` is the
//! potential across the contact. No net current enters the layer. Each node represents the area of the sheet around
//! it (lumped mass).

mod plates;
mod search;
mod sheet;

pub use plates::{PlateContact, PlatePoint, PlatedSheet};
pub use search::{PatchSearch, PatchSets};
pub use sheet::{ContactPatch, ContactSheet};

#[cfg(test)]
mod tests;
