//! Pictures as single-page PDF: paths, and text that can be searched and copied, set in the bundled font, which is
//! embedded. A pixel is three quarters of a point, as on the web.

use std::collections::BTreeMap;

use miniz_oxide::deflate::compress_to_vec_zlib;
use pdf_writer::types::{
    CidFontType, FontFlags, LineCapStyle, LineJoinStyle, SystemInfo, TextRenderingMode, UnicodeCmap,
};
use pdf_writer::{Content, Filter, Finish, Name, Pdf, Rect, Ref, Str, TextStr};

use super::picture::{Colour, Item, Picture, Shape, Text, WHITE};
use super::text;

/// Points per pixel.
const POINTS: f32 = 0.75;
const CATALOG: Ref = Ref::new(1);
const PAGES: Ref = Ref::new(2);
const PAGE: Ref = Ref::new(3);
const CONTENT: Ref = Ref::new(4);
const FONT: Ref = Ref::new(5);
const CID_FONT: Ref = Ref::new(6);
const DESCRIPTOR: Ref = Ref::new(7);
const CHARACTERS: Ref = Ref::new(8);
const FONT_FILE: Ref = Ref::new(9);
const INFO: Ref = Ref::new(10);
const FONT_NAME: Name = Name(b"DejaVuSans");
const SYSTEM: SystemInfo = SystemInfo { registry: Str(b"Adobe"), ordering: Str(b"Identity"), supplement: 0 };
/// Compression level, out of 10.
const LEVEL: u8 = 7;

/// The picture as the content of a PDF file.
pub fn pdf(picture: &Picture) -> Vec<u8> {
    let (width, height) = (picture.width_px as f32, picture.height_px as f32);
    let mut file = Pdf::new();
    file.catalog(CATALOG).pages(PAGES);
    file.pages(PAGES).kids([PAGE]).count(1);
    file.document_info(INFO).title(TextStr(&picture.title)).creator(TextStr("dermis"));
    let mut page = file.page(PAGE);
    page.parent(PAGES).media_box(Rect::new(0.0, 0.0, POINTS * width, POINTS * height)).contents(CONTENT);
    page.resources().fonts().pair(Name(b"F"), FONT);
    page.finish();
    let mut content = Content::new();
    // From here on the units are pixels, with y down as in the picture.
    content.transform([POINTS, 0.0, 0.0, -POINTS, 0.0, POINTS * height]);
    content.set_line_cap(LineCapStyle::RoundCap).set_line_join(LineJoinStyle::RoundJoin);
    for item in &picture.items {
        match item {
            Item::Shape(shape) => draw_shape(&mut content, shape),
            Item::Text(words) => draw_text(&mut content, words),
        }
    }
    let packed = compress_to_vec_zlib(&content.finish(), LEVEL);
    file.stream(CONTENT, &packed).filter(Filter::FlateDecode);
    write_font(&mut file, picture);
    file.finish()
}

fn draw_shape(content: &mut Content, shape: &Shape) {
    if shape.lines.iter().all(|line| line.points.is_empty()) {
        return;
    }
    if let Some(colour) = shape.fill {
        fill_in(content, colour);
    }
    if let Some(stroke) = shape.stroke {
        stroke_in(content, stroke.colour, stroke.width);
    }
    for line in &shape.lines {
        for (index, [x, y]) in line.points.iter().enumerate() {
            let (x, y) = (rounded(*x), rounded(*y));
            let _ = if index == 0 { content.move_to(x, y) } else { content.line_to(x, y) };
        }
        if line.closed {
            content.close_path();
        }
    }
    match (shape.fill, shape.stroke) {
        (Some(_), Some(_)) => content.fill_nonzero_and_stroke(),
        (Some(_), None) => content.fill_nonzero(),
        (None, Some(_)) => content.stroke(),
        (None, None) => content.end_path(),
    };
}

fn draw_text(content: &mut Content, words: &Text) {
    let [x, y] = words.origin().map(rounded);
    let glyphs: Vec<u8> = words.words.chars().flat_map(|character| text::glyph(character).0.to_be_bytes()).collect();
    content.begin_text().set_font(Name(b"F"), words.size as f32);
    // Glyphs are drawn with y up.
    content.set_text_matrix(if words.upward { [0.0, -1.0, -1.0, 0.0, x, y] } else { [1.0, 0.0, 0.0, -1.0, x, y] });
    if words.halo > 0.0 {
        stroke_in(content, WHITE, 2.0 * words.halo);
        content.set_text_rendering_mode(TextRenderingMode::Stroke).show(Str(&glyphs));
        content.set_text_matrix(if words.upward { [0.0, -1.0, -1.0, 0.0, x, y] } else { [1.0, 0.0, 0.0, -1.0, x, y] });
    }
    fill_in(content, words.colour);
    content.set_text_rendering_mode(TextRenderingMode::Fill).show(Str(&glyphs)).end_text();
}

/// Writes the font, with widths and characters of the glyphs used in the picture.
fn write_font(file: &mut Pdf, picture: &Picture) {
    let mut used = BTreeMap::new();
    for item in &picture.items {
        if let Item::Text(words) = item {
            used.extend(words.words.chars().map(|character| (text::glyph(character).0, character)));
        }
    }
    file.type0_font(FONT)
        .base_font(FONT_NAME)
        .encoding_predefined(Name(b"Identity-H"))
        .descendant_font(CID_FONT)
        .to_unicode(CHARACTERS);
    let mut font = file.cid_font(CID_FONT);
    font.subtype(CidFontType::Type2).base_font(FONT_NAME).system_info(SYSTEM).font_descriptor(DESCRIPTOR);
    font.cid_to_gid_map_predefined(Name(b"Identity"));
    let mut widths = font.widths();
    for glyph in used.keys() {
        widths.consecutive(*glyph, [1e3 * text::advance(ttf_parser::GlyphId(*glyph)) as f32]);
    }
    widths.finish();
    font.finish();
    let face = text::face();
    let unit = 1e3 / f32::from(face.units_per_em());
    let bounds = face.global_bounding_box();
    let [left, bottom, right, top] =
        [bounds.x_min, bounds.y_min, bounds.x_max, bounds.y_max].map(|v| unit * f32::from(v));
    file.font_descriptor(DESCRIPTOR)
        .name(FONT_NAME)
        .flags(FontFlags::NON_SYMBOLIC)
        .bbox(Rect::new(left, bottom, right, top))
        .italic_angle(0.0)
        .ascent(unit * f32::from(face.ascender()))
        .descent(unit * f32::from(face.descender()))
        .cap_height(1e3 * text::CAPITAL as f32)
        .stem_v(90.0)
        .font_file2(FONT_FILE);
    let mut characters = UnicodeCmap::new(Name(b"Custom"), SYSTEM);
    used.iter().for_each(|(glyph, character)| characters.pair(*glyph, *character));
    file.stream(CHARACTERS, &characters.finish());
    let packed = compress_to_vec_zlib(text::FILE, LEVEL);
    let mut stream = file.stream(FONT_FILE, &packed);
    stream.filter(Filter::FlateDecode);
    stream.pair(Name(b"Length1"), text::FILE.len() as i32);
}

fn fill_in(content: &mut Content, colour: Colour) {
    let [red, green, blue] = shares(colour);
    content.set_fill_rgb(red, green, blue);
}

fn stroke_in(content: &mut Content, colour: Colour, width: f64) {
    let [red, green, blue] = shares(colour);
    content.set_stroke_rgb(red, green, blue).set_line_width(width as f32);
}

fn shares(Colour(red, green, blue): Colour) -> [f32; 3] {
    [red, green, blue].map(|value| rounded(f64::from(value) / 255.0 * 10.0) / 10.0)
}

/// Rounded to a hundredth of a pixel, which keeps files small.
fn rounded(value: f64) -> f32 {
    (100.0 * value).round() as f32 / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::picture::Polyline;

    #[test]
    fn a_picture_is_a_page_of_its_size_with_paths_and_words() {
        let words = Text { halo: 2.0, ..Text::new("5 µV", 10.0, [40.0, 20.0]) };
        let shape = Shape::filled("area", vec![Polyline::rectangle([1.0, 2.0], [3.0, 4.0])], Colour(255, 0, 0));
        let items = vec![shape.into(), words.into()];
        let file = pdf(&Picture { title: "a title".into(), width_px: 80, height_px: 40, items });
        let text = String::from_utf8_lossy(&file);
        assert!(text.starts_with("%PDF-") && text.contains("/MediaBox [0 0 60 30]"), "{text}");
        assert!(text.contains("(a title)") && text.contains("/FontFile2"), "{text}");
        // The character of each glyph, so that text can be copied. The micro sign is U+00B5.
        let glyph = text::glyph('µ').0;
        assert!(text.contains(&format!("<{glyph:04X}> <00B5>")), "{text}");
        let start = file.windows(7).position(|w| w == b"stream\n").unwrap() + 7;
        let content = miniz_oxide::inflate::decompress_to_vec_zlib(&file[start..]).unwrap();
        let content = String::from_utf8_lossy(&content);
        assert!(content.contains("1 2 m\n3 2 l\n3 4 l\n1 4 l\nh\nf"), "{content}");
        assert!(content.contains("/F 10 Tf"), "{content}");
    }
}
