//! The state of every patch, for `/diagnostics`.

use std::sync::{Arc, Mutex, PoisonError};

use dermis_device::acquire::AcquisitionCounters;
use dermis_live::pipeline::Pipeline;

use super::messages::{Diagnosis, Level};

/// The state of a patch.
#[derive(Clone, Debug, Default)]
pub(super) struct PatchStatus {
    frames: u64,
    counters: AcquisitionCounters,
    channels_left_out: Vec<u32>,
    electrodes: usize,
    frame_fault: bool,
    has_baseline: bool,
    latency_p99_ms: f64,
    problem: Option<String>,
}

impl PatchStatus {
    /// The state of a pipeline and its stream.
    pub fn new(pipeline: &Pipeline, counters: AcquisitionCounters) -> Self {
        let health = pipeline.health();
        Self {
            frames: pipeline.frames(),
            counters,
            channels_left_out: health.channels.iter().map(|fault| fault.channel + 1).collect(),
            electrodes: health.electrodes.len(),
            frame_fault: health.frame.is_some(),
            has_baseline: pipeline.reference().is_some(),
            latency_p99_ms: 1e-3 * pipeline.latencies().total.quantile_us(0.99),
            problem: None,
        }
    }
}

/// A state that the pipeline's thread writes and the node's thread reads.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedStatus(Arc<Mutex<PatchStatus>>);

impl SharedStatus {
    pub fn set(&self, status: PatchStatus) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = status;
    }

    /// Sets the reason why no frames arrive.
    pub fn set_problem(&self, problem: Option<&str>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).problem = problem.map(str::to_owned);
    }

    fn get(&self) -> PatchStatus {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Numbers of the node itself.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Traffic {
    pub sent: u64,
    pub dropped: u64,
    /// Messages refused because of a reader that acknowledges nothing.
    pub refused: u64,
}

/// Turns the states of one patch into diagnoses, one per second.
#[derive(Debug)]
pub(super) struct Watch {
    status: SharedStatus,
    name: String,
    source: String,
    last: PatchStatus,
    last_ns: u64,
    last_traffic: Traffic,
}

impl Watch {
    /// A watch over a patch called `name`, with frames from `source`.
    pub fn new(status: SharedStatus, name: String, source: String, now_ns: u64) -> Self {
        let (last, last_traffic) = (PatchStatus::default(), Traffic::default());
        Self { status, name, source, last, last_ns: now_ns, last_traffic }
    }

    /// The diagnosis at a time on the host's monotonic clock, and what has happened since the last one.
    pub fn diagnose(&mut self, now_ns: u64, traffic: Traffic) -> Diagnosis {
        let status = self.status.get();
        let (last, elapsed_s) = (&self.last, 1e-9 * now_ns.saturating_sub(self.last_ns).max(1) as f64);
        let frames_per_s = status.frames.saturating_sub(last.frames) as f64 / elapsed_s;
        let new_lost = status.counters.total().saturating_sub(last.counters.total());
        let new_dropped =
            (traffic.dropped + traffic.refused).saturating_sub(self.last_traffic.dropped + self.last_traffic.refused);
        let left_out = status.channels_left_out.len();
        let (level, message) = match &status {
            PatchStatus { problem: Some(problem), .. } => (Level::Error, problem.clone()),
            _ if frames_per_s <= 0.0 => (Level::Stale, "no frames".to_owned()),
            PatchStatus { has_baseline: false, .. } => (Level::Warn, "no baseline yet".to_owned()),
            PatchStatus { frame_fault: true, .. } => {
                (Level::Error, "frames are wrong as a whole: touches are unknown".to_owned())
            }
            _ if new_lost > 0 => (Level::Warn, format!("{new_lost} frames lost in the last second")),
            _ if left_out > 0 => (Level::Warn, format!("{left_out} channels left out")),
            _ if new_dropped > 0 => (Level::Warn, format!("{new_dropped} messages not sent in the last second")),
            _ => (Level::Ok, "running".to_owned()),
        };
        let channels: Vec<String> = status.channels_left_out.iter().map(u32::to_string).collect();
        let counters = &status.counters;
        let values = vec![
            ("source", self.source.clone()),
            ("frames", status.frames.to_string()),
            ("frames_per_s", format!("{frames_per_s:.1}")),
            ("lost", counters.lost.to_string()),
            ("damaged", counters.bad.to_string()),
            ("dropped", counters.dropped.to_string()),
            ("channels_left_out", channels.join(" ")),
            ("faulty_electrodes", status.electrodes.to_string()),
            ("latency_p99_ms", format!("{:.3}", status.latency_p99_ms)),
            ("messages_sent", traffic.sent.to_string()),
            ("messages_dropped", traffic.dropped.to_string()),
            ("messages_refused", traffic.refused.to_string()),
        ];
        (self.last, self.last_ns, self.last_traffic) = (status, now_ns, traffic);
        Diagnosis { level, name: self.name.clone(), message, hardware_id: self.source.clone(), values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_diagnosis_names_the_worst_and_counts_since_the_last_one() {
        let shared = SharedStatus::default();
        let mut watch = Watch::new(shared.clone(), "dermis: palm".into(), "twin".into(), 0);
        let diagnosis = watch.diagnose(SECOND_NS, Traffic::default());
        assert_eq!((diagnosis.level, diagnosis.message.as_str()), (Level::Stale, "no frames"));

        let status = PatchStatus { frames: 50, has_baseline: true, latency_p99_ms: 1.5, ..PatchStatus::default() };
        shared.set(status.clone());
        let diagnosis = watch.diagnose(2 * SECOND_NS, Traffic::default());
        assert_eq!((diagnosis.level, diagnosis.hardware_id.as_str()), (Level::Ok, "twin"));
        let value = |diagnosis: &Diagnosis, key: &str| {
            diagnosis.values.iter().find(|(name, _)| *name == key).map(|(_, value)| value.clone()).unwrap()
        };
        assert_eq!(value(&diagnosis, "frames_per_s"), "50.0");

        let counters = AcquisitionCounters { lost: 2, ..AcquisitionCounters::default() };
        shared.set(PatchStatus { frames: 90, counters, channels_left_out: vec![3, 4], ..status.clone() });
        let diagnosis = watch.diagnose(3 * SECOND_NS, Traffic::default());
        assert_eq!((diagnosis.level, diagnosis.message.as_str()), (Level::Warn, "2 frames lost in the last second"));
        assert_eq!(value(&diagnosis, "channels_left_out"), "3 4");

        shared.set(PatchStatus { frames: 130, counters, ..status });
        let dropped = Traffic { dropped: 5, ..Traffic::default() };
        assert_eq!(watch.diagnose(4 * SECOND_NS, dropped).message, "5 messages not sent in the last second");
        shared.set_problem(Some("tcp:skin:5025: connection refused"));
        let diagnosis = watch.diagnose(5 * SECOND_NS, dropped);
        assert_eq!((diagnosis.level, diagnosis.message.contains("refused")), (Level::Error, true));
    }
}
