//! Collects frames that arrive faster than they can be fitted.

/// The frames since the last fit.
#[derive(Debug, Default)]
pub(super) struct Gathered {
    sum: Vec<f64>,
    pub count: u32,
    pub fitted_ns: Option<u64>,
}

impl Gathered {
    /// Adds a frame.
    pub fn add(&mut self, frame: &[f64]) {
        if self.count == 0 {
            self.sum.clear();
            self.sum.extend_from_slice(frame);
        } else {
            self.sum.iter_mut().zip(frame).for_each(|(sum, value)| *sum += value);
        }
        self.count += 1;
    }

    /// The mean of these frames, computed in place. The next frame starts a new mean.
    pub fn mean(&mut self) -> &[f64] {
        let count = f64::from(self.count.max(1));
        self.sum.iter_mut().for_each(|sum| *sum /= count);
        self.count = 0;
        &self.sum
    }
}
