//! Presses held at their place while the baseline ages.

use dermis_estimate::{Anchor, Press};

/// Positions and radii of presses from when the baseline was fresh.
#[derive(Debug, Default)]
pub(super) struct HeldPresses {
    anchors: Vec<Anchor>,
    is_aged: bool,
}

impl HeldPresses {
    /// From now on, the baseline is aged, or fresh again.
    pub fn set_aged(&mut self, is_aged: bool) {
        self.is_aged = is_aged;
    }

    /// Forgets all presses.
    pub fn forget(&mut self) {
        self.anchors.clear();
    }

    /// Keeps presses at the position and radius from when the baseline was fresh, as long as the frame allows it.
    pub fn hold(&mut self, presses: &mut [Press]) {
        self.anchors.retain(|anchor| presses.iter().any(|press| anchor.is_near(press)));
        for press in presses {
            match self.anchors.iter_mut().find(|anchor| anchor.is_near(press)) {
                Some(anchor) if !self.is_aged => anchor.learn(press),
                Some(anchor) => match anchor.hold(press) {
                    Some(held) => *press = held,
                    None => *anchor = Anchor::at(press),
                },
                None => self.anchors.push(Anchor::at(press)),
            }
        }
    }
}
