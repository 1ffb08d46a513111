//! Computes the voltages of a simulated scene. Most skins are one sheet whose conductivity changes at inclusions. A
//! sandwich skin is a sheet that is pressed against a floating shortcut and may be cut. In a sandwich two touches are
//! connected through the shortcut, which no change of the sheet's conductivity can imitate.

use dermis_learn::scene::{Figure, RAISED, Scene};
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{Contact, ElectrodedMesh, Mesh, Point, distance};
use dermis_twin::from_skin::press_range;
use dermis_twin::mechanics::{ContactLaw, normal_cdf};
use dermis_twin::physics::{Cut, SheetConductance, Shortcut, SlitPath, SlitPaths, TwoSheets, damaged_conductance};
use rand::Rng;
use rand::rngs::StdRng;

use crate::Error;
use dermis_skin::{Layer, SandwichLayer, Skin};

/// The lightest and the hardest touch, as shares of the skin's nominal pressure.
const PRESSURES: [f64; 2] = [0.1, 2.5];
/// Maximum factor by which a sample's contact law deviates from the skin file's in its pressures, its saturation and
/// the length over which pressure spreads.
const LAW_FACTOR: f64 = 2.0;
/// Maximum factor on the exponent of the contact law.
const EXPONENT_FACTOR: f64 = 1.3;
/// Range of the width of a cut, as a share of the stroke that labels it.
const CUT_WIDTH: [f64; 2] = [0.02, 0.3];
/// Maximum decades by which the conductance of a cut is reduced further.
const CUT_DECADES: f64 = 3.0;
/// Range of conductivity factors that a scene's touches are drawn from.
const FACTORS: [f64; 2] = [1.2, 5.0];

/// Solves scenes on one body; every thread has its own.
pub(super) enum Solver {
    /// Inclusions change the conductivity.
    OneSheet { model: Box<ForwardModel>, elements: Elements, conductance_s: f64 },
    /// Touches are contacts with a floating shortcut, and cuts are slits in the sheet.
    TwoSheets {
        sheets: Box<TwoSheets>,
        paths: Box<SlitPaths>,
        protocol: Protocol,
        triangles: Vec<[[f64; 2]; 3]>,
        conductance_s: f64,
        touching: Touching,
    },
}

impl Solver {
    /// The layer of a sandwich skin with pads. Its scenes are solved with a shortcut sheet.
    fn sandwich<'a>(skin: &'a Skin, body: &ElectrodedMesh) -> Option<&'a SandwichLayer> {
        let pads = body.electrodes.iter().all(|electrode| matches!(electrode.contact, Contact::Area(_)));
        match &skin.frontend.layer {
            Layer::Sandwich(layer) if pads => Some(layer),
            _ => None,
        }
    }

    /// Prepares the body.
    ///
    /// # Errors
    /// The body's model cannot be solved.
    pub(super) fn new(skin: &Skin, body: &ElectrodedMesh, protocol: &Protocol) -> Result<Self, Error> {
        let conductance_s = skin.sheet_conductance_s();
        let Some(layer) = Self::sandwich(skin, body) else {
            let model = ForwardModel::new(body.clone(), protocol.clone())?;
            let elements = Elements::new(&model.body().mesh);
            return Ok(Self::OneSheet { model: Box::new(model), elements, conductance_s });
        };
        let sheets =
            TwoSheets::new(body, conductance_s, Shortcut::Equipotential).map_err(dermis_twin::TwinError::from)?;
        let positions = sheets.positions_m();
        let corners = |cell: &[u32]| [0, 1, 2].map(|k| positions[cell[k] as usize]);
        let triangles = body.mesh.elements().map(corners).collect();
        let paths = SlitPaths::new(body).map_err(dermis_twin::TwinError::from)?;
        let (sheets, paths, protocol) = (Box::new(sheets), Box::new(paths), protocol.clone());
        let touching = Touching {
            pressure_pa: press_range(skin).initial_pressure_pa,
            contact: ContactLaw::from(&layer.contact),
            spread_m: 1e-3 * layer.smoothing_mm,
        };
        Ok(Self::TwoSheets { sheets, paths, protocol, triangles, conductance_s, touching })
    }

    /// Voltages of the protocol's channels. Properties that the scene leaves open, such as the firmness of touches
    /// and the width of cuts, are drawn at random.
    ///
    /// # Errors
    /// The problem cannot be solved, for example because a cut isolates an electrode.
    pub(super) fn voltages(&mut self, scene: &Scene, random: &mut StdRng) -> Result<Vec<f64>, Error> {
        match self {
            Self::OneSheet { model, elements, conductance_s } => {
                Ok(model.voltages(&elements.conductivity(scene, *conductance_s))?)
            }
            Self::TwoSheets { sheets, paths, protocol, triangles, conductance_s, touching } => {
                let (slits, sensing) = damaged(scene, paths, triangles, *conductance_s, random);
                let contact = touching.strayed(random).contact_s_per_m2(scene, sheets.positions_m());
                sheets.set_sensing_elements(&sensing).map_err(dermis_twin::TwinError::from)?;
                sheets.set_slit_paths(&slits).map_err(dermis_twin::TwinError::from)?;
                let impedance = sheets.impedance(&contact).map_err(dermis_twin::TwinError::from)?;
                let voltage = |channel: &dermis_tomo::eit::Measurement| {
                    let pattern = &protocol.patterns()[channel.pattern as usize];
                    let drive = &protocol.stimulations()[channel.stimulation as usize];
                    let pairs = pattern.entries().iter().flat_map(|a| drive.entries().iter().map(move |b| (a, b)));
                    pairs.map(|(&(e, w), &(d, i))| w * i * impedance[(e as usize, d as usize)]).sum()
                };
                Ok(protocol.measurements().iter().map(voltage).collect())
            }
        }
    }
}

/// Collects what lowers the sheet's conductance. Strokes are cuts: slits where mesh edges can follow them, and
/// otherwise elements of low conductance. Other figures conduct a share.
fn damaged(
    scene: &Scene,
    paths: &SlitPaths,
    triangles: &[[[f64; 2]; 3]],
    rest_s: f64,
    random: &mut StdRng,
) -> (Vec<SlitPath>, Vec<SheetConductance>) {
    let mut slits = Vec::new();
    let mut cuts = Vec::new();
    let mut holes = Vec::new();
    for inclusion in scene.inclusions.iter().filter(|inclusion| inclusion.class != RAISED) {
        match &inclusion.figure {
            Figure::Stroke(chain, width) => {
                let width_m = width * random.random_range(CUT_WIDTH[0]..CUT_WIDTH[1]);
                let residual = inclusion.factor * 10_f64.powf(-CUT_DECADES * random.random::<f64>());
                let cut = |ends: &[[f64; 2]]| Cut { from_m: ends[0], to_m: ends[1], width_m, residual };
                let joined_per_m = chain.windows(2).next().map_or(0.0, |ends| cut(ends).joining_per_m());
                match paths.along(chain, &slits, rest_s * joined_per_m) {
                    Some(path) => slits.push(path),
                    None => cuts.extend(chain.windows(2).map(cut)),
                }
            }
            figure => holes.push((figure, inclusion.factor)),
        }
    }
    let of_triangle = |corners: &[Point; 3]| {
        let middle = [0, 1].map(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0);
        let reach = corners.iter().map(|p| distance(*p, middle)).fold(0.0, f64::max);
        let lowered = holes.iter().filter(|(figure, _)| figure.contains(middle)).map(|(_, factor)| factor);
        let own_s = rest_s * lowered.product::<f64>();
        let near = |cut: &&Cut| {
            let stroke = Figure::Stroke(vec![cut.from_m, cut.to_m], cut.width_m);
            stroke.depth_m(middle) > -reach
        };
        let near: Vec<Cut> = cuts.iter().filter(near).copied().collect();
        if near.is_empty() { SheetConductance::isotropic(own_s) } else { damaged_conductance(own_s, &near, *corners) }
    };
    (slits, triangles.iter().map(of_triangle).collect())
}

/// How touches close the gap of a sandwich.
#[derive(Clone, Copy)]
pub(super) struct Touching {
    /// Nominal pressure of the skin.
    pressure_pa: f64,
    contact: ContactLaw,
    /// Standard deviation of the Gaussian spread of pressure on its way to the gap.
    spread_m: f64,
}

impl Touching {
    /// The parameters of another skin of this kind, drawn at random.
    fn strayed(&self, random: &mut StdRng) -> Self {
        let mut factor = |most: f64| most.powf(random.random_range(-1.0..1.0));
        Self {
            pressure_pa: self.pressure_pa,
            contact: ContactLaw {
                threshold_pa: self.contact.threshold_pa * factor(LAW_FACTOR),
                reference_pa: self.contact.reference_pa * factor(LAW_FACTOR),
                exponent: self.contact.exponent * factor(EXPONENT_FACTOR),
                saturation_s_per_m2: self.contact.saturation_s_per_m2 * factor(LAW_FACTOR),
            },
            spread_m: self.spread_m * factor(LAW_FACTOR),
        }
    }

    /// Contact conductance at each node, S/m^2.
    fn contact_s_per_m2(&self, scene: &Scene, positions_m: &[Point]) -> Vec<f64> {
        /// Cut-off of the pressure's spread, in standard deviations.
        const REACH: f64 = 4.0;
        let mut pressure_pa = vec![0.0; positions_m.len()];
        for inclusion in scene.inclusions.iter().filter(|inclusion| inclusion.class == RAISED) {
            let [least, most] = FACTORS.map(|factor| (factor - 1.0).ln());
            let along = (((inclusion.factor - 1.0).ln() - least) / (most - least)).clamp(0.0, 1.0);
            let middle_pa = self.pressure_pa * PRESSURES[0] * (PRESSURES[1] / PRESSURES[0]).powf(along);
            let (low, high) = inclusion.figure.bounds();
            let margin = REACH * self.spread_m;
            for (pressure, p) in pressure_pa.iter_mut().zip(positions_m) {
                if (0..2).all(|axis| p[axis] > low[axis] - margin && p[axis] < high[axis] + margin) {
                    *pressure += middle_pa * normal_cdf(inclusion.figure.depth_m(*p) / self.spread_m);
                }
            }
        }
        pressure_pa.iter().map(|pressure| self.contact.conductance_s_per_m2(*pressure)).collect()
    }
}

/// Points at which elements sample the conductivity.
pub(super) struct Elements {
    /// Centroid, and the points halfway from it to the corners.
    samples: Vec<[[f64; 2]; 4]>,
}

impl Elements {
    fn new(mesh: &Mesh) -> Self {
        let samples = mesh
            .elements()
            .enumerate()
            .map(|(element, corners)| {
                let [x, y, _] = mesh.centroid(element);
                let mut points = [[x, y]; 4];
                for (point, &node) in points[1..].iter_mut().zip(corners) {
                    let corner = mesh.nodes()[node as usize];
                    *point = [0.5 * (x + corner[0]), 0.5 * (y + corner[1])];
                }
                points
            })
            .collect();
        Self { samples }
    }

    /// Geometric mean over each element's sample points.
    fn conductivity(&self, scene: &Scene, rest: f64) -> Vec<f64> {
        let lookup = scene.lookup();
        let of_element = |points: &[Point; 4]| {
            let product: f64 = points.iter().map(|p| lookup.at(*p).1).product();
            if product == 1.0 { rest } else { rest * product.sqrt().sqrt() }
        };
        self.samples.iter().map(of_element).collect()
    }
}
