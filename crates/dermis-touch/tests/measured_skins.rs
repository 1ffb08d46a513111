//! The calibrated locator on measured skins of unknown wiring: pokes that are much denser in the middle, and a skin
//! before and after it was damaged. Data: DSHardman/Anisotropy and DSHardman/Variable-Sensitivity-E-Skins.

use std::path::Path;

use dermis_touch::locator::{Examples, FusedLocator, FusedOptions, SignatureMap};

/// Assumed side of the skins, metres.
const SIDE_M: f64 = 0.1;
const JUDGED: usize = 300;

struct Skin {
    frames: Vec<Vec<f64>>,
    places_m: Vec<[f64; 2]>,
}

fn numbers(path: &Path, header: usize) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).expect("the measured data are readable");
    let number = |cell: &str| cell.trim().parse().expect("a number");
    text.lines().skip(header).map(|line| line.split(',').map(number).collect()).collect()
}

impl Skin {
    fn read(set: &str, name: &str) -> Option<Self> {
        let folder = dermis_testdata::set(set)?.join(name);
        let places = numbers(&folder.join("positions.csv"), 1);
        Some(Self {
            frames: numbers(&folder.join("differences.csv"), 0),
            places_m: places.iter().map(|row| [row[0], row[1]]).collect(),
        })
    }

    /// Scattered rows. The last ones of the set are kept for judging.
    fn rows(&self, count: usize) -> Vec<usize> {
        (0..count).map(|k| (k * 1229) % (self.frames.len() - JUDGED)).collect()
    }

    fn examples(&self, rows: &[usize]) -> Examples {
        let frames = rows.iter().flat_map(|&row| self.frames[row].iter().copied()).collect();
        Examples::new(self.frames[0].len(), frames, rows.iter().map(|&row| self.places_m[row]).collect()).unwrap()
    }

    /// Median error of the last presses, metres, and the shares of coordinates within 1 and 2.5 sigma.
    fn judge(&self, locator: &FusedLocator) -> (f64, [f64; 2]) {
        let (mut errors, mut within) = (Vec::new(), [0; 2]);
        let mut scratch = locator.scratch();
        for row in self.frames.len() - JUDGED..self.frames.len() {
            let found = locator.predict_into(&self.frames[row], &mut scratch).unwrap();
            let [x, y] = [found.x_m - self.places_m[row][0], found.y_m - self.places_m[row][1]];
            for (sigmas, within) in [1.0, 2.5].into_iter().zip(&mut within) {
                *within += usize::from(x.abs() <= sigmas * found.sigma_x_m);
                *within += usize::from(y.abs() <= sigmas * found.sigma_y_m);
            }
            errors.push(x.hypot(y));
        }
        errors.sort_by(f64::total_cmp);
        (errors[JUDGED / 2], within.map(|count| count as f64 / (2 * JUDGED) as f64))
    }
}

fn fit(examples: &Examples) -> FusedLocator {
    let at = |k: usize| SIDE_M * ((k as f64 + 0.5) / 40.0 - 0.5);
    let places = (0..40).flat_map(|row| (0..40).map(move |column| [at(column), at(row)])).collect();
    let map = SignatureMap::without_physics(examples.channels(), places).unwrap();
    FusedLocator::fit(examples, &map, &FusedOptions::default()).unwrap()
}

/// Six in ten of these pokes are within 20 mm of the middle, and none is beyond 40 mm.
#[test]
fn sigmas_hold_for_unevenly_spread_pokes() {
    let Some(skin) = Skin::read("cam09", "03") else { return };
    let (median_m, [one, more]) = skin.judge(&fit(&skin.examples(&skin.rows(400))));
    println!("median {:.2} mm, within 1 sigma {one:.2}, within 2.5 {more:.3}", 1e3 * median_m);
    assert!(median_m < 3.2e-3, "{median_m}");
    assert!((0.6..=0.78).contains(&one) && more >= 0.95, "{one} {more}");
}

#[test]
fn a_damaged_skin_is_located_best_by_both_sessions_together() {
    let (Some(before), Some(after)) = (Skin::read("five-skins", "circles"), Skin::read("cam09", "16")) else { return };
    let old = before.examples(&before.rows(500));
    let new = after.examples(&after.rows(20));
    let shared = fit(&new.clone().with_earlier(&old).unwrap());
    let errors_m = [&shared, &fit(&new), &fit(&old)].map(|locator| after.judge(locator).0);
    let (_, [one, more]) = after.judge(&shared);
    println!("together, alone, before: {errors_m:?} m; within 1 sigma {one:.2}, within 2.5 {more:.3}");
    assert!(errors_m[0] <= errors_m[1].min(errors_m[2]), "{errors_m:?}");
    assert!((0.55..=0.8).contains(&one) && more >= 0.93, "{one} {more}");
    assert!(shared.report().resemblance.is_some_and(|resemblance| (0.5..1.0).contains(&resemblance)));
}
