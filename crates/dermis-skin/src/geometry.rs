//! From a skin file to geometry, mesh and protocol.

use dermis_mit::Element;
use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{ElectrodeShape, ElectrodedMesh, MeshError, Outline, PixelGrid, SheetSpec, SlitMesh, Surface};

use crate::error::Error;
use crate::layer::Layer;
use crate::magnetic::Coils;
use crate::skin::{Modality, Skin};

/// A skin's geometry and mesh.
#[derive(Clone, Debug)]
pub struct SkinBody {
    /// Outline, metres.
    pub outline: Outline,
    /// Electrode shapes, in order.
    pub electrodes: Vec<ElectrodeShape>,
    /// Mesh with electrodes.
    pub mesh: ElectrodedMesh,
}

/// Fingertip radius as a share of the shorter side.
const FINGER_SHARE: f64 = 0.08;
/// Minimum and maximum fingertip radius, metres.
const FINGER_M: [f64; 2] = [3e-3, 11e-3];

impl Skin {
    /// Radius of a usual press: a fingertip, or less on a small skin; metres.
    pub fn fingertip_m(&self) -> f64 {
        let (low, high) = self.outline().bounds_m();
        let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
        (FINGER_SHARE * shorter_m).clamp(FINGER_M[0], FINGER_M[1]).min(0.2 * shorter_m)
    }

    /// Outline in metres.
    pub fn outline(&self) -> Outline {
        self.frontend.shape.outline()
    }

    /// Electrode shapes in metres, in order; outlines of the coils for a skin with coils.
    pub fn electrode_shapes(&self) -> Vec<ElectrodeShape> {
        match &self.frontend.coils {
            Some(coils) => coils.outlines(),
            None => self.frontend.electrodes.shapes(&self.outline()),
        }
    }

    /// Surface of the sheet in space, see [`crate::Frontend::surface`].
    pub fn surface(&self) -> Surface {
        self.frontend.surface()
    }

    /// Sheet conductance of the resting skin, siemens: conductivity times thickness. For elements, the conductivity
    /// of their metal over one metre, which has no physical meaning.
    pub fn sheet_conductance_s(&self) -> f64 {
        self.frontend.layer.conductivity_s_per_m() * self.frontend.layer.thickness_m().unwrap_or(1.0)
    }

    /// The reconstruction mesh, with electrodes.
    ///
    /// # Errors
    /// Fails if the shapes cannot be meshed, or if electrodes overlap or lie off the skin.
    pub fn body(&self) -> Result<SkinBody, Error> {
        self.body_with_elements(self.imaging.elements)
    }

    /// A mesh of about `elements` elements, with electrodes.
    ///
    /// # Errors
    /// As [`Skin::body`].
    pub fn body_with_elements(&self, elements: usize) -> Result<SkinBody, Error> {
        let electrodes = self.electrode_shapes();
        let factors = vec![1.0; electrodes.len()];
        self.body_with_electrodes(elements, electrodes, &factors)
    }

    /// As [`Skin::body_with_elements`], with displaced electrodes and a factor on each contact impedance.
    pub fn body_with_electrodes(
        &self,
        elements: usize,
        electrodes: Vec<ElectrodeShape>,
        contact_factors: &[f64],
    ) -> Result<SkinBody, Error> {
        let impedances: Vec<f64> =
            self.sheet_contact_impedances(&electrodes).zip(contact_factors).map(|(z, factor)| factor * z).collect();
        let spec = self.unsized_spec(elements, electrodes);
        let (spec, mesh, _) = spec.build_to(elements, &impedances).map_err(|source| self.not_meshed(source))?;
        Ok(SkinBody { outline: spec.outline, electrodes: spec.electrodes, mesh })
    }

    /// A mesh of about `elements` elements with electrodes and with slits along lines (both ends, metres), which add
    /// some elements. The flags tell which lines could be slit, see [`SheetSpec::build_slit`].
    pub fn slit_mesh(&self, elements: usize, lines: &[[[f64; 2]; 2]]) -> Result<(SlitMesh, Vec<bool>), Error> {
        let spec = self.unsized_spec(elements, self.electrode_shapes());
        let impedances: Vec<f64> = self.sheet_contact_impedances(&spec.electrodes).collect();
        let named = |source| self.not_meshed(source);
        if lines.is_empty() {
            let (_, mesh, _) = spec.build_to(elements, &impedances).map_err(named)?;
            return Ok((mesh.opened_along(&[]).map_err(named)?, Vec::new()));
        }
        spec.with_target_elements(elements).and_then(|spec| spec.build_slit(&impedances, lines)).map_err(named)
    }

    fn not_meshed(&self, source: MeshError) -> Error {
        Error::Mesh { skin: self.name.clone(), source }
    }

    /// The sheet with a first guess of the element size.
    fn unsized_spec(&self, elements: usize, electrodes: Vec<ElectrodeShape>) -> SheetSpec {
        let outline = self.outline();
        let size = (outline.area_m2() / elements as f64 * 2.3).sqrt();
        SheetSpec::new(outline, electrodes, size)
    }

    /// Contact impedance of every electrode in the unit of the sheet model: ohm.m^2 for pads under the sheet, ohm.m
    /// (the specific impedance divided by the height of the layer that they touch) for electrodes on the rim.
    pub fn sheet_contact_impedances(&self, electrodes: &[ElectrodeShape]) -> impl Iterator<Item = f64> {
        // Coils touch nothing; they are in the mesh only so that they can be drawn.
        let impedance = |shape| if self.modality == Modality::Mit { 1.0 } else { self.sheet_contact_impedance(shape) };
        electrodes.iter().map(impedance)
    }

    /// Contact impedance in the unit of the sheet model: ohm.m^2 for pads under the sheet, ohm.m (the specific
    /// impedance divided by the thickness) for electrodes on the rim.
    fn sheet_contact_impedance(&self, shape: &ElectrodeShape) -> f64 {
        let specific = self.frontend.contact_impedance_ohm_m2;
        match shape {
            ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. } | ElectrodeShape::RimPoint { .. } => {
                specific / self.frontend.layer.rim_height_m().unwrap_or(1.0)
            }
            _ => specific,
        }
    }

    /// Contact impedance of every electrode, ohm: the specific impedance divided by the electrode's area. The area of
    /// a rim electrode is its length times the layer's thickness. 0 for point electrodes; empty for coils, which have
    /// none.
    pub fn contact_impedances_ohm(&self) -> Vec<f64> {
        if self.modality == Modality::Mit {
            return Vec::new();
        }
        let area_m2 = |shape: &ElectrodeShape| match *shape {
            ElectrodeShape::RimArc { width_m, .. } | ElectrodeShape::RimSegment { width_m, .. } => {
                width_m * self.frontend.layer.rim_height_m().unwrap_or(1.0)
            }
            ElectrodeShape::PadCircle { radius_m, .. } => std::f64::consts::PI * radius_m * radius_m,
            ElectrodeShape::PadRectangle { width_m, height_m, .. } => width_m * height_m,
            ElectrodeShape::RimPoint { .. } | ElectrodeShape::Point { .. } => f64::INFINITY,
        };
        let specific = self.frontend.contact_impedance_ohm_m2;
        self.electrode_shapes().iter().map(|shape| specific / area_m2(shape)).collect()
    }

    /// The image grid of this skin: exactly its bounding box.
    ///
    /// # Errors
    /// Fails if the outline has no extent.
    pub fn grid(&self) -> Result<PixelGrid, Error> {
        let (low, high) = self.outline().bounds_m();
        PixelGrid::covering(low, high, self.imaging.grid)
            .map_err(|source| Error::Mesh { skin: self.name.clone(), source })
    }

    /// Stimulation and measurement as explicit lists.
    ///
    /// # Errors
    /// Fails if a pattern needs a different number of electrodes or names electrodes that do not exist.
    pub fn protocol(&self) -> Result<Protocol, Error> {
        let count = self.frontend.coils.as_ref().map_or_else(|| self.frontend.electrodes.count(), Coils::count);
        self.backend.protocol(count).map_err(|source| Error::Protocol { skin: self.name.clone(), source })
    }

    /// Electromagnetic description of each conducting element; `None` for skins without elements.
    pub fn element(&self) -> Option<Element> {
        let (Layer::Elements(layer), Some(elements)) = (&self.frontend.layer, &self.frontend.elements) else {
            return None;
        };
        Some(Element {
            shape: elements.shape,
            conductivity_s_per_m: layer.conductivity_s_per_m,
            relative_permeability: layer.relative_permeability,
        })
    }
}
