//! Touches and cells of a skin in space: position, outward normal, force and their covariances, in the frame of the
//! patch or any other. Forces act on the sensor: whatever presses on a skin pushes against its outward normal.

use dermis_tomo::mesh::{PixelMap, Surface};
use dermis_touch::force::ForceReading;
use dermis_touch::{LoadQuantity, Touch};

use crate::transform::{Matrix, Transform, Vector, scaled};

/// Force of a touch, newtons, not negative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ForceEstimate {
    /// Magnitude.
    pub force_n: f64,
    /// Standard deviation.
    pub sigma_n: f64,
}

/// A touch in space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpatialTouch {
    /// Position, metres.
    pub position_m: Vector,
    /// Covariance of the position, m^2. It lies in the skin: nothing is uncertain along the normal.
    pub covariance_m2: Matrix,
    /// Outward normal of the skin there: unit length, toward whatever touches.
    pub normal: Vector,
    /// Force on the sensor, newtons: against the normal. `None` where no calibration tells it.
    pub force_n: Option<Vector>,
}

impl SpatialTouch {
    /// A touch of the flat skin on its surface, in the patch's frame.
    pub fn of(touch: &Touch, surface: &Surface, force: Option<ForceEstimate>) -> Self {
        let SurfacePoint { position_m, normal, along, .. } = SurfacePoint::at(surface, touch.position_m);
        let c = &touch.covariance_m2;
        let mut covariance_m2 = [[0.0; 3]; 3];
        for row in 0..3 {
            for column in 0..3 {
                for i in 0..2 {
                    for j in 0..2 {
                        covariance_m2[row][column] += along[i][row] * c[i][j] * along[j][column];
                    }
                }
            }
        }
        let force_n = force.map(|force| scaled(normal, -force.force_n));
        Self { position_m, covariance_m2, normal, force_n }
    }

    /// The same in the outer frame of a transform.
    #[must_use]
    pub fn in_frame(&self, outer_from_inner: &Transform) -> Self {
        Self {
            position_m: outer_from_inner.point_m(self.position_m),
            covariance_m2: outer_from_inner.covariance(&self.covariance_m2),
            normal: outer_from_inner.vector(self.normal),
            force_n: self.force_n.map(|force| outer_from_inner.vector(force)),
        }
    }
}

/// The force that a touch was read as, where it can be trusted: by a calibration of forces (`residual_n` is the root
/// mean square of its errors), or by one of pokes with known forces. `None` outside the calibrated range.
pub fn trusted_force(touch: &Touch, residual_n: Option<f64>) -> Option<ForceEstimate> {
    if let Some(force_n) = touch.force.and_then(ForceReading::valid_n) {
        return Some(ForceEstimate { force_n, sigma_n: residual_n? });
    }
    let load = touch.load.filter(|load| load.quantity == LoadQuantity::ForceN)?;
    let is_sound = load.value.is_finite() && load.sigma.is_finite() && touch.force.is_none();
    is_sound.then_some(ForceEstimate { force_n: load.value.max(0.0), sigma_n: load.sigma })
}

/// A point of a surface, and how it changes along the sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePoint {
    pub position_m: Vector,
    pub normal: Vector,
    /// Change of the position with x and y of the sheet: unit vectors.
    pub along: [Vector; 2],
    /// Change of the normal with x and y of the sheet, 1/m.
    pub normal_along: [Vector; 2],
}

impl SurfacePoint {
    pub fn at(surface: &Surface, sheet_m: [f64; 2]) -> Self {
        let (position_m, normal) = (surface.point_m(sheet_m), surface.normal(sheet_m));
        let (along_x, curvature) = match *surface {
            Surface::Flat => ([1.0, 0.0, 0.0], 0.0),
            Surface::Cylinder { radius_m } => ([normal[2], 0.0, -normal[0]], 1.0 / radius_m),
        };
        let along = [along_x, [0.0, 1.0, 0.0]];
        Self { position_m, normal, along, normal_along: [scaled(along_x, curvature), [0.0; 3]] }
    }
}

/// The cells of a skin in its patch's frame: the pixels of its images that lie on it, in the order of
/// [`PixelMap::inside_pixels`].
#[derive(Clone, Debug, PartialEq)]
pub struct Taxels {
    /// Number of each one's pixel in the image, row-major.
    pub pixels: Vec<u32>,
    /// Middles, metres.
    pub positions_m: Vec<Vector>,
    /// Outward normals.
    pub normals: Vec<Vector>,
    /// Areas of the skin within them, m^2.
    pub areas_m2: Vec<f64>,
}

impl Taxels {
    /// The cells of a skin's images on its surface.
    pub fn of(map: &PixelMap, surface: &Surface) -> Self {
        let centres = map.inside_centres_m();
        let pixel_m2 = map.grid().pixel_m.powi(2);
        Self {
            pixels: map.inside_pixels().to_vec(),
            positions_m: centres.iter().map(|&centre| surface.point_m(centre)).collect(),
            normals: centres.iter().map(|&centre| surface.normal(centre)).collect(),
            areas_m2: map.inside_pixels().iter().map(|&pixel| map.coverage()[pixel as usize] * pixel_m2).collect(),
        }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.pixels.len()
    }

    /// True where there are none.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// The same in the outer frame of a transform.
    #[must_use]
    pub fn in_frame(&self, outer_from_patch: &Transform) -> Self {
        Self {
            positions_m: self.positions_m.iter().map(|&position| outer_from_patch.point_m(position)).collect(),
            normals: self.normals.iter().map(|&normal| outer_from_patch.vector(normal)).collect(),
            ..self.clone()
        }
    }
}
