//! A digital twin behind the same interface as hardware. It delivers frames at the instrument's rate and can be
//! pressed by commands.

use std::any::Any;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TryRecvError};
use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, Source, SourceEvent};
use dermis_tomo::mesh::{Outline, Point};
use dermis_twin::instrument::{Fault, FrameFate, TimedFault};
use dermis_twin::scene::Script;
use dermis_twin::{Frontend, Preparation, Treatment, TwinError};

use crate::Error;
use crate::twin_commands::CommandQueue;
use dermis_skin::Skin;
use dermis_twin::{AnyTwin, PressRange, TwinKit};

pub use crate::twin_commands::{TwinCommand, TwinCommands};

/// A twin as a [`Source`].
#[derive(Debug)]
pub struct TwinSource {
    name: String,
    layout: Layout,
    twin: AnyTwin,
    press: PressRange,
    demo: Option<Script>,
    /// True if the demonstration is wanted.
    wants_demo: bool,
    /// True while the demonstration controls the presses.
    demonstrates: bool,
    /// No demonstration before this frame.
    calm_until: u64,
    /// Current and scheduled faults.
    faults: Vec<TimedFault>,
    /// Contact impedances with all electrodes in contact, ohms.
    contacts_ohm: Vec<f64>,
    commands: CommandQueue,
    /// Treatments being prepared in the background.
    preparing: Option<Preparing>,
    notices: (Sender<String>, Receiver<String>),
    /// Pointers whose last press was refused.
    refused: BTreeSet<u64>,
    /// Pointers that are pressing.
    pressing: BTreeSet<u64>,
    /// True once the warning about the model's validity has been given.
    warned: bool,
    period: Duration,
    started: Option<Instant>,
    /// Paced by the clock if true, else as fast as frames are requested.
    paced: bool,
    /// Frames taken by the instrument, delivered or not.
    ticks: u64,
    /// Frames skipped because this machine was too slow.
    skipped: u64,
    /// Frames lost to an instrument fault.
    dropped: u64,
    frames: u64,
    values: Vec<f64>,
}

/// Maximum number of pointers that may press at once.
const MOST_POINTERS: usize = 32;
/// Maximum number of faults at once.
const MOST_FAULTS: usize = 256;
/// Maximum number of notices waiting for a reader.
const NOTICES: usize = 64;
/// Time that a host may need to prepare its operators while frames already arrive.
const READY: Duration = Duration::from_secs(5);
/// Untouched frames at the start, for a baseline, before the demonstration begins.
const REST_FRAMES: u64 = dermis_live::pipeline::TARE_FRAMES as u64 + 4;

impl TwinSource {
    /// The twin of a skin with its demonstration script, at the skin file's frame rate (50 frames/s by default).
    /// Commands go through the returned sender; the script pauses while someone presses.
    ///
    /// # Errors
    /// The skin has no twin, or the twin cannot be built.
    pub fn new(skin: &Skin) -> Result<(Self, TwinCommands), Error> {
        let TwinKit { twin, press, demo } = TwinKit::of(skin)?;
        let commands = CommandQueue::default();
        let sender = commands.sender();
        let rate = skin.backend.frame_rate_hz();
        let source = Self {
            name: format!("twin:{}", skin.name),
            layout: Layout::Channels { count: twin.frontend().channel_count() },
            twin,
            press,
            demo: Some(demo),
            wants_demo: true,
            demonstrates: false,
            calm_until: REST_FRAMES,
            faults: dermis_twin::from_skin::timed_faults(&skin.twin),
            contacts_ohm: skin.contact_impedances_ohm(),
            commands,
            preparing: None,
            notices: crossbeam_channel::bounded(NOTICES),
            refused: BTreeSet::new(),
            pressing: BTreeSet::new(),
            warned: false,
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

    /// The same twin without its demonstration, so that only commands touch it.
    pub fn undemonstrated(self) -> Self {
        Self { demo: None, ..self }
    }

    /// Pauses the demonstration for a new observer, long enough for a host to get ready and take a baseline.
    ///
    /// # Errors
    /// None for a twin that could be built.
    pub fn calm(&mut self) -> Result<(), Error> {
        self.calm_until = self.ticks + REST_FRAMES + (READY.as_secs_f64() / self.period.as_secs_f64()) as u64;
        if std::mem::take(&mut self.demonstrates) {
            self.twin.scene_mut().set_script(None)?;
        }
        Ok(())
    }

    /// The same twin without pacing, as fast as frames are requested. Times and sequence numbers are those of a paced
    /// twin on a machine that keeps up.
    pub fn unpaced(self) -> Self {
        Self { paced: false, ..self }
    }

    /// Messages for the user: refused presses, and once a warning that the model has left its range of validity.
    pub fn notices(&self) -> Receiver<String> {
        self.notices.1.clone()
    }

    /// Faults currently active in the instrument.
    pub fn acting_faults(&self) -> &[Fault] {
        self.twin.instrument().faults()
    }

    /// Current contact impedance of every electrode, ohms; NaN if open; empty for coils.
    pub fn contacts_ohm(&self) -> Vec<f32> {
        let open = |e: usize| {
            let is_it = |fault: &Fault| matches!(fault, Fault::OpenElectrode { electrode } if *electrode as usize == e);
            self.acting_faults().iter().any(is_it)
        };
        let contact = |(e, ohm): (usize, &f64)| if open(e) { f32::NAN } else { *ohm as f32 };
        self.contacts_ohm.iter().enumerate().map(contact).collect()
    }

    /// Outline of the skin laid flat.
    pub fn extent(&self) -> Outline {
        self.twin.frontend().extent()
    }

    /// Range of pressures and radii for presses.
    pub fn press_range(&self) -> PressRange {
        self.press
    }

    /// Sleeps until the next frame is due, at most `timeout`; returns true if it is due.
    fn wait(&mut self, timeout: Duration) -> bool {
        let started = *self.started.get_or_insert_with(Instant::now);
        let mut due = started + self.period.mul_f64((self.ticks + self.skipped) as f64);
        let now = Instant::now();
        if due > now + timeout {
            std::thread::sleep(timeout);
            return false;
        }
        // A machine too slow for the rate skips frames, as an overrunning instrument would, and counts them.
        let behind = now.saturating_duration_since(due).as_secs_f64() / self.period.as_secs_f64();
        if behind > 4.0 {
            self.skipped += behind as u64;
            due = now;
        }
        std::thread::sleep(due.saturating_duration_since(now));
        true
    }

    fn obey(&mut self) -> Result<(), TwinError> {
        if self.ticks >= self.calm_until
            && self.wants_demo
            && !self.demonstrates
            && let Some(demo) = &self.demo
        {
            self.twin.scene_mut().set_script(Some(demo.clone()))?;
            self.demonstrates = true;
        }
        while let Some(command) = self.commands.next() {
            match command {
                TwinCommand::Press { pointer, position_m, radius_m, pressure_pa } => {
                    self.press(pointer, position_m, radius_m, pressure_pa);
                }
                TwinCommand::Release { pointer } => {
                    self.refused.remove(&pointer);
                    self.pressing.remove(&pointer);
                    self.twin.scene_mut().release(pointer);
                }
                TwinCommand::Demonstrate(wanted) => {
                    self.wants_demo = wanted;
                    if !wanted && std::mem::take(&mut self.demonstrates) {
                        self.twin.scene_mut().set_script(None)?;
                    }
                }
                // Treatments have their own queue.
                TwinCommand::Treat(_) => {}
                TwinCommand::Break(fault) => self.break_(fault),
                TwinCommand::Repair => {
                    self.faults.clear();
                    self.twin.set_faults(Vec::new())?;
                }
            }
        }
        self.treat()
    }

    /// Applies treatments that are ready, and starts preparing those that wait.
    fn treat(&mut self) -> Result<(), TwinError> {
        if self.commands.renews()
            && let Some(preparing) = self.preparing.take()
        {
            preparing.stop.store(true, Ordering::Relaxed);
        }
        if let Some(preparing) = &self.preparing {
            let prepared = match preparing.prepared.try_recv() {
                Ok(prepared) => Ok(prepared),
                Err(TryRecvError::Empty) => return Ok(()),
                Err(TryRecvError::Disconnected) => Err(()),
            };
            self.preparing = None;
            match prepared {
                Ok(prepared) => self.adopt(prepared),
                Err(()) => self.notice("treatment refused: it could not be prepared".to_owned()),
            }
        }
        let treatments = self.commands.treatments();
        if treatments.is_empty() {
            return Ok(());
        }
        // A user who cuts and heals doesn't want a demonstration of touches at the same time.
        self.wants_demo = false;
        if std::mem::take(&mut self.demonstrates) {
            self.twin.scene_mut().set_script(None)?;
        }
        let is_slow = |treatment: &Treatment| matches!(treatment, Treatment::Cut(_) | Treatment::Renew);
        match self.twin.frontend().preparation(&treatments) {
            // Only a paced twin has to keep its frame rate meanwhile; an unpaced one prepares in place.
            Some(work) if self.paced && treatments.iter().any(is_slow) => {
                self.preparing = Some(Preparing::spawn(work));
            }
            Some(work) => {
                let prepared = work(&AtomicBool::new(false));
                self.adopt(prepared);
            }
            None => {
                for treatment in treatments {
                    if let Err(error) = self.twin.frontend_mut().treat(&treatment) {
                        self.notice(format!("treatment refused: {error}"));
                    }
                }
            }
        }
        Ok(())
    }

    fn adopt(&mut self, prepared: Box<dyn Any + Send>) {
        for error in self.twin.frontend_mut().adopt(prepared) {
            self.notice(format!("treatment refused: {error}"));
        }
    }

    /// Steps the twin. If the sheet's fields can no longer be solved, it is replaced by a new sheet, with a notice.
    fn step(&mut self, time_s: f64) -> Result<(u64, FrameFate), TwinError> {
        let stepped = self.twin.step(time_s, &mut self.values).map(|truth| (truth.sequence, truth.fate));
        let error = match stepped {
            Err(error @ TwinError::Fields(_)) if !self.twin.frontend().wounds().is_empty() => error,
            other => return other,
        };
        self.twin.frontend_mut().treat(&Treatment::Renew)?;
        self.notice(format!("{error}: the sheet with its cuts was replaced by a new one"));
        self.twin.step(time_s, &mut self.values).map(|truth| (truth.sequence, truth.fate))
    }

    /// Presses, or gives the reason as a notice, because an invalid press must not end the source. A pointer that
    /// slides off the skin is silently released, and presses again when it returns.
    fn press(&mut self, pointer: u64, [x_m, y_m]: Point, radius_m: f64, pressure_pa: f64) {
        if self.pressing.len() >= MOST_POINTERS && !self.pressing.contains(&pointer) {
            if self.refused.len() < MOST_POINTERS && self.refused.insert(pointer) {
                self.notice(format!(
                    "press refused: {MOST_POINTERS} pointers are already pressing; expected one to be released first"
                ));
            }
            return;
        }
        let scene = self.twin.scene_mut();
        let slides = scene.is_pressed_by(pointer);
        match scene.press(pointer, x_m, y_m, radius_m, pressure_pa) {
            Ok(()) => {
                self.refused.remove(&pointer);
                self.pressing.insert(pointer);
            }
            Err(error) => {
                // A pointer that slides off the skin is released; an invalid press leaves the previous one in place.
                let off = !self.twin.frontend().extent().contains([x_m, y_m]);
                if slides && off {
                    self.pressing.remove(&pointer);
                    self.twin.scene_mut().release(pointer);
                }
                // Forgotten pointers get their notice again.
                if self.refused.len() >= MOST_POINTERS {
                    self.refused.clear();
                }
                if self.refused.insert(pointer) && !(slides && off) {
                    self.notice(format!("press refused: {error}"));
                }
            }
        }
    }

    /// Adds a fault, or says in a notice why it is impossible.
    fn break_(&mut self, fault: Fault) {
        let timed = TimedFault::from(fault);
        if self.faults.contains(&timed) {
            return;
        }
        if self.faults.len() >= MOST_FAULTS {
            return self
                .notice(format!("fault refused: {MOST_FAULTS} faults are already active; expected a repair first"));
        }
        self.faults.push(timed);
        if let Err(error) = self.twin.set_faults(self.faults.clone()) {
            self.faults.pop();
            self.notice(format!("fault refused: {error}"));
        }
    }

    /// Warns once that the model has left its range of validity.
    fn warn(&mut self) {
        if !self.warned
            && let Some(text) = self.twin.frontend().outside_validity()
        {
            self.warned = true;
            self.notice(format!("{}: {text}", self.name));
        }
    }

    fn notice(&self, text: String) {
        tracing::warn!("{text}");
        // Notices without a reader are still in the log.
        let _ = self.notices.0.try_send(text);
    }
}

/// Treatments being prepared in a separate thread.
#[derive(Debug)]
struct Preparing {
    prepared: Receiver<Box<dyn Any + Send>>,
    stop: Arc<AtomicBool>,
}

impl Preparing {
    fn spawn(work: Preparation) -> Self {
        let (done, prepared) = crossbeam_channel::bounded(1);
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::Builder::new().name("dermis-treatment".to_owned());
        // If the thread cannot start, the sender is dropped and the treatment is refused.
        let _ = thread.spawn(move || {
            let _ = done.send(work(&stopped));
        });
        Self { prepared, stop }
    }
}

impl Drop for Preparing {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
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
        let stepped = obeyed.and_then(|()| self.step(time_s));
        let (sequence, fate) = stepped
            .map_err(|error| DeviceError::SourceFailed { name: self.name.clone(), reason: error.to_string() })?;
        self.ticks += 1;
        self.warn();
        if fate == FrameFate::Dropped {
            self.dropped += 1;
            return Ok(SourceEvent::Idle);
        }
        frame.refill(sequence + self.skipped, HostStamp::now(), &self.values, self.twin.instrument().imaginary_v());
        frame.device_time_ns = Some((time_s * 1e9) as u64);
        self.frames += 1;
        Ok(SourceEvent::Frame)
    }

    fn counters(&self) -> Counters {
        Counters { frames: self.frames, lost: self.skipped + self.dropped, bad: 0 }
    }
}

#[cfg(test)]
mod tests;
