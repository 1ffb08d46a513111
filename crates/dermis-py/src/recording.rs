//! [`PyRecording`]: frames, touches, baselines and events of a recording as arrays.

use std::path::PathBuf;

use dermis_device::{Frame, ReadOptions};
use dermis_live::channels::ChannelReader;
use dermis_record::{BaselineEntry, Entry, EventEntry, Recording};
use dermis_skin::Skin;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Array1, Array2, array1, array2};
use crate::errors::Fault;
use crate::hints::{self, Baseline, DataArray, DataFrame, Event, Table, Touches};
use crate::result::{TouchRow, row_of, table_of};
use crate::skin::PySkin;
use crate::skin_argument::SkinLike;
use crate::work::{run, run_interruptibly};

/// A recording made by dermis, finished or not.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     The ``.mcap`` file.
///
/// Raises
/// ------
/// FileError
///     The file doesn't exist, or isn't a recording of dermis.
#[pyclass(frozen, module = "dermis", name = "Recording")]
pub struct PyRecording {
    path: PathBuf,
    skin: Skin,
    source: String,
    written: Option<u64>,
    labels: Vec<String>,
}

/// Frames of a recording in the skin's channel order.
#[derive(Default)]
struct Frames {
    values: Vec<f64>,
    channels: usize,
    times_s: Vec<f64>,
    wall_ns: Vec<i64>,
    sequences: Vec<u64>,
}

impl PyRecording {
    fn read(&self) -> Result<Recording, Fault> {
        Ok(Recording::open(&self.path)?)
    }

    /// Reads frames from `start` up to but excluding `stop`.
    fn read_frames(&self, start: usize, stop: Option<usize>, raw: bool) -> Result<Frames, Fault> {
        let mut recording = self.read()?;
        let layout = recording.head().layout.clone();
        let protocol = self.skin.protocol()?;
        let name = self.path.display().to_string();
        let mut reader = ChannelReader::new(&layout, &protocol, self.skin.backend.reads, &name)?;
        let channels = if raw { layout.channels() } else { protocol.channel_count() };
        let mut frames = Frames { channels, ..Frames::default() };
        let (mut frame, mut row, mut number, mut origin_ns) = (Frame::default(), Vec::new(), 0, None);
        while stop.is_none_or(|stop| number < stop) && recording.next_frame(&mut frame)? {
            let clock_ns = frame.device_time_ns.unwrap_or(frame.host_monotonic_ns);
            let origin_ns = *origin_ns.get_or_insert(clock_ns);
            reader.read(&frame.values, &frame.imaginary, &mut row)?;
            if number >= start {
                frames.values.extend_from_slice(if raw { &frame.values } else { &row });
                frames.times_s.push(1e-9 * clock_ns.saturating_sub(origin_ns) as f64);
                frames.wall_ns.push(i64::try_from(frame.host_wall_ns).unwrap_or(i64::MAX));
                frames.sequences.push(frame.sequence);
            }
            number += 1;
        }
        Ok(frames)
    }
}

#[pymethods]
impl PyRecording {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        run(py, || {
            let recording = Recording::open(&path)?;
            let head = recording.head();
            let skin = Skin::parse(&head.skin_toml, &path.display().to_string())?;
            let (source, labels) = (head.source.clone(), head.labels.clone());
            let written = recording.frames_written();
            Ok(Self { path, skin, source, written, labels })
        })
    }

    /// The file.
    #[getter]
    fn path(&self) -> PathBuf {
        self.path.clone()
    }

    /// The skin at the time of recording.
    #[getter]
    fn skin(&self) -> PySkin {
        PySkin { skin: self.skin.clone() }
    }

    /// Source of the frames.
    #[getter]
    fn source(&self) -> &str {
        &self.source
    }

    /// Number of frames stated at the recording's end, or None.
    #[getter]
    fn frames_written(&self) -> Option<u64> {
        self.written
    }

    /// A label for every channel.
    #[getter]
    fn channel_labels(&self) -> PyResult<Vec<String>> {
        let protocol = self.skin.protocol().map_err(Fault::from)?;
        if self.labels.len() == protocol.channel_count() {
            return Ok(self.labels.clone());
        }
        Ok((0..protocol.channel_count()).map(|channel| protocol.channel_label(channel)).collect())
    }

    /// Readings of the frames.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int, optional
    ///     First frame, and the frame before which to stop.
    /// raw : bool
    ///     Use the instrument's own order instead of the skin's.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (n, k), NaN where missing.
    #[pyo3(signature = (start=0, stop=None, *, raw=false))]
    fn frames<'py>(&self, py: Python<'py>, start: usize, stop: Option<usize>, raw: bool) -> PyResult<Array2<'py, f64>> {
        let frames = run(py, || self.read_frames(start, stop, raw))?;
        array2(py, frames.values, frames.times_s.len(), frames.channels)
    }

    /// Times and sequence numbers of the frames.
    ///
    /// Parameters
    /// ----------
    /// start, stop : int, optional
    ///     First frame, and the frame before which to stop.
    ///
    /// Returns
    /// -------
    /// times_s : numpy.ndarray
    ///     Shape (n,): seconds since the first frame.
    /// wall_ns : numpy.ndarray
    ///     Shape (n,): host's wall clock, nanoseconds since 1970.
    /// sequences : numpy.ndarray
    ///     Shape (n,): the instrument's sequence numbers; gaps are lost frames.
    #[pyo3(signature = (start=0, stop=None))]
    fn times<'py>(
        &self,
        py: Python<'py>,
        start: usize,
        stop: Option<usize>,
    ) -> PyResult<(Array1<'py, f64>, Array1<'py, i64>, Array1<'py, u64>)> {
        let frames = run(py, || self.read_frames(start, stop, true))?;
        Ok((array1(py, frames.times_s), array1(py, frames.wall_ns), array1(py, frames.sequences)))
    }

    /// Recorded touches as a structured array: ``sequence``, ``wall_ns`` and the fields of ``dermis.touch_dtype``.
    fn touches<'py>(&self, py: Python<'py>) -> PyResult<Touches<'py>> {
        let (rows, sequences, times_ns) = run(py, || {
            let mut recording = self.read()?;
            let (mut rows, mut sequences, mut times_ns) = (Vec::<TouchRow>::new(), Vec::new(), Vec::new());
            while let Some(entry) = recording.next_entry()? {
                if let Entry::Touches { wall_ns, entry } = entry {
                    rows.extend(entry.touches.iter().map(row_of));
                    sequences.resize(rows.len(), entry.sequence);
                    times_ns.resize(rows.len(), i64::try_from(wall_ns).unwrap_or(i64::MAX));
                }
            }
            Ok((rows, sequences, times_ns))
        })?;
        let touches = table_of(py, &rows)?;
        let arguments = (array1(py, sequences), array1(py, times_ns), touches);
        Ok(Touches(py.import("dermis._tables")?.getattr("recorded_touches")?.call1(arguments)?))
    }

    /// Frames as a ``pandas.DataFrame``.
    fn to_pandas<'py>(slf: &Bound<'py, Self>) -> PyResult<DataFrame<'py>> {
        Ok(DataFrame(slf.py().import("dermis._tables")?.getattr("to_pandas")?.call1((slf,))?))
    }

    /// Frames as a ``pyarrow.Table``.
    fn to_arrow<'py>(slf: &Bound<'py, Self>) -> PyResult<Table<'py>> {
        Ok(Table(slf.py().import("dermis._tables")?.getattr("to_arrow")?.call1((slf,))?))
    }

    /// Frames as an ``xarray.DataArray``.
    fn to_xarray<'py>(slf: &Bound<'py, Self>) -> PyResult<DataArray<'py>> {
        Ok(DataArray(slf.py().import("dermis._tables")?.getattr("to_xarray")?.call1((slf,))?))
    }

    /// Baselines that came into use: for each a dictionary with ``wall_ns``, ``reason``, ``values`` and
    /// ``noise_std``, both of shape (k,).
    fn baselines<'py>(&self, py: Python<'py>) -> PyResult<Vec<Baseline<'py>>> {
        let found = run(py, || {
            let mut recording = self.read()?;
            let mut found = Vec::new();
            while let Some(entry) = recording.next_entry()? {
                if let Entry::Baseline { wall_ns, entry } = entry {
                    found.push((wall_ns, entry.clone()));
                }
            }
            Ok(found)
        })?;
        let row = |(wall_ns, entry): (u64, BaselineEntry)| {
            let row = PyDict::new(py);
            row.set_item("wall_ns", wall_ns)?;
            row.set_item("reason", entry.record.reason)?;
            row.set_item("values", array1(py, entry.values))?;
            row.set_item("noise_std", array1(py, entry.noise_std))?;
            Ok(Baseline(row.into_any()))
        };
        found.into_iter().map(row).collect()
    }

    /// Events: for each a dictionary with ``wall_ns``, ``event``, ``detail`` and ``values``.
    fn events<'py>(&self, py: Python<'py>) -> PyResult<Vec<Event<'py>>> {
        let found = run(py, || {
            let mut recording = self.read()?;
            let mut found = Vec::new();
            while let Some(entry) = recording.next_entry()? {
                if let Entry::Event { wall_ns, entry } = entry
                    && !entry.event.is_empty()
                {
                    found.push((wall_ns, entry.clone()));
                }
            }
            Ok(found)
        })?;
        let row = |(wall_ns, entry): (u64, EventEntry)| {
            let row = PyDict::new(py);
            row.set_item("wall_ns", wall_ns)?;
            row.set_item("event", entry.event)?;
            row.set_item("detail", entry.detail)?;
            row.set_item("values", array1(py, entry.values))?;
            Ok(Event(row.into_any()))
        };
        found.into_iter().map(row).collect()
    }

    fn __repr__(&self) -> String {
        let count = self.written.map_or("an unknown number of".into(), |count| count.to_string());
        format!("<dermis.Recording {:?}: {count} frames of skin {:?}>", self.path.display().to_string(), self.skin.name)
    }
}

/// Content of a file of frames, for Python.
struct FileFrames {
    rows: Vec<Vec<f64>>,
    times_s: Option<Vec<f64>>,
    sequences: Option<Vec<u64>>,
    wall_ns: Option<Vec<i64>>,
    understood: String,
}

/// Reads frames from any file that ``dermis reconstruct`` reads: text tables, NumPy, MATLAB, Excel, Parquet,
/// recordings, ROS bags, Sciospec ``.eit`` and others.
///
/// Parameters
/// ----------
/// path : str or os.PathLike
///     The file or folder; ``#A..B`` after it selects frames.
/// skin : Skin or str, optional
///     With a skin, single-ended potentials and full matrices are converted to its channels, and columns that name
///     their electrodes are put in its order. Without one, readings are returned as they are.
/// format : str, optional
///     Format of the file; default: recognised from the file.
/// columns : str, optional
///     Columns of a table that hold readings: names, indices from 0, ranges such as ``"1..209"``.
/// skip_rows : int
///     Lines to skip at the start of a text file.
/// array, topic : str, optional
///     Array of an archive or MATLAB file, sheet of a workbook, column of lists of a Parquet file, or topic of a bag.
/// transpose : bool
///     Frames are stored as columns.
///
/// Returns
/// -------
/// frames : numpy.ndarray
///     Shape (n, k), NaN where missing.
/// times_s : numpy.ndarray or None
///     Shape (n,), seconds, if the file has times.
///
/// The returned pair has the attributes ``frames``, ``times_s``, ``sequences`` (the instrument's sequence numbers,
/// gaps are lost frames) and ``wall_ns`` (nanoseconds since 1970), each None if the file has none, and
/// ``understood``, a line on how the file was interpreted.
///
/// Raises
/// ------
/// FileError
///     The file cannot be read; the message gives the place and advice.
#[pyfunction]
#[pyo3(signature = (path, skin=None, *, format=None, columns=None, skip_rows=0, array=None, topic=None, transpose=false))]
pub fn read_frames<'py>(
    py: Python<'py>,
    path: PathBuf,
    skin: Option<SkinLike<'py>>,
    format: Option<String>,
    columns: Option<String>,
    skip_rows: usize,
    array: Option<String>,
    topic: Option<String>,
    transpose: bool,
) -> PyResult<hints::FileFrames<'py>> {
    let skin = skin.as_deref().map(crate::skin::skin_of).transpose()?;
    let found = run_interruptibly(py, "read", move || {
        let spec: dermis_device::FileSpec = path.to_string_lossy().parse()?;
        let options = ReadOptions {
            format: format.map(|name| name.parse()).transpose()?,
            columns: columns.map(|text| text.parse()).transpose()?.unwrap_or_default(),
            skip_rows,
            array: array.or(topic),
            transpose,
            ..ReadOptions::default()
        };
        let table = match &skin {
            Some(skin) => dermis_record::read_frames_of(skin, &spec, options)?,
            None => dermis_record::read_frames(&spec, options)?,
        };
        let rows = match &skin {
            Some(skin) => {
                let protocol = skin.protocol()?;
                let name = table.source().display().to_string();
                ChannelReader::new(table.layout(), &protocol, skin.backend.reads, &name)?.read_table(&table)?
            }
            None => table.rows().map(<[f64]>::to_vec).collect(),
        };
        Ok(FileFrames {
            rows,
            times_s: table.times_s().map(<[f64]>::to_vec),
            sequences: table.sequences().map(<[u64]>::to_vec),
            wall_ns: table.wall_ns().map(<[i64]>::to_vec),
            understood: table.understood(),
        })
    })?;
    let (count, channels) = (found.rows.len(), found.rows.first().map_or(0, Vec::len));
    let arguments = (
        array2(py, found.rows.concat(), count, channels)?,
        found.times_s.map(|times| array1(py, times)),
        found.sequences.map(|numbers| array1(py, numbers)),
        found.wall_ns.map(|moments| array1(py, moments)),
        found.understood,
    );
    Ok(hints::FileFrames(py.import("dermis._tables")?.getattr("FileFrames")?.call1(arguments)?))
}
