//! The Foxglove server of a running body: every patch under its own name, the poses of all links and patches, and the
//! joint values.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use dermis_body::{Body, JointValues, Transform, mount_transform};
use dermis_device::HostStamp;
use dermis_live::pipeline::Pipeline;
use dermis_record::foxglove::{FoxgloveAddress, FoxglovePatch, FoxgloveServer, FramePose};
use dermis_skin::{GuardSettings, Skin};

use super::joints::{JointFeed, JointsState};
use super::patch::Viewer;
use crate::error::Error;

/// Minimum interval between poses, about a frame on a screen.
const POSES_EVERY: Duration = Duration::from_millis(33);
/// Interval at which poses that don't change are repeated.
const REPEAT_EVERY: Duration = Duration::from_secs(1);

/// The server and the thread that publishes poses.
pub(super) struct BodyServer {
    server: Arc<FoxgloveServer>,
    poses: Option<JoinHandle<()>>,
}

impl BodyServer {
    /// Address of the server.
    pub fn address(&self) -> &FoxgloveAddress {
        self.server.address()
    }
}

impl Drop for BodyServer {
    fn drop(&mut self) {
        // The thread has been told to stop. A panic there has been printed.
        let _ = self.poses.take().map(JoinHandle::join);
    }
}

/// Opens the server, if there is an address, for the patches that are ready: their numbers, pipelines and guard limits.
pub(super) fn open<'a>(
    address: Option<&FoxgloveAddress>,
    body: &Arc<Body>,
    joints: &JointFeed,
    stop: &Arc<AtomicBool>,
    ready: impl Iterator<Item = (usize, &'a Pipeline, Option<GuardSettings>)>,
) -> Result<(Option<BodyServer>, Vec<Viewer>), Error> {
    let Some(address) = address else { return Ok((None, Vec::new())) };
    let failed = |source| Error::Foxglove { source };
    let server = Arc::new(FoxgloveServer::open(address, &body.name, true).map_err(failed)?);
    let mut viewers = Vec::new();
    for (number, pipeline, guard) in ready {
        let name = Some(body.patches[number].name.clone());
        let patch = FoxglovePatch { name, frame_id: patch_frame(body, number), mount: None, guard };
        let (feed, requests) = server.patch(patch, pipeline).map_err(failed)?;
        viewers.push(Viewer { patch: number, feed, requests });
    }
    let thread = std::thread::Builder::new().name("dermis-foxglove-poses".to_owned());
    let (there, body, joints, stop) = (server.clone(), body.clone(), joints.clone(), stop.clone());
    let thread = thread.spawn(move || publish_poses(&there, &body, &joints, &stop));
    let poses = thread.map_err(|source| Error::Thread { what: "poses".to_owned(), source })?;
    Ok((Some(BodyServer { server, poses: Some(poses) }), viewers))
}

/// Publishes poses and joint values when they change, and at least once a second, until the body stops.
fn publish_poses(server: &FoxgloveServer, body: &Body, joints: &JointFeed, stop: &AtomicBool) {
    let mut last: Option<(JointValues, Instant)> = None;
    while !stop.load(Ordering::Relaxed) {
        let now = HostStamp::now();
        let snapshot = joints.at(now.monotonic_ns);
        let values = match snapshot.state {
            JointsState::Stale => body.kinematics.unknown(),
            JointsState::Fixed | JointsState::Fresh => snapshot.values,
        };
        let is_due = last.as_ref().is_none_or(|(before, at)| *before != values || at.elapsed() >= REPEAT_EVERY);
        if is_due {
            server.transforms(now.wall_ns, &poses(body, &values));
            let known = |name| Some((name, body.kinematics.value(&values, name)?));
            let known: Vec<(&str, f64)> = body.kinematics.moving_joints().filter_map(known).collect();
            server.joints(now.wall_ns, known.into_iter());
            last = Some((values, Instant::now()));
        }
        std::thread::sleep(POSES_EVERY);
    }
}

/// Poses of the links in their parents, and of the patches in their links. Links behind a joint of unknown value are
/// left out, so they stay where they were.
fn poses(body: &Body, values: &JointValues) -> Vec<FramePose> {
    let kinematics = &body.kinematics;
    let link = |(number, name): (usize, &str)| {
        let parent = kinematics.link_name(kinematics.parent(number)?);
        Some(pose(parent, name, &kinematics.parent_from_link(number, values)?))
    };
    let links = kinematics.link_names().enumerate().filter_map(link);
    let patch = |(number, patch): (usize, &dermis_body::Patch)| {
        pose(kinematics.link_name(patch.link), &patch_frame(body, number), &patch.link_from_patch)
    };
    links.chain(body.patches.iter().enumerate().map(patch)).collect()
}

/// Name of a patch's frame: the patch's own name, with `/skin` after it if a link has the same name.
fn patch_frame(body: &Body, number: usize) -> String {
    let name = &body.patches[number].name;
    frame_beside(name, body.kinematics.link(name).is_some())
}

fn frame_beside(name: &str, is_taken: bool) -> String {
    if is_taken { format!("{name}/skin") } else { name.to_owned() }
}

/// Pose of a single skin on its link, if its file gives one. The frame has the skin's name, with `/skin` after it if
/// the link has the same name.
///
/// No example: only useful with a server of the feature `foxglove`.
pub fn mount_pose(skin: &Skin) -> Option<FramePose> {
    let mount = skin.mount.as_ref()?;
    let xyz_mm_rpy_deg = mount_transform(mount.xyz_mm, mount.rpy_deg);
    Some(pose(&mount.link, &frame_beside(&skin.name, skin.name == mount.link), &xyz_mm_rpy_deg))
}

fn pose(parent: &str, child: &str, parent_from_child: &Transform) -> FramePose {
    FramePose {
        parent: parent.to_owned(),
        child: child.to_owned(),
        translation_m: parent_from_child.translation_m,
        rotation_xyzw: parent_from_child.quaternion(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_skin_on_a_link_of_its_own_name_has_another_frame() {
        let mut skin = Skin::open("healing-square").unwrap();
        assert_eq!(mount_pose(&skin), None);
        let mount =
            dermis_skin::Mount { link: "forearm".into(), xyz_mm: [100.0, 0.0, 30.0], rpy_deg: [0.0, 0.0, 90.0] };
        skin.mount = Some(mount.clone());
        let found = mount_pose(&skin).unwrap();
        assert_eq!((found.parent.as_str(), found.child.as_str()), ("forearm", skin.name.as_str()));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let expected = [0.1, 0.0, 0.03, 0.0, 0.0, half, half];
        let numbers = found.translation_m.into_iter().chain(found.rotation_xyzw);
        assert!(numbers.zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-12), "{found:?}");
        skin.mount = Some(dermis_skin::Mount { link: skin.name.clone(), ..mount });
        assert_eq!(mount_pose(&skin).unwrap().child, format!("{}/skin", skin.name));
    }
}
