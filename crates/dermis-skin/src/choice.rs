//! Priors and rules for lambda as written on a command line: `laplace`, `noser=0.5`, `0.02`, `noise-figure=0.5`, or
//! the value as it would appear in a skin file.

use std::str::FromStr;

use serde::Deserialize;
use serde::de::DeserializeOwned;

use crate::check::Checker;
use crate::error::Error;
use crate::imaging::{HyperparameterChoice, PriorChoice};

#[derive(Deserialize)]
struct Written<T> {
    value: T,
}

/// Parses `text` as a TOML value, as a bare word, or as `key=value`.
fn written<T: DeserializeOwned>(text: &str) -> Option<T> {
    let text = text.trim();
    let forms = [format!("value = {text}"), format!("value = \"{text}\""), format!("value = {{ {text} }}")];
    forms.iter().find_map(|form| toml::from_str::<Written<T>>(form).ok()).map(|written| written.value)
}

fn refused(field: &'static str, text: &str, expected: &str) -> Error {
    Error::SkinField { file: "command line".into(), field: field.into(), value: text.into(), expected: expected.into() }
}

impl FromStr for PriorChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let expected = "identity, laplace, noser=EXPONENT, gaussian-mm=LENGTH, or a value as in a skin file";
        let prior: Self = written(text).ok_or_else(|| refused("imaging.prior", text, expected))?;
        prior.check(0, &Checker { file: "prior" })?;
        Ok(prior)
    }
}

impl FromStr for HyperparameterChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let number = text.trim().parse().ok().map(HyperparameterChoice::Number);
        let expected = "a number, relative=FACTOR, noise-figure=TARGET, or a value as in a skin file";
        number.or_else(|| written(text)).ok_or_else(|| refused("imaging.hyperparameter", text, expected))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_pairs_numbers_and_tables_are_understood() {
        assert_eq!("laplace".parse::<PriorChoice>().unwrap(), PriorChoice::Laplace);
        assert_eq!("noser=0.5".parse::<PriorChoice>().unwrap(), PriorChoice::Noser(0.5));
        assert_eq!("{ gaussian-mm = 4.0 }".parse::<PriorChoice>().unwrap(), PriorChoice::GaussianMm(4.0));
        assert_eq!("1e-3".parse::<HyperparameterChoice>().unwrap(), HyperparameterChoice::Number(1e-3));
        assert_eq!("gcv".parse::<HyperparameterChoice>().unwrap(), HyperparameterChoice::Gcv);
        let figure = "noise-figure=0.5".parse::<HyperparameterChoice>().unwrap();
        assert_eq!(figure, HyperparameterChoice::NoiseFigure(0.5));
    }

    #[test]
    fn unknown_input_is_named() {
        let message = "smooth".parse::<PriorChoice>().unwrap_err().to_string();
        assert!(message.contains("smooth") && message.contains("laplace"), "{message}");
        assert!("\"\nvalue = 3".parse::<HyperparameterChoice>().is_err());
    }
}
