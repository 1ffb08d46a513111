//! Catalogue of the bodies that represent the elements of magnetic induction skins. Their multipole matrices tau are
//! computed with edge elements once per shape, material and frequency (seconds) and stored: those of the built-in
//! skins in the program, all others in the user's cache directory.

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

/// Frequencies of the built-in records, in Hz: the published band and the drive frequencies of the published skins.
pub const SWEEP_HZ: [f64; 8] = [1e3, 2e3, 5e3, 10e3, 20e3, 30e3, 55e3, 100e3];

/// Value of [`BodyRecord::format`].
const FORMAT: &str = "dermis-body-1";
/// Relative difference up to which keys are considered equal.
const SAME: f64 = 1e-12;
/// Row, column, real part, imaginary part. Files number harmonics from 0 and omit zeros and entries below the
/// diagonal.
type Entry = (usize, usize, f64, f64);

const MM: f64 = 1e-3;

/// The tau of an element on disk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BodyRecord {
    /// `dermis-body-1`.
    pub format: String,
    /// The element.
    pub element: Element,
    /// The frequency.
    pub frequency_hz: f64,
    /// Maximum degree of the harmonics; records with another degree cannot be used.
    pub degree: usize,
    /// Row, column, real and imaginary part of the nonzero entries on and above the diagonal. Harmonics are in the
    /// order of [`crate::regular`], counted from 0; entry (i, j) is in H.m^(li + lj).
    pub tau: Vec<Entry>,
}

/// The response of an element at a frequency: in closed form for a ball, otherwise from the built-in records, the
/// cache, or edge elements, in this order. Computed results go into the cache.
///
/// # Errors
/// Invalid sizes, conductivity or permeability, or a frequency outside 1 Hz to 1 MHz. A cache that cannot be read or
/// written only causes a warning.
pub fn body_of(element: &Element, frequency_hz: f64) -> Result<Polarizability, MitError> {
    body_cached(element, frequency_hz, cache_directory().as_deref())
}

/// True if [`body_of`] has to solve for this element: no closed form, no built-in record and no cached one.
pub fn needs_solving(element: &Element, frequency_hz: f64) -> bool {
    let is_built_in =
        || builtin_records().is_ok_and(|records| records.iter().any(|record| record.is_of(element, frequency_hz)));
    let is_kept = || cache_directory().is_some_and(|cache| cache.join(file_name(element, frequency_hz)).exists());
    !matches!(element.shape, ElementShape::Sphere { .. }) && !is_built_in() && !is_kept()
}

/// [`body_of`] with a given cache directory, or without a cache.
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
    info!("computing the response of {} at {frequency_hz} Hz, once", name_of(element));
    let record = compute(element, frequency_hz)?;
    if let Some(file) = &file
        && let Err(error) = write(file, &record)
    {
        warn!("cannot keep {}: {error}", file.display());
    }
    record.body()
}

/// Computes a record with second-order edge elements ([`body_tau`]); takes seconds.
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
            warn!("cannot read {}: {error}; recomputing", file.display());
            return None;
        }
    };
    let found = serde_json::from_str::<BodyRecord>(&text).map_err(|error| error.to_string()).and_then(|record| {
        if record.format != FORMAT || !record.is_of(element, frequency_hz) {
            return Err("it is of another element, frequency, degree or version".into());
        }
        record.body().map_err(|error| error.to_string())
    });
    found.map_err(|error| warn!("{} cannot be used: {error}; recomputing", file.display())).ok()
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

    /// The record as a body over coils.
    ///
    /// # Errors
    /// Entries that do not exist, or non-finite numbers.
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

/// The built-in records: those of the built-in skins, and the larger of their two kinds from 1 to 100 kHz.
///
/// # Errors
/// Never, as a test ensures.
pub fn builtin_records() -> Result<Vec<BodyRecord>, MitError> {
    serde_json::from_str(include_str!("../bodies.json"))
        .map_err(|error| MitError::Record { what: "bodies.json".into(), reason: error.to_string() })
}

/// `$DERMIS_CACHE`, or `dermis` in the user's cache directory; `None` if neither exists.
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
    // Atomic, even if several processes write the same record.
    let beside = file.with_extension(format!("partial-{}", std::process::id()));
    fs::write(&beside, text)?;
    fs::rename(&beside, file)
}
