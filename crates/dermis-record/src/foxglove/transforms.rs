//! Poses of frames of reference as `foxglove.FrameTransforms`.

use ::foxglove::messages::{FrameTransform, FrameTransforms, Quaternion, Timestamp, Vector3};

/// Pose of a frame of reference in another one, its parent.
#[derive(Clone, Debug, PartialEq)]
pub struct FramePose {
    /// Name of the frame that the pose is given in.
    pub parent: String,
    /// Name of the frame.
    pub child: String,
    /// Origin of the child in the parent, metres.
    pub translation_m: [f64; 3],
    /// Rotation of the child in the parent: a unit quaternion x, y, z, w.
    pub rotation_xyzw: [f64; 4],
}

/// The message for poses at a time.
pub(super) fn message(wall_ns: u64, poses: &[FramePose]) -> FrameTransforms {
    let timestamp = Some(time(wall_ns));
    let transform = |pose: &FramePose| FrameTransform {
        timestamp,
        parent_frame_id: pose.parent.clone(),
        child_frame_id: pose.child.clone(),
        translation: Some(vector(pose.translation_m)),
        rotation: Some(quaternion(pose.rotation_xyzw)),
    };
    FrameTransforms { transforms: poses.iter().map(transform).collect() }
}

/// Wall-clock time in Foxglove's type, which ends in 2106.
pub(super) fn time(wall_ns: u64) -> Timestamp {
    Timestamp::new(u32::try_from(wall_ns / 1_000_000_000).unwrap_or(u32::MAX), (wall_ns % 1_000_000_000) as u32)
}

pub(super) fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

pub(super) fn quaternion([x, y, z, w]: [f64; 4]) -> Quaternion {
    Quaternion { x, y, z, w }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_has_every_pose_at_its_time() {
        let pose = FramePose {
            parent: "forearm".into(),
            child: "outer".into(),
            translation_m: [0.1, 0.0, 0.03],
            rotation_xyzw: [0.0, 0.0, 0.6, 0.8],
        };
        let found = message(1_700_000_000_250_000_000, &[pose]);
        let [first] = &found.transforms[..] else { panic!("{found:?}") };
        assert_eq!((first.parent_frame_id.as_str(), first.child_frame_id.as_str()), ("forearm", "outer"));
        assert_eq!(first.timestamp, Some(Timestamp::new(1_700_000_000, 250_000_000)));
        assert_eq!(first.translation, Some(Vector3 { x: 0.1, y: 0.0, z: 0.03 }));
        assert_eq!(first.rotation, Some(Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 }));
    }
}
