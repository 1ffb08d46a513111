//! Scripts: lists of timed press, move and release events, in TOML or built in code. Between two events of a pressing
//! pointer, its position, radius and pressure change linearly; from its last event to its release they stay constant.

use std::f64::consts::TAU;

use dermis_tomo::mesh::Outline;
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check_positive};
use crate::mechanics::{Indenter, check_on_skin};

/// An action of a pointer at a time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "action", rename_all = "snake_case", deny_unknown_fields)]
pub enum Event {
    /// Starts to press with a round indenter.
    Press {
        /// Time from the beginning of the script.
        time_s: f64,
        /// Number of the pointer.
        pointer: u64,
        /// Position along x.
        x_mm: f64,
        /// Position along y.
        y_mm: f64,
        /// Radius of the indenter.
        radius_mm: f64,
        /// Pressure under it.
        pressure_kpa: f64,
    },
    /// Reaches a position or a new load at this time.
    Move {
        /// Time from the beginning of the script.
        time_s: f64,
        /// Number of the pointer.
        pointer: u64,
        /// Position along x.
        x_mm: f64,
        /// Position along y.
        y_mm: f64,
        /// New radius, if it changes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        radius_mm: Option<f64>,
        /// New pressure, if it changes.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        pressure_kpa: Option<f64>,
    },
    /// Stops pressing.
    Release {
        /// Time from the beginning of the script.
        time_s: f64,
        /// Number of the pointer.
        pointer: u64,
    },
}

/// A list of events with a duration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Script {
    /// Duration, seconds; all pointers are released at its end.
    pub duration_s: f64,
    /// True to repeat the script.
    #[serde(default)]
    pub repeat: bool,
    /// Events, ordered by time.
    pub events: Vec<Event>,
}

impl Event {
    fn time_s(&self) -> f64 {
        match *self {
            Self::Press { time_s, .. } | Self::Move { time_s, .. } | Self::Release { time_s, .. } => time_s,
        }
    }

    fn pointer(&self) -> u64 {
        match *self {
            Self::Press { pointer, .. } | Self::Move { pointer, .. } | Self::Release { pointer, .. } => pointer,
        }
    }

    /// The indenter after this event, given the one before it.
    fn indenter(&self, before: Option<Indenter>) -> Option<Indenter> {
        match *self {
            Self::Press { x_mm, y_mm, radius_mm, pressure_kpa, .. } => {
                Some(Indenter::disc([x_mm * 1e-3, y_mm * 1e-3], radius_mm * 1e-3, pressure_kpa * 1e3))
            }
            Self::Move { x_mm, y_mm, radius_mm, pressure_kpa, .. } => before.map(|before| {
                let radius = radius_mm.map_or(before.shape.equal_area_radius_m(), |mm| mm * 1e-3);
                let pressure = pressure_kpa.map_or(before.pressure_pa(), |kpa| kpa * 1e3);
                Indenter::disc([x_mm * 1e-3, y_mm * 1e-3], radius, pressure)
            }),
            Self::Release { .. } => None,
        }
    }
}

impl Script {
    /// Parses TOML and checks the script.
    ///
    /// ```
    /// let script = dermis_twin::scene::Script::from_toml(
    ///     r#"
    ///     duration_s = 2.0
    ///     events = [
    ///         { action = "press", time_s = 0.5, pointer = 1, x_mm = 0, y_mm = 25, radius_mm = 10, pressure_kpa = 80 },
    ///         { action = "release", time_s = 1.5, pointer = 1 },
    ///     ]"#,
    /// )?;
    /// assert_eq!(script.at(1.0).count(), 1);
    /// # Ok::<(), dermis_twin::TwinError>(())
    /// ```
    ///
    /// # Errors
    /// Text that is not valid TOML of this form (with its place), or a script that fails [`Script::check`].
    pub fn from_toml(text: &str) -> Result<Self, TwinError> {
        let script: Self = toml::from_str(text)?;
        script.check()?;
        Ok(script)
    }

    /// Checks times, order and numbers.
    ///
    /// # Errors
    /// Events out of order or beyond the duration, moves and releases of pointers that are not pressing, presses of
    /// pointers that are already pressing, or invalid indenters.
    pub fn check(&self) -> Result<(), TwinError> {
        self.check_with(Indenter::check)
    }

    /// Also checks that every indenter is on a skin of this outline.
    ///
    /// # Errors
    /// As [`Script::check`]; also fails for presses and moves off the skin, and indenters larger than it.
    pub fn check_on(&self, outline: &Outline) -> Result<(), TwinError> {
        self.check_with(|indenter| check_on_skin(outline, indenter))
    }

    fn check_with(&self, accept: impl Fn(&Indenter) -> Result<(), TwinError>) -> Result<(), TwinError> {
        check_positive("script duration_s", self.duration_s)?;
        let mut pressing: Vec<(u64, Indenter)> = Vec::new();
        let mut last = 0.0;
        for (index, event) in self.events.iter().enumerate() {
            let refuse = |reason: String| Err(TwinError::Event { event: index, reason });
            let (time, pointer) = (event.time_s(), event.pointer());
            if !(last..=self.duration_s).contains(&time) {
                return refuse(format!("time_s is {time}, expected {last} (the event before) to {}", self.duration_s));
            }
            last = time;
            let place = pressing.iter().position(|entry| entry.0 == pointer);
            let before = place.map(|place| pressing.swap_remove(place).1);
            if matches!(event, Event::Press { .. }) != before.is_none() {
                let state = if before.is_none() { "is not pressing" } else { "is already pressing" };
                return refuse(format!("pointer {pointer} {state}"));
            }
            if let Some(indenter) = event.indenter(before) {
                accept(&indenter).or_else(|error| refuse(error.to_string()))?;
                if !indenter.is_pressing() {
                    return refuse(format!("pointer {pointer} presses with 0 Pa; release it instead"));
                }
                pressing.push((pointer, indenter));
            }
        }
        Ok(())
    }

    /// The pointers that press at a time since the start of the script, with their indenters.
    pub fn at(&self, time_s: f64) -> impl Iterator<Item = (u64, Indenter)> + '_ {
        let time = if self.repeat { time_s.rem_euclid(self.duration_s) } else { time_s };
        let running = time < self.duration_s;
        let presses = self
            .events
            .iter()
            .enumerate()
            .filter(move |(_, event)| running && event.time_s() <= time && matches!(event, Event::Press { .. }));
        presses.filter_map(move |(index, press)| Some((press.pointer(), self.stroke_at(index, time)?)))
    }

    /// The indenter of the stroke that starts with the press at `index`, unless it was released by `time`.
    fn stroke_at(&self, index: usize, time: f64) -> Option<Indenter> {
        let pointer = self.events[index].pointer();
        let mut now = self.events[index].indenter(None)?;
        let mut since = self.events[index].time_s();
        for event in self.events[index + 1..].iter().filter(|event| event.pointer() == pointer) {
            if event.time_s() > time {
                return match event.indenter(Some(now)) {
                    Some(next) => Some(between(now, next, (time - since) / (event.time_s() - since))),
                    None => Some(now),
                };
            }
            now = event.indenter(Some(now))?;
            since = event.time_s();
        }
        Some(now)
    }

    /// The same script with positions and radii times `length` and pressures times `pressure`, for a skin of another
    /// size and softness.
    pub fn scaled(mut self, length: f64, pressure: f64) -> Self {
        for event in &mut self.events {
            match event {
                Event::Press { x_mm, y_mm, radius_mm, pressure_kpa, .. } => {
                    (*x_mm, *y_mm, *radius_mm) = (length * *x_mm, length * *y_mm, length * *radius_mm);
                    *pressure_kpa *= pressure;
                }
                Event::Move { x_mm, y_mm, radius_mm, pressure_kpa, .. } => {
                    (*x_mm, *y_mm) = (length * *x_mm, length * *y_mm);
                    *radius_mm = radius_mm.map(|radius| length * radius);
                    *pressure_kpa = pressure_kpa.map(|kpa| pressure * kpa);
                }
                Event::Release { .. } => {}
            }
        }
        self
    }

    /// The demonstration: one touch wanders over the skin for 12 s, a second one presses elsewhere, a third slides,
    /// then a pause; 22 s in a loop. One touch at a time, because the copper connects simultaneous touches and a
    /// linear image cannot separate them.
    pub fn demo() -> Self {
        let mut events = Vec::new();
        // A Lissajous figure within 28 mm of the middle.
        let wander = |t: f64| [28.0 * (TAU * t / 12.0).sin(), 24.0 * (TAU * t / 8.0 + 0.6).sin()];
        let start = wander(0.0);
        events.push(press(1.0, 1, start, 10.0, 60.0));
        for k in 1..=120 {
            let t = 0.1 * f64::from(k);
            events.push(moved(1.0 + t, 1, wander(t), Some(60.0 + 30.0 * (TAU * t / 5.0).sin())));
        }
        events.push(Event::Release { time_s: 13.0, pointer: 1 });
        events.push(press(14.0, 2, [-30.0, 22.0], 8.0, 80.0));
        events.push(Event::Release { time_s: 16.0, pointer: 2 });
        events.push(press(17.0, 3, [30.0, -22.0], 10.0, 60.0));
        events.push(moved(18.0, 3, [30.0, -22.0], None));
        events.push(moved(19.5, 3, [30.0, 22.0], None));
        events.push(Event::Release { time_s: 20.0, pointer: 3 });
        Self { duration_s: 22.0, repeat: true, events }
    }
}

fn press(time_s: f64, pointer: u64, [x_mm, y_mm]: [f64; 2], radius_mm: f64, pressure_kpa: f64) -> Event {
    Event::Press { time_s, pointer, x_mm, y_mm, radius_mm, pressure_kpa }
}

fn moved(time_s: f64, pointer: u64, [x_mm, y_mm]: [f64; 2], pressure_kpa: Option<f64>) -> Event {
    Event::Move { time_s, pointer, x_mm, y_mm, radius_mm: None, pressure_kpa }
}

fn between(from: Indenter, to: Indenter, share: f64) -> Indenter {
    let mix = |a: f64, b: f64| a + share * (b - a);
    let centre = [mix(from.centre_m[0], to.centre_m[0]), mix(from.centre_m[1], to.centre_m[1])];
    let radius = mix(from.shape.equal_area_radius_m(), to.shape.equal_area_radius_m());
    Indenter::disc(centre, radius, mix(from.pressure_pa(), to.pressure_pa()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn demo_is_sound_and_never_has_two_touches_at_once() {
        let demo = Script::demo();
        demo.check().unwrap();
        let count = |time: f64| demo.at(time).count();
        assert_eq!([0.5, 5.0, 13.5, 14.5, 16.5, 18.0, 21.0].map(count), [0, 1, 0, 1, 0, 1, 0]);
        assert!((0..4400).all(|k| count(0.01 * f64::from(k)) <= 1));
        let text = toml::to_string(&demo).unwrap();
        assert_eq!(Script::from_toml(&text).unwrap(), demo);
    }

    #[test]
    fn a_scaled_script_scales_places_and_loads() {
        let (demo, scaled) = (Script::demo(), Script::demo().scaled(2.0, 0.1));
        let (before, after) = (demo.at(3.3).next().unwrap().1, scaled.at(3.3).next().unwrap().1);
        assert!((after.centre_m[0] - 2.0 * before.centre_m[0]).abs() < 1e-12);
        assert!((after.shape.equal_area_radius_m() - 2.0 * before.shape.equal_area_radius_m()).abs() < 1e-12);
        assert!((after.pressure_pa() - 0.1 * before.pressure_pa()).abs() < 1e-6);
    }

    #[test]
    fn positions_are_linear_between_events() {
        let events = vec![press(1.0, 7, [0.0, 0.0], 10.0, 80.0), moved(3.0, 7, [20.0, -10.0], Some(40.0))];
        let script = Script { duration_s: 5.0, repeat: false, events };
        let (pointer, indenter) = script.at(1.5).next().unwrap();
        assert_eq!(pointer, 7);
        assert!((indenter.centre_m[0] - 0.005).abs() < 1e-12 && (indenter.centre_m[1] + 0.0025).abs() < 1e-12);
        assert!((indenter.pressure_pa() - 70e3).abs() < 1e-6);
        assert_eq!(script.at(4.0).next().unwrap().1.centre_m, [0.02, -0.01]);
        assert_eq!(script.at(5.0).count(), 0);
    }

    #[test]
    fn bad_scripts_are_refused_with_the_event() {
        let bad = |events: Vec<Event>| {
            let script = Script { duration_s: 5.0, repeat: false, events };
            script.check().unwrap_err().to_string()
        };
        let down = press(1.0, 1, [0.0; 2], 10.0, 80.0);
        assert_eq!(bad(vec![moved(1.0, 1, [0.0; 2], None)]), "script event 0: pointer 1 is not pressing");
        assert_eq!(bad(vec![down, down]), "script event 1: pointer 1 is already pressing");
        let late = Event::Release { time_s: 0.5, pointer: 1 };
        assert_eq!(bad(vec![down, late]), "script event 1: time_s is 0.5, expected 1 (the event before) to 5");
        assert!(bad(vec![press(1.0, 1, [0.0; 2], -1.0, 80.0)]).contains("disc radius_m"));
        let error = Script::from_toml("duration_s = 1\nevents = []\nspeed = 3").unwrap_err().to_string();
        assert!(error.contains("speed"), "{error}");
    }
}
