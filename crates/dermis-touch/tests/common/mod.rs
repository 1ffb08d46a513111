//! Images of Gaussian touches, and noise, for the tests.
#![allow(dead_code)] // Each test binary uses its own part.

use dermis_touch::{Contact, ContactStrength, GridGeometry};

/// One bell-shaped touch.
#[derive(Debug, Clone, Copy)]
pub struct Bell {
    pub x_m: f64,
    pub y_m: f64,
    pub sigma_m: f64,
    pub height: f64,
}

pub fn bell(x_mm: f64, y_mm: f64, sigma_mm: f64, height: f64) -> Bell {
    Bell { x_m: x_mm * 1e-3, y_m: y_mm * 1e-3, sigma_m: sigma_mm * 1e-3, height }
}

/// A square of 128 mm in 64 x 64 pixels of 2 mm.
pub fn square() -> GridGeometry {
    GridGeometry::centred(64, 64, 0.002)
}

pub fn paint(geometry: &GridGeometry, bells: &[Bell]) -> Vec<f32> {
    (0..geometry.len())
        .map(|index| {
            let [x, y] = geometry.pixel_centre_m(index);
            let value =
                |b: &Bell| b.height * (-((x - b.x_m).powi(2) + (y - b.y_m).powi(2)) / (2.0 * b.sigma_m.powi(2))).exp();
            bells.iter().map(value).sum::<f64>() as f32
        })
        .collect()
}

/// Sets everything outside the disc of `radius_m` to NaN.
pub fn cut_disc(geometry: &GridGeometry, image: &mut [f32], radius_m: f64) {
    for (index, value) in image.iter_mut().enumerate() {
        let [x, y] = geometry.pixel_centre_m(index);
        if x.hypot(y) > radius_m {
            *value = f32::NAN;
        }
    }
}

/// A small generator with a fixed seed (xorshift64*), so that tests repeat exactly.
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    pub fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal, by Box and Muller.
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A contact as the finder would report it, at (x, y) in mm, radius 8 mm.
pub fn contact(x_mm: f64, y_mm: f64, strength: ContactStrength) -> Contact {
    let area_m2 = std::f64::consts::PI * 64e-6;
    Contact {
        volume: 1e-4,
        covariance_m2: [[1e-7, 0.0], [0.0, 1e-7]],
        significance: 10.0,
        strength,
        ..Contact::even([x_mm * 1e-3, y_mm * 1e-3], 1.0, area_m2)
    }
}

pub fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    1e3 * (a[0] - b[0]).hypot(a[1] - b[1])
}
