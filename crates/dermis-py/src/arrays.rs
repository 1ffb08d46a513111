//! Arrays in and out. A C-ordered, aligned array of native doubles is used without a copy, even if read-only;
//! anything else is converted by NumPy. Returned arrays own their data.

use std::convert::Infallible;

use numpy::ndarray::Dimension;
use numpy::{
    Complex64, Element, IntoPyArray, Ix1, Ix2, Ix3, IxDyn, PyArray, PyArrayDyn, PyArrayMethods, PyReadonlyArrayDyn,
    PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use pyo3::{intern, type_hint_identifier, type_hint_subscript};

use crate::errors::{Fault, Kind};

/// Doubles from Python, C-ordered.
pub struct Doubles<'py> {
    array: PyReadonlyArrayDyn<'py, f64>,
}

impl<'py> Doubles<'py> {
    /// Takes anything that NumPy can convert to real numbers; `what` names it in errors.
    pub fn of(what: &str, value: &Bound<'py, PyAny>) -> PyResult<Self> {
        let array = match value.cast::<PyArrayDyn<f64>>() {
            // Subclasses of NumPy's arrays may carry more than numbers, such as a mask.
            Ok(array) if value.is_exact_instance_of::<PyUntypedArray>() && is_plain(array) => array.clone(),
            _ => converted::<f64>(what, value, "float64", "real numbers", "fiu")?,
        };
        let array = array.try_readonly().map_err(|error| {
            Fault::new(Kind::Input, format!("{what}: the array is being written to at this moment: {error}"))
        })?;
        Ok(Self { array })
    }

    /// Its shape.
    pub fn shape(&self) -> &[usize] {
        self.array.shape()
    }

    /// Its numbers, row after row.
    pub fn values(&self) -> PyResult<&[f64]> {
        Ok(self.array.as_slice().map_err(|error| Fault::new(Kind::Internal, format!("array: {error}")))?)
    }

    /// Takes a vector of the given length.
    pub fn vector(what: &str, value: &Bound<'py, PyAny>, length: usize, of: &str) -> PyResult<Self> {
        let doubles = Self::of(what, value)?;
        if doubles.shape() != [length] {
            return Err(Fault::input(what, format!("shape ({length},), {of}"), shape_text(doubles.shape())).into());
        }
        Ok(doubles)
    }

    /// Takes rows of the given length, or a single row without the row axis; returns the array and whether it had the
    /// row axis.
    pub fn rows(what: &str, value: &Bound<'py, PyAny>, length: usize, of: &str) -> PyResult<(Self, bool)> {
        let doubles = Self::of(what, value)?;
        let (fits, single) = match doubles.shape() {
            [columns] => (*columns == length, true),
            [_, columns] => (*columns == length, false),
            _ => (false, false),
        };
        if !fits {
            let expected = format!("shape (n, {length}) or ({length},), {of}");
            return Err(Fault::input(what, expected, shape_text(doubles.shape())).into());
        }
        Ok((doubles, single))
    }

    /// The rows as vectors.
    pub fn to_rows(&self) -> PyResult<Vec<Vec<f64>>> {
        let columns = self.shape().last().copied().unwrap_or(1).max(1);
        Ok(self.values()?.chunks_exact(columns).map(<[f64]>::to_vec).collect())
    }

    /// Rejects NaN and infinities.
    pub fn finite(self, what: &str) -> PyResult<Self> {
        match self.values()?.iter().position(|value| !value.is_finite()) {
            Some(at) => {
                let place = index_text(self.shape(), at);
                Err(Fault::input(what, "finite numbers", format!("{} at {place}", self.values()?[at])).into())
            }
            None => Ok(self),
        }
    }
}

/// Takes indices: whole numbers from 0 to below a limit; returns them with the array's shape.
pub fn indices(what: &str, value: &Bound<'_, PyAny>, below: usize, of: &str) -> PyResult<(Vec<u32>, Vec<usize>)> {
    let array = converted::<i64>(what, value, "int64", "whole numbers", "iu")?;
    let array = array.try_readonly().map_err(|error| Fault::new(Kind::Input, format!("{what}: {error}")))?;
    let values = array.as_slice().map_err(|error| Fault::new(Kind::Internal, format!("array: {error}")))?;
    let limit = below.min(u32::MAX as usize);
    let index = |(at, &value): (usize, &i64)| match usize::try_from(value) {
        Ok(value) if value < limit => Ok(value as u32),
        _ => {
            let place = index_text(array.shape(), at);
            Err(Fault::input(
                what,
                format!("indices of {of}, 0 to {}", limit.saturating_sub(1)),
                format!("{value} at {place}"),
            ))
        }
    };
    let list = values.iter().enumerate().map(index).collect::<Result<Vec<u32>, Fault>>()?;
    Ok((list, array.shape().to_vec()))
}

fn is_plain<T: Element>(array: &Bound<'_, PyArrayDyn<T>>) -> bool {
    array.is_c_contiguous() && (array.data() as usize).is_multiple_of(std::mem::align_of::<T>())
}

/// Converts with NumPy to a native, aligned, C-ordered array. `kinds` are the data type kinds to accept.
fn converted<'py, T: Element>(
    what: &str,
    value: &Bound<'py, PyAny>,
    dtype: &str,
    expected: &str,
    kinds: &str,
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let py = value.py();
    let numpy = py.import(intern!(py, "numpy"))?;
    let refuse = |got: String| PyErr::from(Fault::input(what, expected, got));
    let masked = numpy.getattr("ma")?.getattr("MaskedArray")?;
    if value.is_instance(&masked)? {
        return Err(refuse("a masked array; .filled(numpy.nan) marks masked values as missing".into()));
    }
    let plain = numpy.call_method1(intern!(py, "asarray"), (value,)).map_err(|error| {
        if error.is_instance_of::<pyo3::exceptions::PyException>(py) {
            refuse(format!("{}, which is not an array ({})", type_name(value), error.value(py)))
        } else {
            error
        }
    })?;
    let kind: String = plain.getattr("dtype")?.getattr("kind")?.extract()?;
    let empty = plain.getattr("size")?.extract::<usize>()? == 0;
    let is_taken = kinds.contains(&kind) || (empty && kind == "f");
    if !is_taken {
        return Err(refuse(format!("an array of {}", plain.getattr("dtype")?.str()?)));
    }
    let options = PyDict::new(py);
    options.set_item("dtype", dtype)?;
    options.set_item("requirements", ("C", "A"))?;
    let shaped = numpy.call_method("require", (plain,), Some(&options))?;
    shaped.cast_into::<PyArrayDyn<T>>().map_err(|error| refuse(error.to_string()))
}

/// A shape in Python's notation, `(3, 4)`.
pub fn shape_text(shape: &[usize]) -> String {
    let numbers: Vec<String> = shape.iter().map(ToString::to_string).collect();
    let comma = if shape.len() == 1 { "," } else { "" };
    format!("shape ({}{comma})", numbers.join(", "))
}

fn index_text(shape: &[usize], mut at: usize) -> String {
    let mut place = vec![0; shape.len()];
    for (axis, &length) in shape.iter().enumerate().rev() {
        let length = length.max(1);
        place[axis] = at % length;
        at /= length;
    }
    let numbers: Vec<String> = place.iter().map(ToString::to_string).collect();
    format!("[{}]", numbers.join(", "))
}

/// Name of a value's type.
pub fn type_name(value: &Bound<'_, PyAny>) -> String {
    value.get_type().name().map_or_else(|_| "a value".into(), |name| name.to_string())
}

/// An array for Python, where its type is `NDArray` of the scalar.
pub struct Array<'py, T: Element, D>(Bound<'py, PyArray<T, D>>);

/// A vector.
pub type Array1<'py, T> = Array<'py, T, Ix1>;
/// A table.
pub type Array2<'py, T> = Array<'py, T, Ix2>;
/// A stack of tables.
pub type Array3<'py, T> = Array<'py, T, Ix3>;
/// An array with any number of axes.
pub type ArrayDyn<'py, T> = Array<'py, T, IxDyn>;

impl<'py, T: Element, D: Dimension> Array<'py, T, D> {
    /// Forgets the number of axes.
    pub fn into_dyn(self) -> ArrayDyn<'py, T> {
        Array(self.0.to_dyn().clone())
    }

    /// The array without the interpreter lock.
    pub fn unbind(self) -> Py<PyArray<T, D>> {
        self.0.unbind()
    }
}

impl<'py, T: Element, D> From<Bound<'py, PyArray<T, D>>> for Array<'py, T, D> {
    fn from(array: Bound<'py, PyArray<T, D>>) -> Self {
        Self(array)
    }
}

impl<'py, T: Element, D> From<Array<'py, T, D>> for Bound<'py, PyArray<T, D>> {
    fn from(array: Array<'py, T, D>) -> Self {
        array.0
    }
}

impl<'py, T: Scalar, D: Dimension> IntoPyObject<'py> for Array<'py, T, D> {
    type Target = PyArray<T, D>;
    type Output = Bound<'py, PyArray<T, D>>;
    type Error = Infallible;
    const OUTPUT_TYPE: PyStaticExpr =
        type_hint_subscript!(type_hint_identifier!("numpy.typing", "NDArray"), type_hint_identifier!("numpy", T::NAME));

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Infallible> {
        Ok(self.0)
    }
}

/// A number in arrays.
pub trait Scalar: Element {
    /// Its name in NumPy.
    const NAME: &'static str;
}

macro_rules! scalars {
    ($($type:ty: $name:literal),*) => {$(
        impl Scalar for $type {
            const NAME: &'static str = $name;
        }
    )*};
}

scalars!(
    bool: "bool_", i32: "int32", i64: "int64", u32: "uint32", u64: "uint64", f32: "float32", f64: "float64",
    Complex64: "complex128"
);

/// A one-dimensional array.
pub fn array1<T: Element>(py: Python<'_>, values: Vec<T>) -> Array1<'_, T> {
    Array(values.into_pyarray(py))
}

/// A two-dimensional array.
pub fn array2<T: Element>(py: Python<'_>, values: Vec<T>, rows: usize, columns: usize) -> PyResult<Array2<'_, T>> {
    Ok(Array(values.into_pyarray(py).reshape([rows, columns])?))
}

/// A stack of images.
pub fn array3<T: Element>(
    py: Python<'_>,
    values: Vec<T>,
    [images, rows, columns]: [usize; 3],
) -> PyResult<Array3<'_, T>> {
    Ok(Array(values.into_pyarray(py).reshape([images, rows, columns])?))
}

/// An array that Python cannot write to, because the object returns it repeatedly.
pub fn read_only<'py, T: Element, D: Dimension>(array: Array<'py, T, D>) -> PyResult<Array<'py, T, D>> {
    array.0.call_method1("setflags", (false,))?;
    Ok(array)
}
