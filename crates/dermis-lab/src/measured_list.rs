//! A skin's protocol in the form that goes over the wire to an instrument: for each channel four electrodes, two for
//! the current and two for the voltage.

use dermis_device::instruments::sciospec::live::LiveSetup;
use dermis_device::instruments::wire::Order;
use dermis_skin::Skin;
use dermis_tomo::eit::{Pattern, Protocol};
use dermis_wire::NO_ELECTRODE;

use crate::Error;

/// Commands that configure an instrument on the wire to measure as the skin file says, as far as the wire allows:
/// protocol, current, frequency.
///
/// # Errors
/// The skin's protocol is invalid, or its channels cannot be described by four electrodes each. Leaving the
/// instrument's own setting would silently yield other channels.
pub fn setup_of(skin: &Skin) -> Result<Vec<Order>, Error> {
    let protocol = measured_list(&skin.protocol()?).map(Order::Protocol);
    if protocol.is_none() && skin.backend.channels.is_some() {
        return Err(Error::Live(dermis_live::Error::Frames {
            what: format!("backend.channels of {}, sent to an instrument on the wire", skin.name),
            expected: "four electrodes for each channel, or --as-set for an instrument that is set already".into(),
            got: "readings against the mean of all electrodes".into(),
        }));
    }
    let amplitude = Order::AmplitudeA((skin.backend.current_ma * 1e-3) as f32);
    let frequency = skin.backend.frequency_khz.map(|khz| Order::FrequencyHz((khz * 1e3) as f32));
    Ok(protocol.into_iter().chain([amplitude]).chain(frequency).collect())
}

/// The setup of a Sciospec instrument for a skin: every driving pair once, in the protocol's order. The instrument
/// reads every electrode against ground, from which the skin's channels are computed.
///
/// # Errors
/// A skin with an invalid protocol, or one that drives more than two electrodes at once.
pub fn sciospec_setup_of(skin: &Skin) -> Result<LiveSetup, Error> {
    let protocol = skin.protocol()?;
    let mut injections: Vec<(usize, usize)> = Vec::new();
    for channel in 0..protocol.channel_count() {
        let pair = ends(protocol.stimulation_of(channel)).filter(|[_, sink]| *sink != NO_ELECTRODE);
        let Some([source, sink]) = pair else {
            return Err(Error::Live(dermis_live::Error::Frames {
                what: format!("protocol of {}, sent to a Sciospec instrument", skin.name),
                expected: "a current between two electrodes".into(),
                got: format!("another for channel {channel}"),
            }));
        };
        let pair = (usize::from(source), usize::from(sink));
        if injections.last() != Some(&pair) && !injections.contains(&pair) {
            injections.push(pair);
        }
    }
    Ok(LiveSetup {
        electrodes: protocol.electrode_count(),
        injections,
        amplitude_a: skin.backend.current_ma * 1e-3,
        frequency_hz: skin.backend.frequency_khz.map(|khz| khz * 1e3),
        frames_per_s: skin.backend.frames_per_s,
    })
}

/// The channels of a protocol in order. Each has the electrode where the current enters, the one where it leaves, the
/// one whose voltage is read, and the one it is read against; [`NO_ELECTRODE`] if there is none. A channel that reads
/// an electrode against itself is sent as the sink against itself.
///
/// `None` for protocols that four electrodes cannot describe: currents or voltages over more than two electrodes,
/// weights that are not opposite, electrodes beyond 254.
pub fn measured_list(protocol: &Protocol) -> Option<Vec<[u8; 4]>> {
    let quadruple = |channel: usize| {
        let [source, sink] = ends(protocol.stimulation_of(channel))?;
        let pattern = protocol.pattern_of(channel);
        let [positive, negative] = if pattern.entries().is_empty() { [sink, sink] } else { ends(pattern)? };
        Some([source, sink, positive, negative])
    };
    (0..protocol.channel_count()).map(quadruple).collect()
}

/// The positive and the negative electrode of a pattern.
fn ends(pattern: &Pattern) -> Option<[u8; 2]> {
    let electrode = |electrode: u32| u8::try_from(electrode).ok().filter(|electrode| *electrode != NO_ELECTRODE);
    match *pattern.entries() {
        [(one, weight)] if weight > 0.0 => Some([electrode(one)?, NO_ELECTRODE]),
        [(one, weight), (other, opposite)] if weight == -opposite => {
            let (positive, negative) = if weight > 0.0 { (one, other) } else { (other, one) };
            Some([electrode(positive)?, electrode(negative)?])
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dermis_skin::BUILTIN_NAMES;

    #[test]
    fn four_electrodes_describe_the_channels_of_the_built_in_skins() {
        let list = |name: &str| measured_list(&Skin::open(name).unwrap().protocol().unwrap());
        let piezo = list("piezo-disc").unwrap();
        // As in EIDORS, the current enters at the second of two neighbours.
        assert_eq!((piezo.len(), piezo[0], piezo[1], piezo[64]), (4096, [1, 0, 0, 0], [1, 0, 1, 0], [2, 1, 0, 1]));
        assert_eq!(piezo[4095], [0, 63, 63, 63]);
        let healing = list("healing-square").unwrap();
        assert_eq!((healing.len(), healing[0][..2].to_vec()), (208, vec![7, 0]));
        assert_eq!(
            list("em-8").unwrap()[..2],
            [[0, NO_ELECTRODE, 1, NO_ELECTRODE], [0, NO_ELECTRODE, 2, NO_ELECTRODE]]
        );
        let described = BUILTIN_NAMES.iter().filter(|name| list(name).is_some()).count();
        assert!(described >= 9, "{described} of {} built-in skins", BUILTIN_NAMES.len());
    }

    #[test]
    fn a_current_of_three_electrodes_is_not_described() {
        let stimulations = vec![Pattern::new(vec![(0, 1e-3), (1, -0.5e-3), (2, -0.5e-3)])];
        let protocol = Protocol::from_patterns(4, stimulations, vec![(Pattern::pair(2, 3, 1.0), 0)]);
        assert_eq!(measured_list(&protocol.unwrap()), None);
    }
}
