//! Ranges of the numbers in a skin file. Every error names the file, the key, the value and the expected range.

use crate::error::Error;

/// Metres in a millimetre.
pub(crate) const MM: f64 = 1e-3;
/// Maximum length in a skin file, millimetres: ten metres.
pub(crate) const MOST_MM: f64 = 1e4;
/// Minimum length, millimetres: one micrometre.
pub(crate) const LEAST_MM: f64 = 1e-3;

/// The file being checked, to name it in errors.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Checker<'a> {
    pub file: &'a str,
}

impl Checker<'_> {
    /// An error about one key.
    pub fn refused(&self, field: &str, value: impl ToString, expected: impl Into<String>) -> Error {
        Error::SkinField {
            file: self.file.to_string(),
            field: field.to_string(),
            value: value.to_string(),
            expected: expected.into(),
        }
    }

    /// Checks that a number is within a range, ends included.
    pub fn within(&self, field: &str, value: f64, low: f64, high: f64) -> Result<(), Error> {
        if value >= low && value <= high {
            return Ok(());
        }
        Err(self.refused(field, value, format!("{} to {}", number(low), number(high))))
    }

    /// Checks a length in millimetres.
    pub fn length_mm(&self, field: &str, value: f64) -> Result<(), Error> {
        self.within(field, value, LEAST_MM, MOST_MM)
    }

    /// Checks coordinates in millimetres.
    pub fn place_mm(&self, field: &str, value: &[f64]) -> Result<(), Error> {
        value.iter().try_for_each(|&v| self.within(field, v, -MOST_MM, MOST_MM))
    }

    /// Checks that a whole number is within a range, ends included.
    pub fn count(&self, field: &str, value: usize, low: usize, high: usize) -> Result<(), Error> {
        if (low..=high).contains(&value) {
            return Ok(());
        }
        Err(self.refused(field, value, format!("{low} to {high}")))
    }
}

fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) { format!("{value:e}") } else { value.to_string() }
}

#[cfg(test)]
mod tests {
    use toml::{Table, Value};

    use crate::budget::Budget;
    use crate::{BUILTIN_NAMES, Skin};

    /// Values that people and programs write, by mistake or on purpose.
    fn hostile() -> Vec<Value> {
        let floats = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 0.0, -0.0, 1e-300, 1e300];
        let whole = [-1, 0, i64::MAX, i64::MIN];
        let texts = [String::new(), "x".repeat(5_000), "\u{1b}[31m".to_owned()];
        let others = [Value::Boolean(true), Value::Array(Vec::new()), Value::Table(Table::new())];
        let numbers = floats.map(Value::Float).into_iter().chain(whole.map(Value::Integer));
        numbers.chain(texts.map(Value::String)).chain(others).collect()
    }

    /// Builds a skin file with one value replaced.
    type Build<'a> = dyn Fn(Value) -> Value + 'a;

    /// Visits every value of the file, with its key and a function that replaces it.
    fn with_each(value: &Value, key: &str, put: &mut dyn FnMut(&str, &Build<'_>)) {
        put(key, &|new| new);
        match value {
            Value::Table(table) => {
                for (name, inner) in table {
                    with_each(inner, &format!("{key}.{name}"), &mut |key, build| {
                        put(key, &|new| {
                            let mut changed = table.clone();
                            changed.insert(name.clone(), build(new));
                            Value::Table(changed)
                        });
                    });
                }
            }
            Value::Array(list) => {
                // Test only the first and the last entry.
                let ends = [0, list.len().saturating_sub(1)];
                for index in ends.into_iter().take(list.len().min(2)) {
                    with_each(&list[index], key, &mut |key, build| {
                        put(key, &|new| {
                            let mut changed = list.clone();
                            changed[index] = build(new);
                            Value::Array(changed)
                        });
                    });
                }
            }
            _ => {}
        }
    }

    #[test]
    fn any_value_of_a_key_is_refused_by_name_or_makes_a_skin() {
        let (mut refused, mut named, mut taken) = (0, 0, 0);
        let mut seen = std::collections::BTreeSet::new();
        for name in BUILTIN_NAMES {
            let text = Skin::open(name).unwrap().to_toml();
            let whole: Value = Value::Table(text.parse().unwrap());
            with_each(&whole, "", &mut |path, build| {
                // Skip keys already seen in another skin.
                if !seen.insert(path.to_owned()) {
                    return;
                }
                let key = path.rsplit('.').next().unwrap_or_default();
                for value in hostile() {
                    let Ok(text) = toml::to_string(&build(value.clone())) else { continue };
                    match Skin::parse(&text, "hostile.toml") {
                        Ok(skin) => {
                            taken += 1;
                            let budget = Budget::of_imaging(&skin);
                            assert!(budget.bytes.is_finite() && budget.seconds.is_finite(), "{path} = {value}");
                        }
                        Err(error) => {
                            let message = error.to_string();
                            assert!(message.starts_with("hostile.toml: "), "{path} = {value}: {message}");
                            refused += 1;
                            // A value may clash with another key, which is then the one named.
                            named += u32::from(message.contains(key));
                        }
                    }
                }
            });
        }
        assert!(refused > 1_000 && taken > 100, "{refused} refused, {taken} taken");
        // Nine in ten name the key; the rest name another key, or the list that the entry is in.
        assert!(f64::from(named) > 0.85 * f64::from(refused), "{named} of {refused} refusals name the key");
    }
}
