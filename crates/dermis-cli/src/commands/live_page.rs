//! The live page of frames that somebody else runs, one after the other.

use std::net::{Ipv4Addr, SocketAddr};

use crossbeam_channel::Receiver;
use dermis::device::acquire::Acquisition;
use dermis::live::output::Output;
use dermis::live::pipeline::Pipeline;
use dermis::record::RecordingHead;
use dermis::source::TwinControl;
use dermis_device::Frame;

use super::run::{Running, source};
use crate::page::{PageOptions, Request, ServerHandle};

/// The page that `dermis run` has, of a program's own loop over frames. Its methods are called in the order of a
/// frame: [`LivePage::answer`], [`LivePage::record`], [`LivePage::show`], [`LivePage::after`].
pub struct LivePage {
    run: Running,
    requests: Receiver<Request>,
    server: ServerHandle,
}

impl LivePage {
    /// Serves the page on this machine; port 0 takes a free one. What is recorded from the page begins with `head`.
    ///
    /// # Errors
    /// A port that cannot be had.
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

    /// What to open in a browser.
    pub fn url(&self) -> String {
        self.server.url()
    }

    /// Asks the desktop to show it; without a desktop nothing happens.
    pub fn open_browser(&self) {
        source::open_browser(&self.url());
    }

    /// Does what pages have asked for: before every frame.
    pub fn answer(&mut self, pipeline: &mut Pipeline) {
        self.run.answer_all(&self.requests, pipeline);
    }

    /// No frame came.
    ///
    /// # Errors
    /// None that a pipeline gives cause for.
    pub fn wait(&mut self, acquisition: &Acquisition) -> anyhow::Result<()> {
        self.run.wait(acquisition)
    }

    /// A frame before anything is made of it.
    pub fn record(&mut self, frame: &Frame) {
        self.run.record(frame);
    }

    /// What came of it.
    pub fn show(&mut self, output: &Output<'_>) {
        self.run.show(output);
    }

    /// The pipeline after it; `renewed`: the frame's wall clock, where a new baseline stands since.
    ///
    /// # Errors
    /// As [`LivePage::wait`].
    pub fn after(
        &mut self,
        acquisition: &Acquisition,
        pipeline: &Pipeline,
        renewed: Option<u64>,
    ) -> anyhow::Result<()> {
        self.run.after(acquisition, pipeline, renewed)
    }

    /// There will be no more frames; the page stays and says so.
    ///
    /// # Errors
    /// As [`LivePage::wait`].
    pub fn end(&mut self) -> anyhow::Result<()> {
        self.run.end()
    }

    /// Ends a recording that goes on, and the page.
    pub fn close(mut self) {
        self.run.stop_recording();
        self.server.shutdown();
    }
}
