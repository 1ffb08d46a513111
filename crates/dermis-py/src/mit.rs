//! `dermis.mit`: coils, bodies, and the changes of mutual inductance caused by bodies.

use dermis_mit::{CoilArray, CoilShape, CoilSpec, Complex, Polarizability, Sphere};
use numpy::Complex64;
use pyo3::prelude::*;

use crate::arrays::{Array1, Array2, Doubles, array1, array2, shape_text};
use crate::errors::Fault;
use crate::hints::ArrayLike;
use crate::work::run;

fn plain(values: &[Complex]) -> Vec<Complex64> {
    values.iter().map(|value| Complex64::new(value.re, value.im)).collect()
}

/// Identical coils, flat spirals, at given positions.
///
/// Parameters
/// ----------
/// places_m : array_like
///     Shape (n, 2) or (n, 3): their centres, metres.
/// inner_m, outer_m : float
///     Widths, metres.
/// turns : int
///     Number of turns in each.
/// square : bool
///     Square instead of round.
/// inductance_h : float, optional
///     Measured self-inductance, to which fields are scaled.
/// shield_z_m : float, optional
///     Height of a perfectly conducting plane below them.
#[pyclass(frozen, module = "dermis.mit", name = "Coils")]
pub struct PyCoils {
    coils: CoilArray,
}

#[pymethods]
impl PyCoils {
    #[new]
    #[pyo3(signature = (places_m, *, inner_m, outer_m, turns, square=false, inductance_h=None, shield_z_m=None))]
    fn new(
        py: Python<'_>,
        places_m: ArrayLike<'_>,
        inner_m: f64,
        outer_m: f64,
        turns: usize,
        square: bool,
        inductance_h: Option<f64>,
        shield_z_m: Option<f64>,
    ) -> PyResult<Self> {
        let places = Doubles::of("places_m", &places_m)?.finite("places_m")?;
        let &[_, columns @ (2 | 3)] = places.shape() else {
            return Err(Fault::input("places_m", "shape (n, 2) or (n, 3)", shape_text(places.shape())).into());
        };
        let place = |row: &[f64]| [row[0], row[1], row.get(2).copied().unwrap_or(0.0)];
        let places: Vec<[f64; 3]> = places.values()?.chunks_exact(columns).map(place).collect();
        let shape = if square { CoilShape::Square } else { CoilShape::Round };
        let mut spec = CoilSpec::spiral(shape, inner_m, outer_m, turns);
        if let Some(inductance_h) = inductance_h {
            spec = spec.with_inductance(inductance_h);
        }
        let coils = run(py, || {
            spec.check()?;
            let coils = CoilArray::new(&spec, &places)?;
            Ok(match shield_z_m {
                Some(z_m) => coils.with_shield(z_m)?,
                None => coils,
            })
        })?;
        Ok(Self { coils })
    }

    /// Pairs of coils in channel order, shape (p, 2).
    #[getter]
    fn pairs<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, u32>> {
        let pairs = self.coils.pairs();
        array2(py, pairs.as_flattened().iter().map(|&coil| coil as u32).collect(), pairs.len(), 2)
    }

    /// Centres, shape (n, 3), metres.
    #[getter]
    fn places_m<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, f64>> {
        let outlines = self.coils.outlines();
        array2(py, outlines.iter().flat_map(|outline| outline.centre_m).collect(), outlines.len(), 3)
    }

    /// Mutual inductance of every pair, shape (p,), henries.
    fn mutuals_h<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py, f64>> {
        Ok(array1(py, run(py, || Ok(self.coils.mutuals_h()))?))
    }

    /// Self-inductance of every coil, shape (n,), henries.
    fn self_inductances_h<'py>(&self, py: Python<'py>) -> PyResult<Array1<'py, f64>> {
        let own = || Ok(self.coils.coils().iter().map(|coil| coil.self_inductance_h()).collect());
        Ok(array1(py, run(py, own)?))
    }

    /// Changes of mutual inductance caused by a body, complex, henries.
    ///
    /// Parameters
    /// ----------
    /// body : Body
    ///     The body; all wire must lie outside the sphere around it.
    /// centre_m : sequence of float
    ///     Its centre: x, y and z, metres.
    ///
    /// Returns
    /// -------
    /// numpy.ndarray
    ///     Shape (p,): one change per pair, complex, henries.
    fn changes_h<'py>(
        &self,
        py: Python<'py>,
        body: &Bound<'py, PyBody>,
        centre_m: [f64; 3],
    ) -> PyResult<Array1<'py, Complex64>> {
        let body = &body.get().body;
        let changes = run(py, || {
            for (number, coil) in self.coils.coils().iter().enumerate() {
                let distance_m = coil.distance_m(centre_m);
                if !distance_m.is_finite() || distance_m <= body.radius_m {
                    let expected =
                        format!("all wire farther from the body's centre than its radius, {} m", body.radius_m);
                    return Err(Fault::input("centre_m", expected, format!("coil {} at {distance_m} m", number + 1)));
                }
            }
            Ok(body.changes_h(&self.coils, centre_m))
        })?;
        Ok(array1(py, plain(&changes)))
    }

    fn __len__(&self) -> usize {
        self.coils.coils().len()
    }

    fn __repr__(&self) -> String {
        format!("<dermis.mit.Coils: {} coils, {} pairs>", self.coils.coils().len(), self.coils.pairs().len())
    }
}

/// A conducting body at one frequency, represented by its response to the coils' fields.
#[pyclass(frozen, module = "dermis.mit", name = "Body")]
pub struct PyBody {
    body: Polarizability,
}

#[pymethods]
impl PyBody {
    /// A sphere of a single material, in closed form.
    ///
    /// Parameters
    /// ----------
    /// radius_m : float
    ///     Radius, metres.
    /// conductivity_s_per_m : float
    ///     Conductivity, S/m.
    /// frequency_hz : float
    ///     Frequency of the currents in the coils, hertz.
    /// relative_permeability : float
    ///     Relative permeability; 1 for non-magnetic materials.
    ///
    /// Returns
    /// -------
    /// Body
    #[staticmethod]
    #[pyo3(signature = (radius_m, conductivity_s_per_m, frequency_hz, *, relative_permeability=1.0))]
    fn sphere(
        radius_m: f64,
        conductivity_s_per_m: f64,
        frequency_hz: f64,
        relative_permeability: f64,
    ) -> PyResult<Self> {
        let sphere = Sphere { radius_m, conductivity_s_per_m, relative_permeability };
        Ok(Self { body: Polarizability::sphere(&sphere, frequency_hz).map_err(Fault::from)? })
    }

    /// Radius of the sphere around it, metres.
    #[getter]
    fn radius_m(&self) -> f64 {
        self.body.radius_m
    }

    /// Its response to the harmonics of a field, shape (h, h), complex.
    #[getter]
    fn tau<'py>(&self, py: Python<'py>) -> PyResult<Array2<'py, Complex64>> {
        let size = dermis_mit::HARMONICS;
        array2(py, plain(self.body.tau()), size, size)
    }

    fn __repr__(&self) -> String {
        format!("<dermis.mit.Body: {} of radius {} m>", self.body.label, self.body.radius_m)
    }
}
