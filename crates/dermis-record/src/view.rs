//! Messages for viewers of a recording: the image as `sensor_msgs/Image`, the same on the skin's surface as
//! `sensor_msgs/PointCloud2`, and the touches as a second point cloud.

use dermis_touch::Touch;

use super::cdr::CdrWriter;
use dermis_live::prepare::Prepared;
use dermis_skin::Bend;

/// Positions of a skin's pixels in space: x to the right, y up, z out of the skin, origin at the skin's centre.
#[derive(Debug, Clone, PartialEq)]
pub struct SkinView {
    frame_id: String,
    rows: usize,
    columns: usize,
    /// Pixels on the skin and their centres, metres.
    points: Vec<(usize, [f32; 3])>,
    /// Radius of the cylinder that the skin is bent around, metres.
    bend_radius_m: Option<f64>,
    period_ns: u64,
}

impl SkinView {
    /// Images recorded per second by default.
    pub const IMAGES_PER_S: f64 = 10.0;

    /// The view of a prepared skin, with [`Self::IMAGES_PER_S`].
    pub fn new(prepared: &Prepared) -> Self {
        let (map, grid) = (&prepared.map, prepared.map.grid());
        let bend_radius_m = prepared.skin.frontend.bend.map(|Bend::Cylinder { diameter_mm }| 0.5e-3 * diameter_mm);
        let points = map.inside_pixels().iter().map(|&pixel| pixel as usize);
        let points = points.map(|pixel| (pixel, in_space(grid.centre_m(pixel), bend_radius_m))).collect();
        let frame_id = prepared.skin.name.clone();
        let (rows, columns) = (grid.rows, grid.columns);
        Self { frame_id, rows, columns, points, bend_radius_m, period_ns: 0 }.with_images_per_s(Self::IMAGES_PER_S)
    }

    /// Uses this frame of reference instead of the skin's.
    #[must_use]
    pub fn with_frame_id(self, frame_id: &str) -> Self {
        Self { frame_id: frame_id.to_owned(), ..self }
    }

    /// Limits images and point clouds to this number per second. From 1e9 on, and for NaN, every frame has one.
    #[must_use]
    pub fn with_images_per_s(self, images_per_s: f64) -> Self {
        // The cast saturates, and turns NaN into 0.
        Self { period_ns: (1e9 / images_per_s) as u64, ..self }
    }

    /// The frame of reference.
    pub(super) fn frame_id(&self) -> &str {
        &self.frame_id
    }

    /// Minimum time between two images, nanoseconds.
    pub(super) fn period_ns(&self) -> u64 {
        self.period_ns
    }

    /// Number of pixels in an image.
    pub(super) fn pixels(&self) -> usize {
        self.rows * self.columns
    }

    /// The image: 32FC1, row 0 at the top, NaN outside the skin.
    pub(super) fn write_image(&self, out: &mut Vec<u8>, wall_ns: u64, image: &[f32]) {
        let mut cdr = CdrWriter::new(out);
        cdr.header(wall_ns, &self.frame_id);
        cdr.u32(self.rows as u32);
        cdr.u32(self.columns as u32);
        cdr.string("32FC1");
        cdr.u8(0);
        cdr.u32(4 * self.columns as u32);
        cdr.bytes(4 * image.len(), |out| out.extend(image.iter().flat_map(|value| value.to_le_bytes())));
    }

    /// One point for each pixel on the skin, with the image's value there.
    pub(super) fn write_points(&self, out: &mut Vec<u8>, wall_ns: u64, image: &[f32]) {
        let mut cdr = CdrWriter::new(out);
        cdr.header(wall_ns, &self.frame_id);
        let fields = [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), ("pressure", FLOAT32)];
        cloud(&mut cdr, &fields, self.points.len(), |out| {
            for (pixel, [x, y, z]) in &self.points {
                let value = image.get(*pixel).copied().unwrap_or(f32::NAN);
                out.extend([*x, *y, *z, value].iter().flat_map(|number| number.to_le_bytes()));
            }
        });
    }

    /// One point for each touch; `force_n` is NaN without calibration.
    pub(super) fn write_touch_points(&self, out: &mut Vec<u8>, wall_ns: u64, touches: &[Touch]) {
        let mut cdr = CdrWriter::new(out);
        cdr.header(wall_ns, &self.frame_id);
        let fields = [
            ("x", FLOAT32),
            ("y", FLOAT32),
            ("z", FLOAT32),
            ("amplitude", FLOAT32),
            ("force_n", FLOAT32),
            ("area_m2", FLOAT32),
            ("id", UINT32),
        ];
        cloud(&mut cdr, &fields, touches.len(), |out| {
            for touch in touches {
                let [x, y, z] = in_space(touch.position_m, self.bend_radius_m);
                let force_n = touch.force.and_then(|force| force.nearest_n()).unwrap_or(f64::NAN);
                let numbers = [x, y, z, touch.amplitude as f32, force_n as f32, touch.area_m2 as f32];
                out.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
                out.extend_from_slice(&u32::try_from(touch.id).unwrap_or(u32::MAX).to_le_bytes());
            }
        });
    }
}

/// Numbers in `sensor_msgs/PointField` of the four-byte types.
const UINT32: u8 = 6;
pub(super) const FLOAT32: u8 = 7;

/// The rest of a `PointCloud2` after its header: one row of `count` points, whose four-byte fields `fill` appends.
pub(super) fn cloud(cdr: &mut CdrWriter<'_>, fields: &[(&str, u8)], count: usize, fill: impl FnOnce(&mut Vec<u8>)) {
    let step = 4 * fields.len();
    cdr.u32(1);
    cdr.u32(count as u32);
    cdr.length(fields.len());
    for (index, (name, datatype)) in fields.iter().enumerate() {
        cdr.string(name);
        cdr.u32(4 * index as u32);
        cdr.u8(*datatype);
        cdr.u32(1);
    }
    cdr.bool(false);
    cdr.u32(step as u32);
    cdr.u32((step * count) as u32);
    cdr.bytes(step * count, fill);
    // is_dense: all positions are finite.
    cdr.bool(true);
}

/// Position in space of a place on the flattened sheet. A bent sheet follows a cylinder behind it whose axis runs
/// along y.
fn in_space([x_m, y_m]: [f64; 2], bend_radius_m: Option<f64>) -> [f32; 3] {
    let (x, z) = match bend_radius_m {
        Some(radius) => (radius * (x_m / radius).sin(), radius * ((x_m / radius).cos() - 1.0)),
        None => (x_m, 0.0),
    };
    [x as f32, y_m as f32, z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bent_skin_lies_on_its_cylinder() {
        let radius = 0.095;
        for x_m in [-0.07, 0.0, 0.03] {
            let [x, y, z] = in_space([x_m, 0.02], Some(radius)).map(f64::from);
            // Single precision holds seven digits.
            assert!((x.hypot(z + radius) - radius).abs() < 1e-7 && (y - 0.02).abs() < 1e-8);
            assert!((radius * x.atan2(z + radius) - x_m).abs() < 1e-7, "lengths along the sheet stay");
        }
        assert_eq!(in_space([0.25, -0.5], None), [0.25, -0.5, 0.0]);
    }
}
