//! The conductive layer that a skin reads through its electrodes: geometry, contacts, protocol and mesh. Bare sheets,
//! sandwiches, patched skins and liquids share this description.

use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{ElectrodeShape, Outline, SheetSpec};

use crate::error::{TwinError, check_positive};
use crate::physics::ConductanceMap;

/// A conductive layer with electrodes. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct ElectrodedLayer {
    /// Outline of the layer, laid flat.
    pub outline: Outline,
    /// Electrodes, in order: pads or stretches of the rim.
    pub electrodes: Vec<ElectrodeShape>,
    /// Specific contact impedance of each electrode, or one value for all: ohm.m^2 under pads, ohm.m on the rim of a
    /// sheet.
    pub contact_impedances_ohm_m2: Vec<f64>,
    /// Currents and measurements, amperes.
    pub protocol: Protocol,
    /// A factor on the sheet conductance over the skin, for an uneven layer.
    pub conductance: ConductanceMap,
    /// Edge length of the triangles, metres. It should differ from a reconstruction's.
    pub element_size_m: f64,
    /// Edge length at electrodes, metres.
    pub electrode_element_size_m: f64,
}

impl ElectrodedLayer {
    /// The same layer with triangles of other edge lengths: in general, and at electrodes.
    #[must_use]
    pub fn meshed(self, element_size_m: f64, electrode_element_size_m: f64) -> Self {
        Self { element_size_m, electrode_element_size_m, ..self }
    }

    /// Refuses a number of electrodes that differs from the protocol's, and contact impedances that are not one for
    /// all or one each, positive and finite.
    pub(crate) fn check(&self) -> Result<(), TwinError> {
        let (electrodes, expected) = (self.electrodes.len(), self.protocol.electrode_count());
        if electrodes != expected {
            let expected = format!("{expected}, as the protocol has");
            return Err(TwinError::Count { field: "electrodes", got: electrodes, expected });
        }
        let (field, impedances) = ("contact_impedances_ohm_m2", &self.contact_impedances_ohm_m2);
        if ![1, electrodes].contains(&impedances.len()) {
            let expected = format!("1 for all electrodes, or {electrodes}: one for each");
            return Err(TwinError::Count { field, got: impedances.len(), expected });
        }
        impedances.iter().try_for_each(|&value| check_positive(field, value))
    }

    /// The sheet to mesh.
    pub(crate) fn sheet_spec(&self) -> SheetSpec {
        let mut spec = SheetSpec::new(self.outline.clone(), self.electrodes.clone(), self.element_size_m);
        spec.electrode_element_size_m = self.electrode_element_size_m;
        spec
    }
}
