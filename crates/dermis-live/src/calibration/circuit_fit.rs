//! Result of a search for a readout's circuit, in numbers and in words.

use dermis_skin::Circuit;

/// Below this score the model is doubtful: another circuit, channel order or layout.
pub const TRUSTED_SCORE: f64 = 0.75;
/// Minimum margin by which a circuit that reads other lines must be less likely, nats per reading. On a measured
/// skin, draws of 20 presses separate them by 0.07 to 0.11, and choose well.
pub const CLEAR_BY: f64 = 0.03;

/// Result of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircuitFit {
    /// The best circuit; `None` if an ideal voltmeter explains the frames as well.
    pub circuit: Option<Circuit>,
    /// Its score on all frames.
    pub score: f64,
    /// The score of the skin file's own circuit, or of an ideal voltmeter if it has none.
    pub score_before: f64,
    /// Log-likelihood gain over the circuit of `score_before`, nats per reading.
    pub gain: f64,
    /// The best circuit that reads other lines, which shows how clear the choice is.
    pub runner_up: Option<RunnerUp>,
    /// Number of frames used.
    pub frames: usize,
    /// Number of circuits tried.
    pub tried: usize,
}

/// The best circuit that reads other lines than the one chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunnerUp {
    /// The circuit.
    pub circuit: Circuit,
    /// Its score on all frames.
    pub score: f64,
    /// Log-likelihood deficit, nats per reading.
    pub behind: f64,
}

impl CircuitFit {
    /// True if the frames look like single touches on the model.
    pub fn fits(&self) -> bool {
        self.score >= TRUSTED_SCORE
    }

    /// True if no circuit that reads other lines fits nearly as well.
    pub fn is_clear(&self) -> bool {
        self.runner_up.is_none_or(|other| other.behind >= CLEAR_BY)
    }

    /// True if the circuit is reliable: it fits, and no other fits nearly as well.
    pub fn is_trusted(&self) -> bool {
        self.fits() && self.is_clear()
    }

    /// Statement on the circuit's reliability, with the reason.
    pub fn trust(&self) -> String {
        if self.is_trusted() {
            "trusted: yes; a turn or mirror of the layout that leaves the skin alike cannot be told from frames".into()
        } else if self.fits() {
            "trusted: no, a circuit that reads other lines fits nearly as well; more presses, all over the skin, tell"
                .into()
        } else {
            format!("trusted: no, a score below {TRUSTED_SCORE} means another circuit, order or layout than any tried")
        }
    }
}

/// A circuit as written in a skin file after `circuit = `.
pub fn circuit_words(circuit: Option<&Circuit>) -> String {
    match circuit {
        Some(Circuit { load, idle, reading: [plus, minus, sink] }) => {
            format!("{{ load = {load}, idle = {idle}, reading = [{plus}, {minus}, {sink}] }}")
        }
        None => "none (an ideal voltmeter)".into(),
    }
}

/// Result of a background search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircuitNews {
    /// The result of the search.
    pub fit: CircuitFit,
    /// True if it is a different circuit from the current one, and used from this frame on.
    pub is_new: bool,
}

impl CircuitNews {
    /// Description in words, with the line for the skin file.
    pub fn describe(&self) -> String {
        let Self { fit: CircuitFit { score, score_before, frames, circuit, .. }, is_new } = self;
        if !is_new {
            return format!(
                "{frames} presses: no better circuit than the one in use, whose score is {score_before:.3}"
            );
        }
        let words = circuit_words(circuit.as_ref());
        format!(
            "circuit found from {frames} presses and in use from now on: score {score:.3}, before {score_before:.3}; \
             `circuit = {words}` for the skin file; {}",
            self.fit.trust()
        )
    }
}
