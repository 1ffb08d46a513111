//! Functions on arrays: the search for a file's channel order, and the conductance of a sheet.

use dermis_device::{FrameTable, Layout};
use dermis_lab::channel_search::{self, LEAST, find_order};
use dermis_lab::conductance::conductance;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Array2, Doubles, array1, array2, shape_text};
use crate::errors::Fault;
use crate::hints::{ArrayLike, FoundConductance, FoundOrder};
use crate::skin::skin_of;
use crate::skin_argument::SkinLike;
use crate::work::run_interruptibly;

/// Frames, shape (k,) or (n, k), as a table.
fn table_of(what: &str, frames: &Bound<'_, PyAny>) -> PyResult<FrameTable> {
    let frames = Doubles::of(what, frames)?;
    let count = match frames.shape() {
        [count] | [_, count] if *count > 0 && !frames.values()?.is_empty() => *count,
        shape => return Err(Fault::input(what, "shape (k,) or (n, k), with numbers", shape_text(shape)).into()),
    };
    Ok(FrameTable::new(Layout::Channels { count }, frames.values()?.to_vec(), what).map_err(Fault::from)?)
}

/// Result of `dermis order` as a dictionary; `dermis.find_order` turns it into an `Order`.
#[pyfunction]
pub fn search_order<'py>(py: Python<'py>, skin: SkinLike<'py>, baseline: ArrayLike<'py>) -> PyResult<FoundOrder<'py>> {
    let skin = skin_of(&skin)?;
    let table = table_of("baseline", &baseline)?;
    let (found, mapped) = run_interruptibly(py, "order", move || {
        let found = find_order(&table, Some(&skin))?;
        let mapped = match found.candidates.first() {
            Some(best) => best.to_skin(&skin)?,
            None => None,
        };
        Ok((found, mapped))
    })?;
    let dict = PyDict::new(py);
    let best = found.candidates.first();
    let is_stated = mapped.as_ref().is_some_and(|(source, signs)| {
        (0..).zip(source).all(|(k, channel)| k == *channel) && signs.iter().all(|sign| *sign == 1.0)
    });
    let correlation = best.map_or(0.0, |best| best.correlation);
    dict.set_item("correlation", correlation)?;
    dict.set_item("description", best.map_or("", |best| best.description.as_str()))?;
    dict.set_item("lines", found.fitting().map_or_else(String::new, channel_search::OrderCandidate::lines))?;
    dict.set_item("verdict", found.verdict())?;
    // If several orders fit equally well, trust the one in the skin file.
    dict.set_item("is_clear", found.is_clear || (is_stated && correlation >= LEAST))?;
    dict.set_item("is_stated", is_stated)?;
    let candidates: Vec<(f64, &str)> =
        found.candidates.iter().map(|candidate| (candidate.correlation, candidate.description.as_str())).collect();
    dict.set_item("candidates", candidates)?;
    let (source, signs) = mapped.unzip();
    dict.set_item("source", source.map(|list| array1(py, list.into_iter().map(i64::from).collect())))?;
    dict.set_item("sign", signs.map(|list| array1(py, list)))?;
    Ok(FoundOrder(dict.into_any()))
}

/// Result of `dermis conductance` as a dictionary; `dermis.conductance` turns it into a `Conductance`.
#[pyfunction]
pub fn estimate_conductance<'py>(
    py: Python<'py>,
    skin: SkinLike<'py>,
    frames: ArrayLike<'py>,
) -> PyResult<FoundConductance<'py>> {
    let skin = skin_of(&skin)?;
    let table = table_of("frames", &frames)?;
    let found = run_interruptibly(py, "conductance", move || Ok(conductance(&skin, &table)?))?;
    let dict = PyDict::new(py);
    dict.set_item("sheet_s", found.sheet_s)?;
    dict.set_item("sheet_sigma_s", found.sheet_sigma_s)?;
    dict.set_item("uniform_s", found.uniform_s)?;
    dict.set_item("misfit", found.misfit)?;
    let regions: Vec<[f64; 5]> = found
        .regions
        .iter()
        .map(|region| [region.x_m, region.y_m, region.radius_m, region.conductance_s, region.sigma_s])
        .collect();
    let count = regions.len();
    dict.set_item("regions", array2(py, regions.concat(), count, 5)?)?;
    let image =
        |values: Vec<f64>| -> PyResult<Array2<'py, f64>> { array2(py, values, found.grid.rows, found.grid.columns) };
    dict.set_item("image_s", image(found.image_s.clone())?)?;
    dict.set_item("sigma_s", image(found.sigma_s.clone())?)?;
    Ok(FoundConductance(dict.into_any()))
}
