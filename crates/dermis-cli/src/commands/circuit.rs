//! Prints a readout circuit that was found from frames.

use std::io::Write;

use dermis_live::calibration::{CircuitFit, circuit_words};

/// Prints the circuit found, and whether to trust it.
pub(super) fn print_circuit(fit: &CircuitFit, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "circuits tried: {} on {} frames", fit.tried, fit.frames)?;
    writeln!(out, "score (median correlation of a frame with its best touch) before: {:.3}", fit.score_before)?;
    writeln!(out, "score after: {:.3}; {:.3} nats per reading more likely", fit.score, fit.gain)?;
    writeln!(out, "circuit = {}", circuit_words(fit.circuit.as_ref()))?;
    if let Some(other) = &fit.runner_up {
        writeln!(
            out,
            "best circuit that reads other lines: {:.3}, {:.3} nats per reading less likely, with {}",
            other.score,
            other.behind,
            circuit_words(Some(&other.circuit))
        )?;
    }
    writeln!(out, "{}", fit.trust())
}
