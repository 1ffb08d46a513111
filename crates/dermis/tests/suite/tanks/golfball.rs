//! Golf balls in a tank of 30 cm: positions as measured with a ruler.

use super::{Row, chosen, measured, run};

fn error_mm(rows: &[Row], x_mm: f64, y_mm: f64) -> f64 {
    rows.iter().map(|row| (row.x_mm - x_mm).hypot(row.y_mm - y_mm)).fold(f64::INFINITY, f64::min)
}

// Measured: 3.9 mm at the centre, 8.3 mm at (0, 70) mm; of the pair 8.5 and 13.8 mm.
#[test]
fn balls_are_found_where_they_hang() {
    let Some(file) = measured("golfball", "phantom_A.csv") else { return };
    for (frame, balls, limit_mm) in [
        ("setup2", vec![(0.0, 0.0)], 10.0),
        ("setup3", vec![(0.0, 70.0)], 15.0),
        ("setup4", vec![(0.0, 70.0), (-70.0, 0.0)], 20.0),
    ] {
        let outcome = run("golfball-tank", chosen(&file, "ref"), chosen(&file, frame));
        println!("golfball {frame}: {:?}, order {:.4}", outcome.touches, outcome.report.order.correlation);
        assert_eq!(outcome.touches.len(), balls.len(), "{frame}");
        assert_eq!(outcome.images.holes(0), 0);
        for (x_mm, y_mm) in balls {
            let error = error_mm(&outcome.touches, x_mm, y_mm);
            println!("golfball {frame} ({x_mm}, {y_mm}): {error:.2} mm");
            assert!(error <= limit_mm, "{frame} ({x_mm}, {y_mm}): {error:.1} mm");
        }
        assert!(outcome.report.order.correlation > 0.95 && outcome.report.order.better.is_none());
    }
}
