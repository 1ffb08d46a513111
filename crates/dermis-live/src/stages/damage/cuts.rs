//! Cuts known from a fit: their effect on the channels and the image, how far they have healed, and the scars they
//! leave.

use dermis_touch::damage::{Damage, DamageShape, DamageState};

use super::crack::{Crack, CrackModel, CrackScratch};
use super::fit::estimate_cut;
use super::healing::{Healing, HealingMonitor};
use crate::Error;
use crate::prepare::Prepared;
use crate::stages::plates::SheetCut;

/// Minimum share of the data's energy that a fit must explain. Otherwise the damage is not a cut.
const LEAST_EXPLAINED: f64 = 0.7;

/// Fitted cuts, and scars.
#[derive(Debug)]
pub(super) struct KnownCuts {
    /// Effect of cuts, if the skin is a sheet read by electrodes.
    model: Option<CrackModel>,
    scratch: CrackScratch,
    /// Fitted cuts by the identity of their damage.
    fitted: Vec<(u64, Crack)>,
    /// Scars of healed cuts in the sheet, joined as they were when they became part of the intact reference.
    scars: Vec<SheetCut>,
    healing: HealingMonitor,
    /// Joining of a healed scar, 1/m.
    healed_per_m: f64,
    /// Effect of the fitted cuts on the channels and on the image, as far as they are open; stale after any has
    /// changed.
    response: Vec<f64>,
    present: Vec<f64>,
    image: Vec<f32>,
    is_stale: bool,
}

impl KnownCuts {
    pub fn new(prepared: &Prepared) -> Result<Self, Error> {
        let channels = prepared.channels();
        Ok(Self {
            model: CrackModel::applies_to(prepared).then(|| CrackModel::new(prepared)).transpose()?,
            scratch: CrackScratch::default(),
            fitted: Vec::new(),
            scars: Vec::new(),
            healing: HealingMonitor::default(),
            healed_per_m: 1e3 / prepared.skin.damage.healed_scar_mm,
            response: vec![0.0; channels],
            present: Vec::new(),
            image: vec![0.0; prepared.map.grid().len()],
            is_stale: false,
        })
    }

    /// Effect of cuts on this skin, if known.
    pub fn model(&self) -> Option<&CrackModel> {
        self.model.as_ref()
    }

    /// Response of all fitted cuts together, each as far as it is still open, model volts.
    pub fn response(&self) -> &[f64] {
        &self.response
    }

    /// Image of the response, if there is any cut.
    pub fn image(&self) -> Option<&[f32]> {
        (!self.fitted.is_empty()).then_some(&self.image)
    }

    /// Healing of the fitted cuts.
    pub fn healing(&self) -> &[Healing] {
        self.healing.states()
    }

    /// The largest sum of squares of an open cut's response; `None` if no healing is followed.
    pub fn open_square(&self) -> Option<f64> {
        (!self.healing.states().is_empty()).then(|| self.healing.open_square())
    }

    /// Call this when another operator makes the images.
    pub fn invalidate_image(&mut self) {
        self.is_stale = true;
    }

    /// Updates the response. Returns the data to image, without the channels missing in `difference`, and the image
    /// to write. `None` if the image is still up to date.
    pub fn update_response(&mut self, difference: &[f64]) -> Option<(&[f64], &mut [f32])> {
        if !std::mem::take(&mut self.is_stale) {
            return None;
        }
        let model = self.model.as_ref()?;
        add_responses(model, &self.fitted, &self.healing, &mut self.scratch, &mut self.response);
        self.present.clear();
        let present = self.response.iter().zip(difference);
        self.present.extend(present.map(|(known, d)| if d.is_nan() { f64::NAN } else { *known }));
        Some((&self.present, &mut self.image))
    }

    /// True if the cut of another damage site is known.
    pub fn knows_others(&self, damage: u64) -> bool {
        self.fitted.iter().any(|(id, _)| *id != damage)
    }

    /// Fits a cut to new damage. If `with_others`, `change` (model volts) includes the modelled effect of all other
    /// cuts. Returns the shape found.
    pub fn fit(
        &mut self,
        damage: &Damage,
        mut change: Vec<f64>,
        with_others: bool,
        noise: &[f64],
        prepared: &Prepared,
    ) -> Result<Option<DamageShape>, Error> {
        let Some(model) = &self.model else { return Ok(None) };
        self.fitted.retain(|(id, _)| *id != damage.id);
        self.is_stale = true;
        if with_others {
            add_responses(model, &self.fitted, &self.healing, &mut self.scratch, &mut self.response);
            change.iter_mut().zip(&self.response).for_each(|(sum, known)| *sum -= known);
        }
        let estimate = estimate_cut(prepared, model, &change, noise, &damage.shape)?;
        let Some(estimate) = estimate.filter(|estimate| estimate.explained >= LEAST_EXPLAINED) else {
            return Ok(None);
        };
        self.fitted.push((damage.id, estimate.crack));
        self.healing.follow(damage.id, &estimate.crack, model, prepared);
        Ok(Some(estimate.shape()))
    }

    /// Estimates how far the cuts have healed from a change against the intact skin, model volts.
    pub fn estimate_healing(&mut self, time_ns: u64, change: &[f64], noise: &[f64], rest: &[f64]) {
        self.healing.estimate(time_ns, change, noise, rest, self.healed_per_m);
        self.is_stale = true;
    }

    /// With a new intact reference, healed cuts leave the record and stay in the sheet as scars.
    pub fn keep_scars(&mut self, damages: &[Damage]) {
        for damage in damages.iter().filter(|damage| damage.state == DamageState::Healed) {
            let is_fitted = self.fitted.iter().any(|(id, _)| *id == damage.id);
            let state = self.healing.states().iter().find(|state| state.id == damage.id && is_fitted);
            self.scars.extend(state.map(|state| SheetCut {
                ends_m: damage.shape.ends_m(),
                joined_per_m: state.joined * self.healed_per_m,
            }));
        }
    }

    /// Forgets the cuts of all other damage sites.
    pub fn retain(&mut self, damages: &[Damage]) {
        let stands = |id: u64| damages.iter().any(|damage| damage.id == id);
        self.fitted.retain(|(id, _)| stands(*id));
        self.healing.retain(stands);
        self.is_stale = true;
    }

    /// The cuts and scars that the baseline of touches includes.
    pub fn in_sheet(&self, damages: &[Damage]) -> Vec<SheetCut> {
        let open = damages.iter().filter(|damage| damage.is_open() && damage.shape.length_m > 0.0);
        let open = open.map(|damage| SheetCut { ends_m: damage.shape.ends_m(), joined_per_m: 0.0 });
        open.chain(self.scars.iter().copied()).collect()
    }
}

/// Response of all fitted cuts together, each as far as it is still open.
fn add_responses(
    model: &CrackModel,
    fitted: &[(u64, Crack)],
    healing: &HealingMonitor,
    scratch: &mut CrackScratch,
    known: &mut [f64],
) {
    known.fill(0.0);
    let mut response = vec![0.0; known.len()];
    for (id, crack) in fitted {
        let left = healing.states().iter().find(|state| state.id == *id).map_or(1.0, |state| state.left);
        if model.respond(crack, scratch, &mut response) {
            known.iter_mut().zip(&response).for_each(|(sum, change)| *sum += left * change);
        }
    }
}
