//! A sheet with electrodes under separate shortcut patches with a gap between them. Pressing brings patches into
//! contact with the sheet and raises its local conductivity. Unlike a continuous layer, patches do not connect
//! distant touches.
//!
//! A sheet bent without stretching gives the same readings as when laid flat, so positions always refer to the flat
//! sheet.

use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{ElectrodedMesh, Outline, Point};

use crate::electroded_layer::ElectrodedLayer;
use crate::error::{TwinError, check, check_positive};
use crate::gap::Gap;
use crate::instrument::Instrument;
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory};
use crate::physics::{ContactCell, PatchLayout, PatchedSheet};
use crate::twin::Frontend;
use crate::wiring::superpose;

/// Description of a skin of sheet and patches. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchedOptions {
    /// The sheet with its electrodes.
    pub layer: ElectrodedLayer,
    /// Sheet conductance of the sheet, siemens: conductivity times thickness.
    pub sheet_s: f64,
    /// The patches, with at most 8000 contact cells on the sheet; the cells need `8 cells^2` bytes, 512 MB.
    pub patches: PatchLayout,
    /// Spreading of pressure on its way to the gap.
    pub cover: Cover,
    /// Contact between sheet and patches.
    pub contact: ContactLaw,
    /// Viscoelastic memory of the cover, if any.
    pub memory: Option<Memory>,
}

impl PatchedOptions {
    /// The same skin with triangles of other edge lengths: in general, and at electrodes.
    #[must_use]
    pub fn meshed(mut self, element_size_m: f64, electrode_element_size_m: f64) -> Self {
        self.layer = self.layer.meshed(element_size_m, electrode_element_size_m);
        self
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("sheet_s", self.sheet_s)?;
        self.patches.check()?;
        self.layer.check()?;
        let cells = self.patches.cells_on(&self.layer.outline).round();
        let expected = "at most 8000 (512 MB of memory): patches with a larger pitch, or fewer cells_per_side";
        check("contact cells on the sheet", cells, 0.0, PatchLayout::MOST_CELLS, expected)
    }
}

/// The skin; see the module.
#[derive(Clone, Debug)]
pub struct PatchedSkin {
    outline: Outline,
    body: ElectrodedMesh,
    protocol: Protocol,
    sheet: PatchedSheet,
    places_m: Vec<Point>,
    gap: Gap,
    voltages_v: Vec<f64>,
}

impl PatchedSkin {
    /// Meshes the skin and solves the sheet without contact.
    ///
    /// # Errors
    /// Invalid parameters, electrodes that do not fit the protocol, or a mesh that cannot be built.
    pub fn new(options: PatchedOptions) -> Result<Self, TwinError> {
        options.check()?;
        let mut gap = Gap::new(options.cover, options.contact, options.memory, 0)?;
        let layer = options.layer;
        let (body, _) = layer.sheet_spec().build(&layer.contact_impedances_ohm_m2)?;
        let sheet = PatchedSheet::new(&body, options.sheet_s, options.patches, &layer.conductance)?;
        let places_m: Vec<Point> = sheet.cells().iter().map(|cell| cell.centre_m).collect();
        gap.reset(places_m.len());
        Ok(Self {
            voltages_v: vec![0.0; layer.protocol.channel_count()],
            outline: layer.outline,
            protocol: layer.protocol,
            body,
            sheet,
            places_m,
            gap,
        })
    }

    /// Its flat mesh with electrodes.
    pub fn body(&self) -> &ElectrodedMesh {
        &self.body
    }

    /// Stimulation and measurement.
    pub fn stimulation(&self) -> &Protocol {
        &self.protocol
    }

    /// The sheet under its patches.
    pub fn sheet(&self) -> &PatchedSheet {
        &self.sheet
    }

    /// Contact cells, in the order of [`PatchedSkin::contact_s_per_m2`].
    pub fn cells(&self) -> &[ContactCell] {
        self.sheet.cells()
    }

    /// Contact conductance of each cell after the last frame, S/m^2.
    pub fn contact_s_per_m2(&self) -> &[f64] {
        self.gap.contact_s_per_m2()
    }

    /// Replaces the contact law, for instance to fit it.
    ///
    /// # Errors
    /// As [`ContactLaw::check`].
    pub fn set_contact(&mut self, contact: ContactLaw) -> Result<(), TwinError> {
        self.gap.set_contact(contact)
    }

    fn solve(&mut self) -> Result<(), TwinError> {
        let impedance = self.sheet.impedance(self.gap.contact_s_per_m2())?;
        superpose(&self.protocol, impedance, &mut self.voltages_v);
        self.gap.mark_solved();
        Ok(())
    }
}

impl Frontend for PatchedSkin {
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    fn extent(&self) -> Outline {
        self.outline.clone()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_protocol(&self.protocol)
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        if self.gap.press(indenters, &self.places_m, dt_s) {
            self.solve()?;
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}
