//! The outline of a skin without a skin file, as given on the command line.

use std::str::FromStr;

use dermis_skin::Shape;

/// A rectangle or a disc, millimetres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Extent {
    /// Width and height.
    Rectangle([f64; 2]),
    /// Diameter.
    Disc(f64),
}

impl Extent {
    /// The shape as in skin files.
    pub fn shape(self) -> Shape {
        match self {
            Self::Rectangle([width_mm, height_mm]) => Shape::Rectangle { width_mm, height_mm },
            Self::Disc(diameter_mm) => Shape::Disc { diameter_mm },
        }
    }
}

impl FromStr for Extent {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refuse = || format!("expected WxH or a diameter in millimetres, 1 to 10000, got {text:?}");
        let number = |part: &str| match part.trim().parse::<f64>() {
            Ok(value) if (1.0..=1e4).contains(&value) => Ok(value),
            _ => Err(refuse()),
        };
        match text.split(['x', 'X']).collect::<Vec<_>>()[..] {
            [diameter] => Ok(Self::Disc(number(diameter)?)),
            [width, height] => Ok(Self::Rectangle([number(width)?, number(height)?])),
            _ => Err(refuse()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outlines_are_read_or_refused() {
        assert_eq!("100x80.5".parse(), Ok(Extent::Rectangle([100.0, 80.5])));
        assert_eq!("171".parse(), Ok(Extent::Disc(171.0)));
        for text in ["", "x", "10x", "1x2x3", "-5", "nan", "0.1"] {
            assert!(text.parse::<Extent>().is_err(), "{text}");
        }
    }
}
