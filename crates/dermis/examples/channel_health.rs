//! The figures of the book's chapter on channel health, measured on the twins: false alarms, frames until a fault is
//! recognised, time to go on without what is lost, and places of touches with electrodes lost.
//!
//! `cargo run --release -p dermis --example channel_health -- [places|onsets|alarms] [frames]`

use std::time::Instant;

use dermis::experiments::Rig;
use dermis::imager::Imager;
use dermis::pipeline::Pipeline;
use dermis::prepare::Prepared;
use dermis::skin::{Skin, builtin_text};
use dermis::touches::TouchStage;
use dermis::twins::{AnyTwin, TwinKit};
use dermis_device::{Frame, HostStamp, Layout};
use dermis_tomo::inverse::SpotModel;
use dermis_touch::health::Health;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::scene::RandomTouches;

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
        let frame_s = 1.0 / skin.backend.frames_per_s.unwrap_or(50.0);
        let (twin, pipeline) = (TwinKit::of(skin)?.twin, Pipeline::new(prepared, &layout, None)?);
        Ok(Self { twin, pipeline, frame: Frame::default(), values: Vec::new(), ticks: 0, frame_s })
    }

    /// One frame; seconds that the pipeline took.
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
    Ok(Skin::parse(&format!("{text}\n[twin]\nseed = 5\nfaults = [{faults}]\n"), "an example")?)
}

/// Touches of one to three indenters, held and let go, over the skin's own range of pressure.
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

/// Frames in which a sound twin, half of the time pressed, has anything declared.
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
        if !line.health().is_sound() && alarms == 1 {
            println!("  {name}: frame {}: {:?}", line.ticks, line.health());
        }
    }
    Ok((alarms, pressed))
}

/// Frames from the onset of a fault until all of it is known, and the longest frame while it was taken in.
fn onset(name: &str, fault: &str, known: impl Fn(Health<'_>) -> bool) -> Outcome<(Option<u64>, f64)> {
    let frame_s = 1.0 / Skin::open(name)?.backend.frames_per_s.unwrap_or(50.0);
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

/// Difference frames of presses and where they are.
struct Presses {
    rig: Rig,
    imager: Imager,
    model: SpotModel,
    frames: Vec<([f64; 2], Vec<f64>)>,
}

fn presses(name: &str, radius_m: f64, forces_n: &[f64]) -> Outcome<Presses> {
    let mut rig = Rig::new(name)?;
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
    let model = rig.prepared().spot_model(&rig.reference().noise)?;
    let imager = rig.prepared().imager(rig.reference(), &[])?;
    Ok(Presses { rig, imager, model, frames })
}

/// How well presses are placed.
struct Placed {
    /// Mean error, millimetres.
    error_mm: f64,
    /// Mean standard deviation that the forward model and the noise allow at best, millimetres.
    bound_mm: f64,
    /// Presses that were not found at all.
    missed: usize,
}

/// Places without the channels of these electrodes.
fn places(presses: &mut Presses, lost: &[u32]) -> Outcome<Placed> {
    let Presses { rig, imager, model, frames } = presses;
    let prepared = rig.prepared();
    let left_out = channels_of(prepared, lost)?;
    let noise = &rig.reference().noise;
    imager.leave_out(&left_out, noise)?;
    let mut stage = TouchStage::new(prepared, imager.noise_image())?;
    stage.refine_by_model(prepared, model.without(&left_out, noise)?);
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let (mut sum, mut bounds, mut found, mut time_ns) = (0.0, 0.0, 0, 0);
    for (place, difference) in frames.iter() {
        let mut difference = difference.clone();
        left_out.iter().for_each(|&c| difference[c as usize] = f64::NAN);
        imager.image(&difference, &mut image)?;
        time_ns += 1_000_000_000;
        stage.forget(time_ns);
        stage.process(time_ns, &image, imager.filled(), None)?;
        if let Some(contact) = stage.contacts().first() {
            sum += 1e3 * (contact.centroid_m[0] - place[0]).hypot(contact.centroid_m[1] - place[1]);
            bounds += 1e3 * (contact.covariance_m2[0][0] + contact.covariance_m2[1][1]).sqrt();
            found += 1;
        }
    }
    let count = f64::from(found);
    Ok(Placed { error_mm: sum / count, bound_mm: bounds / count, missed: frames.len() - found as usize })
}

fn channels_of(prepared: &Prepared, electrodes: &[u32]) -> Outcome<Vec<u32>> {
    let wiring = prepared.wiring()?;
    let mut channels: Vec<u32> = electrodes.iter().flat_map(|&e| wiring.channels_of(e).to_vec()).collect();
    channels.sort_unstable();
    channels.dedup();
    Ok(channels)
}

/// Shortest times of going on without two electrodes: operator and image noise, and the refinement of touches.
fn update_times(name: &str, presses: &mut Presses) -> Outcome<()> {
    let Presses { rig, imager, model, .. } = presses;
    let noise = &rig.reference().noise;
    let left_out = channels_of(rig.prepared(), &[2, 7])?;
    let (mut operator, mut refinement) = (f64::INFINITY, f64::INFINITY);
    for _ in 0..20 {
        let start = Instant::now();
        imager.leave_out(&left_out, noise)?;
        operator = operator.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        model.without(&left_out, noise)?;
        refinement = refinement.min(start.elapsed().as_secs_f64());
    }
    let count = left_out.len();
    println!("{name}: {count} channels left out in {:.1} ms, refinement in {:.1} ms", 1e3 * operator, 1e3 * refinement);
    Ok(())
}

fn localisation(name: &str, radius_m: f64, forces_n: &[f64]) -> Outcome<()> {
    let mut presses = presses(name, radius_m, forces_n)?;
    let intact = places(&mut presses, &[])?;
    println!("{name}: {} presses, intact {:.2} mm, {} missed", presses.frames.len(), intact.error_mm, intact.missed);
    update_times(name, &mut presses)?;
    let ratio = |placed: &Placed| [placed.error_mm / intact.error_mm, placed.bound_mm / intact.bound_mm];
    let (mut missed, mut ratios) = (0, Vec::new());
    for electrode in 0..16 {
        let placed = places(&mut presses, &[electrode])?;
        ratios.push(ratio(&placed)[0]);
        missed += placed.missed;
    }
    let largest = ratios.iter().copied().fold(0.0, f64::max);
    println!("{name}: one lost: ratios {ratios:.2?}, largest {largest:.2}, {missed} missed");
    let (mut missed, mut ratios) = (0, Vec::new());
    for [a, b] in (0..16).flat_map(|a| (a + 1..16).map(move |b| [a, b])) {
        let placed = places(&mut presses, &[a, b])?;
        let [error, bound] = ratio(&placed);
        if error > 2.2 {
            println!(
                "  {name}: without electrodes {} and {}: ratio {error:.2}, of the bounds {bound:.2}",
                a + 1,
                b + 1
            );
        }
        ratios.push(error);
        missed += placed.missed;
    }
    ratios.sort_by(f64::total_cmp);
    let at = |share: f64| ratios[((ratios.len() - 1) as f64 * share) as usize];
    let count = ratios.len();
    println!(
        "{name}: two lost, {count} pairs: median {:.2}, 95 % {:.2}, largest {:.2}, {missed} missed",
        at(0.5),
        at(0.95),
        at(1.0)
    );
    Ok(())
}

fn main() -> Outcome<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let asked = |part: &str| arguments.is_empty() || arguments.iter().any(|argument| argument == part);
    let frames = arguments.iter().find_map(|argument| argument.parse().ok()).unwrap_or(10_000);
    if asked("places") {
        localisation("ionic-disc", 0.01, &[0.255, 0.57])?;
        localisation("healing-square", 0.01, &[8.0, 25.0])?;
    }
    if asked("onsets") {
        onsets("ionic-disc", &[[1, 2], [8, 9], [16, 1]])?;
        onsets("healing-square", &[[1, 8], [5, 12]])?;
    }
    if asked("alarms") {
        for name in ["ionic-disc", "healing-square", "em-8", "em-16-square"] {
            let (alarms, pressed) = false_alarms(name, frames)?;
            println!("{name}: {alarms} of {frames} frames with a false alarm, {pressed} of all pressed");
        }
    }
    Ok(())
}
