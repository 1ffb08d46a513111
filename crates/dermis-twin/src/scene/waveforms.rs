//! Scripts of one round indenter with time-dependent pressure: ramps, taps, sines. They are ordinary lists of events,
//! so they can be edited, saved and combined.

use std::f64::consts::TAU;

use super::script::{Event, Script};
use crate::error::{TwinError, check, check_positive};

/// Number of events per period of a sine. Linear in between, they deviate by at most `1 - cos(pi / 64)` of its
/// amplitude, 0.12 %.
const EVENTS_PER_PERIOD: f64 = 64.0;
/// Minimum pressure as a share of a waveform's maximum, because a pointer with zero pressure is not allowed.
const LEAST_SHARE: f64 = 1e-6;

/// Position of a round indenter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Centre, to the right of the centroid.
    pub x_m: f64,
    /// Centre, above the centroid.
    pub y_m: f64,
    /// Radius.
    pub radius_m: f64,
}

impl Place {
    fn press(&self, time_s: f64, pointer: u64, pressure_pa: f64) -> Event {
        let (x_mm, y_mm, radius_mm) = (1e3 * self.x_m, 1e3 * self.y_m, 1e3 * self.radius_m);
        Event::Press { time_s, pointer, x_mm, y_mm, radius_mm, pressure_kpa: 1e-3 * pressure_pa }
    }

    fn change(&self, time_s: f64, pointer: u64, pressure_pa: f64) -> Event {
        let (x_mm, y_mm, pressure_kpa) = (1e3 * self.x_m, 1e3 * self.y_m, Some(1e-3 * pressure_pa));
        Event::Move { time_s, pointer, x_mm, y_mm, radius_mm: None, pressure_kpa }
    }
}

impl Script {
    /// Pressure that changes linearly from one value to another over `rise_s` and then stays for `hold_s`. A zero at
    /// either end is replaced with a millionth of the other value.
    ///
    /// # Errors
    /// Invalid times or pressures, or an invalid position.
    pub fn ramp(place: Place, [from_pa, to_pa]: [f64; 2], rise_s: f64, hold_s: f64) -> Result<Self, TwinError> {
        check_positive("ramp rise_s", rise_s)?;
        check("ramp hold_s", hold_s, 0.0, f64::MAX, "zero or more, finite")?;
        let least = LEAST_SHARE * from_pa.max(to_pa);
        let events = vec![place.press(0.0, 1, from_pa.max(least)), place.change(rise_s, 1, to_pa.max(least))];
        Self::checked(rise_s + hold_s, events)
    }

    /// `count` taps at `frequency_hz`, each pressed for a share `duty` of its period, starting immediately. Touches
    /// fade in and out according to the scene.
    ///
    /// # Errors
    /// As [`Script::ramp`]; also fails for a duty not between 0 and 1, and for no taps.
    pub fn taps(place: Place, pressure_pa: f64, frequency_hz: f64, duty: f64, count: usize) -> Result<Self, TwinError> {
        check_positive("tap frequency_hz", frequency_hz)?;
        check("tap duty", duty, f64::MIN_POSITIVE, 1.0 - f64::EPSILON, "above 0 and below 1")?;
        check("taps", count as f64, 1.0, 1e6, "at least 1")?;
        let period_s = frequency_hz.recip();
        let tap = |k: usize| {
            let start_s = k as f64 * period_s;
            [place.press(start_s, 1, pressure_pa), Event::Release { time_s: start_s + duty * period_s, pointer: 1 }]
        };
        Self::checked(count as f64 * period_s, (0..count).flat_map(tap).collect())
    }

    /// Pressure `mean + amplitude sin(2 pi f t)` for `duration_s`. An amplitude equal to the mean reaches zero, which
    /// is replaced with a millionth of the maximum pressure.
    ///
    /// # Errors
    /// As [`Script::ramp`]; also fails for an amplitude above the mean and for more than a million periods.
    pub fn sine(
        place: Place,
        mean_pa: f64,
        amplitude_pa: f64,
        frequency_hz: f64,
        duration_s: f64,
    ) -> Result<Self, TwinError> {
        check_positive("sine frequency_hz", frequency_hz)?;
        check_positive("sine duration_s", duration_s)?;
        check("sine periods", frequency_hz * duration_s, 0.0, 1e6, "at most a million")?;
        check("sine amplitude_pa", amplitude_pa, 0.0, mean_pa, "0 to the mean")?;
        let least = LEAST_SHARE * (mean_pa + amplitude_pa);
        let at = |t: f64| (mean_pa + amplitude_pa * (TAU * frequency_hz * t).sin()).max(least);
        let step_s = (frequency_hz * EVENTS_PER_PERIOD).recip();
        let steps = (duration_s / step_s).ceil() as usize;
        let mut events = vec![place.press(0.0, 1, at(0.0))];
        events.extend((1..=steps).map(|k| (k as f64 * step_s).min(duration_s)).map(|t| place.change(t, 1, at(t))));
        Self::checked(duration_s, events)
    }

    fn checked(duration_s: f64, events: Vec<Event>) -> Result<Self, TwinError> {
        let script = Self { duration_s, repeat: false, events };
        script.check()?;
        Ok(script)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: Place = Place { x_m: 0.01, y_m: -0.02, radius_m: 0.005 };

    fn pressure(script: &Script, time_s: f64) -> f64 {
        script.at(time_s).map(|(_, indenter)| indenter.pressure_pa()).sum()
    }

    #[test]
    fn a_ramp_is_straight_and_stays() {
        let script = Script::ramp(PLACE, [0.0, 2e3], 4.0, 1.0).unwrap();
        for (time, expected) in [(1.0, 500.0), (2.0, 1e3), (3.9, 1950.0), (4.0, 2e3), (4.9, 2e3), (5.0, 0.0)] {
            // The ramp starts at 2 mPa.
            assert!((pressure(&script, time) - expected).abs() < 3e-3, "{time}: {}", pressure(&script, time));
        }
        let (_, indenter) = script.at(1.0).next().unwrap();
        assert!((indenter.centre_m[0] - 0.01).abs() < 1e-12 && (indenter.centre_m[1] + 0.02).abs() < 1e-12);
        let down = Script::ramp(PLACE, [2e3, 0.0], 4.0, 0.0).unwrap();
        assert!((pressure(&down, 3.0) - 500.0).abs() < 3e-3);
    }

    #[test]
    fn taps_press_for_their_share_of_the_period() {
        let script = Script::taps(PLACE, 1e3, 2.0, 0.25, 3).unwrap();
        let pressed: usize = (0..2000).filter(|k| pressure(&script, 1e-3 * f64::from(*k)) > 0.0).count();
        // Three taps of 125 ms in steps of 1 ms.
        assert!((373..=377).contains(&pressed), "{pressed}");
        assert_eq!(
            [0.05, 0.2, 0.55, 1.05, 1.45, 1.6].map(|t| pressure(&script, t) > 0.0),
            [true, false, true, true, false, false]
        );
    }

    #[test]
    fn a_sine_is_one_to_a_thousandth() {
        let script = Script::sine(PLACE, 1e3, 600.0, 3.0, 2.0).unwrap();
        for k in 0..199 {
            let time = 0.01 * f64::from(k);
            let exact = 1e3 + 600.0 * (TAU * 3.0 * time).sin();
            assert!((pressure(&script, time) - exact).abs() < 1.3e-3 * 600.0, "{time}");
        }
    }

    #[test]
    fn bad_input_is_refused() {
        assert!(Script::ramp(PLACE, [0.0, f64::NAN], 1.0, 0.0).is_err());
        assert!(Script::ramp(PLACE, [-1.0, -1.0], 1.0, 0.0).is_err());
        assert!(Script::ramp(PLACE, [0.0, 1.0], 0.0, 1.0).is_err());
        assert!(Script::taps(PLACE, 1e3, 1.0, 1.0, 3).is_err());
        assert!(Script::taps(PLACE, 1e3, 1.0, 0.5, 0).is_err());
        let error = Script::sine(PLACE, 1e3, 2e3, 1.0, 1.0).unwrap_err().to_string();
        assert_eq!(error, "sine amplitude_pa: 2000 refused; expected 0 to the mean");
        assert!(Script::sine(Place { radius_m: -1.0, ..PLACE }, 1e3, 0.0, 1.0, 1.0).is_err());
    }
}
