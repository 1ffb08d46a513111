//! Topics of a recording and the ROS 2 definitions (`ros2msg`) of what stands at them. With these in the file, readers
//! that have never heard of dermis decode every message.

/// Topics.
pub(super) const FRAMES: &str = "/dermis/frames";
pub(super) const BASELINES: &str = "/dermis/baselines";
pub(super) const TOUCHES: &str = "/dermis/touches";
pub(super) const EVENTS: &str = "/dermis/events";
pub(super) const IMAGE: &str = "/dermis/image";
pub(super) const POINTS: &str = "/dermis/points";
pub(super) const TOUCH_POINTS: &str = "/dermis/touch_points";

/// A type of messages.
pub(super) struct Schema {
    pub(super) topic: &'static str,
    pub(super) name: &'static str,
    /// The definition, then those of the types it is made of.
    pub(super) parts: &'static [&'static str],
}

/// What every recording has.
pub(super) const OWN: [Schema; 4] = [
    Schema { topic: FRAMES, name: "dermis_msgs/msg/Frame", parts: &[FRAME] },
    Schema { topic: BASELINES, name: "dermis_msgs/msg/Baseline", parts: &[BASELINE] },
    Schema { topic: TOUCHES, name: "dermis_msgs/msg/Touches", parts: &[TOUCHES_OF_A_FRAME, TOUCH, OTHER_PLACE] },
    Schema { topic: EVENTS, name: "dermis_msgs/msg/Event", parts: &[EVENT] },
];

/// What viewers draw.
pub(super) const STANDARD: [Schema; 3] = [
    Schema { topic: IMAGE, name: "sensor_msgs/msg/Image", parts: &[IMAGE_OF_ROS, HEADER, TIME] },
    Schema { topic: POINTS, name: "sensor_msgs/msg/PointCloud2", parts: &[POINT_CLOUD, POINT_FIELD, HEADER, TIME] },
    Schema {
        topic: TOUCH_POINTS,
        name: "sensor_msgs/msg/PointCloud2",
        parts: &[POINT_CLOUD, POINT_FIELD, HEADER, TIME],
    },
];

impl Schema {
    /// The text of the schema: the definition, and each further one under a heading `MSG: package/Type` that follows a
    /// line of 80 equals signs.
    pub(super) fn text(&self) -> String {
        self.parts.join(&format!("{}\n", "=".repeat(80)))
    }
}

const FRAME: &str = "\
# One frame as the instrument sent it, before any processing.
uint64 sequence  # the device's number of the frame; gaps are lost frames
bool has_device_time
uint64 device_time_ns  # the device's clock, 0 without one
uint64 host_monotonic_ns  # first byte, the host's monotonic clock
uint64 host_wall_ns  # first byte, since 1970-01-01 UTC
float64[] values  # readings in the order and unit of the instrument, NaN where missing
float64[] imaginary  # imaginary parts, empty for instruments without
uint32 status  # flags of the wire, 0 for instruments that state none
int32 gain  # the instrument's own code, -1 where it states none
uint64[] channel_times_ns  # of each reading after device_time_ns, empty for instruments that state none
";

const BASELINE: &str = "\
# What frames are compared with from here on.
uint64 time_ns  # of the frame that completed it, the device's clock where it has one
uint64 frames  # averaged; 0 when given
string origin  # startup, tare, forced-tare, given
string reason
float64[] values  # one a channel of the protocol
float64[] noise_std  # standard deviation of each channel at rest
";

const TOUCHES_OF_A_FRAME: &str = "\
# The touches of a frame, those that ended in it included.
uint64 sequence  # the frame
uint64 host_monotonic_ns  # of the frame
dermis_msgs/Touch[] touches
dermis_msgs/OtherPlace[] other_places  # of touches whose place is in doubt
";

const TOUCH: &str = "\
MSG: dermis_msgs/Touch
uint64 id
string phase  # begin, move, end
float64 x_m
float64 y_m
float64 amplitude  # of the image
float64 area_m2
float64 sigma_x_m
float64 sigma_y_m
float64 force_n  # NaN without calibration
string force_range  # within, below, above, saturated, none; empty without calibration
float64 radius_m  # NaN where none was fitted
";

const OTHER_PLACE: &str = "\
MSG: dermis_msgs/OtherPlace
uint64 id  # of the touch
float64 x_m
float64 y_m
float64 sigma_x_m  # if it is there
float64 sigma_y_m
float64 probability  # that it is
";

const EVENT: &str = "\
# Something that happened before the next frame.
string event
string detail
float64[] values
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
