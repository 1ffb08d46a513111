//! Formats the numbers of a table.

use dermis_lab::experiments::Row;

/// The paper's value, the value here and their ratio, as text.
pub(super) fn cells(row: &Row) -> [String; 3] {
    let ratio = row.paper.filter(|paper| *paper != 0.0).map(|paper| format!("{:.2}", row.here / paper));
    [row.paper.map(number).unwrap_or_default(), number(row.here), ratio.unwrap_or_default()]
}

/// Four significant digits.
fn number(value: f64) -> String {
    if value == 0.0 || !value.is_finite() {
        return format!("{value}");
    }
    let digits = 3 - value.abs().log10().floor() as i32;
    if !(-3..=7).contains(&digits) {
        return format!("{value:.3e}");
    }
    let text = format!("{value:.*}", digits.max(0) as usize);
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_string() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_four_digits() {
        let texts = [0.0, 6.0, 0.123456, 2.51, 16.92, 1.19e-4, 56789.0, f64::NAN].map(number);
        assert_eq!(texts, ["0", "6", "0.1235", "2.51", "16.92", "0.000119", "56789", "NaN"].map(String::from));
    }
}
