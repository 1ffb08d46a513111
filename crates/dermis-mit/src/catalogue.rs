//! The bodies that elements of magnetic induction skins are for the fields: their multipole matrices tau come from edge
//! elements once for a shape, a material and a frequency (seconds), and are kept: those of the built-in skins in the
//! program, all others in a directory of the user's.

use std::fs;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use tracing::{info, warn};

use crate::edge::{Material, body_tau};
use crate::element::{Element, ElementShape};
use crate::error::MitError;
use crate::harmonics::{HARMONICS, MOST_DEGREE};
use crate::polarizability::Polarizability;
use crate::sphere::Sphere;
use crate::vector::Complex;

/// Frequencies of the program's own records, in Hz: the published band and the drives of the published skins.
pub const SWEEP_HZ: [f64; 8] = [1e3, 2e3, 5e3, 10e3, 20e3, 30e3, 55e3, 100e3];

/// What [`BodyRecord::format`] says.
const FORMAT: &str = "dermis-body-1";
/// Relative differences of keys that count as none.
const SAME: f64 = 1e-12;
/// Harmonics are numbered from 0 in the files, entries below the diagonal are left out, as are zeros.
type Entry = (usize, usize, f64, f64);

const MM: f64 = 1e-3;

/// An element's tau on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyRecord {
    /// `dermis-body-1`.
    pub format: String,
    /// Of what.
    pub element: Element,
    /// At which frequency.
    pub frequency_hz: f64,
    /// Highest degree of the harmonics; those of another are of no use here.
    pub degree: usize,
    /// Row, column, real and imaginary part of the entries on and above the diagonal that are not zero; harmonics in
    /// the order of [`crate::regular`], counted from 0; entry (i, j) in H.m^(li + lj).
    pub tau: Vec<Entry>,
}

/// Its answer at a frequency: closed form for a ball, else from the program's own records, the cache, or edge elements,
/// in this order; what was computed goes into the cache.
///
/// # Errors
/// Sizes, conductivity or permeability that make no sense, a frequency outside 1 Hz to 1 MHz. A cache that cannot be
/// read or written is only warned of.
pub fn body_of(element: &Element, frequency_hz: f64) -> Result<Polarizability, MitError> {
    body_cached(element, frequency_hz, cache_directory().as_deref())
}

/// Whether [`body_of`] has to solve for this element: no closed form, not in the program, not in the cache.
pub fn needs_solving(element: &Element, frequency_hz: f64) -> bool {
    let is_built_in =
        || builtin_records().is_ok_and(|records| records.iter().any(|record| record.is_of(element, frequency_hz)));
    let is_kept = || cache_directory().is_some_and(|cache| cache.join(file_name(element, frequency_hz)).exists());
    !matches!(element.shape, ElementShape::Sphere { .. }) && !is_built_in() && !is_kept()
}

/// [`body_of`] with a cache of one's own, or none.
///
/// # Errors
/// As [`body_of`].
pub fn body_cached(element: &Element, frequency_hz: f64, cache: Option<&Path>) -> Result<Polarizability, MitError> {
    if let ElementShape::Sphere { diameter_mm } = element.shape {
        let sphere = Sphere {
            radius_m: 0.5 * diameter_mm * MM,
            conductivity_s_per_m: element.conductivity_s_per_m,
            relative_permeability: element.relative_permeability,
        };
        return Polarizability::sphere(&sphere, frequency_hz);
    }
    if let Some(record) = builtin_records()?.iter().find(|record| record.is_of(element, frequency_hz)) {
        return record.body();
    }
    let file = cache.map(|directory| directory.join(file_name(element, frequency_hz)));
    if let Some(body) = file.as_deref().and_then(|file| read(element, frequency_hz, file)) {
        return Ok(body);
    }
    info!("computing the answer of {} at {frequency_hz} Hz, once", name_of(element));
    let record = compute(element, frequency_hz)?;
    if let Some(file) = &file
        && let Err(error) = write(file, &record)
    {
        warn!("cannot keep {}: {error}", file.display());
    }
    record.body()
}

/// By edge elements of second order ([`body_tau`]); seconds.
///
/// # Errors
/// As [`body_of`].
pub fn compute(element: &Element, frequency_hz: f64) -> Result<BodyRecord, MitError> {
    let material = Material {
        conductivity_s_per_m: element.conductivity_s_per_m,
        relative_permeability: element.relative_permeability,
    };
    let body = body_tau(&element.shape.solid(), &material, frequency_hz)?;
    let tau = (0..HARMONICS)
        .flat_map(|i| (i..HARMONICS).map(move |j| (i, j)))
        .map(|(i, j)| (i, j, body.tau()[i * HARMONICS + j]))
        .filter(|(.., value)| value.norm() > 0.0)
        .map(|(i, j, value)| (i, j, value.re, value.im))
        .collect();
    Ok(BodyRecord { format: FORMAT.into(), element: *element, frequency_hz, degree: MOST_DEGREE, tau })
}

fn read(element: &Element, frequency_hz: f64, file: &Path) -> Option<Polarizability> {
    let text = match fs::read_to_string(file) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
        Err(error) => {
            warn!("cannot read {}: {error}; computing anew", file.display());
            return None;
        }
    };
    let found = serde_json::from_str::<BodyRecord>(&text).map_err(|error| error.to_string()).and_then(|record| {
        if record.format != FORMAT || !record.is_of(element, frequency_hz) {
            return Err("it is of another element, frequency, degree or version".into());
        }
        record.body().map_err(|error| error.to_string())
    });
    found.map_err(|error| warn!("{} is of no use: {error}; computing anew", file.display())).ok()
}

fn name_of(element: &Element) -> String {
    match element.shape {
        ElementShape::Sphere { diameter_mm } => format!("sphere-{diameter_mm}mm"),
        ElementShape::Cylinder { diameter_mm, height_mm } => format!("cylinder-{diameter_mm}x{height_mm}mm"),
        ElementShape::Plate { side_mm, height_mm } => format!("plate-{side_mm}x{height_mm}mm"),
    }
}

fn file_name(element: &Element, frequency_hz: f64) -> String {
    let Element { conductivity_s_per_m, relative_permeability, .. } = element;
    format!("{}-{conductivity_s_per_m:e}-mu{relative_permeability}-{frequency_hz}Hz.json", name_of(element))
}

impl BodyRecord {
    fn is_of(&self, element: &Element, frequency_hz: f64) -> bool {
        let key = |e: &Element, f: f64| {
            let (kind, a, b) = match e.shape {
                ElementShape::Sphere { diameter_mm } => (0.0, diameter_mm, diameter_mm),
                ElementShape::Cylinder { diameter_mm, height_mm } => (1.0, diameter_mm, height_mm),
                ElementShape::Plate { side_mm, height_mm } => (2.0, side_mm, height_mm),
            };
            [kind, a, b, e.conductivity_s_per_m, e.relative_permeability, f]
        };
        let (a, b) = (key(&self.element, self.frequency_hz), key(element, frequency_hz));
        self.degree == MOST_DEGREE && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= SAME * b.abs())
    }

    /// As a body over coils.
    ///
    /// # Errors
    /// Entries that do not exist, numbers that are not finite.
    pub fn body(&self) -> Result<Polarizability, MitError> {
        let mut tau = vec![Complex::new(0.0, 0.0); HARMONICS * HARMONICS];
        for &(i, j, re, im) in &self.tau {
            if i > j || j >= HARMONICS {
                return Err(MitError::Record {
                    what: format!("tau of {}", name_of(&self.element)),
                    reason: format!(
                        "expected entries on or above the diagonal of {HARMONICS} harmonics, got ({i}, {j})"
                    ),
                });
            }
            tau[i * HARMONICS + j] = Complex::new(re, im);
            tau[j * HARMONICS + i] = Complex::new(re, im);
        }
        let shape = self.element.shape;
        Ok(Polarizability::from_tau(name_of(&self.element), shape.solid().radius_m(), tau)?
            .with_inner_radius(shape.inner_radius_m()))
    }
}

/// Those that come with the program: of the built-in skins, and the larger of their two kinds from 1 to 100 kHz.
///
/// # Errors
/// None, as a test sees to.
pub fn builtin_records() -> Result<Vec<BodyRecord>, MitError> {
    serde_json::from_str(include_str!("../bodies.json"))
        .map_err(|error| MitError::Record { what: "bodies.json".into(), reason: error.to_string() })
}

/// `$DERMIS_CACHE`, or `dermis` in the user's directory for caches; none where there is neither.
pub fn cache_directory() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    set("DERMIS_CACHE")
        .or_else(|| set("XDG_CACHE_HOME").map(|directory| directory.join("dermis")))
        .or_else(|| set("HOME").map(|directory| directory.join(".cache/dermis")))
}

fn write(file: &Path, record: &BodyRecord) -> std::io::Result<()> {
    let text = serde_json::to_string(record)?;
    if let Some(directory) = file.parent() {
        fs::create_dir_all(directory)?;
    }
    // Whole or not at all, whoever else writes the same.
    let beside = file.with_extension(format!("partial-{}", std::process::id()));
    fs::write(&beside, text)?;
    fs::rename(&beside, file)
}
