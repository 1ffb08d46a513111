//! The gap of skins whose layers touch under pressure: the load, its memory, and the resulting contact.

use dermis_tomo::mesh::Point;

use crate::error::TwinError;
use crate::mechanics::{ContactLaw, Cover, Indenter, Memory, PressureState};

/// Contact conductance at a set of places, and the contact of the last solution.
#[derive(Clone, Debug)]
pub(crate) struct Gap {
    cover: Cover,
    contact: ContactLaw,
    memory: Option<Memory>,
    state: PressureState,
    pressure_pa: Vec<f64>,
    contact_s_per_m2: Vec<f64>,
    solved_s_per_m2: Vec<f64>,
    solved: bool,
}

impl Gap {
    /// An open gap with `places` places.
    ///
    /// # Errors
    /// Invalid parameters.
    pub fn new(cover: Cover, contact: ContactLaw, memory: Option<Memory>, places: usize) -> Result<Self, TwinError> {
        cover.check()?;
        contact.check()?;
        memory.as_ref().map_or(Ok(()), Memory::check)?;
        let (state, none) = (PressureState::new(memory, 0), Vec::new());
        let (pressure_pa, contact_s_per_m2, solved_s_per_m2) = (none.clone(), none.clone(), none);
        let mut gap =
            Self { cover, contact, memory, state, pressure_pa, contact_s_per_m2, solved_s_per_m2, solved: false };
        gap.reset(places);
        Ok(gap)
    }

    /// Opens the gap and forgets past loads, for `places` places.
    pub fn reset(&mut self, places: usize) {
        self.state = PressureState::new(self.memory, places);
        for values in [&mut self.pressure_pa, &mut self.contact_s_per_m2, &mut self.solved_s_per_m2] {
            values.clear();
            values.resize(places, 0.0);
        }
        self.solved = false;
    }

    /// Replaces the contact law.
    ///
    /// # Errors
    /// As [`ContactLaw::check`].
    pub fn set_contact(&mut self, contact: ContactLaw) -> Result<(), TwinError> {
        contact.check()?;
        (self.contact, self.solved) = (contact, false);
        Ok(())
    }

    /// Presses at these places for `dt_s`; returns true if the fields must be solved again.
    pub fn press(&mut self, indenters: &[Indenter], places_m: &[Point], dt_s: f64) -> bool {
        self.pressure_pa.fill(0.0);
        for indenter in indenters {
            indenter.add_pressure(self.cover, places_m, &mut self.pressure_pa);
        }
        self.state.apply(dt_s, &mut self.pressure_pa);
        for (g, pressure) in self.contact_s_per_m2.iter_mut().zip(&self.pressure_pa) {
            *g = self.contact.conductance_s_per_m2(*pressure);
        }
        // A skin that is idle or held still costs nothing.
        !self.solved || self.contact_s_per_m2 != self.solved_s_per_m2
    }

    /// The contact at each place, S/m^2.
    pub fn contact_s_per_m2(&self) -> &[f64] {
        &self.contact_s_per_m2
    }

    /// Records that the fields belong to the current contact.
    pub fn mark_solved(&mut self) {
        self.solved_s_per_m2.copy_from_slice(&self.contact_s_per_m2);
        self.solved = true;
    }

    /// Records that the fields belong to another sheet.
    pub fn mark_stale(&mut self) {
        self.solved = false;
    }
}
