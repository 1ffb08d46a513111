//! From a skin file to its geometry, mesh and protocol.

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec, Reference};
use dermis_tomo::mesh::{
    Direction, ElectrodeShape, ElectrodedMesh, MeshError, Outline, PixelGrid, SheetSpec, SlitMesh,
};

use dermis_twin::physics::Surface;
use dermis_twin::square_to_disc;

use super::{
    Bend, DrivePattern, DrivenChannels, Electrodes, MeasurePattern, Modality, Pad, ReadingOrder, ReferenceChoice,
    RimElectrode, Shape, Skin,
};
use crate::Error;

const MM: f64 = 1e-3;

/// A skin's geometry made concrete.
#[derive(Clone, Debug)]
pub struct SkinBody {
    /// Outline, metres.
    pub outline: Outline,
    /// Electrode shapes, in order.
    pub electrodes: Vec<ElectrodeShape>,
    /// Mesh with electrodes.
    pub mesh: ElectrodedMesh,
}

impl Skin {
    /// Outline in metres.
    pub fn outline(&self) -> Outline {
        match &self.frontend.shape {
            Shape::Disc { diameter_mm } => Outline::Disc { radius_m: 0.5 * diameter_mm * MM },
            Shape::Square { side_mm } => Outline::Rectangle { width_m: side_mm * MM, height_m: side_mm * MM },
            Shape::Rectangle { width_mm, height_mm } => {
                Outline::Rectangle { width_m: width_mm * MM, height_m: height_mm * MM }
            }
            Shape::Polygon { outer_mm, holes_mm } => {
                let metres = |points: &[[f64; 2]]| points.iter().map(|p| [p[0] * MM, p[1] * MM]).collect::<Vec<_>>();
                Outline::Polygon { outer: metres(outer_mm), holes: holes_mm.iter().map(|h| metres(h)).collect() }
            }
        }
    }

    /// Electrode shapes in metres, in order; of coils, their outlines.
    pub fn electrode_shapes(&self) -> Vec<ElectrodeShape> {
        if let Some(coils) = &self.frontend.coils {
            return coils.outlines();
        }
        match &self.frontend.electrodes {
            Electrodes::Rim { count, width_mm, start_deg, clockwise } => {
                let direction = if *clockwise { Direction::Clockwise } else { Direction::CounterClockwise };
                let outline = self.outline();
                match outline {
                    Outline::Disc { .. } => Outline::rim_arcs(*count, width_mm * MM, start_deg.to_radians(), direction),
                    _ => {
                        let start_m = start_deg / 360.0 * outline.perimeter_m();
                        outline.rim_segments(*count, width_mm * MM, start_m, direction)
                    }
                }
            }
            Electrodes::RimPads { per_side, pitch_mm, size_mm } => {
                let pad = ElectrodeShape::PadRectangle {
                    centre_m: [0.0, 0.0],
                    width_m: size_mm * MM,
                    height_m: size_mm * MM,
                    angle_rad: 0.0,
                };
                pad.ring(per_side + 1, per_side + 1, [pitch_mm * MM; 2], Direction::CounterClockwise)
            }
            Electrodes::RimList(list) => {
                let outline = self.outline();
                let on_disc = matches!(outline, Outline::Disc { .. });
                let place = |electrode: &RimElectrode| {
                    let width_m = electrode.width_mm * MM;
                    if on_disc {
                        ElectrodeShape::RimArc { centre_rad: electrode.at_deg.to_radians(), width_m }
                    } else {
                        let turn = (electrode.at_deg / 360.0).rem_euclid(1.0);
                        ElectrodeShape::RimSegment { centre_m: turn * outline.perimeter_m(), width_m }
                    }
                };
                list.iter().map(place).collect()
            }
            Electrodes::PadGrid { per_side, diameter_mm } => {
                let pad = |centre_m| ElectrodeShape::PadCircle { centre_m, radius_m: 0.5 * diameter_mm * MM };
                pad_grid(&self.outline(), *per_side).into_iter().map(pad).collect()
            }
            Electrodes::Pads(pads) => pads.iter().map(pad_shape).collect(),
        }
    }

    /// How the sheet lies in space: maps between positions on the sheet laid flat, in which everything else is given, and
    /// points in space, for drawing. Bending without stretching changes no field, see [`Surface`].
    pub fn surface(&self) -> Surface {
        match self.frontend.bend {
            Some(Bend::Cylinder { diameter_mm }) => Surface::Cylinder { radius_m: 0.5 * diameter_mm * MM },
            None => Surface::Flat,
        }
    }

    /// Sheet conductance of the resting skin, siemens: conductivity times thickness.
    pub fn sheet_conductance_s(&self) -> f64 {
        self.frontend.layer.conductivity_s_per_m * self.frontend.layer.thickness_mm * MM
    }

    /// The reconstruction's mesh, with electrodes.
    ///
    /// # Errors
    /// Shapes that cannot be meshed, electrodes that overlap or lie off the skin.
    pub fn body(&self) -> Result<SkinBody, Error> {
        self.body_with_elements(self.imaging.elements)
    }

    /// A mesh of about so many elements, with electrodes.
    ///
    /// # Errors
    /// As [`Skin::body`].
    pub fn body_with_elements(&self, elements: usize) -> Result<SkinBody, Error> {
        let electrodes = self.electrode_shapes();
        let factors = vec![1.0; electrodes.len()];
        self.body_with_electrodes(elements, electrodes, &factors)
    }

    /// As [`Skin::body_with_elements`] with electrodes somewhat elsewhere, and a factor on each contact impedance.
    pub(crate) fn body_with_electrodes(
        &self,
        elements: usize,
        electrodes: Vec<ElectrodeShape>,
        contact_factors: &[f64],
    ) -> Result<SkinBody, Error> {
        let spec = self.sheet_spec(elements, electrodes)?;
        let impedances: Vec<f64> = self
            .sheet_contact_impedances(&spec.electrodes)
            .zip(contact_factors)
            .map(|(z, factor)| factor * z)
            .collect();
        let (mesh, _) = spec.build(&impedances).map_err(|source| self.not_meshed(source))?;
        Ok(SkinBody { outline: spec.outline, electrodes: spec.electrodes, mesh })
    }

    /// A mesh of about so many elements, with electrodes and with slits along lines (both ends, metres), which bring some more;
    /// and which of them could be slit, see [`SheetSpec::build_slit`].
    pub(crate) fn slit_mesh(&self, elements: usize, lines: &[[[f64; 2]; 2]]) -> Result<(SlitMesh, Vec<bool>), Error> {
        let spec = self.sheet_spec(elements, self.electrode_shapes())?;
        let impedances: Vec<f64> = self.sheet_contact_impedances(&spec.electrodes).collect();
        spec.build_slit(&impedances, lines).map_err(|source| self.not_meshed(source))
    }

    fn not_meshed(&self, source: MeshError) -> Error {
        Error::Mesh { skin: self.name.clone(), source }
    }

    fn sheet_spec(&self, elements: usize, electrodes: Vec<ElectrodeShape>) -> Result<SheetSpec, Error> {
        let outline = self.outline();
        let size = (outline.area_m2() / elements as f64 * 2.3).sqrt();
        let spec = SheetSpec::new(outline, electrodes, size);
        spec.with_target_elements(elements).map_err(|source| self.not_meshed(source))
    }

    fn sheet_contact_impedances(&self, electrodes: &[ElectrodeShape]) -> impl Iterator<Item = f64> {
        // Coils touch nothing: they are in the mesh to be drawn.
        let impedance = |shape| if self.modality == Modality::Mit { 1.0 } else { self.sheet_contact_impedance(shape) };
        electrodes.iter().map(impedance)
    }

    /// Contact impedance in the unit that the sheet model takes: ohm.m^2 for pads under the sheet; ohm.m (the specific
    /// impedance over the thickness) for electrodes on the rim.
    fn sheet_contact_impedance(&self, shape: &ElectrodeShape) -> f64 {
        let specific = self.frontend.contact_impedance_ohm_m2;
        match shape {
            ElectrodeShape::RimArc { .. } | ElectrodeShape::RimSegment { .. } | ElectrodeShape::RimPoint { .. } => {
                specific / (self.frontend.layer.thickness_mm * MM)
            }
            _ => specific,
        }
    }

    /// Contact impedance of every electrode, ohm: the specific one over the electrode's area, on the rim its length times the
    /// layer's thickness. 0 for electrodes that are points; empty for coils, which have none.
    pub fn contact_impedances_ohm(&self) -> Vec<f64> {
        if self.modality == Modality::Mit {
            return Vec::new();
        }
        let area_m2 = |shape: &ElectrodeShape| match *shape {
            ElectrodeShape::RimArc { width_m, .. } | ElectrodeShape::RimSegment { width_m, .. } => {
                width_m * self.frontend.layer.thickness_mm * MM
            }
            ElectrodeShape::PadCircle { radius_m, .. } => std::f64::consts::PI * radius_m * radius_m,
            ElectrodeShape::PadRectangle { width_m, height_m, .. } => width_m * height_m,
            ElectrodeShape::RimPoint { .. } | ElectrodeShape::Point { .. } => f64::INFINITY,
        };
        let specific = self.frontend.contact_impedance_ohm_m2;
        self.electrode_shapes().iter().map(|shape| specific / area_m2(shape)).collect()
    }

    /// The grid that images of this skin live on: exactly its bounding box.
    ///
    /// # Errors
    /// An outline without extent.
    pub fn grid(&self) -> Result<PixelGrid, Error> {
        let (low, high) = self.outline().bounds_m();
        PixelGrid::covering(low, high, self.imaging.grid)
            .map_err(|source| Error::Mesh { skin: self.name.clone(), source })
    }

    /// Stimulation and measurement as explicit lists.
    ///
    /// # Errors
    /// Patterns that need another number of electrodes, or name electrodes that do not exist.
    pub fn protocol(&self) -> Result<Protocol, Error> {
        self.protocol_of(self.electrode_shapes().len())
            .map_err(|source| Error::Protocol { skin: self.name.clone(), source })
    }

    fn protocol_of(&self, electrode_count: usize) -> Result<Protocol, dermis_tomo::eit::ProtocolError> {
        let backend = &self.backend;
        if self.modality == Modality::Mit {
            return Protocol::coil_pairs(electrode_count, backend.current_ma * 1e-3);
        }
        let coils = dermis_tomo::eit::ProtocolError::TooFewElectrodes {
            pattern: "a pattern of coils, without them,",
            needed: usize::MAX,
            even: false,
            got: electrode_count,
        };
        // Electrode 0 does not exist on paper; wrapping makes it an index that is out of range and is refused as such.
        let zero_based =
            |pairs: &[[u32; 2]]| pairs.iter().map(|p| (p[0].wrapping_sub(1), p[1].wrapping_sub(1))).collect::<Vec<_>>();
        Protocol::generate(&ProtocolSpec {
            electrode_count,
            drive: match &backend.drive {
                DrivePattern::Adjacent => Drive::Adjacent,
                DrivePattern::Opposite => Drive::Opposite,
                DrivePattern::Skip(skip) => Drive::Skip(*skip),
                DrivePattern::PseudoPolar => Drive::PseudoPolar,
                DrivePattern::Trigonometric => Drive::Trigonometric,
                DrivePattern::Pairs(pairs) => Drive::Pairs(zero_based(pairs)),
                DrivePattern::EachCoil => return Err(coils),
            },
            measure: match &backend.measure {
                MeasurePattern::Adjacent => Measure::Adjacent,
                MeasurePattern::Opposite => Measure::Opposite,
                MeasurePattern::Skip(skip) => Measure::Skip(*skip),
                MeasurePattern::PseudoPolar => Measure::PseudoPolar,
                MeasurePattern::Pairs(pairs) => Measure::Pairs(zero_based(pairs)),
                MeasurePattern::HigherCoils => return Err(coils),
                MeasurePattern::SingleEnded(reference) => Measure::SingleEnded(match reference {
                    ReferenceChoice::Mean => Reference::Mean,
                    ReferenceChoice::Sink => Reference::Sink,
                    ReferenceChoice::Electrode(number) => Reference::Electrode(number.wrapping_sub(1)),
                }),
            },
            order: match backend.order {
                ReadingOrder::Absolute => Order::Absolute,
                ReadingOrder::Rotating => Order::Rotating,
            },
            driven: match backend.driven {
                DrivenChannels::Drop => Driven::Drop,
                DrivenChannels::Keep => Driven::Keep,
            },
            amplitude_a: backend.current_ma * 1e-3,
        })
    }
}

/// Places of [`Electrodes::PadGrid`], metres.
fn pad_grid(outline: &Outline, per_side: usize) -> Vec<[f64; 2]> {
    let (low, high) = outline.bounds_m();
    let unit = |k: usize| (2.0 * k as f64 + 1.0) / per_side as f64 - 1.0;
    let place = |row: usize, step: usize| {
        let column = if row.is_multiple_of(2) { step } else { per_side - 1 - step };
        let [x, y] = match outline {
            Outline::Disc { .. } => square_to_disc([unit(column), unit(row)]),
            _ => [unit(column), unit(row)],
        };
        let along = |axis: usize, unit: f64| 0.5 * (low[axis] + high[axis] + unit * (high[axis] - low[axis]));
        [along(0, x), along(1, y)]
    };
    (0..per_side).flat_map(|row| (0..per_side).map(move |step| place(row, step))).collect()
}

fn pad_shape(pad: &Pad) -> ElectrodeShape {
    let metres = |p: &[f64; 2]| [p[0] * MM, p[1] * MM];
    match pad {
        Pad::Circle { centre_mm, diameter_mm } => {
            ElectrodeShape::PadCircle { centre_m: metres(centre_mm), radius_m: 0.5 * diameter_mm * MM }
        }
        Pad::Rectangle { centre_mm, width_mm, height_mm } => ElectrodeShape::PadRectangle {
            centre_m: metres(centre_mm),
            width_m: width_mm * MM,
            height_m: height_mm * MM,
            angle_rad: 0.0,
        },
        Pad::Point { at_mm } => ElectrodeShape::Point { position_m: metres(at_mm) },
    }
}
