//! Do sigmas hold? Every built-in twin is pressed at random places, and errors are counted in units of their sigmas.

use dermis::device::FileSpec;
use dermis::lab::reconstruct::{Request, reconstruct};
use dermis::lab::twin_sample::{SampleRequest, random_presses, sample};
use dermis::skin::Skin;
use dermis::twin::from_skin::press_range;

/// Presses of each twin.
const PRESSES: usize = 60;

/// Errors of x and y of single presses, mm, each with its sigma; and how many presses were one touch.
struct Trial {
    errors_mm: Vec<f64>,
    sigmas_mm: Vec<f64>,
    single: usize,
}

fn press(name: &str, seed: u64) -> Trial {
    let skin = Skin::open(name).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let places = random_presses(&skin.outline(), &press_range(&skin), PRESSES, seed).unwrap();
    let request = SampleRequest {
        skin: skin.clone(),
        presses: places.clone(),
        baseline: at("b.npy"),
        frames: at("f.npy"),
        truth: None,
        seed: Some(seed),
        repeats: 1,
    };
    sample(&request, |_, _| {}).unwrap();
    let request = Request {
        skin,
        baseline: Some(FileSpec::all(at("b.npy"))),
        frames: FileSpec::all(at("f.npy")),
        format: None,
        calibration: None,
        forces: None,
        hyperparameter: None,
        touches: Some(at("t.csv")),
        images: None,
    };
    reconstruct(&request, |_, _| {}).unwrap();
    let text = std::fs::read_to_string(at("t.csv")).unwrap();
    let mut found: Vec<Vec<Vec<f64>>> = vec![Vec::new(); PRESSES];
    for line in text.lines().skip(1) {
        let cells: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        found[cells[0] as usize].push(cells);
    }
    let mut trial = Trial { errors_mm: Vec::new(), sigmas_mm: Vec::new(), single: 0 };
    for (press, found) in places.iter().zip(&found) {
        let [only] = &found[..] else { continue };
        trial.single += 1;
        for axis in 0..2 {
            trial.errors_mm.push((only[2 + axis] - 1e3 * press[0].centre_m[axis]).abs());
            trial.sigmas_mm.push(only[6 + axis]);
        }
    }
    trial
}

impl Trial {
    fn within(&self, sigmas: f64) -> f64 {
        let inside = self.errors_mm.iter().zip(&self.sigmas_mm).filter(|(e, s)| **e <= sigmas * **s).count();
        inside as f64 / self.errors_mm.len() as f64
    }

    fn quantile_mm(&self, share: f64) -> f64 {
        let mut sorted = self.errors_mm.clone();
        sorted.sort_by(f64::total_cmp);
        sorted[((sorted.len() - 1) as f64 * share) as usize]
    }
}

/// Two thirds of the errors within one sigma an axis: 60 to 76 % is asked for of many presses; 120 errors scatter by 4
/// %, and those of one press are not independent.
#[test]
fn errors_of_presses_anywhere_lie_within_their_sigmas() {
    let mut wrong = Vec::new();
    for name in SKINS {
        let trial = press(name, 5);
        let (one, more) = (trial.within(1.0), trial.within(2.5));
        let mut sigmas = trial.sigmas_mm.clone();
        sigmas.sort_by(f64::total_cmp);
        println!(
            "{name}: {} of {PRESSES} single, error an axis 50 % {:.3} 68 % {:.3} 95 % {:.3} mm, sigma {:.3} mm, within {one:.2} {more:.2}",
            trial.single,
            trial.quantile_mm(0.5),
            trial.quantile_mm(0.683),
            trial.quantile_mm(0.95),
            sigmas[sigmas.len() / 2],
        );
        // Presses between elements over coils have errors of long tails, and the refined touches of a twin at its usual
        // pressure are better than those of others.
        let least_more = if name.starts_with("em-") { 0.75 } else { 0.9 };
        let most = if name == "healing-square" { 1.0 } else { 0.84 };
        if !(0.52..=most).contains(&one) || more < least_more {
            wrong.push((name, one, more));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
}

/// One of every layer and shape that a built-in twin has.
const SKINS: [&str; 8] = [
    "healing-square",
    "ionic-disc",
    "ionic-square",
    "piezo-square",
    "piezo-disc",
    "piezo-cylinder",
    "em-8",
    "em-16-square",
];
