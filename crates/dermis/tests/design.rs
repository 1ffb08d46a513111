//! The bounds of `dermis design`, held against estimates from noisy frames.

use dermis::design::{Maps, Noise, Summary, improve_protocol};
use dermis::prepare::Prepared;
use dermis::skin::Skin;

const PLACE: [f64; 2] = [0.018, -0.011];
const AMPLITUDE: f64 = 0.1;

fn skin() -> Skin {
    let mut skin = Skin::open("healing-square").unwrap();
    (skin.imaging.grid, skin.imaging.elements) = (48, 3000);
    skin
}

/// Gaussian numbers by Box and Muller from a xorshift.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Least squares for (x, y, a) by Gauss-Newton from near the truth: with white noise the maximum of the likelihood.
fn fit(prepared: &Prepared, frame: &[f64]) -> [f64; 3] {
    let (mut place, mut amplitude, step) = ([PLACE[0] + 1e-3, PLACE[1] - 1e-3], 0.8 * AMPLITUDE, 1e-4);
    let channels = frame.len();
    for _ in 0..5 {
        let [x, y] = place;
        let rows = prepared.signatures(&[[x, y], [x + step, y], [x - step, y], [x, y + step], [x, y - step]]);
        let row = |k: usize| &rows[k * channels..(k + 1) * channels];
        let column = |k: usize, channel: usize| match k {
            0 => amplitude * (row(1)[channel] - row(2)[channel]) / (2.0 * step),
            1 => amplitude * (row(3)[channel] - row(4)[channel]) / (2.0 * step),
            _ => row(0)[channel],
        };
        let mut normal = faer::Mat::<f64>::zeros(3, 3);
        let mut right = faer::Mat::<f64>::zeros(3, 1);
        for channel in 0..channels {
            let g = [0, 1, 2].map(|k| column(k, channel));
            let rest = frame[channel] - amplitude * row(0)[channel];
            for a in 0..3 {
                right[(a, 0)] += g[a] * rest;
                (0..3).for_each(|b| normal[(a, b)] += g[a] * g[b]);
            }
        }
        let factor = normal.llt(faer::Side::Lower).unwrap();
        let change = faer::linalg::solvers::Solve::solve(&factor, &right);
        place = [x + change[(0, 0)], y + change[(1, 0)]];
        amplitude += change[(2, 0)];
    }
    [place[0], place[1], amplitude]
}

#[test]
fn estimates_from_500_noisy_frames_attain_the_bound() {
    let prepared = Prepared::new(skin()).unwrap();
    let largest = prepared.voltages.iter().map(|v| v.abs()).fold(0.0, f64::max);
    let noise_v = 1e-4 * largest;
    let truth = prepared.signatures(&[PLACE]);
    let mut random = Random(7);
    let mut found = Vec::new();
    for _ in 0..500 {
        let frame: Vec<f64> = truth.iter().map(|s| AMPLITUDE * s + noise_v * random.normal()).collect();
        found.push(fit(&prepared, &frame));
    }
    let deviation = |k: usize| {
        let mean = found.iter().map(|f| f[k]).sum::<f64>() / 500.0;
        (found.iter().map(|f| (f[k] - mean).powi(2)).sum::<f64>() / 499.0).sqrt()
    };
    let maps = Maps::new(&prepared, Noise::Volts(noise_v), AMPLITUDE, 64).unwrap();
    let nearest = (0..maps.places_m.len())
        .min_by(|&a, &b| {
            let distance = |k: usize| (maps.places_m[k][0] - PLACE[0]).hypot(maps.places_m[k][1] - PLACE[1]);
            distance(a).total_cmp(&distance(b))
        })
        .unwrap();
    // The bound is for the larger axis of the ellipse, which is at least either deviation and at most their root sum.
    let (x, y) = (deviation(0), deviation(1));
    let (bound, amplitude) = (maps.position_m[nearest], AMPLITUDE * maps.amplitude_share[nearest]);
    println!(
        "position {:.3e} {:.3e} m, bound {bound:.3e}; amplitude {:.3e}, bound {amplitude:.3e}",
        x,
        y,
        deviation(2)
    );
    let larger = larger_axis(&found);
    // 500 frames give a deviation within 3.2 % (one standard error); the nearest place of the map is up to 0.8 mm off.
    assert!((larger / bound - 1.0).abs() < 0.15, "{larger:e} against {bound:e}");
    assert!((deviation(2) / amplitude - 1.0).abs() < 0.15, "{:e} against {amplitude:e}", deviation(2));
}

/// Deviation along the larger axis of the estimates' ellipse.
fn larger_axis(found: &[[f64; 3]]) -> f64 {
    let count = found.len() as f64;
    let mean = [0, 1].map(|k| found.iter().map(|f| f[k]).sum::<f64>() / count);
    let moment =
        |a: usize, b: usize| found.iter().map(|f| (f[a] - mean[a]) * (f[b] - mean[b])).sum::<f64>() / (count - 1.0);
    let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
    (0.5 * (xx + yy) + (0.25 * (xx - yy).powi(2) + xy * xy).sqrt()).sqrt()
}

#[test]
fn the_search_finds_a_protocol_at_least_as_good() {
    let mut skin = Skin::open("golfball-tank").unwrap();
    (skin.imaging.grid, skin.imaging.elements) = (24, 1000);
    let [own, best] = improve_protocol(&skin, AMPLITUDE, 10, |_, _| {}).unwrap();
    assert!(best.position_m.worst <= own.position_m.worst);
    assert!(Summary::of(&[3.0, 1.0, 2.0]).best == 1.0);
    // What is written is a skin file.
    Skin::parse(&best.skin.to_toml(), "winner").unwrap();
}

#[test]
fn bounds_scale_with_the_noise_and_nonsense_is_refused() {
    let prepared = Prepared::new(skin()).unwrap();
    let at = |volts: f64| Maps::new(&prepared, Noise::Volts(volts), AMPLITUDE, 8).unwrap();
    let (quiet, loud) = (at(1e-6), at(1e-5));
    for (a, b) in quiet.position_m.iter().zip(&loud.position_m) {
        assert!((b / a - 10.0).abs() < 1e-6, "{a:e} {b:e}");
    }
    assert!(Maps::new(&prepared, Noise::Volts(-1.0), AMPLITUDE, 8).is_err());
    assert!(Maps::new(&prepared, Noise::Assumed, f64::NAN, 8).is_err());
}
