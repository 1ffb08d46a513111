//! [`PySkin`]: a checked skin file.

use std::sync::Arc;

use dermis_live::prepare::Prepared;
use dermis_skin::{BUILTIN_NAMES, Modality, Skin};
use dermis_tomo::mesh::{Outline, Surface};
use pyo3::prelude::*;

use crate::arrays::{Array1, Array2, Doubles, array1, array2, read_only};
use crate::errors::{Fault, Kind};
use crate::hints::{self, ArrayLike, Axes, Restorer};
use crate::model::PyModel;
use crate::skin_argument::SkinLike;
pub use crate::skin_argument::{PySkin, skin_of};
use crate::work::run_interruptibly;

/// Corners of the polygon that represents a disc.
const DISC_CORNERS: usize = 128;

#[pymethods]
impl PySkin {
    #[new]
    fn new(source: SkinLike<'_>) -> PyResult<Self> {
        Ok(Self { skin: skin_of(&source)? })
    }

    /// The names of the built-in skins.
    #[staticmethod]
    fn names() -> Vec<&'static str> {
        BUILTIN_NAMES.to_vec()
    }

    /// A skin from the text of its file, in this or an earlier version of the format.
    ///
    /// Parameters
    /// ----------
    /// text : str
    ///     TOML text, with all parts in it.
    #[staticmethod]
    fn from_toml(text: &str) -> PyResult<Self> {
        Ok(Self { skin: Skin::parse(text, "skin").map_err(Fault::from)? })
    }

    /// The skin as TOML text, with all parts in it.
    fn to_toml(&self) -> String {
        self.skin.to_toml()
    }

    /// Short name.
    #[getter]
    fn name(&self) -> &str {
        &self.skin.name
    }

    /// Title, in one line.
    #[getter]
    fn title(&self) -> &str {
        &self.skin.title
    }

    /// Physical principle: ``eit`` or ``mit``.
    #[getter]
    fn modality(&self) -> hints::Modality {
        hints::Modality::of(self.skin.modality.name())
    }

    /// Quantity of its images' values.
    #[getter]
    fn image_quantity(&self) -> &'static str {
        self.skin.modality.image_quantity()
    }

    /// Frame rate of its instrument, or None.
    #[getter]
    fn frames_per_s(&self) -> Option<f64> {
        self.skin.backend.frames_per_s
    }

    /// Number of readings in a frame.
    #[getter]
    fn channel_count(&self) -> PyResult<usize> {
        Ok(self.skin.protocol().map_err(Fault::from)?.channel_count())
    }

    /// Number of electrodes or coils.
    #[getter]
    fn electrode_count(&self) -> usize {
        self.skin.electrode_shapes().len()
    }

    /// Sheet conductance at rest, siemens: conductivity times thickness.
    #[getter]
    fn sheet_conductance_s(&self) -> f64 {
        self.skin.sheet_conductance_s()
    }

    /// Corners of the rim, shape (n, 2), metres, without repeating the first; a disc has 128. Read-only.
    #[getter]
    fn outline<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let points: Vec<[f64; 2]> = match self.skin.outline() {
            Outline::Disc { radius_m } => (0..DISC_CORNERS)
                .map(|k| {
                    let (s, c) = (std::f64::consts::TAU * k as f64 / DISC_CORNERS as f64).sin_cos();
                    [radius_m * c, radius_m * s]
                })
                .collect(),
            Outline::Rectangle { width_m, height_m } => {
                let (x, y) = (0.5 * width_m, 0.5 * height_m);
                vec![[-x, -y], [x, -y], [x, y], [-x, y]]
            }
            outline => polygon(&outline),
        };
        read_only(array2(py, points.as_flattened().to_vec(), points.len(), 2)?)
    }

    /// Lower left and upper right corners, metres.
    #[getter]
    fn bounds_m(&self) -> ([f64; 2], [f64; 2]) {
        self.skin.outline().bounds_m()
    }

    /// Radius of the cylinder that the sheet is bent around, metres, or None if it is flat. The axis runs along y, one
    /// radius behind the middle of the sheet; positions on the skin are those of the sheet laid flat.
    #[getter]
    fn cylinder_radius_m(&self) -> Option<f64> {
        match self.skin.surface() {
            Surface::Flat => None,
            Surface::Cylinder { radius_m } => Some(radius_m),
        }
    }

    /// True for points on the skin, including its rim but not its holes.
    ///
    /// Parameters
    /// ----------
    /// points_m : array_like
    ///     Shape (n, 2): positions on the sheet laid flat, metres.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (n,), bool.
    fn contains<'py>(&self, py: Python<'py>, points_m: ArrayLike<'py>) -> PyResult<Array1<'py, bool>> {
        let (points, _) = Doubles::rows("points_m", &points_m, 2, "x and y of each point")?;
        let outline = self.skin.outline();
        let inside = points.values()?.chunks_exact(2).map(|point| outline.contains([point[0], point[1]])).collect();
        Ok(array1(py, inside))
    }

    /// The skin's mesh and forward model at rest.
    ///
    /// Parameters
    /// ----------
    /// elements : int, optional
    ///     Approximate number of elements; default: the skin file's.
    ///
    /// Returns
    /// -------
    /// Model
    ///
    /// Raises
    /// ------
    /// SkinError
    ///     The geometry cannot be meshed.
    #[pyo3(signature = (elements=None))]
    fn model(&self, py: Python<'_>, elements: Option<usize>) -> PyResult<PyModel> {
        let mut skin = self.skin.clone();
        if let Some(elements) = elements {
            skin.imaging.elements = elements;
            skin = skin.checked().map_err(Fault::from)?;
        }
        let prepared = run_interruptibly(py, "model", move || Ok(Prepared::new(skin)?))?;
        PyModel::of(py, Arc::new(prepared))
    }

    /// Draws the rim and the numbered electrodes.
    ///
    /// Parameters
    /// ----------
    /// axes : matplotlib.axes.Axes, optional
    ///     Axes to draw on; default: a new figure's.
    ///
    /// Returns
    /// -------
    /// matplotlib.axes.Axes
    #[pyo3(signature = (axes=None))]
    fn plot<'py>(slf: &Bound<'py, Self>, axes: Option<Axes<'py>>) -> PyResult<Axes<'py>> {
        Ok(Axes(slf.py().import("dermis.plot")?.getattr("skin")?.call1((slf, axes))?))
    }

    fn _repr_svg_(&self, py: Python<'_>) -> PyResult<Option<String>> {
        if self.skin.modality == Modality::Mit && self.skin.frontend.coils.is_none() {
            return Ok(None);
        }
        let skin = self.skin.clone();
        run_interruptibly(py, "drawing", move || Ok(Some(dermis_cli::skin_svg(&skin)?)))
    }

    fn __repr__(&self) -> String {
        let channels = self.skin.protocol().map_or(0, |protocol| protocol.channel_count());
        let what = if self.skin.modality == Modality::Mit { "coils" } else { "electrodes" };
        format!("<dermis.Skin {:?}: {} {what}, {channels} channels>", self.skin.name, self.electrode_count())
    }

    fn __eq__(&self, other: &Bound<'_, PyAny>) -> bool {
        other.cast::<PySkin>().is_ok_and(|other| other.get().skin == self.skin)
    }

    fn __hash__(&self) -> u64 {
        use std::hash::{DefaultHasher, Hash, Hasher};
        let mut hasher = DefaultHasher::new();
        self.skin.to_toml().hash(&mut hasher);
        hasher.finish()
    }

    fn __reduce__<'py>(slf: &Bound<'py, Self>) -> PyResult<(Restorer<'py>, (String,))> {
        let make = slf.get_type().getattr("from_toml")?;
        Ok((Restorer(make), (slf.get().to_toml(),)))
    }
}

fn polygon(outline: &Outline) -> Vec<[f64; 2]> {
    match outline {
        Outline::Polygon { outer, .. } => outer.clone(),
        _ => Vec::new(),
    }
}

/// Rejects a model of another skin.
pub fn same_skin(what: &str, expected: &Skin, got: &Skin) -> Result<(), Fault> {
    if expected.name == got.name {
        return Ok(());
    }
    Err(Fault::new(
        Kind::Input,
        format!("{what}: expected one of skin {}, got one of skin {}", expected.name, got.name),
    ))
}
