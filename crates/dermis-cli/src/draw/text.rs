//! The bundled font: its glyphs, text widths, and the outlines to fill in formats without fonts of their own. It
//! covers Latin, Greek and the signs needed for units and formulas.

use std::sync::LazyLock;

use ttf_parser::{Face, GlyphId};

/// The bundled font's name, followed by fallbacks for viewers without it.
pub const FAMILIES: &str = "DejaVu Sans, Verdana, Arial, sans-serif";
/// Height of a capital relative to the font size.
pub const CAPITAL: f64 = 0.729;
/// The font as a file.
pub const FILE: &[u8] = include_bytes!("../../fonts/DejaVuSans.ttf");

static FACE: LazyLock<Face<'static>> = LazyLock::new(|| Face::parse(FILE, 0).expect("the bundled font is a font"));

/// The font.
pub fn face() -> &'static Face<'static> {
    &FACE
}

/// The glyph of a character; an empty box if the font lacks it.
pub fn glyph(character: char) -> GlyphId {
    face().glyph_index(character).unwrap_or_default()
}

/// Advance width of a glyph relative to the font size.
pub fn advance(glyph: GlyphId) -> f64 {
    f64::from(face().glyph_hor_advance(glyph).unwrap_or_default()) / f64::from(face().units_per_em())
}

/// Width of a text at a font size, in the unit of the size.
pub fn width(text: &str, size: f64) -> f64 {
    size * text.chars().map(|character| advance(glyph(character))).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widths_are_those_of_the_font() {
        // DejaVu Sans has 2048 units per em: digits are 1303 wide, a blank 651.
        assert_eq!(width("00", 2048.0), 2606.0);
        assert_eq!(width(" ", 2048.0), 651.0);
        let capital = face().glyph_bounding_box(glyph('H')).unwrap();
        assert_eq!([capital.y_min, capital.y_max], [0, (CAPITAL * 2048.0).round() as i16]);
    }

    #[test]
    fn the_font_has_every_sign_that_units_and_formulas_need() {
        let signs = "azAZ09 äéßñ µΩαβσΔ ×·±−≤≥≈ ⁰¹²³⁻⁴ ₀₁₂ °%‰ –—“”‘’… ∂∞√ →";
        let missing: String = signs.chars().filter(|character| glyph(*character).0 == 0).collect();
        assert_eq!(missing, "");
        assert_eq!(glyph('\u{4e00}').0, 0);
    }
}
