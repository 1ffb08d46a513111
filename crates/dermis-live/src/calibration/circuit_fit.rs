//! What a search for a readout's circuit has come to, in numbers and in words.

use dermis_skin::Circuit;

/// Below this score the model is doubted: another circuit, another order or another layout.
pub const TRUSTED_SCORE: f64 = 0.75;
/// A circuit that reads other lines must be less likely by this, nats a reading. On a measured skin, draws of 20
/// presses tell them apart by 0.07 to 0.11, and choose well.
pub const CLEAR_BY: f64 = 0.03;

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircuitFit {
    /// The best circuit; `None` where an ideal voltmeter explains the frames as well.
    pub circuit: Option<Circuit>,
    /// Its score on all frames.
    pub score: f64,
    /// The score of the skin file's own circuit, or of an ideal voltmeter where it has none.
    pub score_before: f64,
    /// By how much likelier the circuit makes the frames than that one, nats a reading.
    pub gain: f64,
    /// The best circuit that reads other lines: how clear the choice is.
    pub runner_up: Option<RunnerUp>,
    /// Frames that took part.
    pub frames: usize,
    /// Circuits tried.
    pub tried: usize,
}

/// The best circuit that reads other lines than the one chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunnerUp {
    /// The circuit.
    pub circuit: Circuit,
    /// Its score on all frames.
    pub score: f64,
    /// How much less likely it makes the frames, nats a reading.
    pub behind: f64,
}

impl CircuitFit {
    /// Whether the frames look like single touches on the model at all.
    pub fn fits(&self) -> bool {
        self.score >= TRUSTED_SCORE
    }

    /// Whether no circuit that reads other lines fits nearly as well.
    pub fn is_clear(&self) -> bool {
        self.runner_up.is_none_or(|other| other.behind >= CLEAR_BY)
    }

    /// Whether the circuit is to be relied on: it fits, and no other does.
    pub fn is_trusted(&self) -> bool {
        self.fits() && self.is_clear()
    }

    /// Whether it is to be relied on, in words, and why not.
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

/// A circuit as it stands in a skin file, behind `circuit = `.
pub fn circuit_words(circuit: Option<&Circuit>) -> String {
    match circuit {
        Some(Circuit { load, idle, reading: [plus, minus, sink] }) => {
            format!("{{ load = {load}, idle = {idle}, reading = [{plus}, {minus}, {sink}] }}")
        }
        None => "none (an ideal voltmeter)".into(),
    }
}

/// What a search beside the stream has come to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CircuitNews {
    /// What was found.
    pub fit: CircuitFit,
    /// Whether that is another circuit than the one in use so far, and used from this frame on.
    pub is_new: bool,
}

impl CircuitNews {
    /// In words, with the line for the skin file.
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
