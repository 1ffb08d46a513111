//! The topics of a node: names, types and quality of service.

use super::participant::Quality;

/// A topic below the name of the node, of a patch or of a link.
#[derive(Clone, Copy, Debug)]
pub(super) struct Topic {
    pub name: &'static str,
    pub kind: &'static str,
    pub quality: Quality,
}

/// The topics of each patch, as indices into [`PATCH_TOPICS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub(super) enum OfPatch {
    Shape,
    Points,
    Image,
    TouchPoints,
    Touches,
    Wrenches,
    Wrench,
    Events,
    Guard,
}

const fn topic(name: &'static str, kind: &'static str, quality: Quality) -> Topic {
    Topic { name, kind, quality }
}

/// The topics of each patch, in the order of [`OfPatch`].
pub(super) const PATCH_TOPICS: [Topic; 9] = [
    topic("patch", "dermis_msgs/msg/Patch", Quality::Latched),
    topic("points", "sensor_msgs/msg/PointCloud2", Quality::Sensor),
    topic("image", "sensor_msgs/msg/Image", Quality::Sensor),
    topic("touch_points", "sensor_msgs/msg/PointCloud2", Quality::Sensor),
    topic("touches", "dermis_msgs/msg/Touches", Quality::Reliable),
    topic("wrenches", WRENCH.kind, Quality::Reliable),
    WRENCH,
    topic("events", "dermis_msgs/msg/Event", Quality::Reliable),
    topic("guard", "dermis_msgs/msg/Guard", Quality::Reliable),
];

/// The net wrench on a patch, a link or the body.
pub(super) const WRENCH: Topic = topic("wrench", "geometry_msgs/msg/WrenchStamped", Quality::Reliable);

/// Topics with fixed names.
pub(super) const DIAGNOSTICS: Topic = topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", Quality::Reliable);
pub(super) const TF: Topic = topic("/tf", "tf2_msgs/msg/TFMessage", Quality::Reliable);
pub(super) const TF_STATIC: Topic = topic("/tf_static", "tf2_msgs/msg/TFMessage", Quality::Latched);

/// Name and type of the service that tares a patch.
pub(super) const TARE: (&str, &str) = ("tare", "std_srvs/srv/Trigger");
