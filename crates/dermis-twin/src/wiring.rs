//! Voltages of skins with electrodes, from their transfer impedances.

use dermis_tomo::eit::Protocol;
use faer::MatRef;

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
