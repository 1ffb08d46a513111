//! Skins mounted on a robot: the positions of its links and the touches on them, in every frame of reference.
//!
//! A body file names a robot's URDF file and mounts skins on its links. [`Body`] reads it, [`Kinematics`] gives the
//! poses of the links for given joint values, [`SpatialTouch`] transforms a touch into any frame, and [`Wrench`] sums
//! touches to a force and a torque with their covariance.
//!
//! ```
//! use dermis_body::{Body, SpatialTouch, Taxels};
//!
//! # let folder = tempfile::tempdir()?;
//! # let file = folder.path().join("arm.toml");
//! # std::fs::write(folder.path().join("arm.urdf"), r#"<robot name="arm"><link name="base"/><link name="forearm"/>
//! #   <joint name="elbow" type="revolute"><parent link="base"/><child link="forearm"/><origin xyz="0 0 0.3"/>
//! #   <axis xyz="0 1 0"/></joint></robot>"#)?;
//! # std::fs::write(&file, r#"
//! urdf = "arm.urdf"
//!
//! [[patch]]
//! name = "outer"
//! skin = "healing-square"
//! link = "forearm"
//! xyz_mm = [100, 0, 30]
//! rpy_deg = [0, 0, 90]
//! # "#.replace("//! ", ""))?;
//! let body = Body::open(&file)?;
//! let mut joints = body.kinematics.unknown();
//! assert!(body.root_from_patch(0, &joints).is_none(), "the elbow's angle is unknown");
//! body.kinematics.assign(&mut joints, "elbow", 0.0)?;
//! let root_from_patch = body.root_from_patch(0, &joints).expect("now it is known");
//! let position_m = root_from_patch.point_m([0.010, -0.005, 0.0]);
//! assert!((position_m[0] - 0.105).abs() < 1e-12 && (position_m[2] - 0.33).abs() < 1e-12);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Frames
//! The *patch's* frame is the skin's: x right, y up, z out of the skin towards whatever touches it, origin at the
//! centre of the sheet. The *link's* frame is defined by the URDF file; the *root* is the link without a parent
//! joint. `a_from_b` transforms coordinates in b to coordinates in a. Lengths are metres, angles radians.
//! Forces and wrenches act on the sensor: a press pushes against the outward normal.

mod body;
mod body_file;
mod error;
mod files;
pub mod joint_lines;
mod joint_source;
mod kinematics;
mod mesh_file;
mod space;
mod transform;
pub mod urdf;
mod wrench;

pub use body::{Body, MOST_PATCHES, ONLY_LINK, Patch, Problem, mount_transform};
pub use body_file::{DEMO_FILES, is_body_file};
pub use error::Error;
pub use joint_source::JointSource;
pub use kinematics::{Assigned, JointValues, Kinematics};
pub use mesh_file::read_triangles;
pub use space::{ForceEstimate, SpatialTouch, Taxels, trusted_force};
pub use transform::{Matrix, Transform, Vector};
pub use wrench::{Matrix6, Press, Wrench, presses};
