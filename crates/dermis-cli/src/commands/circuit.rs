//! What is printed of a readout's circuit that was found from frames.

use std::io::Write;

use dermis::live::calibration::{CircuitFit, TRUSTED_SCORE};
use dermis::skin::Circuit;

/// What was found of a readout's circuit, and whether to believe it.
pub(super) fn print_circuit(fit: &CircuitFit, out: &mut dyn Write) -> std::io::Result<()> {
    let described = |circuit: Option<&Circuit>| match circuit {
        Some(Circuit { load, idle, reading: [plus, minus, sink] }) => {
            format!("{{ load = {load}, idle = {idle}, reading = [{plus}, {minus}, {sink}] }}")
        }
        None => "none (an ideal voltmeter)".into(),
    };
    writeln!(out, "circuits tried: {} on {} frames", fit.tried, fit.frames)?;
    writeln!(out, "score (median correlation of a frame with its best touch) before: {:.3}", fit.score_before)?;
    writeln!(out, "score after: {:.3}", fit.score)?;
    writeln!(out, "circuit = {}", described(fit.circuit.as_ref()))?;
    if let Some((circuit, score)) = &fit.runner_up {
        writeln!(out, "the best that reads other lines: {:.3} with {}", score, described(Some(circuit)))?;
    }
    if fit.is_trusted() {
        writeln!(
            out,
            "trusted: yes; a turn or mirror of the layout that leaves the skin alike cannot be told from frames"
        )
    } else if fit.fits() {
        writeln!(
            out,
            "trusted: no, a circuit that reads other lines fits nearly as well; more presses, all over the skin, tell"
        )
    } else {
        writeln!(
            out,
            "trusted: no, a score below {TRUSTED_SCORE} means another circuit, order or layout than any that was tried"
        )
    }
}
