//! The sheet that contacts are fitted on and the one that they are looked for on, slit where the skin is cut. New ones
//! take the better part of a second and are worked out beside the stream ([`crate::beside`]).

use std::sync::Arc;

use dermis_tomo::eit::contacts::{ContactPatch, ContactSheet, PatchSearch};
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{SlitEdge, SlitMesh};

use crate::Error;
use crate::beside::{Beside, Wanted};
use crate::prepare::Prepared;
use dermis_skin::Skin;

/// Elements of the mesh that contacts are fitted on, about 2.5 mm on a skin of 100 mm, and of the one that they are
/// looked for on, where a fit takes a fifth of the time and sizes are a tenth off.
const ELEMENTS: usize = 4000;
const COARSE_ELEMENTS: usize = 2000;
/// Edges of patches are blurred over so many of the finer elements: 7 mm on a skin of 100 mm. Of widths from 3 to 7 mm
/// this one placed and sized indenters of 20 and 25 mm best on the twin.
const EDGE: f64 = 4.25;
/// Places that are searched, along the shorter side.
const PLACES: usize = 10;
/// What is left of the conductance of an element that a cut crosses which no slit can follow: it blocks the current,
/// and no matrix becomes singular.
const LEFT_BY_A_CUT: f64 = 1e-4;
/// Sheets that are ordered take effect so much later, nanoseconds: several times what they take on one slow core.
const READY_NS: u64 = 3_000_000_000;

/// Both ends, metres.
type Ends = [[f64; 2]; 2];

/// A sheet's mesh with its slits, and of each cut whether it is one of them.
type Meshed = (SlitMesh, Vec<bool>);

/// A cut that a sheet has, or the scar of one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SheetCut {
    pub ends_m: Ends,
    /// Conductance across it per length, over the sheet's conductance: 0 where it is open. 1/m.
    pub joined_per_m: f64,
}

/// The sheets with their cuts, ready for contacts.
#[derive(Debug)]
pub(super) struct Sheets {
    pub fine: ContactSheet,
    pub coarse: ContactSheet,
    pub search: PatchSearch,
}

/// What sheets are made of.
#[derive(Debug)]
struct Bare {
    skin: Skin,
    protocol: Protocol,
    edge_m: f64,
    typical: ContactPatch,
    places: Vec<[f64; 2]>,
}

impl Bare {
    /// With these cuts; `None` where they are wanted no longer.
    fn with(&self, cuts: &[SheetCut], wanted: &Wanted) -> Option<Result<Sheets, Error>> {
        let lines: Vec<Ends> = cuts.iter().map(|cut| cut.ends_m).collect();
        let mesh = |elements: usize| self.skin.slit_mesh(elements, &lines).map_err(Error::from);
        let meshed = mesh(ELEMENTS).and_then(|fine| Ok((fine, mesh(COARSE_ELEMENTS)?)));
        meshed.map_or_else(|error| Some(Err(error)), |(fine, coarse)| self.on(fine, coarse, cuts, wanted).transpose())
    }

    /// On these meshes with the cuts, which say of each whether it is slit; `None` where they are wanted no longer.
    fn on(&self, fine: Meshed, coarse: Meshed, cuts: &[SheetCut], wanted: &Wanted) -> Result<Option<Sheets>, Error> {
        let coarse = self.sheet(coarse, cuts)?;
        let Some(()) = wanted.go_on() else { return Ok(None) };
        let search = PatchSearch::new(&coarse, self.typical, &self.places)?;
        let Some(()) = wanted.go_on() else { return Ok(None) };
        Ok(Some(Sheets { fine: self.sheet(fine, cuts)?, coarse, search }))
    }

    fn sheet(&self, meshed: Meshed, cuts: &[SheetCut]) -> Result<ContactSheet, Error> {
        let (SlitMesh { mesh, slits }, is_slit) = meshed;
        let rest_s = self.skin.sheet_conductance_s();
        let slit_cuts = cuts.iter().zip(&is_slit).filter(|(_, is_slit)| **is_slit).map(|(cut, _)| cut);
        let joints: Vec<(SlitEdge, f64)> = slit_cuts
            .zip(&slits)
            .filter(|(cut, _)| cut.joined_per_m > 0.0)
            .flat_map(|(cut, edges)| edges.iter().map(|edge| (*edge, rest_s * cut.joined_per_m)))
            .collect();
        let model = ForwardModel::with_joints(mesh, self.protocol.clone(), &joints)?;
        let mesh = &model.body().mesh;
        let corner = |node: u32| [mesh.nodes()[node as usize][0], mesh.nodes()[node as usize][1]];
        // Blocked whole, a cut is longer by about half an element at each end.
        // A scar that nothing can follow is left out.
        let blocking = cuts.iter().zip(&is_slit).filter(|(cut, is_slit)| !**is_slit && cut.joined_per_m == 0.0);
        let blocking: Vec<Ends> = blocking.map(|(cut, _)| shortened(cut.ends_m, 0.5 * mesh.element_size_m())).collect();
        let conductance: Vec<f64> = mesh
            .elements()
            .map(|cell| {
                let corners = [corner(cell[0]), corner(cell[1]), corner(cell[2])];
                let blocked = blocking.iter().any(|cut| crosses(corners, *cut));
                rest_s * if blocked { LEFT_BY_A_CUT } else { 1.0 }
            })
            .collect();
        Ok(ContactSheet::new(&model, &conductance, self.edge_m)?)
    }
}

/// The sheets in use, and those to come.
#[derive(Debug)]
pub(super) struct CutSheets {
    bare: Arc<Bare>,
    /// The cuts of the sheets that were ordered last.
    cuts: Vec<SheetCut>,
    pub now: Sheets,
    coming: Beside<Result<Sheets, Error>>,
}

impl CutSheets {
    /// Without cuts, for touches of a typical kind.
    pub fn new(prepared: &Prepared, typical: ContactPatch) -> Result<Self, Error> {
        let (low, high) = prepared.body.outline.bounds_m();
        let step = (high[0] - low[0]).min(high[1] - low[1]) / PLACES as f64;
        let count = |axis: usize| ((high[axis] - low[axis]) / step).round() as usize;
        let at = |axis: usize, k: usize| low[axis] + (k as f64 + 0.5) * (high[axis] - low[axis]) / count(axis) as f64;
        let inside = prepared.map.inside_mask();
        let places: Vec<[f64; 2]> = (0..count(1))
            .flat_map(|row| (0..count(0)).map(move |column| (row, column)))
            .map(|(row, column)| [at(0, column), at(1, row)])
            .filter(|place| prepared.map.grid().pixel_at(*place).is_some_and(|pixel| inside[pixel]))
            .collect();
        let (skin, protocol) = (prepared.skin.clone(), prepared.protocol.clone());
        let mesh = |elements: usize| skin.slit_mesh(elements, &[]);
        let (fine, coarse) = rayon::join(|| mesh(ELEMENTS), || mesh(COARSE_ELEMENTS));
        let (fine, coarse) = (fine?, coarse?);
        let edge_m = EDGE * fine.0.mesh.mesh.element_size_m();
        let bare = Arc::new(Bare { skin, protocol, edge_m, typical, places });
        let searched = || -> Result<_, Error> {
            let coarse = bare.sheet(coarse, &[])?;
            Ok((PatchSearch::new(&coarse, typical, &bare.places)?, coarse))
        };
        let (fine, searched) = rayon::join(|| bare.sheet(fine, &[]), searched);
        let (search, coarse) = searched?;
        let now = Sheets { fine: fine?, coarse, search };
        Ok(Self { bare, cuts: Vec::new(), now, coming: Beside::new() })
    }

    /// Orders sheets with these cuts, in place of any that were ordered before. Does nothing where the last ones have
    /// them.
    pub fn order(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        if self.cuts == cuts {
            return;
        }
        self.cuts = cuts.to_vec();
        let (bare, cuts) = (self.bare.clone(), cuts.to_vec());
        self.coming.begin(time_ns.saturating_add(READY_NS), move |wanted| bare.with(&cuts, wanted));
    }

    /// Frames that have waited for sheets.
    pub fn waits(&self) -> u64 {
        self.coming.waits()
    }

    /// Takes up what was ordered, if its time has come; true where it was. Waits for it if need be.
    pub fn take_up(&mut self, time_ns: u64) -> Result<bool, Error> {
        let Some(sheets) = self.coming.take(time_ns) else { return Ok(false) };
        self.now = sheets?;
        Ok(true)
    }
}

/// A segment without so much at either end; its middle where little is left.
fn shortened([a, b]: Ends, by_m: f64) -> Ends {
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    let share = (by_m / length.max(f64::MIN_POSITIVE)).min(0.499);
    let at = |share: f64| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    [at(share), at(1.0 - share)]
}

/// Whether a segment meets a triangle.
fn crosses(corners: [[f64; 2]; 3], [a, b]: Ends) -> bool {
    let side = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let meets = |p: [f64; 2], q: [f64; 2]| side(p, q, a) * side(p, q, b) <= 0.0 && side(a, b, p) * side(a, b, q) <= 0.0;
    let edges = [(0, 1), (1, 2), (2, 0)];
    let inside = edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) >= 0.0)
        || edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) <= 0.0);
    inside || edges.iter().any(|&(i, j)| meets(corners[i], corners[j]))
}
