//! The live page for a frame loop run by another program.

use std::net::{Ipv4Addr, SocketAddr};

use crossbeam_channel::Receiver;
use dermis::source::TwinControl;
use dermis_device::Frame;
use dermis_device::acquire::Acquisition;
use dermis_live::pipeline::Pipeline;
use dermis_live::skin_frame::SkinFrame;
use dermis_record::RecordingHead;

use super::run::{Running, source};
use crate::page::{PageOptions, Request, ServerHandle};

/// The page of `dermis run` for a program's own frame loop. For each frame, call the methods in this order:
/// [`LivePage::answer`], [`LivePage::record`], [`LivePage::show`], [`LivePage::after`].
pub struct LivePage {
    run: Running,
    requests: Receiver<Request>,
    server: ServerHandle,
}

impl LivePage {
    /// Serves the page on this machine; port 0 takes a free one. Recordings made from the page start with `head`.
    ///
    /// # Errors
    /// The port is not available.
    pub fn serve(
        port: u16,
        twin: Option<TwinControl>,
        head: RecordingHead,
        pipeline: &Pipeline,
    ) -> anyhow::Result<Self> {
        let run = Running::new(twin, head, pipeline);
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let (server, requests) = run.serve(address, PageOptions::default(), pipeline)?;
        Ok(Self { run, requests, server })
    }

    /// The page's address for a browser.
    pub fn url(&self) -> String {
        self.server.url()
    }

    /// Asks the desktop to open the page; without a desktop, does nothing.
    pub fn open_browser(&self) {
        source::open_browser(&self.url());
    }

    /// Carries out the pages' requests; call it before every frame.
    pub fn answer(&mut self, pipeline: &mut Pipeline) {
        self.run.answer_all(&self.requests, pipeline);
    }

    /// Call this when no frame arrived.
    ///
    /// # Errors
    /// [`dermis_page::UpdateError`], which the pipeline never causes.
    pub fn wait(&mut self, acquisition: &Acquisition) -> anyhow::Result<()> {
        self.run.wait(acquisition)
    }

    /// Records a frame; call it before processing.
    pub fn record(&mut self, frame: &Frame) {
        self.run.record(frame);
    }

    /// Shows the results of the frame.
    pub fn show(&mut self, output: &SkinFrame<'_>) {
        self.run.show(output);
    }

    /// Updates the page from the pipeline after a frame. `renewed` is the frame's wall-clock time if a new baseline
    /// has just been taken.
    ///
    /// # Errors
    /// As for [`LivePage::wait`].
    pub fn after(
        &mut self,
        acquisition: &Acquisition,
        pipeline: &Pipeline,
        renewed: Option<u64>,
    ) -> anyhow::Result<()> {
        self.run.after(acquisition, pipeline, renewed)
    }

    /// Tells the page, which stays open, that there will be no more frames.
    ///
    /// # Errors
    /// As for [`LivePage::wait`].
    pub fn end(&mut self) -> anyhow::Result<()> {
        self.run.end()
    }

    /// Stops a running recording and closes the page.
    pub fn close(mut self) {
        self.run.stop_recording();
        self.server.shutdown();
    }
}
