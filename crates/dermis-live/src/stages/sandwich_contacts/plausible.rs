//! Rules for accepting fitted patches, during tracking and search.

use dermis_tomo::eit::contacts::{ContactFit, ContactPatch, FitSummary};

/// Largest misfit of an accepted fit.
pub(super) const BELIEVED: f64 = 2.0;
/// Largest radius of a patch, relative to half the shorter side. A larger patch stands for several touches.
const LARGEST: f64 = 0.5;
/// Smallest distance of two patches, relative to the sum of their radii. Patches that are nearer are one.
const APART: f64 = 1.0;
/// Largest share of a frame that patches may leave unexplained.
const EXPLAINED: f64 = 0.3;

/// True if patches explain a frame, don't overlap, and are no larger than a touch.
pub(super) fn plausible(fits: &[ContactFit], summary: &FitSummary, half_width_m: f64) -> bool {
    let near = |a: &ContactPatch, b: &ContactPatch| {
        let distance = (a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]);
        distance < APART * (a.radius_m + b.radius_m)
    };
    let overlap = (1..fits.len()).any(|k| fits[..k].iter().any(|other| near(&fits[k].patch, &other.patch)));
    !overlap && !are_large(fits, half_width_m) && summary.misfit <= EXPLAINED * summary.energy
}

/// True if any patch is larger than a touch.
pub(super) fn are_large(fits: &[ContactFit], half_width_m: f64) -> bool {
    fits.iter().any(|fit| fit.patch.radius_m > LARGEST * half_width_m)
}

/// Largest radius that a patch may reach during a fit, metres: slightly more than a touch can have, so that patches
/// that tend to be larger show up.
pub(super) fn most_radius_m(half_width_m: f64) -> f64 {
    1.05 * LARGEST * half_width_m
}
