//! Labels from an image without a network: a threshold for each sign. This resembles the two thresholds of the
//! challenge organisers, but is relative to the image's own extremes, so that a weak inclusion keeps its size. A sign
//! whose extreme is no more than a side lobe of the other is ignored.

use dermis_learn::scene::{BACKGROUND, LOWERED, RAISED};

/// Conditions for a pixel to belong to an inclusion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskRule {
    /// A sign whose extreme is below this is absent.
    pub least_extreme: f64,
    /// A sign whose extreme is below this share of the other's is absent too: side lobes can reach it.
    pub side_lobe_share: f64,
    /// Minimum value of an inside pixel, as a share of its sign's extreme.
    pub inside_share: f64,
    /// Minimum value of an inside pixel.
    pub least_value: f64,
}

impl MaskRule {
    /// For images of log conductivity: thresholds where conductivity has doubled or halved. The shares were chosen on
    /// the four training phantoms of the Kuopio challenge.
    pub const LOG_CONDUCTIVITY: Self =
        Self { least_extreme: 0.7, side_lobe_share: 0.3, inside_share: 0.35, least_value: 0.7 };

    /// For linear images of relative changes, given the smallest amplitude that counts.
    pub fn linear(smallest: f64) -> Self {
        Self { least_extreme: smallest, side_lobe_share: 0.4, inside_share: 0.45, least_value: 0.0 }
    }
}

/// Assigns pixels to classes by a network's probabilities. If the network is unsure of an object's rim, for example
/// behind lost electrodes, few pixels are more likely object than background although the object is certainly there.
/// Taking the most likely class of every pixel would then make it too small.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PresenceRule {
    /// A class is present if its largest probability reaches this.
    pub least_peak: f32,
    /// Minimum probability of a pixel in the class, as a share of the largest.
    pub inside_share: f32,
    /// Minimum probability of a pixel in the class.
    pub least_probability: f32,
}

/// The best of 15 rules on 500 simulated frames that the network of `ktc-tank` has not seen: a mean challenge score
/// of 0.781. The others reach 0.776 to 0.780, and the most likely classes 0.755.
pub const PRESENCE: PresenceRule = PresenceRule { least_peak: 0.4, inside_share: 0.4, least_probability: 0.2 };

impl PresenceRule {
    /// Labels pixels by probabilities, classes x pixels, with the background as the first class. If several classes
    /// claim a pixel, the most likely one gets it.
    pub fn label(&self, probabilities: &[f32], labels: &mut [u8]) {
        labels.fill(BACKGROUND);
        let mut won = vec![0.0; labels.len()];
        for (class, values) in probabilities.chunks_exact(labels.len().max(1)).enumerate().skip(1) {
            let peak = values.iter().copied().fold(0.0, f32::max);
            if peak < self.least_peak {
                continue;
            }
            let threshold = (self.inside_share * peak).max(self.least_probability);
            for ((label, won), value) in labels.iter_mut().zip(&mut won).zip(values) {
                if *value > threshold && *value > *won {
                    (*label, *won) = (class as u8, *value);
                }
            }
        }
    }
}

/// Labels of an image (positive where conductivity is raised; `NaN` outside the skin is background).
pub fn masks_of_image(image: &[f32], rule: &MaskRule) -> Vec<u8> {
    let mut labels = vec![BACKGROUND; image.len()];
    label_image(image, 1.0, rule, &mut labels);
    labels
}

/// As [`masks_of_image`] for the image times `factor`, into the given labels.
pub(super) fn label_image(image: &[f32], factor: f32, rule: &MaskRule, labels: &mut [u8]) {
    let value = |value: &f32| f64::from(factor * *value);
    let finite = || image.iter().map(value).filter(|value| value.is_finite());
    let extremes = [(RAISED, 1.0, finite().fold(0.0, f64::max)), (LOWERED, -1.0, -finite().fold(0.0, f64::min))];
    let strongest = extremes[0].2.max(extremes[1].2);
    labels.fill(BACKGROUND);
    for (class, sign, extreme) in extremes {
        if extreme < rule.least_extreme.max(rule.side_lobe_share * strongest) || extreme == 0.0 {
            continue;
        }
        let threshold = (rule.inside_share * extreme).max(rule.least_value);
        for (label, pixel) in labels.iter_mut().zip(image) {
            if sign * value(pixel) > threshold {
                *label = class;
            }
        }
    }
}

/// Resamples an image from `from` = rows, columns to `to` = rows, columns, bilinear between pixel centres, with
/// repeated edges. Pixels outside the skin (`NaN`) take the value of their neighbours, and become `NaN` again where
/// `outside` is true for the new pixels (row-major; empty: nowhere).
pub fn enlarge(image: &[f32], from: [usize; 2], to: [usize; 2], outside: &[bool]) -> Vec<f32> {
    let ([rows, columns], [to_rows, to_columns]) = (from, to);
    let filled = fill_outside(image, rows, columns);
    let place = |k: usize, count: usize, to: usize| {
        let at = ((k as f64 + 0.5) * count as f64 / to as f64 - 0.5).clamp(0.0, count as f64 - 1.0);
        let low = at.floor() as usize;
        (low, (low + 1).min(count - 1), (at - low as f64) as f32)
    };
    let across: Vec<_> = (0..to_columns).map(|k| place(k, columns, to_columns)).collect();
    let mut out = Vec::with_capacity(to_rows * to_columns);
    for row in 0..to_rows {
        let (top, bottom, down) = place(row, rows, to_rows);
        for (column, &(left, right, along)) in across.iter().enumerate() {
            let mix = |row: usize| {
                let run = &filled[row * columns..(row + 1) * columns];
                run[left] + along * (run[right] - run[left])
            };
            let value = mix(top) + down * (mix(bottom) - mix(top));
            out.push(if outside.get(row * to_columns + column) == Some(&true) { f32::NAN } else { value });
        }
    }
    out
}

/// Extends the values outwards, ring by ring; each new pixel is the mean of its neighbours that have a value.
fn fill_outside(image: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    let mut filled = image.to_vec();
    for _ in 0..rows.max(columns) {
        let before = filled.clone();
        let mut left = false;
        for place in (0..filled.len()).filter(|&place| before[place].is_nan()) {
            let (row, column) = ((place / columns) as isize, (place % columns) as isize);
            let (mut sum, mut count) = (0.0, 0.0);
            for (down, along) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (r, c) = (row + down, column + along);
                let there = r >= 0 && c >= 0 && r < rows as isize && c < columns as isize;
                let value = if there { before[r as usize * columns + c as usize] } else { f32::NAN };
                if value.is_finite() {
                    (sum, count) = (sum + value, count + 1.0);
                }
            }
            if count > 0.0 {
                filled[place] = sum / count;
            } else {
                left = true;
            }
        }
        if !left {
            break;
        }
    }
    filled.iter_mut().filter(|value| value.is_nan()).for_each(|value| *value = 0.0);
    filled
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn side_lobes_are_no_inclusions_but_weak_ones_keep_their_size() {
        let rule = MaskRule::LOG_CONDUCTIVITY;
        // A strong resistive inclusion with a conductive side lobe of a fifth.
        let labels = masks_of_image(&[-3.0, -2.0, -0.5, 0.6, f32::NAN], &rule);
        assert_eq!(labels, [1, 1, 0, 0, 0]);
        // A weak conductive one next to it: 0.35 of its own extreme.
        let labels = masks_of_image(&[-3.0, 0.0, 1.2, 0.75, 0.65], &rule);
        assert_eq!(labels, [1, 0, 2, 2, 0]);
        assert_eq!(masks_of_image(&[0.3, -0.2, f32::NAN], &rule), [0, 0, 0]);
    }

    #[test]
    fn an_object_with_an_unsure_rim_keeps_it() {
        // One pixel more likely than background, the others of its object not; and an absent class.
        let raised = [0.05, 0.25, 0.52, 0.4, 0.15, 0.02];
        let lowered = [0.2, 0.1, 0.0, 0.05, 0.29, 0.1];
        let background: Vec<f32> = raised.iter().zip(&lowered).map(|(a, b)| 1.0 - a - b).collect();
        let mut labels = [9; 6];
        PRESENCE.label(&[&background[..], &lowered, &raised].concat(), &mut labels);
        assert_eq!(labels, [0, 2, 2, 2, 0, 0]);
        // If both claim a pixel, the more likely one gets it.
        PRESENCE.label(&[0.0, 0.1, 0.55, 0.1, 0.45, 0.8], &mut labels[..2]);
        assert_eq!(labels[..2], [1, 2]);
    }

    #[test]
    fn a_plane_stays_a_plane_when_enlarged() {
        let image: Vec<f32> = (0..64).map(|k| (k % 8) as f32 + 10.0 * (k / 8) as f32).collect();
        let outside: Vec<bool> = (0..256).map(|k| k == 3).collect();
        let large = enlarge(&image, [8, 8], [16, 16], &outside);
        assert!(large[3].is_nan());
        for row in 1..15 {
            for column in 1..15 {
                let expected = (column as f32 + 0.5) / 2.0 - 0.5 + 10.0 * ((row as f32 + 0.5) / 2.0 - 0.5);
                assert!((large[row * 16 + column] - expected).abs() < 1e-4);
            }
        }
        let mut hole = vec![f32::NAN; 64];
        hole[27] = 4.0;
        assert!(enlarge(&hole, [8, 8], [8, 8], &[]).iter().all(|value| *value == 4.0));
    }
}
