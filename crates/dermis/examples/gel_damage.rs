//! Monitors a gel that drifts and is cut, from a long file of frames. Prints what the pipeline reports about
//! damage, and draws the images of the selected frames. Frames are eight seconds apart and count from 0.
//!
//! `cargo run --release -p dermis --example gel_damage -- monitored.csv gel-damage.svg 493 663 664 667`

use std::fmt::Write as _;

use dermis::{Error, FileError};
use dermis_device::{FileSpec, Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::stages::damage::describe;
use dermis_skin::Skin;

/// Seconds between frames.
const PERIOD_S: f64 = 8.0;
/// Side of a panel, pixels.
const SIDE: f64 = 220.0;
/// Space around a panel, pixels.
const GAP: f64 = 14.0;

/// An image with its name, and the ends of each damage in it.
struct Panel {
    name: String,
    image: Vec<f32>,
    ends: Vec<[[f64; 2]; 2]>,
}

fn main() -> Result<(), Error> {
    let mut arguments = std::env::args().skip(1);
    let (Some(frames), Some(out)) = (arguments.next(), arguments.next()) else {
        eprintln!("usage: gel_damage FRAMES.csv OUT.svg [FRAME...]");
        return Ok(());
    };
    let drawn: Vec<usize> = arguments.filter_map(|number| number.parse().ok()).collect();
    let mut skin = Skin::open("hydrogel-disc")?;
    skin.damage.watch = true;
    let prepared = Prepared::new(skin)?;
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None)?;
    let table = dermis_device::read(&FileSpec::all(frames), None)?;
    let (mut frame, mut panels) = (Frame::default(), Vec::new());
    for (index, values) in table.rows().enumerate() {
        let time_ns = (index as f64 * PERIOD_S * 1e9) as u64;
        frame.refill(index as u64, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, values, &[]);
        frame.device_time_ns = Some(time_ns);
        let damage = pipeline.process(&frame, time_ns)?.damage;
        for event in damage.events.iter() {
            println!("frame {index}: {}", describe(event));
        }
        if index % 100 == 99 {
            println!("frame {index}: the readings have drifted by {:.1} %", 100.0 * damage.drift);
        }
        if drawn.contains(&index) {
            let ends = damage.damages.iter().map(|damage| damage.shape.ends_m()).collect();
            panels.push(Panel { name: format!("frame {index}"), image: damage.image.to_vec(), ends });
        }
    }
    let grid = *pipeline.prepared().map.grid();
    let text = svg(&panels, grid.columns, |[x, y]| [(x - grid.left_m) / grid.pixel_m, (grid.top_m - y) / grid.pixel_m]);
    std::fs::write(&out, text).map_err(|source| Error::Io(FileError { file: out.into(), source }))
}

/// Panels side by side, each on its own scale: red where the skin conducts less and blue where it conducts more.
fn svg(panels: &[Panel], columns: usize, place: impl Fn([f64; 2]) -> [f64; 2]) -> String {
    let (width, height) = (panels.len() as f64 * (SIDE + GAP) + GAP, SIDE + 2.0 * GAP + 44.0);
    let mut text = format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\">\n");
    // The page around it may be dark. Writing to a String cannot fail.
    let _ = writeln!(text, "<rect width=\"{width}\" height=\"{height}\" fill=\"white\"/>");
    let pixel = SIDE / columns as f64;
    for (index, Panel { name, image, ends }) in panels.iter().enumerate() {
        let left = GAP + index as f64 * (SIDE + GAP);
        let largest = image.iter().copied().filter(|value| value.is_finite()).fold(1e-9_f32, f32::max);
        for (cell, value) in image.iter().enumerate().filter(|(_, value)| value.is_finite()) {
            let (x, y) = (left + (cell % columns) as f64 * pixel, GAP + (cell / columns) as f64 * pixel);
            let side = pixel + 0.2;
            let fill = colour(value / largest);
            let _ = writeln!(
                text,
                "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{side:.1}\" height=\"{side:.1}\" fill=\"{fill}\"/>"
            );
        }
        for [from, to] in ends {
            let [[x0, y0], [x1, y1]] = [place(*from), place(*to)].map(|[x, y]| [left + x * pixel, GAP + y * pixel]);
            let _ =
                writeln!(text, "<path d=\"M{x0:.1} {y0:.1}L{x1:.1} {y1:.1}\" stroke=\"black\" stroke-width=\"2\"/>");
        }
        let (x, y) = (left + 0.5 * SIDE, SIDE + 2.0 * GAP + 6.0);
        let style = "font-family=\"sans-serif\" font-size=\"14\" text-anchor=\"middle\"";
        let _ = writeln!(text, "<text x=\"{x:.1}\" y=\"{y:.1}\" {style}>{name}, to {:.1} %</text>", 100.0 * largest);
    }
    let y = SIDE + 2.0 * GAP + 30.0;
    let _ = writeln!(
        text,
        "<text x=\"{GAP}\" y=\"{y:.1}\" font-family=\"sans-serif\" font-size=\"12\" fill=\"#555\">against the intact skin, drift \
         followed: red, conducts less; blue, better; black, the long axis of the damage in the record</text>"
    );
    text.push_str("</svg>\n");
    text
}

fn colour(share: f32) -> String {
    // Sixteen steps in each direction are enough for the eye.
    let step = (16.0 * share.clamp(-1.0, 1.0)).round() / 16.0;
    let end: [f32; 3] = if step < 0.0 { [33.0, 102.0, 172.0] } else { [200.0, 50.0, 30.0] };
    let [r, g, b] = end.map(|end| (248.0 + step.abs() * (end - 248.0)).round() as u8);
    format!("#{r:02x}{g:02x}{b:02x}")
}
