//! Turns recorded frames into images and touches offline; the work behind `dermis reconstruct`.

use dermis_live::imager::Refiner;
use std::path::PathBuf;

use dermis_device::{FileSpec, ReadOptions};
use dermis_tomo::eit::OrderReport;
use dermis_touch::health::{FrameFault, FrameFaultKind, Health};
use dermis_touch::{Observation, Touch};

use crate::Error;
use crate::odd_frames::{describe, describe_baseline, odd};
use dermis_live::as_built;
use dermis_live::calibration::{
    CalibratedImager, Calibration, CircuitFit, PlacementFinder, find_circuit, relative_changes, set_channels,
};
use dermis_live::channels::ChannelReader;
use dermis_live::forces::{load_forces, parse_forces_as};
use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::reference::{NoiseSource, Reference, are_pairs};
use dermis_live::skin_frame::SkinFrame;
use dermis_record::sink::{ImageStack, Sink, TouchColumns, TouchTable};
use dermis_skin::{CircuitChoice, HyperparameterChoice, Skin};

/// Input and output of a reconstruction.
#[derive(Clone, Debug)]
pub struct Request {
    /// The skin.
    pub skin: Skin,
    /// Baseline frames: one or more, or as many as there are frames. In the latter case each frame has its own
    /// baseline, and frames are independent of each other. `None` if the frames are already differences from the
    /// untouched skin.
    pub baseline: Option<FileSpec>,
    /// The frames.
    pub frames: FileSpec,
    /// How to read both files.
    pub read: ReadOptions,
    /// Accept recordings and calibrations of another skin as this skin's.
    pub as_skin: bool,
    /// A calibration of the skin.
    pub calibration: Option<PathBuf>,
    /// A force calibration of the skin.
    pub forces: Option<PathBuf>,
    /// lambda, overriding the skin file's rule.
    pub hyperparameter: Option<f64>,
    /// Output file of the touches, with columns frame, id, x_mm, y_mm, amplitude, area_mm2, sigma_x_mm, sigma_y_mm; a
    /// frame without touch has no row.
    pub touches: Option<PathBuf>,
    /// Output file of the images: NPY, frames x rows x columns, f32, row 0 at the top, NaN outside.
    pub images: Option<PathBuf>,
}

/// Summary of a reconstruction.
#[derive(Clone, Debug)]
pub struct Report {
    /// Mismatches of scale and sign between model, baseline and frames, as messages.
    pub mismatches: Vec<String>,
    /// Frames reconstructed.
    pub frames: usize,
    /// Rows in the table of touches.
    pub touch_rows: usize,
    /// lambda.
    pub hyperparameter: f64,
    /// Frames with missing channels.
    pub frames_with_missing: usize,
    /// Channels excluded from all frames, from 0, because they change even without a touch.
    pub left_out: Vec<u32>,
    /// Number of frames averaged for the baseline; `None` if each frame has its own or frames are differences.
    pub averaged: Option<usize>,
    /// Source of the channel noise.
    pub noise_source: NoiseSource,
    /// Comparison of the baseline with the skin's model.
    pub order: OrderReport,
    /// The fitted circuit, if the skin file asks for one (`backend.circuit = "learn"`).
    pub circuit: Option<CircuitFit>,
}

/// Reconstructs all frames. `progress` gets the work done and the total: frames, or Gauss-Newton steps if the skin
/// file asks for them.
///
/// # Errors
/// Files cannot be read or don't fit the skin, the calibration belongs to another skin, or an output cannot be
/// written. No partial file is left under its final name.
pub fn reconstruct(request: &Request, progress: impl FnMut(usize, usize)) -> Result<Report, Error> {
    reconstruct_to(request, None, None, progress)
}

/// [`reconstruct`] for use inside a program: accepts a calibration that is not in a file, and an extra sink next to
/// the request's files.
///
/// # Errors
/// As for [`reconstruct`], and errors of the sink.
pub fn reconstruct_into(
    request: &Request,
    calibration: Option<&Calibration>,
    sink: &mut dyn Sink,
    progress: impl FnMut(usize, usize),
) -> Result<Report, Error> {
    reconstruct_to(request, calibration, Some(sink), progress)
}

/// The reference of baselines: one for each frame, or all for every frame.
pub(crate) fn reference_of(prepared: &Prepared, baselines: &[Vec<f64>], paired: bool) -> Result<Reference, Error> {
    Ok(if paired { Reference::of_pairs } else { Reference::of }(prepared, baselines)?)
}

/// Replaces a skin as drawn, and its reference, by the skin as built if its baselines show how it was built.
pub(crate) fn learn_from_rest(
    prepared: &mut Prepared,
    reference: &mut Reference,
    baselines: &[Vec<f64>],
    paired: bool,
) -> Result<(), Error> {
    if let Some(built) = as_built::from_rest(prepared, reference)? {
        *prepared = built;
        *reference = reference_of(prepared, baselines, paired)?;
    }
    Ok(())
}

fn reconstruct_to(
    request: &Request,
    at_hand: Option<&Calibration>,
    mut beside: Option<&mut dyn Sink>,
    mut progress: impl FnMut(usize, usize),
) -> Result<Report, Error> {
    let mut skin = request.skin.clone();
    if let Some(lambda) = request.hyperparameter {
        skin.imaging.hyperparameter = HyperparameterChoice::Number(lambda);
    }
    // Offline every frame counts by itself: report a touch at first sight.
    skin.touch.least_frames = 1;
    skin.backend.differences |= request.baseline.is_none();
    if !request.as_skin && request.read.format.is_none() {
        request
            .baseline
            .iter()
            .chain([&request.frames])
            .try_for_each(|file| dermis_record::check_skin(file, &request.skin))?;
    }
    let read = |file| dermis_record::read_frames_of(&request.skin, file, request.read.clone());
    let baseline_table = request.baseline.as_ref().map(read).transpose()?;
    let frame_table = read(&request.frames)?;
    let loaded = request.calibration.as_deref().map(Calibration::load).transpose()?;
    let loaded = if request.as_skin { loaded.map(Calibration::insist) } else { loaded };
    let calibration = at_hand.or(loaded.as_ref());
    let forces = match &request.forces {
        Some(path) if request.as_skin => {
            Some(parse_forces_as(&dermis_device::instruments::read_bytes(path)?, path, &skin)?)
        }
        Some(path) => Some(load_forces(path, &skin)?),
        None => None,
    };
    let mut prepared = Prepared::new(skin)?;
    if let Some(built) = calibration.map(|calibration| calibration.skin_as_built(&prepared)).transpose()?.flatten() {
        prepared = built;
    }
    let reads = prepared.skin.backend.reads;
    let reader = |table: &dermis_device::FrameTable| {
        ChannelReader::new(table.layout(), &prepared.protocol, reads, &table.source().display().to_string())
    };
    let mut frame_reader = reader(&frame_table)?;
    let mut baselines = Vec::new();
    if let Some(table) = &baseline_table {
        let mut baseline_reader = reader(table)?;
        baselines = baseline_reader.read_table(table)?;
        frame_reader.share_phase_of(&baseline_reader);
    }
    let frames = frame_reader.read_table(&frame_table)?;
    let paired = are_pairs(&baselines, &frames);
    let circuit = match (prepared.skin.backend.circuit, &baseline_table) {
        (Some(CircuitChoice::ToLearn(_)), Some(_)) if calibration.is_none() => {
            let fit = find_circuit(&prepared, &relative_changes(&prepared, &baselines, &frames)?, |_| {})?;
            let mut skin = prepared.skin.clone();
            skin.backend.circuit = fit.circuit.map(CircuitChoice::Known);
            prepared = Prepared::new(skin)?;
            Some(fit)
        }
        _ => None,
    };
    let mut reference = match &baseline_table {
        Some(_) => reference_of(&prepared, &baselines, paired)?,
        None => Reference::of_differences(&prepared, &frames)?,
    };
    if calibration.is_none() {
        learn_from_rest(&mut prepared, &mut reference, &baselines, paired)?;
    }
    let is_compared = baseline_table.is_some() && prepared.skin.backend.wiring.is_known();
    let said = is_compared.then(|| describe_baseline(&reference.baseline, &prepared.voltages)).flatten();
    let odd: Vec<Option<FrameFaultKind>> = match &baseline_table {
        Some(_) => frames
            .iter()
            .enumerate()
            .map(|(index, frame)| odd(frame, if paired { &baselines[index] } else { &reference.baseline }))
            .collect(),
        None => vec![None; frames.len()],
    };
    let mismatches: Vec<String> = said.into_iter().chain(describe(&odd)).collect();
    mismatches.iter().for_each(|text| tracing::warn!("{}: {text}", request.frames.path.display()));
    let own = |index: usize| paired.then(|| baselines[index].as_slice());
    let differences_to = |reference: &Reference| -> Vec<Vec<f64>> {
        let difference = |(index, frame): (usize, &Vec<f64>)| match odd[index] {
            // Assume no change for faulty frames.
            Some(_) => vec![0.0; frame.len()],
            None => reference.difference(frame, own(index)),
        };
        frames.iter().enumerate().map(difference).collect()
    };
    // The noise and the rules for lambda use only sound frames.
    let mut data = differences_to(&reference);
    let mut sound = odd.iter().map(Option::is_none);
    if odd.iter().any(Option::is_none) {
        data.retain(|_| sound.next().unwrap_or(true));
    }
    if !paired {
        reference.estimate_noise(&data);
    }
    // Leave out channels that have changed at rest, for example over a cut, in the frames and in the pokes.
    let by_pokes = calibration.is_some_and(|calibration| calibration.correction().is_none());
    let left_out = match calibration.filter(|_| paired && by_pokes) {
        Some(calibration) => calibration.unsound_channels(&baselines),
        None => Vec::new(),
    };
    let fitted_anew = match calibration.filter(|_| !left_out.is_empty()) {
        Some(calibration) => Some(calibration.without_channels(&prepared, &left_out, &reference.noise)?),
        None => None,
    };
    let calibration = fitted_anew.as_ref().or(calibration);
    let CalibratedImager { imager, reference, placement } =
        CalibratedImager::new(&prepared, calibration, reference, &data)?;
    // A calibration may have rescaled the channels.
    let mut differences = differences_to(&reference);
    set_channels(&mut differences, &left_out, f64::NAN);
    let refinement = prepared.skin.imaging.refinement.filter(|_| !by_pokes);
    let refined = match &refinement {
        Some(refinement) => {
            let (mut done, all) = (0, refinement.steps * frames.len());
            Refiner::new(&prepared, refinement, &reference, imager.hyperparameter())?.images(&differences, || {
                done += 1;
                progress(done, all);
            })?
        }
        None => Vec::new(),
    };
    let hyperparameter = imager.hyperparameter();
    let mut reconstructor = Reconstructor::offline(&prepared, &reference.noise, imager, placement, calibration)?;
    reconstructor.set_forces(forces.clone())?;
    reconstructor.take_reference(&prepared, &reference);
    let grid = prepared.map.grid();
    let load = calibration.and_then(Calibration::load_quantity);
    let mut sinks: Vec<Box<dyn Sink>> = Vec::new();
    if let Some(path) = &request.touches {
        let other_places = matches!(reconstructor.placement, Some(PlacementFinder::Matched(_)));
        let is_refined = reconstructor.refinement.refines();
        let forces = forces.is_some() || is_refined && prepared.skin.states_force_law();
        sinks.push(Box::new(TouchTable::create(path, TouchColumns { forces, load, other_places })?));
    }
    if let Some(path) = &request.images {
        sinks.push(Box::new(ImageStack::create(path, grid.rows, grid.columns)?));
    }
    let rate = prepared.skin.backend.frame_rate_hz();
    let mut image = vec![f32::NAN; grid.len()];
    let unknown = vec![f64::NAN; prepared.channels()];
    let rim = prepared.rim_pixels();
    let mut touches: Vec<Touch> = Vec::new();
    let mut touch_rows = 0;
    for (index, difference) in differences.iter().enumerate() {
        let seconds = frame_table.times_s().map_or(index as f64 / rate, |times| times[index] - times[0]);
        let time_ns = (seconds.max(0.0) * 1e9) as u64;
        if odd[index].is_some() {
            image.fill(f32::NAN);
            reconstructor.forget(time_ns);
        } else {
            reconstructor.image(difference, &mut image)?;
            if let Some(refined) = refined.get(index) {
                image.copy_from_slice(refined);
            }
            if paired {
                reconstructor.forget(time_ns);
            }
            let placement = reconstructor.place(time_ns, difference)?;
            reconstructor.follow_touches(time_ns, &image, placement)?;
        }
        if let Some(refinement) = &refinement {
            refinement.threshold(&mut image);
        }
        // Image files show a value wherever there is skin. The touches were found without these repeated values.
        rim.iter().for_each(|&(pixel, nearest)| image[pixel] = image[nearest]);
        touches.clear();
        touches.extend(
            reconstructor.touches.touches().iter().filter(|touch| touch.observation != Observation::Missed).copied(),
        );
        touch_rows += touches.len();
        let output = SkinFrame {
            sequence: index as u64,
            time_s: 1e-9 * time_ns as f64,
            time_ns,
            is_ready: true,
            raw: (&frames[index]).into(),
            compensated: if odd[index].is_some() { (&unknown).into() } else { difference.into() },
            image: (&image).into(),
            columns: grid.columns,
            rows: grid.rows,
            touches: (&touches).into(),
            ended: reconstructor.touches.ended().into(),
            health: Health {
                frame: odd[index].map(|kind| FrameFault { kind, since_ns: time_ns, since_sequence: index as u64 }),
                ..Health::default()
            },
            ..SkinFrame::default()
        };
        sinks.iter_mut().try_for_each(|sink| sink.accept(&output))?;
        beside.iter_mut().try_for_each(|sink| sink.accept(&output))?;
        if refinement.is_none() {
            progress(index + 1, frames.len());
        }
    }
    for sink in &mut sinks {
        sink.finish()?;
    }
    beside.iter_mut().try_for_each(|sink| sink.finish().map(|_| ()))?;
    Ok(Report {
        mismatches,
        frames: frames.len(),
        touch_rows,
        hyperparameter,
        frames_with_missing: differences.iter().filter(|d| d.iter().any(|v| !v.is_finite())).count(),
        left_out,
        averaged: (baseline_table.is_some() && !paired).then_some(baselines.len()),
        noise_source: reference.noise_source,
        order: reference.order,
        circuit,
    })
}
