//! Skins on a robot: its links and joints, touches in every frame of reference, and all skins running at once.

/// ```
/// use dermis::Body;
/// use dermis::body::{DEMO_FILES, Patch, Transform};
///
/// let folder = std::env::temp_dir().join(format!("dermis-arm-{}", std::process::id()));
/// # let failed = |source| dermis::FileError { file: folder.clone(), source };
/// # std::fs::create_dir_all(&folder).map_err(failed)?;
/// for (name, text) in DEMO_FILES {
///     std::fs::write(folder.join(name), text).map_err(failed)?;
/// }
/// let body = Body::open(&folder.join("arm.toml"))?;
/// let joints = body.kinematics.at_rest();
/// for (number, Patch { name, .. }) in body.patches.iter().enumerate() {
///     let root_from_patch: Transform = body.root_from_patch(number, &joints).expect("all joints are known");
///     println!("{name}: its centre is at {:.3?} m", root_from_patch.point_m([0.0; 3]));
/// }
/// # std::fs::remove_dir_all(&folder).map_err(failed)?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_body::Patch;
/// Shown with [`Patch`].
pub use dermis_body::{DEMO_FILES, Transform};
/// No example here: parts of a [`Body`](crate::Body), used by [`Patch`]'s example.
pub use dermis_body::{JointSource, JointValues, Kinematics};

/// No example: a touch in space, as [`TouchInFrames`] holds it.
pub use dermis_body::SpatialTouch;
/// ```
/// use dermis::Skin;
/// use dermis::body::{Taxels, Transform};
/// use dermis::pipeline::Prepared;
///
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// // Positions and normals of the pixels, on a link that carries the skin 30 mm above its origin.
/// let taxels = Taxels::of(&prepared.map, &prepared.skin.surface()).in_frame(&Transform::shift([0.0, 0.0, 0.03]));
/// assert_eq!(taxels.len(), prepared.map.inside_count());
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_body::Taxels;

/// ```
/// use dermis::Skin;
/// use dermis::body::{ForceEstimate, Press, Transform, Wrench};
///
/// let surface = Skin::open("healing-square")?.surface();
/// let force = ForceEstimate { force_n: 2.0, sigma_n: 0.2 };
/// let press = Press { position_m: [0.01, 0.0], covariance_m2: [[1e-6, 0.0], [0.0, 1e-6]], force };
/// let wrench = Wrench::of(&press, &surface, &Transform::shift([0.0; 3]), [0.0; 3]);
/// // 2 N against the outward normal, 10 mm from the centre.
/// assert!((wrench.force_n[2] + 2.0).abs() < 1e-12 && (wrench.torque_nm[1] - 0.02).abs() < 1e-12);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_body::Wrench;
/// Shown with [`Wrench`].
pub use dermis_body::{ForceEstimate, Press};

#[cfg(feature = "foxglove")]
pub use crate::body_run::mount_pose;
pub use crate::body_run::{
    BodyRunOptions, BodyWatch, JointSnapshot, JointsState, NetWrench, OpenPublisher, PatchHealth, PatchReport,
    PatchState, StartingPatch, TouchInFrames, check_patch_files,
};

/// ```
/// use dermis::body::GuardAddress;
///
/// let address: GuardAddress = "tcp://127.0.0.1:5005".parse()?;
/// assert!("tcp://8.8.8.8:5005".parse::<GuardAddress>().is_err(), "verdicts stay on this machine");
/// # drop(address);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub use dermis_record::guard_socket::GuardAddress;

/// No example: a value of [`BodyRunOptions`], with the feature `foxglove`.
#[cfg(feature = "foxglove")]
pub use dermis_record::foxglove::FoxgloveAddress;
/// No example: values of [`BodyRunOptions`] and of [`BodyRun::close_ros2`](crate::BodyRun::close_ros2), with the
/// feature `ros2`.
#[cfg(feature = "ros2")]
pub use dermis_record::ros2::{Ros2Options, Ros2Summary};
