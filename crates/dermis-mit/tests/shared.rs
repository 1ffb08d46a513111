//! Reference values of magnetic induction (`tests/data/oracle/mit`).

use dermis_mit::Complex;
use serde_json::Value;

/// A file of reference values.
pub fn reference(name: &str) -> Value {
    serde_json::from_str(&dermis_testdata::oracle_text(&format!("mit/{name}"))).expect("reference values are JSON")
}

/// A number in the file.
pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A complex number, stored as its two parts.
pub fn complex(value: &Value) -> Complex {
    Complex::new(number(&value[0]), number(&value[1]))
}

/// Difference of two numbers relative to the second.
pub fn relative(found: Complex, expected: Complex) -> f64 {
    (found - expected).norm() / expected.norm()
}
