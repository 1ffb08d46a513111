//! What is believed of fitted patches, while they are followed and while they are looked for.

use dermis_tomo::eit::contacts::{ContactFit, ContactPatch, FitSummary};

/// A fit is believed up to this misfit.
pub(super) const BELIEVED: f64 = 2.0;
/// Patches larger than this, relative to half the shorter side, are several that are taken for one.
const LARGEST: f64 = 0.5;
/// Patches whose middles are nearer than this, relative to the sum of their radii, are one.
const APART: f64 = 1.0;
/// Patches that leave more than this share of a frame do not explain it.
const EXPLAINED: f64 = 0.3;

/// Whether patches explain a frame, lie apart, and are no larger than a touch.
pub(super) fn plausible(fits: &[ContactFit], summary: &FitSummary, half_width_m: f64) -> bool {
    let near = |a: &ContactPatch, b: &ContactPatch| {
        let distance = (a.position_m[0] - b.position_m[0]).hypot(a.position_m[1] - b.position_m[1]);
        distance < APART * (a.radius_m + b.radius_m)
    };
    let overlap = (1..fits.len()).any(|k| fits[..k].iter().any(|other| near(&fits[k].patch, &other.patch)));
    !overlap && !are_large(fits, half_width_m) && summary.misfit <= EXPLAINED * summary.energy
}

/// Whether any patch is larger than a touch.
pub(super) fn are_large(fits: &[ContactFit], half_width_m: f64) -> bool {
    fits.iter().any(|fit| fit.patch.radius_m > LARGEST * half_width_m)
}

/// Radius that a fit's patches may grow to on the way, metres: a little more than a touch has, so that those which want
/// to be larger show.
pub(super) fn most_radius_m(half_width_m: f64) -> f64 {
    1.05 * LARGEST * half_width_m
}
