//! The clock by which stages are timed: the system's. WebAssembly in a browser has none; there it is the one that the
//! program around the pipeline gives once, by `set_clock`, and without one every stage takes no time.

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

    /// A time of the clock that [`set_clock`] gave.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
    pub struct Instant(Duration);

    /// Times stages by `now` from here on: the time since any moment, never less than before. A clock that was given
    /// before stays.
    pub fn set_clock(now: fn() -> Duration) {
        // The first one is as good as any.
        let _ = CLOCK.set(now);
    }

    impl Instant {
        /// Now.
        pub fn now() -> Self {
            Self(CLOCK.get().map_or(Duration::ZERO, |now| now()))
        }

        /// Time since then.
        pub fn elapsed(&self) -> Duration {
            Self::now() - *self
        }

        /// Time from `earlier` to this; zero where that is later.
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
