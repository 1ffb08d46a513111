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
mod tests {
    use super::*;

    /// Frames of the twin of a built-in skin until it has obeyed, and what it said.
    fn told(skin: &str, commands: &[TwinCommand]) -> Vec<String> {
        let (source, sender) = TwinSource::new(&Skin::open(skin).unwrap()).unwrap();
        let (mut source, mut frame) = (source.unpaced(), Frame::default());
        let mut step = |command: Option<TwinCommand>| {
            command.map_or(Ok(()), |command| sender.send(command)).unwrap();
            assert_eq!(source.next_frame(&mut frame, Duration::ZERO).unwrap(), SourceEvent::Frame);
            assert!(frame.values.iter().all(|value| value.is_finite()));
        };
        commands.iter().for_each(|command| step(Some(*command)));
        (0..3).for_each(|_| step(None));
        source.notices().try_iter().collect()
    }

    fn press(pointer: u64, x_m: f64, pressure_pa: f64) -> TwinCommand {
        TwinCommand::Press { pointer, position_m: [x_m, 0.0], radius_m: 0.01, pressure_pa }
    }

    #[test]
    fn presses_that_make_no_sense_are_said_and_frames_go_on() {
        let bad = [press(1, 0.2, 80e3), press(1, 0.2, 80e3), press(2, 0.0, f64::NAN), press(3, 0.0, -5.0)];
        let told = told("healing-square", &bad);
        assert_eq!(told.len(), 3, "each pointer once: {told:?}");
        assert_eq!(
            told[0],
            "press refused: x of the indenter, m: 0.2 refused; expected no farther out than the skin's rim"
        );
        assert!(
            told[1].contains("pressure_pa: NaN refused") && told[2].contains("pressure_pa: -5 refused"),
            "{told:?}"
        );
    }

    #[test]
    fn sheets_are_cut_and_healed_and_skins_without_say_so() {
        let cut = TwinCommand::Treat(Treatment::Cut(dermis_twin::physics::Cut::open([-0.01, 0.0], [0.01, 0.0])));
        assert_eq!(told("healing-square", &[cut, TwinCommand::Treat(Treatment::Renew)]), [""; 0]);
        let nowhere = TwinCommand::Treat(Treatment::TimeLapse(f64::NAN));
        assert!(told("healing-square", &[nowhere])[0].contains("treatment refused: time-lapse: NaN"));
        let refused = told("ionic-disc", &[cut]);
        assert!(refused[0].contains("cannot be treated"), "{refused:?}");
    }

    #[test]
    fn a_demonstration_that_is_not_wanted_ends_and_may_begin_again() {
        let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
        let (mut source, mut frame) = (source.unpaced(), Frame::default());
        let mut rest = Vec::new();
        let mut changes = |frames: usize| {
            let moved = |values: &[f64], rest: &[f64]| {
                let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
                size(&mut values.iter().zip(rest).map(|(a, b)| a - b)) / size(&mut rest.iter().copied())
            };
            let mut largest: f64 = 0.0;
            for _ in 0..frames {
                source.next_frame(&mut frame, Duration::ZERO).unwrap();
                if rest.is_empty() {
                    rest.clone_from(&frame.values);
                }
                largest = largest.max(moved(&frame.values, &rest));
            }
            largest
        };
        // Noise is below a thousandth of the readings, a touch is far above.
        assert!(changes(30) < 5e-3);
        assert!(changes(120) > 2e-2, "it demonstrates by itself");
        sender.send(TwinCommand::Demonstrate(false)).unwrap();
        changes(50);
        assert!(changes(150) < 5e-3, "nothing touches it any more");
        sender.send(TwinCommand::Demonstrate(true)).unwrap();
        assert!(changes(150) > 2e-2, "it demonstrates again");
    }

    #[test]
    fn equal_cuts_heals_and_cuts_of_any_length_leave_a_skin_that_runs() {
        let cut = |from_m, to_m| TwinCommand::Treat(Treatment::Cut(dermis_twin::physics::Cut::open(from_m, to_m)));
        let middle = cut([0.0, 0.0], [0.02, 0.0]);
        // In one frame and in one after the other.
        assert_eq!(told("healing-square", &[middle, middle, middle, middle]), [""; 0]);
        let far = told("healing-square", &[cut([-50.0, 0.0], [50.0, 0.0]), middle]);
        assert!(far.len() == 1 && far[0].contains("no farther from the skin than the skin is long"), "{far:?}");
        let heating = |k: u32| dermis_twin::Heating {
            centre_m: [f64::from(k) * 1e-5, 0.0],
            radius_m: 0.01,
            temperature_c: 90.0,
            duration_s: 7200.0,
        };
        let heats: Vec<TwinCommand> = (0..40).map(|k| TwinCommand::Treat(Treatment::Heat(heating(k)))).collect();
        let told = told("healing-square", &heats);
        assert!(told.iter().all(|text| text.contains("heat pads: 25 refused; expected at most 24")), "{told:?}");
        assert_eq!(told.len(), 16);
    }

    #[test]
    fn bursts_of_cuts_are_prepared_beside_the_frames() {
        let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
        let (mut source, mut frame) = (source.undemonstrated(), Frame::default());
        for k in 0..12 {
            let y_m = -0.03 + 0.004 * f64::from(k);
            let cut = dermis_twin::physics::Cut::open([-0.01, y_m], [0.01, y_m]);
            sender.send(TwinCommand::Treat(Treatment::Cut(cut))).unwrap();
        }
        let mut during = 0;
        while source.twin.frontend().wounds().is_empty() {
            source.next_frame(&mut frame, Duration::from_millis(100)).unwrap();
            during += u32::from(source.preparing.is_some());
            assert!(during < 100_000, "the cuts never came");
        }
        assert!(during > 0, "the frames waited for the cuts");
        assert_eq!(source.twin.frontend().wounds().len(), 12);
        assert_eq!(source.notices().try_iter().collect::<Vec<_>>(), [""; 0]);
    }

    #[test]
    fn any_number_of_pointers_and_faults_is_borne() {
        let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
        let (mut source, mut frame) = (source.unpaced(), Frame::default());
        for k in 0..600 {
            let _ = sender.send(press(k, 0.0, 1e3));
            let fault = Fault::NoisyChannel { channel: 0, deviation_v: 1e-6 * k as f64 };
            let _ = sender.send(TwinCommand::Break(fault));
            source.next_frame(&mut frame, Duration::ZERO).unwrap();
        }
        assert_eq!((source.pressing.len(), source.faults.len()), (MOST_POINTERS, MOST_FAULTS));
        let told: Vec<String> = source.notices().try_iter().collect();
        assert!(told.iter().any(|text| text.contains("32 press already")), "{told:?}");
    }

    #[test]
    fn sliding_off_the_skin_lets_go_without_a_word() {
        let slide = [press(1, 0.04, 80e3), press(1, 0.06, 80e3), press(1, 0.07, 80e3), press(1, 0.0, 80e3)];
        assert_eq!(told("healing-square", &slide), [""; 0]);
    }

    #[test]
    fn a_membrane_on_the_bottom_is_said_once() {
        let heavy = [press(1, 0.0, 20e3), press(1, 0.01, 20e3), press(1, 0.02, 20e3)];
        let told = told("ionic-disc", &heavy);
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with("twin:ionic-disc: the membrane touches the bottom"), "{told:?}");
    }
}
