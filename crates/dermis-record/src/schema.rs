//! Topics of a recording and the ROS 2 definitions (`ros2msg`) of their messages. With these in the file, readers
//! that know nothing of dermis can decode every message. Our own definitions are the files of the ROS package in
//! `dermis_msgs`.

/// Topics.
pub(super) const FRAMES: &str = "/dermis/frames";
pub(super) const BASELINES: &str = "/dermis/baselines";
pub(super) const TOUCHES: &str = "/dermis/touches";
pub(super) const EVENTS: &str = "/dermis/events";
pub(super) const IMAGE: &str = "/dermis/image";
pub(super) const POINTS: &str = "/dermis/points";
pub(super) const TOUCH_POINTS: &str = "/dermis/touch_points";

/// Joint values, in recordings of bodies.
pub(super) const JOINTS: Schema =
    Schema { topic: "/joint_states", name: "sensor_msgs/msg/JointState", parts: &[JOINT_STATE, HEADER, TIME] };

/// Prefix of every topic of dermis.
const DERMIS: &str = "/dermis/";

/// A topic of one patch, if the recording is of a body: `/dermis/PATCH/frames`.
pub(super) fn topic_of(topic: &str, patch: Option<&str>) -> String {
    match (patch, topic.strip_prefix(DERMIS)) {
        (Some(patch), Some(rest)) => format!("{DERMIS}{patch}/{rest}"),
        _ => topic.to_owned(),
    }
}

/// The topic's name if the patch were recorded alone. Topics of other patches keep their names.
pub(super) fn topic_alone(topic: &str, patch: Option<&str>) -> String {
    let rest = patch.and_then(|patch| topic.strip_prefix(DERMIS)?.strip_prefix(patch)?.strip_prefix('/'));
    rest.map_or_else(|| topic.to_owned(), |rest| format!("{DERMIS}{rest}"))
}

/// Name of a metadata record of one patch, if the recording is of a body: `dermis.skin/PATCH`.
pub(super) fn name_of(name: &str, patch: Option<&str>) -> String {
    patch.map_or_else(|| name.to_owned(), |patch| format!("{name}/{patch}"))
}

/// A type of messages.
pub(super) struct Schema {
    pub(super) topic: &'static str,
    pub(super) name: &'static str,
    /// The definition, followed by those of the types it uses.
    pub(super) parts: &'static [&'static str],
}

/// Messages in every recording.
pub(super) const OWN: [Schema; 4] = [
    Schema { topic: FRAMES, name: "dermis_msgs/msg/Frame", parts: &[FRAME] },
    Schema { topic: BASELINES, name: "dermis_msgs/msg/Baseline", parts: &[BASELINE] },
    Schema { topic: TOUCHES, name: "dermis_msgs/msg/Touches", parts: TOUCHES_PARTS },
    Schema { topic: EVENTS, name: "dermis_msgs/msg/Event", parts: &[EVENT, HEADER, TIME] },
];

/// Messages that viewers draw.
pub(super) const STANDARD: [Schema; 3] = [
    Schema { topic: IMAGE, name: "sensor_msgs/msg/Image", parts: &[IMAGE_OF_ROS, HEADER, TIME] },
    Schema { topic: POINTS, name: "sensor_msgs/msg/PointCloud2", parts: &[POINT_CLOUD, POINT_FIELD, HEADER, TIME] },
    Schema {
        topic: TOUCH_POINTS,
        name: "sensor_msgs/msg/PointCloud2",
        parts: &[POINT_CLOUD, POINT_FIELD, HEADER, TIME],
    },
];

const TOUCHES_PARTS: &[&str] = &[TOUCHES_OF_A_FRAME, TOUCH, OTHER_PLACE, HEADER, TIME];

impl Schema {
    /// The text of the schema: the definition, then each further one under a heading `MSG: package/Type` after a
    /// line of 80 equals signs.
    pub(super) fn text(&self) -> String {
        self.parts.join(&format!("{}\n", "=".repeat(80)))
    }
}

const FRAME: &str = include_str!("../dermis_msgs/msg/Frame.msg");

const BASELINE: &str = include_str!("../dermis_msgs/msg/Baseline.msg");

const TOUCHES_OF_A_FRAME: &str = include_str!("../dermis_msgs/msg/Touches.msg");

const TOUCH: &str = concat!("MSG: dermis_msgs/Touch\n", include_str!("../dermis_msgs/msg/Touch.msg"));

const OTHER_PLACE: &str = concat!("MSG: dermis_msgs/OtherPlace\n", include_str!("../dermis_msgs/msg/OtherPlace.msg"));

const EVENT: &str = include_str!("../dermis_msgs/msg/Event.msg");

const JOINT_STATE: &str = "\
std_msgs/Header header
string[] name
float64[] position  # radians, of sliding joints metres
float64[] velocity
float64[] effort
";

const IMAGE_OF_ROS: &str = "\
std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
";

const POINT_CLOUD: &str = "\
std_msgs/Header header
uint32 height
uint32 width
sensor_msgs/PointField[] fields
bool is_bigendian
uint32 point_step
uint32 row_step
uint8[] data
bool is_dense
";

const POINT_FIELD: &str = "\
MSG: sensor_msgs/PointField
uint8 INT8=1
uint8 UINT8=2
uint8 INT16=3
uint8 UINT16=4
uint8 INT32=5
uint8 UINT32=6
uint8 FLOAT32=7
uint8 FLOAT64=8
string name
uint32 offset
uint8 datatype
uint32 count
";

const HEADER: &str = "\
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
";

const TIME: &str = "\
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";
