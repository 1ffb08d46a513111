//! The sheets for fitting contacts and for searching them, slit where the skin is cut. New ones take up to a second
//! and are computed in the background ([`crate::beside`]).

use std::sync::Arc;

use dermis_tomo::eit::contacts::{ContactPatch, ContactSheet, PatchSearch};
use dermis_tomo::eit::{ForwardModel, Protocol};
use dermis_tomo::mesh::{SlitEdge, SlitMesh};

use crate::Error;
use crate::beside::{Beside, Wanted};
use crate::prepare::Prepared;
use dermis_skin::Skin;

/// Number of elements of the mesh for fits, about 2.5 mm on a skin of 100 mm, and of the mesh for searches, on which
/// a fit takes a fifth of the time and sizes are 10 % off.
const ELEMENTS: usize = 4000;
const COARSE_ELEMENTS: usize = 2000;
/// Width over which the edges of patches are blurred, in elements of the finer mesh: 7 mm on a skin of 100 mm. Of
/// widths from 3 to 7 mm, this one gave the best positions and sizes for indenters of 20 and 25 mm on the twin.
const EDGE: f64 = 4.25;
/// Number of positions searched along the shorter side.
const PLACES: usize = 10;
/// Share of the conductance left in an element that is crossed by a cut which no slit can follow. It blocks the
/// current but keeps the matrices regular.
const LEFT_BY_A_CUT: f64 = 1e-4;
/// Delay after which ordered sheets take effect, nanoseconds: several times the time to compute them on one slow
/// core.
const READY_NS: u64 = 3_000_000_000;

/// Both ends of a segment, metres.
type Ends = [[f64; 2]; 2];

/// A sheet's mesh with its slits, and for each cut whether it is one of them.
type Meshed = (SlitMesh, Vec<bool>);

/// A cut in a sheet, or its scar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SheetCut {
    pub ends_m: Ends,
    /// Conductance across the cut per length, over the sheet's conductance, 1/m; 0 if it is open.
    pub joined_per_m: f64,
}

/// The sheets with their cuts, ready for fits of contacts.
#[derive(Debug)]
pub(super) struct Sheets {
    pub fine: ContactSheet,
    pub coarse: ContactSheet,
    pub search: PatchSearch,
}

/// The ingredients of sheets, without cuts.
#[derive(Debug)]
struct Bare {
    skin: Skin,
    protocol: Protocol,
    edge_m: f64,
    typical: ContactPatch,
    places: Vec<[f64; 2]>,
}

impl Bare {
    /// The sheets with these cuts; `None` if they are no longer wanted.
    fn with(&self, cuts: &[SheetCut], wanted: &Wanted) -> Option<Result<Sheets, Error>> {
        let lines: Vec<Ends> = cuts.iter().map(|cut| cut.ends_m).collect();
        let mesh = |elements: usize| self.skin.slit_mesh(elements, &lines).map_err(Error::from);
        let meshed = mesh(ELEMENTS).and_then(|fine| Ok((fine, mesh(COARSE_ELEMENTS)?)));
        meshed.map_or_else(|error| Some(Err(error)), |(fine, coarse)| self.on(fine, coarse, cuts, wanted).transpose())
    }

    /// The sheets on these meshes, which tell for each cut whether it is slit; `None` if they are no longer wanted.
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
        // Blocking whole elements makes a cut longer by about half an element at each end. A scar that no slit can
        // follow is left out.
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

/// The sheets in use and the ones in preparation.
#[derive(Debug)]
pub(super) struct CutSheets {
    bare: Arc<Bare>,
    /// The cuts of the sheets ordered last.
    cuts: Vec<SheetCut>,
    pub now: Sheets,
    coming: Beside<Result<Sheets, Error>>,
}

impl CutSheets {
    /// Sheets without cuts, for touches like `typical`.
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

    /// Orders sheets with these cuts, replacing any earlier order. Does nothing if the last ones ordered have the
    /// same cuts.
    pub fn order(&mut self, time_ns: u64, cuts: &[SheetCut]) {
        if self.cuts == cuts {
            return;
        }
        self.cuts = cuts.to_vec();
        let (bare, cuts) = (self.bare.clone(), cuts.to_vec());
        self.coming.begin(time_ns.saturating_add(READY_NS), move |wanted| bare.with(&cuts, wanted));
    }

    /// Number of frames that had to wait for sheets.
    pub fn waits(&self) -> u64 {
        self.coming.waits()
    }

    /// Puts the ordered sheets into use when they are due, waiting for them if necessary. True if it did.
    pub fn take_up(&mut self, time_ns: u64) -> Result<bool, Error> {
        let Some(sheets) = self.coming.take(time_ns) else { return Ok(false) };
        self.now = sheets?;
        Ok(true)
    }
}

/// A segment shortened by this length at each end, or what is left of it around its middle.
fn shortened([a, b]: Ends, by_m: f64) -> Ends {
    let length = (b[0] - a[0]).hypot(b[1] - a[1]);
    let share = (by_m / length.max(f64::MIN_POSITIVE)).min(0.499);
    let at = |share: f64| [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])];
    [at(share), at(1.0 - share)]
}

/// True if a segment meets a triangle.
fn crosses(corners: [[f64; 2]; 3], [a, b]: Ends) -> bool {
    let side = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
    let meets = |p: [f64; 2], q: [f64; 2]| side(p, q, a) * side(p, q, b) <= 0.0 && side(a, b, p) * side(a, b, q) <= 0.0;
    let edges = [(0, 1), (1, 2), (2, 0)];
    let inside = edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) >= 0.0)
        || edges.iter().all(|&(i, j)| side(corners[i], corners[j], a) <= 0.0);
    inside || edges.iter().any(|&(i, j)| meets(corners[i], corners[j]))
}
