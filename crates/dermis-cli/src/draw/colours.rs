//! Colours that most eyes can tell apart: maps from values to colours, and the colours of curves.

use super::picture::Colour;

/// Colours of curves (Okabe and Ito 2008), without yellow, which is hard to see on white.
pub const CURVES: [Colour; 7] = [
    Colour(0, 114, 178),
    Colour(213, 94, 0),
    Colour(0, 158, 115),
    Colour(204, 121, 167),
    Colour(86, 180, 233),
    Colour(230, 159, 0),
    Colour(90, 90, 90),
];

/// Blue through white to red (Brewer's RdBu, reversed).
const SIGNED: [u32; 11] =
    [0x053061, 0x2166ac, 0x4393c3, 0x92c5de, 0xd1e5f0, 0xf7f7f7, 0xfddbc7, 0xf4a582, 0xd6604d, 0xb2182b, 0x67001f];
/// Dark violet to yellow, with evenly rising lightness (viridis).
const RISING: [u32; 11] =
    [0x440154, 0x482475, 0x414487, 0x355f8d, 0x2a788e, 0x21918c, 0x22a884, 0x44bf70, 0x7ad151, 0xbddf26, 0xfde725];

/// A map from values to colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Map {
    /// Values of both signs: white at 0.
    Signed,
    /// Values from 0 up.
    Rising,
}

impl Map {
    /// Colour at a position in the map, from 0 at its lower end to 1 at its upper.
    pub fn colour(self, share: f64) -> Colour {
        let stops = match self {
            Self::Signed => &SIGNED,
            Self::Rising => &RISING,
        };
        let place = share.clamp(0.0, 1.0) * (stops.len() - 1) as f64;
        let below = (place.floor() as usize).min(stops.len() - 2);
        let part = place - below as f64;
        let mix = |shift: u32| {
            let [low, high] = [stops[below], stops[below + 1]].map(|stop| f64::from(stop >> shift & 0xff));
            (low * (1.0 - part) + high * part).round() as u8
        };
        Colour(mix(16), mix(8), mix(0))
    }
}

/// A colour map with the values at its ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The map.
    pub map: Map,
    /// Value at the lower end.
    pub low: f64,
    /// Value at the upper end.
    pub high: f64,
}

impl Scale {
    /// A scale for all these values: from 0 up if none is clearly negative, else symmetric about 0.
    pub fn of<'a>(values: impl Iterator<Item = &'a f32>) -> Self {
        let finite = values.filter(|value| value.is_finite()).map(|value| f64::from(*value));
        let (low, high) = finite.fold((0.0_f64, 0.0_f64), |(low, high), value| (low.min(value), high.max(value)));
        let largest = high.max(-low).max(f64::from(f32::MIN_POSITIVE));
        match low < -0.02 * high {
            true => Self { map: Map::Signed, low: -largest, high: largest },
            false => Self { map: Map::Rising, low: 0.0, high: largest },
        }
    }

    /// Position of a value between the ends, from 0 to 1.
    pub fn share(self, value: f64) -> f64 {
        ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance of a colour, as defined by sRGB.
    fn luminance(Colour(red, green, blue): Colour) -> f64 {
        let linear = |value: u8| {
            let share = f64::from(value) / 255.0;
            if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * linear(red) + 0.7152 * linear(green) + 0.0722 * linear(blue)
    }

    #[test]
    fn lightness_alone_determines_the_value_on_a_colour_map() {
        let rising: Vec<f64> = (0..=50).map(|k| luminance(Map::Rising.colour(f64::from(k) / 50.0))).collect();
        assert!(rising.windows(2).all(|pair| pair[1] > pair[0]), "{rising:?}");
        let signed: Vec<f64> = (0..=50).map(|k| luminance(Map::Signed.colour(f64::from(k) / 50.0))).collect();
        assert!(signed[..=25].windows(2).all(|pair| pair[1] > pair[0]), "{signed:?}");
        assert!(signed[25..].windows(2).all(|pair| pair[1] < pair[0]), "{signed:?}");
    }

    #[test]
    fn signs_are_blue_and_red_about_a_neutral_middle() {
        assert_eq!(Map::Signed.colour(0.5), Colour(247, 247, 247));
        assert_eq!(Map::Signed.colour(1.0), Colour(103, 0, 31));
        assert_eq!(Map::Signed.colour(-3.0), Colour(5, 48, 97));
    }

    #[test]
    fn values_of_both_signs_are_about_a_neutral_zero() {
        assert_eq!(Scale::of([2.0, -1.0].iter()), Scale { map: Map::Signed, low: -2.0, high: 2.0 });
        assert_eq!(Scale::of([2.0, -0.01].iter()), Scale { map: Map::Rising, low: 0.0, high: 2.0 });
        assert_eq!(Scale::of([-3.0, f32::NAN].iter()), Scale { map: Map::Signed, low: -3.0, high: 3.0 });
        assert_eq!(Scale::of([2.0, -2.0].iter()).share(0.0), 0.5);
    }
}
