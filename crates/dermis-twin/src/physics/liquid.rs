//! Fields of a flat tray of conducting liquid with variable depth and with electrodes on its wall or bottom.
//!
//! Averaged over the depth h, the potential solves `div(sigma h grad u) = 0` in the plane. This holds if h varies
//! slowly and electrodes reach from bottom to top. In three dimensions, `div(sigma grad u) = 0` is solved on
//! tetrahedra whose nodes move with the surface, `z -> z h / h0`, with electrodes of their true size, so their
//! fringing field is real. Both use the complete electrode model.

use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{
    CellKind, ElectrodeShape, ElectrodedMesh, Mesh, MeshError, Outline, PrismElectrode, PrismSpec, SheetSpec,
};

use super::conductance_map::ConductanceMap;
use crate::error::{TwinError, check, check_positive};

/// Electrodes of a tray.
#[derive(Clone, Debug, PartialEq)]
pub struct LiquidElectrodes {
    /// Stretches of the rim, in order; and pads on the bottom if fields are depth-averaged.
    pub shapes: Vec<ElectrodeShape>,
    /// Height of the electrodes on the wall, metres.
    pub height_m: f64,
    /// Height of their centres above the bottom, metres; makes no difference in depth-averaged fields.
    pub middle_m: f64,
    /// Specific contact impedance, ohm.m^2: one for all or one each.
    pub contact_impedances_ohm_m2: Vec<f64>,
}

fn is_on_rim(shape: &ElectrodeShape) -> bool {
    matches!(shape, ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. })
}

/// A tray of liquid at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct LiquidSpec {
    /// Outline seen from above.
    pub outline: Outline,
    /// Depth, metres.
    pub depth_m: f64,
    /// Conductivity, S/m.
    pub conductivity_s_per_m: f64,
    /// A factor on the conductance over the plan, for depth-averaged fields only.
    pub conductance: ConductanceMap,
    /// Electrodes of the tray.
    pub electrodes: LiquidElectrodes,
    /// Edge length of the triangles seen from above, metres.
    pub element_size_m: f64,
    /// Edge length at electrodes, metres.
    pub electrode_element_size_m: f64,
}

/// The fields of a tray for any depth over its plan.
#[derive(Debug)]
pub struct LiquidFields {
    spec: LiquidSpec,
    protocol: Protocol,
    plan: Mesh,
    body: Body,
}

#[derive(Debug)]
enum Body {
    Averaged { model: Box<ForwardModel>, sheet_s: Vec<f64> },
    Solid { rest: ElectrodedMesh },
}

impl LiquidSpec {
    fn check(&self) -> Result<(), TwinError> {
        check_positive("depth_m", self.depth_m)?;
        check_positive("conductivity_s_per_m", self.conductivity_s_per_m)?;
        let electrodes = &self.electrodes;
        for &value in &electrodes.contact_impedances_ohm_m2 {
            check_positive("contact_impedances_ohm_m2", value)?;
        }
        if !electrodes.shapes.iter().any(is_on_rim) {
            return Ok(());
        }
        let expected = "above 0 and no more than the liquid's depth";
        let half = 0.5 * electrodes.height_m;
        check("electrode_height_m", 2.0 * half, f64::MIN_POSITIVE, self.depth_m, expected)?;
        // A patch that ends at the surface may miss it by rounding.
        let slack = 1e-9 * self.depth_m;
        let range = (half - slack, self.depth_m - half + slack);
        check("electrode_middle_m", electrodes.middle_m, range.0, range.1, "a place within the wall")
    }

    /// The plan as a sheet with its electrodes. Current that enters over a share of the wall's height sees the
    /// impedance of that share.
    fn sheet(&self) -> Result<ElectrodedMesh, TwinError> {
        let electrodes = &self.electrodes;
        let mut sheet = SheetSpec::new(self.outline.clone(), electrodes.shapes.clone(), self.element_size_m);
        sheet.electrode_element_size_m = self.electrode_element_size_m;
        let per_m = |(shape, impedance): (&ElectrodeShape, &f64)| match is_on_rim(shape) {
            true => impedance / electrodes.height_m,
            false => *impedance,
        };
        let given = &electrodes.contact_impedances_ohm_m2;
        let impedances: Vec<f64> = match given.as_slice() {
            [one] => electrodes.shapes.iter().map(|shape| per_m((shape, one))).collect(),
            each if each.len() == electrodes.shapes.len() => electrodes.shapes.iter().zip(each).map(per_m).collect(),
            // The mesh refuses the wrong number of impedances.
            other => other.to_vec(),
        };
        Ok(sheet.build(&impedances)?.0)
    }

    fn solid(&self, layers: usize) -> Result<ElectrodedMesh, TwinError> {
        let electrodes = &self.electrodes;
        if let Some(electrode) = electrodes.shapes.iter().position(|shape| !is_on_rim(shape)) {
            let reason = "expected a stretch of the rim: three-dimensional fields support no others".to_string();
            return Err(MeshError::Electrode { electrode, reason }.into());
        }
        let low_m = (electrodes.middle_m - 0.5 * electrodes.height_m).max(0.0);
        let high_m = (low_m + electrodes.height_m).min(self.depth_m);
        let side = |rim: &ElectrodeShape| PrismElectrode::Side { rim: rim.clone(), low_m, high_m };
        let prism = PrismSpec {
            outline: self.outline.clone(),
            height_m: self.depth_m,
            element_size_m: self.element_size_m,
            electrode_element_size_m: self.electrode_element_size_m,
            layers,
            electrodes: electrodes.shapes.iter().map(side).collect(),
        };
        Ok(prism.build(&electrodes.contact_impedances_ohm_m2)?)
    }
}

impl LiquidFields {
    /// Depth-averaged fields: fast.
    ///
    /// # Errors
    /// Invalid parameters, a plan that cannot be meshed, or a protocol for other electrodes.
    pub fn averaged(spec: LiquidSpec, protocol: Protocol) -> Result<Self, TwinError> {
        spec.check()?;
        let sheet = spec.sheet()?;
        let plan = sheet.mesh.clone();
        let body = Body::Averaged {
            sheet_s: vec![0.0; plan.element_count()],
            model: Box::new(ForwardModel::new(sheet, protocol.clone())?),
        };
        Ok(Self { spec, protocol, plan, body })
    }

    /// Three-dimensional fields with about `layers` layers of elements: slow, since every solution needs a new body.
    ///
    /// # Errors
    /// As [`LiquidFields::averaged`].
    pub fn solid(spec: LiquidSpec, layers: usize, protocol: Protocol) -> Result<Self, TwinError> {
        spec.check()?;
        let rest = spec.solid(layers)?;
        let plan = bottom_of(&rest.mesh)?;
        Ok(Self { spec, protocol, plan, body: Body::Solid { rest } })
    }

    /// The plan; depths are given at its nodes.
    pub fn plan(&self) -> &Mesh {
        &self.plan
    }

    /// Number of elements on which the fields are solved.
    pub fn element_count(&self) -> usize {
        match &self.body {
            Body::Averaged { model, .. } => model.body().mesh.element_count(),
            Body::Solid { rest } => rest.mesh.element_count(),
        }
    }

    /// Stimulation and measurement.
    pub fn protocol(&self) -> &Protocol {
        &self.protocol
    }

    /// One voltage per channel, volts, for a depth at each node of the plan, metres, linear in between.
    ///
    /// # Errors
    /// Depths that are not positive, or fields that cannot be solved.
    pub fn voltages(&mut self, depth_m: &[f64]) -> Result<Vec<f64>, TwinError> {
        match &mut self.body {
            Body::Averaged { model, sheet_s } => {
                for (sheet, triangle) in sheet_s.iter_mut().zip(self.plan.elements()) {
                    let mean = triangle.iter().map(|&node| depth_m[node as usize]).sum::<f64>() / 3.0;
                    *sheet = self.spec.conductivity_s_per_m * mean;
                    if !self.spec.conductance.is_even() {
                        let at = |axis: usize| {
                            triangle.iter().map(|&n| self.plan.nodes()[n as usize][axis]).sum::<f64>() / 3.0
                        };
                        *sheet *= self.spec.conductance.at([at(0), at(1)]);
                    }
                }
                Ok(model.voltages(sheet_s)?)
            }
            Body::Solid { rest } => {
                let deformed = deformed(rest, depth_m, self.spec.depth_m)?;
                let sigma = vec![self.spec.conductivity_s_per_m; deformed.mesh.element_count()];
                Ok(ForwardModel::new(deformed, self.protocol.clone())?.voltages(&sigma)?)
            }
        }
    }
}

/// The mesh of a prism's bottom. The prism's nodes are stored level by level, starting with those of the plan.
fn bottom_of(solid: &Mesh) -> Result<Mesh, TwinError> {
    let per_level = solid.nodes().iter().take_while(|node| node[2] == 0.0).count();
    let faces = solid.boundary_faces();
    let at_bottom = |face: &&(Vec<u32>, u32)| face.0.iter().all(|&node| (node as usize) < per_level);
    let triangles = faces.iter().filter(at_bottom).flat_map(|(face, _)| face.iter().copied()).collect();
    Ok(Mesh::new(CellKind::Triangle, solid.nodes()[..per_level].to_vec(), triangles)?)
}

/// The prism with its levels moved in proportion to the depth.
fn deformed(rest: &ElectrodedMesh, depth_m: &[f64], rest_m: f64) -> Result<ElectrodedMesh, TwinError> {
    let scaled = |(index, node): (usize, &[f64; 3])| {
        let [x, y, z] = *node;
        [x, y, z * depth_m[index % depth_m.len()] / rest_m]
    };
    let nodes = rest.mesh.nodes().iter().enumerate().map(scaled).collect();
    let elements = rest.mesh.elements().flatten().copied().collect();
    let mesh = Mesh::new(CellKind::Tetrahedron, nodes, elements)?;
    Ok(ElectrodedMesh::new(mesh, rest.electrodes.clone())?)
}
