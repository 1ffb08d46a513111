//! A running body as other threads see it: its patches' health and its joints, which may be set by hand. The program's
//! own publishers are opened with it.

use std::sync::Arc;

use dermis_body::{Body, JointValues};
use dermis_live::pipeline::Pipeline;
use dermis_record::Publisher;

use super::joints::{JointFeed, JointSnapshot, rest_where_unknown};
use super::patch::SharedHealth;
use super::report::PatchHealth;
use crate::source::TwinControl;

/// A running body, seen from any thread. Clones see the same body.
///
/// No example: [`OpenPublisher`] gets one.
#[derive(Clone, Debug)]
pub struct BodyWatch {
    body: Arc<Body>,
    joints: JointFeed,
    health: Vec<SharedHealth>,
}

/// A patch that is about to run.
///
/// No example: [`OpenPublisher`] gets one.
#[derive(Clone, Copy, Debug)]
pub struct StartingPatch<'a> {
    /// Its number in the body file.
    pub number: usize,
    /// Its pipeline, which has seen no frame.
    pub pipeline: &'a Pipeline,
    /// Control over its twin, if it is one.
    pub twin: Option<&'a TwinControl>,
}

/// Opens the publisher of a patch, if it gets one. The publisher moves to the patch's thread.
///
/// No example: for programs that publish a body in a way of their own, with
/// [`BodyRun::start_with`](super::BodyRun::start_with).
pub type OpenPublisher<'a> = dyn FnMut(&BodyWatch, StartingPatch<'_>) -> Option<Box<dyn Publisher>> + 'a;

impl BodyWatch {
    pub(super) fn new(body: &Arc<Body>, joints: &JointFeed, health: &[SharedHealth]) -> Self {
        Self { body: body.clone(), joints: joints.clone(), health: health.to_vec() }
    }

    /// The body.
    pub fn body(&self) -> &Arc<Body> {
        &self.body
    }

    /// State of every patch, in the order of the body file.
    pub fn health(&self) -> Vec<PatchHealth> {
        self.health.iter().map(SharedHealth::get).collect()
    }

    /// Joint values at a time on the host's monotonic clock, nanoseconds.
    pub fn joints_at(&self, now_ns: u64) -> JointSnapshot {
        self.joints.at(now_ns)
    }

    /// The problem with the source of joint values, if any.
    pub fn joints_problem(&self) -> Option<String> {
        self.joints.problem()
    }

    /// True if joints are set by [`BodyWatch::set_joint`]: their source is `page`.
    pub fn sets_joints(&self) -> bool {
        self.joints.is_set_by_hand()
    }

    /// Sets a joint, radians or metres.
    ///
    /// # Errors
    /// The reason for refusing it: the joints have another source, there is no such joint, or its value isn't finite.
    pub fn set_joint(&self, joint: &str, value: f64) -> Result<(), String> {
        self.joints.set(joint, value)
    }

    /// The values, with joints of unknown value at rest: a posture to draw.
    pub fn posture(&self, values: &JointValues) -> JointValues {
        rest_where_unknown(&self.body, values)
    }
}
