//! `dermis run BODY.toml`: runs all skins of a robot at once and prints JSON lines.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use dermis::BodyRun;
use dermis::body::{BodyRunOptions, PatchHealth, PatchState};
use dermis_body::Body;
use serde_json::{Value, json};

use super::super::{busy, hint};
use super::viewers::tell_not_shown;
use crate::exit::Outcome;
use crate::interrupt;

/// Interval between printed tables of health.
const HEALTH_EVERY: Duration = Duration::from_secs(1);
/// Longest wait for a line.
const NAP: Duration = Duration::from_millis(50);

/// Runs a body until every patch has ended or the user interrupts.
pub(super) fn run(
    file: &Path,
    options: &BodyRunOptions,
    only_touches: bool,
    out: &mut dyn Write,
) -> anyhow::Result<Outcome> {
    let (body, problems) = Body::examine(file)?;
    let mut has_left_out = false;
    for problem in problems {
        if problem.only_drawn {
            tracing::warn!("{}", problem.error);
        } else if options.keep_going {
            tracing::error!("{}", problem.error);
            has_left_out = true;
        } else {
            return Err(problem.error.into());
        }
    }
    if options.joints.is_none() && body.joint_source.is_none() && !body.needed_joints().is_empty() {
        let needed: Vec<&str> = body.needed_joints().into_iter().collect();
        hint(&format!("{} stand still: --joints SOURCE says where they are", needed.join(", ")));
    }
    let busy = busy(format!("preparing {} patches", body.patches.len()));
    #[cfg_attr(not(feature = "ros2"), expect(unused_mut, reason = "only a node is closed before the end"))]
    let mut run = BodyRun::start(body, options)?;
    busy.finish();
    if let Some(address) = run.guard_address() {
        eprintln!("guard: {address}");
    }
    #[cfg(feature = "foxglove")]
    if let Some(address) = run.foxglove_address() {
        super::viewers::announce(address);
    }
    let interrupted = interrupt::begin();
    let outcome = follow(&run, only_touches, interrupted, out);
    #[cfg(feature = "ros2")]
    run.close_ros2().iter().for_each(super::ros2::print_summary);
    let health = run.finish();
    outcome?;
    let is_lossy = |row: &PatchHealth| {
        let PatchHealth { patch, lost, damaged, dropped, unread, not_recorded, .. } = row;
        let in_all = lost + damaged + dropped + unread + not_recorded;
        if in_all > 0 {
            tracing::error!(%patch, lost, damaged, dropped, unread, not_recorded, "frames were lost");
        }
        in_all > 0 || row.recording_problem.is_some() || matches!(row.state, PatchState::Failed(_))
    };
    tell_not_shown(health.iter().map(|row| row.not_shown).sum());
    let lossy = health.iter().filter(|row| is_lossy(row)).count();
    Ok(if lossy > 0 || has_left_out { Outcome::DataLost } else { Outcome::Done })
}

fn follow(
    run: &BodyRun,
    only_touches: bool,
    interrupted: &std::sync::atomic::AtomicBool,
    out: &mut dyn Write,
) -> anyhow::Result<()> {
    let begun = Instant::now();
    let mut told = begun;
    let ended = loop {
        if interrupted.load(Ordering::Relaxed) {
            break false;
        }
        match run.next(NAP) {
            Some(report) if only_touches && report.touches.is_empty() => {}
            Some(report) => {
                out.write_all(&report.line)?;
                out.flush()?;
            }
            None if run.has_ended() => break true,
            None => {}
        }
        if told.elapsed() >= HEALTH_EVERY {
            told = Instant::now();
            print_health(run, begun, out)?;
        }
    };
    if ended {
        print_health(run, begun, out)?;
    }
    Ok(())
}

fn print_health(run: &BodyRun, begun: Instant, out: &mut dyn Write) -> anyhow::Result<()> {
    let row = |row: PatchHealth| -> Value {
        let reason = match &row.state {
            PatchState::Failed(reason) => Some(reason.clone()),
            _ => row.problem.clone(),
        };
        json!({
            "patch": row.patch, "state": row.state.name(), "problem": reason, "frames": row.frames, "lost": row.lost,
            "damaged": row.damaged, "dropped": row.dropped, "unread": row.unread, "touches": row.touches,
            "channels_left_out": row.channels_left_out,
            "latency_p99_ms": if row.latency_p99_ms.is_finite() { json!(row.latency_p99_ms) } else { Value::Null },
        })
    };
    let patches: Vec<Value> = run.health().into_iter().map(row).collect();
    let health = json!({ "health": {
        "running_s": (1e3 * begun.elapsed().as_secs_f64()).round() / 1e3,
        "joints_problem": run.joints_problem(), "patches": patches,
    } });
    writeln!(out, "{health}")?;
    Ok(out.flush()?)
}
