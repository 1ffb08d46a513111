//! Stimulation and measurement patterns.

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Pattern, Protocol, ProtocolSpec, Reference};
use pyo3::prelude::*;

use crate::arrays::{Array1, Array2, Doubles, array1, array2, indices, shape_text};
use crate::errors::Fault;
use crate::hints::{ArrayLike, Patterns, Restorer};

/// Patterns as dense rows over the electrodes.
pub fn dense_patterns<'py, 'a>(
    py: Python<'py>,
    electrodes: usize,
    patterns: impl Iterator<Item = &'a Pattern>,
) -> PyResult<Array2<'py, f64>> {
    let mut values = Vec::new();
    let mut rows = 0;
    for pattern in patterns {
        values.resize((rows + 1) * electrodes, 0.0);
        for &(electrode, weight) in pattern.entries() {
            values[rows * electrodes + electrode as usize] = weight;
        }
        rows += 1;
    }
    array2(py, values, rows, electrodes)
}

/// Electrodes of every channel, from 0, in the order of a skin file: the drive's first and second (current enters at
/// the second), and the measured first and second (the reading is the first's potential minus the second's). -1 if a
/// pattern has no such electrode, or several.
pub fn channels_of<'py>(py: Python<'py>, protocol: &Protocol) -> PyResult<Array2<'py, i32>> {
    let only = |pattern: &Pattern, sign: f64| {
        let mut found = pattern.entries().iter().filter(|entry| sign * entry.1 > 0.0);
        match (found.next(), found.next()) {
            (Some(entry), None) => entry.0 as i32,
            _ => -1,
        }
    };
    let row = |channel: usize| {
        let (drive, read) = (protocol.stimulation_of(channel), protocol.pattern_of(channel));
        [only(drive, -1.0), only(drive, 1.0), only(read, 1.0), only(read, -1.0)]
    };
    let count = protocol.channel_count();
    array2(py, (0..count).flat_map(row).collect(), count, 4)
}

/// Stimulations, measurements, and the channels that pair them.
///
/// Parameters
/// ----------
/// stimulations : array_like
///     Shape (s, electrodes), amperes into the body; each row sums to zero.
/// measurements : array_like
///     Shape (k, electrodes): weights of the potentials in each reading.
/// stimulation_of : array_like
///     Shape (k,): the stimulation of every channel, from 0.
#[pyclass(frozen, module = "dermis.eit", name = "Protocol")]
pub struct PyProtocol {
    /// The lists.
    pub protocol: Protocol,
}

/// Arguments that make a protocol.
type Parts<'py> = (Array2<'py, f64>, Array2<'py, f64>, Array1<'py, u32>);

fn rows(what: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<Vec<f64>>> {
    let rows = Doubles::of(what, value)?;
    if rows.shape().len() != 2 {
        return Err(Fault::input(what, "shape (n, electrodes)", shape_text(rows.shape())).into());
    }
    rows.finite(what)?.to_rows()
}

fn pairs(what: &str, value: &Bound<'_, PyAny>, electrodes: usize) -> PyResult<Vec<(u32, u32)>> {
    let (list, shape) = indices(what, value, electrodes, "electrodes")?;
    if shape.len() != 2 || shape[1] != 2 {
        return Err(Fault::input(what, "shape (n, 2)", shape_text(&shape)).into());
    }
    Ok(list.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect())
}

fn drive_of(value: &Bound<'_, PyAny>, electrodes: usize) -> PyResult<Drive> {
    let Ok(text) = value.extract::<String>() else { return Ok(Drive::Pairs(pairs("drive", value, electrodes)?)) };
    match (text.as_str(), text.strip_prefix("skip-").and_then(|n| n.parse().ok())) {
        ("adjacent", _) => Ok(Drive::Adjacent),
        ("opposite", _) => Ok(Drive::Opposite),
        ("pseudo-polar", _) => Ok(Drive::PseudoPolar),
        ("trigonometric", _) => Ok(Drive::Trigonometric),
        (_, Some(skip)) => Ok(Drive::Skip(skip)),
        _ => {
            let expected = "\"adjacent\", \"opposite\", \"pseudo-polar\", \"trigonometric\", \"skip-N\" or pairs";
            Err(Fault::input("drive", expected, format!("{text:?}")).into())
        }
    }
}

fn measure_of(value: &Bound<'_, PyAny>, electrodes: usize) -> PyResult<Measure> {
    let Ok(text) = value.extract::<String>() else { return Ok(Measure::Pairs(pairs("measure", value, electrodes)?)) };
    match (text.as_str(), text.strip_prefix("skip-").and_then(|n| n.parse().ok())) {
        ("adjacent", _) => Ok(Measure::Adjacent),
        ("opposite", _) => Ok(Measure::Opposite),
        ("pseudo-polar", _) => Ok(Measure::PseudoPolar),
        ("single-ended", _) => Ok(Measure::SingleEnded(Reference::Mean)),
        ("single-ended-sink", _) => Ok(Measure::SingleEnded(Reference::Sink)),
        (_, Some(skip)) => Ok(Measure::Skip(skip)),
        _ => {
            let expected = "\"adjacent\", \"opposite\", \"pseudo-polar\", \"single-ended\", \"single-ended-sink\", \
                            \"skip-N\" or pairs";
            Err(Fault::input("measure", expected, format!("{text:?}")).into())
        }
    }
}

/// The number of channels grows with the square of the electrodes: more would not fit into memory.
const MOST_ELECTRODES: usize = 512;

#[pymethods]
impl PyProtocol {
    #[new]
    fn new(stimulations: ArrayLike<'_>, measurements: ArrayLike<'_>, stimulation_of: ArrayLike<'_>) -> PyResult<Self> {
        let (stimulations, measurements) = (rows("stimulations", &stimulations)?, rows("measurements", &measurements)?);
        let (of, shape) = indices("stimulation_of", &stimulation_of, stimulations.len(), "stimulations")?;
        if shape != [measurements.len()] {
            let expected = format!("shape ({},), one per measurement", measurements.len());
            return Err(Fault::input("stimulation_of", expected, shape_text(&shape)).into());
        }
        let of: Vec<usize> = of.iter().map(|&stimulation| stimulation as usize).collect();
        Ok(Self { protocol: Protocol::from_rows(&stimulations, &measurements, &of).map_err(Fault::from)? })
    }

    /// A protocol by its common name.
    ///
    /// Parameters
    /// ----------
    /// electrodes : int
    ///     Number of electrodes.
    /// drive, measure : str or array_like, optional
    ///     ``adjacent``, ``opposite``, ``pseudo-polar``, ``skip-N``; drives also ``trigonometric``, measurements also
    ///     ``single-ended`` (against the mean) and ``single-ended-sink``; or pairs, shape (n, 2), from 0.
    /// rotating : bool
    ///     Start the measurements at the drive's own electrode.
    /// keep_driven : bool
    ///     Include channels with driven electrodes.
    /// amplitude_a : float
    ///     Current, amperes.
    #[staticmethod]
    #[pyo3(signature = (electrodes, drive=None, measure=None, *, rotating=false, keep_driven=false, amplitude_a=1e-3))]
    fn generate(
        electrodes: usize,
        drive: Option<Patterns<'_>>,
        measure: Option<Patterns<'_>>,
        rotating: bool,
        keep_driven: bool,
        amplitude_a: f64,
    ) -> PyResult<Self> {
        if electrodes > 4096 {
            return Err(Fault::input("electrodes", "at most 4096", electrodes).into());
        }
        if electrodes > MOST_ELECTRODES {
            return Err(Fault::input("electrodes", format!("at most {MOST_ELECTRODES}"), electrodes).into());
        }
        let spec = ProtocolSpec {
            electrode_count: electrodes,
            drive: drive.map_or(Ok(Drive::Adjacent), |drive| drive_of(&drive, electrodes))?,
            measure: measure.map_or(Ok(Measure::Adjacent), |measure| measure_of(&measure, electrodes))?,
            order: if rotating { Order::Rotating } else { Order::Absolute },
            driven: if keep_driven { Driven::Keep } else { Driven::Drop },
            amplitude_a,
        };
        Ok(Self { protocol: Protocol::generate(&spec).map_err(Fault::from)? })
    }

    /// Adjacent drives and measurements.
    ///
    /// Parameters
    /// ----------
    /// electrodes : int
    ///     Number of electrodes.
    /// rotating : bool
    ///     Start the measurements at the driven electrodes instead of the first.
    /// keep_driven : bool
    ///     Include pairs with a driven electrode.
    /// amplitude_a : float
    ///     Current, amperes.
    ///
    /// Returns
    /// -------
    /// Protocol
    #[staticmethod]
    #[pyo3(signature = (electrodes, *, rotating=false, keep_driven=false, amplitude_a=1e-3))]
    fn adjacent(electrodes: usize, rotating: bool, keep_driven: bool, amplitude_a: f64) -> PyResult<Self> {
        Self::generate(electrodes, None, None, rotating, keep_driven, amplitude_a)
    }

    /// Number of electrodes.
    #[getter]
    fn electrode_count(&self) -> usize {
        self.protocol.electrode_count()
    }

    /// Number of channels.
    #[getter]
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    /// Shape (s, electrodes), amperes into the body.
    #[getter]
    fn stimulations<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        dense_patterns(py, self.protocol.electrode_count(), self.protocol.stimulations().iter())
    }

    /// Shape (k, electrodes).
    #[getter]
    fn measurements<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let patterns = (0..self.protocol.channel_count()).map(|channel| self.protocol.pattern_of(channel));
        dense_patterns(py, self.protocol.electrode_count(), patterns)
    }

    /// The stimulation of every channel, shape (k,).
    #[getter]
    fn stimulation_of<'py>(&self, py: Python<'py>) -> Array1<'py, u32> {
        array1(py, self.protocol.measurements().iter().map(|measurement| measurement.stimulation).collect())
    }

    /// Electrodes of every channel, shape (k, 4), as in :attr:`dermis.Model.channels`.
    #[getter]
    fn channels<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, i32>> {
        channels_of(py, &self.protocol)
    }

    /// A label for every channel, with electrodes counted from 1.
    #[getter]
    fn labels(&self) -> Vec<String> {
        (0..self.protocol.channel_count()).map(|channel| self.protocol.channel_label(channel)).collect()
    }

    fn __len__(&self) -> usize {
        self.protocol.channel_count()
    }

    fn __repr__(&self) -> String {
        format!(
            "<dermis.eit.Protocol: {} electrodes, {} stimulations, {} channels>",
            self.protocol.electrode_count(),
            self.protocol.stimulations().len(),
            self.protocol.channel_count()
        )
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Restorer<'py>, Parts<'py>)> {
        let (py, own) = (slf.py(), slf.get());
        let arguments = (own.stimulations(py)?, own.measurements(py)?, own.stimulation_of(py));
        Ok((Restorer(slf.get_type().into_any()), arguments))
    }
}
