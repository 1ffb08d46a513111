//! A digital twin behind the same interface as hardware: frames at the instrument's rate, and people may press on it.

use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender};
use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, Source, SourceEvent};
use dermis_twin::instrument::FrameFate;
use dermis_twin::scene::Script;
use dermis_twin::{Frontend, TwinError};

use crate::Error;
use crate::skin::Skin;
use crate::twins::{AnyTwin, PressRange, TwinKit};

/// What can be done to a running twin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TwinCommand {
    /// Press, or go on pressing elsewhere or otherwise.
    Press {
        /// Who presses.
        pointer: u64,
        /// Where, metres.
        position_m: [f64; 2],
        /// Radius of the indenter, metres.
        radius_m: f64,
        /// Pressure under it, pascal.
        pressure_pa: f64,
    },
    /// Stop pressing.
    Release {
        /// Who stops.
        pointer: u64,
    },
}

/// A twin as a [`Source`].
#[derive(Debug)]
pub struct TwinSource {
    name: String,
    layout: Layout,
    twin: AnyTwin,
    press: PressRange,
    demo: Option<Script>,
    commands: Receiver<TwinCommand>,
    period: Duration,
    started: Option<Instant>,
    /// Paced by the clock, or as fast as asked.
    paced: bool,
    /// Frames that the instrument took, whatever became of them.
    ticks: u64,
    /// Frames skipped because this machine was too slow.
    skipped: u64,
    /// Frames that a fault of the instrument lost.
    dropped: u64,
    frames: u64,
    values: Vec<f64>,
}

/// Commands that may wait for the next frame.
const QUEUE: usize = 256;
/// Frames without any touch at the start, for a baseline; then the demonstration begins.
const REST_FRAMES: u64 = crate::pipeline::TARE_FRAMES as u64 + 4;

impl TwinSource {
    /// The twin of a skin, at the skin file's frame rate (50 frames/s where it gives none), with its demonstration script.
    /// Commands go through the sender; while someone presses, the script waits.
    ///
    /// # Errors
    /// A skin without twin, or one that cannot be made.
    pub fn new(skin: &Skin) -> Result<(Self, Sender<TwinCommand>), Error> {
        let TwinKit { twin, press, demo } = TwinKit::of(skin)?;
        let (sender, commands) = crossbeam_channel::bounded(QUEUE);
        let rate = skin.backend.frames_per_s.unwrap_or(50.0);
        let source = Self {
            name: format!("twin:{}", skin.name),
            layout: Layout::Channels { count: twin.frontend().channel_count() },
            twin,
            press,
            demo: Some(demo),
            commands,
            period: Duration::from_secs_f64(1.0 / rate),
            started: None,
            paced: true,
            ticks: 0,
            skipped: 0,
            dropped: 0,
            frames: 0,
            values: Vec::new(),
        };
        Ok((source, sender))
    }

    /// The same as fast as frames are asked for; times and numbers are those of the paced one on a machine that keeps up.
    pub fn unpaced(self) -> Self {
        Self { paced: false, ..self }
    }

    /// What people may press with.
    pub fn press_range(&self) -> PressRange {
        self.press
    }

    /// Sleeps until the next frame is due, at most `timeout`; true if it is due.
    fn wait(&mut self, timeout: Duration) -> bool {
        let started = *self.started.get_or_insert_with(Instant::now);
        let mut due = started + self.period.mul_f64((self.ticks + self.skipped) as f64);
        let now = Instant::now();
        if due > now + timeout {
            std::thread::sleep(timeout);
            return false;
        }
        // A machine too slow for the rate skips frames, as an instrument would overrun, and counts them.
        let behind = now.saturating_duration_since(due).as_secs_f64() / self.period.as_secs_f64();
        if behind > 4.0 {
            self.skipped += behind as u64;
            due = now;
        }
        std::thread::sleep(due.saturating_duration_since(now));
        true
    }

    fn obey(&mut self) -> Result<(), TwinError> {
        if self.ticks >= REST_FRAMES && self.demo.is_some() {
            self.twin.scene_mut().set_script(self.demo.take())?;
        }
        for command in self.commands.try_iter() {
            match command {
                TwinCommand::Press { pointer, position_m: [x, y], radius_m, pressure_pa } => {
                    self.twin.scene_mut().press(pointer, x, y, radius_m, pressure_pa)?;
                }
                TwinCommand::Release { pointer } => self.twin.scene_mut().release(pointer),
            }
        }
        Ok(())
    }
}

impl Source for TwinSource {
    fn layout(&self) -> &Layout {
        &self.layout
    }

    fn name(&self) -> &str {
        &self.name
    }

    fn next_frame(&mut self, frame: &mut Frame, timeout: Duration) -> Result<SourceEvent, DeviceError> {
        if self.paced && !self.wait(timeout) {
            return Ok(SourceEvent::Idle);
        }
        let time_s = (self.ticks + self.skipped) as f64 * self.period.as_secs_f64();
        let obeyed = self.obey();
        let stepped = obeyed.and_then(|()| self.twin.step(time_s, &mut self.values));
        let stepped = stepped.map(|truth| (truth.sequence, truth.fate));
        let (sequence, fate) = stepped
            .map_err(|error| DeviceError::SourceFailed { name: self.name.clone(), reason: error.to_string() })?;
        self.ticks += 1;
        if fate == FrameFate::Dropped {
            self.dropped += 1;
            return Ok(SourceEvent::Idle);
        }
        frame.refill(sequence + self.skipped, HostStamp::now(), &self.values, &[]);
        frame.device_time_ns = Some((time_s * 1e9) as u64);
        self.frames += 1;
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        Counters { frames: self.frames, lost: self.skipped + self.dropped, bad: 0 }
    }
}
