//! Starts a body from its file: opens the sources of its patches, prepares their skins, starts their threads and
//! delivers their reports.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, bounded};
use dermis_body::{Body, JointSource, Patch};
use dermis_device::HostStamp;
use dermis_device::acquire::Acquisition;
use dermis_live::latency::RecentLatencies;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_record::guard_socket::{GuardAddress, GuardSocket};
#[cfg(feature = "ros2")]
use dermis_record::ros2::{Ros2Node, Ros2Options, Ros2Summary};
use dermis_record::{BodyHead, BodyRecording, LiveRecording, Publisher, RecordingHead, SkinView};
use dermis_skin::{GuardSettings, Skin};
use dermis_touch::guard::GuardReport;

use super::joints::JointFeed;
use super::loads::Loads;
use super::patch::{PatchThread, SharedHealth};
use super::patch_files::PatchFiles;
use super::report::{PatchHealth, PatchReport};
#[cfg(feature = "ros2")]
use super::ros2;
use super::watch::{BodyWatch, OpenPublisher, StartingPatch};
use crate::error::Error;
use crate::source::{SourceOptions, TwinControl, open_source};

/// Frames that may queue between a source and its pipeline, as for a single skin.
const QUEUE: usize = 128;
/// Reports that may queue for their reader.
const REPORTS: usize = 1024;

/// How long a guard line about a patch that was not started stays valid, nanoseconds. Such a line never says `ok`.
const UNSTARTED_STALE_NS: u64 = 1_000_000_000;

/// Minimum interval between recorded joint values: the rate of a fast robot's joint states.
const JOINTS_EVERY: Duration = Duration::from_millis(10);

/// Options for running a body.
///
/// No example here: [`BodyRun`] has one.
#[derive(Clone, Debug, Default)]
pub struct BodyRunOptions {
    /// Speed of files and twins, settings of instruments.
    pub source: SourceOptions,
    /// Source of joint values, overriding the body file's; see [`BodyRun::start`].
    pub joints: Option<JointSource>,
    /// If true, a patch that cannot be started is marked as failed in the health table; otherwise it is an error.
    pub keep_going: bool,
    /// Records every patch and the joint values into this file.
    pub record: Option<PathBuf>,
    /// Adds its JSON line to each report.
    pub lines: bool,
    /// Ends each patch after this many frames.
    pub most_frames: Option<u64>,
    /// Serves every patch and the moving links to Foxglove on this address.
    #[cfg(feature = "foxglove")]
    pub foxglove: Option<dermis_record::foxglove::FoxgloveAddress>,
    /// Publishes the guard's verdict on every frame on this socket. On patches without limits any touch stops.
    pub guard: Option<GuardAddress>,
    /// Publishes every patch as a ROS 2 node.
    #[cfg(feature = "ros2")]
    pub ros2: Option<Ros2Options>,
}

/// A running body.
///
/// ```
/// use std::time::Duration;
///
/// use dermis::body::{BodyRunOptions, PatchReport, PatchState};
/// use dermis::{Body, BodyRun};
///
/// let folder = std::env::temp_dir().join(format!("dermis-run-{}", std::process::id()));
/// # let failed = |source| dermis::FileError { file: folder.clone(), source };
/// # std::fs::create_dir_all(&folder).map_err(failed)?;
/// // A body without a robot: one skin, played by its twin.
/// let file = folder.join("pad.toml");
/// std::fs::write(&file, "[[patch]]\nname = \"pad\"\nskin = \"healing-square\"\nsource = \"twin\"\n").map_err(failed)?;
/// let options = BodyRunOptions { most_frames: Some(40), ..BodyRunOptions::default() };
/// let run = BodyRun::start(Body::open(&file)?, &options)?;
/// while !run.has_ended() {
///     let Some(PatchReport { sequence, touches, .. }) = run.next(Duration::from_millis(100)) else { continue };
///     println!("frame {sequence}: {} touches", touches.len());
/// }
/// let health = run.finish();
/// assert_eq!((&health[0].state, health[0].frames), (&PatchState::Ended, 40));
/// # std::fs::remove_dir_all(&folder).map_err(failed)?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub struct BodyRun {
    body: Arc<Body>,
    joints: JointFeed,
    reports: Receiver<PatchReport>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    joint_threads: Vec<JoinHandle<()>>,
    health: Vec<SharedHealth>,
    twins: Vec<Option<TwinControl>>,
    guard: Option<GuardSocket>,
    #[cfg(feature = "foxglove")]
    foxglove: Option<super::foxglove::BodyServer>,
    #[cfg(feature = "ros2")]
    ros2: Option<Ros2Node>,
}

impl std::fmt::Debug for BodyRun {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("BodyRun")
            .field("body", &self.body.name)
            .field("health", &self.health())
            .finish_non_exhaustive()
    }
}

impl BodyRun {
    /// Opens the source of every patch and starts them together.
    ///
    /// Patches with identical skins share their preparation. Joint values come from a [`JointSource`];
    /// [`JointSource::Page`] leaves them to [`BodyWatch::set_joint`]. Without a source the joints stay as in the body
    /// file, or else at rest.
    ///
    /// # Errors
    /// A patch cannot be started and the options don't say to keep going, or a source of joint values cannot be
    /// opened.
    pub fn start(body: Body, options: &BodyRunOptions) -> Result<Self, Error> {
        Self::start_with(body, options, &mut |_, _| None)
    }

    /// As [`BodyRun::start`], and gives each patch the publisher that `open` returns for it, if any.
    ///
    /// # Errors
    /// As [`BodyRun::start`].
    pub fn start_with(body: Body, options: &BodyRunOptions, open: &mut OpenPublisher<'_>) -> Result<Self, Error> {
        let body = Arc::new(body);
        let stop = Arc::new(AtomicBool::new(false));
        let joint_source = options.joints.as_ref().or(body.joint_source.as_ref());
        let joints = JointFeed::open(&body, joint_source, &stop)?;
        let health: Vec<SharedHealth> = body.patches.iter().map(|patch| SharedHealth::new(&patch.name)).collect();
        let loads = Arc::new(Loads::new(&body));
        let (send, reports) = bounded(REPORTS);
        let mut prepared: Vec<(Skin, Arc<Prepared>)> = Vec::new();
        let (mut ready, mut twins) = (Vec::new(), Vec::new());
        for (number, patch) in body.patches.iter().enumerate() {
            match open_patch(patch, &body, options, &mut prepared) {
                Ok((opened, twin)) => {
                    ready.push((number, opened));
                    twins.push(twin);
                }
                Err(error) if options.keep_going => {
                    let reason = error.to_string();
                    tracing::error!("patch {}: {reason}", patch.name);
                    loads.lose(number, format!("{}: {reason}", patch.name));
                    health[number].fail(reason);
                    twins.push(None);
                }
                Err(source) => {
                    let (patch, source) = (patch.name.clone(), Box::new(source));
                    return Err(Error::Patch { patch, source });
                }
            }
        }
        if ready.is_empty() {
            return Err(Error::NoPatch { body: body.name.clone(), patches: body.patches.len() });
        }
        let (recordings, joint_recorder) = match &options.record {
            Some(path) => start_recording(path, &body, &joints, &stop, &ready)?,
            None => (ready.iter().map(|_| None).collect(), None),
        };
        let guard = options.guard.as_ref().map(|address| open_guard(address, &body, &ready)).transpose()?;
        #[cfg(feature = "foxglove")]
        let (foxglove, mut viewers) = {
            let ready = ready.iter().map(|(number, opened)| (*number, &opened.pipeline, opened.guard));
            super::foxglove::open(options.foxglove.as_ref(), &body, &joints, &stop, ready)?
        };
        #[cfg(not(feature = "foxglove"))]
        let mut viewers: Vec<super::patch::Viewer> = Vec::new();
        let joint_threads = joint_recorder.into_iter().collect();
        let mut run = Self {
            body,
            joints,
            reports,
            stop,
            threads: Vec::new(),
            joint_threads,
            health,
            twins,
            guard,
            #[cfg(feature = "foxglove")]
            foxglove,
            #[cfg(feature = "ros2")]
            ros2: None,
        };
        let mut publishers = run.open_publishers(options, &ready)?;
        let watch = run.watch();
        for ((number, opened), publishers) in ready.iter().zip(&mut publishers) {
            let (number, pipeline) = (*number, &opened.pipeline);
            let patch = StartingPatch { number, pipeline, twin: run.twins[number].as_ref() };
            publishers.extend(open(&watch, patch));
        }
        let silent_links: Vec<usize> = (ready.iter())
            .filter(|(_, opened)| opened.pipeline.force_source().is_none())
            .map(|(number, _)| run.body.patches[*number].link)
            .collect();
        // Started last, so that no frame waits for another patch to be prepared.
        for (((number, opened), recording), publishers) in ready.into_iter().zip(recordings).zip(publishers) {
            let OpenedPatch { source, waits, pipeline, .. } = opened;
            let (feeds, requests) =
                viewers.extract_if(.., |viewer| viewer.patch == number).map(|v| (v.feed, v.requests)).unzip();
            let thread = PatchThread {
                number,
                body: run.body.clone(),
                acquisition: Acquisition::spawn(source, QUEUE, waits),
                waits,
                pipeline,
                joints: run.joints.clone(),
                loads: loads.clone(),
                health: run.health[number].clone(),
                reports: send.clone(),
                stop: run.stop.clone(),
                guard: run.guard.as_ref().map(|socket| socket.publisher(number)),
                recording,
                feeds,
                requests,
                publishers,
                link_tells_forces: !silent_links.contains(&run.body.patches[number].link),
                body_tells_forces: silent_links.is_empty(),
                lines: options.lines,
                most_frames: options.most_frames,
                recent: RecentLatencies::default(),
            };
            let name = &run.body.patches[number].name;
            let builder = std::thread::Builder::new().name(format!("dermis-{name}"));
            let thread = builder.spawn(move || thread.run());
            let name = name.clone();
            run.threads.push(thread.map_err(|source| Error::Thread { what: format!("patch {name}"), source })?);
        }
        Ok(run)
    }

    /// Opens the ROS 2 node, if requested, and returns the publishers of each ready patch.
    #[cfg(feature = "ros2")]
    fn open_publishers(
        &mut self,
        options: &BodyRunOptions,
        ready: &[(usize, OpenedPatch)],
    ) -> Result<Vec<Vec<Box<dyn Publisher>>>, Error> {
        let Some(options) = &options.ros2 else { return Ok(ready.iter().map(|_| Vec::new()).collect()) };
        let patches: Vec<_> =
            ready.iter().map(|(number, opened)| (*number, &opened.pipeline, opened.head.source.as_str())).collect();
        let mut node = ros2::open(options, &self.body, &self.joints, &patches)?;
        self.joint_threads.extend(ros2::follow_joints(node.transforms(), &self.body, &self.joints, &self.stop)?);
        let boxed = |publisher| Box::new(publisher) as Box<dyn Publisher>;
        let publishers = (0..ready.len()).map(|patch| node.publisher(patch).map(boxed).into_iter().collect()).collect();
        self.ros2 = Some(node);
        Ok(publishers)
    }

    /// No publishers: built without ROS 2.
    #[cfg(not(feature = "ros2"))]
    fn open_publishers(
        &mut self,
        _options: &BodyRunOptions,
        ready: &[(usize, OpenedPatch)],
    ) -> Result<Vec<Vec<Box<dyn Publisher>>>, Error> {
        Ok(ready.iter().map(|_| Vec::new()).collect())
    }

    /// Stops every patch, sends what is queued for ROS 2, and returns the numbers of messages if there was a node.
    #[cfg(feature = "ros2")]
    pub fn close_ros2(&mut self) -> Option<Ros2Summary> {
        self.end();
        self.ros2.take().map(Ros2Node::close)
    }

    /// The running body as other threads see it.
    pub fn watch(&self) -> BodyWatch {
        BodyWatch::new(&self.body, &self.joints, &self.health)
    }

    /// The body.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// The next frame of any patch, waiting at most `timeout`.
    pub fn next(&self, timeout: Duration) -> Option<PatchReport> {
        self.reports.recv_timeout(timeout).ok()
    }

    /// True once no patch will yield anything more and every report has been taken.
    pub fn has_ended(&self) -> bool {
        self.threads.iter().all(JoinHandle::is_finished) && self.reports.is_empty()
    }

    /// Address of the guard's socket, if there is one.
    pub fn guard_address(&self) -> Option<&GuardAddress> {
        self.guard.as_ref().map(GuardSocket::address)
    }

    /// Address of the server for Foxglove, if there is one.
    #[cfg(feature = "foxglove")]
    pub fn foxglove_address(&self) -> Option<&dermis_record::foxglove::FoxgloveAddress> {
        self.foxglove.as_ref().map(super::foxglove::BodyServer::address)
    }

    /// State of every patch, in the order of the body file.
    pub fn health(&self) -> Vec<PatchHealth> {
        self.health.iter().map(SharedHealth::get).collect()
    }

    /// The problem with the source of joint values, if any.
    pub fn joints_problem(&self) -> Option<String> {
        self.joints.problem()
    }

    /// Control over a patch's twin, if it is one.
    pub fn twin(&self, patch: usize) -> Option<&TwinControl> {
        self.twins.get(patch)?.as_ref()
    }

    /// Stops every patch, waits for them, and returns how each ended.
    pub fn finish(mut self) -> Vec<PatchHealth> {
        self.end();
        self.health()
    }

    fn end(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads.drain(..).chain(self.joint_threads.drain(..)) {
            // A panic is already in the health table.
            let _ = thread.join();
        }
        #[cfg(feature = "foxglove")]
        drop(self.foxglove.take());
    }
}

impl Drop for BodyRun {
    fn drop(&mut self) {
        self.end();
    }
}

/// A patch that is ready to run.
struct OpenedPatch {
    source: Box<dyn dermis_device::Source>,
    waits: bool,
    pipeline: Pipeline,
    /// The guard's limits in use.
    #[cfg_attr(not(feature = "foxglove"), allow(dead_code, reason = "viewers alone read it"))]
    guard: Option<GuardSettings>,
    head: RecordingHead,
}

fn open_patch(
    patch: &Patch,
    body: &Body,
    options: &BodyRunOptions,
    prepared: &mut Vec<(Skin, Arc<Prepared>)>,
) -> Result<(OpenedPatch, Option<TwinControl>), Error> {
    // Report bad files before the work of preparing a skin.
    let PatchFiles { selector, baseline, calibration, forces } = PatchFiles::read(body, patch, &options.source.read)?;
    let opened = open_source(&selector, &patch.skin, &options.source)?;
    // Mount and guard don't affect what is prepared.
    let skin = Skin { mount: None, guard: None, ..patch.skin.clone() };
    let shared = match prepared.iter().find(|(other, _)| *other == skin) {
        Some((_, shared)) => shared.clone(),
        None => {
            let shared = Arc::new(Prepared::new(skin.clone())?);
            prepared.push((skin, shared.clone()));
            shared
        }
    };
    let mut head = RecordingHead::of(&shared, opened.source.layout().clone(), opened.source.name());
    head.calibration = calibration.as_ref().map(|(_, text)| text.clone());
    head.forces = forces.as_ref().map(|(_, text)| text.clone());
    let guard = patch.skin.guard.or(options.guard.as_ref().map(|_| GuardSettings::default()));
    head.skin_toml = Skin { mount: None, guard, ..patch.skin.clone() }.to_toml();
    let mut pipeline = Pipeline::new(shared, opened.source.layout(), calibration.map(|(calibration, _)| calibration))?;
    pipeline.set_guard(guard)?;
    pipeline.set_live(opened.twin.is_none() && !opened.is_file);
    forces.map_or(Ok(()), |(forces, _)| pipeline.set_forces(forces))?;
    baseline.map_or(Ok(()), |table| pipeline.set_baseline(&table))?;
    let opened_patch = OpenedPatch { source: opened.source, waits: opened.waits, pipeline, guard, head };
    Ok((opened_patch, opened.twin))
}

/// Opens the guard's socket. A patch that was not started has no frames, so its verdict stays `stale`.
fn open_guard(address: &GuardAddress, body: &Body, ready: &[(usize, OpenedPatch)]) -> Result<GuardSocket, Error> {
    let now_ns = HostStamp::now().monotonic_ns;
    let report = |number: usize| {
        let opened = ready.iter().find(|(ready, _)| *ready == number);
        let report = opened.and_then(|(_, opened)| opened.pipeline.guard_before_frames(now_ns));
        report.unwrap_or(GuardReport::before_frames(now_ns, UNSTARTED_STALE_NS))
    };
    let patches: Vec<_> =
        body.patches.iter().enumerate().map(|(number, patch)| (patch.name.clone(), report(number))).collect();
    GuardSocket::open(address, &patches).map_err(|source| Error::Guard { source })
}

/// A recorder for each patch, and the thread that records the joints.
type Recorders = (Vec<Option<LiveRecording>>, Option<JoinHandle<()>>);

/// Makes a recorder for every ready patch, and starts a thread that records the joint values.
fn start_recording(
    path: &Path,
    body: &Arc<Body>,
    joints: &JointFeed,
    stop: &Arc<AtomicBool>,
    ready: &[(usize, OpenedPatch)],
) -> Result<Recorders, Error> {
    let text = |path: &Path| std::fs::read_to_string(path).unwrap_or_default();
    let urdf = body.urdf.as_ref().map(|(file, _)| text(file));
    let head = BodyHead { name: body.name.clone(), toml: text(&body.file), urdf };
    let mut recording = BodyRecording::create(path, &head)?;
    let mut all = Vec::new();
    for (number, opened) in ready {
        let recorder = recording.patch(&body.patches[*number].name, &opened.head)?;
        let live = LiveRecording::start_with(recorder, &opened.pipeline, SkinView::IMAGES_PER_S);
        all.push(Some(live?));
    }
    let (body, joints, stop) = (body.clone(), joints.clone(), stop.clone());
    let thread = std::thread::Builder::new().name("dermis-joint-recorder".to_owned());
    let thread = thread.spawn(move || {
        if let Err(error) = record_joints(recording, &body, &joints, &stop) {
            tracing::error!("joint positions are no longer recorded: {error}");
        }
    });
    let thread = thread.map_err(|source| Error::Thread { what: "the recording of joints".to_owned(), source })?;
    Ok((all, Some(thread)))
}

/// Records the joint values whenever they change, until the body stops.
fn record_joints(
    mut recording: BodyRecording,
    body: &Body,
    joints: &JointFeed,
    stop: &AtomicBool,
) -> Result<(), dermis_record::Error> {
    let mut last = None;
    while !stop.load(Ordering::Relaxed) {
        let now = HostStamp::now();
        let values = joints.at(now.monotonic_ns).values;
        if last.as_ref() != Some(&values) {
            let known = |name| Some((name, body.kinematics.value(&values, name)?));
            let known: Vec<(&str, f64)> = body.kinematics.moving_joints().filter_map(known).collect();
            recording.write_joints(now.wall_ns, known.into_iter())?;
            last = Some(values);
        }
        std::thread::sleep(JOINTS_EVERY);
    }
    recording.finish()
}
