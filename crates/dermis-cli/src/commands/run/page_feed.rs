//! From what the pipeline knows to what the page shows.

mod damage;

use dermis::live::imager::Imager;
use dermis::live::reference::Reference;
use std::borrow::Cow;
use std::path::Path;
use std::time::{Duration, Instant};

use crate::page::{
    Counter, ElectrodeView, FaultView, GridView, PressLimits, Scene, SourceState, StageLatency, TareState, TouchPhase,
    TouchView, Update,
};
use dermis::device::acquire::AcquisitionCounters;
use dermis::live::output::Output;
use dermis::live::pipeline::Pipeline;
use dermis::live::prepare::Prepared;
use dermis::record::RecorderStatus;
use dermis::skin::Bend;
use dermis::twin::PressRange;
use dermis_learn::scene::{LOWERED, RAISED};
use dermis_tomo::mesh::{Contact, Outline};
use dermis_touch::health::{ChannelFaultKind, ElectrodeFaultKind};
use dermis_touch::{BaselineState, Touch, TouchEvent};

const MM: f64 = 1e3;
/// Quantiles are looked up this often, in frames: they cost more than a frame's touches.
const LATENCY_EVERY: u64 = 25;
/// Without frames for so long, a source is waited for.
const SILENCE: Duration = Duration::from_secs(1);
/// Channels listed at most.
const MOST_CHANNEL_FAULTS: usize = 64;

/// The update that is refilled for every frame.
#[derive(Debug)]
pub struct PageFeed {
    update: Update,
    rate: Rate,
    skipped: f32,
    tared_at_ns: Option<u64>,
    records: usize,
    waiting_since: Option<Instant>,
}

impl PageFeed {
    /// For a pipeline that has not seen a frame.
    pub fn new(pipeline: &Pipeline) -> Self {
        let mut update = Update::default();
        let grid = pipeline.prepared().map.grid();
        (update.image.rows, update.image.cols) = (grid.rows, grid.columns);
        update.image.values = vec![f32::NAN; grid.len()];
        update.latency = pipeline
            .latencies()
            .stages()
            .map(|(stage, _)| StageLatency { stage: Cow::Borrowed(stage), ..StageLatency::default() })
            .to_vec();
        update.counters = ["frames", "dropped", "lost", "damaged", "not recorded", "repeated"]
            .map(|name| Counter {
                name: Cow::Borrowed(name),
                value: 0,
                is_loss: !["frames", "repeated"].contains(&name),
            })
            .to_vec();
        update.state.baseline_age_s = f64::NAN;
        Self { update, rate: Rate::new(), skipped: 0.0, tared_at_ns: None, records: 0, waiting_since: None }
    }

    /// What the page is to show.
    pub fn update(&self) -> &Update {
        &self.update
    }

    /// The twin shows touches by itself, or not.
    pub fn demonstrate(&mut self, demonstrates: bool) {
        self.update.state.demonstrates = demonstrates;
    }

    /// Takes over one frame's results.
    pub fn show(&mut self, output: &Output<'_>) {
        let update = &mut self.update;
        update.frame = output.sequence;
        update.time_ns = output.time_ns;
        update.image.values.copy_from_slice(output.image);
        update.channels.values.clear();
        update.channels.values.extend(output.raw.iter().map(|v| *v as f32));
        update.touches.clear();
        update.touches.extend(output.touches.iter().map(view));
        let ended = output.events.iter().filter(|event| matches!(event, TouchEvent::End(_)));
        update.touches.extend(ended.map(|event| TouchView { phase: TouchPhase::End, ..view(event.touch()) }));
        update.fps = self.rate.count();
        self.waiting_since = None;
        if update.state.source != SourceState::Running {
            update.state.source = SourceState::Running;
        }
        self.show_health(output);
        self.show_classes(output);
        damage::take(&output.damage, &mut self.update.damage);
    }

    fn show_classes(&mut self, output: &Output<'_>) {
        let Some(seen) = output.classes else {
            self.update.classes = None;
            return;
        };
        let (shown, seen) = (self.update.classes.get_or_insert_default(), seen.classes);
        (shown.rows, shown.cols) = (seen.rows, seen.columns);
        for (values, class) in [(&mut shown.lowered, LOWERED), (&mut shown.raised, RAISED)] {
            values.clear();
            values.extend_from_slice(seen.of_class(class).unwrap_or_default());
        }
        shown.novelty = seen.novelty.unwrap_or(f32::NAN);
        shown.falls_back = seen.falls_back;
    }

    fn show_health(&mut self, output: &Output<'_>) {
        let health = &mut self.update.health;
        let for_s = |since_ns: u64| output.time_ns.saturating_sub(since_ns) as f64 * 1e-9;
        health.left_out = output.health.channels.len() as u32;
        health.electrodes.clear();
        health.electrodes.extend(output.health.electrodes.iter().map(|fault| {
            let (kind, with) = match fault.kind {
                ElectrodeFaultKind::Lost => ("lost", None),
                ElectrodeFaultKind::Shorted { with } => ("shorted", Some(with + 1)),
            };
            FaultView { number: fault.electrode + 1, kind, with, for_s: for_s(fault.since_ns) }
        }));
        health.channels.clear();
        let own = output.health.channels.iter().filter(|fault| fault.kind != ChannelFaultKind::Electrode);
        health.channels.extend(own.take(MOST_CHANNEL_FAULTS).map(|fault| FaultView {
            number: fault.channel + 1,
            kind: fault.kind.name(),
            with: None,
            for_s: for_s(fault.since_ns),
        }));
    }

    /// No frame came: true where there is something new to show of that. `problem` is the source's own word for it.
    pub fn wait(&mut self, problem: Option<String>) -> bool {
        let since = *self.waiting_since.get_or_insert_with(Instant::now);
        let source = match problem {
            Some(reason) => SourceState::Lost { reason },
            None if since.elapsed() < SILENCE => return false,
            None => SourceState::Waiting { reason: "connected, but no frames come".into() },
        };
        let changed = self.update.state.source != source;
        if changed {
            self.update.state.source = source;
            self.update.fps = 0.0;
        }
        changed
    }

    /// Takes over the losses and the state of the recording.
    pub fn count(&mut self, lost: AcquisitionCounters, recording: Option<(&Path, RecorderStatus)>) {
        let (not_recorded, state) = match &recording {
            Some((_, status)) => (status.dropped, Some(status.written)),
            None => (0, None),
        };
        let values =
            [self.update.counters[0].value + 1, lost.dropped, lost.lost, lost.bad, not_recorded, lost.repeated];
        self.update.counters.iter_mut().zip(values).for_each(|(counter, value)| counter.value = value);
        self.update.state.recorded_frames = state.unwrap_or(0);
        match recording {
            Some((path, _)) if self.update.state.recording.is_none() => {
                self.update.state.recording = Some(path.display().to_string());
            }
            None => self.update.state.recording = None,
            _ => {}
        }
    }

    /// Takes over what the pipeline is doing.
    pub fn describe(&mut self, pipeline: &Pipeline) {
        let state = &mut self.update.state;
        state.tare = match pipeline.baseline_state() {
            BaselineState::Starting { have, want } | BaselineState::Taring { have, want } => {
                TareState::Taring { frames_left: want.saturating_sub(have) as u32 }
            }
            BaselineState::Ready => TareState::Tared,
        };
        if pipeline.baseline_records().len() != self.records {
            self.records = pipeline.baseline_records().len();
            self.tared_at_ns = Some(self.update.time_ns);
        }
        let age_ns = self.tared_at_ns.map(|since| self.update.time_ns.saturating_sub(since));
        state.baseline_age_s = age_ns.map_or(f64::NAN, |ns| ns as f64 * 1e-9);
        state.hyperparameter = pipeline.hyperparameter().unwrap_or(f64::NAN);
        if pipeline.frames() % LATENCY_EVERY == 1 {
            for (shown, (_, histogram)) in self.update.latency.iter_mut().zip(pipeline.latencies().stages()) {
                shown.p50_us = histogram.quantile_us(0.5);
                shown.p99_us = histogram.quantile_us(0.99);
            }
        }
        self.skipped = self.update.counters[1].value as f32;
    }

    /// The source has ended.
    pub fn end(&mut self) {
        self.update.state.source = SourceState::Ended;
    }

    /// One line for the terminal.
    pub fn status(&self) -> String {
        let total = self.update.latency.last();
        format!(
            "{:.1} frames/s, {} touches, latency p50 {:.0} us, p99 {:.0} us, lost {}",
            self.update.fps,
            self.update.touches.len(),
            total.map_or(f64::NAN, |stage| stage.p50_us),
            total.map_or(f64::NAN, |stage| stage.p99_us),
            self.update.counters.iter().filter(|counter| counter.is_loss).map(|counter| counter.value).sum::<u64>()
        )
    }
}

/// Rate over the last second or so.
#[derive(Debug)]
struct Rate {
    since: Instant,
    frames: u32,
    per_s: f32,
}

impl Rate {
    fn new() -> Self {
        Self { since: Instant::now(), frames: 0, per_s: 0.0 }
    }

    fn count(&mut self) -> f32 {
        self.frames += 1;
        let elapsed = self.since.elapsed().as_secs_f32();
        if elapsed > 0.5 {
            self.per_s = self.frames as f32 / elapsed;
            self.since = Instant::now();
            self.frames = 0;
        }
        self.per_s
    }
}

fn view(touch: &Touch) -> TouchView {
    TouchView {
        id: touch.id,
        phase: match touch.phase {
            dermis_touch::TouchPhase::Begin => TouchPhase::Begin,
            dermis_touch::TouchPhase::Move => TouchPhase::Move,
            dermis_touch::TouchPhase::End => TouchPhase::End,
        },
        x_mm: touch.position_m[0] * MM,
        y_mm: touch.position_m[1] * MM,
        amplitude: touch.amplitude,
        area_mm2: touch.area_m2 * MM * MM,
        sigma_x_mm: touch.covariance_m2[0][0].max(0.0).sqrt() * MM,
        sigma_y_mm: touch.covariance_m2[1][1].max(0.0).sqrt() * MM,
        force_n: touch.force.and_then(|force| force.nearest_n()),
        force_range: touch.force.map(|force| force.range()),
    }
}

/// What does not change while the skin runs; `press`: what its twin may be pressed with, if it is one.
pub fn scene(prepared: &Prepared, press: Option<PressRange>) -> Scene {
    let grid = prepared.map.grid();
    let mm = |p: [f64; 2]| [p[0] * MM, p[1] * MM];
    let lambda = typical_hyperparameter(prepared);
    Scene {
        skin: prepared.skin.name.clone(),
        modality: prepared.skin.modality.name().into(),
        is_twin: press.is_some(),
        watches_damage: prepared.skin.damage.watch,
        is_treatable: press.is_some() && matches!(prepared.skin.frontend.layer, dermis::skin::Layer::Sandwich(_)),
        outline_mm: rings(&prepared.body.outline).into_iter().map(|ring| ring.into_iter().map(mm).collect()).collect(),
        bend_diameter_mm: prepared.skin.frontend.bend.map(|Bend::Cylinder { diameter_mm }| diameter_mm),
        electrodes: electrodes(prepared),
        grid: GridView {
            rows: grid.rows,
            cols: grid.columns,
            x_min_mm: grid.left_m * MM,
            x_max_mm: (grid.left_m + grid.columns as f64 * grid.pixel_m) * MM,
            y_min_mm: (grid.top_m - grid.rows as f64 * grid.pixel_m) * MM,
            y_max_mm: grid.top_m * MM,
        },
        channel_labels: (0..prepared.channels()).map(|channel| prepared.protocol.channel_label(channel)).collect(),
        channel_unit: "V".into(),
        image_quantity: prepared.skin.modality.image_quantity().into(),
        image_unit: String::new(),
        range_hint: Some([0.0, 0.5]),
        hyperparameter_range: [lambda * 1e-2, lambda * 1e2],
        press: press.map_or_else(PressLimits::default, limits),
    }
}

fn limits(range: PressRange) -> PressLimits {
    PressLimits {
        radius_mm: range.radius_m.map(|m| m * MM),
        pressure_kpa: range.pressure_pa.map(|pa| pa * 1e-3),
        initial_radius_mm: range.initial_radius_m * MM,
        initial_pressure_kpa: range.initial_pressure_pa * 1e-3,
    }
}

/// Middle of the slider: lambda by the skin file's own rule where that needs no data, else 1.
fn typical_hyperparameter(prepared: &Prepared) -> f64 {
    let reference = Reference::from_baseline(prepared, &prepared.voltages, None);
    reference.and_then(|r| Imager::new(prepared, &r, &[])).map_or(1.0, |imager| imager.hyperparameter())
}

fn rings(outline: &Outline) -> Vec<Vec<[f64; 2]>> {
    match outline {
        Outline::Disc { radius_m } => {
            let corner = |k: usize| {
                let angle = std::f64::consts::TAU * k as f64 / 120.0;
                [radius_m * angle.cos(), radius_m * angle.sin()]
            };
            vec![(0..120).map(corner).collect()]
        }
        Outline::Rectangle { width_m, height_m } => {
            let (x, y) = (0.5 * width_m, 0.5 * height_m);
            vec![vec![[-x, -y], [x, -y], [x, y], [-x, y]]]
        }
        Outline::Polygon { outer, holes } => std::iter::once(outer).chain(holes).cloned().collect(),
    }
}

/// Rim electrodes as the segment between their ends, pads as their bounding rectangle's corners, points as nothing.
fn electrodes(prepared: &Prepared) -> Vec<ElectrodeView> {
    let body = &prepared.body.mesh;
    (0..body.electrodes.len())
        .map(|index| {
            let centre = body.electrode_centre(index);
            let nodes: Vec<[f64; 3]> =
                body.electrode_nodes(index).iter().map(|&node| body.mesh.nodes()[node as usize]).collect();
            let outline_mm = match body.electrodes[index].contact {
                Contact::Point(_) => Vec::new(),
                Contact::Faces(_) => ends(&nodes),
                Contact::Area(_) => corners(&nodes),
            };
            let number = index as u32 + 1;
            ElectrodeView { number, position_mm: [centre[0] * MM, centre[1] * MM], outline_mm }
        })
        .collect()
}

/// The two nodes farthest from each other.
fn ends(nodes: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let distance = |a: &[f64; 3], b: &[f64; 3]| (a[0] - b[0]).hypot(a[1] - b[1]);
    let pairs = nodes.iter().flat_map(|a| nodes.iter().map(move |b| (a, b)));
    let farthest = pairs.max_by(|x, y| distance(x.0, x.1).total_cmp(&distance(y.0, y.1)));
    farthest.map_or(Vec::new(), |(a, b)| vec![[a[0] * MM, a[1] * MM], [b[0] * MM, b[1] * MM]])
}

fn corners(nodes: &[[f64; 3]]) -> Vec<[f64; 2]> {
    let fold = |axis: usize| {
        nodes.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), n| (l.min(n[axis] * MM), h.max(n[axis] * MM)))
    };
    let ((left, right), (bottom, top)) = (fold(0), fold(1));
    vec![[left, bottom], [right, bottom], [right, top], [left, top]]
}
