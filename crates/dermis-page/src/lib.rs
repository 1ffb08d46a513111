//! Data and commands of the live page, independent of the transport: a server's WebSocket, or the page's own module.
//!
//! [`feed::PageFeed`] refills an [`Update`] from the pipeline's results for a frame, and [`protocol`] turns it into
//! the page's messages, which `docs/src/page-protocol.md` describes. [`Command`] is a request from the page, checked
//! against the [`Scene`]. Times are arguments: nothing here reads a clock, or opens a file or a socket.
//!
//! ```
//! use dermis_page::{Image, Update, protocol};
//!
//! let image = Image { rows: 1, cols: 2, values: vec![0.5, f32::NAN] };
//! let update = Update { frame: 7, image, ..Update::default() };
//! update.check()?;
//! let messages = protocol::Encoded::new(1, &update);
//! assert_eq!(messages.image.len(), 32 + 2 * 4);
//! # Ok::<(), dermis_page::UpdateError>(())
//! ```

mod announcer;
mod body_scene;
mod body_state;
mod command;
mod error;
pub mod feed;
pub mod message;
pub mod protocol;
mod scene;
#[cfg(test)]
mod schema_text;
mod skin_scene;
mod update;
#[cfg(test)]
mod words;

pub use announcer::Announcer;
pub use body_scene::{
    BodyScene, GeometryView, JointView, LinkView, PatchView, Pose, RimView, RunningPatchView, ShapeView, SurfaceView,
};
pub use body_state::{BodyState, BodyTouchView, JointsView, LinkPoseView, PatchStateView, PlacedTouchView};
pub use command::{BodyCommand, Command, PatchCommand, Press};
pub use error::UpdateError;
pub use scene::{ElectrodeView, GridView, PressLimits, Scene};
pub use skin_scene::{rings, scene};
pub use update::{
    BaselineRow, ChannelValues, ClassImage, Counter, DamageRow, DamageView, FaultView, FrameFaultView, GuardView,
    HealthView, Image, OtherPlaceView, PipelineState, ProposalView, SourceState, StageLatency, TareState, TouchPhase,
    TouchView, Update,
};
