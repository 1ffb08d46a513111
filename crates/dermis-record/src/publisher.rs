//! The interface for publishing a running patch to other programs. A publisher sees the frames, their results and the
//! state of the stream, and passes on requests. Nothing here may wait for a reader.

use dermis_device::Frame;
use dermis_device::acquire::AcquisitionCounters;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;

use super::live_request::LiveRequest;

/// Force (newtons) on the sensor and torque (newton metres).
pub type ForceAndTorque = [[f64; 3]; 2];

/// Publishes one patch.
pub trait Publisher: Send {
    /// Takes a raw frame before it is processed.
    fn frame(&mut self, frame: &Frame);

    /// Takes the results of a frame.
    fn results(&mut self, output: &SkinFrame<'_>);

    /// Takes the state after a frame.
    fn state(&mut self, pipeline: &Pipeline, counters: AcquisitionCounters);

    /// Called while no frame comes, with the reason if it is known.
    fn idle(&mut self, problem: Option<&str>);

    /// Takes the net wrenches of the last results: on the patch's link, in the link's frame about its origin, and on
    /// the body, in the root's; each `None` if unknown. Called for bodies, not for single skins.
    fn wrenches(&mut self, on_link: Option<ForceAndTorque>, on_body: Option<ForceAndTorque>);

    /// Takes an event that is not in the results, such as a tare: its name, a description and its numbers.
    fn event(&mut self, event: &str, detail: &str, values: &[f64]);

    /// The next command, if a reader has sent one.
    fn take_request(&mut self) -> Option<LiveRequest>;
}
