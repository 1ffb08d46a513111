//! Publishes the output of one patch's pipeline. Runs on the thread behind the patch's queue.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ::foxglove::RawChannel;
use ::foxglove::messages::Log;
use ::foxglove::messages::log::Level;
use ::foxglove::websocket::Parameter;
use dermis_device::{Frame, HostStamp};
use dermis_touch::TouchPhase;

use super::channels::{Kept, PatchChannels, encoded, log};
use super::parameters::{HYPERPARAMETER, Parameters, Running};
use super::scene::Scene;
use super::transforms::{FramePose, message, time};
use crate::Error;
use crate::events::GAP;
use crate::live_feed::HYPERPARAMETER as NEW_LAMBDA;
use crate::live_writer::{BaselineNews, LiveWriter, TouchBatch};
use crate::messages::{self, Stamp};
use crate::view::SkinView;
use crate::writer::RecordingSummary;

/// Interval of counts and fixed transforms.
const BEAT: Duration = Duration::from_secs(1);
/// Minimum interval between two warnings about lost frames, so that they don't fill the clients' queues.
const WARN_EVERY: Duration = Duration::from_secs(5);
/// Minimum interval between two scenes, nanoseconds: 30 per second. Touches that begin or end are sent at once.
const SCENE_EVERY_NS: u64 = 33_000_000;

/// The publishing end of a patch's queue.
pub(super) struct Publisher {
    pub(super) server: Arc<Running>,
    pub(super) channels: PatchChannels,
    pub(super) log: Arc<RawChannel>,
    pub(super) transforms: Arc<Kept>,
    /// Pose of a single skin's link, if the skin file gives one.
    pub(super) mount: Option<FramePose>,
    pub(super) view: SkinView,
    pub(super) scene: Scene,
    pub(super) scene_ns: u64,
    pub(super) parameters: Parameters,
    /// Start of the names of parameters: empty, or `PATCH.`.
    pub(super) prefix: String,
    /// Name in the log: the skin's or the patch's.
    pub(super) name: String,
    pub(super) frames: u64,
    pub(super) losses: Losses,
    pub(super) beaten: Option<Instant>,
    pub(super) bytes: Vec<u8>,
}

/// Frames that viewers miss.
#[derive(Default)]
pub(super) struct Losses {
    /// Gaps in the sequence numbers.
    missing: u64,
    /// Dropped because the queue was full.
    dropped: Arc<AtomicU64>,
    /// The numbers in the last warning, and its time.
    told: [u64; 2],
    told_at: Option<Instant>,
}

impl Losses {
    fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }

    /// A warning, if the numbers have grown and the last one is old enough.
    fn news(&mut self, name: &str) -> Option<String> {
        let now = [self.missing, self.dropped()];
        let is_due = self.told_at.is_none_or(|at| at.elapsed() >= WARN_EVERY);
        if now == self.told || !is_due {
            return None;
        }
        (self.told, self.told_at) = (now, Some(Instant::now()));
        let [missing, dropped] = now;
        Some(format!("{name}: {missing} frames were lost before dermis, {dropped} are not shown because of load"))
    }
}

impl Publisher {
    /// Sends `bytes` as a message.
    fn send(&self, channel: &RawChannel, wall_ns: u64) {
        log(channel, wall_ns, &self.bytes);
    }

    fn say(&self, wall_ns: u64, level: Level, text: &str) {
        if self.log.has_sinks() {
            let line = Log {
                timestamp: Some(time(wall_ns)),
                level: level.into(),
                message: text.to_owned(),
                name: self.name.clone(),
                ..Log::default()
            };
            log(&self.log, wall_ns, &encoded(&line));
        }
    }

    fn parameter(&self, name: &str, value: f64) -> Parameter {
        Parameter::float64(format!("{}{name}", self.prefix), value)
    }

    /// Sends the messages that are due once a second.
    fn beat(&mut self) {
        if self.beaten.is_some_and(|at| at.elapsed() < BEAT) {
            return;
        }
        self.beaten = Some(Instant::now());
        let count = |name: &str, count: u64| {
            Parameter::integer(format!("{}{name}", self.prefix), i64::try_from(count).unwrap_or(i64::MAX))
        };
        self.parameters.publish(vec![
            count("frames", self.frames),
            count("frames_lost", self.losses.missing),
            count("frames_not_shown", self.losses.dropped()),
        ]);
        let wall_ns = HostStamp::now().wall_ns;
        if let Some(mount) = &self.mount {
            self.transforms.log(wall_ns, &encoded(&message(wall_ns, std::slice::from_ref(mount))));
        }
        if let Some(text) = self.losses.news(&self.name) {
            self.say(wall_ns, Level::Warning, &text);
            self.server.warn(&format!("dermis-lost-{}", self.name), text);
        }
    }
}

impl LiveWriter for Publisher {
    fn view(&self) -> Option<&SkinView> {
        Some(&self.view)
    }

    fn watch(&mut self, dropped: &Arc<AtomicU64>) {
        self.losses.dropped = dropped.clone();
    }

    fn frame(&mut self, frame: &Frame) -> Result<(), Error> {
        self.frames += 1;
        if self.channels.frames.has_sinks() {
            messages::write_frame(&mut self.bytes, frame);
            self.send(&self.channels.frames, frame.host_wall_ns);
        }
        self.beat();
        Ok(())
    }

    fn touches(&mut self, batch: &TouchBatch) -> Result<(), Error> {
        let TouchBatch { wall_ns, sequence, time_ns, touches, ended } = batch;
        if self.channels.touches.has_sinks() {
            let stamp = Stamp { wall_ns: *wall_ns, frame_id: self.view.frame_id() };
            messages::write_touches(&mut self.bytes, stamp, *sequence, *time_ns, touches, ended);
            self.send(&self.channels.touches, *wall_ns);
        }
        if self.channels.touch_points.has_sinks() {
            self.view.write_touch_points(&mut self.bytes, *wall_ns, touches);
            self.send(&self.channels.touch_points, *wall_ns);
        }
        let has_news = !ended.is_empty() || touches.iter().any(|touch| touch.phase == TouchPhase::Begin);
        // A clock that is set back must not stop the scene.
        if has_news || wall_ns.abs_diff(self.scene_ns) >= SCENE_EVERY_NS {
            self.scene_ns = *wall_ns;
            let update = self.scene.update(batch);
            self.channels.scene.log(*wall_ns, &encoded(&update));
        }
        Ok(())
    }

    fn image(&mut self, wall_ns: u64, image: &[f32]) -> Result<(), Error> {
        if image.len() != self.view.pixels() {
            return Ok(());
        }
        if self.channels.image.has_sinks() {
            self.view.write_image(&mut self.bytes, wall_ns, image);
            self.send(&self.channels.image, wall_ns);
        }
        if self.channels.points.has_sinks() {
            self.view.write_points(&mut self.bytes, wall_ns, image);
            self.send(&self.channels.points, wall_ns);
        }
        Ok(())
    }

    fn baseline(&mut self, news: &BaselineNews) -> Result<(), Error> {
        let BaselineNews { wall_ns, record, values, noise_std, hyperparameter } = news;
        messages::write_baseline(&mut self.bytes, record, values, noise_std);
        self.channels.baselines.log(*wall_ns, &self.bytes);
        let origin = messages::origin_name(record.origin);
        self.say(*wall_ns, Level::Info, &format!("baseline ({origin}) of {} frames: {}", record.frames, record.reason));
        if let Some(lambda) = hyperparameter {
            self.parameters.publish(vec![self.parameter(HYPERPARAMETER, *lambda)]);
        }
        Ok(())
    }

    fn event(&mut self, wall_ns: u64, event: &str, detail: &str, values: &[f64]) -> Result<(), Error> {
        if self.channels.events.has_sinks() {
            let stamp = Stamp { wall_ns, frame_id: self.view.frame_id() };
            messages::write_event(&mut self.bytes, stamp, event, detail, values);
            self.send(&self.channels.events, wall_ns);
        }
        self.say(wall_ns, level_of(event, detail), &format!("{event}: {detail}"));
        match (event, values.first()) {
            (GAP, Some(missing)) => self.losses.missing += *missing as u64,
            (NEW_LAMBDA, Some(lambda)) => self.parameters.publish(vec![self.parameter(HYPERPARAMETER, *lambda)]),
            _ => {}
        }
        Ok(())
    }

    fn rest(&mut self) -> Result<(), Error> {
        self.beat();
        Ok(())
    }

    fn taken_and_safe(&self) -> [u64; 2] {
        [self.frames, self.frames]
    }

    fn finish(self, dropped: u64) -> Result<RecordingSummary, Error> {
        Ok(RecordingSummary { frames: self.frames, dropped })
    }
}

/// Faults, gaps, refusals and verdicts other than `ok` are warnings, and the failure of a patch is an error.
fn level_of(event: &str, detail: &str) -> Level {
    if event == "failed" {
        return Level::Error;
    }
    let is_verdict = event == "guard" && detail != "ok";
    let is_bad = ["-fault", "-refused", "-begin"].iter().any(|end| event.ends_with(end));
    if is_verdict || is_bad || [GAP, "silent"].contains(&event) { Level::Warning } else { Level::Info }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_are_reported_when_they_grow_but_not_too_often() {
        let mut losses = Losses::default();
        assert_eq!(losses.news("palm"), None);
        losses.missing = 2;
        losses.dropped.store(3, Ordering::Relaxed);
        let text = "palm: 2 frames were lost before dermis, 3 are not shown because of load";
        assert_eq!(losses.news("palm").as_deref(), Some(text));
        losses.missing = 9;
        assert_eq!(losses.news("palm"), None, "too soon");
        losses.told_at = Instant::now().checked_sub(WARN_EVERY);
        assert!(losses.news("palm").is_some_and(|text| text.starts_with("palm: 9 frames")));
    }

    #[test]
    fn only_what_needs_attention_is_a_warning() {
        for (event, detail, expected) in [
            ("guard", "ok", Level::Info),
            ("guard", "stop: force", Level::Warning),
            ("tare", "requested in Foxglove", Level::Info),
            ("tare-refused", "something touches", Level::Warning),
            ("electrode-fault", "3", Level::Warning),
            ("electrode-recovered", "3", Level::Info),
            ("gap", "2 frames missing", Level::Warning),
            ("damage-begin", "", Level::Warning),
            ("silent", "no frames arrive", Level::Warning),
            ("failed", "unplugged", Level::Error),
        ] {
            assert_eq!(level_of(event, detail), expected, "{event}");
        }
    }
}
