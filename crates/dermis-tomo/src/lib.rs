//! Tomographic mathematics of tactile skins: meshes, electrical impedance tomography (EIT) forward models, and
//! inverse operators. Pure: no files, no clocks, no devices.
//!
//! Conventions: SI units throughout; frame of a flat skin: x right, y up, z out of the skin toward the toucher; images
//! are row-major with row 0 at the top (+y), pixel value at the pixel centre, `NaN` outside the skin; EIT signs as in
//! EIDORS (`J = dv/dsigma`, stimulation in amperes into the body).

pub mod eit;
pub mod inverse;
pub mod least_squares;
pub mod membrane;
pub mod mesh;
pub mod quality;
pub mod sparse;
