//! [`PySkin`], and the values that Python may give in its place.

use std::path::PathBuf;

use dermis_skin::Skin;
use pyo3::inspect::PyStaticExpr;
use pyo3::prelude::*;
use pyo3::type_hint_union;
use pyo3::type_object::PyTypeInfo;

use crate::errors::Fault;
use crate::hints::{PATH, python_types};

/// The type of a skin, its name, its file or its text.
pub const SKIN: PyStaticExpr = type_hint_union!(PySkin::TYPE_HINT, PATH);

python_types! {
    /// A skin, the name of one, its file, or its text.
    SkinLike = SKIN;
}

/// A skin as described by its file.
///
/// Parameters
/// ----------
/// source : Skin, str or os.PathLike
///     A skin, the name of a built-in one, the path of a skin file, or its text.
///
/// Raises
/// ------
/// SkinError
///     The skin is unknown or its file is invalid; the message gives the key, the value and what was expected.
#[pyclass(frozen, module = "dermis", name = "Skin")]
pub struct PySkin {
    /// The skin file.
    pub skin: Skin,
}

/// A skin from any value that Python accepts as one: the object, a name, a path, or the text of a file.
pub fn skin_of(value: &Bound<'_, PyAny>) -> PyResult<Skin> {
    if let Ok(skin) = value.cast::<PySkin>() {
        return Ok(skin.get().skin.clone());
    }
    let path: PathBuf = value.extract().map_err(|_| {
        let expected = "a dermis.Skin, the name of a built-in skin, a path, or the text of a skin file";
        Fault::input("skin", expected, crate::arrays::type_name(value))
    })?;
    let text = path.to_string_lossy().into_owned();
    // A path has no line break, and a skin file always has one.
    let skin = if text.contains('\n') { Skin::parse(&text, "skin") } else { Skin::open(&text) };
    Ok(skin.map_err(Fault::from)?)
}
