//! A skin behind a readout circuit that loads it and reads a mixture of lines ([`dermis_tomo::eit::ReadoutCircuit`]).
//!
//! The skin is solved for the transfer impedances between its electrodes: one ampere into each electrode and out of
//! the last, with all potentials relative to the last. The circuit's readings follow from these alone.

use std::any::Any;

use dermis_tomo::eit::{Pattern, Protocol, ReadoutCircuit};
use dermis_tomo::mesh::Outline;
use faer::Mat;

use crate::error::TwinError;
use crate::healing::{Treatment, Wound};
use crate::instrument::Instrument;
use crate::mechanics::Indenter;
use crate::twin::{Frontend, Preparation};

/// A protocol whose voltages are the transfer impedances of a skin, row by row.
///
/// # Errors
/// Fewer than two electrodes.
pub(crate) fn impedance_protocol(electrodes: usize) -> Result<Protocol, TwinError> {
    let last = electrodes.saturating_sub(1) as u32;
    let against_last = |electrode: u32| Pattern::pair(electrode, last, 1.0);
    let stimulations = (0..last).map(against_last).collect();
    let channels =
        (0..last).flat_map(|drive| (0..last).map(move |read| (against_last(read), drive as usize))).collect();
    Ok(Protocol::from_patterns(electrodes, stimulations, channels)?)
}

/// A skin built with [`impedance_protocol`], read through a circuit.
#[derive(Debug)]
pub(crate) struct BehindCircuit {
    skin: Box<dyn Frontend>,
    circuit: ReadoutCircuit,
    protocol: Protocol,
    /// Reference of the circuit's relative admittances, siemens.
    sheet_s: f64,
    impedances: Vec<f64>,
    /// The impedances to which `voltages_v` belongs; empty at first.
    solved: Vec<f64>,
    voltages_v: Vec<f64>,
}

impl BehindCircuit {
    pub fn new(skin: Box<dyn Frontend>, circuit: ReadoutCircuit, protocol: Protocol, sheet_s: f64) -> Self {
        Self {
            impedances: vec![0.0; skin.channel_count()],
            solved: Vec::new(),
            voltages_v: vec![0.0; protocol.channel_count()],
            skin,
            circuit,
            protocol,
            sheet_s,
        }
    }
}

impl Frontend for BehindCircuit {
    fn channel_count(&self) -> usize {
        self.protocol.channel_count()
    }

    fn extent(&self) -> Outline {
        self.skin.extent()
    }

    fn check_indenter(&self, indenter: &Indenter) -> Result<(), TwinError> {
        self.skin.check_indenter(indenter)
    }

    fn outside_validity(&self) -> Option<String> {
        self.skin.outside_validity()
    }

    fn treat(&mut self, treatment: &Treatment) -> Result<(), TwinError> {
        self.skin.treat(treatment)
    }

    fn preparation(&self, treatments: &[Treatment]) -> Option<Preparation> {
        self.skin.preparation(treatments)
    }

    fn adopt(&mut self, prepared: Box<dyn Any + Send>) -> Vec<TwinError> {
        self.skin.adopt(prepared)
    }

    fn wounds(&self) -> Vec<Wound> {
        self.skin.wounds()
    }

    fn wired(&self, instrument: Instrument) -> Result<Instrument, TwinError> {
        instrument.with_protocol(&self.protocol)
    }

    fn voltages(&mut self, indenters: &[Indenter], dt_s: f64, voltages_v: &mut [f64]) -> Result<(), TwinError> {
        self.skin.voltages(indenters, dt_s, &mut self.impedances)?;
        // A skin that is idle or held still costs nothing.
        if self.impedances != self.solved {
            let last = self.protocol.electrode_count() - 1;
            let impedance = Mat::from_fn(last + 1, last + 1, |row, column| {
                if row < last && column < last { self.impedances[column * last + row] } else { 0.0 }
            });
            self.voltages_v = self.circuit.voltages(&self.protocol, impedance.as_ref(), self.sheet_s)?;
            self.solved.clone_from(&self.impedances);
        }
        voltages_v.copy_from_slice(&self.voltages_v);
        Ok(())
    }
}
