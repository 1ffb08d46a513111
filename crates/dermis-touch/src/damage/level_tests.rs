//! Tests of the level watch on synthetic channels: individual drift, white noise, steps of known size.

use super::{LevelChange, LevelParams, LevelWatch};

const CHANNELS: usize = 40;

/// White noise with a standard deviation of about 1, the same in every run.
fn noise(frame: u64, channel: usize) -> f64 {
    let mut state = (frame * CHANNELS as u64 + channel as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut uniform = || {
        state ^= state >> 29;
        state = state.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        state ^= state >> 32;
        (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
    };
    (0..12).map(|_| uniform()).sum()
}

/// Frames eight seconds apart, at levels of 1,000 that drift by -1 to 1 per frame.
struct Bench {
    watch: LevelWatch,
    frame: u64,
}

impl Bench {
    fn new() -> Self {
        let params = LevelParams { follow_s: 60.0, jump_sigma: 8.0, rest_s: 1.5 };
        let mut bench = Self { watch: LevelWatch::new(CHANNELS, params).unwrap(), frame: 0 };
        assert_eq!(bench.run(32, 0.0), None);
        bench.watch.start(&[f64::NAN; CHANNELS], &[f64::NAN; CHANNELS]).unwrap();
        assert_eq!(bench.run(100, 0.0), None);
        bench
    }

    /// Runs frames whose even channels are off by `step`. Returns the result of the last.
    fn run(&mut self, frames: u64, step: f64) -> Option<LevelChange> {
        let mut said = None;
        for _ in 0..frames {
            let value = |channel: usize| {
                let drift = (channel as f64 / 19.5 - 1.0) * self.frame as f64;
                1e3 + drift + noise(self.frame, channel) + if channel.is_multiple_of(2) { step } else { 0.0 }
            };
            let raw: Vec<f64> = (0..CHANNELS).map(value).collect();
            said = self.watch.process(8_000_000_000 * self.frame, &raw, |_| true).unwrap();
            self.frame += 1;
        }
        said
    }
}

#[test]
fn drift_of_each_channel_is_followed_and_no_change() {
    let mut bench = Bench::new();
    for _ in 0..300 {
        assert_eq!(bench.run(1, 0.0), None);
        assert_eq!(bench.watch.disturbed_since_ns(), None, "frame {}", bench.frame);
    }
    let off =
        |channel: usize| bench.watch.levels()[channel] - 1e3 - (channel as f64 / 19.5 - 1.0) * (bench.frame - 1) as f64;
    assert!((0..CHANNELS).all(|channel| off(channel).abs() < 3.0));
}

#[test]
fn the_residue_of_a_release_is_reported_with_its_size() {
    let mut bench = Bench::new();
    assert_eq!(bench.run(2, 100.0), None);
    assert_eq!(bench.run(2, 30.0), None, "three frames of rest are asked for");
    let change = bench.run(1, 30.0).unwrap();
    assert!(change.was_released() && !change.is_remainder() && !change.has_crept(), "{change:?}");
    let [even, odd] = [0, 1].map(|first| {
        let of_kind = bench.watch.change().iter().skip(first).step_by(2);
        of_kind.sum::<f64>() / (CHANNELS / 2) as f64
    });
    assert!((even - 30.0).abs() < 1.5 && odd.abs() < 1.5, "{even} {odd}");
    bench.watch.accept();
    assert_eq!(bench.run(5, 30.0), None);
    assert_eq!(bench.watch.disturbed_since_ns(), None);
}

#[test]
fn a_resting_touch_is_not_released_and_an_ended_one_leaves_nothing() {
    let mut bench = Bench::new();
    let change = bench.run(20, 100.0).unwrap();
    assert!(!change.was_released() && !change.has_crept(), "{change:?}");
    assert_eq!(bench.run(1, 0.0), None);
    assert_eq!(bench.watch.disturbed_since_ns(), None);
}

#[test]
fn bad_input_is_refused_by_name() {
    let params = LevelParams { follow_s: 0.0, jump_sigma: 8.0, rest_s: 1.5 };
    let error = LevelWatch::new(4, params).unwrap_err().to_string();
    assert_eq!(error, "follow_s = 0: expected above 0");
}
