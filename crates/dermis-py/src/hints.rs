//! Values of Python by their Python types: pyo3 shows these types in the stubs (`_dermis.pyi`) where a Rust type cannot
//! tell them. Unions and dictionaries have their names in `python/dermis/_types.py`.

use std::convert::Infallible;
use std::marker::PhantomData;
use std::path::PathBuf;

use pyo3::inspect::{PyStaticConstant, PyStaticExpr};
use pyo3::prelude::*;
use pyo3::type_object::PyTypeInfo;
use pyo3::types::PyDict;
use pyo3::{type_hint_identifier as name, type_hint_subscript as subscript, type_hint_union};

use crate::arrays::{Array1, Array2, Array3};

/// A name in `python/dermis/_types.py`.
macro_rules! own {
    ($name:literal) => {
        name!("dermis._types", $name)
    };
}

/// The type of arrays and what NumPy can convert to them.
pub const ARRAY_LIKE: PyStaticExpr = name!("numpy.typing", "ArrayLike");
/// The type of paths and texts.
pub const PATH: PyStaticExpr = <PathBuf as FromPyObject>::INPUT_TYPE;
/// `...` in types.
pub const ELLIPSIS: PyStaticExpr = PyStaticExpr::Constant { value: PyStaticConstant::Ellipsis };

/// Defines a wrapper of any Python object for each type.
macro_rules! python_types {
    ($($(#[$doc:meta])* $of:ident = $hint:expr;)*) => {$(
        $(#[$doc])*
        pub struct $of<'py>(pub pyo3::Bound<'py, pyo3::PyAny>);

        impl<'py> pyo3::FromPyObject<'_, 'py> for $of<'py> {
            type Error = std::convert::Infallible;
            const INPUT_TYPE: pyo3::inspect::PyStaticExpr = $hint;

            fn extract(object: pyo3::Borrowed<'_, 'py, pyo3::PyAny>) -> Result<Self, Self::Error> {
                Ok(Self(object.to_owned()))
            }
        }

        impl<'py> pyo3::IntoPyObject<'py> for $of<'py> {
            type Target = pyo3::PyAny;
            type Output = pyo3::Bound<'py, pyo3::PyAny>;
            type Error = std::convert::Infallible;
            const OUTPUT_TYPE: pyo3::inspect::PyStaticExpr = $hint;

            fn into_pyobject(self, _: pyo3::Python<'py>) -> Result<Self::Output, Self::Error> {
                Ok(self.0)
            }
        }

        impl<'py> std::ops::Deref for $of<'py> {
            type Target = pyo3::Bound<'py, pyo3::PyAny>;

            fn deref(&self) -> &Self::Target {
                &self.0
            }
        }
    )*};
}
pub(crate) use python_types;

python_types! {
    /// Anything that NumPy can convert to an array.
    ArrayLike = ARRAY_LIKE;
    /// A data type of NumPy, or its name.
    DTypeLike = name!("numpy.typing", "DTypeLike");
    /// An array of any type.
    AnyArray = own!("AnyArray");
    /// Touches as a structured array.
    Touches = own!("Touches");
    /// Times, readings and images of a session.
    SessionArrays = <(Array1<'static, f64>, Array2<'static, f64>, Array3<'static, f32>) as IntoPyObject>::OUTPUT_TYPE;
    /// A source of frames.
    Source = own!("Source");
    /// A prior as in a skin file.
    PriorChoice = own!("PriorChoice");
    /// A hyperparameter or a rule for it, as in a skin file.
    HyperparameterChoice = own!("HyperparameterChoice");
    /// A hyperparameter or a rule for it.
    Rule = own!("Rule");
    /// Name of a pattern, or pairs of electrodes.
    Patterns = type_hint_union!(name!("builtins", "str"), ARRAY_LIKE);
    /// The callable that restores a pickled object from its arguments.
    Restorer = subscript!(name!("collections.abc", "Callable"), ELLIPSIS, name!("builtins", "object"));
    /// Class of an exception.
    ExceptionClass = subscript!(name!("builtins", "type"), name!("builtins", "BaseException"));
    /// An exception.
    Exception = name!("builtins", "BaseException");
    /// The traceback of an exception.
    Traceback = name!("types", "TracebackType");
    /// Axes to draw on.
    Axes = name!("matplotlib.axes", "Axes");
    /// A table of pandas.
    DataFrame = name!("pandas", "DataFrame");
    /// A table of Arrow.
    Table = name!("pyarrow", "Table");
    /// An array of xarray.
    DataArray = name!("xarray", "DataArray");
    /// Frames of a file.
    FileFrames = name!("dermis._tables", "FileFrames");
    /// The health of a skin.
    Health = own!("Health");
    /// The guard's verdict.
    Guard = own!("Guard");
    /// Damage found on a monitored skin.
    DamageWatch = own!("DamageWatch");
    /// A baseline of a recording.
    Baseline = own!("Baseline");
    /// An event of a recording.
    Event = own!("Event");
    /// A search for the order of channels.
    FoundOrder = own!("FoundOrder");
    /// An estimate of a conductance.
    FoundConductance = own!("FoundConductance");
}

/// Numbers by their names: a dictionary with values of one type.
pub struct Named<'py, T>(Bound<'py, PyDict>, PhantomData<T>);

impl<'py, T: IntoPyObject<'py>> Named<'py, T> {
    /// A dictionary of these names and values.
    pub fn of<const N: usize>(py: Python<'py>, entries: [(&str, T); N]) -> PyResult<Self> {
        let dict = PyDict::new(py);
        for (name, value) in entries {
            dict.set_item(name, value)?;
        }
        Ok(Self(dict, PhantomData))
    }
}

impl<'py, T: IntoPyObject<'py>> IntoPyObject<'py> for Named<'py, T> {
    type Target = PyDict;
    type Output = Bound<'py, PyDict>;
    type Error = Infallible;
    const OUTPUT_TYPE: PyStaticExpr = subscript!(PyDict::TYPE_HINT, name!("builtins", "str"), T::OUTPUT_TYPE);

    fn into_pyobject(self, _: Python<'py>) -> Result<Self::Output, Infallible> {
        Ok(self.0)
    }
}

/// Defines a type for each closed set of words, shown as `Literal`.
macro_rules! words {
    ($($(#[$doc:meta])* $of:ident = $($word:literal)|+;)*) => {$(
        $(#[$doc])*
        pub struct $of(&'static str);

        impl $of {
            /// One of these words.
            pub fn of(word: &'static str) -> Self {
                debug_assert!([$($word),+].contains(&word), "{word} is none of {:?}", [$($word),+]);
                Self(word)
            }
        }

        impl<'py> IntoPyObject<'py> for $of {
            type Target = PyAny;
            type Output = Bound<'py, PyAny>;
            type Error = PyErr;
            const OUTPUT_TYPE: PyStaticExpr = subscript!(
                name!("typing", "Literal"),
                $(PyStaticExpr::Constant { value: PyStaticConstant::Str($word) }),+
            );

            fn into_pyobject(self, py: Python<'py>) -> PyResult<Self::Output> {
                Ok(self.0.into_pyobject(py)?.into_any())
            }
        }
    )*};
}

words! {
    /// Physical principle of a skin.
    Modality = "eit" | "mit";
    /// Parts of a mesh that an electrode covers.
    ElectrodeKind = "edges" | "faces" | "elements" | "point";
}
