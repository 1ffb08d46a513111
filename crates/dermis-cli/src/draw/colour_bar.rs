//! The colour bar that explains the colours of an image.

use super::axis::{Axis, nice_at_least, power_of_ten};
use super::colours::Scale;
use super::picture::{Anchor, INK, Item, PixelPoint, Polyline, Shape, Text};
use super::text::width;

const BAR: f64 = 14.0;
/// Longest bar; a longer one is no easier to read.
const LONGEST: f64 = 360.0;
const STEPS: usize = 64;
const SIZE: f64 = 12.5;

/// A bar with ticks, placed next to images.
pub struct ColourBar<'a> {
    /// Colours and their values.
    pub scale: Scale,
    /// Quantity with its unit.
    pub quantity: &'a str,
}

impl ColourBar<'_> {
    /// Width of a bar with its ticks and name, pixels.
    pub const WIDTH: f64 = 96.0;

    /// The bar, as high as its images, or centred on them if that would be too long.
    pub fn items(&self, [left, top]: PixelPoint, span: f64) -> Vec<Item> {
        let length = span.min(LONGEST);
        let (top, left) = (top + 0.5 * (span - length), left + 4.0);
        let (bottom, right) = (top + length, left + BAR);
        let Scale { map, low, high } = self.scale;
        let step = nice_at_least((high - low) / 5.0);
        let axis = Axis { low, high, start: bottom, end: top, step };
        let mut items: Vec<Item> = Vec::new();
        for k in 0..STEPS {
            let level = |k: usize| bottom - length * k as f64 / STEPS as f64;
            // Each step extends under the next, so that no seams show.
            let rectangle = Polyline::rectangle([left, level((k + 2).min(STEPS))], [right, level(k)]);
            let colour = map.colour((k as f64 + 0.5) / STEPS as f64);
            items.push(Shape::filled("colours", vec![rectangle], colour).into());
        }
        items.push(Shape::stroked("bar", vec![Polyline::rectangle([left, top], [right, bottom])], INK, 0.9).into());
        let (first, last) = ((low / step - 1e-9).ceil() as i64, (high / step + 1e-9).floor() as i64);
        let (mut ticks, mut widest) = (Vec::new(), 0.0_f64);
        for value in (first..=last).map(|k| k as f64 * step) {
            let level = axis.place(value);
            ticks.push(Polyline::open([[right, level], [right + 4.0, level]]));
            let text = Text { anchor: Anchor::Start, ..Text::new(axis.label(value), SIZE, [right + 7.0, level]) };
            widest = widest.max(text.width());
            items.push(text.into());
        }
        items.push(Shape::stroked("ticks", ticks, INK, 0.9).into());
        let power = axis.power();
        let words = match (self.quantity, power) {
            (quantity, 0) => quantity.to_string(),
            ("", power) => format!("× {}", power_of_ten(power)),
            (quantity, power) => format!("{quantity}, × {}", power_of_ten(power)),
        };
        // Shrink a name that is longer than the images are high.
        let size = SIZE.min(SIZE * (span + 12.0) / width(&words, SIZE).max(1.0));
        let at = [right + 7.0 + widest + 13.0, 0.5 * (top + bottom)];
        items.push(Text { upward: true, ..Text::new(words, size, at) }.into());
        items
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::colours::Map;
    use crate::draw::picture::Picture;

    fn drawn(low: f64, high: f64) -> Picture {
        let bar = ColourBar { scale: Scale { map: Map::Signed, low, high }, quantity: "change (%)" };
        Picture { title: String::new(), width_px: 100, height_px: 200, items: bar.items([0.0, 10.0], 170.0) }
    }

    #[test]
    fn ticks_are_round_numbers_at_their_values() {
        let picture = drawn(-0.23, 0.23);
        let level = |words: &str| picture.texts().find(|text| text.words == words).unwrap().at[1];
        assert!((level("0") - 95.0).abs() < 1e-9);
        assert!((level("0.2") - (95.0 - 85.0 * 0.2 / 0.23)).abs() < 1e-9);
        assert!((level("−0.1") - (95.0 + 85.0 * 0.1 / 0.23)).abs() < 1e-9);
        assert!(picture.texts().any(|text| text.words == "change (%)" && text.upward));
    }

    #[test]
    fn small_values_share_a_power_of_ten_and_everything_has_room() {
        let picture = drawn(-3e-5, 3e-5);
        assert!(picture.texts().any(|text| text.words == "change (%), × 10⁻⁵"), "{picture:?}");
        assert!(picture.texts().all(|text| text.upward || text.at[0] + text.width() < ColourBar::WIDTH));
        assert!(picture.texts().all(|text| text.at[0] + 0.5 * SIZE < ColourBar::WIDTH), "{picture:?}");
    }
}
