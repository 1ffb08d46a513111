//! Reference values of magnetic induction, where they are at hand.

use std::path::PathBuf;

use dermis_mit::Complex;
use serde_json::Value;

/// A file of reference values; says so where it is missing.
pub fn reference(name: &str) -> Option<Value> {
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/oracle/mit").join(name);
    match std::fs::read_to_string(&path) {
        Ok(text) => Some(serde_json::from_str(&text).expect("reference values are JSON")),
        Err(_) => {
            println!("{} is not there: nothing compared", path.display());
            None
        }
    }
}

/// A number in it.
pub fn number(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

/// A complex number, written as its two parts.
pub fn complex(value: &Value) -> Complex {
    Complex::new(number(&value[0]), number(&value[1]))
}

/// Difference of two numbers over the second.
pub fn relative(found: Complex, expected: Complex) -> f64 {
    (found - expected).norm() / expected.norm()
}
