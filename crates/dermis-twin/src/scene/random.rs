//! Random touches, for tests and for training sets.

use dermis_tomo::mesh::distance;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::script::{Event, Script};
use crate::error::{TwinError, check, check_positive};
use crate::mechanics::Indenter;

/// Maximum number of attempts to place a touch clear of the others before fewer are drawn.
const TRIES: usize = 200;

/// A seeded source of round, non-overlapping touches, uniform in position, radius and pressure.
#[derive(Clone, Debug)]
pub struct RandomTouches {
    /// Centres are within this distance of the origin along x and y, metres.
    pub half_width_m: f64,
    /// Minimum and maximum radius, metres.
    pub radius_m: [f64; 2],
    /// Minimum and maximum pressure, pascals.
    pub pressure_pa: [f64; 2],
    /// Minimum distance between the edges of two touches, metres.
    pub gap_m: f64,
    random: ChaCha8Rng,
}

impl RandomTouches {
    /// Touches for a skin of 100 mm: radii of 7.5 to 15 mm, 30 to 100 kPa, within 35 mm of the middle along each
    /// axis, at least 10 mm between edges.
    pub fn new(seed: u64) -> Self {
        Self {
            half_width_m: 0.035,
            radius_m: [7.5e-3, 15e-3],
            pressure_pa: [30e3, 100e3],
            gap_m: 0.01,
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    /// Draws up to `count` simultaneous touches; fewer if there is no room for more.
    ///
    /// # Errors
    /// Ranges that are not positive, finite and in order.
    pub fn draw(&mut self, count: usize) -> Result<Vec<Indenter>, TwinError> {
        self.check()?;
        let mut touches: Vec<Indenter> = Vec::with_capacity(count);
        for _ in 0..TRIES * count {
            if touches.len() == count {
                break;
            }
            let candidate = self.candidate();
            let clear = |other: &Indenter| {
                let radii = other.shape.equal_area_radius_m() + candidate.shape.equal_area_radius_m();
                distance(other.centre_m, candidate.centre_m) >= radii + self.gap_m
            };
            if touches.iter().all(clear) {
                touches.push(candidate);
            }
        }
        Ok(touches)
    }

    /// A script that holds each of `groups` draws of 1 to `most` touches for `hold_s`, with a pause of the same
    /// length after each.
    ///
    /// # Errors
    /// As [`RandomTouches::draw`]; also fails for a time that is not positive, or if there are no touches to draw.
    pub fn script(&mut self, groups: usize, most: usize, hold_s: f64) -> Result<Script, TwinError> {
        check_positive("hold_s", hold_s)?;
        check("groups", groups as f64, 1.0, 1e9, "at least 1")?;
        check("most touches", most as f64, 1.0, 1e6, "at least 1")?;
        let mut events = Vec::new();
        for group in 0..groups {
            let start = 2.0 * hold_s * group as f64;
            let count = self.random.random_range(1..=most);
            let touches = self.draw(count)?;
            for (pointer, touch) in (1..).zip(&touches) {
                events.push(Event::Press {
                    time_s: start,
                    pointer,
                    x_mm: touch.centre_m[0] * 1e3,
                    y_mm: touch.centre_m[1] * 1e3,
                    radius_mm: touch.shape.equal_area_radius_m() * 1e3,
                    pressure_kpa: touch.pressure_pa() * 1e-3,
                });
            }
            let release = |pointer| Event::Release { time_s: start + hold_s, pointer };
            events.extend((1..=touches.len() as u64).map(release));
        }
        Ok(Script { duration_s: 2.0 * hold_s * groups as f64, repeat: false, events })
    }

    fn candidate(&mut self) -> Indenter {
        let centre = [0; 2].map(|_| self.random.random_range(-self.half_width_m..=self.half_width_m));
        let radius = self.random.random_range(self.radius_m[0]..=self.radius_m[1]);
        Indenter::disc(centre, radius, self.random.random_range(self.pressure_pa[0]..=self.pressure_pa[1]))
    }

    fn check(&self) -> Result<(), TwinError> {
        check("half_width_m", self.half_width_m, 0.0, 1e3, "zero or more, in metres")?;
        check("gap_m", self.gap_m, -1e3, 1e3, "a distance in metres")?;
        check_positive("smallest radius_m", self.radius_m[0])?;
        check("largest radius_m", self.radius_m[1], self.radius_m[0], 1e3, "no less than the smallest")?;
        check_positive("smallest pressure_pa", self.pressure_pa[0])?;
        check("largest pressure_pa", self.pressure_pa[1], self.pressure_pa[0], 1e9, "no less than the smallest")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_repeat_by_seed_and_keep_clear() {
        let draw = |seed: u64| {
            let mut random = RandomTouches::new(seed);
            (0..20).map(|_| random.draw(3).unwrap()).collect::<Vec<_>>()
        };
        assert_eq!(draw(4), draw(4));
        assert_ne!(draw(4), draw(5));
        for touches in draw(6) {
            for (k, a) in touches.iter().enumerate() {
                for b in &touches[..k] {
                    let radii = a.shape.equal_area_radius_m() + b.shape.equal_area_radius_m();
                    assert!(distance(a.centre_m, b.centre_m) >= 0.01 + radii - 1e-12);
                }
            }
        }
    }

    #[test]
    fn scripts_are_sound() {
        let script = RandomTouches::new(9).script(10, 3, 0.5).unwrap();
        script.check().unwrap();
        assert!(script.at(0.25).count() >= 1);
        assert_eq!(script.at(0.75).count(), 0);
    }

    #[test]
    fn bad_ranges_are_refused() {
        let mut random = RandomTouches::new(0);
        random.radius_m = [0.02, 0.01];
        assert!(random.draw(1).unwrap_err().to_string().starts_with("largest radius_m: 0.01"));
    }
}
