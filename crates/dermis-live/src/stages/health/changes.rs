//! Changes in the health of a skin from one frame to the next, in words and numbers, for logs, the page and
//! recordings. Electrodes come first; channels that fail with an electrode are not listed separately.

use dermis_touch::health::{
    ChannelFault, ChannelFaultKind, ElectrodeFault, ElectrodeFaultKind, FrameFault, FrameFaultKind, Health,
};

use dermis_skin::{Modality, Skin};

/// Maximum number of channels named in a description; the others are counted.
const MOST_NAMED: usize = 8;

/// A fault that was detected, or has ended.
#[derive(Clone, Debug, PartialEq)]
pub struct HealthChange {
    /// `frame-fault`, `frame-recovered`, `electrode-fault`, `electrode-recovered`, `channel-fault` or
    /// `channel-recovered`; coils count as electrodes.
    pub event: &'static str,
    /// Description for users: `electrode 7 is lost since frame 142`.
    pub detail: String,
    /// The electrode, or the channels, counted from 1; empty for whole frames.
    pub numbers: Vec<f64>,
    /// True for a fault, false for a recovery.
    pub is_fault: bool,
}

/// Compares the health of every frame with the previous frame's. Allocates only if something has changed.
#[derive(Clone, Debug)]
pub struct HealthWatch {
    electrode: &'static str,
    frame: Option<FrameFault>,
    electrodes: Vec<ElectrodeFault>,
    channels: Vec<ChannelFault>,
}

impl HealthWatch {
    /// A watch without known faults, using the terms of this skin.
    pub fn new(skin: &Skin) -> Self {
        let electrode = if skin.modality == Modality::Mit { "coil" } else { "electrode" };
        Self { electrode, frame: None, electrodes: Vec::new(), channels: Vec::new() }
    }

    /// Changes in this frame.
    pub fn changes(&mut self, health: &Health<'_>) -> Vec<HealthChange> {
        if health.frame == self.frame && health.electrodes == self.electrodes && health.channels == self.channels {
            return Vec::new();
        }
        let mut changes = Vec::new();
        if health.frame != self.frame {
            changes.push(frame_change(health.frame));
            self.frame = health.frame;
        }
        self.electrode_changes(health, &mut changes);
        self.channel_changes(health, &mut changes);
        self.electrodes.clear();
        self.electrodes.extend_from_slice(&health.electrodes);
        self.channels.clear();
        self.channels.extend_from_slice(&health.channels);
        changes
    }

    fn electrode_changes(&self, health: &Health<'_>, changes: &mut Vec<HealthChange>) {
        let name = self.electrode;
        let same = |a: &ElectrodeFault, b: &ElectrodeFault| (a.electrode, a.kind) == (b.electrode, b.kind);
        for fault in health.electrodes.iter().filter(|fault| !self.electrodes.iter().any(|old| same(old, fault))) {
            let number = fault.electrode + 1;
            let how = match fault.kind {
                ElectrodeFaultKind::Lost => "lost".to_owned(),
                ElectrodeFaultKind::Shorted { with } => format!("shorted with {name} {}", with + 1),
            };
            let detail = format!("{name} {number} is {how} since frame {}", fault.since_sequence);
            let numbers = vec![f64::from(number)];
            changes.push(HealthChange { event: "electrode-fault", detail, numbers, is_fault: true });
        }
        let mut recovered: Vec<u32> = self.electrodes.iter().map(|fault| fault.electrode + 1).collect();
        recovered.dedup();
        recovered.retain(|number| !health.electrodes.iter().any(|fault| fault.electrode + 1 == *number));
        for number in recovered {
            let detail = format!("{name} {number} is sound again");
            let numbers = vec![f64::from(number)];
            changes.push(HealthChange { event: "electrode-recovered", detail, numbers, is_fault: false });
        }
    }

    fn channel_changes(&self, health: &Health<'_>, changes: &mut Vec<HealthChange>) {
        let is_own = |fault: &&ChannelFault| fault.kind != ChannelFaultKind::Electrode;
        let known = |fault: &ChannelFault| {
            self.channels.iter().any(|old| (old.channel, old.kind) == (fault.channel, fault.kind))
        };
        let mut new: Vec<&ChannelFault> = health.channels.iter().filter(is_own).filter(|fault| !known(fault)).collect();
        new.sort_by_key(|fault| (fault.kind, fault.channel));
        for of_kind in new.chunk_by(|a, b| a.kind == b.kind) {
            let numbers: Vec<u32> = of_kind.iter().map(|fault| fault.channel + 1).collect();
            let (first, kind) = (of_kind.iter().map(|fault| fault.since_sequence).min().unwrap_or(0), of_kind[0].kind);
            let detail = format!("{} {} since frame {first}", named(&numbers), kind.name());
            changes.push(channel_change("channel-fault", detail, &numbers, true));
        }
        let present = |channel: u32| health.channels.iter().any(|fault| fault.channel == channel);
        let own_before = self.channels.iter().filter(is_own);
        let numbers: Vec<u32> = own_before.filter(|old| !present(old.channel)).map(|fault| fault.channel + 1).collect();
        if !numbers.is_empty() {
            let detail = format!("{} sound again", named(&numbers));
            changes.push(channel_change("channel-recovered", detail, &numbers, false));
        }
    }
}

fn frame_change(fault: Option<FrameFault>) -> HealthChange {
    let Some(FrameFault { kind, since_sequence, .. }) = fault else {
        let detail = "the frames are sound again, and touches known".to_owned();
        return HealthChange { event: "frame-recovered", detail, numbers: Vec::new(), is_fault: false };
    };
    let what = match kind {
        FrameFaultKind::Frozen => "all channels read the same, frame after frame",
        FrameFaultKind::Saturated => "most channels are at the limit of the range",
        FrameFaultKind::Flipped => "all channels have changed sign",
        FrameFaultKind::Blank => "all readings have vanished",
        FrameFaultKind::OutOfRange => "the readings are far larger than any press can make them",
    };
    let detail = format!("touches are unknown since frame {since_sequence}: {what}");
    HealthChange { event: "frame-fault", detail, numbers: Vec::new(), is_fault: true }
}

fn channel_change(event: &'static str, detail: String, numbers: &[u32], is_fault: bool) -> HealthChange {
    HealthChange { event, detail, numbers: numbers.iter().copied().map(f64::from).collect(), is_fault }
}

/// `channel 3 is`, `channels 3, 4 are`.
fn named(numbers: &[u32]) -> String {
    let shown: Vec<String> = numbers.iter().take(MOST_NAMED).map(u32::to_string).collect();
    let shown = shown.join(", ");
    match numbers.len() {
        1 => format!("channel {shown} is"),
        count if count > MOST_NAMED => format!("channels {shown} and {} more are", count - MOST_NAMED),
        _ => format!("channels {shown} are"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(channel: u32, kind: ChannelFaultKind) -> ChannelFault {
        ChannelFault { channel, kind, since_ns: 0, since_sequence: 40 + u64::from(channel) }
    }

    fn electrode(electrode: u32, kind: ElectrodeFaultKind) -> ElectrodeFault {
        ElectrodeFault { electrode, kind, since_ns: 0, since_sequence: 7 }
    }

    fn texts(changes: &[HealthChange]) -> Vec<(&str, &str)> {
        changes.iter().map(|change| (change.event, change.detail.as_str())).collect()
    }

    #[test]
    fn faults_and_recoveries_are_told_once_each() {
        let mut watch = HealthWatch::new(&Skin::open("healing-square").unwrap());
        assert!(watch.changes(&Health::default()).is_empty());
        let channels = [
            channel(1, ChannelFaultKind::Electrode),
            channel(3, ChannelFaultKind::Stuck),
            channel(4, ChannelFaultKind::Stuck),
            channel(9, ChannelFaultKind::Noisy),
        ];
        let electrodes = [electrode(6, ElectrodeFaultKind::Lost)];
        let broken = Health { channels: (&channels).into(), electrodes: (&electrodes).into(), ..Health::default() };
        let changes = watch.changes(&broken);
        let expected = [
            ("electrode-fault", "electrode 7 is lost since frame 7"),
            ("channel-fault", "channel 10 is noisy since frame 49"),
            ("channel-fault", "channels 4, 5 are stuck since frame 43"),
        ];
        assert_eq!(texts(&changes), expected);
        assert_eq!(changes[2].numbers, [4.0, 5.0]);
        assert!(watch.changes(&broken).is_empty());
        // One of the stuck channels turns out to belong to a short; the others recover.
        let channels = [channel(3, ChannelFaultKind::Electrode)];
        let electrodes = [electrode(6, ElectrodeFaultKind::Shorted { with: 7 })];
        let changes = watch.changes(&Health {
            channels: (&channels).into(),
            electrodes: (&electrodes).into(),
            ..Health::default()
        });
        let expected = [
            ("electrode-fault", "electrode 7 is shorted with electrode 8 since frame 7"),
            ("channel-recovered", "channels 5, 10 are sound again"),
        ];
        assert_eq!(texts(&changes), expected);
        assert_eq!(texts(&watch.changes(&Health::default())), [("electrode-recovered", "electrode 7 is sound again")]);
    }

    #[test]
    fn a_fault_of_whole_frames_is_told_once_and_its_end_too() {
        let mut watch = HealthWatch::new(&Skin::open("healing-square").unwrap());
        let frame = Some(FrameFault { kind: FrameFaultKind::Frozen, since_ns: 0, since_sequence: 9 });
        let frozen = Health { frame, ..Health::default() };
        let told = "touches are unknown since frame 9: all channels read the same, frame after frame";
        assert_eq!(texts(&watch.changes(&frozen)), [("frame-fault", told)]);
        assert!(watch.changes(&frozen).is_empty());
        let over = "the frames are sound again, and touches known";
        assert_eq!(texts(&watch.changes(&Health::default())), [("frame-recovered", over)]);
    }

    #[test]
    fn many_channels_are_counted_and_coils_are_called_so() {
        let mut watch = HealthWatch::new(&Skin::open("em-8").unwrap());
        let channels: Vec<ChannelFault> = (0..20).map(|c| channel(c, ChannelFaultKind::Missing)).collect();
        let electrodes = [electrode(2, ElectrodeFaultKind::Lost)];
        let changes = watch.changes(&Health {
            channels: (&channels).into(),
            electrodes: (&electrodes).into(),
            ..Health::default()
        });
        assert_eq!(changes[0].detail, "coil 3 is lost since frame 7");
        let many = "channels 1, 2, 3, 4, 5, 6, 7, 8 and 12 more are missing since frame 40";
        assert_eq!((changes[1].detail.as_str(), changes[1].numbers.len()), (many, 20));
    }
}
