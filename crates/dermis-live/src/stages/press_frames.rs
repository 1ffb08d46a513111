//! Collects one frame of each press in a session, for learning about the skin without labels. Touch is detected from
//! the noise of the channels alone, since the image may be wrong.

/// Minimum likeness to the strongest frame of a press; below it, the press has slid away and the next one has begun.
const SLID: f64 = 0.9;
/// A press is over when a frame is weaker than this share of its strongest.
const OVER: f64 = 0.5;
/// A press whose frame resembles an earlier one more than this gives no new information.
const ALIKE: f64 = 0.98;
/// Minimum strength of a touched frame: subtracting the noise would leave almost nothing of a weaker one.
const LEAST_STRENGTH: f64 = 1.5;

/// A frame of a press.
#[derive(Clone, Debug, Default)]
struct Press {
    /// Changes relative to the baseline, `NaN` where missing.
    change: Vec<f64>,
    /// The difference in units of the channels' noise, scaled to unit length; 0 where missing.
    direction: Vec<f64>,
    /// RMS of the difference in units of the noise.
    strength: f64,
}

/// The strongest frame of each press, up to a maximum number.
#[derive(Debug)]
pub(crate) struct PressFrames {
    presses: Vec<Press>,
    /// The strongest frame of the current press.
    under_way: Option<Press>,
    /// The current frame.
    now: Press,
    /// RMS above which a frame is touched, in units of the noise.
    least_strength: f64,
    most: usize,
}

impl PressFrames {
    /// A collection without presses.
    pub fn new(least_strength: f64, most: usize) -> Self {
        let least_strength = least_strength.max(LEAST_STRENGTH);
        Self { presses: Vec::new(), under_way: None, now: Press::default(), least_strength, most }
    }

    /// Number of presses collected.
    pub fn len(&self) -> usize {
        self.presses.len()
    }

    /// Their frames: changes relative to the baseline, in the order in which they were made.
    pub fn changes(&self) -> Vec<Vec<f64>> {
        self.presses.iter().map(|press| press.change.clone()).collect()
    }

    /// Strength that nine in ten of the presses exceed: RMS in units of the noise. 0 without presses.
    pub fn weak(&self) -> f64 {
        let mut strengths: Vec<f64> = self.presses.iter().map(|press| press.strength).collect();
        strengths.sort_by(f64::total_cmp);
        strengths.get(strengths.len() / 10).copied().unwrap_or(0.0)
    }

    /// Takes a frame: readings minus `baseline`, and `difference` and `noise` of the channels in one unit, `NaN` in
    /// either where a channel is missing. Allocates for each press that is collected.
    pub fn offer(&mut self, compensated: &[f64], baseline: &[f64], difference: &[f64], noise: &[f64]) {
        if self.presses.len() >= self.most {
            return;
        }
        self.read(compensated, baseline, difference, noise);
        if let Some(press) = &self.under_way
            && (self.now.strength < self.least_strength.max(OVER * press.strength) || likeness(press, &self.now) < SLID)
        {
            self.end_press();
        }
        let strongest = self.under_way.as_ref().map_or(0.0, |press| press.strength);
        if self.now.strength >= self.least_strength && self.now.strength > strongest {
            std::mem::swap(self.under_way.get_or_insert_default(), &mut self.now);
        }
    }

    /// Discards the current press.
    pub fn forget(&mut self) {
        self.under_way = None;
    }

    fn end_press(&mut self) {
        let Some(press) = self.under_way.take() else { return };
        if self.presses.iter().all(|other| likeness(other, &press) < ALIKE) {
            self.presses.push(press);
        }
    }

    fn read(&mut self, compensated: &[f64], baseline: &[f64], difference: &[f64], noise: &[f64]) {
        let Press { change, direction, strength } = &mut self.now;
        let relative = |(compensated, baseline): (&f64, &f64)| compensated / baseline;
        change.clear();
        change.extend(compensated.iter().zip(baseline).map(relative));
        direction.clear();
        let (mut sum, mut count) = (0.0, 0_u32);
        for (channel, (difference, noise)) in difference.iter().zip(noise).enumerate() {
            let in_noise = difference / noise;
            if in_noise.is_finite() && change[channel].is_finite() {
                (sum, count) = (sum + in_noise * in_noise, count + 1);
                direction.push(in_noise);
            } else {
                change[channel] = f64::NAN;
                direction.push(0.0);
            }
        }
        let length = f64::sqrt(sum);
        direction.iter_mut().for_each(|value| *value /= length.max(f64::MIN_POSITIVE));
        *strength = length / f64::from(count.max(1)).sqrt();
    }
}

/// Cosine between two frames, relative to its expected value for two noisy frames of one press.
fn likeness(a: &Press, b: &Press) -> f64 {
    let cosine: f64 = a.direction.iter().zip(&b.direction).map(|(a, b)| a * b).sum();
    let signal = |press: &Press| 1.0 - press.strength.powi(-2);
    cosine / (signal(a) * signal(b)).max(f64::MIN_POSITIVE).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Offers a frame whose channels differ from a baseline of 2 by these values, at a noise of 0.1.
    fn offer(frames: &mut PressFrames, difference: [f64; 3]) {
        frames.offer(&difference, &[2.0; 3], &difference, &[0.1; 3]);
    }

    #[test]
    fn each_press_gives_its_strongest_frame_once() {
        let mut frames = PressFrames::new(5.0, 3);
        for share in [0.1, 0.5, 1.0, 0.9, 0.2] {
            offer(&mut frames, [4.0 * share, 0.0, f64::NAN]);
        }
        assert_eq!(frames.len(), 1);
        assert_eq!(frames.changes()[0][..2], [2.0, 0.0]);
        assert!(frames.changes()[0][2].is_nan());
        // The same press again is not new; one that slides elsewhere counts as two.
        for share in [0.5, 1.0, 0.1] {
            offer(&mut frames, [4.0 * share, 0.0, 0.0]);
        }
        assert_eq!(frames.len(), 1);
        offer(&mut frames, [0.0, 4.0, 0.0]);
        offer(&mut frames, [0.0, 1.0, 4.0]);
        assert_eq!(frames.len(), 2);
        offer(&mut frames, [0.0; 3]);
        assert_eq!(frames.len(), 3);
        assert!((frames.weak() - 40.0 / 2_f64.sqrt()).abs() < 10.0, "{}", frames.weak());
        // No more than the maximum.
        offer(&mut frames, [0.0, -4.0, 0.0]);
        offer(&mut frames, [0.0; 3]);
        assert_eq!(frames.len(), 3);
    }
}
