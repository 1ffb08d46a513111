//! Rows of the tables: what was measured, under which conditions, and the figures of dermis, of a plain method and
//! from the literature.

use std::fmt;

use serde::Serialize;

/// A number with its name and unit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Figure {
    /// Name, as in "median".
    pub name: String,
    /// The value, or its mean over several draws.
    pub value: f64,
    /// Its unit; "of 500" for a count; empty for a ratio.
    pub unit: String,
    /// Smallest and largest over several draws.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[f64; 2]>,
}

impl Figure {
    /// A single number.
    pub fn new(name: &str, value: f64, unit: &str) -> Self {
        Self { name: name.into(), value, unit: unit.into(), range: None }
    }

    /// A count out of a total.
    pub fn count(name: &str, count: usize, all: usize) -> Self {
        Self::new(name, count as f64, &format!("of {all}"))
    }

    /// The mean over draws, with the smallest and the largest; NaN without draws.
    pub fn over(name: &str, values: &[f64], unit: &str) -> Self {
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let range = (values.len() > 1).then_some([low, high]);
        Self { range, ..Self::new(name, mean, unit) }
    }

    fn number(&self, value: f64) -> String {
        let digits = match self.unit.as_str() {
            "mm" if value.abs() < 10.0 => 2,
            "mm" | "deg" => 1,
            "1e-4 T" => 2,
            "" => 3,
            "s" => 1,
            _ => 0,
        };
        if value.is_finite() { format!("{value:.digits$}") } else { "none".into() }
    }
}

impl fmt::Display for Figure {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{} {}", self.name, self.number(self.value))?;
        if !self.unit.is_empty() {
            write!(out, " {}", self.unit)?;
        }
        match self.range {
            Some([low, high]) => write!(out, " ({} to {})", self.number(low), self.number(high)),
            None => Ok(()),
        }
    }
}

/// A result to compare the figures of dermis with.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// The method, or its authors.
    pub what: String,
    /// Figures computed in the same run.
    pub figures: Vec<Figure>,
}

impl Comparison {
    /// A comparison in words only: a citation, or a statement that there is none.
    pub fn said(what: &str) -> Self {
        Self { what: what.into(), figures: Vec::new() }
    }

    /// A method and its figures in this run.
    pub fn computed(what: &str, figures: Vec<Figure>) -> Self {
        Self { what: what.into(), figures }
    }

    /// Text for a table cell.
    pub fn text(&self) -> String {
        if self.figures.is_empty() { self.what.clone() } else { format!("{}: {}", self.what, joined(&self.figures)) }
    }
}

/// One row: a measurement and the results on it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The measurement.
    pub measured: String,
    /// Information that dermis was given, or assumed.
    pub known: String,
    /// Figures of dermis.
    pub here: Vec<Figure>,
    /// A plain method on the same data.
    pub plain: Comparison,
    /// The best published result on these data.
    pub published: Comparison,
    /// Computing time including the plain method, seconds.
    pub seconds: f64,
}

impl Finding {
    /// The figures of dermis as text for a table cell.
    pub fn here_text(&self) -> String {
        joined(&self.here)
    }

    /// The figure with this name, if there is one.
    pub fn figure(&self, name: &str) -> Option<f64> {
        self.here.iter().find(|figure| figure.name == name).map(|figure| figure.value)
    }
}

fn joined(figures: &[Figure]) -> String {
    figures.iter().map(Figure::to_string).collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_as_sentences_do() {
        assert_eq!(Figure::over("median", &[1.0, 1.5], "mm").to_string(), "median 1.25 mm (1.00 to 1.50)");
        assert_eq!(Figure::over("median", &[12.34], "mm").to_string(), "median 12.3 mm");
        assert_eq!(Figure::count("found", 498, 500).to_string(), "found 498 of 500");
        assert_eq!(Figure::new("score", 0.9244, "").to_string(), "score 0.924");
        assert_eq!(Figure::over("median", &[], "mm").to_string(), "median none mm");
        let row = Comparison::computed("ridge", vec![Figure::new("rms", 1.3, "1e-4 T")]);
        assert_eq!(row.text(), "ridge: rms 1.30 1e-4 T");
        assert_eq!(Comparison::said("none").text(), "none");
    }
}
