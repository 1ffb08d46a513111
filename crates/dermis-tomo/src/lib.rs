//! Tomographic mathematics of tactile skins: meshes, electrical impedance tomography (EIT) forward models, and
//! inverse operators. Pure: no files, no clocks, no devices. It can be used without the other crates.
//!
//! ```
//! use dermis_tomo::eit::{Drive, Driven, ForwardModel, Measure, Order, Protocol, ProtocolSpec};
//! use dermis_tomo::inverse::{ImageBasis, LinearProblem, Prior, Weighting};
//! use dermis_tomo::mesh::{Direction, Outline, PixelGrid, PixelMap, SheetSpec, distance};
//!
//! // A disc of 100 mm with 16 electrodes of 8 mm; 1 mA through neighbours, voltages between neighbours.
//! let rim = Outline::rim_arcs(16, 8e-3, 0.0, Direction::CounterClockwise);
//! let (drive, measure, order, driven) = (Drive::Adjacent, Measure::Adjacent, Order::Absolute, Driven::Drop);
//! let spec = ProtocolSpec { electrode_count: 16, drive, measure, order, driven, amplitude_a: 1e-3 };
//! let (body, _) = SheetSpec::new(Outline::Disc { radius_m: 0.05 }, rim, 4e-3).build(&[1e-4])?;
//! let model = ForwardModel::new(body, Protocol::generate(&spec)?)?;
//!
//! // Its voltages at 1 mS per square, and what they change by for each pixel of an image.
//! let rest = vec![1e-3; model.body().mesh.element_count()];
//! let map = PixelMap::new(PixelGrid::covering([-0.05; 2], [0.05; 2], 32)?, &model.body().mesh)?;
//! let jacobian = model.solve(&rest)?.jacobian_to_pixels(&map);
//!
//! // An operator from differences to images, tried on a change at one pixel.
//! let centres = map.inside_centres_m();
//! let positions = centres.iter().map(|&[x, y]| [x, y, 0.0]).collect();
//! let basis = ImageBasis { positions, neighbours: Vec::new() };
//! let prior = Prior::Noser { exponent: 0.5 }.matrix(jacobian.as_mat(), &Weighting::Identity, &basis)?;
//! let operator = LinearProblem::new(jacobian.as_mat(), Weighting::Identity, prior)?.operator(1e-2)?;
//! let touched = map.inside_count() / 3;
//! let dv: Vec<f64> = (0..208).map(|channel| jacobian.row(channel)[touched]).collect();
//! let image = operator.apply(&dv)?;
//! let brightest = (0..image.len()).max_by(|&a, &b| image[a].total_cmp(&image[b])).unwrap_or(0);
//! assert!(distance(centres[brightest], centres[touched]) < 0.01);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | |
//! |---|---|
//! | [`mesh`] | outlines, electrodes, meshes of sheets and solids, pixels over a mesh |
//! | [`eit`] | protocols, the forward model, Jacobians, readout circuits, contacts, the order of channels |
//! | [`inverse`] | priors, weights, hyperparameters, linear and nonlinear problems, uncertainties |
//! | [`membrane`] | a membrane under tension and pressure |
//! | [`least_squares`], [`sparse`] | the damped least-squares loop of all fits; sparse factorisations |
//! | [`quality`] | figures of merit of images |
//! | [`normal`] | the normal distribution |
//! | [`memory`] | the memory that solvers may use |
//!
//! Conventions: SI units throughout; frame of a flat skin: x right, y up, z out of the skin towards the viewer;
//! images are row-major with row 0 at the top (+y), pixel value at the pixel centre, `NaN` outside the skin; EIT
//! signs as in EIDORS (`J = dv/dsigma`, stimulation in amperes into the body).

pub mod eit;
mod inner_product;
pub mod inverse;
pub mod least_squares;
pub mod membrane;
pub mod memory;
pub mod mesh;
pub mod normal;
pub mod quality;
pub mod sparse;

pub use inner_product::inner_product;
