//! Electrical impedance tomography in its usual terms, for people who know EIDORS or pyEIT: a mesh with electrodes, a
//! protocol, a forward model with its Jacobian, priors and inverse operators, figures of merit.
//!
//! SI units; x right, y up; images are row-major with row 0 at the top, `NaN` outside; signs as in EIDORS
//! (`J = dv/dsigma`). `dermis-tomo` has more, for example nonlinear problems and readout circuits.

/// ```
/// use dermis::eit::{Direction, Outline, PixelGrid, PixelMap, SheetSpec};
///
/// // A disc of 100 mm with 16 electrodes of 8 mm round its rim, in elements of about 4 mm.
/// let rim = Outline::rim_arcs(16, 8e-3, 0.0, Direction::CounterClockwise);
/// let (body, _quality) = SheetSpec::new(Outline::Disc { radius_m: 0.05 }, rim, 4e-3).build(&[1e-4])?;
/// assert!(body.mesh.element_count() > 500 && body.electrodes.len() == 16);
/// // Images of 32 pixels a side over it.
/// let map = PixelMap::new(PixelGrid::covering([-0.05; 2], [0.05; 2], 32)?, &body.mesh)?;
/// assert!(map.inside_count() < 32 * 32);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::mesh::SheetSpec;
/// Shown with [`SheetSpec`].
pub use dermis_tomo::mesh::{Direction, Outline, PixelGrid, PixelMap};
/// No example: electrodes of a [`SheetSpec`], the mesh that it builds, and the surface that a sheet is bent onto.
pub use dermis_tomo::mesh::{ElectrodeShape, ElectrodedMesh, Mesh, Surface};

/// Shown with [`read_msh`].
pub use dermis_tomo::mesh::ElectrodeGroups;
/// ```
/// use dermis::eit::{ElectrodeGroups, read_msh};
///
/// // Two triangles, as Gmsh writes them; the group "electrode1" is the left side, "electrode2" the right one.
/// let text = b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n\
///     $PhysicalNames\n3\n1 1 \"electrode1\"\n1 2 \"electrode2\"\n2 3 \"sheet\"\n$EndPhysicalNames\n\
///     $Nodes\n4\n1 0 0 0\n2 1 0 0\n3 1 1 0\n4 0 1 0\n$EndNodes\n\
///     $Elements\n4\n1 1 2 1 1 4 1\n2 1 2 2 1 2 3\n3 2 2 3 1 1 2 3\n4 2 2 3 1 1 3 4\n$EndElements\n";
/// let body = read_msh(text, &ElectrodeGroups::Prefix("electrode".into()), &[1e-4])?;
/// assert_eq!((body.mesh.element_count(), body.electrodes.len()), (2, 2));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::mesh::read_msh;

/// ```
/// use dermis::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
///
/// // 1 mA through neighbours, voltages between neighbours, none on driven electrodes.
/// let (drive, measure, order, driven) = (Drive::Adjacent, Measure::Adjacent, Order::Absolute, Driven::Drop);
/// let spec = ProtocolSpec { electrode_count: 16, drive, measure, order, driven, amplitude_a: 1e-3 };
/// let protocol = Protocol::generate(&spec)?;
/// assert_eq!((protocol.stimulations().len(), protocol.channel_count()), (16, 208));
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::eit::Protocol;
/// No example: the argument of [`Measure::SingleEnded`].
pub use dermis_tomo::eit::Reference as SingleEndedReference;
/// Shown with [`Protocol`].
pub use dermis_tomo::eit::{Drive, Driven, Measure, Order, ProtocolSpec};

/// ```
/// use dermis::eit::{
///     Direction, Drive, Driven, ForwardModel, ImageBasis, LinearProblem, Measure, Order, Outline, PixelGrid, PixelMap,
///     Prior, Protocol, ProtocolSpec, SheetSpec, Weighting, peak_m,
/// };
///
/// let rim = Outline::rim_arcs(16, 8e-3, 0.0, Direction::CounterClockwise);
/// let (body, _) = SheetSpec::new(Outline::Disc { radius_m: 0.05 }, rim, 4e-3).build(&[1e-4])?;
/// let (drive, measure, order, driven) = (Drive::Adjacent, Measure::Adjacent, Order::Absolute, Driven::Drop);
/// let spec = ProtocolSpec { electrode_count: 16, drive, measure, order, driven, amplitude_a: 1e-3 };
/// let model = ForwardModel::new(body, Protocol::generate(&spec)?)?;
///
/// // Voltages at 1 mS per square, and their change for every pixel of an image.
/// let rest = vec![1e-3; model.body().mesh.element_count()];
/// let map = PixelMap::new(PixelGrid::covering([-0.05; 2], [0.05; 2], 32)?, &model.body().mesh)?;
/// let jacobian = model.solve(&rest)?.jacobian_to_pixels(&map);
///
/// // An operator from differences to images, tried on a change at one pixel.
/// let positions = map.inside_centres_m().into_iter().map(|[x, y]| [x, y, 0.0]).collect();
/// let basis = ImageBasis { positions, neighbours: Vec::new() };
/// let prior = Prior::Noser { exponent: 0.5 }.matrix(jacobian.as_mat(), &Weighting::Identity, &basis)?;
/// let operator = LinearProblem::new(jacobian.as_mat(), Weighting::Identity, prior)?.operator(1e-2)?;
/// let touched = map.inside_count() / 3;
/// let dv: Vec<f64> = (0..208).map(|channel| jacobian.row(channel)[touched]).collect();
/// let image = map.image(&operator.apply(&dv)?)?;
/// let ([x, y], [true_x, true_y]) = (peak_m(&image, map.grid(), 1.0)?, map.inside_centres_m()[touched]);
/// assert!((x - true_x).hypot(y - true_y) < 0.01);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::eit::ForwardModel;
/// No example here: results of [`ForwardModel::solve`] and [`LinearProblem::operator`], used by [`ForwardModel`]'s
/// example.
pub use dermis_tomo::{
    eit::{Jacobian, Solution},
    inverse::Operator,
};
/// Shown with [`ForwardModel`].
pub use dermis_tomo::{
    inverse::{ImageBasis, LinearProblem, Prior, Weighting},
    quality::peak_m,
};

/// No example: rules for lambda, whose variants explain themselves.
pub use dermis_tomo::inverse::Hyperparameter;

/// No example: GREIT and total variation take the problem of [`ForwardModel`]'s example.
pub use dermis_tomo::inverse::{Greit, GreitSpec, TotalVariation};

/// ```
/// use dermis::eit::{GreitFigures, PixelGrid, Target};
///
/// let grid = PixelGrid::covering([-0.05; 2], [0.05; 2], 20)?;
/// let target = Target { centre_m: [0.02, 0.0], area_m2: 1e-4, change: 1.0 };
/// let spot = |[x, y]: [f64; 2]| (-((x - 0.02).powi(2) + y.powi(2)) / 2e-4).exp();
/// let image: Vec<f64> = grid.centres_m().into_iter().map(spot).collect();
/// let figures = GreitFigures::of(&image, &grid, &target)?;
/// assert!(figures.position_error_m < 2e-3 && figures.ringing == 0.0);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::quality::GreitFigures;
/// Shown with [`GreitFigures`].
pub use dermis_tomo::quality::Target;

/// No example: the result of [`diagnose_order`], which has one.
pub use dermis_tomo::eit::OrderReport;
/// ```
/// use dermis::Skin;
/// use dermis::eit::diagnose_order;
/// use dermis::pipeline::Prepared;
///
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// // Readings in the model's order, with the opposite sign.
/// let reversed: Vec<f64> = prepared.voltages.iter().map(|volts| -volts).collect();
/// let report = diagnose_order(&prepared.protocol, &prepared.voltages, &reversed, false);
/// println!("{report:?}");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_tomo::eit::diagnose_order;
