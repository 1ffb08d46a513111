//! Images and touches of frames in files.

/// ```
/// use dermis::Skin;
/// use dermis::offline::{ReconstructReport, ReconstructRequest, reconstruct};
/// use dermis::source::{FileSpec, ReadOptions};
/// use dermis::twin::{SampleRequest, press_range, random_presses, sample};
///
/// let folder = std::env::temp_dir().join(format!("dermis-reconstruct-{}", std::process::id()));
/// # let failed = |source| dermis::FileError { file: folder.clone(), source };
/// # std::fs::create_dir_all(&folder).map_err(failed)?;
/// // Files of a twin; yours come from your instrument.
/// let skin = Skin::open("healing-square")?;
/// let (baseline, frames) = (folder.join("rest.csv"), folder.join("press.csv"));
/// let presses = random_presses(&skin.outline(), &press_range(&skin), 2, 7)?;
/// let request = SampleRequest {
///     skin: skin.clone(),
///     presses,
///     baseline: baseline.clone(),
///     frames: frames.clone(),
///     truth: None,
///     seed: None,
///     built: None,
///     repeats: 1,
/// };
/// sample(&request, |_done, _all| {})?;
///
/// let request = ReconstructRequest {
///     skin,
///     baseline: Some(FileSpec::all(baseline)),
///     frames: FileSpec::all(frames),
///     read: ReadOptions::default(),
///     as_skin: false,
///     calibration: None,
///     forces: None,
///     hyperparameter: None,
///     touches: Some(folder.join("touches.csv")),
///     images: Some(folder.join("images.npy")),
/// };
/// let report: ReconstructReport = reconstruct(&request, |_done, _all| {})?;
/// assert_eq!((report.frames, report.touch_rows), (2, 2));
/// # std::fs::remove_dir_all(&folder).map_err(failed)?;
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_lab::reconstruct::reconstruct;
/// Shown with [`reconstruct`].
pub use dermis_lab::reconstruct::{Report as ReconstructReport, Request as ReconstructRequest};

/// ```
/// use dermis::Skin;
/// use dermis::offline::{Imager, Reference};
/// use dermis::pipeline::Prepared;
///
/// let prepared = Prepared::new(Skin::open("healing-square")?)?;
/// let rest = vec![prepared.voltages.clone(); 2];
/// let touch = prepared.signatures(&[[0.01, -0.02]]);
/// let pressed: Vec<f64> = rest[0].iter().zip(&touch).map(|(rest, change)| rest + 0.3 * change).collect();
///
/// let reference = Reference::of(&prepared, &rest)?; // Gains and noise.
/// let mut imager = Imager::new(&prepared, &reference, &[])?; // The operator.
/// let grid = prepared.map.grid();
/// let mut image = vec![f32::NAN; grid.len()];
/// imager.image(&reference.difference(&pressed, None), &mut image)?;
/// let size = |pixel: &usize| if image[*pixel].is_finite() { image[*pixel].abs() } else { 0.0 };
/// let peak = (0..grid.len()).max_by(|a, b| size(a).total_cmp(&size(b))).expect("the image has pixels");
/// let [x, y] = grid.centre_m(peak);
/// assert!((x - 0.01).hypot(y + 0.02) < 0.01);
/// # Ok::<(), dermis::Error>(())
/// ```
pub use dermis_live::imager::Imager;
/// Shown with [`Imager`].
pub use dermis_live::reference::Reference;
