//! Verdicts of a guard, and their reasons.

/// A verdict, from the harmless one to the most urgent one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GuardVerdict {
    /// The frame is recent and trusted, and no limit is exceeded.
    Ok,
    /// Unknown: no recent frame, or one that is not trusted. Treat it as a stop.
    Stale,
    /// A limit is exceeded, or may be.
    Stop,
}

impl GuardVerdict {
    /// The verdict in one word, as in files and streams.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::Stale => "stale",
            Self::Stop => "stop",
        }
    }
}

/// Why a verdict is not `ok`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum GuardReason {
    /// Something touches the skin.
    Touch,
    /// A touch reaches the force limit.
    Force,
    /// A touch reaches the pressure limit.
    Pressure,
    /// A touch has no force that can be compared with the limit.
    ForceUnknown,
    /// A touch has no pressure that can be compared with the limit.
    PressureUnknown,
    /// The skin is damaged.
    Damage,
    /// There is no baseline yet.
    NoBaseline,
    /// The baseline may include a touch, or the skin rests at other values.
    BaselineUntrusted,
    /// Frames are wrong as a whole: frozen, saturated, flipped, out of range or blank.
    FrameFault,
    /// More channels are left out or have no reading than allowed.
    ChannelsLeftOut,
    /// The last understood image of the skin is too old: readings since then are in doubt, or show something that is
    /// not recognised as a touch.
    InDoubt,
    /// The frame is older than the limit, or arrived late by the device's clock.
    Late,
    /// The time since the frame before exceeds the limit.
    Gap,
    /// The device's clock or frame numbers jumped, so the frame's age is unknown.
    Clock,
    /// No frame has come for longer than the limit.
    NoFrames,
    /// The source has ended or failed.
    Ended,
    /// The cause has gone, and the hold time has not passed yet.
    Held,
}

impl GuardReason {
    /// All reasons, in the order of their names in lists.
    pub const ALL: [Self; 17] = [
        Self::Touch,
        Self::Force,
        Self::Pressure,
        Self::ForceUnknown,
        Self::PressureUnknown,
        Self::Damage,
        Self::NoBaseline,
        Self::BaselineUntrusted,
        Self::FrameFault,
        Self::ChannelsLeftOut,
        Self::InDoubt,
        Self::Late,
        Self::Gap,
        Self::Clock,
        Self::NoFrames,
        Self::Ended,
        Self::Held,
    ];

    /// The reason as in files and streams.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Touch => "touch",
            Self::Force => "force",
            Self::Pressure => "pressure",
            Self::ForceUnknown => "force-unknown",
            Self::PressureUnknown => "pressure-unknown",
            Self::Damage => "damage",
            Self::NoBaseline => "no-baseline",
            Self::BaselineUntrusted => "baseline-untrusted",
            Self::FrameFault => "frame-fault",
            Self::ChannelsLeftOut => "channels-left-out",
            Self::InDoubt => "in-doubt",
            Self::Late => "late",
            Self::Gap => "gap",
            Self::Clock => "clock",
            Self::NoFrames => "no-frames",
            Self::Ended => "ended",
            Self::Held => "held",
        }
    }

    /// The verdict that the reason leads to. A held verdict keeps its own.
    fn verdict(self) -> GuardVerdict {
        match self {
            Self::Touch
            | Self::Force
            | Self::Pressure
            | Self::ForceUnknown
            | Self::PressureUnknown
            | Self::Damage
            | Self::Ended => GuardVerdict::Stop,
            Self::NoBaseline
            | Self::BaselineUntrusted
            | Self::FrameFault
            | Self::ChannelsLeftOut
            | Self::InDoubt
            | Self::Late
            | Self::Gap
            | Self::Clock
            | Self::NoFrames
            | Self::Held => GuardVerdict::Stale,
        }
    }
}

/// A set of reasons.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GuardReasons(u32);

impl GuardReasons {
    /// Adds a reason.
    pub fn insert(&mut self, reason: GuardReason) {
        self.0 |= 1 << reason as u8;
    }

    /// True if the reason is in the set.
    #[must_use]
    pub fn contains(self, reason: GuardReason) -> bool {
        self.0 & 1 << reason as u8 != 0
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The reasons, in the order of [`GuardReason::ALL`].
    pub fn iter(self) -> impl Iterator<Item = GuardReason> {
        GuardReason::ALL.into_iter().filter(move |reason| self.contains(*reason))
    }

    /// The most urgent verdict of the reasons; `ok` if there is none.
    pub(super) fn verdict(self) -> GuardVerdict {
        self.iter().map(GuardReason::verdict).max().unwrap_or(GuardVerdict::Ok)
    }
}

/// The verdict on a frame, and how long it may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuardReport {
    /// The verdict.
    pub verdict: GuardVerdict,
    /// Its reasons; none if it is `ok`.
    pub reasons: GuardReasons,
    /// Arrival of the frame on the host's monotonic clock, nanoseconds.
    pub frame_ns: u64,
    /// Age of the frame from which on the verdict is stale, nanoseconds.
    pub stale_after_ns: u64,
}

impl GuardReport {
    /// The report before the first frame, at a time on the host's monotonic clock.
    #[must_use]
    pub fn before_frames(now_ns: u64, stale_after_ns: u64) -> Self {
        let mut reasons = GuardReasons::default();
        reasons.insert(GuardReason::NoBaseline);
        Self { verdict: GuardVerdict::Stale, reasons, frame_ns: now_ns, stale_after_ns }
    }

    /// The same report at a later time: never `ok` once the frame is older than the limit.
    #[must_use]
    pub fn at(self, now_ns: u64) -> Self {
        if now_ns.saturating_sub(self.frame_ns) <= self.stale_after_ns {
            return self;
        }
        let mut reasons = self.reasons;
        reasons.insert(GuardReason::NoFrames);
        Self { verdict: self.verdict.max(GuardVerdict::Stale), reasons, ..self }
    }

    /// The last report of a source: there will be no more frames.
    #[must_use]
    pub fn ended(self) -> Self {
        let mut reasons = GuardReasons::default();
        reasons.insert(GuardReason::Ended);
        Self { verdict: GuardVerdict::Stop, reasons, ..self }
    }
}
