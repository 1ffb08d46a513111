//! Symbols at points, which distinguish curves without their colours, and dashes.

use dermis_tomo::mesh::distance;

use super::picture::{Colour, PixelPoint, Polyline, Shape, Stroke, WHITE};

/// Length of a dash, and of the gap to the next, pixels.
const DASH: [f64; 2] = [7.0, 5.0];

/// A symbol.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Marker {
    Disc,
    Square,
    Triangle,
    Diamond,
    HollowSquare,
}

impl Marker {
    /// The symbol of the curve with this number, counted from 0.
    pub fn of(number: usize) -> Self {
        [Self::Disc, Self::Square, Self::Triangle, Self::Diamond][number % 4]
    }

    fn outline(self, [x, y]: PixelPoint) -> Polyline {
        match self {
            Self::Disc => Polyline::disc([x, y], 4.2),
            Self::Square => Polyline::rectangle([x - 3.8, y - 3.8], [x + 3.8, y + 3.8]),
            Self::Triangle => Polyline::closed([[x, y - 5.0], [x + 4.8, y + 3.6], [x - 4.8, y + 3.6]]),
            Self::Diamond => Polyline::closed([[x - 5.2, y], [x, y - 5.2], [x + 5.2, y], [x, y + 5.2]]),
            Self::HollowSquare => Polyline::rectangle([x - 5.5, y - 5.5], [x + 5.5, y + 5.5]),
        }
    }

    /// One symbol at every point; `None` without points.
    pub fn shape(self, class: &'static str, points: &[PixelPoint], colour: Colour) -> Option<Shape> {
        let lines: Vec<Polyline> = points.iter().map(|point| self.outline(*point)).collect();
        let (fill, stroke) = match self {
            Self::HollowSquare => (None, Stroke { colour, width: 2.0 }),
            _ => (Some(colour), Stroke { colour: WHITE, width: 0.6 }),
        };
        (!lines.is_empty()).then_some(Shape { class, lines, fill, stroke: Some(stroke), crisp: false })
    }
}

/// Dashes along a line.
pub fn dashed(points: &[PixelPoint]) -> Vec<Polyline> {
    let mut dashes = Vec::new();
    // Position of the line within a dash and its gap.
    let mut phase = 0.0;
    for pair in points.windows(2) {
        let [from, to] = [pair[0], pair[1]];
        let length = distance(from, to);
        let at = |way: f64| [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * way / length);
        let mut way = 0.0;
        while way < length {
            let left = if phase < DASH[0] { DASH[0] - phase } else { DASH[0] + DASH[1] - phase };
            let end = (way + left).min(length);
            if phase < DASH[0] {
                dashes.push(Polyline::open([at(way), at(end)]));
            }
            phase += end - way;
            if phase >= DASH[0] + DASH[1] - 1e-9 {
                phase = 0.0;
            }
            way = end;
        }
    }
    dashes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_cover_their_share_of_a_line_and_run_on_round_corners() {
        let lines = dashed(&[[0.0, 0.0], [60.0, 0.0], [60.0, 60.0]]);
        let length = |line: &Polyline| distance(line.points[0], line.points[1]);
        let covered: f64 = lines.iter().map(length).sum();
        assert!((covered - 120.0 * 7.0 / 12.0).abs() < 1e-6, "{covered}");
        assert_eq!(lines[0].points, [[0.0, 0.0], [7.0, 0.0]]);
        assert!(lines.iter().all(|line| length(line) <= 7.0 + 1e-9));
    }

    #[test]
    fn neighbours_have_different_symbols() {
        let kinds: Vec<Marker> = (0..5).map(Marker::of).collect();
        assert_eq!(kinds[0], kinds[4]);
        assert!(kinds[..4].iter().enumerate().all(|(k, kind)| !kinds[..k].contains(kind)));
        assert_eq!(Marker::Disc.shape("points", &[], WHITE), None);
    }
}
