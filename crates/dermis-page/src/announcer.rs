//! Turns events of a frame into notices: damage, faults of channels, a circuit that was found, clock jumps.

use dermis_live::clock::FrameAnomalies;
use dermis_live::skin_frame::SkinFrame;
use dermis_live::stages::damage::describe;
use dermis_live::stages::health::{HealthChange, HealthWatch};
use dermis_skin::Skin;

use crate::message::{Level, Notice};

/// Announces everything that begins or ends with a frame, once.
#[derive(Debug)]
pub struct Announcer {
    health: HealthWatch,
}

impl Announcer {
    /// An announcer for a skin without known faults.
    pub fn new(skin: &Skin) -> Self {
        Self { health: HealthWatch::new(skin) }
    }

    /// Notices for the next frame.
    pub fn notices(&mut self, output: &SkinFrame<'_>) -> Vec<Notice> {
        let warning = |text| Notice { level: Level::Warning, text };
        let mut notices: Vec<Notice> = output.damage.events.iter().map(|event| warning(describe(event))).collect();
        notices.extend(self.health.changes(&output.health).into_iter().map(
            |HealthChange { detail, is_fault, .. }| Notice {
                level: if is_fault { Level::Warning } else { Level::Info },
                text: detail,
            },
        ));
        notices.extend(output.circuit.map(|news| {
            let is_doubted = news.is_new && !news.fit.is_trusted();
            Notice { level: if is_doubted { Level::Warning } else { Level::Info }, text: news.describe() }
        }));
        let FrameAnomalies { clock_jump_ns, renumbered, .. } = output.anomalies;
        if clock_jump_ns != 0 || renumbered {
            let jump_s = clock_jump_ns as f64 * 1e-9;
            let reset = if renumbered { " and its frame numbers start again: it was reset" } else { "" };
            let text =
                format!("the device's clock was off by {jump_s:.1} s{reset}; time continues at its earlier rate");
            notices.push(warning(text));
        }
        notices
    }
}
