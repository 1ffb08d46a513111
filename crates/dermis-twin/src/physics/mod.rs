//! Fields of two conductive sheets that touch under pressure: a sensing sheet u with electrodes, and a floating
//! shortcut sheet v, `div(s_s grad u) = g (u - v)`, `div(s_c grad v) = -g (u - v)`, with insulated rims. In weak form
//! the contact adds `integral g (u - v)(phi_u - phi_v)`. Under continuous copper, g is linear on each triangle and
//! the integral exact ([`TwoSheets`]); under separate patches, g and v are constant on cells ([`PatchedSheet`]). Also
//! fields of a tray of liquid with variable depth, depth-averaged or in three dimensions.

mod conductance_map;
mod cut;
mod direct;
mod element;
mod liquid;
mod patches;
mod patches_cells;
mod paths;
mod sheet_body;
mod two_sheets;

pub use conductance_map::ConductanceMap;
pub use cut::{Cut, damaged_conductance};
pub use direct::direct_impedance;
pub use element::SheetConductance;
pub use liquid::{LiquidElectrodes, LiquidFields, LiquidSpec};
pub use patches::{PatchedSheet, direct_patched_impedance};
pub use patches_cells::{ContactCell, PatchLayout};
pub use paths::{SlitPath, SlitPaths};
pub use two_sheets::{Shortcut, TwoSheets};
