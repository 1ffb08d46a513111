//! Calibrations: positions from pokes at known places, forces from presses with known force.

/// ```
/// use dermis::calibration::{Calibration, CalibrationOptions, PokeFrames, Pokes, calibrate};
/// use dermis::pipeline::Prepared;
/// use dermis::twin::{press_range, random_presses, sample_tables};
/// use dermis::{Pipeline, Skin};
///
/// // Twelve pokes of the twin; yours are made by hand, and read by `read_pokes`.
/// let skin = Skin::open("healing-square")?;
/// let presses = random_presses(&skin.outline(), &press_range(&skin), 12, 7)?;
/// let [untouched, pressed] = sample_tables(&skin, &presses, None, |_done, _all| {})?;
/// let positions_m = presses.iter().map(|press| press[0].centre_m).collect();
/// let pokes = Pokes { positions_m, ..Pokes::default() };
///
/// let prepared = Prepared::new(skin)?;
/// let rows = |table: &dermis::source::FrameTable| table.rows().map(<[f64]>::to_vec).collect::<Vec<_>>();
/// let (baselines, frames) = (rows(&untouched), rows(&pressed));
/// let measured = PokeFrames::Readings { baselines: &baselines, frames: &frames };
/// let options = CalibrationOptions { physics: false, ..CalibrationOptions::default() };
/// let calibration: Calibration = calibrate(&prepared, measured, &pokes, &options)?;
/// assert_eq!(calibration.pokes(), 12);
/// println!("left-out pokes are found within {:.4} m", calibration.leave_one_out().median_error_m);
/// Pipeline::new(prepared, untouched.layout(), Some(calibration))?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::calibrate::calibrate;
/// Shown with [`calibrate`].
pub use dermis_live::calibration::{Calibration, CalibrationOptions, PokeFrames, Pokes, read_pokes};

/// No example: the result of [`Calibration::leave_one_out`].
pub use dermis_touch::locator::LeaveOneOut;

/// ```
/// use dermis::calibration::{CalibrationScope, CurveKind, ForceSample, fit_forces};
///
/// // Presses of 1 to 8 N at one place, and the signal of each: the peak of its image. The layer has no force law.
/// let sample = |force_n| ForceSample { position_m: [0.0, 0.0], force_n, signal: 0.1 * force_n, by_law: None };
/// let samples: Vec<ForceSample> = (1..=8).map(|n| sample(f64::from(n))).collect();
/// let scope = CalibrationScope { skin: "my-pad".into(), indenter_area_m2: 2e-4, date: "2026-01-31".into() };
/// let forces = fit_forces(&samples, CurveKind::Linear, scope)?;
/// let force = forces.read([0.0, 0.0], 0.35, None).expect("a curve of the signal");
/// let newtons = force.valid_n().expect("within the range of the samples");
/// assert!((newtons - 3.5).abs() < 0.01, "{newtons}");
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::forces::fit_forces;
/// No example: the result of [`fit_forces`], which has one.
pub use dermis_touch::force::ForceCalibration;
/// Shown with [`fit_forces`].
pub use dermis_touch::force::{CalibrationScope, CurveKind, ForceSample};

/// No example: samples come from pokes with a column of forces, or from a twin, and take seconds to make.
pub use dermis_lab::forces::{PressPlan, force_samples, press_twin};

/// No example: they write and read the file of `dermis calibrate --forces`, which [`SessionOptions`] names.
///
/// [`SessionOptions`]: crate::SessionOptions
pub use dermis_live::forces::{load_forces, save_forces};
