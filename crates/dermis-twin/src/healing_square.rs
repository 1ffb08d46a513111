//! `healing-square`, the self-healing sandwich of paper H (Chen, Wang et al.): a 100 mm square of conductive composite
//! with 16 pads along its rim under an air gap and a copper layer. Pressing closes the gap, current takes the shortcut
//! and the local equivalent conductivity rises; a cut lowers it. Both follow from the two-sheet fields alone.

use dermis_tomo::eit::{Drive, Driven, Measure, Order, Protocol, ProtocolSpec};
use dermis_tomo::mesh::{Direction, ElectrodeShape, ElectrodedMesh, Outline, SheetSpec};
use serde::{Deserialize, Serialize};

use crate::error::{TwinError, check_positive};
use crate::healing::{Treatment, Wear, Wound};
use crate::instrument::{Instrument, InstrumentOptions};
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory, PressureState};
use crate::physics::{Cut, Shortcut, TwoSheets};
use crate::scene::{Scene, SceneOptions, Script};
use crate::twin::{Frontend, Twin};

/// Side of the square.
const SIDE_M: f64 = 0.1;
/// Side of a pad.
const PAD_M: f64 = 6e-3;
/// Pads a side, the two at its corners included: 4 x 23.5 mm between the middles of pads flush with the rim.
const PADS_PER_SIDE: usize = 5;
const PITCH_M: f64 = 23.5e-3;

/// Parameters of the twin. The defaults are those of paper H where it gives any.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HealingSquareOptions {
    /// Edge length of the twin's triangles, metres. Its mesh is finer than a reconstruction's and of other sizes.
    pub element_size_m: f64,
    /// Edge length at the pads, metres.
    pub electrode_element_size_m: f64,
    /// Conductivity of the composite, S/m. A bar of 100 x 10 x 1 mm has 2.01 kohm: 4.98 S/m.
    pub conductivity_s_per_m: f64,
    /// Its thickness, metres.
    pub thickness_m: f64,
    /// Sheet conductance of the copper, siemens: 35 um of foil (assumed) at 5.8e7 S/m.
    pub copper_sheet_s: f64,
    /// Specific contact impedance of the pads, ohm.m^2. Assumed: 14 ohm a pad, so that current enters over
    /// `sqrt(5e-4 x 5 mS)` = 1.6 mm, which the mesh resolves. Four-electrode voltages hardly depend on it.
    pub contact_impedance_ohm_m2: f64,
    /// Amplitude of the current, amperes.
    pub current_a: f64,
    /// Frames a second for those who pace the twin. The paper gives none; at 954 Hz a scan of 208 channels one after
    /// the other lasts at least 0.22 s, so a real device is slower than this default.
    pub frame_rate_hz: f64,
    /// How pressure spreads on its way to the contact.
    pub cover: Cover,
    /// Contact of composite and copper.
    pub contact: ContactLaw,
    /// Viscoelastic memory of the sheet, where wanted.
    pub memory: Option<Memory>,
    /// Noise, drift, converter.
    pub instrument: InstrumentOptions,
    /// Fading, and how script and people share the skin.
    pub scene: SceneOptions,
    /// What touches it by itself.
    pub script: Option<Script>,
    /// Seed of the instrument's noise.
    pub seed: u64,
}

impl Default for HealingSquareOptions {
    fn default() -> Self {
        Self {
            element_size_m: 1.7e-3,
            electrode_element_size_m: 1.0e-3,
            conductivity_s_per_m: 0.1 / (2010.0 * 0.01 * 0.001),
            thickness_m: 1e-3,
            copper_sheet_s: 35e-6 * 5.8e7,
            contact_impedance_ohm_m2: 5e-4,
            current_a: 0.35e-3,
            frame_rate_hz: 25.0,
            cover: Cover::default(),
            contact: ContactLaw::default(),
            memory: None,
            instrument: InstrumentOptions::healing(),
            scene: SceneOptions::default(),
            script: None,
            seed: 1,
        }
    }
}

impl HealingSquareOptions {
    /// Sheet conductance of the intact composite, siemens.
    pub fn sheet_s(&self) -> f64 {
        self.conductivity_s_per_m * self.thickness_m
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("conductivity_s_per_m", self.conductivity_s_per_m)?;
        check_positive("thickness_m", self.thickness_m)?;
        let expected = "at least 100 times the composite's sheet conductance, finite";
        crate::error::check("copper_sheet_s", self.copper_sheet_s, 100.0 * self.sheet_s(), f64::MAX, expected)?;
        check_positive("contact_impedance_ohm_m2", self.contact_impedance_ohm_m2)?;
        check_positive("frame_rate_hz", self.frame_rate_hz)?;
        check_positive("cover smoothing_m", self.cover.smoothing_m)?;
        self.contact.check()?;
        self.memory.as_ref().map_or(Ok(()), Memory::check)
    }
}

/// How the cuts are in the mesh.
#[derive(Debug, Default)]
struct Slits {
    /// Both ends of every cut, metres.
    ends_m: Vec<[[f64; 2]; 2]>,
    /// Whether the mesh is slit there; else the elements that the cut crosses are blocked whole.
    is_slit: Vec<bool>,
    /// The cut that each edge of the slits belongs to.
    cut_of_edge: Vec<usize>,
}

/// The sandwich itself; see the module. The composite is slit where it is cut, and joined again across the slit as it heals. A
/// cut that no slit can follow (through a pad, off the skin, across another cut) blocks the elements that it crosses.
#[derive(Debug)]
pub struct HealingSquare {
    body: ElectrodedMesh,
    protocol: Protocol,
    sheets: TwoSheets,
    sheet_s: f64,
    /// Cuts set from outside.
    cuts: Vec<Cut>,
    /// Cuts and heat of its own life.
    wear: Wear,
    spec: SheetSpec,
    contact_impedance_ohm_m2: f64,
    shortcut: Shortcut,
    slits: Slits,
    memory: Option<Memory>,
    cover: Cover,
    contact: ContactLaw,
    state: PressureState,
    pressure_pa: Vec<f64>,
    contact_s_per_m2: Vec<f64>,
    /// The contact that `voltages_v` belongs to.
    solved_s_per_m2: Vec<f64>,
    solved: bool,
    voltages_v: Vec<f64>,
}

impl HealingSquare {
    /// Outline of the skin.
    pub fn outline() -> Outline {
        Outline::Rectangle { width_m: SIDE_M, height_m: SIDE_M }
    }

    /// Its 16 pads: squares of 6 mm flush with the rim, 23.5 mm from middle to middle, corners included; number 1 at
    /// the bottom left, counter-clockwise.
    pub fn electrodes() -> Vec<ElectrodeShape> {
        let pad = ElectrodeShape::PadRectangle { centre_m: [0.0; 2], width_m: PAD_M, height_m: PAD_M, angle_rad: 0.0 };
        pad.ring(PADS_PER_SIDE, PADS_PER_SIDE, [PITCH_M; 2], Direction::CounterClockwise)
    }

    /// Its protocol: pairs (k, k+7) drive and measure, channels on driven electrodes dropped, measurements from
    /// electrode 1 on; 208 channels.
    ///
    /// # Errors
    /// A current that is not positive and finite.
    pub fn protocol(current_a: f64) -> Result<Protocol, TwinError> {
        Ok(Protocol::generate(&ProtocolSpec {
            electrode_count: Self::electrodes().len(),
            drive: Drive::PseudoPolar,
            measure: Measure::PseudoPolar,
            order: Order::Absolute,
            driven: Driven::Drop,
            amplitude_a: current_a,
        })?)
    }

    /// Meshes the skin and prepares its fields.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made.
    pub fn new(options: &HealingSquareOptions) -> Result<Self, TwinError> {
        options.check()?;
        let protocol = Self::protocol(options.current_a)?;
        let mut spec = SheetSpec::new(Self::outline(), Self::electrodes(), options.element_size_m);
        spec.electrode_element_size_m = options.electrode_element_size_m;
        let contact_impedance_ohm_m2 = options.contact_impedance_ohm_m2;
        let (body, _) = spec.build(&[contact_impedance_ohm_m2])?;
        let shortcut = Shortcut::Sheet { conductance_s: options.copper_sheet_s };
        let sheets = TwoSheets::new(&body, options.sheet_s(), shortcut)?;
        let nodes = sheets.positions_m().len();
        Ok(Self {
            voltages_v: vec![0.0; protocol.channel_count()],
            sheet_s: options.sheet_s(),
            cuts: Vec::new(),
            wear: Wear::default(),
            spec,
            contact_impedance_ohm_m2,
            shortcut,
            slits: Slits::default(),
            memory: options.memory,
            cover: options.cover,
            contact: options.contact,
            state: PressureState::new(options.memory, nodes),
            pressure_pa: vec![0.0; nodes],
            contact_s_per_m2: vec![0.0; nodes],
            solved_s_per_m2: vec![0.0; nodes],
            solved: false,
            body,
            protocol,
            sheets,
        })
    }

    /// Its mesh with electrodes, slit where it is cut.
    pub fn body(&self) -> &ElectrodedMesh {
        &self.body
    }

    /// Stimulation and measurement.
    pub fn stimulation(&self) -> &Protocol {
        &self.protocol
    }

    /// The two sheets.
    pub fn sheets(&self) -> &TwoSheets {
        &self.sheets
    }

    /// The cuts set by [`HealingSquare::set_cuts`].
    pub fn cuts(&self) -> &[Cut] {
        &self.cuts
    }

    /// Replaces the cuts; none heals the skin without a scar.
    ///
    /// # Errors
    /// As [`Cut::check`].
    pub fn set_cuts(&mut self, cuts: Vec<Cut>) -> Result<(), TwinError> {
        cuts.iter().try_for_each(Cut::check)?;
        self.cuts = cuts;
        self.renew_sheet()
    }

    /// What has become of the sheet by [`Frontend::treat`].
    pub fn wear(&self) -> &Wear {
        &self.wear
    }

    fn renew_sheet(&mut self) -> Result<(), TwinError> {
        // Each cut in equal pieces that conduct differently.
        let cuts: Vec<Vec<Cut>> = self.wear.cuts().chain(self.cuts.iter().map(|cut| vec![*cut])).collect();
        let ends_m: Vec<[[f64; 2]; 2]> = cuts.iter().map(|pieces| whole(pieces)).collect();
        if ends_m != self.slits.ends_m {
            self.slit(ends_m)?;
        }
        let (sheet_s, wear, slits) = (self.sheet_s, &self.wear, &self.slits);
        let inset_m = 0.5 * self.spec.element_size_m;
        let blocking = cuts.iter().zip(&slits.is_slit).filter(|(_, is_slit)| !**is_slit);
        let blocking: Vec<Cut> = blocking.flat_map(|(pieces, _)| drawn_in(pieces, inset_m)).collect();
        self.sheets.set_sensing_by(|point| sheet_s * wear.share_at(point), &blocking);
        self.sheets.set_joints(|edge, middle| {
            let cut = slits.cut_of_edge[edge];
            let ([from, to], pieces) = (slits.ends_m[cut], &cuts[cut]);
            let along = [to[0] - from[0], to[1] - from[1]];
            let share = ((middle[0] - from[0]) * along[0] + (middle[1] - from[1]) * along[1])
                / (along[0] * along[0] + along[1] * along[1]);
            let piece = &pieces[((share * pieces.len() as f64) as usize).min(pieces.len() - 1)];
            sheet_s * wear.share_at(middle) * piece.joining_per_m()
        });
        self.solved = false;
        Ok(())
    }

    /// Meshes the skin anew with slits along cuts, as many as can be slit.
    fn slit(&mut self, ends_m: Vec<[[f64; 2]; 2]>) -> Result<(), TwinError> {
        let (slit, is_slit) = self.spec.build_slit(&[self.contact_impedance_ohm_m2], &ends_m)?;
        let slit_cuts = is_slit.iter().enumerate().filter(|(_, is_slit)| **is_slit).map(|(cut, _)| cut);
        let cut_of_edge = slit_cuts.zip(&slit.slits).flat_map(|(cut, edges)| edges.iter().map(move |_| cut)).collect();
        self.sheets = TwoSheets::with_slits(&slit.mesh, &slit.slits.concat(), self.sheet_s, self.shortcut)?;
        self.body = slit.mesh;
        self.slits = Slits { ends_m, is_slit, cut_of_edge };
        let nodes = self.sheets.positions_m().len();
        self.state = PressureState::new(self.memory, nodes);
        for values in [&mut self.pressure_pa, &mut self.contact_s_per_m2, &mut self.solved_s_per_m2] {
            values.clear();
            values.resize(nodes, 0.0);
        }
        Ok(())
    }

    /// Contact conductance at each node after the last frame, S/m^2.
    pub fn contact_s_per_m2(&self) -> &[f64] {
        &self.contact_s_per_m2
    }

    /// Voltages by superposition of the electrodes' unit currents.
    fn solve(&mut self) -> Result<(), TwinError> {
        let impedance = self.sheets.impedance(&self.contact_s_per_m2)?;
        for (voltage, channel) in self.voltages_v.iter_mut().zip(self.protocol.measurements()) {
            let stimulation = &self.protocol.stimulations()[channel.stimulation as usize];
            let pattern = &self.protocol.patterns()[channel.pattern as usize];
            *voltage = 0.0;
            for &(electrode, weight) in pattern.entries() {
                for &(driven, current) in stimulation.entries() {
                    *voltage += weight * current * impedance[(electrode as usize, driven as usize)];
                }
            }
        }
        self.solved_s_per_m2.copy_from_slice(&self.contact_s_per_m2);
        self.solved = true;
        Ok(())
    }
}

/// Both ends of a cut in pieces.
fn whole(pieces: &[Cut]) -> [[f64; 2]; 2] {
    [pieces[0].from_m, pieces[pieces.len() - 1].to_m]
}

/// A cut in pieces, shorter by this at both ends ([`Cut::shortened`]).
fn drawn_in(pieces: &[Cut], by_m: f64) -> Vec<Cut> {
    let [from_m, to_m] = whole(pieces);
    let cut = Cut { from_m, to_m, ..pieces[0] }.shortened(by_m);
    let count = pieces.len() as f64;
    let piece = |(k, piece): (usize, &Cut)| Cut {
        from_m: cut.at(k as f64 / count),
        to_m: cut.at((k + 1) as f64 / count),
        ..*piece
    };
    pieces.iter().enumerate().map(piece).collect()
}

impl Frontend for HealingSquare {
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    fn extent(&self) -> Outline {
        Self::outline()
    }

    fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        self.wear.treat(treatment)?;
        self.renew_sheet()
    }

    fn wounds(&self) -> Vec<Wound> {
        self.wear.wounds().collect()
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        if self.wear.advance(dt_s) {
            self.renew_sheet()?;
        }
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(self.cover, self.sheets.positions_m(), &mut self.pressure_pa);
        }
        self.state.apply(dt_s, &mut self.pressure_pa);
        for (g, pressure) in self.contact_s_per_m2.iter_mut().zip(&self.pressure_pa) {
            *g = self.contact.conductance_s_per_m2(*pressure);
        }
        // A skin that is left alone, or held still, costs nothing.
        if !self.solved || self.contact_s_per_m2 != self.solved_s_per_m2 {
            self.solve()?;
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}

impl Twin<HealingSquare> {
    /// The twin of paper H's skin.
    ///
    /// # Errors
    /// Parameters that make no sense, a mesh that cannot be made.
    pub fn healing_square(options: &HealingSquareOptions) -> Result<Self, TwinError> {
        let frontend = HealingSquare::new(options)?;
        let instrument = Instrument::new(options.instrument, frontend.channel_count(), options.seed)?;
        let instrument = instrument.with_protocol(frontend.stimulation())?;
        let scene = Scene::new(options.scene, options.script.clone())?.on(frontend.extent())?;
        Ok(Self::new(frontend, instrument, scene))
    }
}
