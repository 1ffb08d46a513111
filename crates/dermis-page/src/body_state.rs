//! The content of a body's page at one moment: joints, links, and every patch with its touches.

use std::collections::BTreeMap;

use dermis_tomo::mesh::Point;
use serde::Serialize;

use crate::body_scene::Pose;
use crate::update::{GuardView, TouchPhase};

/// Everything that the page of a body shows at one moment, except the images.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BodyState {
    /// Time on the host's monotonic clock, nanoseconds, as text because it exceeds exact JSON numbers.
    pub monotonic_ns: String,
    /// Values of the joints.
    pub joints: JointsView,
    /// Poses of the links in the root's frame, by number.
    pub links: Vec<LinkPoseView>,
    /// The patches, by number.
    pub patches: Vec<PatchStateView>,
    /// Net force (newtons) and torque (newton metres) on the body in the root's frame, about its origin; `None` while a
    /// part of it is unknown.
    pub body_wrench: Option<[[f64; 3]; 2]>,
}

/// Values of the joints.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct JointsView {
    /// `fresh`, `stale` or `fixed`.
    pub state: &'static str,
    /// Seconds since the source sent them.
    pub age_s: Option<f64>,
    /// The problem with their source.
    pub problem: Option<String>,
    /// Radians or metres; `None` if no source has given it.
    pub values: BTreeMap<String, Option<f64>>,
}

/// Pose of a link.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LinkPoseView {
    /// Its pose in the root's frame. Joints of unknown value are drawn at rest, and stale ones where they last were.
    /// `None` behind a joint that moves in several directions.
    pub root_from_link: Option<Pose>,
    /// True if every joint on the way is known and not stale.
    pub is_known: bool,
}

/// One patch.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PatchStateView {
    /// `starting`, `running`, `silent`, `ended` or `failed`.
    pub state: &'static str,
    /// The reason why it has failed, or why no frames arrive.
    pub problem: Option<String>,
    /// Number of the frame that is shown.
    pub frame: u64,
    /// Frames per second that leave its pipeline.
    pub fps: f32,
    /// Frames processed.
    pub frames: u64,
    /// Frames lost, damaged or dropped.
    pub lost: u64,
    /// Channels left out because of faults.
    pub channels_left_out: usize,
    /// 99th percentile of the time from a frame's first byte to its touches, milliseconds.
    pub latency_p99_ms: f64,
    /// True while its twin shows touches by itself when nobody presses.
    pub demonstrates: bool,
    /// The guard's verdict, if it has a guard.
    pub guard: Option<GuardView>,
    /// Its touches.
    pub touches: Vec<BodyTouchView>,
}

/// One touch.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct BodyTouchView {
    /// Permanent number of the touch on its patch.
    pub id: u64,
    /// Phase.
    pub phase: TouchPhase,
    /// Position on the flattened sheet, millimetres.
    pub sheet_mm: Point,
    /// Fitted radius, or else the radius of a disc of its area, millimetres; `None` if unknown.
    pub radius_mm: Option<f64>,
    /// Magnitude of the force, newtons, if it can be trusted.
    pub force_n: Option<f64>,
    /// Standard deviation of the force, newtons.
    pub sigma_force_n: Option<f64>,
    /// The touch in the patch's frame.
    pub in_patch: PlacedTouchView,
    /// The touch in the root's frame; `None` while joints are unknown or stale.
    pub in_root: Option<PlacedTouchView>,
}

/// A touch in a frame of reference.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct PlacedTouchView {
    /// Position, millimetres.
    pub position_mm: [f64; 3],
    /// Standard deviations along x, y and z, millimetres.
    pub sigma_mm: [f64; 3],
    /// Outward unit normal of the skin.
    pub normal: [f64; 3],
    /// Force on the sensor, against the normal, newtons.
    pub force_n: Option<[f64; 3]>,
}
