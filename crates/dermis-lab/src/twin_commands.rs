//! The queue of commands to a running twin: one bounded queue for pages, standard input and all other callers. A
//! later command removes those that it makes pointless, equal commands are merged, and a command that doesn't fit is
//! refused with the reason.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use dermis_tomo::mesh::Point;
use dermis_twin::Treatment;
use dermis_twin::instrument::Fault;

/// Maximum number of presses and faults queued for the next frame.
pub const MOST_WAITING: usize = 256;
/// Maximum number of treatments queued while others are being prepared.
pub const MOST_TREATMENTS: usize = 64;

/// A command to a running twin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TwinCommand {
    /// Start a press, or change a current one.
    Press {
        /// Identifies the press.
        pointer: u64,
        /// Position, metres.
        position_m: Point,
        /// Radius of the indenter, metres.
        radius_m: f64,
        /// Pressure, pascals.
        pressure_pa: f64,
    },
    /// End a press.
    Release {
        /// Identifies the press.
        pointer: u64,
    },
    /// Add a fault to the instrument.
    Break(Fault),
    /// Cut, heat or renew a self-healing sheet.
    Treat(Treatment),
    /// Switch the demonstration on or off, which shows touches while nobody presses.
    Demonstrate(bool),
    /// Remove all faults, including those of the skin file.
    Repair,
}

/// Reason for refusing a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CommandRefused {
    /// The queue is full.
    #[error("{waiting} {what} are already waiting for the twin; expected fewer, or a pause between them")]
    Full {
        /// Kind of command.
        what: &'static str,
        /// Number already queued.
        waiting: usize,
    },
    /// The twin has ended.
    #[error("the twin has ended")]
    Ended,
}

#[derive(Debug, Default)]
struct Waiting {
    /// Presses, releases and faults.
    quick: VecDeque<TwinCommand>,
    treatments: VecDeque<Treatment>,
}

/// The sending end; any number of threads may hold one.
#[derive(Clone, Debug)]
pub struct TwinCommands(Weak<Mutex<Waiting>>);

/// The receiving end.
#[derive(Debug, Default)]
pub(crate) struct CommandQueue(Arc<Mutex<Waiting>>);

impl TwinCommands {
    /// Queues a command. It acts at the next frame, together with any that follow before then.
    ///
    /// # Errors
    /// The queue is full, or the twin has ended.
    pub fn send(&self, command: TwinCommand) -> Result<(), CommandRefused> {
        let waiting = self.0.upgrade().ok_or(CommandRefused::Ended)?;
        let mut waiting = locked(&waiting);
        match command {
            TwinCommand::Treat(treatment) => waiting.treat(treatment),
            quick => waiting.act(quick),
        }
    }
}

impl CommandQueue {
    pub fn sender(&self) -> TwinCommands {
        TwinCommands(Arc::downgrade(&self.0))
    }

    /// The next press, release or fault.
    pub fn next(&self) -> Option<TwinCommand> {
        locked(&self.0).quick.pop_front()
    }

    /// Takes all queued treatments.
    pub fn treatments(&self) -> Vec<Treatment> {
        locked(&self.0).treatments.drain(..).collect()
    }

    /// True if a new sheet is requested, which makes all earlier treatments pointless.
    pub fn renews(&self) -> bool {
        locked(&self.0).treatments.contains(&Treatment::Renew)
    }
}

/// A panic elsewhere cannot leave the queue inconsistent, so a poisoned lock is usable.
fn locked(waiting: &Mutex<Waiting>) -> MutexGuard<'_, Waiting> {
    waiting.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Waiting {
    fn act(&mut self, command: TwinCommand) -> Result<(), CommandRefused> {
        use TwinCommand::{Break, Demonstrate, Press, Release, Repair, Treat};
        match command {
            Press { pointer, .. } | Release { pointer } => {
                let of_it = |other: &&mut TwinCommand| matches!(other, Press { pointer: p, .. } | Release { pointer: p } if *p == pointer);
                let last = self.quick.iter_mut().rev().find(of_it);
                // Keep a release followed by a new press within one frame as two commands.
                if let Some(last) = last.filter(|last| !matches!((&**last, &command), (Release { .. }, Press { .. }))) {
                    *last = command;
                    return Ok(());
                }
            }
            Break(_) if self.quick.contains(&command) => return Ok(()),
            Repair => self.quick.retain(|other| !matches!(other, Break(_) | Repair)),
            Demonstrate(_) => self.quick.retain(|other| !matches!(other, Demonstrate(_))),
            Break(_) | Treat(_) => {}
        }
        // Always accept releases: nothing may stay pressed because the queue is full.
        let most = if matches!(command, Release { .. }) { 2 * MOST_WAITING } else { MOST_WAITING };
        if self.quick.len() >= most {
            return Err(CommandRefused::Full { what: "commands", waiting: self.quick.len() });
        }
        self.quick.push_back(command);
        Ok(())
    }

    fn treat(&mut self, treatment: Treatment) -> Result<(), CommandRefused> {
        use Treatment::{Cut, Heat, Renew, TimeLapse, Warm};
        match treatment {
            Cut(cut) if self.treatments.iter().any(|other| matches!(other, Cut(other) if other.is_along(&cut))) => {
                return Ok(());
            }
            Heat(_) if self.treatments.contains(&treatment) => return Ok(()),
            TimeLapse(_) => self.treatments.retain(|other| !matches!(other, TimeLapse(_))),
            Warm(_) => self.treatments.retain(|other| !matches!(other, Warm(_))),
            Renew => self.treatments.retain(|other| matches!(other, TimeLapse(_))),
            Cut(_) | Heat(_) => {}
        }
        if self.treatments.len() >= MOST_TREATMENTS {
            return Err(CommandRefused::Full { what: "treatments", waiting: self.treatments.len() });
        }
        self.treatments.push_back(treatment);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use dermis_twin::physics::Cut;

    use super::*;

    fn press(pointer: u64, x_m: f64) -> TwinCommand {
        TwinCommand::Press { pointer, position_m: [x_m, 0.0], radius_m: 0.01, pressure_pa: 1e3 }
    }

    fn left(commands: &[TwinCommand]) -> (Vec<TwinCommand>, Vec<Treatment>) {
        let queue = CommandQueue::default();
        commands.iter().for_each(|command| queue.sender().send(*command).unwrap());
        (std::iter::from_fn(|| queue.next()).collect(), queue.treatments())
    }

    #[test]
    fn the_last_of_each_pointer_counts_and_equal_cuts_are_one() {
        let release = TwinCommand::Release { pointer: 1 };
        assert_eq!(left(&[press(1, 0.0), press(2, 0.0), press(1, 0.1)]).0, [press(1, 0.1), press(2, 0.0)]);
        assert_eq!(left(&[press(1, 0.0), release, press(1, 0.1)]).0, [release, press(1, 0.1)]);
        let cut = |from_m, to_m| TwinCommand::Treat(Treatment::Cut(Cut::open(from_m, to_m)));
        let (a, b) = ([0.0, 0.0], [0.02, 0.0]);
        assert_eq!(left(&[cut(a, b), cut(b, a), cut(a, b)]).1.len(), 1);
        let lapse = |factor| TwinCommand::Treat(Treatment::TimeLapse(factor));
        assert_eq!(left(&[lapse(1.0), lapse(2.0), lapse(3.0)]).1, [Treatment::TimeLapse(3.0)]);
        assert_eq!(left(&[cut(a, b), TwinCommand::Treat(Treatment::Renew)]).1, [Treatment::Renew]);
        let broken = TwinCommand::Break(Fault::DeadCoil { coil: 1 });
        assert_eq!(left(&[broken, broken, TwinCommand::Repair]).0, [TwinCommand::Repair]);
    }

    #[test]
    fn a_full_queue_and_an_ended_twin_refuse_commands() {
        let queue = CommandQueue::default();
        let sender = queue.sender();
        let sent = (0..20_000).filter(|k| sender.send(press(*k, 0.0)).is_ok()).count();
        assert_eq!(sent, MOST_WAITING);
        let reason = sender.send(press(20_001, 0.0)).unwrap_err().to_string();
        assert!(reason.starts_with("256 commands are already waiting"), "{reason}");
        let cut = |k: u32| TwinCommand::Treat(Treatment::Cut(Cut::open([0.0, 0.0], [0.02, f64::from(k) * 1e-5])));
        assert_eq!((0..1000).filter(|k| sender.send(cut(*k)).is_ok()).count(), MOST_TREATMENTS);
        drop(queue);
        assert_eq!(sender.send(press(1, 0.0)), Err(CommandRefused::Ended));
    }
}
