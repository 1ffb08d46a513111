//! Checks that frames, calibrations and force files belong to the skin they are used for. The check covers everything
//! that frames depend on, not just the name. Materials, imaging and touch settings may differ, since people change
//! them to interpret the same frames better.

use dermis_skin::Skin;
use serde_json::{Value, json};

use crate::Error;

/// Number of digits of a fingerprint shown to users.
const SHOWN: usize = 12;

/// Everything that the frames of a skin depend on, by the keys of its file.
fn parts(skin: &Skin) -> [(&'static str, Value); 14] {
    let (front, back) = (&skin.frontend, &skin.backend);
    let kind = serde_json::to_value(&front.layer).ok().and_then(|layer| layer.get("kind").cloned());
    [
        ("modality", json!(skin.modality)),
        ("frontend.shape", json!(front.shape)),
        ("frontend.bend", json!(front.bend)),
        ("frontend.layer.kind", kind.unwrap_or_default()),
        ("frontend.electrodes", json!(front.electrodes)),
        ("frontend.coils", json!(front.coils)),
        ("frontend.elements", json!(front.elements)),
        ("backend.frequency_khz", json!(back.frequency_khz)),
        // Patterns that a list of channels replaces have no form in a file.
        ("backend.drive", serde_json::to_value(&back.drive).unwrap_or_default()),
        ("backend.measure", serde_json::to_value(&back.measure).unwrap_or_default()),
        ("backend.channels", json!(back.channels)),
        ("backend.order", json!(back.order)),
        ("backend.driven", json!(back.driven)),
        ("backend.reads", json!(back.reads)),
    ]
}

/// SHA-256 of everything that the frames of a skin depend on: modality, shape, kind of layer, electrodes, coils,
/// elements, drives, readings and their order.
///
/// ```
/// use dermis_live::same_skin::frames_sha256;
/// use dermis_skin::Skin;
///
/// let skin = Skin::open("healing-square")?;
/// let mut imaged_otherwise = skin.clone();
/// imaged_otherwise.imaging.grid = 32;
/// assert_eq!(frames_sha256(&imaged_otherwise), frames_sha256(&skin));
/// assert_ne!(frames_sha256(&Skin::open("ionic-disc")?), frames_sha256(&skin));
/// # Ok::<(), dermis_skin::Error>(())
/// ```
pub fn frames_sha256(skin: &Skin) -> String {
    dermis_learn::sha256(json!(parts(skin).map(|(_, value)| value)).to_string().as_bytes())
}

/// Rejects frames of one skin for use with another; `what` names the frames.
///
/// # Errors
/// [`Error::OtherSkin`] with both names and the differences.
pub fn check_frames(what: &str, recorded: &Skin, wanted: &Skin) -> Result<(), Error> {
    let (of_recorded, of_wanted) = (parts(recorded), parts(wanted));
    let other = of_recorded.iter().zip(&of_wanted).filter(|((_, a), (_, b))| a != b);
    let differs: Vec<&str> = other.map(|((key, _), _)| *key).collect();
    if differs.is_empty() {
        return Ok(());
    }
    Err(Error::OtherSkin {
        what: what.to_owned(),
        got: named(&recorded.name, &frames_sha256(recorded)),
        expected: named(&wanted.name, &frames_sha256(wanted)),
        differs: format!("; {} differ", differs.join(", ")),
    })
}

/// Rejects a calibration with the fingerprint of another skin. One without a fingerprint was made by an earlier
/// version.
///
/// # Errors
/// [`Error::OtherSkin`] with both names and fingerprints.
pub fn check_print(what: &str, (name, sha256): (&str, Option<&str>), wanted: &Skin) -> Result<(), Error> {
    let print = frames_sha256(wanted);
    if name == wanted.name && sha256.is_none_or(|sha256| sha256 == print) {
        return Ok(());
    }
    Err(Error::OtherSkin {
        what: what.to_owned(),
        got: named(name, sha256.unwrap_or_default()),
        expected: named(&wanted.name, &print),
        differs: String::new(),
    })
}

/// `healing-square (1f3a...)`.
fn named(name: &str, sha256: &str) -> String {
    match sha256.get(..SHOWN) {
        Some(print) => format!("{name} (fingerprint {print})"),
        None => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::{BUILTIN_NAMES, builtin_text};

    #[test]
    fn skins_with_listed_channels_have_fingerprints_too() {
        let listed = |plus| {
            let channels = [[1, 2, plus, 4], [2, 3, 4, 1]].map(dermis_skin::ListedChannel::Pairs);
            Skin::open("healing-square").unwrap().with_channels(channels.to_vec())
        };
        assert_eq!(frames_sha256(&listed(3)), frames_sha256(&listed(3)));
        assert_ne!(frames_sha256(&listed(3)), frames_sha256(&listed(5)));
        assert!(check_frames("a.mcap", &listed(3), &listed(5)).unwrap_err().to_string().contains("backend.channels"));
    }

    #[test]
    fn frames_with_and_without_their_baseline_are_of_the_same_skin() {
        let skin = Skin::open("healing-square").unwrap();
        let mut differences = skin.clone();
        differences.backend.differences = true;
        assert_eq!(frames_sha256(&skin), frames_sha256(&differences));
    }

    #[test]
    fn built_in_skins_are_distinguished_and_recognise_themselves() {
        let skins: Vec<Skin> = BUILTIN_NAMES.iter().map(|name| Skin::open(name).unwrap()).collect();
        for recorded in &skins {
            let stored = Skin::parse(&recorded.to_toml(), "a recording").unwrap();
            for wanted in &skins {
                let checked = check_frames("h.mcap", &stored, wanted);
                if recorded.name == wanted.name {
                    checked.unwrap();
                    continue;
                }
                let text = checked.unwrap_err().to_string();
                assert!(text.contains(&recorded.name) && text.contains(&wanted.name), "{text}");
                assert!(text.contains("--as-skin"), "{text}");
            }
        }
    }

    #[test]
    fn a_skin_of_twice_the_side_is_refused_with_the_key_that_differs() {
        let text = builtin_text("healing-square").unwrap();
        let doubled = Skin::parse(&text.replace("side_mm = 100.0", "side_mm = 200.0"), "doubled").unwrap();
        let error = check_frames("h.mcap", &Skin::open("healing-square").unwrap(), &doubled).unwrap_err().to_string();
        assert!(error.contains("; frontend.shape differ"), "{error}");
        let softer = Skin { title: "another title".into(), ..Skin::open("healing-square").unwrap() };
        check_frames("h.mcap", &softer, &Skin::open("healing-square").unwrap()).unwrap();
    }
}
