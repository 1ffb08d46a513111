//! A patch's frame as one JSON line: the line of `dermis run --headless`, with the patch, the frames of reference of
//! the body and the net wrenches added.

use dermis_body::{ForceEstimate, SpatialTouch, Transform};
use dermis_record::sink::LineExtras;
use dermis_touch::{Touch, TouchPhase};
use serde::Serialize;

use super::joints::JointSnapshot;
use super::loads::NetWrench;

/// Fields that a body adds to a patch's line.
pub(super) struct BodyExtras<'a> {
    pub patch: &'a str,
    pub link: &'a str,
    pub root: &'a str,
    pub surface: dermis_tomo::mesh::Surface,
    pub link_from_patch: Transform,
    pub root_from_patch: Option<Transform>,
    pub joints: &'a JointSnapshot,
    pub on_link: &'a NetWrench,
    pub on_body: &'a NetWrench,
    pub force: &'a dyn Fn(&Touch) -> Option<ForceEstimate>,
}

impl<'a> LineExtras for BodyExtras<'a> {
    type Line = BodyLine<'a>;
    type Touch = BodyTouch;

    fn line(&self) -> BodyLine<'a> {
        BodyLine {
            patch: self.patch,
            link: self.link,
            root: self.root,
            joints: JointsObject { state: self.joints.state.name(), age_s: self.joints.age_s },
            link_wrench: WrenchObject::of(self.on_link),
            body_wrench: WrenchObject::of(self.on_body),
        }
    }

    fn touch(&self, touch: &Touch) -> BodyTouch {
        // A touch that has ended exerts no force.
        let force = if touch.phase == TouchPhase::End { None } else { (self.force)(touch) };
        let on_patch = SpatialTouch::of(touch, &self.surface, force);
        BodyTouch {
            in_patch: TouchInFrame::of(&on_patch),
            in_link: TouchInFrame::of(&on_patch.in_frame(&self.link_from_patch)),
            in_root: self.root_from_patch.as_ref().map(|place| TouchInFrame::of(&on_patch.in_frame(place))),
        }
    }
}

/// The fields of a line that a body adds.
#[derive(Serialize)]
pub(super) struct BodyLine<'a> {
    patch: &'a str,
    link: &'a str,
    root: &'a str,
    joints: JointsObject,
    link_wrench: WrenchObject<'a>,
    body_wrench: WrenchObject<'a>,
}

#[derive(Serialize)]
struct JointsObject {
    state: &'static str,
    age_s: Option<f64>,
}

/// A net wrench; null, with the reason, if it is unknown.
#[derive(Serialize)]
struct WrenchObject<'a> {
    force_n: Option<[f64; 3]>,
    torque_nm: Option<[f64; 3]>,
    covariance: Option<[[f64; 6]; 6]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    unknown: Option<&'a [String]>,
}

impl<'a> WrenchObject<'a> {
    fn of(net: &'a NetWrench) -> Self {
        let wrench = net.wrench.as_ref();
        Self {
            force_n: wrench.map(|wrench| wrench.force_n),
            torque_nm: wrench.map(|wrench| wrench.torque_nm),
            covariance: wrench.map(|wrench| wrench.covariance),
            unknown: if wrench.is_none() { Some(&net.unknown) } else { None },
        }
    }
}

/// The fields of a touch that a body adds.
#[derive(Serialize)]
pub(super) struct BodyTouch {
    in_patch: TouchInFrame,
    in_link: TouchInFrame,
    /// Null if the joints are unknown.
    in_root: Option<TouchInFrame>,
}

/// A touch in a frame of reference.
#[derive(Serialize)]
struct TouchInFrame {
    position_mm: [f64; 3],
    normal: [f64; 3],
    covariance_mm2: [[f64; 3]; 3],
    force_n: Option<[f64; 3]>,
}

impl TouchInFrame {
    fn of(touch: &SpatialTouch) -> Self {
        Self {
            position_mm: touch.position_m.map(|m| 1e3 * m),
            normal: touch.normal,
            covariance_mm2: touch.covariance_m2.map(|row| row.map(|m2| 1e6 * m2)),
            force_n: touch.force_n,
        }
    }
}
