//! One cell of a text table: a number, a missing reading, a complex reading, or neither.

/// Mark between integer and fractional part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::instruments) enum Decimal {
    Point,
    Comma,
}

impl Decimal {
    pub(in crate::instruments) fn mark(self) -> u8 {
        match self {
            Self::Point => b'.',
            Self::Comma => b',',
        }
    }

    fn expected(self) -> &'static str {
        match self {
            Self::Point => "a number with a decimal point, nan or nothing",
            Self::Comma => "a number with a decimal comma as in the rest of the file, nan or nothing",
        }
    }
}

/// Words that spreadsheets and loggers write for a missing reading.
const MISSING: [&str; 9] = ["", "nan", "na", "n/a", "#n/a", "null", "none", "-", "--"];

/// Powers of ten that a double holds exactly.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18, 1e19, 1e20,
    1e21, 1e22,
];

/// Largest mantissa that a double holds exactly.
const EXACT: u64 = 1 << 53;

/// The number at the start of `bytes`, and its length in bytes. The value is the double nearest to the decimal number.
/// If mantissa and power of ten are both exact, a single product or quotient gives it (Clinger 1990). Other numbers go
/// through the standard library.
#[inline]
pub(in crate::instruments) fn leading_number(bytes: &[u8], mark: u8) -> Option<(f64, usize)> {
    let is_negative = bytes.first() == Some(&b'-');
    let mut at = usize::from(is_negative || bytes.first() == Some(&b'+'));
    let begin = at;
    let (mut mantissa, mut power, mut digits) = (0_u64, 0_i32, 0_usize);
    while let Some(digit) = bytes.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
        mantissa = mantissa.wrapping_mul(10).wrapping_add(digit.into());
        digits += 1;
        at += 1;
    }
    if bytes.get(at) == Some(&mark) {
        at += 1;
        let fraction = at;
        while let Some(digit) = bytes.get(at).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(digit.into());
            digits += 1;
            at += 1;
        }
        power -= (at - fraction) as i32;
        // "1," is a number followed by a separator.
        if mark == b',' && at == fraction {
            at -= 1;
        }
    }
    if digits == 0 {
        return None;
    }
    let mut is_plain = digits <= 19;
    if let Some(b'e' | b'E') = bytes.get(at) {
        let sign = usize::from(matches!(bytes.get(at + 1), Some(b'+' | b'-')));
        let (mut end, mut exponent) = (at + 1 + sign, 0_i32);
        let first = end;
        while let Some(digit) = bytes.get(end).map(|byte| byte.wrapping_sub(b'0')).filter(|digit| *digit < 10) {
            exponent = exponent.saturating_mul(10).saturating_add(digit.into());
            end += 1;
        }
        if end > first {
            let exponent = if bytes.get(at + 1) == Some(&b'-') { -exponent } else { exponent };
            power = power.saturating_add(exponent);
            at = end;
        }
    }
    is_plain &= mantissa <= EXACT && power.unsigned_abs() < POWERS.len() as u32;
    if is_plain {
        let scale = POWERS[power.unsigned_abs() as usize];
        let value = if power < 0 { mantissa as f64 / scale } else { mantissa as f64 * scale };
        return Some((if is_negative { -value } else { value }, at));
    }
    let text: String = bytes[begin..at].iter().map(|byte| if *byte == mark { '.' } else { *byte as char }).collect();
    let value: f64 = text.parse().ok()?;
    Some((if is_negative { -value } else { value }, at))
}

/// A cell's value, NaN for a missing reading. The error says what was expected.
pub(in crate::instruments) fn number(cell: &str, decimal: Decimal) -> Result<f64, &'static str> {
    match leading_number(cell.as_bytes(), decimal.mark()) {
        Some((value, length)) if length == cell.len() => {
            return if value.is_infinite() { Err("a finite number or nan") } else { Ok(value) };
        }
        _ => {}
    }
    if MISSING.iter().any(|word| cell.eq_ignore_ascii_case(word)) {
        return Ok(f64::NAN);
    }
    // Typographic minus sign.
    if let Some(rest) = cell.strip_prefix('\u{2212}') {
        return number(rest, decimal).map(|value| -value);
    }
    match cell.parse::<f64>() {
        Ok(value) if value.is_nan() => Ok(value),
        Ok(_) if decimal == Decimal::Point => Err("a finite number or nan"),
        _ => Err(decimal.expected()),
    }
}

/// Both parts of a complex cell: `a+bj` or `bj`, with `i` or `j`, with or without parentheses. A part may be `nan`.
pub(in crate::instruments) fn complex(cell: &str) -> Option<[f64; 2]> {
    let bare = cell.strip_prefix('(').and_then(|cell| cell.strip_suffix(')')).unwrap_or(cell);
    let body = bare.strip_suffix(['j', 'i', 'J', 'I'])?;
    // The last sign that doesn't belong to an exponent.
    let mut signs = body.char_indices().filter(|(at, c)| "+-".contains(*c) && !body[..*at].ends_with(['e', 'E']));
    let (real, imaginary) = body.split_at(signs.next_back().map_or(0, |(at, _)| at));
    // NumPy writes `1+-2j`.
    let real = real.strip_suffix('+').unwrap_or(real);
    let finite = |part: &str| part.trim().parse::<f64>().ok().filter(|value| !value.is_infinite());
    Some([if real.is_empty() { 0.0 } else { finite(real)? }, finite(imaginary)?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn numbers_agree_with_the_standard_library(value in any::<f64>().prop_filter("finite", |v| v.is_finite()), places in 0_usize..20) {
            for text in [format!("{value}"), format!("{value:e}"), format!("{value:.places$e}"), format!("{:.places$}", value % 1e6)] {
                let expected: f64 = text.parse().unwrap();
                prop_assert_eq!(leading_number(text.as_bytes(), b'.'), Some((expected, text.len())), "{}", &text);
                prop_assert_eq!(number(&text.replace('.', ","), Decimal::Comma), Ok(expected));
            }
        }
    }

    #[test]
    fn leading_numbers_end_at_the_right_character() {
        for (text, mark, expected) in [
            ("1,2", b'.', Some((1.0, 1))),
            ("1,2", b',', Some((1.2, 3))),
            ("1, 2", b',', Some((1.0, 1))),
            ("-.5e", b'.', Some((-0.5, 3))),
            ("5.", b'.', Some((5.0, 2))),
            ("e5", b'.', None),
            (".", b'.', None),
            ("-", b'.', None),
        ] {
            assert_eq!(leading_number(text.as_bytes(), mark), expected, "{text}");
        }
    }
}
