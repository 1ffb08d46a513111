//! Faults with a start and an end on the twin's clock.

use serde::{Deserialize, Serialize};

use super::Fault;
use crate::error::{TwinError, check};

/// A fault and its times.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TimedFault {
    /// The fault.
    pub fault: Fault,
    /// Start, seconds after the first frame.
    pub from_s: f64,
    /// End, seconds after the first frame; `None` if the fault is permanent.
    pub until_s: Option<f64>,
}

impl From<Fault> for TimedFault {
    /// A permanent fault from the first frame on.
    fn from(fault: Fault) -> Self {
        Self { fault, from_s: 0.0, until_s: None }
    }
}

impl TimedFault {
    /// True if the fault is active at this time.
    pub fn acts_at(&self, time_s: f64) -> bool {
        time_s >= self.from_s && self.until_s.is_none_or(|until| time_s < until)
    }

    /// Checks the times; the instrument checks the fault.
    ///
    /// # Errors
    /// A negative start, or an end that is not after it.
    pub fn check(&self) -> Result<(), TwinError> {
        check("fault from_s", self.from_s, 0.0, f64::MAX, "zero or more, finite")?;
        match self.until_s {
            Some(until) if until <= self.from_s => {
                Err(TwinError::Value { field: "fault until_s", value: until, expected: "after from_s" })
            }
            Some(until) => check("fault until_s", until, 0.0, f64::MAX, "finite"),
            None => Ok(()),
        }
    }
}

/// Timed faults, and which of them are active.
#[derive(Clone, Debug, Default)]
pub(crate) struct FaultSchedule {
    list: Vec<TimedFault>,
    acting: Vec<bool>,
}

impl FaultSchedule {
    /// None is active before the first [`FaultSchedule::change_at`].
    pub fn new(list: Vec<TimedFault>) -> Self {
        Self { acting: vec![false; list.len()], list }
    }

    /// The faults active at this time, if they have changed since the last call.
    pub fn change_at(&mut self, time_s: f64) -> Option<Vec<Fault>> {
        let mut changed = false;
        for (timed, acting) in self.list.iter().zip(&mut self.acting) {
            let now = timed.acts_at(time_s);
            changed |= now != *acting;
            *acting = now;
        }
        let acting = self.list.iter().zip(&self.acting).filter(|(_, acting)| **acting);
        changed.then(|| acting.map(|(timed, _)| timed.fault).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_change_is_reported_once() {
        let late = TimedFault { fault: Fault::DroppedFrames { probability: 0.5 }, from_s: 2.0, until_s: Some(3.0) };
        let stuck = Fault::StuckChannel { channel: 0, value_v: 0.0 };
        let mut schedule = FaultSchedule::new(vec![stuck.into(), late]);
        assert_eq!(schedule.change_at(0.0), Some(vec![stuck]));
        assert_eq!(schedule.change_at(1.9), None);
        assert_eq!(schedule.change_at(2.0), Some(vec![stuck, late.fault]));
        assert_eq!(schedule.change_at(3.0), Some(vec![stuck]));
        assert_eq!(schedule.change_at(9.0), None);
    }

    #[test]
    fn times_out_of_order_are_refused() {
        let timed = |from_s: f64, until_s: Option<f64>| TimedFault {
            fault: Fault::OpenElectrode { electrode: 0 },
            from_s,
            until_s,
        };
        assert!(timed(0.0, Some(1.0)).check().is_ok() && timed(1.0, None).check().is_ok());
        let error = timed(2.0, Some(1.0)).check().unwrap_err().to_string();
        assert_eq!(error, "fault until_s: 1 refused; expected after from_s");
        assert!(timed(-1.0, None).check().is_err() && timed(f64::NAN, None).check().is_err());
    }
}
