//! Coils and conducting elements of a skin of magnetic induction: what the file says of them, and the model of its readings
//! at rest and of their change with the elements' heights. Of each element the model keeps the dipole alone, without its
//! neighbours' excitation: simple, and some per cent off at the usual heights.

use dermis_tomo::eit::Jacobian;
use dermis_tomo::mesh::ElectrodeShape;
use dermis_tomo::mit::{Body, Coil, CoilArray, Complex, HARMONICS, MU0, Sphere};
use dermis_twin::EmArray;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{DrivePattern, MeasurePattern, Reads, Skin, refused};
use crate::Error;
use crate::bodies::Element;

const MM: f64 = 1e-3;
/// Half the distance over which fields are differentiated by height, metres.
const STEP_M: f64 = 1e-4;
/// Width of an element in the image relative to the pitch: standard deviation of a Gaussian.
pub(crate) const ELEMENT_WIDTH: f64 = 0.25;
/// Standard deviations beyond which it counts as zero.
const REACH: f64 = 4.0;
/// Most elements along a side.
const MOST_PER_SIDE: usize = 32;

/// Coils of a skin.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coils {
    /// One of the published arrays.
    pub array: EmArray,
    /// Height of a conducting plate beneath, as a shield or the robot's arm; below 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shield_mm: Option<f64>,
}

/// Conducting elements that a touch moves toward the coils: a square grid around the skin's middle, numbered row by row from
/// the bottom left.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Elements {
    /// Elements along a side.
    pub per_side: usize,
    /// Distance of neighbours.
    pub pitch_mm: f64,
    /// Height of their middles over the coils' at rest.
    pub rest_mm: f64,
    /// Travel when fully pressed: image value 1.
    pub travel_mm: f64,
    /// What they are.
    pub shape: ElementShape,
}

/// Shape of an element.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ElementShape {
    /// A ball.
    Sphere {
        /// Its diameter.
        diameter_mm: f64,
    },
    /// An upright cylinder; in the model of images the sphere of its volume.
    Cylinder {
        /// Its diameter.
        diameter_mm: f64,
        /// Its height.
        height_mm: f64,
    },
    /// A square plate that lies, sides along x and y; in the model of images the sphere of its volume.
    Plate {
        /// Its side.
        side_mm: f64,
        /// Its thickness.
        height_mm: f64,
    },
}

impl ElementShape {
    /// Radius of the sphere of its volume, metres.
    pub fn volume_radius_m(&self) -> f64 {
        match self {
            Self::Sphere { diameter_mm } => 0.5 * diameter_mm * MM,
            Self::Cylinder { diameter_mm, height_mm } => (0.1875 * diameter_mm * diameter_mm * height_mm).cbrt() * MM,
            Self::Plate { side_mm, height_mm } => {
                (0.75 / std::f64::consts::PI * side_mm * side_mm * height_mm).cbrt() * MM
            }
        }
    }
}

impl Coils {
    /// The array over its shield.
    ///
    /// # Errors
    /// None with the published numbers.
    pub fn coils(&self) -> Result<CoilArray, Error> {
        let array = self.array.coils()?;
        Ok(match self.shield_mm {
            Some(z_mm) => array.with_shield(z_mm * MM),
            None => array,
        })
    }

    /// Outlines of the coils, for drawing; none where the array cannot be made.
    pub fn outlines(&self) -> Vec<ElectrodeShape> {
        let (round, width_m) = match self.array {
            EmArray::Em8 => (true, 0.04),
            EmArray::Em16Circular => (true, 0.07),
            EmArray::Em16Square => (false, 0.075),
        };
        let outline = |coil: &Coil| {
            let centre_m = [coil.centre_m[0], coil.centre_m[1]];
            if round {
                ElectrodeShape::PadCircle { centre_m, radius_m: 0.5 * width_m }
            } else {
                ElectrodeShape::PadRectangle { centre_m, width_m, height_m: width_m, angle_rad: 0.0 }
            }
        };
        self.array.coils().map_or(Vec::new(), |array| array.coils().iter().map(outline).collect())
    }
}

impl Elements {
    /// Middles of the elements, metres.
    pub fn places_m(&self) -> Vec<[f64; 2]> {
        let at = |k: usize| (k as f64 - 0.5 * (self.per_side as f64 - 1.0)) * self.pitch_mm * MM;
        (0..self.per_side * self.per_side).map(|k| [at(k % self.per_side), at(k / self.per_side)]).collect()
    }
}

/// What the readings of a skin of magnetic induction are modelled by.
#[derive(Clone, Debug)]
pub struct MagneticModel {
    /// The coils.
    pub array: CoilArray,
    /// The elements.
    pub elements: Elements,
    /// What each is.
    pub element: Element,
    /// The sphere of its volume at the drive frequency.
    pub body: Body,
    /// Of the drive.
    pub frequency_hz: f64,
    /// Volts read for a mutual inductance of one henry: `2 pi f I`.
    pub volts_per_h: f64,
}

impl Skin {
    /// Coils and elements made concrete.
    ///
    /// # Errors
    /// A skin without them, numbers that make no sense.
    pub fn magnetic(&self) -> Result<MagneticModel, Error> {
        let missing = |what: &str| Error::Frames {
            what: format!("skin {}", self.name),
            expected: format!("{what}, as of modality = \"mit\""),
            got: "none".into(),
        };
        let coils = self.frontend.coils.ok_or_else(|| missing("frontend.coils"))?;
        let elements = self.frontend.elements.ok_or_else(|| missing("frontend.elements"))?;
        let frequency_hz = 1e3 * self.backend.frequency_khz.ok_or_else(|| missing("backend.frequency_khz"))?;
        let element = self.element().ok_or_else(|| missing("frontend.elements"))?;
        let sphere = Sphere {
            radius_m: elements.shape.volume_radius_m(),
            conductivity_s_per_m: element.conductivity_s_per_m,
            relative_permeability: element.relative_permeability,
        };
        Ok(MagneticModel {
            array: coils.coils()?,
            elements,
            element,
            body: Body::sphere(&sphere, frequency_hz)?,
            frequency_hz,
            volts_per_h: std::f64::consts::TAU * frequency_hz * self.backend.current_ma * 1e-3,
        })
    }

    /// What each element is, as far as fields go; `None` for skins without.
    pub fn element(&self) -> Option<Element> {
        self.frontend.elements.map(|elements| Element {
            shape: elements.shape,
            conductivity_s_per_m: self.frontend.layer.conductivity_s_per_m,
            relative_permeability: 1.0,
        })
    }

    /// Magnitudes at rest, volts, and their change with the pixels of an image, volts per share of the full travel: an
    /// element reads the image around its middle, weighted by a Gaussian a quarter of the pitch wide.
    pub(crate) fn magnetic_model(&self, at_m: &[[f64; 2]], pixel_m: f64) -> Result<(Vec<f64>, Jacobian), Error> {
        let model = self.magnetic()?;
        let rest_h = model.rest_h();
        let travel_v = model.volts_per_h * model.elements.travel_mm * MM;
        let places = model.elements.places_m();
        let pressed: Vec<Vec<f64>> = places
            .par_iter()
            .map(|place| {
                // Pressed: down, against z.
                let towards = |(slope, rest): (&Complex, &Complex)| -(rest.conj() * *slope).re / rest.norm();
                let slopes = model.dipole_at(*place).slopes_h_per_m();
                slopes.iter().zip(&rest_h).map(towards).map(|v| v * travel_v).collect()
            })
            .collect();
        let width = ELEMENT_WIDTH * model.elements.pitch_mm * MM;
        let weight = |p: [f64; 2], q: [f64; 2]| {
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

    pub(super) fn check_magnetic(&self, file: &str) -> Result<(), Error> {
        let (Some(coils), Some(elements)) = (self.frontend.coils, self.frontend.elements) else {
            return Err(refused(file, "frontend.coils", "left out", "coils and elements with modality = \"mit\""));
        };
        if !self.frontend.electrodes.are_none() || self.frontend.contact_impedance_ohm_m2 != 0.0 {
            return Err(refused(file, "frontend.electrodes", "given", "none with modality = \"mit\""));
        }
        if self.frontend.bend.is_some() {
            return Err(refused(file, "frontend.bend", "given", "none with modality = \"mit\""));
        }
        if !(1..=MOST_PER_SIDE).contains(&elements.per_side) {
            let expected = format!("1 to {MOST_PER_SIDE}");
            return Err(refused(file, "frontend.elements.per_side", elements.per_side, &expected));
        }
        if let Some(z_mm) = coils.shield_mm.filter(|z| !(-1e4..=-1.0).contains(z)) {
            return Err(refused(file, "frontend.coils.shield_mm", z_mm, "-10000 to -1: beneath the coils"));
        }
        let radius_mm = elements.shape.volume_radius_m() / MM;
        let positive = [
            ("frontend.elements.pitch_mm", elements.pitch_mm),
            ("frontend.elements.rest_mm", elements.rest_mm),
            ("frontend.elements.travel_mm", elements.travel_mm),
            ("frontend.elements.shape", radius_mm),
        ];
        if let Some((field, value)) = positive.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite())) {
            return Err(refused(file, field, value, "a positive number"));
        }
        if elements.rest_mm - elements.travel_mm < radius_mm {
            let expected =
                format!("at most {:.1}, from where elements would reach the coils", elements.rest_mm - radius_mm);
            return Err(refused(file, "frontend.elements.travel_mm", elements.travel_mm, &expected));
        }
        let frequency_khz = self.backend.frequency_khz.unwrap_or(0.0);
        if !(1e-3..=1e3).contains(&frequency_khz) {
            return Err(refused(file, "backend.frequency_khz", frequency_khz, "0.001 to 1000 with modality = \"mit\""));
        }
        if self.backend.drive != DrivePattern::EachCoil || self.backend.measure != MeasurePattern::HigherCoils {
            let expected = "drive = \"each-coil\" and measure = \"higher-coils\" with modality = \"mit\"";
            return Err(refused(file, "backend.drive", "a pattern of electrodes", expected));
        }
        if self.backend.circuit.is_some() || self.imaging.refinement.is_some() || self.touch.refine {
            let expected = "no circuit, refinement or refine with modality = \"mit\"";
            return Err(refused(file, "backend.circuit, imaging.refinement or touch.refine", "given", expected));
        }
        if self.backend.reads != Reads::Magnitude {
            return Err(refused(file, "backend.reads", "another", "\"magnitude\" with modality = \"mit\""));
        }
        Ok(())
    }
}

impl MagneticModel {
    /// Mutual inductances of all pairs with the elements at rest, henries.
    fn rest_h(&self) -> Vec<Complex> {
        let mut rest_h: Vec<Complex> = self.array.mutuals_h().iter().map(|m| Complex::new(*m, 0.0)).collect();
        for place in self.elements.places_m() {
            let changes = self.dipole_at(place).changes_h();
            rest_h.iter_mut().zip(changes).for_each(|(rest, change)| *rest += change);
        }
        rest_h
    }

    /// One element at its resting height, here.
    fn dipole_at(&self, [x, y]: [f64; 2]) -> Dipole<'_> {
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

/// The coils' fields at an element, a little below, and a little above.
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
