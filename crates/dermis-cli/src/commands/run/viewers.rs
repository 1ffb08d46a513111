//! Live viewers of a run other than the page: options, feeds and requests.

use crossbeam_channel::Receiver;
#[cfg(feature = "foxglove")]
use dermis::body::mount_pose;
use dermis_live::pipeline::Pipeline;
#[cfg(feature = "foxglove")]
use dermis_record::foxglove::{FoxgloveAddress, FoxglovePatch, FoxgloveServer};
use dermis_record::{LiveFeed, LiveRequest};
use dermis_skin::GuardSettings;

use crate::exit::UsageError;

/// Options of viewers.
#[derive(clap::Args)]
pub struct ViewerArguments {
    /// Serve everything live to Foxglove, or to another viewer that speaks its protocol. Without an address this is
    /// 127.0.0.1:8765; port 0 takes a free one. There is no token and no encryption: anyone who can connect can watch
    /// and tare.
    #[cfg(feature = "foxglove")]
    #[arg(long, value_name = "HOST:PORT", num_args = 0..=1, default_missing_value = FoxgloveAddress::DEFAULT)]
    pub foxglove: Option<FoxgloveAddress>,
    #[cfg(not(feature = "foxglove"))]
    #[arg(long, hide = true, num_args = 0..=1, default_missing_value = "")]
    foxglove: Option<String>,
}

impl ViewerArguments {
    /// Refuses a viewer that this build lacks.
    pub fn check(&self) -> Result<(), UsageError> {
        #[cfg(not(feature = "foxglove"))]
        if self.foxglove.is_some() {
            let text = "--foxglove: this dermis was built without it; expected one built with `--features foxglove`";
            return Err(UsageError(text.into()));
        }
        Ok(())
    }
}

/// The viewers of a run. Dropping it ends them.
#[derive(Default)]
pub struct Viewers {
    /// Feeds of the viewers.
    pub feeds: Vec<LiveFeed>,
    requests: Vec<Receiver<LiveRequest>>,
    // Dropped last: its feeds end first.
    #[cfg(feature = "foxglove")]
    _server: Option<FoxgloveServer>,
}

impl Viewers {
    /// Opens the servers that the options ask for. `guard` holds the limits in use.
    #[cfg_attr(not(feature = "foxglove"), allow(unused_variables, reason = "there are no viewers"))]
    pub fn open(
        arguments: &ViewerArguments,
        pipeline: &Pipeline,
        guard: Option<GuardSettings>,
    ) -> anyhow::Result<Self> {
        #[cfg_attr(not(feature = "foxglove"), allow(unused_mut, reason = "there are no viewers"))]
        let mut viewers = Self::default();
        #[cfg(feature = "foxglove")]
        if let Some(address) = &arguments.foxglove {
            let skin = &pipeline.prepared().skin;
            let server = FoxgloveServer::open(address, &skin.name, false)?;
            announce(server.address());
            let mount = mount_pose(skin);
            let frame_id = mount.as_ref().map_or(&skin.name, |mount| &mount.child).clone();
            let (feed, requests) = server.patch(FoxglovePatch { name: None, frame_id, mount, guard }, pipeline)?;
            viewers.feeds.push(feed);
            viewers.requests.push(requests);
            viewers._server = Some(server);
        }
        Ok(viewers)
    }

    /// The viewers' requests that are waiting.
    pub fn requests(&self) -> Vec<LiveRequest> {
        self.requests.iter().flat_map(Receiver::try_iter).collect()
    }

    /// Reports how many frames the viewers missed.
    pub fn report(&self) {
        tell_not_shown(self.feeds.iter().map(|feed| feed.status().dropped).sum());
    }
}

/// Warns that viewers missed frames, while recordings and results are complete.
pub fn tell_not_shown(frames: u64) {
    if frames > 0 {
        tracing::warn!(frames, "frames were not shown to live viewers because of load");
    }
}

/// Prints the server's address, and a warning if other machines can reach it.
#[cfg(feature = "foxglove")]
pub fn announce(address: &FoxgloveAddress) {
    eprintln!("foxglove: ws://{address}");
    if !address.is_loopback() {
        eprintln!("warning: anyone who can reach {address} can watch and tare; Foxglove's protocol has no token");
    }
}
