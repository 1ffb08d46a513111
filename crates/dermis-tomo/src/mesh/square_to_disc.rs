//! An area-preserving map from the square to the disc, for grids of electrodes and taxels on round skins.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};

use crate::mesh::plane::Point;

/// The equal-area concentric map of Shirley and Chiu (1997) from the square [-1, 1]^2 to the unit disc; it maps
/// squares around the centre to circles. Lengths are relative to half the square's side and to the disc's radius.
pub fn square_to_disc([x, y]: Point) -> Point {
    let (radius, angle) = if x.abs() > y.abs() {
        (x, FRAC_PI_4 * y / x)
    } else if y != 0.0 {
        (y, FRAC_PI_2 - FRAC_PI_4 * x / y)
    } else {
        (0.0, 0.0)
    };
    [radius * angle.cos(), radius * angle.sin()]
}

#[cfg(test)]
mod tests {
    use super::square_to_disc;

    #[test]
    fn squares_become_circles_and_areas_keep_their_share() {
        for (x, y) in [(0.5, 0.2), (-0.7, 0.7), (0.1, -0.9), (-0.3, -0.1)] {
            let [u, v] = square_to_disc([x, y]);
            let half_side: f64 = f64::max(f64::abs(x), f64::abs(y));
            assert!((u.hypot(v) - half_side).abs() < 1e-15, "{x} {y}");
            if f64::abs(x) == f64::abs(y) {
                continue;
            }
            // Determinant of the map: pi/4, the disc's area over the square's. Central differences over 1e-5.
            let step = 1e-5;
            let by = |dx: f64, dy: f64| {
                let ([a, b], [c, d]) = (square_to_disc([x + dx, y + dy]), square_to_disc([x - dx, y - dy]));
                [(a - c) / (2.0 * step), (b - d) / (2.0 * step)]
            };
            let (along_x, along_y) = (by(step, 0.0), by(0.0, step));
            let area = along_x[0] * along_y[1] - along_x[1] * along_y[0];
            assert!((area - std::f64::consts::FRAC_PI_4).abs() < 1e-8, "{x} {y}: {area}");
        }
        assert_eq!(square_to_disc([0.0, 0.0]), [0.0, 0.0]);
    }
}
