//! A patch's frame as one JSON line: the line of `dermis run --headless`, with the patch, the frames of reference of
//! the body and the net wrenches added.

use std::fmt::Write as _;

use dermis_body::{ForceEstimate, SpatialTouch, Transform};
use dermis_record::sink::LineExtras;
use dermis_touch::{Touch, TouchPhase};

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

impl LineExtras for BodyExtras<'_> {
    fn line(&self, line: &mut String) {
        // Writing to a String cannot fail. Names are escaped because those of links can contain any character.
        let text = |name: &str| serde_json::Value::from(name).to_string();
        let _ =
            write!(line, ",\"patch\":{},\"link\":{},\"root\":{}", text(self.patch), text(self.link), text(self.root));
        let _ = write!(line, ",\"joints\":{{\"state\":\"{}\",\"age_s\":", self.joints.state.name());
        push_number(line, self.joints.age_s.unwrap_or(f64::NAN));
        line.push_str("},\"link_wrench\":");
        push_wrench(line, self.on_link);
        line.push_str(",\"body_wrench\":");
        push_wrench(line, self.on_body);
    }

    fn touch(&self, line: &mut String, touch: &Touch) {
        // A touch that has ended exerts no force.
        let force = if touch.phase == TouchPhase::End { None } else { (self.force)(touch) };
        if let Some(force) = force {
            line.push_str(",\"sigma_force_n\":");
            push_number(line, force.sigma_n);
        }
        let on_patch = SpatialTouch::of(touch, &self.surface, force);
        line.push_str(",\"in_patch\":");
        push_touch(line, &on_patch);
        line.push_str(",\"in_link\":");
        push_touch(line, &on_patch.in_frame(&self.link_from_patch));
        line.push_str(",\"in_root\":");
        match &self.root_from_patch {
            Some(place) => push_touch(line, &on_patch.in_frame(place)),
            None => line.push_str("null"),
        }
    }
}

fn push_touch(line: &mut String, touch: &SpatialTouch) {
    line.push_str("{\"position_mm\":");
    push_list(line, touch.position_m.map(|m| 1e3 * m));
    line.push_str(",\"normal\":");
    push_list(line, touch.normal);
    line.push_str(",\"covariance_mm2\":");
    push_rows(line, touch.covariance_m2.map(|row| row.map(|m2| 1e6 * m2)));
    line.push_str(",\"force_n\":");
    match touch.force_n {
        Some(force) => push_list(line, force),
        None => line.push_str("null"),
    }
    line.push('}');
}

fn push_wrench(line: &mut String, net: &NetWrench) {
    match &net.wrench {
        Some(wrench) => {
            line.push_str("{\"force_n\":");
            push_list(line, wrench.force_n);
            line.push_str(",\"torque_nm\":");
            push_list(line, wrench.torque_nm);
            line.push_str(",\"covariance\":");
            push_rows(line, wrench.covariance);
        }
        None => {
            line.push_str("{\"force_n\":null,\"torque_nm\":null,\"covariance\":null,\"unknown\":");
            line.push_str(&serde_json::Value::from(net.unknown.clone()).to_string());
        }
    }
    line.push('}');
}

fn push_rows<const N: usize>(line: &mut String, rows: [[f64; N]; N]) {
    for (index, row) in rows.into_iter().enumerate() {
        line.push(if index == 0 { '[' } else { ',' });
        push_list(line, row);
    }
    line.push(']');
}

fn push_list<const N: usize>(line: &mut String, numbers: [f64; N]) {
    for (index, number) in numbers.into_iter().enumerate() {
        line.push(if index == 0 { '[' } else { ',' });
        push_number(line, number);
    }
    line.push(']');
}

/// Writes a number with as many digits as it takes to read it back exactly, or `null` if it isn't finite.
fn push_number(line: &mut String, number: f64) {
    if number.is_finite() {
        // Write minus zero as zero.
        line.push_str(&serde_json::Value::from(number + 0.0).to_string());
    } else {
        line.push_str("null");
    }
}
