//! Loads on a body: the last presses of every patch, and their net wrench on each link and on the whole body.

use std::sync::{Mutex, PoisonError};

use dermis_body::{Body, ForceEstimate, JointValues, Press, Transform, Vector, Wrench, presses};
use dermis_live::skin_frame::SkinFrame;
use dermis_touch::Touch;

/// The presses of one patch.
#[derive(Clone, Debug)]
struct PatchLoad {
    /// Presses of known force.
    presses: Vec<Press>,
    /// Reasons for an unknown sum: touches without a force, a silent patch.
    unknown: Vec<String>,
}

/// The presses of every patch.
#[derive(Debug)]
pub(super) struct Loads(Mutex<Vec<PatchLoad>>);

/// A net wrench, or the reasons why it is unknown.
///
/// No example here: part of the reports of [`BodyRun`](crate::BodyRun).
#[derive(Clone, Debug, PartialEq)]
pub struct NetWrench {
    /// `None` if a touch's force is unknown or a patch is silent, because a partial sum would be misleading.
    pub wrench: Option<Wrench>,
    /// Reasons why it is unknown.
    pub unknown: Vec<String>,
}

impl Loads {
    /// Loads before the first frame of any patch.
    pub fn new(body: &Body) -> Self {
        let silent = |name: &str| PatchLoad { presses: Vec::new(), unknown: vec![format!("{name}: no frame yet")] };
        Self(Mutex::new(body.patches.iter().map(|patch| silent(&patch.name)).collect()))
    }

    /// Takes a patch's frame. Its load is unknown until it has a baseline.
    pub fn set(
        &self,
        patch: usize,
        name: &str,
        output: &SkinFrame<'_>,
        force: impl Fn(&Touch) -> Option<ForceEstimate>,
    ) {
        if !output.is_ready {
            return self.lose(patch, format!("{name}: no baseline yet"));
        }
        let (presses, without_force) = presses(&output.touches, force);
        let why = |touch: &&Touch| format!("{name}: touch {} has no force: {}", touch.id, why_no_force(touch));
        let unknown = without_force.iter().map(why).collect();
        self.with(|loads| loads[patch] = PatchLoad { presses, unknown });
    }

    /// Marks a patch's load as unknown.
    pub fn lose(&self, patch: usize, why: String) {
        self.with(|loads| loads[patch] = PatchLoad { presses: Vec::new(), unknown: vec![why] });
    }

    /// Net wrench on a link, in its frame, about its origin.
    pub fn on_link(&self, body: &Body, link: usize) -> NetWrench {
        self.sum(body, |patch| (body.patches[patch].link == link).then(|| Ok(body.patches[patch].link_from_patch)))
    }

    /// Net wrench on the whole body, in the root's frame, about its origin.
    pub fn on_body(&self, body: &Body, joints: Option<&JointValues>) -> NetWrench {
        self.sum(body, |patch| {
            let place = joints.and_then(|joints| body.root_from_patch(patch, joints));
            let lost = || format!("{}: the positions of its joints are unknown", body.patches[patch].name);
            Some(place.ok_or_else(lost))
        })
    }

    /// Sum over the patches for which `place` gives a pose. An error is the reason why a patch has none.
    fn sum(&self, body: &Body, place: impl Fn(usize) -> Option<Result<Transform, String>>) -> NetWrench {
        const ORIGIN: Vector = [0.0; 3];
        let loads = self.with(|loads| loads.clone());
        let (mut net, mut unknown) = (Wrench::none_about(ORIGIN), Vec::new());
        for (patch, load) in loads.iter().enumerate() {
            let Some(place) = place(patch) else { continue };
            unknown.extend(load.unknown.iter().cloned());
            if load.presses.is_empty() {
                continue;
            }
            match place {
                Ok(place) => {
                    let surface = body.patches[patch].surface();
                    let wrenches = load.presses.iter().map(|press| Wrench::of(press, &surface, &place, ORIGIN));
                    net = wrenches.fold(net, |sum, wrench| sum.plus(&wrench));
                }
                Err(why) => unknown.push(why),
            }
        }
        NetWrench { wrench: unknown.is_empty().then_some(net), unknown }
    }

    fn with<T>(&self, work: impl FnOnce(&mut Vec<PatchLoad>) -> T) -> T {
        work(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

fn why_no_force(touch: &Touch) -> &'static str {
    match touch.force.map(|force| force.range()) {
        None => "no force calibration",
        Some("below") => "below its calibration",
        Some("above") => "above its calibration",
        Some("saturated") => "the skin is saturated",
        Some(_) => "not a finite number",
    }
}
