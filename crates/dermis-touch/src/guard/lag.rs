//! How late frames arrive, by comparing the device's clock with the host's.

/// Rate at which a lag is forgotten, so that clocks that drift apart don't look like one: 1 %. The resonators and RC
/// oscillators of microcontrollers are within 1 %, crystals within 0.01 %.
const FORGOTTEN_NS_PER_S: u64 = 10_000_000;

/// Measures how much later than its predecessors a frame arrives. Frames that queue up anywhere between device and
/// host, for example while the host was suspended, arrive with increasing lag although their arrival times look fresh.
#[derive(Clone, Copy, Debug, Default)]
pub struct LagMeter {
    /// Smallest host time minus device time so far, and the host time of the last frame.
    fastest: Option<(i128, u64)>,
}

impl LagMeter {
    /// Takes a frame's times, nanoseconds, and returns its lag behind the fastest frame so far. 0 for the first one.
    pub fn lag_ns(&mut self, device_ns: u64, host_ns: u64) -> u64 {
        let offset = i128::from(host_ns) - i128::from(device_ns);
        let fastest = match self.fastest {
            None => offset,
            Some((fastest, last_ns)) => {
                let passed_ns = u128::from(host_ns.saturating_sub(last_ns));
                let forgotten = passed_ns * u128::from(FORGOTTEN_NS_PER_S) / 1_000_000_000;
                offset.min(fastest.saturating_add(i128::try_from(forgotten).unwrap_or(i128::MAX)))
            }
        };
        self.fastest = Some((fastest, host_ns));
        u64::try_from(offset - fastest).unwrap_or(u64::MAX)
    }

    /// Starts over, after the device's clock was set.
    pub fn reset(&mut self) {
        self.fastest = None;
    }
}
