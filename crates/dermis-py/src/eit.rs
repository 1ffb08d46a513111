//! `dermis.eit`: meshes, electrodes, protocols, forward models, priors and operators for problems without a skin file.

pub mod figures;
pub mod forward;
pub mod mesh;
pub mod operator;
pub mod protocol;
