//! A digital twin behind the same interface as hardware: frames at the instrument's rate, and people may press on it.

use std::any::Any;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use crossbeam_channel::{Receiver, Sender, TryRecvError};
use dermis_device::{Counters, DeviceError, Frame, HostStamp, Layout, Source, SourceEvent};
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
    /// The demonstration is wanted.
    wants_demo: bool,
    /// The demonstration is what touches the twin.
    demonstrates: bool,
    /// Until this frame nothing is demonstrated.
    calm_until: u64,
    /// What is broken, and when.
    faults: Vec<TimedFault>,
    /// Contact impedances with all electrodes in contact.
    contacts_ohm: Vec<f64>,
    commands: CommandQueue,
    /// Treatments that are being prepared beside the frames.
    preparing: Option<Preparing>,
    notices: (Sender<String>, Receiver<String>),
    /// Pointers whose last press was refused.
    refused: BTreeSet<u64>,
    /// Pointers that press.
    pressing: BTreeSet<u64>,
    /// That the model left its validity has been said.
    warned: bool,
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

/// Most that may press at once, and most that may be broken at once.
const MOST_POINTERS: usize = 32;
const MOST_FAULTS: usize = 256;
/// Notices that may wait for a reader.
const NOTICES: usize = 64;
/// Hosts make their operators while frames come already.
const READY: Duration = Duration::from_secs(5);
/// Frames without any touch at the start, for a baseline; then the demonstration begins.
const REST_FRAMES: u64 = dermis_live::pipeline::TARE_FRAMES as u64 + 4;

impl TwinSource {
    /// The twin of a skin, at the skin file's frame rate (50 frames/s where it gives none), with its demonstration
    /// script. Commands go through the sender; while someone presses, the script waits.
    ///
    /// # Errors
    /// A skin without twin, or one that cannot be made.
    pub fn new(skin: &Skin) -> Result<(Self, TwinCommands), Error> {
        let TwinKit { twin, press, demo } = TwinKit::of(skin)?;
        let commands = CommandQueue::default();
        let sender = commands.sender();
        let rate = skin.backend.frames_per_s.unwrap_or(50.0);
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

    /// The same without its demonstration: nothing touches it but who commands it.
    pub fn undemonstrated(self) -> Self {
        Self { demo: None, ..self }
    }

    /// Somebody new looks: the demonstration stops for as long as a host takes to get ready and to take a baseline, and
    /// then begins again.
    ///
    /// # Errors
    /// None of a twin that could be made.
    pub fn calm(&mut self) -> Result<(), Error> {
        self.calm_until = self.ticks + REST_FRAMES + (READY.as_secs_f64() / self.period.as_secs_f64()) as u64;
        if std::mem::take(&mut self.demonstrates) {
            self.twin.scene_mut().set_script(None)?;
        }
        Ok(())
    }

    /// The same as fast as frames are asked for; times and numbers are those of the paced one on a machine that keeps
    /// up.
    pub fn unpaced(self) -> Self {
        Self { paced: false, ..self }
    }

    /// What the twin has to say to people: presses refused, and, once, that its model has left its validity.
    pub fn notices(&self) -> Receiver<String> {
        self.notices.1.clone()
    }

    /// What is broken in its instrument now.
    pub fn acting_faults(&self) -> &[Fault] {
        self.twin.instrument().faults()
    }

    /// Contact impedance of every electrode now, ohm, NaN where open; empty for coils.
    pub fn contacts_ohm(&self) -> Vec<f32> {
        let open = |e: usize| {
            let is_it = |fault: &Fault| matches!(fault, Fault::OpenElectrode { electrode } if *electrode as usize == e);
            self.acting_faults().iter().any(is_it)
        };
        let contact = |(e, ohm): (usize, &f64)| if open(e) { f32::NAN } else { *ohm as f32 };
        self.contacts_ohm.iter().enumerate().map(contact).collect()
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
                // Treatments have a queue of their own.
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

    /// Treats the sheet as far as that is prepared, and begins to prepare what waits.
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
        // Who cuts and heals wants to see that, and not a demonstration of touches.
        self.wants_demo = false;
        if std::mem::take(&mut self.demonstrates) {
            self.twin.scene_mut().set_script(None)?;
        }
        let is_slow = |treatment: &Treatment| matches!(treatment, Treatment::Cut(_) | Treatment::Renew);
        match self.twin.frontend().preparation(&treatments) {
            // Frames that nobody waits for may wait themselves.
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

    /// Steps the twin. A sheet whose fields cannot be solved any more is replaced by a new one, which is said.
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

    /// Presses, or says why not: a press that makes no sense must not end the source. A pointer that slides off the
    /// skin lets go without a word, and presses again where it comes back.
    fn press(&mut self, pointer: u64, [x_m, y_m]: [f64; 2], radius_m: f64, pressure_pa: f64) {
        if self.pressing.len() >= MOST_POINTERS && !self.pressing.contains(&pointer) {
            if self.refused.len() < MOST_POINTERS && self.refused.insert(pointer) {
                self.notice(format!(
                    "press refused: {MOST_POINTERS} press already; expected one of them to let go first"
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
                // Whoever slides off the skin lets go; a press that makes no sense leaves what was pressed as it is.
                let off = !self.twin.frontend().extent().contains([x_m, y_m]);
                if slides && off {
                    self.pressing.remove(&pointer);
                    self.twin.scene_mut().release(pointer);
                }
                // Pointers that are not remembered are told again.
                if self.refused.len() >= MOST_POINTERS {
                    self.refused.clear();
                }
                if self.refused.insert(pointer) && !(slides && off) {
                    self.notice(format!("press refused: {error}"));
                }
            }
        }
    }

    /// Breaks something more, or says why it cannot be broken.
    fn break_(&mut self, fault: Fault) {
        let timed = TimedFault::from(fault);
        if self.faults.contains(&timed) {
            return;
        }
        if self.faults.len() >= MOST_FAULTS {
            return self.notice(format!("fault refused: {MOST_FAULTS} faults act already; expected a repair first"));
        }
        self.faults.push(timed);
        if let Err(error) = self.twin.set_faults(self.faults.clone()) {
            self.faults.pop();
            self.notice(format!("fault refused: {error}"));
        }
    }

    /// Says once that the model has left its validity.
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
        // Notices that nobody reads are in the log.
        let _ = self.notices.0.try_send(text);
    }
}

/// Work on treatments in a thread of its own.
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
        // Without a thread the sender is gone, and the treatment refused.
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
