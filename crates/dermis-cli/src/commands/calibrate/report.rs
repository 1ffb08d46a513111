//! Reports on a calibration by pokes and on a force calibration.

use std::io::Write;

use dermis_live::calibration::{Calibration, LoadQuantity, StartReview, StartUse};
use dermis_skin::Skin;
use dermis_touch::force::ForceCalibration;
use dermis_touch::locator::{Accuracy, PriorUse};

use crate::commands::listed;

/// Standard errors from which a session counts as drifting.
const DRIFT_Z: f64 = 3.0;

pub(super) fn print_pokes(calibration: &Calibration, out: &mut dyn Write) -> std::io::Result<()> {
    let (report, review) = (calibration.leave_one_out(), calibration.review());
    writeln!(out, "pokes: {}", calibration.pokes())?;
    if review.repeated > 0 {
        writeln!(out, "exact repetitions of other pokes, left out: {}", review.repeated)?;
    }
    for (what, channels) in [
        ("channels with the same reading in every poke", &review.dead_channels),
        ("channels that jump while nothing touches the skin, left out", &review.unsound_channels),
    ] {
        if !channels.is_empty() {
            writeln!(out, "{what}: {}", listed(channels.iter().map(|c| *c as usize)))?;
        }
    }
    writeln!(
        out,
        "leave-one-out error: median {:.2} mm, 90th percentile {:.2} mm",
        report.median_error_m * 1e3,
        report.p90_error_m * 1e3
    )?;
    writeln!(
        out,
        "within one predicted sigma: {:.0} % in x, {:.0} % in y",
        100.0 * report.coverage[0],
        100.0 * report.coverage[1]
    )?;
    if let (Some(quantity), Some(error)) = (calibration.load_quantity(), report.load_error) {
        let name = match quantity {
            LoadQuantity::DepthM => "depth",
            LoadQuantity::ForceN => "force",
        };
        writeln!(out, "{name}: estimated within {:.0} % (one sigma)", 100.0 * error)?;
    }
    if calibration.has_silent_loads() {
        writeln!(out, "depth or force of the pokes: not estimated, since the frames do not grow with it")?;
    }
    if let Some(drift) = review.drift {
        let mm = |accuracy: Accuracy| format!("{:.2} mm", 1e3 * accuracy.median_m);
        let verdict = if drift.z > DRIFT_Z { "signatures drift" } else { "no drift seen" };
        writeln!(
            out,
            "time: {verdict}; median error {} when the first half locates the second, {} when every other poke locates \
             the rest",
            mm(drift.later),
            mm(drift.interleaved)
        )?;
    }
    Ok(())
}

/// Prints the parts of the locator in use, and the benefit of physics and sister skins.
pub(super) fn print_experts(
    skin: &Skin,
    calibration: &Calibration,
    differences: bool,
    no_physics: bool,
    out: &mut dyn Write,
) -> std::io::Result<()> {
    let report = calibration.experts();
    if let Some(start) = calibration.review().start {
        print_start(&start, out)?;
    }
    if calibration.is_as_built() {
        writeln!(out, "touches are located by a model of the skin as built, fitted to baseline and pokes")?;
    } else if calibration.correction().is_some() {
        writeln!(
            out,
            "touches are located by the skin's model, corrected by the pokes, and by the pokes where it sees nothing"
        )?;
        writeln!(out, "by pokes alone:")?;
    }
    let expert = |used: bool, a: &Accuracy| {
        let used = if used { "used" } else { "not used" };
        format!("median {:.2} mm, 90th percentile {:.2} mm, {used}", 1e3 * a.median_m, 1e3 * a.p90_m)
    };
    writeln!(out, "  from place to frame (Gaussian process): {}", expert(report.forward_used, &report.forward))?;
    writeln!(out, "  from frame to place (kernel regression): {}", expert(report.inverse_used, &report.inverse))?;
    let brought = |part: PriorUse| {
        let used = if part.used { "used" } else { "left out" };
        format!("{used}; changes the log density of left-out pokes by {:+.3} on average", part.gain)
    };
    match report.physics {
        Some(part) => writeln!(out, "physics of the skin file: {}", brought(part))?,
        None if no_physics => writeln!(out, "physics of the skin file: left out, as requested")?,
        None if !skin.backend.wiring.is_known() => writeln!(out, "physics: none, the wiring is unknown")?,
        None if differences => writeln!(out, "physics of the skin file: not tried")?,
        None => {}
    }
    for (what, part) in [
        ("map of the sister skin", report.sister_map),
        ("its noise", report.sister_covariance),
        ("pokes rotated to match it", report.sister_turn),
    ] {
        if let Some(part) = part {
            writeln!(out, "{what}: {}", brought(part))?;
        }
    }
    if !report.doubtful.is_empty() {
        let fate = if report.doubtful_left_out { "left out" } else { "kept" };
        writeln!(
            out,
            "pokes that contradict the others, {fate}: {} (check their positions)",
            listed(report.doubtful.iter().copied())
        )?;
    }
    Ok(())
}

/// Prints how an earlier calibration was used, and why.
fn print_start(start: &StartReview, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(
        out,
        "earlier calibration: explains {:.0} % of the new pokes (within 2.5 sigma), median error {:.2} mm unchanged",
        100.0 * start.explained,
        1e3 * start.unchanged_m
    )?;
    let used = match start.used {
        StartUse::Nothing => "not used: the new pokes alone are better",
        StartUse::Prior => "used as prior",
        StartUse::Pooled => "used: its pokes are pooled with the new ones",
        StartUse::Unchanged => "used unchanged: the new pokes do not improve it",
    };
    write!(out, "  {used}; median error on the new pokes {:.2} mm", 1e3 * start.chosen_m)?;
    match start.resemblance {
        Some(share) => writeln!(out, "; similarity of the sessions {share} (0: nothing in common, 1: no change)"),
        None => writeln!(out),
    }
}

pub(super) fn print_forces(calibration: &ForceCalibration, presses: usize, out: &mut dyn Write) -> std::io::Result<()> {
    let [least, most] = calibration.valid_force_n;
    let range = most - least;
    writeln!(out, "presses seen: {} of {presses}", calibration.samples)?;
    writeln!(out, "force: {least:.4} to {most:.4} N on {:.1} mm^2", 1e6 * calibration.scope.indenter_area_m2)?;
    let share = 100.0 * calibration.residual_n / range;
    if let Some(law) = &calibration.law {
        let factor = law.weights[0].exp();
        writeln!(out, "the layer's law is used, corrected by a factor of {factor:.3} in the middle of the skin")?;
        return writeln!(
            out,
            "error: {:.4} N rms of presses left out, {share:.1} % of the range",
            calibration.residual_n
        );
    }
    writeln!(out, "residual: {:.4} N rms, {share:.1} % of the range", calibration.residual_n)?;
    let saturated = calibration.signal.as_ref().and_then(|signal| Some((signal, signal.saturation_signal?)));
    match saturated {
        Some((signal, from)) => writeln!(out, "saturated above {:.4} N", signal.curve.force_n(from)),
        None => writeln!(out, "no saturation within the range"),
    }
}
