//! A stroke font of the characters that drawings need, on a grid of 4 x 6 units, drawn as polylines: digits, a few
//! small letters, capitals, signs. Other small letters are small capitals.

use super::picture::{Point, Polyline};

/// Height of a capital or digit in grid units.
const CAPITAL: f64 = 6.0;
/// Blank between characters.
const GAP: f64 = 1.6;

type Glyph = (char, f64, &'static [&'static [[f64; 2]]]);

/// Character, width, and its lines; y counts up from the base line.
const GLYPHS: [Glyph; 18] = [
    (
        '0',
        4.0,
        &[&[
            [1.0, 0.0],
            [3.0, 0.0],
            [4.0, 1.2],
            [4.0, 4.8],
            [3.0, 6.0],
            [1.0, 6.0],
            [0.0, 4.8],
            [0.0, 1.2],
            [1.0, 0.0],
        ]],
    ),
    ('1', 3.0, &[&[[0.2, 4.6], [1.7, 6.0], [1.7, 0.0]]]),
    ('2', 4.0, &[&[[0.0, 4.8], [1.0, 6.0], [3.0, 6.0], [4.0, 4.9], [4.0, 3.9], [0.0, 0.0], [4.0, 0.0]]]),
    (
        '3',
        4.0,
        &[
            &[[0.0, 5.0], [1.0, 6.0], [3.0, 6.0], [4.0, 5.1], [4.0, 4.0], [3.0, 3.1], [1.6, 3.1]],
            &[[3.0, 3.1], [4.0, 2.2], [4.0, 1.0], [3.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
        ],
    ),
    ('4', 4.0, &[&[[3.0, 0.0], [3.0, 6.0], [0.0, 1.8], [4.0, 1.8]]]),
    (
        '5',
        4.0,
        &[&[
            [3.8, 6.0],
            [0.4, 6.0],
            [0.2, 3.2],
            [1.2, 3.7],
            [3.0, 3.7],
            [4.0, 2.7],
            [4.0, 1.1],
            [3.0, 0.0],
            [1.0, 0.0],
            [0.0, 0.9],
        ]],
    ),
    (
        '6',
        4.0,
        &[&[
            [3.7, 5.3],
            [2.9, 6.0],
            [1.2, 6.0],
            [0.0, 4.6],
            [0.0, 1.2],
            [1.0, 0.0],
            [3.0, 0.0],
            [4.0, 1.1],
            [4.0, 2.5],
            [3.0, 3.6],
            [1.0, 3.6],
            [0.0, 2.6],
        ]],
    ),
    ('7', 4.0, &[&[[0.0, 6.0], [4.0, 6.0], [1.4, 0.0]]]),
    (
        '8',
        4.0,
        &[&[
            [1.0, 3.2],
            [0.2, 4.0],
            [0.2, 5.2],
            [1.1, 6.0],
            [2.9, 6.0],
            [3.8, 5.2],
            [3.8, 4.0],
            [3.0, 3.2],
            [1.0, 3.2],
            [0.0, 2.3],
            [0.0, 1.0],
            [1.0, 0.0],
            [3.0, 0.0],
            [4.0, 1.0],
            [4.0, 2.3],
            [3.0, 3.2],
        ]],
    ),
    (
        '9',
        4.0,
        &[&[
            [0.3, 0.7],
            [1.1, 0.0],
            [2.8, 0.0],
            [4.0, 1.4],
            [4.0, 4.8],
            [3.0, 6.0],
            [1.0, 6.0],
            [0.0, 4.9],
            [0.0, 3.5],
            [1.0, 2.4],
            [3.0, 2.4],
            [4.0, 3.4],
        ]],
    ),
    ('-', 3.0, &[&[[0.0, 3.0], [3.0, 3.0]]]),
    ('.', 0.4, &[&[[0.0, 0.0], [0.3, 0.0]]]),
    (
        'm',
        5.0,
        &[
            &[[0.0, 0.0], [0.0, 4.0]],
            &[[0.0, 2.9], [1.2, 4.0], [2.5, 3.2], [2.5, 0.0]],
            &[[2.5, 2.9], [3.7, 4.0], [5.0, 3.2], [5.0, 0.0]],
        ],
    ),
    ('x', 3.2, &[&[[0.0, 0.0], [3.2, 4.0]], &[[0.0, 4.0], [3.2, 0.0]]]),
    ('y', 3.2, &[&[[0.0, 4.0], [1.6, 0.2]], &[[3.2, 4.0], [0.8, -1.8]]]),
    ('(', 1.4, &[&[[1.4, 6.8], [0.3, 4.8], [0.3, 0.8], [1.4, -1.2]]]),
    (')', 1.4, &[&[[0.0, 6.8], [1.1, 4.8], [1.1, 0.8], [0.0, -1.2]]]),
    (' ', 2.0, &[]),
];

/// Character and its lines, separated by `|`, each a list of corners: column and row of the grid.
const LETTERS: [(char, &str); 40] = [
    ('A', "00 26 40|12 32"),
    ('B', "00 06 36 45 44 33 03|33 42 41 30 00"),
    ('C', "45 36 16 05 01 10 30 41"),
    ('D', "00 06 26 44 42 20 00"),
    ('E', "40 00 06 46|03 33"),
    ('F', "00 06 46|03 33"),
    ('G', "45 36 16 05 01 10 30 41 43 23"),
    ('H', "00 06|40 46|03 43"),
    ('I', "10 30|20 26|16 36"),
    ('J', "46 41 30 10 01"),
    ('K', "00 06|46 03 40"),
    ('L', "06 00 40"),
    ('M', "00 06 23 46 40"),
    ('N', "00 06 40 46"),
    ('O', "10 30 41 45 36 16 05 01 10"),
    ('P', "00 06 36 45 44 33 03"),
    ('Q', "10 30 41 45 36 16 05 01 10|22 40"),
    ('R', "00 06 36 45 44 33 03|23 40"),
    ('S', "45 36 16 05 04 13 33 42 41 30 10 01"),
    ('T', "06 46|20 26"),
    ('U', "06 01 10 30 41 46"),
    ('V', "06 20 46"),
    ('W', "06 10 23 30 46"),
    ('X', "00 46|06 40"),
    ('Y', "06 23 46|23 20"),
    ('Z', "06 46 00 40"),
    ('/', "00 46"),
    ('%', "00 46|05 06 16 15 05|30 31 41 40 30"),
    ('=', "02 42|04 44"),
    ('+', "03 43|21 25"),
    (',', "21 10"),
    (':', "11 12|14 15"),
    ('<', "45 03 41"),
    ('>', "05 43 01"),
    ('^', "14 26 34"),
    ('_', "00 40"),
    ('*', "12 34|32 14|22 24"),
    (';', "11 00|14 15"),
    ('[', "26 06 00 20"),
    (']', "06 26 20 00"),
];
/// Height of small capitals relative to capitals.
const SMALL: f64 = 0.74;

/// Most letters of a unit or variable (`mm`, `x`), which are set in small letters where the font has them.
const SYMBOL: usize = 2;

/// Width and lines of a character; of one that the font lacks, a blank.
fn glyph(character: char, of_symbol: bool) -> (f64, Vec<Vec<[f64; 2]>>) {
    let own = GLYPHS.iter().find(|glyph| glyph.0 == character);
    if let Some((_, width, strokes)) = own.filter(|_| of_symbol || !character.is_ascii_alphabetic()) {
        return (*width, strokes.iter().map(|stroke| stroke.to_vec()).collect());
    }
    let scale = if character.is_ascii_lowercase() { SMALL } else { 1.0 };
    let capital = character.to_ascii_uppercase();
    let Some((_, lines)) = LETTERS.iter().find(|letter| letter.0 == capital) else { return (2.0, Vec::new()) };
    let corner = |pair: &str| {
        let mut digits = pair.bytes().map(|digit| scale * f64::from(digit.saturating_sub(b'0')));
        [digits.next().unwrap_or_default(), digits.next().unwrap_or_default()]
    };
    (4.0 * scale, lines.split('|').map(|line| line.split(' ').map(corner).collect()).collect())
}

/// Length of the run of letters that a byte of the text is in.
fn letters_around(text: &str, index: usize) -> usize {
    let letter = |byte: &&u8| byte.is_ascii_alphabetic();
    let (before, after) = text.as_bytes().split_at(index);
    before.iter().rev().take_while(letter).count() + after.iter().take_while(letter).count()
}

/// Text as polylines, and how wide they are, pixels.
pub struct Lettering {
    /// Lines with the text's middle at the origin.
    lines: Vec<Polyline>,
    /// From the left edge of the first character to the right edge of the last.
    pub width: f64,
}

impl Lettering {
    /// Sets text with capitals `height` pixels high. Characters that the font lacks are left blank.
    pub fn new(text: &str, height: f64) -> Self {
        let unit = height / CAPITAL;
        let mut lines = Vec::new();
        let mut pen = 0.0;
        for (index, character) in text.char_indices() {
            let (width, strokes) = glyph(character, letters_around(text, index) <= SYMBOL);
            lines.extend(strokes.iter().map(|stroke| {
                let place = |[x, y]: &[f64; 2]| [(pen + x) * unit, (CAPITAL / 2.0 - y) * unit];
                Polyline::open(stroke.iter().map(place).collect::<Vec<_>>())
            }));
            pen += width + GAP;
        }
        let width = (pen - GAP).max(0.0) * unit;
        let shift = |point: &mut Point| point[0] -= width / 2.0;
        lines.iter_mut().flat_map(|line| &mut line.points).for_each(shift);
        Self { lines, width }
    }

    /// The lines with the text's middle (half-way up its capitals) at a point.
    pub fn centred_at(&self, centre: Point) -> Vec<Polyline> {
        self.turned_at(centre, false)
    }

    /// As [`Lettering::centred_at`], turned to read upward where asked.
    pub fn turned_at(&self, centre: Point, upward: bool) -> Vec<Polyline> {
        let place = |[x, y]: &Point| match upward {
            true => [centre[0] + y, centre[1] - x],
            false => [centre[0] + x, centre[1] + y],
        };
        self.lines.iter().map(|line| Polyline::open(line.points.iter().map(place).collect::<Vec<_>>())).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_digit_fills_its_height_and_differs_from_the_others() {
        let digits: Vec<_> = ('0'..='9').map(|digit| Lettering::new(&digit.to_string(), 12.0)).collect();
        for (index, digit) in digits.iter().enumerate() {
            let heights = digit.lines.iter().flat_map(|line| &line.points).map(|point| point[1]);
            let (low, high) = heights.fold((0.0_f64, 0.0_f64), |(low, high), y| (low.min(y), high.max(y)));
            assert!((low + 6.0).abs() < 1e-9 && (high - 6.0).abs() < 1e-9, "{index}: {low} to {high}");
            assert!(digits[..index].iter().all(|other| other.lines != digit.lines), "{index}");
        }
    }

    #[test]
    fn words_are_all_small_capitals_and_units_small_letters() {
        assert_eq!(glyph('m', true).0, 5.0);
        assert_eq!(glyph('m', false), {
            let (width, lines) = glyph('M', false);
            let smaller = |line: Vec<[f64; 2]>| line.into_iter().map(|p| p.map(|c| c * SMALL)).collect();
            (width * SMALL, lines.into_iter().map(smaller).collect())
        });
        assert_eq!(letters_around("y: 12 mm of many", 6), 2);
        assert_eq!(letters_around("y: 12 mm of many", 12), 4);
        assert_eq!(letters_around("y: 12 mm of many", 0), 1);
    }

    #[test]
    fn text_is_centred() {
        let text = Lettering::new("20 mm", 9.0);
        let points: Vec<Point> = text.centred_at([100.0, 50.0]).into_iter().flat_map(|line| line.points).collect();
        let left = points.iter().map(|p| p[0]).fold(f64::INFINITY, f64::min);
        let right = points.iter().map(|p| p[0]).fold(f64::NEG_INFINITY, f64::max);
        assert!((left + right - 200.0).abs() < 1e-9, "{left} {right}");
        assert!((right - left - text.width).abs() < 1e-9);
    }
}
