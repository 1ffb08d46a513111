//! Compares skins on equal terms: one instrument, and the same frame time for each. The time per reading is then
//! inversely proportional to the number of readings, and the noise power of a reading is proportional to that number,
//! so extra electrodes come at a price. All bounds scale with the noise alike, so the ranking doesn't depend on the
//! assumed noise.

use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;

use super::maps::{Noise, Summary};
use crate::Error;

/// Bounds within this share of each other count as equal; meshes alone cause such differences.
const EQUAL: f64 = 0.1;

/// One instrument shared by several skins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SharedInstrument {
    /// Noise of one reading at [`Self::readings`] per frame.
    pub noise: Noise,
    /// Readings per frame at which that noise holds.
    pub readings: usize,
}

impl SharedInstrument {
    /// The instrument of a skin, with the given [`Noise`]. The skin file's assumption becomes volts, the same for
    /// every channel.
    ///
    /// # Errors
    /// The skin's model has no voltages.
    pub fn of(prepared: &Prepared, noise: Noise) -> Result<Self, Error> {
        let noise = match noise {
            Noise::Assumed => {
                let reference = Reference::from_baseline(prepared, &prepared.voltages, None)?;
                Noise::Volts(reference.noise.iter().copied().fold(0.0, f64::max))
            }
            stated => stated,
        };
        Ok(Self { noise, readings: prepared.channels() })
    }

    /// The instrument's noise on another skin, at the same frame time.
    pub fn noise_of(&self, prepared: &Prepared) -> Noise {
        let longer = prepared.channels() as f64 / self.readings as f64;
        match self.noise {
            Noise::Volts(volts) => Noise::Volts(volts * longer.sqrt()),
            Noise::Decibels(db) => Noise::Decibels(db - 10.0 * longer.log10()),
            Noise::Assumed => Noise::Assumed,
        }
    }
}

/// Says in a sentence which skin places touches best, judged by the position bound at the worst place, and whether
/// the median place agrees. `None` for fewer than two skins.
pub fn verdict(skins: &[(&str, Summary)]) -> Option<String> {
    let best_by = |of: fn(&Summary) -> f64| skins.iter().min_by(|a, b| of(&a.1).total_cmp(&of(&b.1)));
    let (name, best) = best_by(|summary| summary.worst).filter(|_| skins.len() > 1)?;
    let mut others: Vec<&(&str, Summary)> = skins.iter().filter(|(other, _)| other != name).collect();
    others.sort_by(|a, b| a.1.worst.total_cmp(&b.1.worst));
    let next = others.first()?;
    let millimetres = 1e3 * best.worst;
    if next.1.worst < (1.0 + EQUAL) * best.worst {
        let equal: Vec<&str> =
            others.iter().filter(|other| other.1.worst < (1.0 + EQUAL) * best.worst).map(|other| other.0).collect();
        return Some(format!(
            "{name} and {} place touches equally well at their worst places, to {millimetres:.3} mm within 10 %",
            equal.join(", ")
        ));
    }
    let times: Vec<String> = others
        .iter()
        .map(|(other, summary)| format!("{:.1} times better than {other}", summary.worst / best.worst))
        .collect();
    let (at_median, median) = best_by(|summary| summary.median)?;
    let agrees = if at_median == name || best.median < (1.0 + EQUAL) * median.median {
        "; at the median place too".to_string()
    } else {
        format!("; at the median place {at_median} is better")
    };
    Some(format!("{name} places touches best: to {millimetres:.3} mm at its worst place, {}{agrees}", times.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn summary(worst: f64, median: f64) -> Summary {
        Summary { worst, median, best: median }
    }

    #[test]
    fn verdicts_name_the_best_if_there_is_one() {
        assert_eq!(verdict(&[("a", summary(1e-3, 1e-3))]), None);
        let text = verdict(&[("a", summary(2e-3, 1e-3)), ("b", summary(1e-3, 0.5e-3)), ("c", summary(3e-3, 2e-3))]);
        let said = "b places touches best: to 1.000 mm at its worst place, 2.0 times better than a, 3.0 times better than c; \
                    at the median place too";
        assert_eq!(text.as_deref(), Some(said));
        let text = verdict(&[("a", summary(2e-3, 0.5e-3)), ("b", summary(1e-3, 1e-3))]).unwrap();
        assert!(text.ends_with("; at the median place a is better"), "{text}");
        let text = verdict(&[("a", summary(1.05e-3, 1e-3)), ("b", summary(1e-3, 1e-3))]).unwrap();
        assert!(text.starts_with("b and a place touches equally well"), "{text}");
    }
}
