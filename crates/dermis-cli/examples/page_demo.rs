//! The live page without a skin: a blob circles on a 100 mm square, and another appears wherever the page is pressed.
//! `cargo run -p dermis-cli --example page_demo -- [--port 8080] [--fps 50] [--grid 64] [--token]` prints the page's
//! address.

use std::collections::BTreeMap;
use std::env;
use std::error::Error;
use std::f64::consts::TAU;
use std::net::SocketAddr;
use std::thread;
use std::time::{Duration, Instant};

use dermis_cli::page::{
    self, Command, Counter, ElectrodeView, GridView, Hub, Level, PageOptions, Press, Request, Scene, StageLatency,
    TareState, Token, TouchPhase, TouchView, Update,
};

const HALF_SIDE_MM: f64 = 50.0;
const ELECTRODES: u32 = 16;
const CIRCLING_RADIUS_MM: f64 = 8.0;

struct Demo {
    hub: Hub,
    update: Update,
    presses: BTreeMap<u64, Press>,
    /// Touches in the last frame, for telling new touches from continued ones.
    touched: Vec<u64>,
    started: Instant,
    tared: Instant,
}

fn main() -> Result<(), Box<dyn Error>> {
    let port = argument("--port", 8080.0)? as u16;
    let fps = argument("--fps", 50.0)?;
    let grid = argument("--grid", 64.0)? as usize;
    let scene = scene(grid);
    let hub = Hub::new();
    let (commands, requests) = crossbeam_channel::bounded(256);
    let noise: Vec<f32> = (0..208).map(|channel| 1e-5 * (1.0 + 3.0 * ((channel * 7 % 13) as f32 / 13.0))).collect();
    hub.publish_noise(&noise);
    let address = SocketAddr::from(([127, 0, 0, 1], port));
    let token = env::args().any(|argument| argument == "--token").then(Token::random).transpose()?;
    let options = PageOptions { token, ..PageOptions::default() };
    let server = page::serve(address, options, hub.clone(), scene, commands)?;
    println!("page: {}", server.url());
    Demo::new(hub, grid).run(&requests, Duration::from_secs_f64(1.0 / fps))
}

impl Demo {
    fn new(hub: Hub, grid: usize) -> Self {
        let mut update = Update::default();
        update.image.rows = grid;
        update.image.cols = grid;
        update.image.values = vec![0.0; grid * grid];
        update.channels.values = vec![0.0; 208];
        update.state.hyperparameter = 0.01;
        update.state.tare = TareState::Tared;
        let stages = ["decode", "condition", "reconstruct", "touches"];
        update.latency =
            stages.iter().map(|&stage| StageLatency { stage: stage.into(), ..StageLatency::default() }).collect();
        update.counters = [("frames", false), ("lost frames", true), ("dropped for sinks", true)]
            .map(|(name, is_loss)| Counter { name: name.into(), value: 0, is_loss })
            .into();
        update.state.demonstrates = true;
        let now = Instant::now();
        Self { hub, update, presses: BTreeMap::new(), touched: Vec::new(), started: now, tared: now }
    }

    fn run(mut self, requests: &crossbeam_channel::Receiver<Request>, period: Duration) -> Result<(), Box<dyn Error>> {
        let mut next = Instant::now();
        loop {
            for request in requests.try_iter() {
                self.obey(request);
            }
            let work = Instant::now();
            self.fill();
            self.hub.publish(&self.update)?;
            let took_us = work.elapsed().as_secs_f64() * 1e6;
            for (share, latency) in self.update.latency.iter_mut().enumerate() {
                latency.p50_us = took_us * (share + 1) as f64 / 10.0;
                latency.p99_us = 1.6 * latency.p50_us;
            }
            self.update.fps = (1.0 / period.as_secs_f64()) as f32;
            next += period;
            thread::sleep(next.saturating_duration_since(Instant::now()));
        }
    }

    fn obey(&mut self, request: Request) {
        let Request { command, reply, .. } = request;
        match command {
            Command::Press(press) | Command::Move(press) => _ = self.presses.insert(press.pointer_id, press),
            Command::Release { pointer_id } => _ = self.presses.remove(&pointer_id),
            Command::Tare { force: false } if !self.presses.is_empty() => {
                reply.refuse("tare refused: a touch is on the skin");
            }
            Command::Tare { .. } => {
                self.tared = Instant::now();
                reply.accept("tared");
            }
            Command::RecordStart => {
                self.update.state.recording = Some("demo.mcap".into());
                self.update.state.recorded_frames = 0;
                reply.accept("recording to demo.mcap (the demo writes nothing)");
            }
            Command::RecordStop => {
                self.update.state.recording = None;
                self.hub.announce(Level::Info, format!("{} frames recorded", self.update.state.recorded_frames));
            }
            Command::Hyperparameter(value) => self.update.state.hyperparameter = value,
            Command::Demonstrate(wanted) => self.update.state.demonstrates = wanted,
            Command::ChooseChannels(_) => {}
            other => reply.refuse(format!("the demo does not know {other:?}")),
        }
    }

    /// Makes the next frame: Gaussian blobs, and channel values to match.
    fn fill(&mut self) {
        let update = &mut self.update;
        let time_s = self.started.elapsed().as_secs_f64();
        update.frame += 1;
        update.time_ns = self.started.elapsed().as_nanos() as u64;
        update.counters[0].value = update.frame;
        update.state.baseline_age_s = self.tared.elapsed().as_secs_f64();
        update.state.recorded_frames += u64::from(update.state.recording.is_some());
        let angle = TAU * time_s / 12.0;
        let circling = Press {
            pointer_id: 0,
            x_mm: 25.0 * angle.cos(),
            y_mm: 25.0 * angle.sin(),
            radius_mm: CIRCLING_RADIUS_MM,
            pressure_kpa: 50.0 + 10.0 * (TAU * time_s / 3.0).sin(),
        };
        let circling = update.state.demonstrates.then_some(circling);
        let blobs: Vec<Press> = circling.into_iter().chain(self.presses.values().copied()).collect();
        paint(&blobs, update.image.rows, &mut update.image.values);
        update.touches = blobs.iter().map(|blob| touch(blob, &self.touched)).collect();
        self.touched = update.touches.iter().map(|touch| touch.id).collect();
        for (channel, value) in update.channels.values.iter_mut().enumerate() {
            let phase = TAU * channel as f64 / 208.0;
            *value = blobs
                .iter()
                .map(|b| 1e-5 * b.pressure_kpa * (phase + b.x_mm / 20.0 - b.y_mm / 30.0).sin())
                .sum::<f64>() as f32;
        }
    }
}

fn amplitude(blob: &Press) -> f64 {
    blob.pressure_kpa / 100.0
}

fn touch(blob: &Press, before: &[u64]) -> TouchView {
    // Small, stable ids made from page and pointer.
    let id = (blob.pointer_id >> 32) * 10 + blob.pointer_id % 10;
    TouchView {
        id,
        phase: if before.contains(&id) { TouchPhase::Move } else { TouchPhase::Begin },
        x_mm: blob.x_mm,
        y_mm: blob.y_mm,
        amplitude: amplitude(blob),
        area_mm2: TAU / 2.0 * blob.radius_mm * blob.radius_mm,
        sigma_x_mm: 0.4,
        sigma_y_mm: 0.5,
        force_n: None,
        force_range: None,
        other: None,
    }
}

fn paint(blobs: &[Press], side: usize, values: &mut [f32]) {
    for (index, value) in values.iter_mut().enumerate() {
        let pixel_mm = 2.0 * HALF_SIDE_MM / side as f64;
        let x_mm = (0.5 + (index % side) as f64) * pixel_mm - HALF_SIDE_MM;
        let y_mm = HALF_SIDE_MM - (0.5 + (index / side) as f64) * pixel_mm;
        let ripple = 0.01 * (x_mm / 7.0).sin() * (y_mm / 9.0).cos();
        let height = |blob: &Press| {
            let distance = (x_mm - blob.x_mm).hypot(y_mm - blob.y_mm) / blob.radius_mm;
            amplitude(blob) * (-distance * distance * 2f64.ln()).exp()
        };
        *value = (ripple + blobs.iter().map(height).sum::<f64>()) as f32;
    }
}

fn scene(grid: usize) -> Scene {
    let side = HALF_SIDE_MM;
    Scene {
        skin: "demonstration".into(),
        modality: "eit".into(),
        is_twin: true,
        outline_mm: vec![vec![[-side, -side], [side, -side], [side, side], [-side, side]]],
        electrodes: (1..=ELECTRODES).map(electrode).collect(),
        grid: GridView { rows: grid, cols: grid, x_min_mm: -side, x_max_mm: side, y_min_mm: -side, y_max_mm: side },
        channel_labels: (0..ELECTRODES)
            .flat_map(|drive| (0..13).map(move |measure| (drive, (drive + 1 + measure) % ELECTRODES)))
            .map(|(drive, measure)| {
                let partner = |electrode: u32| (electrode + 7) % ELECTRODES + 1;
                format!("{}-{} / {}-{}", drive + 1, partner(drive), measure + 1, partner(measure))
            })
            .collect(),
        channel_unit: "V".into(),
        image_quantity: "conductivity change".into(),
        image_unit: "S/m".into(),
        amplitude_unit: "S/m".into(),
        range_hint: Some([-0.1, 0.8]),
        hyperparameter_range: [1e-4, 1.0],
        ..Scene::default()
    }
}

/// Four square 6 mm pads on each side, counter-clockwise from the left end of the lower side.
fn electrode(number: u32) -> ElectrodeView {
    let along = 23.5 * (f64::from((number - 1) % 4) - 1.5);
    let rim = HALF_SIDE_MM - 4.0;
    let [x, y] = match (number - 1) / 4 {
        0 => [along, -rim],
        1 => [rim, along],
        2 => [-along, rim],
        _ => [-rim, -along],
    };
    let half = 3.0;
    let outline_mm = vec![[x - half, y - half], [x + half, y - half], [x + half, y + half], [x - half, y + half]];
    ElectrodeView { number, position_mm: [x, y], outline_mm }
}

fn argument(name: &str, otherwise: f64) -> Result<f64, Box<dyn Error>> {
    let mut arguments = env::args().skip_while(|argument| argument != name).skip(1);
    match arguments.next() {
        Some(text) => text.parse().map_err(|_| format!("{name} {text}: expected a number").into()),
        None => Ok(otherwise),
    }
}
