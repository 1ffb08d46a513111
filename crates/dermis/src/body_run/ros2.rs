//! The ROS 2 node of a running body: its patches, and the transforms between its links.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use dermis_body::{Body, JointValues};
use dermis_device::HostStamp;
use dermis_live::pipeline::Pipeline;
use dermis_record::ros2::{NamedTransform, NodeHead, PatchHead, Ros2Node, Ros2Options, TransformPublisher};

use super::joints::{JointFeed, JointsState};
use crate::error::Error;

/// Interval between transforms of moving joints: as robot_state_publisher sends them.
const TRANSFORMS_EVERY: Duration = Duration::from_millis(20);

/// A patch that is about to run: its number in the body file, its pipeline, and where its frames come from.
pub(super) type ReadyPatch<'a> = (usize, &'a Pipeline, &'a str);

/// Opens a node for these patches, whose publishers come in the same order.
pub(super) fn open(
    options: &Ros2Options,
    body: &Body,
    joints: &JointFeed,
    ready: &[ReadyPatch<'_>],
) -> Result<Ros2Node, Error> {
    let head = |(number, pipeline, source): &ReadyPatch<'_>| {
        let patch = &body.patches[*number];
        let link = body.kinematics.link_name(patch.link);
        PatchHead::new(pipeline, &frame_of(body, *number), source)
            .named(&patch.name)
            .on_link(link, patch.link_from_patch)
    };
    let values = joints.at(HostStamp::now().monotonic_ns);
    let never_move = match values.state {
        JointsState::Fixed => values.values,
        JointsState::Fresh | JointsState::Stale => body.kinematics.unknown(),
    };
    let fixed = if joints.is_of_ros() { Vec::new() } else { transforms(body, &never_move) };
    let patches = ready.iter().map(head).collect();
    let head = NodeHead { patches, root: Some(body.root().to_owned()), fixed };
    Ok(Ros2Node::open(options, head)?)
}

/// Frame of reference of a patch: its name, with `_skin` after it if a link has that name too.
fn frame_of(body: &Body, patch: usize) -> String {
    let mut frame = body.patches[patch].name.clone();
    let is_taken = |frame: &str| {
        let is_patch = body.patches.iter().enumerate().any(|(other, row)| other != patch && row.name == frame);
        is_patch || body.kinematics.link(frame).is_some()
    };
    while is_taken(&frame) {
        frame.push_str("_skin");
    }
    frame
}

/// Transforms of the links on the way from the root to the patches whose joints have these values.
fn transforms(body: &Body, joints: &JointValues) -> Vec<NamedTransform> {
    let kinematics = &body.kinematics;
    let (mut seen, mut found) = (BTreeSet::new(), Vec::new());
    for patch in &body.patches {
        let mut link = patch.link;
        while let Some(parent) = kinematics.parent(link).filter(|_| seen.insert(link)) {
            if let Some(parent_from_child) = kinematics.parent_from_link(link, joints) {
                let name = |link: usize| kinematics.link_name(link).to_owned();
                found.push(NamedTransform { parent: name(parent), child: name(link), parent_from_child });
            }
            link = parent;
        }
    }
    found
}

/// Publishes the transforms of moving joints while their values are fresh, until the body stops. With joint values from
/// ROS 2, where robot_state_publisher sends them, there is no such thread.
pub(super) fn follow_joints(
    to: TransformPublisher,
    body: &Arc<Body>,
    joints: &JointFeed,
    stop: &Arc<AtomicBool>,
) -> Result<Option<JoinHandle<()>>, Error> {
    if joints.is_fixed() || joints.is_of_ros() {
        return Ok(None);
    }
    let (body, joints, stop) = (body.clone(), joints.clone(), stop.clone());
    let never_move: BTreeSet<String> =
        transforms(&body, &body.kinematics.unknown()).into_iter().map(|transform| transform.child).collect();
    let thread = std::thread::Builder::new().name("dermis-tf".to_owned());
    let thread = thread.spawn(move || {
        while !stop.load(Ordering::Relaxed) {
            let now = HostStamp::now();
            let values = joints.at(now.monotonic_ns);
            if values.state == JointsState::Fresh {
                let mut moving = transforms(&body, &values.values);
                moving.retain(|transform| !never_move.contains(&transform.child));
                if !moving.is_empty() {
                    to.publish(now.wall_ns, &moving);
                }
            }
            std::thread::sleep(TRANSFORMS_EVERY);
        }
    });
    thread.map(Some).map_err(|source| Error::Thread { what: "tf".to_owned(), source })
}
