//! Means, variances, covariances and signal-to-noise ratios.

mod common;

use common::Noise;
use dermis_touch::{Covariance, RunningStats, ShrinkageTarget, SnrDefinition, TouchError, average_snr_db, snr_db};
use proptest::prelude::*;

#[test]
fn the_three_ratios_differ_as_their_formulas_do() {
    let mut stats = RunningStats::new(2);
    for value in [9.0, 11.0, 9.0, 11.0] {
        stats.push(&[value, -value]).unwrap();
    }
    // mean 10, squared deviations sum to 4, so std = sqrt(4/3); sum of squares 404.
    let ratio = 10.0 / (4.0f64 / 3.0).sqrt();
    for channel in 0..2 {
        let db = |definition| snr_db(definition, &stats, channel);
        assert!((db(SnrDefinition::IonicAsPrinted) - 10.0 * ratio.log10()).abs() < 1e-12);
        assert!((db(SnrDefinition::Amplitude) - 20.0 * ratio.log10()).abs() < 1e-12);
        assert!((db(SnrDefinition::HealingEnergy) - 10.0 * 101f64.log10()).abs() < 1e-12);
    }
}

#[test]
fn ratios_without_noise_are_left_out_of_the_average() {
    let mut stats = RunningStats::new(3);
    for value in [1.0, 2.0] {
        stats.push(&[value, 5.0, f64::NAN]).unwrap();
    }
    assert_eq!(snr_db(SnrDefinition::Amplitude, &stats, 1), f64::INFINITY);
    assert!(snr_db(SnrDefinition::HealingEnergy, &stats, 2).is_nan());
    let summary = average_snr_db(SnrDefinition::Amplitude, &stats);
    assert_eq!((summary.channels, summary.left_out), (1, 2));
    assert_eq!(summary.mean_db, snr_db(SnrDefinition::Amplitude, &stats, 0));
    assert!(average_snr_db(SnrDefinition::Amplitude, &RunningStats::new(2)).mean_db.is_nan());
}

/// Frames of `channels` values with neighbouring channels correlated and standard deviations 1, 2, 4 ...
fn frames(count: usize, channels: usize, seed: u64) -> Vec<f64> {
    let mut noise = Noise::new(seed);
    let mut values = Vec::new();
    for _ in 0..count {
        let mut before = noise.normal();
        for channel in 0..channels {
            let next = 0.6 * before + 0.8 * noise.normal();
            values.push(f64::powi(2.0, channel as i32) * next + 100.0);
            before = next;
        }
    }
    values
}

#[test]
fn many_frames_give_the_covariance() {
    let covariance = Covariance::ledoit_wolf(&frames(20_000, 4, 1), 4, ShrinkageTarget::Diagonal).unwrap();
    assert!(covariance.shrinkage < 0.01, "{}", covariance.shrinkage);
    for row in 0..4 {
        for column in 0..4 {
            let scale = f64::powi(2.0, (row + column) as i32);
            let truth = 0.6f64.powi((row as i32 - column as i32).abs());
            // Standard error of a correlation from 20,000 frames: 0.01 at most.
            assert!((covariance.matrix[4 * row + column] / scale - truth).abs() < 0.04);
        }
    }
}

#[test]
fn few_frames_still_give_weights() {
    // Ten frames of 30 channels: the sample covariance has rank 9.
    for target in [ShrinkageTarget::Diagonal, ShrinkageTarget::ScaledIdentity] {
        let covariance = Covariance::ledoit_wolf(&frames(10, 30, 2), 30, target).unwrap();
        assert!(covariance.shrinkage > 0.05 && covariance.shrinkage <= 1.0, "{}", covariance.shrinkage);
        let weights = covariance.inverse().unwrap();
        for row in 0..30 {
            for column in 0..30 {
                let entry: f64 = (0..30).map(|k| covariance.matrix[30 * row + k] * weights[30 * k + column]).sum();
                let scale = (covariance.variance(row) / covariance.variance(column)).sqrt();
                // Relative to the rows' scales, which span 2^29: rounding times a condition number of order 100.
                assert!((entry - f64::from(u8::from(row == column))).abs() < 1e-9 * scale.max(1.0));
            }
        }
    }
}

#[test]
fn shrinkage_is_closer_to_the_truth_than_the_sample() {
    let channels = 20;
    let truth = |row: usize, column: usize| {
        f64::powi(2.0, (row + column) as i32) * 0.6f64.powi((row as i32 - column as i32).abs())
    };
    let error = |covariance: &Covariance, keep: f64| {
        let mut sum = 0.0;
        for row in 0..channels {
            for column in 0..channels {
                let value = covariance.matrix[channels * row + column] / if row == column { 1.0 } else { keep };
                sum += ((value - truth(row, column)) / f64::powi(2.0, (row + column) as i32)).powi(2);
            }
        }
        sum
    };
    for seed in 0..10 {
        let covariance =
            Covariance::ledoit_wolf(&frames(15, channels, seed), channels, ShrinkageTarget::Diagonal).unwrap();
        // Dividing by 1 - shrinkage undoes the shrinkage off the diagonal.
        assert!(error(&covariance, 1.0) < error(&covariance, 1.0 - covariance.shrinkage), "seed {seed}");
    }
}

#[test]
fn agrees_with_the_definition_on_a_small_example() {
    // Three frames of two channels about the mean (0, 0): x = (1, 0), (-1, 1), (0, -1).
    let frames = [1.0, 0.0, -1.0, 1.0, 0.0, -1.0];
    // S = [[2, -1], [-1, 2]] / 3; m = 2/3; d^2 = (1/2)(2/9) = 1/9. The x x' - S have squared Frobenius norms (1/9)(1
    // + 1 + 1 + 4), (1/9)(1 + 4 + 4 + 1), (1/9)(4 + 1 + 1 + 1), 24/9 in total; b^2 = (24/9) / 2 / 9 = 4/27 > d^2.
    let covariance = Covariance::ledoit_wolf(&frames, 2, ShrinkageTarget::ScaledIdentity).unwrap();
    assert_eq!(covariance.shrinkage, 1.0);
    // Calculated by hand; exact except for rounding.
    for (value, expected) in covariance.matrix.iter().zip([2.0 / 3.0, 0.0, 0.0, 2.0 / 3.0]) {
        assert!((value - expected).abs() < 1e-15);
    }
}

#[test]
fn bad_frames_are_named() {
    let wolf = |frames: &[f64], channels| Covariance::ledoit_wolf(frames, channels, ShrinkageTarget::Diagonal);
    assert_eq!(wolf(&[1.0; 5], 2).unwrap_err(), TouchError::Length { what: "frames", expected: 4, got: 5 });
    assert!(matches!(wolf(&[1.0; 2], 2), Err(TouchError::TooFewFrames { got: 1, .. })));
    assert!(matches!(wolf(&[1.0, 2.0, 3.0, f64::NAN], 2), Err(TouchError::NonFinite { index: 3, .. })));
    assert!(wolf(&[], 0).is_err());
    let constant = wolf(&[1.0, 5.0, 2.0, 5.0, 4.0, 5.0], 2).unwrap();
    assert!(matches!(constant.inverse(), Err(TouchError::SingularCovariance { channels: 2, .. })));
}

proptest! {
    #[test]
    fn running_agrees_with_two_passes(values in proptest::collection::vec(-1e3..1e3f64, 2..200), offset in -1e6..1e6f64) {
        let mut stats = RunningStats::new(1);
        for value in &values {
            stats.push(&[value + offset]).unwrap();
            stats.push(&[f64::NAN]).unwrap();
        }
        let count = values.len() as f64;
        let mean = values.iter().sum::<f64>() / count;
        let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
        prop_assert_eq!(stats.count(0), values.len() as u64);
        // Rounding of values near 1e6 is 1e-10; a deviation of 1e3 carries it as 1e-7 into the variance.
        prop_assert!((stats.mean(0) - mean - offset).abs() < 1e-8);
        prop_assert!((stats.variance(0) - variance).abs() < 1e-6 * variance.max(1.0));
    }

    #[test]
    fn shrunk_covariances_are_symmetric_with_shrinkage_in_range(
        values in proptest::collection::vec(-10.0..10.0f64, 4 * 6),
    ) {
        for target in [ShrinkageTarget::Diagonal, ShrinkageTarget::ScaledIdentity] {
            let covariance = Covariance::ledoit_wolf(&values, 4, target).unwrap();
            prop_assert!((0.0..=1.0).contains(&covariance.shrinkage));
            for row in 0..4 {
                for column in 0..4 {
                    let gap = covariance.matrix[4 * row + column] - covariance.matrix[4 * column + row];
                    prop_assert!(gap.abs() < 1e-12 * covariance.variance(row).max(1.0));
                }
            }
        }
    }
}
