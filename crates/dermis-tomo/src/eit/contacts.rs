//! A resistive sheet under a floating layer that conducts perfectly and touches it where pressed: the sandwich. Every
//! touch joins the sheet to the same layer, so that several touches are joined to each other, which no change of the
//! sheet's own conductivity describes. Touches are patches of contact; their effect on the channels is a low-rank
//! change of the bare sheet's, whose Green's function between all nodes is worked out once.
//!
//! Of a bare sheet with potentials `f` (one column a pattern of electrode currents) and Green's function `G` at the
//! nodes that are touched, with contact conductances `g`, the currents that leave the sheet into the layer (potential
//! `u`) are `i = P f` with `(diag(1/g) + G) i = f - u 1` and `1' i = 0`, that is
//! `P = M^-1 - M^-1 1 1' M^-1 / (1' M^-1 1)`, `M = diag(1/g) + G`. A channel's voltage changes by `-f_m' P f_s`, for
//! stimulation s and measuring pattern m (reciprocity), and `dV/dg_p = -w_mp w_sp` where `w = diag(1/g) P f` is the
//! potential across the contact. No net current enters the layer. Nodes carry the area of the sheet around them (lumped
//! mass).

mod fit;
mod search;
mod sheet;

pub use fit::{ContactFit, FitOptions, FitSummary, PatchFit};
pub use search::{Looked, PatchSearch, PatchSets};
pub use sheet::{ContactPatch, ContactSheet};

#[cfg(test)]
mod tests;
