//! Estimates channel noise from frames without knowing in which of them the skin is touched.

use dermis_live::frame_noise::noise_of_frames;

const CHANNELS: usize = 60;

/// Standard normal numbers, the same in every run.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Reading of a touch at p in [0, 1]; smooth in p.
fn touch(p: f64, k: usize) -> f64 {
    (-((p - k as f64 / CHANNELS as f64) / 0.2).powi(2)).exp()
}

fn sigma(k: usize) -> f64 {
    0.01 * (1.0 + (k % 5) as f64)
}

/// Median ratio of estimate to truth.
fn ratio(frames: &[Vec<f64>]) -> f64 {
    let noise = noise_of_frames(frames).expect("frames enough");
    let mut ratios: Vec<f64> = noise.iter().enumerate().map(|(k, v)| v / sigma(k)).collect();
    ratios.sort_by(f64::total_cmp);
    ratios[ratios.len() / 2]
}

fn frames(count: usize, place: impl Fn(usize, &mut Random) -> Option<f64>) -> Vec<Vec<f64>> {
    let mut random = Random(0x9e37_79b9_7f4a_7c15);
    (0..count)
        .map(|t| {
            let p = place(t, &mut random);
            (0..CHANNELS).map(|k| p.map_or(0.0, |p| touch(p, k)) + sigma(k) * random.normal()).collect()
        })
        .collect()
}

/// A median of this many numbers scatters by a few per cent, and using the quieter half lowers it by a few more.
#[test]
fn noise_is_estimated_under_any_touch() {
    let resting = ratio(&frames(40, |_, _| None));
    let held = ratio(&frames(80, |t, _| (20..60).contains(&t).then_some(0.3)));
    let every = ratio(&frames(200, |_, random| Some(random.uniform())));
    assert!((0.8..1.2).contains(&resting) && (0.8..1.2).contains(&held), "{resting} {held}");
    // The smooth remainder after 16 components is taken for noise.
    assert!((0.8..1.6).contains(&every), "{every}");
}

#[test]
fn few_or_constant_frames_give_no_noise() {
    assert!(noise_of_frames(&frames(8, |_, _| None)).is_none());
    let still = vec![vec![1.0; 4]; 20];
    assert!(noise_of_frames(&still).is_none());
    let mut one_dead = frames(20, |_, _| None);
    one_dead.iter_mut().for_each(|frame| frame[3] = f64::NAN);
    let noise = noise_of_frames(&one_dead).expect("the others");
    assert!(noise[3].is_nan() && noise[4] > 0.0);
}
