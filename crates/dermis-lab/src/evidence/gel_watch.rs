//! `hydrogel-damage`: a gel skin watched for two hours, with two disturbances. The second one changes the readings
//! permanently.

use dermis_device::{FileSpec, Frame, FrameTable, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_skin::Skin;
use dermis_touch::ReferenceOrigin;
use dermis_touch::damage::DamageEvent;

use super::bench::{Bench, Row, Stop};
use super::finding::{Comparison, Figure};
use crate::Error;

/// Time between frames, seconds.
pub const PERIOD_S: f64 = 8.0;
/// First frame of the first disturbance, counted from 0. Until then the skin is untouched.
pub const FIRST_DISTURBED: usize = 491;
/// The last frame of the second disturbance, counted from 0.
pub const LAST_DISTURBED: usize = 664;
/// Threshold of the plain watch, in standard deviations.
const PLAIN_SIGMAS: f64 = 8.0;
/// Frames from which the plain watch takes mean and noise.
const PLAIN_FRAMES: usize = 64;

/// Record of a long watch.
#[derive(Clone, Debug, Default)]
pub struct Watched {
    /// Number of frames.
    pub frames: usize,
    /// Damage events, each with the frame that reported it.
    pub events: Vec<(usize, DamageEvent)>,
    /// Frames with a touch.
    pub touched: Vec<usize>,
    /// Mean relative change of the readings that was followed as drift.
    pub drift: f64,
    /// Origins of the baselines used, oldest first.
    pub origins: Vec<ReferenceOrigin>,
}

/// Runs a skin's live pipeline, with its watch for damage, over frames that are `period_s` apart.
///
/// # Errors
/// The skin cannot be prepared, or the frames don't fit it.
pub fn watch(skin: Skin, table: &FrameTable, period_s: f64) -> Result<Watched, Error> {
    let prepared = Prepared::new(skin)?;
    let layout = Layout::Channels { count: prepared.channels() };
    let mut pipeline = Pipeline::new(prepared, &layout, None)?;
    let (mut frame, mut watched) = (Frame::default(), Watched::default());
    for (index, values) in table.rows().enumerate() {
        let time_ns = (index as f64 * period_s * 1e9) as u64;
        frame.refill(index as u64, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, values, &[]);
        frame.device_time_ns = Some(time_ns);
        let output = pipeline.process(&frame, time_ns)?;
        watched.events.extend(output.damage.events.iter().map(|event| (index, *event)));
        if !output.touches.is_empty() {
            watched.touched.push(index);
        }
        watched.drift = output.damage.drift;
        watched.frames = index + 1;
    }
    watched.origins = pipeline.baseline_records().iter().map(|record| record.origin).collect();
    Ok(watched)
}

/// `hydrogel-disc` with the damage watch enabled.
///
/// # Errors
/// None in practice, since the skin is built in.
pub fn skin() -> Result<Skin, Error> {
    let mut skin = Skin::open("hydrogel-disc")?;
    skin.damage.watch = true;
    Ok(skin)
}

pub(super) fn measure(bench: &mut Bench<'_>) -> Result<(), Stop> {
    let file = bench.need("monitored.csv")?;
    bench.say("watching");
    let table = dermis_device::read(&FileSpec::all(&file), None)?;
    let watched = watch(skin()?, &table, PERIOD_S)?;
    let begins: Vec<usize> = watched
        .events
        .iter()
        .filter(|(_, event)| matches!(event, DamageEvent::Begin(_)))
        .map(|(frame, _)| *frame)
        .collect();
    let early = watched.touched.iter().filter(|frame| **frame < FIRST_DISTURBED).count();
    let mut here = vec![Figure::new("damage sites reported", begins.len() as f64, "")];
    if let Some(&frame) = begins.first() {
        here[0].unit = "in all".into();
        here.push(Figure::new("first in frame", frame as f64, "(from 0)"));
        here.push(Figure::new("delay after the last disturbance", frame as f64 - LAST_DISTURBED as f64, "frames"));
    }
    here.push(Figure::count("false touches before the first disturbance", early, FIRST_DISTURBED));
    here.push(Figure::new("drift followed", 100.0 * watched.drift, "%"));
    let plain = plain_watch(&table).map_or(f64::NAN, |frame| frame as f64);
    bench.add(Row {
        measured: &format!("damage detection over {} frames", watched.frames),
        known: "the skin file with `watch = true` and eight seconds between frames; not when or where anything happened",
        here,
        plain: Comparison::computed(
            "a threshold of 8 standard deviations of the first 64 frames, without following drift",
            vec![Figure::new("damage reported in frame", plain, "(from 0)")],
        ),
        published: Comparison::said("none: time and place of the damage are unknown"),
    });
    Ok(())
}

/// The first frame whose normalised distance from the first frames (root mean square over channels) exceeds the
/// threshold.
fn plain_watch(table: &FrameTable) -> Option<usize> {
    let rows: Vec<&[f64]> = table.rows().collect();
    let first = rows.get(..PLAIN_FRAMES)?;
    let channels = first.first()?.len();
    let statistics: Vec<[f64; 2]> = (0..channels)
        .map(|channel| {
            let mean = first.iter().map(|row| row[channel]).sum::<f64>() / PLAIN_FRAMES as f64;
            let variance = first.iter().map(|row| (row[channel] - mean).powi(2)).sum::<f64>() / PLAIN_FRAMES as f64;
            [mean, variance.sqrt().max(f64::MIN_POSITIVE)]
        })
        .collect();
    let distance = |row: &[f64]| {
        let sum: f64 = row.iter().zip(&statistics).map(|(value, [mean, sigma])| ((value - mean) / sigma).powi(2)).sum();
        (sum / channels as f64).sqrt()
    };
    (PLAIN_FRAMES..rows.len()).find(|&index| distance(rows[index]) > PLAIN_SIGMAS)
}
