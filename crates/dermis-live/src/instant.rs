//! The clock that times the stages: the system clock. WebAssembly in a browser has none; there the host program
//! supplies one by `set_clock`, and without one every stage takes no time.

#[cfg(not(all(target_arch = "wasm32", target_os = "unknown")))]
pub use std::time::Instant;

#[cfg(all(target_arch = "wasm32", target_os = "unknown"))]
pub use given::{Instant, set_clock};

#[cfg(all(target_arch = "wasm32", target_os = "unknown"))]
mod given {
    use std::ops::Sub;
    use std::sync::OnceLock;
    use std::time::Duration;

    static CLOCK: OnceLock<fn() -> Duration> = OnceLock::new();

    /// A time of the clock set by [`set_clock`].
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub struct Instant(Duration);

    /// Sets the clock that times the stages: time since any fixed moment, never decreasing. A clock that was set
    /// before stays.
    pub fn set_clock(now: fn() -> Duration) {
        // Only the first one counts.
        let _ = CLOCK.set(now);
    }

    impl Instant {
        /// Now.
        pub fn now() -> Self {
            Self(CLOCK.get().map_or(Duration::ZERO, |now| now()))
        }

        /// Time elapsed since this instant.
        pub fn elapsed(&self) -> Duration {
            Self::now() - *self
        }

        /// Time from `earlier` to this instant; zero if that is later.
        pub fn saturating_duration_since(&self, earlier: Self) -> Duration {
            *self - earlier
        }
    }

    impl Sub for Instant {
        type Output = Duration;

        fn sub(self, earlier: Self) -> Duration {
            self.0.saturating_sub(earlier.0)
        }
    }
}
