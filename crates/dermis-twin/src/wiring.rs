//! Common parts of skins with electrodes: consistency of electrodes, contact impedances and protocol, and voltages
//! from transfer impedances.

use dermis_tomo::eit::Protocol;
use faer::MatRef;

use crate::error::{TwinError, check_positive};

/// Refuses a number of electrodes that differs from the protocol's, and contact impedances that are not one for all
/// or one each, positive and finite. `field` is the name of the contact impedances.
pub(crate) fn check_electrodes(
    electrodes: usize,
    field: &'static str,
    contact_impedances: &[f64],
    protocol: &Protocol,
) -> Result<(), TwinError> {
    if electrodes != protocol.electrode_count() {
        let expected = format!("{}, as the protocol has", protocol.electrode_count());
        return Err(TwinError::Count { field: "electrodes", got: electrodes, expected });
    }
    if ![1, electrodes].contains(&contact_impedances.len()) {
        let expected = format!("1 for all electrodes, or {electrodes}: one for each");
        return Err(TwinError::Count { field, got: contact_impedances.len(), expected });
    }
    contact_impedances.iter().try_for_each(|&value| check_positive(field, value))
}

/// Voltages of the protocol's channels by superposition of the electrodes' unit currents. `impedance` holds the
/// potential of the row's electrode for 1 A into the column's electrode, ohm.
pub(crate) fn superpose(protocol: &Protocol, impedance: MatRef<'_, f64>, voltages_v: &mut [f64]) {
    for (voltage, channel) in voltages_v.iter_mut().zip(protocol.measurements()) {
        let stimulation = &protocol.stimulations()[channel.stimulation as usize];
        let pattern = &protocol.patterns()[channel.pattern as usize];
        *voltage = 0.0;
        for &(electrode, weight) in pattern.entries() {
            for &(driven, current) in stimulation.entries() {
                *voltage += weight * current * impedance[(electrode as usize, driven as usize)];
            }
        }
    }
}
