//! Model of the readings of a magnetic-induction skin at rest, and of their change with the elements' heights. Each
//! element is represented by its dipole alone, without excitation by its neighbours. This is simple, and a few per
//! cent off at the usual heights.

use dermis_mit::{Coil, CoilArray, Complex, HARMONICS, MU0, Polarizability, Sphere};
use dermis_skin::{Element, Elements, Skin};
use dermis_tomo::eit::Jacobian;
use dermis_tomo::mesh::Point;
use rayon::prelude::*;

use crate::Error;

const MM: f64 = 1e-3;
/// Half the distance over which fields are differentiated by height, metres.
const STEP_M: f64 = 1e-4;
/// Width of an element in the image relative to the pitch: standard deviation of a Gaussian.
pub const ELEMENT_WIDTH: f64 = 0.25;
/// Number of standard deviations beyond which the Gaussian is treated as zero.
const REACH: f64 = 4.0;

/// Model of the readings of a magnetic-induction skin.
#[derive(Clone, Debug)]
pub struct MagneticModel {
    /// The coils.
    pub array: CoilArray,
    /// The elements.
    pub elements: Elements,
    /// Material and shape of each element.
    pub element: Element,
    /// Sphere with the element's volume, at the drive frequency.
    pub body: Polarizability,
    /// Drive frequency.
    pub frequency_hz: f64,
    /// Volts read for a mutual inductance of one henry: `2 pi f I`.
    pub volts_per_h: f64,
}

impl MagneticModel {
    /// Builds coils and elements from a skin.
    ///
    /// # Errors
    /// A skin without them, or with invalid numbers.
    pub fn of(skin: &Skin) -> Result<Self, Error> {
        let missing = |what: &str| Error::Frames {
            what: format!("skin {}", skin.name),
            expected: format!("{what}, as of modality = \"mit\""),
            got: "none".into(),
        };
        let coils = skin.frontend.coils.as_ref().ok_or_else(|| missing("frontend.coils"))?;
        let elements = skin.frontend.elements.clone().ok_or_else(|| missing("frontend.elements"))?;
        let frequency_hz = 1e3 * skin.backend.frequency_khz.ok_or_else(|| missing("backend.frequency_khz"))?;
        let element = skin.element().ok_or_else(|| missing("frontend.elements"))?;
        let sphere = Sphere {
            radius_m: elements.shape.volume_radius_m(),
            conductivity_s_per_m: element.conductivity_s_per_m,
            relative_permeability: element.relative_permeability,
        };
        Ok(Self {
            array: coils.array()?,
            elements,
            element,
            body: Polarizability::sphere(&sphere, frequency_hz)?,
            frequency_hz,
            volts_per_h: std::f64::consts::TAU * frequency_hz * skin.backend.current_ma * 1e-3,
        })
    }

    /// Magnitudes at rest, volts, and their change with the pixels of an image, volts per share of the full travel.
    /// An element's travel is the image around its centre, weighted by a Gaussian a quarter of the pitch wide.
    pub(crate) fn linearised(&self, at_m: &[Point], pixel_m: f64) -> Result<(Vec<f64>, Jacobian), Error> {
        let model = self;
        let rest_h = model.rest_h();
        let travel_v = model.volts_per_h * model.elements.travel_mm * MM;
        let places = model.elements.places_m();
        let pressed: Vec<Vec<f64>> = places
            .par_iter()
            .map(|place| {
                // Pressing moves down, against z.
                let towards = |(slope, rest): (&Complex, &Complex)| -(rest.conj() * *slope).re / rest.norm();
                let slopes = model.dipole_at(*place).slopes_h_per_m();
                slopes.iter().zip(&rest_h).map(towards).map(|v| v * travel_v).collect()
            })
            .collect();
        let width = ELEMENT_WIDTH * model.elements.pitch_m();
        let weight = |p: Point, q: Point| {
            let square = ((p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2)) / (width * width);
            if square > REACH * REACH {
                return 0.0;
            }
            (pixel_m / width).powi(2) / std::f64::consts::TAU * (-0.5 * square).exp()
        };
        let (rows, columns) = (rest_h.len(), at_m.len());
        let mut values = vec![0.0; rows * columns];
        for (element, place) in places.iter().enumerate() {
            for (column, at) in at_m.iter().enumerate() {
                let weight = weight(*place, *at);
                if weight > 0.0 {
                    (0..rows).for_each(|row| values[row * columns + column] += weight * pressed[element][row]);
                }
            }
        }
        let voltages = rest_h.iter().map(|m| m.norm() * model.volts_per_h).collect();
        Ok((voltages, Jacobian { rows, columns, values }))
    }

    /// Mutual inductances of all pairs with the elements at rest, henries.
    fn rest_h(&self) -> Vec<Complex> {
        let mut rest_h: Vec<Complex> = self.array.mutuals_h().iter().map(|m| Complex::new(*m, 0.0)).collect();
        for place in self.elements.places_m() {
            let changes = self.dipole_at(place).changes_h();
            rest_h.iter_mut().zip(changes).for_each(|(rest, change)| *rest += change);
        }
        rest_h
    }

    /// One element at its resting height at this position.
    fn dipole_at(&self, [x, y]: Point) -> Dipole<'_> {
        let z = self.elements.rest_mm * MM;
        // B = -mu0 grad(c0 z + c1 x + c2 y).
        let expansion = |coil: &Coil, z: f64| {
            let [bx, by, bz] = coil.flux_density([x, y, z]);
            [bz, bx, by].map(|b| -b / MU0)
        };
        let at = |by: f64| self.array.coils().iter().map(|coil| expansion(coil, z + by)).collect();
        Dipole { tau: self.body.tau(), low: at(-STEP_M), here: at(0.0), high: at(STEP_M) }
    }
}

/// The coils' fields at an element, slightly below and slightly above.
struct Dipole<'a> {
    tau: &'a [Complex],
    low: Vec<[f64; 3]>,
    here: Vec<[f64; 3]>,
    high: Vec<[f64; 3]>,
}

impl Dipole<'_> {
    fn product(&self, a: [f64; 3], b: [f64; 3]) -> Complex {
        let entry = |k: usize| self.tau[(k / 3) * HARMONICS + k % 3] * (a[k / 3] * b[k % 3]);
        (0..9).map(entry).sum()
    }

    fn pairs(&self) -> impl Iterator<Item = (usize, usize)> + use<> {
        let count = self.here.len();
        (0..count).flat_map(move |m| (m + 1..count).map(move |n| (m, n)))
    }

    fn changes_h(&self) -> Vec<Complex> {
        self.pairs().map(|(m, n)| self.product(self.here[m], self.here[n])).collect()
    }

    fn slopes_h_per_m(&self) -> Vec<Complex> {
        let slope =
            |(m, n): (usize, usize)| self.product(self.high[m], self.high[n]) - self.product(self.low[m], self.low[n]);
        self.pairs().map(slope).map(|difference| difference * (0.5 / STEP_M)).collect()
    }
}
