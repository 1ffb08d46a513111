//! Reproduces the numbers in the book's chapter on channel health with the twins: false alarms, frames until a fault is
//! detected, time until the pipeline runs without the lost channels, and errors of touches with electrodes lost, with
//! their theoretical bounds.
//!
//! `cargo run --release -p dermis --example channel_health -- [places|bounds|onsets|alarms] [twins] [frames]`

use dermis_live::stages::health::wiring;
use dermis_live::stages::spot_model::spot_model;
use std::time::Instant;

use dermis_device::{Frame, HostStamp, Layout};
use dermis_lab::twin_bench::Rig;
use dermis_live::imager::Imager;
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::reconstructor::Reconstructor;
use dermis_live::stages::refinement::Refinement;
use dermis_skin::{DrivePattern, MeasurePattern, Skin, builtin_text};
use dermis_tomo::inverse::{Spot, SpotModel};
use dermis_touch::health::Health;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::scene::RandomTouches;
use dermis_twin::{AnyTwin, TwinKit};

/// Skins whose false alarms are counted.
const SKINS: [&str; 9] = [
    "healing-square",
    "piezo-square",
    "piezo-disc",
    "piezo-cylinder",
    "ionic-disc",
    "ionic-square",
    "em-8",
    "em-16-circular",
    "em-16-square",
];

type Outcome<T> = Result<T, Box<dyn std::error::Error>>;

/// A twin and the pipeline that follows it.
struct Line {
    twin: AnyTwin,
    pipeline: Pipeline,
    frame: Frame,
    values: Vec<f64>,
    ticks: u64,
    frame_s: f64,
}

impl Line {
    fn new(skin: &Skin) -> Outcome<Self> {
        let prepared = Prepared::new(skin.clone())?;
        let layout = Layout::Channels { count: prepared.channels() };
        let frame_s = 1.0 / skin.backend.frame_rate_hz();
        let (twin, pipeline) = (TwinKit::of(skin)?.twin, Pipeline::new(prepared, &layout, None)?);
        Ok(Self { twin, pipeline, frame: Frame::default(), values: Vec::new(), ticks: 0, frame_s })
    }

    /// Processes one frame; returns the seconds that the pipeline took.
    fn step(&mut self) -> Outcome<f64> {
        let time_s = self.ticks as f64 * self.frame_s;
        self.twin.step(time_s, &mut self.values)?;
        let at = HostStamp { monotonic_ns: (time_s * 1e9) as u64, wall_ns: 0 };
        self.frame.refill(self.ticks, at, &self.values, &[]);
        self.ticks += 1;
        let start = Instant::now();
        self.pipeline.process(&self.frame, at.monotonic_ns)?;
        Ok(start.elapsed().as_secs_f64())
    }

    fn health(&self) -> Health<'_> {
        self.pipeline.health()
    }
}

fn with_faults(name: &str, faults: &str) -> Outcome<Skin> {
    let text = builtin_text(name).ok_or("no such skin")?;
    Ok(Skin::parse(&text.replacen("[twin]\n", &format!("[twin]\nseed = 5\nfaults = [{faults}]\n"), 1), "an example")?)
}

/// Touches of one to three indenters, held and released, over the skin's own range of pressure.
fn random_touches(name: &str, seed: u64, line: &Line) -> Outcome<RandomTouches> {
    let range = TwinKit::of(&Skin::open(name)?)?.press;
    let half = line.pipeline.prepared().half_width_m();
    let mut touches = RandomTouches::new(seed);
    touches.half_width_m = 0.65 * half;
    touches.gap_m = 0.1 * half;
    touches.radius_m = [0.6 * range.initial_radius_m, 1.5 * range.initial_radius_m];
    touches.pressure_pa = [0.2 * range.initial_pressure_pa, 1.5 * range.initial_pressure_pa];
    Ok(touches)
}

/// Number of frames in which anything is declared faulty on a sound twin that is pressed half of the time.
fn false_alarms(name: &str, frames: u64) -> Outcome<(u64, u64)> {
    let mut line = Line::new(&Skin::open(name)?)?;
    let mut touches = random_touches(name, 11, &line)?;
    let (mut alarms, mut pressed) = (0, 0);
    while line.ticks < frames {
        if line.ticks == 40 {
            let groups = (frames / 24) as usize + 1;
            let script = touches.script(groups, 3, 12.0 * line.frame_s)?;
            line.twin.scene_mut().set_script(Some(script))?;
        }
        line.step()?;
        alarms += u64::from(!line.health().is_sound());
        pressed += u64::from(line.twin.scene().indenters().next().is_some());
        if line.ticks.is_multiple_of(1000) {
            eprintln!("  {name}: {} frames, {alarms} with a false alarm", line.ticks);
        }
        if !line.health().is_sound() && alarms == 1 {
            println!("  {name}: frame {}: {:?}", line.ticks, line.health());
        }
    }
    Ok((alarms, pressed))
}

/// Frames from a fault's onset until all of it is identified, and the longest processing time of a frame in between.
fn onset(name: &str, fault: &str, known: impl Fn(Health<'_>) -> bool) -> Outcome<(Option<u64>, f64)> {
    let frame_s = 1.0 / Skin::open(name)?.backend.frame_rate_hz();
    let from = 80;
    let skin = with_faults(name, &format!("{{ {fault}, from_s = {:.4} }}", (from as f64 - 0.5) * frame_s))?;
    let mut line = Line::new(&skin)?;
    let mut slowest: f64 = 0.0;
    for _ in 0..from + 40 {
        let seconds = line.step()?;
        if line.ticks > from {
            slowest = slowest.max(seconds);
            if known(line.health()) {
                return Ok((Some(line.ticks - from), slowest));
            }
        }
    }
    let (channels, electrodes) = (line.health().channels.len(), line.health().electrodes);
    println!("  {name}, {fault}: {channels} channels left out, {electrodes:?}");
    Ok((None, slowest))
}

fn onsets(name: &str, pairs: &[[u32; 2]]) -> Outcome<()> {
    let mut frames = Vec::new();
    let mut slowest: f64 = 0.0;
    for electrode in [1_u32, 4, 9, 16] {
        let lost =
            move |health: Health<'_>| health.electrodes.len() == 1 && health.electrodes[0].electrode + 1 == electrode;
        let (after, seconds) = onset(name, &format!("open_electrodes = [{electrode}]"), lost)?;
        frames.push(after);
        slowest = slowest.max(seconds);
    }
    println!("{name}: open electrode known after {frames:?} frames, slowest frame {:.1} ms", 1e3 * slowest);
    let mut frames = Vec::new();
    for &[a, b] in pairs {
        let shorted = move |health: Health<'_>| {
            health.electrodes.len() == 2
                && [a, b].iter().all(|e| health.electrodes.iter().any(|f| f.electrode + 1 == *e))
        };
        frames.push(onset(name, &format!("shorted_pairs = [[{a}, {b}]]"), shorted)?.0);
    }
    println!("{name}: shorted pair known after {frames:?} frames");
    let mut frames = Vec::new();
    for channel in [1_u32, 50, 120, 208] {
        let stuck = move |health: Health<'_>| health.channels.iter().any(|f| f.channel + 1 == channel);
        frames.push(onset(name, &format!("stuck_channels = [{{ channel = {channel}, value_mv = 3.0 }}]"), stuck)?.0);
    }
    println!("{name}: stuck channel known after {frames:?} frames");
    Ok(())
}

/// Difference frames of presses with their positions, and the spots fitted there with all channels.
struct Presses {
    rig: Rig,
    reconstructor: Reconstructor,
    model: SpotModel,
    frames: Vec<([f64; 2], Vec<f64>)>,
    spots: Vec<Spot>,
    time_ns: u64,
}

fn presses(skin: Skin, radius_m: f64, forces_n: &[f64]) -> Outcome<Presses> {
    let mut rig = Rig::of(skin)?;
    let half = rig.prepared().half_width_m();
    let mut frames = Vec::new();
    for (ring, direction) in [0.0, 0.34, 0.69].iter().flat_map(|ring| (0..6).map(move |k| (*ring, k))) {
        let angle = 0.4 + std::f64::consts::TAU / 6.0 * f64::from(direction);
        let centre_m = [half * ring * angle.cos(), half * ring * angle.sin()];
        for &force_n in forces_n {
            let indenter = Indenter { centre_m, shape: Shape::Disc { radius_m }, load: Load::ForceN(force_n) };
            let frame = rig.mean_frame(&[indenter], 1)?;
            frames.push((centre_m, rig.reference().difference(&frame, None)));
        }
        rig.frames(&[], 30)?;
    }
    let model = spot_model(rig.prepared(), &rig.reference().noise)?;
    let imager = Imager::new(rig.prepared(), rig.reference(), &[])?;
    let refinement = Refinement::new(rig.prepared(), &rig.reference().noise)?.taking_time();
    let reconstructor = Reconstructor::new(rig.prepared(), imager, None, refinement)?;
    let (mut spots, mut scratch) = (Vec::new(), model.scratch());
    for (place, difference) in &frames {
        model.fit(difference, &[*place], &mut scratch)?;
        spots.push(Spot { position_m: *place, ..scratch.spots()[0] });
    }
    Ok(Presses { rig, reconstructor, model, frames, spots, time_ns: 0 })
}

/// Accuracy of the presses' positions.
struct Placed {
    /// Mean error, millimetres.
    error_mm: f64,
    /// Mean lower bound on the standard deviation of an unbiased estimate (Cramér-Rao), millimetres.
    bound_mm: f64,
    /// Presses that were not found.
    missed: usize,
    /// For each press: position, error, and whether the forward model placed it (else the image did); millimetres.
    each: Vec<([f64; 2], f64, bool)>,
}

/// Places the presses without the channels of these electrodes.
fn places(presses: &mut Presses, lost: &[u32]) -> Outcome<Placed> {
    let Presses { rig, reconstructor, model, frames, spots, time_ns } = presses;
    let prepared = rig.prepared();
    let left_out = channels_of(prepared, lost)?;
    let noise = &rig.reference().noise;
    reconstructor.leave_out(prepared, &left_out, noise)?;
    let model = model.without(&left_out, noise)?;
    let mut bounds = 0.0;
    for Spot { position_m, amplitude, radius_m, .. } in spots.iter() {
        let covariance = model.bound(*position_m, *amplitude, *radius_m)?;
        bounds += 1e3 * (covariance[0][0] + covariance[1][1]).sqrt();
    }
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let mut each = Vec::with_capacity(frames.len());
    // The frames are independent of each other and of the last call's.
    for (place, difference) in frames.iter() {
        let mut difference = difference.clone();
        left_out.iter().for_each(|&c| difference[c as usize] = f64::NAN);
        reconstructor.image(&difference, &mut image)?;
        *time_ns += 1_000_000_000;
        reconstructor.forget(*time_ns);
        reconstructor.follow_touches(*time_ns, &image, None)?;
        if let Some(contact) = reconstructor.touches.contacts().first() {
            let off_mm = 1e3 * (contact.centroid_m[0] - place[0]).hypot(contact.centroid_m[1] - place[1]);
            each.push((place.map(|x| 1e3 * x), off_mm, contact.radius_m.is_some()));
        }
    }
    let error_mm = each.iter().map(|(_, off_mm, _)| off_mm).sum::<f64>() / each.len() as f64;
    Ok(Placed { error_mm, bound_mm: bounds / frames.len() as f64, missed: frames.len() - each.len(), each })
}

fn channels_of(prepared: &Prepared, electrodes: &[u32]) -> Outcome<Vec<u32>> {
    let wiring = wiring(prepared)?;
    let mut channels: Vec<u32> = electrodes.iter().flat_map(|&e| wiring.channels_of(e).to_vec()).collect();
    channels.sort_unstable();
    channels.dedup();
    Ok(channels)
}

/// CPU time of all threads so far, seconds; 0 if the operating system doesn't provide it.
fn computed_s() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let nanoseconds = |task: std::fs::DirEntry| -> Option<f64> {
        std::fs::read_to_string(task.path().join("schedstat")).ok()?.split_whitespace().next()?.parse().ok()
    };
    1e-9 * tasks.filter_map(nanoseconds).sum::<f64>()
}

/// Measures the time until the pipeline runs without two electrodes: operator and image noise, and the refinement of
/// touches.
fn update_times(name: &str, presses: &mut Presses) -> Outcome<()> {
    let Presses { rig, reconstructor, model, .. } = presses;
    let noise = &rig.reference().noise;
    let left_out = channels_of(rig.prepared(), &[2, 7])?;
    let (mut operator, mut refinement) = (Vec::new(), Vec::new());
    let timed = |times: &mut Vec<[f64; 2]>, work: &mut dyn FnMut() -> Outcome<()>| -> Outcome<()> {
        let (start, computed) = (Instant::now(), computed_s());
        work()?;
        times.push([1e3 * start.elapsed().as_secs_f64(), 1e3 * (computed_s() - computed)]);
        Ok(())
    };
    for _ in 0..20 {
        timed(&mut operator, &mut || reconstructor.imager.leave_out(&left_out, noise).map_err(Into::into))?;
        timed(&mut refinement, &mut || model.without(&left_out, noise).map(drop).map_err(Into::into))?;
    }
    println!("{name}: without {} channels, ms (shortest, longest; computing of all threads):", left_out.len());
    for (what, times) in [("operator and image noise", operator), ("refinement", refinement)] {
        let ends = |k: usize| {
            let of = |start: f64, pick: fn(f64, f64) -> f64| times.iter().map(|time| time[k]).fold(start, pick);
            [of(f64::INFINITY, f64::min), of(0.0, f64::max)]
        };
        println!("  {what}: {:.1?}; {:.1?}", ends(0), ends(1));
    }
    Ok(())
}

/// Median, 95th percentile and maximum, and how many exceed the goal for two lost electrodes.
fn spread(mut ratios: Vec<f64>) -> String {
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| ratios[((ratios.len() - 1) as f64 * share) as usize];
    let over = ratios.iter().filter(|ratio| **ratio > 2.2).count();
    format!("median {:.2}, 95 % {:.2}, largest {:.2}, {over} of {} over 2.2", at(0.5), at(0.95), at(1.0), ratios.len())
}

fn localisation(label: &str, skin: Skin, radius_m: f64, forces_n: &[f64]) -> Outcome<()> {
    let mut presses = presses(skin, radius_m, forces_n)?;
    let intact = places(&mut presses, &[])?;
    let Placed { error_mm, bound_mm, missed, .. } = &intact;
    println!("{label}: {} presses, {error_mm:.2} mm, bound {bound_mm:.3} mm, {missed} missed", presses.frames.len());
    update_times(label, &mut presses)?;
    let count = presses.rig.prepared().protocol.electrode_count() as u32;
    let one = (0..count).map(|e| vec![e]).collect();
    let two = (0..count).flat_map(|a| (a + 1..count).map(move |b| vec![a, b])).collect();
    for lost in [one, two] as [Vec<Vec<u32>>; 2] {
        let (mut errors, mut bounds, mut missed) = (Vec::new(), Vec::new(), 0);
        for electrodes in &lost {
            let placed = places(&mut presses, electrodes)?;
            let [error, bound] = [placed.error_mm / intact.error_mm, placed.bound_mm / intact.bound_mm];
            if error > 2.2 || bound > 2.2 {
                let numbers: Vec<u32> = electrodes.iter().map(|e| e + 1).collect();
                println!("  {label}: without {numbers:?}: errors {error:.2}, bounds {bound:.2}");
                let mut each = placed.each.clone();
                each.sort_by(|a, b| b.1.total_cmp(&a.1));
                for ([x_mm, y_mm], off_mm, refined) in &each[..3.min(each.len())] {
                    let by = if *refined { "model" } else { "image" };
                    println!("    {off_mm:.2} mm at {x_mm:.1}, {y_mm:.1} mm, placed by the {by}");
                }
            }
            errors.push(error);
            bounds.push(bound);
            missed += placed.missed;
        }
        println!("{label}: {} lost: errors {}, {missed} missed", lost[0].len(), spread(errors));
        println!("{label}: {} lost: bounds {}", lost[0].len(), spread(bounds));
    }
    Ok(())
}

/// A skin with other electrode pairs.
fn skipping(name: &str, skip: usize) -> Outcome<Skin> {
    let mut skin = Skin::open(name)?;
    skin.backend.drive = DrivePattern::Skip(skip);
    skin.backend.measure = MeasurePattern::Skip(skip);
    Ok(skin)
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let asked = |part: &str| arguments.is_empty() || arguments.iter().any(|argument| argument == part);
    let frames = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(10_000);
    let named: Vec<&str> = SKINS.into_iter().filter(|name| arguments.iter().any(|a| a == name)).collect();
    if asked("places") {
        for (name, forces_n) in [("ionic-disc", [0.255, 0.57]), ("healing-square", [8.0, 25.0])] {
            if named.is_empty() || named.contains(&name) {
                localisation(name, Skin::open(name)?, 0.01, &forces_n)?;
            }
        }
    }
    if asked("bounds") {
        for skip in 1..=6 {
            let label = format!("ionic-disc, skip-{skip}");
            localisation(&label, skipping("ionic-disc", skip)?, 0.01, &[0.255, 0.57])?;
        }
    }
    if asked("onsets") {
        onsets("ionic-disc", &[[1, 2], [8, 9], [16, 1]])?;
        onsets("healing-square", &[[1, 8], [5, 12]])?;
    }
    if asked("alarms") {
        for name in if named.is_empty() { SKINS.to_vec() } else { named } {
            let (alarms, pressed) = false_alarms(name, frames)?;
            println!("{name}: {alarms} of {frames} frames with a false alarm, {pressed} of all pressed");
        }
    }
    Ok(())
}
