//! `dermis run BODY.toml`: runs all skins of a robot at once, and shows them on a page or prints JSON lines.

use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use dermis::BodyRun;
use dermis::body::{BodyRunOptions, PatchHealth, PatchState};
use dermis_body::{Body, JointSource};
use serde_json::{Value, json};

use super::super::{busy, hint, spinner};
use super::body_page::PageOfBody;
use super::source;
use super::viewers::tell_not_shown;
use crate::exit::{Outcome, UsageError};
use crate::interrupt;
use crate::page::Binding;

/// Interval between printed tables of health.
const HEALTH_EVERY: Duration = Duration::from_secs(1);
/// Longest wait for a line.
const NAP: Duration = Duration::from_millis(50);

/// Output of a running body.
pub(super) enum Shown {
    /// JSON lines on standard output.
    Lines {
        /// Only frames with touches.
        only_touches: bool,
    },
    /// A page at this address.
    Page {
        /// The address.
        binding: Box<Binding>,
        /// Opens it in a browser.
        opens_browser: bool,
    },
}

/// Runs a body until every patch has ended or the user interrupts.
pub(super) fn run(file: &Path, options: &BodyRunOptions, shown: Shown, out: &mut dyn Write) -> anyhow::Result<Outcome> {
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
    let mut options = options.clone();
    if matches!(shown, Shown::Page { .. }) && body.joint_source.is_none() {
        options.joints.get_or_insert(JointSource::Page);
    }
    if let (Shown::Lines { .. }, Some(JointSource::Page)) =
        (&shown, options.joints.as_ref().or(body.joint_source.as_ref()))
    {
        let text = "joints from the page: expected another source with --headless, which has no page";
        return Err(UsageError(text.into()).into());
    }
    if options.joints.is_none() && body.joint_source.is_none() && !body.needed_joints().is_empty() {
        let needed: Vec<&str> = body.needed_joints().into_iter().collect();
        hint(&format!("joints without a source: {}; --joints SOURCE gives them one", needed.join(", ")));
    }
    let busy = busy("preparing the patches".to_owned());
    let mut page = matches!(shown, Shown::Page { .. }).then(|| PageOfBody::new(body.patches.len()));
    #[cfg_attr(not(feature = "ros2"), expect(unused_mut, reason = "only a node is closed before the end"))]
    let mut run =
        BodyRun::start_with(body, &options, &mut |watch, patch| Some(page.as_mut()?.publisher(watch, patch)))?;
    busy.finish();
    let (only_touches, server) = match (shown, page) {
        (Shown::Page { binding, opens_browser }, Some(page)) => {
            let server = page.serve(*binding, run.watch())?;
            writeln!(out, "page: {}", server.url())?;
            out.flush()?;
            if opens_browser {
                source::open_browser(&server.url());
            }
            (false, Some(server))
        }
        (Shown::Lines { only_touches }, _) => (only_touches, None),
        (Shown::Page { .. }, None) => (false, None),
    };
    if let Some(address) = run.guard_address() {
        eprintln!("guard: {address}");
    }
    #[cfg(feature = "foxglove")]
    if let Some(address) = run.foxglove_address() {
        super::viewers::announce(address);
    }
    let interrupted = interrupt::begin();
    let outcome = match &server {
        Some(_) => follow_silently(&run, interrupted),
        None => follow(&run, only_touches, interrupted, out),
    };
    #[cfg(feature = "ros2")]
    run.close_ros2().iter().for_each(super::ros2::print_summary);
    let health = run.finish();
    match (server, &outcome) {
        (Some(server), Ok(true)) => server.shutdown_because("every patch has ended"),
        (server, _) => drop(server),
    }
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

/// Takes the reports, which the page doesn't need; returns true if every patch has ended by itself.
fn follow_silently(run: &BodyRun, interrupted: &AtomicBool) -> anyhow::Result<bool> {
    let bar = spinner("running");
    let mut told = Instant::now();
    while !interrupted.load(Ordering::Relaxed) {
        if run.next(NAP).is_none() && run.has_ended() {
            return Ok(true);
        }
        if told.elapsed() >= HEALTH_EVERY {
            told = Instant::now();
            let state = |row: PatchHealth| format!("{} {}", row.patch, row.state.name());
            bar.set_message(run.health().into_iter().map(state).collect::<Vec<_>>().join(", "));
        }
    }
    Ok(false)
}

/// Prints the reports; returns true if every patch has ended by itself.
fn follow(run: &BodyRun, only_touches: bool, interrupted: &AtomicBool, out: &mut dyn Write) -> anyhow::Result<bool> {
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
    Ok(ended)
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
