//! Images and touches of frames in files. Here a twin makes the files; yours come from your instrument: CSV or NumPy,
//! one frame per row. `cargo run --release -p dermis --example offline_images`

use dermis::offline::{Imager, Reference};
use dermis::pipeline::Prepared;
use dermis::source::{FileSpec, read};
use dermis::twin::{SampleRequest, press_range, random_presses, sample};
use dermis::{Error, FileError, Skin};

/// Makes images from files of frames.
pub fn main() -> Result<(), Error> {
    let folder = std::env::temp_dir().join(format!("dermis-offline-images-{}", std::process::id()));
    let failed = |source| Error::Io(FileError { file: folder.clone(), source });
    std::fs::create_dir_all(&folder).map_err(failed)?;
    let skin = Skin::open("healing-square")?;
    let presses = random_presses(&skin.outline(), &press_range(&skin), 3, 7)?;
    let (baseline, frames) = (folder.join("rest.csv"), folder.join("press.csv"));
    let request = SampleRequest {
        skin: skin.clone(),
        presses: presses.clone(),
        baseline: baseline.clone(),
        frames: frames.clone(),
        truth: None,
        seed: None,
        built: None,
        repeats: 1,
    };
    sample(&request, |_, _| {})?;

    // From here on, the code is the same for measured files.
    let (rest, pressed) = (read(&FileSpec::all(&baseline), None)?, read(&FileSpec::all(&frames), None)?);
    let prepared = Prepared::new(skin)?; // Mesh, forward model, Jacobian.
    let rest: Vec<Vec<f64>> = rest.rows().map(<[f64]>::to_vec).collect();
    let reference = Reference::of(&prepared, &rest)?; // Gains, noise, and a check of the channel order.
    let mut imager = Imager::new(&prepared, &reference, &[])?; // The operator.
    let grid = prepared.map.grid();
    let mut image = vec![f32::NAN; grid.len()];
    for (frame, press) in pressed.rows().zip(&presses) {
        imager.image(&reference.difference(frame, None), &mut image)?;
        let sized = |pixel: &usize| if image[*pixel].is_finite() { image[*pixel].abs() } else { 0.0 };
        let peak = (0..grid.len()).max_by(|a, b| sized(a).total_cmp(&sized(b))).unwrap_or(0);
        let (at, true_at) = (grid.centre_m(peak), press[0].centre_m);
        println!("pressed at {true_at:.3?} m, brightest at {at:.3?} m");
        assert!((at[0] - true_at[0]).hypot(at[1] - true_at[1]) < 0.01, "a tenth of the side");
    }
    std::fs::remove_dir_all(&folder).map_err(failed)?;
    Ok(())
}
