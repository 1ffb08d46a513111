//! Real-time priority for the threads between an instrument and its touches.

use std::marker::PhantomData;

/// Real-time priority of the current thread, until dropped.
#[derive(Debug)]
pub struct RealTime {
    is_granted: bool,
    /// It belongs to the thread.
    _stays: PhantomData<*const ()>,
}

impl RealTime {
    /// Asks for real-time priority (`SCHED_RR`, the lowest level), so that the thread runs as soon as it has something
    /// to do. Without it, a frame waits for up to two milliseconds while other threads use all cores. Linux grants it
    /// to root, and to users with an `rtprio` limit; other systems are not asked. On a single core it is not used,
    /// since a stream that is too fast would leave nothing for other threads. A process that was started with another
    /// policy, as by `chrt`, keeps that.
    ///
    /// New threads inherit it from the thread that starts them: call [`leave_real_time`] in those.
    #[must_use]
    pub fn request() -> Self {
        let is_granted = std::thread::available_parallelism().is_ok_and(|cores| cores.get() > 1) && system::enter();
        tracing::debug!(is_granted, "real-time priority");
        Self { is_granted, _stays: PhantomData }
    }

    /// True if the system has granted it.
    #[must_use]
    pub fn is_granted(&self) -> bool {
        self.is_granted
    }
}

impl Drop for RealTime {
    fn drop(&mut self) {
        if self.is_granted {
            leave_real_time();
        }
    }
}

/// Returns the current thread to ordinary priority, if it has inherited real-time priority.
pub fn leave_real_time() {
    system::leave();
}

#[cfg(target_os = "linux")]
mod system {
    use rustix::process::getpriority_process;
    use thread_priority::{
        NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
        ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
    };

    const REAL_TIME: ThreadSchedulePolicy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);

    const ORDINARY: ThreadSchedulePolicy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);

    pub fn enter() -> bool {
        thread_schedule_policy() == Ok(ORDINARY)
            && set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, REAL_TIME).is_ok()
    }

    pub fn leave() {
        if thread_schedule_policy() != Ok(REAL_TIME) {
            return;
        }
        // With the policy, the library sets a niceness. It must be the one that the user chose.
        let niceness = getpriority_process(None).unwrap_or(0);
        let priorities = (0..=u8::from(ThreadPriorityValue::MAX)).filter_map(|value| value.try_into().ok());
        let as_nice = |priority: &ThreadPriority| priority.to_posix(ORDINARY) == Ok(niceness);
        let priority = priorities.map(ThreadPriority::Crossplatform).find(as_nice).unwrap_or(ThreadPriority::Min);
        if let Err(error) = set_thread_priority_and_policy(thread_native_id(), priority, ORDINARY) {
            tracing::warn!("a thread keeps its real-time priority: {error:?}");
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod system {
    pub fn enter() -> bool {
        false
    }

    pub fn leave() {}
}

#[cfg(test)]
mod tests {
    #[cfg(target_os = "linux")]
    #[test]
    fn a_thread_returns_to_its_own_priority_and_new_ones_can() {
        use rustix::process::{getpriority_process, nice};
        use thread_priority::{NormalThreadSchedulePolicy, ThreadSchedulePolicy, thread_schedule_policy};

        use super::{RealTime, leave_real_time};

        std::thread::spawn(|| {
            let ordinary = Ok(ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other));
            nice(3).unwrap();
            let own = getpriority_process(None).unwrap();
            let real_time = RealTime::request();
            // Not every user may have it.
            assert_eq!(thread_schedule_policy() != ordinary, real_time.is_granted());
            let inherited = std::thread::spawn(move || {
                leave_real_time();
                (thread_schedule_policy(), getpriority_process(None))
            });
            let (policy, niceness) = inherited.join().unwrap();
            assert_eq!(policy, ordinary);
            assert_eq!(niceness, Ok(own));
            drop(real_time);
            assert_eq!(thread_schedule_policy(), ordinary);
            assert_eq!(getpriority_process(None), Ok(own));
        })
        .join()
        .unwrap();
    }
}
