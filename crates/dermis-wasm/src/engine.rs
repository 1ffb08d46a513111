//! Runs frames of the twin through the pipeline, turns them into messages for the page, and handles the page's
//! requests.

use std::collections::VecDeque;

use bytes::Bytes;
use dermis_device::acquire::AcquisitionCounters;
use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_page::feed::PageFeed;
use dermis_page::message::{Answer, HubStats, Level, Notice};
use dermis_page::protocol::{self, Encoded, PageMessage};
use dermis_page::{Announcer, Command, Scene, scene};
use dermis_skin::Skin;
use dermis_twin::from_skin::treatment_of;

use crate::pressed_twin::PressedTwin;

/// Maximum number of updates sent but not yet acknowledged.
const WINDOW: u64 = 8;
/// Maximum number of messages waiting for the page; further ones are dropped.
const MOST_MESSAGES: usize = 256;
/// Maximum time that the twin advances over a pause in which the page was not viewed, frame periods.
const LONGEST_PAUSE: u64 = 4;
/// Interval between messages that the engine is alive.
const ALIVE_NS: u64 = 1_000_000_000;

/// A message to the page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Message {
    /// JSON.
    Text(String),
    /// Binary data: an image, channels or noise.
    Binary(Bytes),
}

/// The twin, its pipeline and their connection to the page.
#[derive(Debug)]
pub struct Engine {
    twin: PressedTwin,
    pipeline: Pipeline,
    feed: PageFeed,
    announcer: Announcer,
    scene: Scene,
    frame: Frame,
    outbox: VecDeque<Message>,
    period_ns: u64,
    /// Time of the last frame on the twin's clock and on the page's clock.
    time_ns: u64,
    last_ns: Option<u64>,
    alive_ns: Option<u64>,
    sequence: u64,
    acknowledged: u64,
    missed: u64,
}

impl Engine {
    /// The twin of a built-in skin at `frames_per_s` frames per second. The scene message is queued.
    ///
    /// # Errors
    /// A sentence that names the problem: the skin is not built in or has no twin, or the rate is not above 0 and at
    /// most 1000.
    pub fn new(skin: &str, frames_per_s: f64) -> Result<Self, String> {
        if !(frames_per_s > 0.0 && frames_per_s <= 1000.0) {
            return Err(format!("frames per second: {frames_per_s} refused; expected above 0, at most 1000"));
        }
        let text = dermis_skin::builtin_text(skin);
        let text = text.ok_or_else(|| format!("skin {skin:?} refused; expected the name of a built-in one"))?;
        let skin = Skin::parse(text, skin).map_err(|error| error.to_string())?;
        let twin = PressedTwin::new(&skin).map_err(|error| error.to_string())?;
        let prepared = Prepared::new(skin).map_err(|error| error.to_string())?;
        let (announcer, scene) = (Announcer::new(&prepared.skin), scene(&prepared, Some(twin.press_range()), None));
        let layout = Layout::Channels { count: twin.channels() };
        let pipeline = Pipeline::new(prepared, &layout, None).map_err(|error| error.to_string())?;
        let mut feed = PageFeed::new(&pipeline);
        feed.demonstrate(true);
        let mut engine = Self {
            twin,
            pipeline,
            feed,
            announcer,
            frame: Frame::default(),
            outbox: VecDeque::new(),
            period_ns: (1e9 / frames_per_s) as u64,
            time_ns: 0,
            last_ns: None,
            alive_ns: None,
            sequence: 0,
            acknowledged: 0,
            missed: 0,
            scene,
        };
        let scene = protocol::scene(&engine.scene);
        engine.send(Message::Text(scene));
        Ok(engine)
    }

    /// Runs one frame and queues its messages. `now_ns` is a monotonic clock, nanoseconds. Failures are reported to
    /// the page.
    pub fn step(&mut self, now_ns: u64) {
        if let Err(text) = self.run_frame(now_ns) {
            self.notice(Notice { level: Level::Error, text });
        }
        if self.alive_ns.is_none_or(|last| now_ns.saturating_sub(last) >= ALIVE_NS) {
            self.alive_ns = Some(now_ns);
            self.send_alive();
        }
    }

    /// Reports that the engine is alive, without running a frame, while the page is not being viewed.
    pub fn rest(&mut self) {
        self.send_alive();
    }

    /// Handles a message from the page: an acknowledgement or a request.
    pub fn hear(&mut self, text: &str) {
        let (id, answer) = match protocol::parse::<Command>(text) {
            Ok(PageMessage::Acknowledge(sequence)) => {
                self.acknowledged = sequence.clamp(self.acknowledged, self.sequence);
                return;
            }
            Ok(PageMessage::Ask(id, command)) => (id, command.check(&self.scene).and_then(|()| self.obey(command))),
            Err((id, refusal)) => (id, Err(refusal)),
        };
        let (ok, text) = match answer {
            Ok(None) => return,
            Ok(Some(text)) => (true, text),
            Err(text) => (false, text),
        };
        self.send(Message::Text(protocol::answer(&Answer { id, ok, text })));
    }

    /// Takes the next message to the page.
    pub fn take(&mut self) -> Option<Message> {
        self.outbox.pop_front()
    }

    /// Nanoseconds from one frame to the next.
    pub fn period_ns(&self) -> u64 {
        self.period_ns
    }

    fn run_frame(&mut self, now_ns: u64) -> Result<(), String> {
        let elapsed_ns = now_ns.saturating_sub(self.last_ns.unwrap_or(now_ns));
        self.last_ns = Some(now_ns);
        self.time_ns += elapsed_ns.min(LONGEST_PAUSE * self.period_ns);
        let stepped = self.twin.step(self.time_ns as f64 * 1e-9);
        let (number, values, imaginary) = stepped.map_err(|error| error.to_string())?;
        self.frame.refill(number, HostStamp { monotonic_ns: now_ns, wall_ns: 0 }, values, imaginary);
        self.frame.device_time_ns = Some(self.time_ns);
        let baselines = self.pipeline.baseline_records().len();
        let output = self.pipeline.process(&self.frame, now_ns).map_err(|error| error.to_string())?;
        self.feed.show(&output, now_ns);
        let notices = self.announcer.notices(&output);
        self.feed.count(AcquisitionCounters::default(), None);
        self.feed.describe(&self.pipeline, now_ns);
        notices.into_iter().for_each(|notice| self.notice(notice));
        if self.pipeline.baseline_records().len() > baselines {
            let noise: Vec<f32> = self.pipeline.baseline().1.iter().map(|v| *v as f32).collect();
            self.send(Message::Binary(protocol::noise(&noise)));
        }
        self.send_update();
        Ok(())
    }

    /// Sends the feed's contents, if the page keeps up.
    fn send_update(&mut self) {
        if self.sequence - self.acknowledged >= WINDOW {
            self.missed += 1;
            return;
        }
        self.sequence += 1;
        let Encoded { image, channels, classes, state, .. } = Encoded::new(self.sequence, self.feed.update());
        let binary = [Some(image), Some(channels), classes];
        binary.into_iter().flatten().for_each(|message| self.send(Message::Binary(message)));
        self.send(Message::Text(state));
    }

    /// Carries out a request and returns a message about it, if there is one.
    fn obey(&mut self, command: Command) -> Result<Option<String>, String> {
        match command {
            Command::Tare { force } => match self.pipeline.tare(force, "requested on the page") {
                Ok(frames) => Ok(Some(format!("taring over {frames} frames"))),
                Err(error) => Err(format!("tare refused: {error}")),
            },
            Command::RecordStart | Command::RecordStop => {
                Err("not recorded: the skin in this page has no disk to record to; `dermis run` has".into())
            }
            Command::Hyperparameter(value) => match self.pipeline.set_hyperparameter(value) {
                Ok(()) => Ok(Some(format!("hyperparameter {value:.3e}"))),
                Err(error) => Err(format!("hyperparameter refused: {error}")),
            },
            Command::Press(press) | Command::Move(press) => {
                self.twin.press(&press).map(|()| None).map_err(|error| format!("press refused: {error}"))
            }
            Command::Release { pointer_id } => {
                self.twin.release(pointer_id);
                Ok(None)
            }
            Command::Treat(action) => {
                let treated = self.twin.treat(&treatment_of(action));
                treated.map(|()| None).map_err(|error| format!("treatment refused: {error}"))
            }
            Command::Demonstrate(wanted) => {
                self.twin.demonstrate(wanted).map_err(|error| format!("refused: {error}"))?;
                self.feed.demonstrate(wanted);
                let text = if wanted { "the twin shows touches by itself" } else { "only you press the twin" };
                Ok(Some(text.into()))
            }
            // All channels are sent; the page selects among them.
            Command::ChooseChannels(_) => Ok(None),
        }
    }

    fn send_alive(&mut self) {
        let hub = HubStats { clients: 1, published: self.sequence + self.missed, coalesced: 0, dropped: self.missed };
        self.send(Message::Text(protocol::alive(self.missed, hub)));
    }

    fn notice(&mut self, notice: Notice) {
        self.send(Message::Text(protocol::notice(&notice)));
    }

    fn send(&mut self, message: Message) {
        if self.outbox.len() < MOST_MESSAGES {
            self.outbox.push_back(message);
        }
    }
}
