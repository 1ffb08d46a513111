//! Cuts a sandwich skin, presses on the cut, releases, and heals it in time-lapse. Prints what the pipeline reports
//! about the damage, and draws the images relative to the intact skin side by side.
//!
//! `cargo run --release -p dermis --example damage -- damage.svg`

use std::fmt::Write as _;

use dermis::{Error, FileError};
use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::stages::damage::describe;
use dermis_skin::Skin;
use dermis_twin::physics::Cut;
use dermis_twin::{AnyTwin, TwinKit};
use dermis_twin::{Frontend, Heating, Treatment};

/// Side of a panel, pixels.
const SIDE: f64 = 220.0;
/// Space around a panel, pixels.
const GAP: f64 = 14.0;
/// Drop below the intact skin at which the colour saturates.
const FALL: f32 = 0.2;
/// Rise above the intact skin at which the colour saturates.
const RISE: f32 = 0.8;

/// An image with its name, and the ends of the cuts fitted in it.
struct Panel {
    name: String,
    image: Vec<f32>,
    ends: Vec<[[f64; 2]; 2]>,
}

/// A twin and the pipeline that follows it.
struct Line {
    twin: AnyTwin,
    pipeline: Pipeline,
    ticks: u64,
    time_s: f64,
    period_s: f64,
    panels: Vec<Panel>,
}

impl Line {
    /// Runs for a time and prints changes of the damage.
    fn run(&mut self, seconds: f64) -> Result<(), Error> {
        let end = self.time_s + seconds;
        let (mut values, mut frame) = (Vec::new(), Frame::default());
        while self.time_s < end {
            self.time_s += self.period_s;
            self.twin.step(self.time_s, &mut values)?;
            let time_ns = (self.time_s * 1e9) as u64;
            frame.refill(self.ticks, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, &values, &[]);
            frame.device_time_ns = Some(time_ns);
            self.ticks += 1;
            let output = self.pipeline.process(&frame, time_ns)?;
            for event in output.damage.events.iter() {
                println!("{:6.1} s  {}", self.time_s, describe(event));
            }
        }
        Ok(())
    }

    fn treat(&mut self, treatment: Treatment) -> Result<(), Error> {
        Ok(self.twin.frontend_mut().treat(&treatment)?)
    }

    fn draw(&mut self, name: &str) {
        let view = self.pipeline.damage();
        let ends = view.damages.iter().map(|damage| damage.shape.ends_m()).collect();
        self.panels.push(Panel { name: name.to_owned(), image: view.image.to_vec(), ends });
        let truth = self.twin.frontend().wounds().first().map_or(0.0, |wound| wound.healed);
        for state in view.healing.iter() {
            println!(
                "{:6.1} s  {name}: {:.0} % joined (truth {:.0} %), {:.0} % of the response left, sheet risen by {:.1} %",
                self.time_s,
                100.0 * state.joined,
                100.0 * truth,
                100.0 * state.left,
                100.0 * state.rise
            );
        }
    }
}

fn colour(value: f32) -> String {
    // Sixteen steps in each direction are enough for the eye and keep the file small.
    let share = if value < 0.0 { -value / FALL } else { value / RISE };
    let share = (16.0 * share.min(1.0)).round() / 16.0;
    let end: [f32; 3] = if value < 0.0 { [33.0, 102.0, 172.0] } else { [200.0, 50.0, 30.0] };
    let [r, g, b] = end.map(|end| (248.0 + share * (end - 248.0)).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}

/// Panels side by side: blue where the image is lower, red where it is higher, fitted cuts as lines.
fn svg(line: &Line) -> String {
    let grid = *line.pipeline.prepared().map.grid();
    let width = line.panels.len() as f64 * (SIDE + GAP) + GAP;
    let height = SIDE + 3.0 * GAP + 32.0;
    let mut text = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\">\n");
    // The page around it may be dark.
    let _ = writeln!(text, "<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>");
    let pixel = SIDE / grid.columns as f64;
    for (index, Panel { name, image, ends }) in line.panels.iter().enumerate() {
        let left = GAP + index as f64 * (SIDE + GAP);
        for (row, values) in image.chunks(grid.columns).enumerate() {
            let mut start = 0;
            while start < values.len() {
                let here = colour(values[start]);
                let end = (start + 1..values.len()).find(|&k| colour(values[k]) != here).unwrap_or(values.len());
                let (x, y) = (left + start as f64 * pixel, GAP + row as f64 * pixel);
                let (w, h) = ((end - start) as f64 * pixel + 0.2, pixel + 0.2);
                // Writing to a String cannot fail.
                let _ = writeln!(
                    text,
                    "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{w:.1}\" height=\"{h:.1}\" fill=\"{here}\"/>"
                );
                start = end;
            }
        }
        let place = |p: [f64; 2]| {
            let (column, row) = ((p[0] - grid.left_m) / grid.pixel_m, (grid.top_m - p[1]) / grid.pixel_m);
            (left + column * pixel, GAP + row * pixel)
        };
        for [from, to] in ends {
            let ((x0, y0), (x1, y1)) = (place(*from), place(*to));
            let _ =
                writeln!(text, "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\" stroke=\"black\" stroke-width=\"2\"/>");
        }
        let (x, y) = (left + 0.5 * SIDE, SIDE + 2.0 * GAP + 10.0);
        let style = "font-family=\"sans-serif\" font-size=\"14\" text-anchor=\"middle\"";
        let _ = writeln!(text, "<text x=\"{x:.1}\" y=\"{y:.1}\" {style}>{name}</text>");
    }
    let _ = writeln!(
        text,
        "<text x=\"{GAP}\" y=\"{:.1}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#555\">against the intact skin: blue, conductivity down to {:.0} %; \
         red, up to +{:.0} %; black, damage in the record</text>",
        SIDE + 3.0 * GAP + 22.0,
        -100.0 * FALL,
        100.0 * RISE
    );
    text.push_str("</svg>\n");
    text
}

fn main() -> Result<(), Error> {
    let skin = Skin::open("healing-square")?;
    let prepared = Prepared::new(skin.clone())?;
    let layout = Layout::Channels { count: prepared.channels() };
    let twin = TwinKit::of(&skin)?.twin;
    let pipeline = Pipeline::new(prepared, &layout, None)?;
    let mut line = Line { twin, pipeline, ticks: 0, time_s: 0.0, period_s: 0.1, panels: Vec::new() };
    line.run(5.0)?;
    line.treat(Treatment::Cut(Cut::open([0.015, 0.018], [0.031, 0.03])))?;
    line.run(8.0)?;
    line.draw("cut");
    line.twin.scene_mut().press(1, 0.023, 0.024, 0.0125, 80e3)?;
    line.run(5.0)?;
    line.draw("pressed on the cut");
    line.twin.scene_mut().release(1);
    line.run(5.0)?;
    line.draw("released");
    // As published: 90 C for two hours.
    let (centre_m, radius_m) = ([0.023, 0.024], 0.025);
    line.treat(Treatment::Heat(Heating { centre_m, radius_m, temperature_c: 90.0, duration_s: 7200.0 }))?;
    // Two hours in a minute and a half. Every frame has a different sheet, so use fewer frames.
    line.period_s = 0.4;
    line.treat(Treatment::TimeLapse(80.0))?;
    line.run(120.0)?;
    line.draw("after the heat");
    // Two days in two minutes.
    line.treat(Treatment::TimeLapse(1440.0))?;
    line.run(160.0)?;
    line.draw("two days later");
    let proposal = line.pipeline.damage().proposal;
    let why = proposal.map_or("the sheet has healed", |proposal| proposal.reason.name());
    println!(
        "{:6.1} s  a new baseline, {}: {why}",
        line.time_s,
        if proposal.is_some() { "proposed" } else { "requested" }
    );
    line.pipeline.tare(false, why)?;
    line.period_s = 0.1;
    line.run(10.0)?;
    line.draw("new baseline");
    if let Some(path) = std::env::args().nth(1) {
        std::fs::write(&path, svg(&line)).map_err(|source| Error::Io(FileError { file: path.into(), source }))?;
    }
    Ok(())
}
