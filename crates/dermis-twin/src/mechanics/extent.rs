//! Checks that a skin can carry an indenter: its centre must be on the skin, and its face no larger than the skin.

use dermis_tomo::mesh::Outline;

use super::Indenter;
use crate::error::{TwinError, check};

/// Refuses an indenter that a skin with this outline cannot carry.
///
/// # Errors
/// A centre off the skin (or in a hole), or a face larger than the skin, with the value; otherwise as
/// [`Indenter::check`].
pub fn check_on_skin(outline: &Outline, indenter: &Indenter) -> Result<(), TwinError> {
    indenter.check()?;
    let [x, y] = indenter.centre_m;
    match outline {
        Outline::Disc { radius_m } => {
            let field = "distance of the indenter from the middle, m";
            check(field, x.hypot(y), 0.0, *radius_m, "no farther out than the skin's rim")?;
        }
        Outline::Rectangle { .. } => {
            let (low, high) = outline.bounds_m();
            check("x of the indenter, m", x, low[0], high[0], "no farther out than the skin's rim")?;
            check("y of the indenter, m", y, low[1], high[1], "no farther out than the skin's rim")?;
        }
        Outline::Polygon { .. } => {
            if !outline.contains([x, y]) {
                let expected = "a middle on the skin, within its rim and in none of its holes";
                return Err(TwinError::Place { what: "indenter", x_m: x, y_m: y, expected });
            }
        }
    }
    let area = indenter.shape.area_m2();
    check("area of the indenter, m^2", area, 0.0, outline.area_m2(), "no larger than the skin's")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_carries_load_except_in_its_holes() {
        let square = |half: f64| vec![[-half, -half], [half, -half], [half, half], [-half, half]];
        let frame = Outline::Polygon { outer: square(0.05), holes: vec![square(0.02)] };
        let at = |x_m, y_m| check_on_skin(&frame, &Indenter::disc([x_m, y_m], 0.005, 1e3));
        for (x_m, y_m) in [(0.03, 0.0), (-0.04, 0.04), (0.05, 0.0), (0.02, 0.01), (-0.05, -0.05)] {
            assert!(at(x_m, y_m).is_ok(), "{x_m} {y_m}");
        }
        for (x_m, y_m) in [(0.0, 0.0), (0.019, 0.01), (0.051, 0.0), (0.0, -0.2)] {
            let error = at(x_m, y_m).unwrap_err().to_string();
            assert!(error.starts_with(&format!("indenter at ({x_m}, {y_m}) m refused")), "{error}");
        }
        // With either orientation.
        let turned = Outline::Polygon { outer: square(0.05).into_iter().rev().collect(), holes: vec![square(0.02)] };
        assert!(turned.contains([0.03, 0.0]) && !turned.contains([0.0, 0.0]));
        assert!(Outline::Disc { radius_m: 0.01 }.contains([0.006, -0.008]));
        assert!(!Outline::Rectangle { width_m: 0.02, height_m: 0.01 }.contains([0.0, 0.006]));
        let large = Indenter::disc([0.03, 0.0], 0.052, 1e3);
        assert!(check_on_skin(&frame, &large).unwrap_err().to_string().starts_with("area of the indenter"));
    }
}
