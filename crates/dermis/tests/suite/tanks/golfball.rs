//! Golf balls in a 30 cm tank, at positions measured with a ruler.

use dermis_lab::evidence::golfball::{SETUPS, error_mm, setup};

use super::measured;

// Measured: 3.9 mm at the centre, 8.3 mm at (0, 70) mm; for the pair 8.5 and 13.8 mm.
#[test]
fn balls_are_located() {
    let Some(file) = measured("golfball", "phantom_A.csv") else { return };
    for ((frame, balls), limit_mm) in SETUPS.into_iter().zip([5.0, 10.5, 17.0]) {
        let outcome = setup(&file, frame).unwrap();
        println!("golfball {frame}: {:?}, order {:.4}", outcome.touches, outcome.report.order.correlation);
        assert_eq!(outcome.touches.len(), balls.len(), "{frame}");
        assert_eq!(outcome.images.holes(0), 0);
        for ball in balls {
            let error = error_mm(&outcome, *ball);
            println!("golfball {frame} {ball:?}: {error:.2} mm");
            assert!(error <= limit_mm, "{frame} {ball:?}: {error:.1} mm");
        }
        assert!(outcome.report.order.correlation > 0.95 && outcome.report.order.better.is_none());
    }
}
