//! Presses at known places: selects training and test pokes, and measures the error of the touches.

use std::path::Path;

use dermis_device::{FileSpec, FrameItem, FrameSelect};
use dermis_live::calibrate::calibrate;
use dermis_live::calibration::{Calibration, CalibrationOptions, PokeFrames, Pokes};
use dermis_live::channels::ChannelReader;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_tomo::mesh::{Point, distance};
use rand::SeedableRng;
use rand::rngs::StdRng;
use rand::seq::SliceRandom;

use super::finding::Figure;
use super::imaged::imaged;
use super::kernel_ridge::KernelRidge;
use crate::Error;

/// Presses of a skin at known places, stored in files.
#[derive(Clone, Debug)]
pub struct Presses {
    skin: Skin,
    /// Frames without touch, one for each press; `None` if the frames are differences.
    baseline: Option<FileSpec>,
    frames: FileSpec,
    /// Frames in the protocol's order; `before` is `None` if the frames are differences.
    before: Option<Vec<Vec<f64>>>,
    pressed: Vec<Vec<f64>>,
    pokes: Pokes,
}

/// Distances of touches from the presses that caused them.
#[derive(Clone, Debug, PartialEq)]
pub struct PlaceErrors {
    /// Number of presses judged.
    pub presses: usize,
    /// Touches in excess of one per press.
    pub extra: usize,
    /// Errors of the presses that were found, sorted, millimetres. If a press gave several touches, the strongest
    /// counts.
    pub errors_mm: Vec<f64>,
    /// Shares of the errors within one standard deviation, x and y.
    pub within: [f64; 2],
}

impl PlaceErrors {
    /// Quantile of the errors of the presses found, millimetres; NaN if none was found.
    pub fn quantile_mm(&self, share: f64) -> f64 {
        let last = self.errors_mm.len().saturating_sub(1);
        let at = ((self.errors_mm.len() as f64 * share) as usize).min(last);
        self.errors_mm.get(at).copied().unwrap_or(f64::NAN)
    }

    /// Figures over several draws.
    pub(super) fn figures(draws: &[Self]) -> Vec<Figure> {
        let over = |name: &str, unit: &str, of: &dyn Fn(&Self) -> f64| {
            Figure::over(name, &draws.iter().map(of).collect::<Vec<_>>(), unit)
        };
        let mut figures = Self::without_sigmas(draws);
        figures.push(over("within one sigma, x", "%", &|draw| 100.0 * draw.within[0]));
        figures.push(over("within one sigma, y", "%", &|draw| 100.0 * draw.within[1]));
        figures
    }

    /// Figures over several draws, for a method without standard deviations.
    pub(super) fn without_sigmas(draws: &[Self]) -> Vec<Figure> {
        let over =
            |name: &str, of: &dyn Fn(&Self) -> f64| Figure::over(name, &draws.iter().map(of).collect::<Vec<_>>(), "mm");
        let all: usize = draws.iter().map(|draw| draw.presses).sum();
        let (found, extra): (usize, usize) =
            draws.iter().fold((0, 0), |(found, extra), draw| (found + draw.errors_mm.len(), extra + draw.extra));
        let mut figures =
            vec![over("median", &|draw| draw.quantile_mm(0.5)), over("90th percentile", &|draw| draw.quantile_mm(0.9))];
        if found < all {
            figures.push(Figure::count("presses found", found, all));
        }
        if extra > 0 {
            figures.push(Figure::new("false touches", extra as f64, "in all"));
        }
        figures
    }
}

/// The presses in a random order. For this version, a seed gives the same order on every machine.
pub fn shuffled(count: usize, seed: u64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..count).collect();
    order.shuffle(&mut StdRng::seed_from_u64(seed));
    order
}

impl Presses {
    /// Reads the frames, the frames before them (`None` if the frames are differences), and the places of the
    /// presses.
    ///
    /// # Errors
    /// The files cannot be read, or don't fit the skin or each other.
    pub fn read(skin: Skin, before: Option<&Path>, pressed: &Path, places: &Path) -> Result<Self, Error> {
        let pokes = dermis_live::calibration::read_pokes(places)?;
        let prepared = Prepared::new(skin.clone())?;
        let rows = |path: &Path| -> Result<Vec<Vec<f64>>, Error> {
            let table = dermis_record::read_frames(&FileSpec::all(path), None)?;
            let reads = prepared.skin.backend.reads;
            let source = path.display().to_string();
            let rows = ChannelReader::new(table.layout(), &prepared.protocol, reads, &source)?.read_table(&table)?;
            if rows.len() == pokes.positions_m.len() {
                return Ok(rows);
            }
            let expected = format!("{} as in {}", pokes.positions_m.len(), places.display());
            Err(Error::Live(dermis_live::Error::Frames {
                what: format!("frames of {source}"),
                expected,
                got: rows.len().to_string(),
            }))
        };
        let (before_rows, pressed_rows) = (before.map(rows).transpose()?, rows(pressed)?);
        let (baseline, frames) = (before.map(FileSpec::all), FileSpec::all(pressed));
        Ok(Self { skin, baseline, frames, before: before_rows, pressed: pressed_rows, pokes })
    }

    /// Number of presses.
    pub fn count(&self) -> usize {
        self.pressed.len()
    }

    /// The same presses with another description of the skin.
    pub fn with_skin(&self, skin: Skin) -> Self {
        Self { skin, ..self.clone() }
    }

    /// Does what `dermis calibrate` does, on the presses in these rows.
    ///
    /// # Errors
    /// As for [`calibrate`].
    pub fn calibrate(&self, rows: &[usize]) -> Result<Calibration, Error> {
        self.calibrate_from(rows, &[])
    }

    /// Does what `dermis calibrate --start` does: starts from calibrations of sister skins.
    ///
    /// # Errors
    /// As for [`calibrate`].
    pub fn calibrate_from(&self, rows: &[usize], start: &[Calibration]) -> Result<Calibration, Error> {
        let prepared = Prepared::new(self.skin.clone())?;
        let pick = |all: &[Vec<f64>]| rows.iter().map(|&row| all[row].clone()).collect::<Vec<_>>();
        let loads = self.pokes.loads.as_ref();
        let pokes = Pokes {
            positions_m: rows.iter().map(|&row| self.pokes.positions_m[row]).collect(),
            further_m: Vec::new(),
            loads: loads.map(|(quantity, loads)| (*quantity, rows.iter().map(|&row| loads[row]).collect())),
        };
        let frames = pick(&self.pressed);
        let options = CalibrationOptions { start, ..CalibrationOptions::default() };
        Ok(match &self.before {
            Some(before) => {
                let measured = PokeFrames::Readings { baselines: &pick(before), frames: &frames };
                calibrate(&prepared, measured, &pokes, &options)?
            }
            None => calibrate(&prepared, PokeFrames::Differences(&frames), &pokes, &options)?,
        })
    }

    /// Does what `dermis reconstruct` does on these rows, and compares the touches with the presses.
    ///
    /// # Errors
    /// As for [`crate::reconstruct::reconstruct`].
    pub fn judge(&self, rows: &[usize], calibration: Option<&Calibration>) -> Result<PlaceErrors, Error> {
        let select =
            FrameSelect::Listed(rows.iter().map(|&row| FrameItem::Range { first: row, end: Some(row + 1) }).collect());
        let of_rows = |file: &FileSpec| FileSpec { path: file.path.clone(), select: select.clone() };
        let found = imaged(self.skin.clone(), self.baseline.as_ref().map(of_rows), of_rows(&self.frames), calibration)?;
        let (mut errors_mm, mut within, mut extra) = (Vec::new(), [0.0; 2], 0);
        for (frame, &row) in rows.iter().enumerate() {
            let touches = found.touches.iter().filter(|touch| touch.frame == frame);
            let strongest = touches.clone().max_by(|a, b| a.amplitude.total_cmp(&b.amplitude));
            let Some(touch) = strongest else { continue };
            extra += touches.count() - 1;
            let offset = [0, 1].map(|axis| touch.at_mm[axis] - 1e3 * self.pokes.positions_m[row][axis]);
            errors_mm.push(offset[0].hypot(offset[1]));
            for axis in 0..2 {
                within[axis] += f64::from(u8::from(offset[axis].abs() <= touch.sigma_mm[axis]));
            }
        }
        errors_mm.sort_by(f64::total_cmp);
        let count = errors_mm.len().max(1) as f64;
        Ok(PlaceErrors { presses: rows.len(), extra, errors_mm, within: within.map(|sum| sum / count) })
    }

    /// Kernel ridge regression trained on some rows and judged on others; empty if it cannot be fitted.
    pub fn judge_plain(&self, taught: &[usize], rows: &[usize]) -> PlaceErrors {
        let changes = self.changes();
        let views: Vec<&[f64]> = taught.iter().map(|&row| changes[row].as_slice()).collect();
        let places: Vec<Point> = taught.iter().map(|&row| self.pokes.positions_m[row]).collect();
        let fitted = KernelRidge::fit(&views, &places, self.noise().as_deref());
        let error_mm = |&row: &usize| {
            let found = fitted.as_ref()?.place(&changes[row]);
            let offset = [0, 1].map(|axis| 1e3 * (found[axis] - self.pokes.positions_m[row][axis]));
            Some(offset[0].hypot(offset[1]))
        };
        let mut errors_mm: Vec<f64> = rows.iter().filter_map(error_mm).collect();
        errors_mm.sort_by(f64::total_cmp);
        PlaceErrors { presses: rows.len(), extra: 0, errors_mm, within: [f64::NAN; 2] }
    }

    /// The trivial predictor: always the mean position of all presses.
    pub fn judge_middle(&self) -> PlaceErrors {
        let count = self.count().max(1) as f64;
        let middle = [0, 1].map(|axis| self.pokes.positions_m.iter().map(|place| place[axis]).sum::<f64>() / count);
        let mut errors_mm: Vec<f64> =
            self.pokes.positions_m.iter().map(|place| 1e3 * distance(*place, middle)).collect();
        errors_mm.sort_by(f64::total_cmp);
        PlaceErrors { presses: self.count(), extra: 0, errors_mm, within: [f64::NAN; 2] }
    }

    /// Noise of each channel relative to its mean: the change of the untouched readings from one press to the next.
    fn noise(&self) -> Option<Vec<f64>> {
        let before = self.before.as_ref()?;
        let count = before.len() as f64;
        let of_channel = |channel: usize| {
            let mean = before.iter().map(|frame| frame[channel]).sum::<f64>() / count;
            let steps: f64 = before.windows(2).map(|pair| (pair[1][channel] - pair[0][channel]).powi(2)).sum();
            (steps / count.max(2.0)).sqrt() / mean.abs().max(f64::MIN_POSITIVE)
        };
        Some((0..before.first()?.len()).map(of_channel).collect())
    }

    /// The frames as differences: unchanged if they already are, else relative to the mean of the frames before.
    fn changes(&self) -> Vec<Vec<f64>> {
        let Some(before) = &self.before else { return self.pressed.clone() };
        let channels = before.first().map_or(0, Vec::len);
        let mean: Vec<f64> = (0..channels)
            .map(|channel| before.iter().map(|frame| frame[channel]).sum::<f64>() / before.len() as f64)
            .collect();
        let relative = |(pressed, before): (&Vec<f64>, &Vec<f64>)| {
            (0..channels).map(|c| if mean[c] == 0.0 { 0.0 } else { (pressed[c] - before[c]) / mean[c] }).collect()
        };
        self.pressed.iter().zip(before).map(relative).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_order_contains_every_press_once_and_depends_on_the_seed() {
        let (one, other) = (shuffled(50, 1), shuffled(50, 2));
        assert_eq!(one, shuffled(50, 1));
        assert_ne!(one, other);
        let mut sorted = one;
        sorted.sort_unstable();
        assert_eq!(sorted, (0..50).collect::<Vec<_>>());
    }

    #[test]
    fn quantiles_are_over_found_touches() {
        let errors_mm = (1..=10).map(f64::from).collect();
        let errors = PlaceErrors { presses: 12, extra: 1, errors_mm, within: [0.7, 0.6] };
        assert_eq!([errors.quantile_mm(0.5), errors.quantile_mm(0.9), errors.quantile_mm(1.0)], [6.0, 10.0, 10.0]);
        let figures = PlaceErrors::figures(&[errors]);
        assert_eq!(figures[2].to_string(), "presses found 10 of 12");
        let none = PlaceErrors { presses: 2, extra: 0, errors_mm: vec![], within: [0.0; 2] };
        assert!(none.quantile_mm(0.5).is_nan());
    }
}
