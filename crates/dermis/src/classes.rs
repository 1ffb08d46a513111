//! The network's word beside the live image: classes of the pixels. A network takes some milliseconds, which touches must not
//! wait for; so it works on a thread of its own, at most so many times a second, and its classes come a little after their
//! frame.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use dermis_learn::Model;

use crate::Error;
use crate::learning::{Classes, Classifier};
use crate::prepare::Prepared;

/// When a network is asked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClassPace {
    /// In every frame, which waits for it.
    EveryFrame,
    /// Beside the frames, at most 25 times a second of theirs: a frame's classes are seen some frames later.
    Beside,
}

/// What a network made of a frame.
#[derive(Clone, Copy, Debug)]
pub struct SeenClasses<'a> {
    /// Classes of the pixels.
    pub classes: &'a Classes,
    /// Number of the frame that they are of: the present one, or one a little before.
    pub sequence: u64,
}

/// Least time between two frames that are looked at beside the others, nanoseconds.
const INTERVAL_NS: u64 = 40_000_000;

/// A network with the classes that it saw last.
#[derive(Debug)]
pub(crate) struct ClassStage {
    works: Works,
    classes: Classes,
    /// The frame that they are of.
    sequence: Option<u64>,
}

#[derive(Debug)]
enum Works {
    Here(Box<Classifier>),
    Beside(Beside),
}

#[derive(Debug)]
struct Beside {
    desk: Arc<Desk>,
    thread: Option<JoinHandle<()>>,
    /// When a frame was last handed over.
    asked_ns: Option<u64>,
    /// What is of a frame before this one is of no use any more.
    from_sequence: u64,
}

/// Where frames are left for the network, and its classes for the frames.
#[derive(Debug)]
struct Desk {
    papers: Mutex<Papers>,
    arrived: Condvar,
}

#[derive(Debug)]
struct Papers {
    difference: Vec<f64>,
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
    /// A frame lies there.
    Asked,
    /// The network looks at it.
    Busy,
    /// Its classes lie there.
    Done,
}

impl Desk {
    /// Nobody panics while holding the papers; if it were so, they would be as good as before.
    fn papers(&self) -> MutexGuard<'_, Papers> {
        self.papers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Looks at one frame after the other.
    fn work(&self, mut classifier: Classifier) {
        let (mut difference, mut classes) = (Vec::new(), Classes::new(0, 0));
        loop {
            let mut papers = self.papers();
            while papers.state != State::Asked && !papers.ended {
                papers = self.arrived.wait(papers).unwrap_or_else(PoisonError::into_inner);
            }
            if papers.ended {
                return;
            }
            std::mem::swap(&mut difference, &mut papers.difference);
            papers.state = State::Busy;
            drop(papers);
            let seen = classifier.classify(&difference, &mut classes);
            let mut papers = self.papers();
            match seen {
                Ok(()) => std::mem::swap(&mut classes, &mut papers.classes),
                Err(error) => papers.failed = Some(error),
            }
            papers.state = State::Done;
        }
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        self.desk.papers().ended = true;
        self.desk.arrived.notify_one();
        if let Some(thread) = self.thread.take() {
            // A panic there was reported by its own thread.
            let _ = thread.join();
        }
    }
}

impl ClassStage {
    pub(crate) fn new(prepared: &Prepared, model: &Model, pace: ClassPace) -> Result<Self, Error> {
        let grid = prepared.map.grid();
        let classes = Classes::new(grid.rows, grid.columns);
        let classifier = Classifier::new(prepared, model)?;
        let works = match pace {
            ClassPace::EveryFrame => Works::Here(Box::new(classifier)),
            ClassPace::Beside => Works::Beside(Beside::new(classifier, classes.clone())?),
        };
        Ok(Self { works, classes, sequence: None })
    }

    /// Classifies difference data (model volts, `NaN` where missing) of a frame at a time on the skin's clock.
    pub(crate) fn see(&mut self, sequence: u64, time_ns: u64, difference: &[f64]) -> Result<(), Error> {
        let anything = difference.iter().any(|value| value.is_finite());
        match &mut self.works {
            Works::Here(classifier) => {
                self.sequence = None;
                if anything {
                    classifier.classify(difference, &mut self.classes)?;
                    self.sequence = Some(sequence);
                }
            }
            Works::Beside(beside) => {
                if !anything {
                    self.forget(sequence);
                } else if let Some(sequence) = beside.see(sequence, time_ns, difference, &mut self.classes)? {
                    self.sequence = Some(sequence);
                }
            }
        }
        Ok(())
    }

    /// Nothing was seen in this frame.
    pub(crate) fn forget(&mut self, sequence: u64) {
        self.sequence = None;
        if let Works::Beside(beside) = &mut self.works {
            beside.from_sequence = sequence.saturating_add(1);
        }
    }

    /// The latest classes.
    pub(crate) fn seen(&self) -> Option<SeenClasses<'_>> {
        self.sequence.map(|sequence| SeenClasses { classes: &self.classes, sequence })
    }
}

impl Beside {
    fn new(classifier: Classifier, classes: Classes) -> Result<Self, Error> {
        let papers =
            Papers { difference: Vec::new(), sequence: 0, state: State::Idle, classes, failed: None, ended: false };
        let desk = Arc::new(Desk { papers: Mutex::new(papers), arrived: Condvar::new() });
        let worker = Arc::clone(&desk);
        let thread = std::thread::Builder::new()
            .name("classes".into())
            .spawn(move || worker.work(classifier))
            .map_err(|source| Error::Thread { what: "classes", source })?;
        Ok(Self { desk, thread: Some(thread), asked_ns: None, from_sequence: 0 })
    }

    /// Takes what the network is done with, and leaves it this frame if it is free; the number of the frame whose classes
    /// were put into `classes`.
    fn see(
        &mut self,
        sequence: u64,
        time_ns: u64,
        difference: &[f64],
        classes: &mut Classes,
    ) -> Result<Option<u64>, Error> {
        // Never waits: the network holds the papers for a moment at a time, and the next frame comes soon.
        let Ok(mut papers) = self.desk.papers.try_lock() else { return Ok(None) };
        if let Some(error) = papers.failed.take() {
            return Err(error);
        }
        let mut taken = None;
        if papers.state == State::Done {
            papers.state = State::Idle;
            if papers.sequence >= self.from_sequence {
                std::mem::swap(classes, &mut papers.classes);
                taken = Some(papers.sequence);
            }
        }
        let due = self.asked_ns.is_none_or(|asked_ns| time_ns.saturating_sub(asked_ns) >= INTERVAL_NS);
        if papers.state == State::Idle && due {
            papers.difference.clear();
            papers.difference.extend_from_slice(difference);
            (papers.sequence, papers.state) = (sequence, State::Asked);
            self.asked_ns = Some(time_ns);
            self.desk.arrived.notify_one();
        }
        Ok(taken)
    }
}
