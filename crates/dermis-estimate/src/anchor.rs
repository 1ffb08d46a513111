//! A press that stays where it is: the position and radius it had while the baseline was fresh.
//!
//! A fit of position, radius and load to a frame that has drifted can trade one for the other. As long as the frame
//! is consistent with the position and radius from when the baseline was fresh, these are kept, and only the load is
//! fitted.

use dermis_tomo::mesh::{Point, distance};

use crate::press::Press;

/// Number of frames averaged in an anchor.
const FRAMES: f64 = 50.0;
/// A press that moves by more than this share of its radius, and by more than this many standard deviations, gets a new
/// anchor.
const MOVED_RADII: f64 = 0.3;
const MOVED_SIGMAS: f64 = 3.0;

/// Position, radius and load of a press while its baseline was fresh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Anchor {
    position_m: Point,
    log_radius: f64,
    load: f64,
    frames: f64,
}

impl Anchor {
    /// A new anchor at a press.
    pub fn at(press: &Press) -> Self {
        let Press { position_m, radius_m, load, .. } = *press;
        Self { position_m, log_radius: radius_m.ln(), load, frames: 1.0 }
    }

    /// True if a press could be this one.
    pub fn is_near(&self, press: &Press) -> bool {
        distance(press.position_m, self.position_m) <= press.radius_m.max(self.log_radius.exp())
    }

    /// Updates the anchor with the press of a frame.
    pub fn learn(&mut self, press: &Press) {
        let least_m = (MOVED_RADII * press.radius_m).max(MOVED_SIGMAS * press.place_sigma_m());
        if distance(press.position_m, self.position_m) > least_m {
            *self = Self::at(press);
            return;
        }
        self.frames = (self.frames + 1.0).min(FRAMES);
        let share = 1.0 / self.frames;
        (0..2).for_each(|axis| self.position_m[axis] += share * (press.position_m[axis] - self.position_m[axis]));
        self.log_radius += share * (press.radius_m.ln() - self.log_radius);
        self.load += share * (press.load - self.load);
    }

    /// Ends the averaging: the baseline has aged.
    pub fn settle(&mut self) {
        self.frames = FRAMES;
    }

    /// True if it averages as many frames as it ever will.
    pub fn is_settled(&self) -> bool {
        self.frames >= FRAMES
    }

    /// The average press.
    pub fn press(&self) -> Press {
        let Self { position_m, log_radius, load, .. } = *self;
        Press { position_m, radius_m: log_radius.exp(), load, ..Press::default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_average_frames_and_follow_presses_that_move() {
        let at = |x: f64, radius_m: f64| Press { position_m: [x, 0.0], radius_m, ..Press::default() };
        let mut anchor = Anchor::at(&at(0.0, 0.01));
        anchor.learn(&at(0.002, 0.01));
        assert!((anchor.press().position_m[0] - 0.001).abs() < 1e-12);
        (0..48).for_each(|_| anchor.learn(&at(0.001, 0.01)));
        assert!(anchor.is_settled());
        anchor.learn(&at(0.005, 0.01));
        assert!(!anchor.is_settled() && anchor.press().position_m[0] == 0.005);
    }
}
