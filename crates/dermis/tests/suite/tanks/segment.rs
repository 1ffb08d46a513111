//! Segmentation of the Kuopio tank: labels compared with the photographed ground truth by the challenge's own score,
//! with as many electrodes missing as at its hardest level.

use dermis_lab::evidence::ktc::scores;
use dermis_live::network::built_in;

use super::measured;

// Measured: 0.661, 0.772, 0.882, 0.832; the chapter on learning has all levels.
#[test]
fn thresholds_segment_the_phantoms_without_twelve_electrodes() {
    let Some(directory) = measured("ktc", "") else { return };
    let found = scores(&directory, 7, None, true).unwrap();
    let mean = found.iter().sum::<f64>() / 4.0;
    println!("ktc level 7: {found:.3?} mean {mean:.3}");
    assert!(mean > 0.74, "{found:.3?}");
}

// Measured: 0.963, 0.946, 0.976, 0.840 with all electrodes, 0.849, 0.908, 0.948, 0.831 without twelve. The networks
// were trained on simulations only.
#[test]
fn the_networks_segment_the_phantoms_with_all_electrodes_and_without_twelve() {
    let Some(directory) = measured("ktc", "") else { return };
    let model = built_in("ktc-tank").unwrap().unwrap();
    for (level, least) in [(1, 0.91), (7, 0.85)] {
        let found = scores(&directory, level, Some(&model), true).unwrap();
        let mean = found.iter().sum::<f64>() / 4.0;
        println!("ktc level {level}, network: {found:.3?} mean {mean:.3}");
        assert!(mean > least, "level {level}: {found:.3?}");
    }
}
