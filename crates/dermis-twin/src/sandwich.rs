//! A sandwich: a conductive sheet with electrodes under a gap and a continuous floating shortcut layer. Pressing
//! closes the gap, so current takes the shortcut and the local equivalent conductivity rises; a cut of the sheet
//! lowers it. Both follow from the two-sheet fields alone ([`crate::physics::TwoSheets`]).

use std::any::Any;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis_tomo::eit::Protocol;
use dermis_tomo::mesh::{ElectrodedMesh, Outline, Point, SheetSpec};

use crate::electroded_layer::ElectrodedLayer;
use crate::error::{TwinError, check, check_positive};
use crate::gap::Gap;
use crate::healing::{HealingLaw, Treatment, Wear, Wound};
use crate::instrument::Instrument;
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory};
use crate::physics::{ConductanceMap, Cut, Shortcut, TwoSheets};
use crate::twin::{Frontend, Preparation};
use crate::wiring::superpose;

/// Description of a sandwich. SI units.
#[derive(Clone, Debug, PartialEq)]
pub struct SandwichOptions {
    /// The sensing sheet with its electrodes.
    pub layer: ElectrodedLayer,
    /// Sheet conductance of the sensing sheet, siemens: conductivity times thickness.
    pub sheet_s: f64,
    /// Sheet conductance of the shortcut layer, siemens; at least 100 times `sheet_s`.
    pub shortcut_s: f64,
    /// Spreading of pressure on its way to the gap.
    pub cover: Cover,
    /// Contact between sheet and shortcut layer.
    pub contact: ContactLaw,
    /// Viscoelastic memory of the cover, if any.
    pub memory: Option<Memory>,
    /// Healing of the sheet under heat; with `None` it can be cut but does not heal.
    pub healing: Option<HealingLaw>,
}

impl SandwichOptions {
    /// The same skin with triangles of other edge lengths: in general, and at electrodes.
    #[must_use]
    pub fn meshed(mut self, element_size_m: f64, electrode_element_size_m: f64) -> Self {
        self.layer = self.layer.meshed(element_size_m, electrode_element_size_m);
        self
    }

    fn check(&self) -> Result<(), TwinError> {
        check_positive("sheet_s", self.sheet_s)?;
        let expected = "at least 100 times sheet_s, finite";
        check("shortcut_s", self.shortcut_s, 100.0 * self.sheet_s, f64::MAX, expected)?;
        self.healing.as_ref().map_or(Ok(()), HealingLaw::check)?;
        self.layer.check()
    }
}

/// Representation of the cuts in the mesh.
#[derive(Debug, Default)]
struct Slits {
    /// Both ends of every cut, metres.
    ends_m: Vec<[Point; 2]>,
    /// True if the mesh is slit along each cut; otherwise the elements that it crosses are blocked.
    is_slit: Vec<bool>,
    /// Index of the cut for each edge of the slits.
    cut_of_edge: Vec<usize>,
}

/// Time between renewals of the conductances of a sheet that heals or warms, seconds. Heating takes minutes; solving a
/// sheet under many pads takes longer than a frame.
const RENEWAL_S: f64 = 0.1;

/// The sandwich; see the module. The sheet is slit where it is cut, and rejoined across the slit as it heals. A cut
/// that no slit can follow (through a pad, off the skin, across another cut) blocks the elements that it crosses.
#[derive(Debug)]
pub struct Sandwich {
    spec: SheetSpec,
    contact_impedances: Vec<f64>,
    body: ElectrodedMesh,
    protocol: Protocol,
    sheets: TwoSheets,
    sheet_s: f64,
    conductance: ConductanceMap,
    /// Cuts set by the caller.
    cuts: Vec<Cut>,
    /// Time since the conductances were last renewed, and whether the sheet has healed since.
    waiting_s: f64,
    has_healed: bool,
    /// Cuts and heat from treatments.
    wear: Wear,
    slits: Slits,
    gap: Gap,
    voltages_v: Vec<f64>,
}

impl Sandwich {
    /// Meshes the skin and prepares its fields.
    ///
    /// # Errors
    /// Invalid parameters, electrodes that do not fit the protocol, or a mesh that cannot be built.
    pub fn new(options: SandwichOptions) -> Result<Self, TwinError> {
        options.check()?;
        let mut gap = Gap::new(options.cover, options.contact, options.memory, 0)?;
        let layer = options.layer;
        let spec = layer.sheet_spec();
        let (body, _) = spec.build(&layer.contact_impedances_ohm_m2)?;
        let shortcut = Shortcut::Sheet { conductance_s: options.shortcut_s };
        let mut sheets = TwoSheets::new(&body, options.sheet_s, shortcut)?;
        if !layer.conductance.is_even() {
            sheets.set_sensing_by(|point| options.sheet_s * layer.conductance.at(point), &[]);
        }
        gap.reset(sheets.positions_m().len());
        Ok(Self {
            voltages_v: vec![0.0; layer.protocol.channel_count()],
            protocol: layer.protocol,
            sheet_s: options.sheet_s,
            conductance: layer.conductance,
            cuts: Vec::new(),
            wear: Wear::new(options.healing),
            waiting_s: 0.0,
            has_healed: false,
            slits: Slits::default(),
            spec,
            contact_impedances: layer.contact_impedances_ohm_m2,
            body,
            sheets,
            gap,
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

    /// The cuts set by [`Sandwich::set_cuts`].
    pub fn cuts(&self) -> &[Cut] {
        &self.cuts
    }

    /// Replaces the cuts; an empty list restores the skin without a scar.
    ///
    /// # Errors
    /// As [`Cut::check`].
    pub fn set_cuts(&mut self, cuts: Vec<Cut>) -> Result<(), TwinError> {
        cuts.iter().try_for_each(Cut::check)?;
        self.cuts = cuts;
        self.renew_sheet()
    }

    /// State of the sheet after [`Frontend::treat`].
    pub fn wear(&self) -> &Wear {
        &self.wear
    }

    fn renew_sheet(&mut self) -> Result<(), TwinError> {
        let cuts = self.pieces(&self.wear);
        let ends_m: Vec<[Point; 2]> = cuts.iter().map(|pieces| whole(pieces)).collect();
        if ends_m != self.slits.ends_m {
            let slit = SlitSheets::build(&self.plan(), ends_m)?;
            self.install(slit);
        }
        let plan = self.plan();
        plan.conduct(&mut self.sheets, &self.wear, &cuts, &self.slits);
        self.gap.mark_stale();
        Ok(())
    }

    /// Each cut, in equal pieces with different conductances.
    fn pieces(&self, wear: &Wear) -> Vec<Vec<Cut>> {
        wear.cuts().chain(self.cuts.iter().map(|cut| vec![*cut])).collect()
    }

    fn install(&mut self, slit: SlitSheets) {
        (self.sheets, self.body, self.slits) = (slit.sheets, slit.body, slit.slits);
        self.gap.reset(self.sheets.positions_m().len());
    }

    fn plan(&self) -> Plan {
        Plan {
            spec: self.spec.clone(),
            contact_impedances: self.contact_impedances.clone(),
            sheet_s: self.sheet_s,
            conductance: self.conductance.clone(),
            shortcut: self.sheets.shortcut(),
        }
    }

    /// Contact conductance at each node after the last frame, S/m^2.
    pub fn contact_s_per_m2(&self) -> &[f64] {
        self.gap.contact_s_per_m2()
    }

    /// Applies the treatments that were tried.
    fn take_over(&mut self, tried: Tried) -> Vec<TwinError> {
        let (before, mut refused) = (self.wear.clone(), tried.refused);
        let treated = tried.done.iter().try_for_each(|treatment| self.wear.treat(treatment));
        if let Some(sheet) = tried.sheet {
            self.install(sheet);
        }
        if let Err(error) = treated.and_then(|()| self.renew_sheet()) {
            self.wear = before;
            refused.push(error);
            // The previous sheet could be built before.
            refused.extend(self.renew_sheet().err());
        }
        refused
    }

    fn solve(&mut self) -> Result<(), TwinError> {
        let impedance = self.sheets.impedance(self.gap.contact_s_per_m2())?;
        superpose(&self.protocol, impedance, &mut self.voltages_v);
        self.gap.mark_solved();
        Ok(())
    }
}

/// Data from which a sheet is built, independent of its cuts.
struct Plan {
    spec: SheetSpec,
    contact_impedances: Vec<f64>,
    sheet_s: f64,
    conductance: ConductanceMap,
    shortcut: Shortcut,
}

impl Plan {
    /// Sets the conductances of a slit sheet according to wear and cuts.
    fn conduct(&self, sheets: &mut TwoSheets, wear: &Wear, cuts: &[Vec<Cut>], slits: &Slits) {
        let (sheet_s, map, share) = (self.sheet_s, &self.conductance, wear.share());
        let inset_m = 0.5 * self.spec.element_size_m;
        let blocking = cuts.iter().zip(&slits.is_slit).filter(|(_, is_slit)| !**is_slit);
        let blocking: Vec<Cut> = blocking.flat_map(|(pieces, _)| joined(drawn_in(pieces, inset_m))).collect();
        sheets.set_sensing_by(|point| sheet_s * share(point) * map.at(point), &blocking);
        sheets.set_joints(|edge, middle| {
            let cut = slits.cut_of_edge[edge];
            let ([from, to], pieces) = (slits.ends_m[cut], &cuts[cut]);
            let along = [to[0] - from[0], to[1] - from[1]];
            let place = ((middle[0] - from[0]) * along[0] + (middle[1] - from[1]) * along[1])
                / (along[0] * along[0] + along[1] * along[1]);
            let piece = &pieces[((place * pieces.len() as f64) as usize).min(pieces.len() - 1)];
            sheet_s * share(middle) * map.at(middle) * piece.joining_per_m()
        });
    }

    /// The sheet with these cuts and wear, if its fields can be solved with no load.
    fn tried(&self, wear: &Wear, fixed: &[Cut]) -> Result<SlitSheets, TwinError> {
        let cuts: Vec<Vec<Cut>> = wear.cuts().chain(fixed.iter().map(|cut| vec![*cut])).collect();
        let mut slit = SlitSheets::build(self, cuts.iter().map(|pieces| whole(pieces)).collect())?;
        self.conduct(&mut slit.sheets, wear, &cuts, &slit.slits);
        let apart = vec![0.0; slit.sheets.positions_m().len()];
        slit.sheets.impedance(&apart)?;
        Ok(slit)
    }
}

/// The skin, meshed with slits along as many cuts as possible.
struct SlitSheets {
    body: ElectrodedMesh,
    sheets: TwoSheets,
    slits: Slits,
}

impl SlitSheets {
    fn build(plan: &Plan, ends_m: Vec<[Point; 2]>) -> Result<Self, TwinError> {
        let (slit, is_slit) = plan.spec.build_slit(&plan.contact_impedances, &ends_m)?;
        let slit_cuts = is_slit.iter().enumerate().filter(|(_, is_slit)| **is_slit).map(|(cut, _)| cut);
        let cut_of_edge = slit_cuts.zip(&slit.slits).flat_map(|(cut, edges)| edges.iter().map(move |_| cut)).collect();
        let sheets = TwoSheets::with_slits(&slit.mesh, &slit.slits.concat(), plan.sheet_s, plan.shortcut)?;
        Ok(Self { body: slit.mesh, sheets, slits: Slits { ends_m, is_slit, cut_of_edge } })
    }
}

/// Treatments tried on a copy of the sheet.
struct Tried {
    /// Treatments that the sheet accepts.
    done: Vec<Treatment>,
    refused: Vec<TwinError>,
    /// The resulting sheet; `None` if its cuts have not changed.
    sheet: Option<SlitSheets>,
}

impl Tried {
    /// Tries all treatments at once, or one by one if that fails.
    fn of(treatments: &[Treatment], plan: &Plan, wear: &Wear, fixed: &[Cut], stop: &AtomicBool) -> Self {
        let outline = plan.spec.outline.clone();
        let treat = |wear: &mut Wear, treatment: &Treatment| {
            if let Treatment::Cut(cut) = treatment {
                cut.check_reach(&outline)?;
            }
            wear.treat(treatment)
        };
        let (mut all, mut done, mut refused) = (wear.clone(), Vec::new(), Vec::new());
        for treatment in treatments {
            match treat(&mut all, treatment) {
                Ok(()) => done.push(*treatment),
                Err(error) => refused.push(error),
            }
        }
        if same_cuts(&all, wear) {
            return Self { done, refused, sheet: None };
        }
        if let Ok(sheet) = plan.tried(&all, fixed) {
            return Self { done, refused, sheet: Some(sheet) };
        }
        let (mut kept, mut sheet) = (wear.clone(), None);
        done.retain(|treatment| {
            if stop.load(Ordering::Relaxed) {
                return false;
            }
            let mut next = kept.clone();
            let tried = treat(&mut next, treatment)
                .and_then(|()| if same_cuts(&next, &kept) { Ok(None) } else { plan.tried(&next, fixed).map(Some) });
            match tried {
                Ok(slit) => {
                    (kept, sheet) = (next, slit.or(sheet.take()));
                    true
                }
                Err(error) => {
                    refused.push(error);
                    false
                }
            }
        });
        Self { done, refused, sheet }
    }
}

fn same_cuts(a: &Wear, b: &Wear) -> bool {
    let ends = |wear: &Wear| wear.wounds().map(|wound| [wound.cut.from_m, wound.cut.to_m]).collect::<Vec<_>>();
    ends(a) == ends(b)
}

/// Both ends of a cut in pieces.
fn whole(pieces: &[Cut]) -> [[f64; 2]; 2] {
    [pieces[0].from_m, pieces[pieces.len() - 1].to_m]
}

/// A cut in pieces, shortened by this length at both ends ([`Cut::shortened`]).
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

/// The same cut with neighbouring pieces of equal conductance merged, since every element looks at every piece.
fn joined(pieces: Vec<Cut>) -> Vec<Cut> {
    let mut joined: Vec<Cut> = Vec::with_capacity(pieces.len());
    for piece in pieces {
        match joined.last_mut().filter(|last| last.residual == piece.residual) {
            Some(last) => last.to_m = piece.to_m,
            None => joined.push(piece),
        }
    }
    joined
}

impl Frontend for Sandwich {
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    fn extent(&self) -> Outline {
        self.spec.outline.clone()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_protocol(&self.protocol)
    }

    fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        let tried = Tried::of(&[*treatment], &self.plan(), &self.wear, &self.cuts, &AtomicBool::new(false));
        self.take_over(tried).pop().map_or(Ok(()), Err)
    }

    fn preparation(&self, treatments: &[Treatment]) -> Option<Preparation> {
        let (plan, wear, fixed) = (self.plan(), self.wear.clone(), self.cuts.clone());
        let treatments = treatments.to_vec();
        Some(Box::new(move |stop| Box::new(Tried::of(&treatments, &plan, &wear, &fixed, stop))))
    }

    fn adopt(&mut self, prepared: Box<dyn Any + Send>) -> Vec<TwinError> {
        prepared.downcast().map_or_else(|_| Vec::new(), |tried: Box<Tried>| self.take_over(*tried))
    }

    fn wounds(&self) -> Vec<Wound> {
        self.wear.wounds().collect()
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.has_healed |= self.wear.advance(dt_s);
        self.waiting_s += dt_s;
        if self.has_healed && self.waiting_s >= RENEWAL_S {
            (self.has_healed, self.waiting_s) = (false, 0.0);
            self.renew_sheet()?;
        }
        if self.gap.press(indenters, self.sheets.positions_m(), dt_s) {
            self.solve()?;
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}
