//! Touches and cells of a skin in space: position, outward normal, force and their covariances, in the patch's frame
//! or any other. Forces act on the sensor: whatever presses on a skin pushes against its outward normal.

use dermis_tomo::mesh::{PixelMap, Point, Surface};
use dermis_touch::force::ForceReading;
use dermis_touch::{LoadQuantity, Touch};

use crate::transform::{Matrix, Transform, Vector, scaled};

/// Force of a touch, newtons, never negative.
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
    /// Covariance of the position, m^2. It is confined to the skin's surface, without uncertainty along the normal.
    pub covariance_m2: Matrix,
    /// Outward unit normal of the skin at the touch.
    pub normal: Vector,
    /// Force on the sensor, newtons, opposite to the normal. `None` without a calibration.
    pub force_n: Option<Vector>,
}

impl SpatialTouch {
    /// Maps a touch on the flat skin onto its surface, in the patch's frame.
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

    /// The touch transformed into the outer frame of a transform.
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

/// The force of a touch, if it can be trusted: from a force calibration, by the law of the layer, or from a calibration
/// by pokes of known force. `None` for the end of a calibrated range.
pub fn trusted_force(touch: &Touch) -> Option<ForceEstimate> {
    if let Some(ForceReading::Valid { force_n, sigma_n } | ForceReading::FromLaw { force_n, sigma_n }) = touch.force {
        let is_sound = force_n.is_finite() && sigma_n.is_finite();
        return is_sound.then_some(ForceEstimate { force_n: force_n.max(0.0), sigma_n });
    }
    let load = touch.load.filter(|load| load.quantity == LoadQuantity::ForceN)?;
    let is_sound = load.value.is_finite() && load.sigma.is_finite() && touch.force.is_none();
    is_sound.then_some(ForceEstimate { force_n: load.value.max(0.0), sigma_n: load.sigma })
}

/// A point on a surface, with its derivatives along the sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfacePoint {
    pub position_m: Vector,
    pub normal: Vector,
    /// Derivatives of the position by x and y of the sheet: unit vectors.
    pub along: [Vector; 2],
    /// Derivatives of the normal by x and y of the sheet, 1/m.
    pub normal_along: [Vector; 2],
}

impl SurfacePoint {
    pub fn at(surface: &Surface, sheet_m: Point) -> Self {
        let (position_m, normal) = (surface.point_m(sheet_m), surface.normal(sheet_m));
        let (along_x, curvature) = match *surface {
            Surface::Flat => ([1.0, 0.0, 0.0], 0.0),
            Surface::Cylinder { radius_m } => ([normal[2], 0.0, -normal[0]], 1.0 / radius_m),
        };
        let along = [along_x, [0.0, 1.0, 0.0]];
        Self { position_m, normal, along, normal_along: [scaled(along_x, curvature), [0.0; 3]] }
    }
}

/// The cells of a skin in its patch's frame: the image pixels that lie on it, in the order of
/// [`PixelMap::inside_pixels`].
#[derive(Clone, Debug, PartialEq)]
pub struct Taxels {
    /// Pixel number of each cell in the image, row-major.
    pub pixels: Vec<u32>,
    /// Centres, metres.
    pub positions_m: Vec<Vector>,
    /// Outward normals.
    pub normals: Vec<Vector>,
    /// Area of skin within each, m^2.
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

    /// True if there are no cells.
    pub fn is_empty(&self) -> bool {
        self.pixels.is_empty()
    }

    /// The cells transformed into the outer frame of a transform.
    #[must_use]
    pub fn in_frame(&self, outer_from_patch: &Transform) -> Self {
        Self {
            positions_m: self.positions_m.iter().map(|&position| outer_from_patch.point_m(position)).collect(),
            normals: self.normals.iter().map(|&normal| outer_from_patch.vector(normal)).collect(),
            ..self.clone()
        }
    }
}
