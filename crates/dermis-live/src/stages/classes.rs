//! Classes of the pixels from a network, in addition to the live image. A network takes several milliseconds, and
//! touches must not wait for it. It therefore runs on its own thread, at a limited rate, and its classes arrive
//! slightly after their frame.

use std::borrow::Cow;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use dermis_learn::Model;
use dermis_touch::Contact;

use crate::Error;
use crate::network::{Classes, Classifier, FittedTouches};
use crate::prepare::Prepared;

/// When the network runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClassPace {
    /// In every frame, which waits for it.
    EveryFrame,
    /// In the background, at most 25 times per second of the frames' time. A frame's classes appear a few frames
    /// later.
    Background,
}

/// A network's classes for a frame.
#[derive(Clone, Debug)]
pub struct SeenClasses<'a> {
    /// Classes of the pixels.
    pub classes: Cow<'a, Classes>,
    /// Number of the frame they belong to: the current one, or a slightly earlier one.
    pub sequence: u64,
}

impl SeenClasses<'_> {
    /// The same classes, in memory of their own.
    pub fn into_owned(self) -> SeenClasses<'static> {
        SeenClasses { classes: Cow::Owned(self.classes.into_owned()), sequence: self.sequence }
    }
}

/// A frame with the forward model's fit, in model volts.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FittedFrame<'a> {
    /// `NaN` where missing.
    pub difference: &'a [f64],
    /// The contacts; those that were fitted have a radius.
    pub contacts: &'a [Contact],
    /// The part of the frame that they explain.
    pub explained: Option<&'a [f64]>,
}

/// Minimum time between two frames in the background, nanoseconds.
const INTERVAL_NS: u64 = 40_000_000;

/// A network with its latest classes.
#[derive(Debug)]
pub(crate) struct ClassStage {
    worker: Worker,
    classes: Classes,
    /// The frame they belong to.
    sequence: Option<u64>,
}

#[derive(Debug)]
enum Worker {
    Inline(Box<Classifier>, FittedTouches),
    Background(Background),
}

#[derive(Debug)]
struct Background {
    mailbox: Arc<Mailbox>,
    thread: Option<JoinHandle<()>>,
    /// Time when a frame was last handed over.
    asked_ns: Option<u64>,
    /// Results for frames before this one are discarded.
    from_sequence: u64,
}

/// Passes frames to the network, and its classes to the pipeline.
#[derive(Debug)]
struct Mailbox {
    slot: Mutex<Slot>,
    arrived: Condvar,
}

#[derive(Debug)]
struct Slot {
    difference: Vec<f64>,
    fitted: FittedTouches,
    sequence: u64,
    state: State,
    classes: Classes,
    failed: Option<Error>,
    ended: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Nothing to do.
    Idle,
    /// A frame is waiting.
    Asked,
    /// The network is running.
    Busy,
    /// Its classes are ready.
    Done,
}

impl Mailbox {
    /// Nothing panics while holding the slot; if something did, its contents would still be valid.
    fn slot(&self) -> MutexGuard<'_, Slot> {
        self.slot.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Processes one frame after another.
    fn work(&self, mut classifier: Classifier) {
        let (mut difference, mut fitted, mut classes) = (Vec::new(), FittedTouches::default(), Classes::new(0, 0));
        loop {
            let mut slot = self.slot();
            while slot.state != State::Asked && !slot.ended {
                slot = self.arrived.wait(slot).unwrap_or_else(PoisonError::into_inner);
            }
            if slot.ended {
                return;
            }
            std::mem::swap(&mut difference, &mut slot.difference);
            std::mem::swap(&mut fitted, &mut slot.fitted);
            slot.state = State::Busy;
            drop(slot);
            let seen = classifier.classify_fitted(&difference, &fitted, &mut classes);
            let mut slot = self.slot();
            match seen {
                Ok(()) => std::mem::swap(&mut classes, &mut slot.classes),
                Err(error) => slot.failed = Some(error),
            }
            slot.state = State::Done;
        }
    }
}

impl Drop for Background {
    fn drop(&mut self) {
        self.mailbox.slot().ended = true;
        self.mailbox.arrived.notify_one();
        if let Some(thread) = self.thread.take() {
            // Its own thread has already reported any panic.
            let _ = thread.join();
        }
    }
}

impl ClassStage {
    pub(crate) fn new(prepared: &Prepared, model: &Model, pace: ClassPace) -> Result<Self, Error> {
        let grid = prepared.map.grid();
        let classes = Classes::new(grid.rows, grid.columns);
        let classifier = Classifier::beside_fits(prepared, model)?;
        let worker = match pace {
            ClassPace::EveryFrame => Worker::Inline(Box::new(classifier), FittedTouches::default()),
            ClassPace::Background => Worker::Background(Background::new(classifier, classes.clone())?),
        };
        Ok(Self { worker, classes, sequence: None })
    }

    /// Classifies a frame, at a time on the skin's clock.
    pub(crate) fn classify(&mut self, sequence: u64, time_ns: u64, frame: &FittedFrame<'_>) -> Result<(), Error> {
        let anything = frame.difference.iter().any(|value| value.is_finite());
        match &mut self.worker {
            Worker::Inline(classifier, fitted) => {
                self.sequence = None;
                if anything {
                    fitted.set(frame.difference, frame.contacts, frame.explained);
                    classifier.classify_fitted(frame.difference, fitted, &mut self.classes)?;
                    self.sequence = Some(sequence);
                }
            }
            Worker::Background(background) => {
                if !anything {
                    self.forget(sequence);
                } else if let Some(sequence) = background.exchange(sequence, time_ns, frame, &mut self.classes)? {
                    self.sequence = Some(sequence);
                }
            }
        }
        Ok(())
    }

    /// Reports that nothing was seen in this frame.
    pub(crate) fn forget(&mut self, sequence: u64) {
        self.sequence = None;
        if let Worker::Background(background) = &mut self.worker {
            background.from_sequence = sequence.saturating_add(1);
        }
    }

    /// The latest classes.
    pub(crate) fn seen(&self) -> Option<SeenClasses<'_>> {
        self.sequence.map(|sequence| SeenClasses { classes: Cow::Borrowed(&self.classes), sequence })
    }
}

impl Background {
    fn new(classifier: Classifier, classes: Classes) -> Result<Self, Error> {
        let slot = Slot {
            difference: Vec::new(),
            fitted: FittedTouches::default(),
            sequence: 0,
            state: State::Idle,
            classes,
            failed: None,
            ended: false,
        };
        let mailbox = Arc::new(Mailbox { slot: Mutex::new(slot), arrived: Condvar::new() });
        let worker = Arc::clone(&mailbox);
        let thread = std::thread::Builder::new()
            .name("classes".into())
            .spawn(move || worker.work(classifier))
            .map_err(|source| Error::Thread { what: "classes", source })?;
        Ok(Self { mailbox, thread: Some(thread), asked_ns: None, from_sequence: 0 })
    }

    /// Collects finished classes into `classes`, and hands over this frame if the network is free. Returns the
    /// sequence number of these classes' frame.
    fn exchange(
        &mut self,
        sequence: u64,
        time_ns: u64,
        frame: &FittedFrame<'_>,
        classes: &mut Classes,
    ) -> Result<Option<u64>, Error> {
        // Never wait: the network holds the slot only briefly, and the next frame comes soon.
        let Ok(mut slot) = self.mailbox.slot.try_lock() else { return Ok(None) };
        if let Some(error) = slot.failed.take() {
            return Err(error);
        }
        let mut taken = None;
        if slot.state == State::Done {
            slot.state = State::Idle;
            if slot.sequence >= self.from_sequence {
                std::mem::swap(classes, &mut slot.classes);
                taken = Some(slot.sequence);
            }
        }
        let due = self.asked_ns.is_none_or(|asked_ns| time_ns.saturating_sub(asked_ns) >= INTERVAL_NS);
        if slot.state == State::Idle && due {
            slot.difference.clear();
            slot.difference.extend_from_slice(frame.difference);
            slot.fitted.set(frame.difference, frame.contacts, frame.explained);
            (slot.sequence, slot.state) = (sequence, State::Asked);
            self.asked_ns = Some(time_ns);
            self.mailbox.arrived.notify_one();
        }
        Ok(taken)
    }
}
