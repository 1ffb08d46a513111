//! Finds the readout's circuit of a skin whose file requests it (`backend.circuit = "learn"`) from the presses of the
//! session, in the background.

use dermis_skin::{CircuitChoice, Skin};
use dermis_touch::Baseline;

use crate::Error;
use crate::beside::{Beside, Wanted};
use crate::calibration::{CircuitNews, SelfCalibrated, check_searchable, find_circuit_while};
use crate::prepare::Prepared;
use crate::reference::{MeasuredNoise, Reference};
use crate::stages::press_frames::PressFrames;

/// Number of different presses that starts each search, and the delay until its result counts, nanoseconds of the
/// frames' time: about three times what a search takes on one slow core.
const SEARCHES: [(usize, u64); 3] = [(20, 30_000_000_000), (60, 60_000_000_000), (MOST_PRESSES, 60_000_000_000)];
/// Maximum number of presses collected.
const MOST_PRESSES: usize = 150;
/// Maximum number of channels: with more, a search would take minutes, and frames would wait for it.
const MOST_CHANNELS: usize = 256;
/// Frames weaker than this share of the weak presses show no touch on the self-calibrated skin.
const LEAST_SHARE: f64 = 0.5;

/// Presses, and the current search.
#[derive(Debug)]
pub(crate) struct CircuitStage {
    presses: PressFrames,
    searches: usize,
    is_searching: bool,
    coming: Beside<Result<Found, Error>>,
    news: Option<CircuitNews>,
}

/// Result of a search: the fit, and the skin calibrated with a circuit if one should be used.
#[derive(Debug)]
struct Found {
    news: CircuitNews,
    skin: Option<Box<(Prepared, SelfCalibrated)>>,
}

/// Inputs of a search.
struct Search {
    skin: Skin,
    changes: Vec<Vec<f64>>,
    baseline: Vec<f64>,
    noise_std: Vec<f64>,
    smallest_amplitude: f64,
}

impl Search {
    /// Searches, and calibrates the skin with the result. `None` if the result is no longer wanted.
    fn run(self, wanted: &Wanted) -> Option<Result<Found, Error>> {
        self.result(wanted).transpose()
    }

    fn result(self, wanted: &Wanted) -> Result<Option<Found>, Error> {
        let Self { skin, changes, baseline, noise_std, smallest_amplitude } = self;
        let own = skin.backend.circuit.as_ref().and_then(CircuitChoice::known).copied();
        let mut prepared = Prepared::new(skin)?;
        let go_on = |_| wanted.go_on().is_some();
        let Some(fit) = find_circuit_while(&prepared, &changes, go_on)? else { return Ok(None) };
        // Never return from a circuit found earlier to an ideal voltmeter.
        let in_use = fit.circuit.or(own);
        let news = CircuitNews { fit, is_new: in_use != own };
        let Some(circuit) = in_use else { return Ok(Some(Found { news, skin: None })) };
        if news.is_new {
            let mut skin = prepared.skin.clone();
            skin.backend.circuit = Some(CircuitChoice::Known(circuit));
            prepared = Prepared::new(skin)?;
        }
        // With more presses than before, reweight the channels even for the same circuit.
        let noise = MeasuredNoise::of_start(&noise_std);
        let reference = Reference::from_baseline(&prepared, &baseline, Some(noise))?;
        let calibrated = SelfCalibrated::of_changes(&prepared, reference, &changes, smallest_amplitude)?;
        Ok(Some(Found { news, skin: Some(Box::new((prepared, calibrated))) }))
    }
}

impl CircuitStage {
    /// A stage for a skin that asks for a search of its circuit; `None` for others.
    ///
    /// # Errors
    /// A skin whose circuit cannot be found in the background.
    pub fn new(prepared: &Prepared) -> Result<Option<Self>, Error> {
        let Skin { name, backend, touch, .. } = &prepared.skin;
        if !matches!(backend.circuit, Some(CircuitChoice::ToLearn(_))) {
            return Ok(None);
        }
        check_searchable(prepared)?;
        let expected = match prepared.channels() {
            _ if backend.differences => "readings of the resting skin too, not backend.differences".into(),
            channels if channels > MOST_CHANNELS => format!(
                "at most {MOST_CHANNELS} channels, or the circuit that dermis calibrate --write-skin finds from \
                 recorded touches"
            ),
            _ => {
                let presses = PressFrames::new(touch.hold_sigma, MOST_PRESSES);
                let coming = Beside::new();
                return Ok(Some(Self { presses, searches: 0, is_searching: false, coming, news: None }));
            }
        };
        let what = format!("skin {name}, backend.circuit = \"learn\"");
        Err(Error::Frames { what, expected, got: format!("{} channels", prepared.channels()) })
    }

    /// States whether frames come from an instrument, which doesn't wait for a search.
    pub fn set_live(&mut self, is_live: bool) {
        self.coming.set_live(is_live);
    }

    /// Number of frames that waited for a search.
    pub fn waits(&self) -> u64 {
        self.coming.waits()
    }

    /// Result of a search that was completed with the current frame.
    pub fn news(&self) -> Option<&CircuitNews> {
        self.news.as_ref()
    }

    /// Discards the current press, since the current frame is not reliable.
    pub fn forget(&mut self) {
        self.presses.forget();
    }

    /// Adds the current frame (difference data and their noise in one unit), and starts a search if there are enough
    /// presses.
    pub fn gather(
        &mut self,
        time_ns: u64,
        prepared: &Prepared,
        baseline: &Baseline,
        difference: &[f64],
        noise: &[f64],
    ) {
        self.presses.offer(baseline.compensated(), baseline.baseline(), difference, noise);
        let Some((presses, after_ns)) = SEARCHES.get(self.searches).copied() else { return };
        if self.is_searching || self.presses.len() < presses {
            return;
        }
        let search = Search {
            skin: prepared.skin.clone(),
            changes: self.presses.changes(),
            baseline: baseline.baseline().to_vec(),
            noise_std: baseline.noise_std().to_vec(),
            smallest_amplitude: prepared.skin.touch.hold_sigma.max(LEAST_SHARE * self.presses.weak()),
        };
        (self.searches, self.is_searching) = (self.searches + 1, true);
        self.coming.begin(time_ns.saturating_add(after_ns), move |wanted| search.run(wanted));
    }

    /// Result of a search, in the first frame at or after its due time: the skin calibrated with a circuit, if one
    /// should be used from this frame on.
    pub fn take(&mut self, time_ns: u64) -> Option<(Prepared, SelfCalibrated)> {
        self.news = None;
        let found = self.coming.take(time_ns)?;
        self.is_searching = false;
        match found {
            Ok(Found { news, skin }) => {
                self.news = Some(news);
                skin.map(|skin| *skin)
            }
            Err(error) => {
                tracing::warn!("the circuit was not found ({error}); continuing as before");
                None
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use dermis_skin::builtin_text;

    use super::*;

    #[test]
    fn circuits_are_found_where_they_are_asked_for_and_can_be() {
        let known = "circuit = { load = 0.47, idle = 0.15, reading = [-0.5, 1.0, -0.5] }";
        let text = builtin_text("hydrogel-disc").unwrap();
        let stage = |line: &str| {
            let skin = Skin::parse(&text.replace(known, line), "test").unwrap();
            CircuitStage::new(&Prepared::new(skin).unwrap())
        };
        assert!(stage(known).unwrap().is_none());
        assert!(stage("circuit = \"learn\"").unwrap().is_some_and(|stage| stage.news().is_none()));
        let refused = stage("circuit = \"learn\"\ndifferences = true").unwrap_err().to_string();
        assert!(refused.contains("backend.differences"), "{refused}");
    }
}
