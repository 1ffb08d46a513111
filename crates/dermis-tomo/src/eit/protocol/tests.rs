use super::*;

fn spec(drive: Drive, measure: Measure) -> ProtocolSpec {
    ProtocolSpec {
        electrode_count: 16,
        drive,
        measure,
        order: Order::Absolute,
        driven: Driven::Drop,
        amplitude_a: 1e-3,
    }
}

#[test]
fn published_channel_counts() {
    let count = |spec: &ProtocolSpec| Protocol::generate(spec).unwrap().channel_count();
    assert_eq!(count(&spec(Drive::Adjacent, Measure::Adjacent)), 208);
    // Paper H: 16 drives x 13 pseudo-polar pairs that share no electrode with the drive.
    assert_eq!(count(&spec(Drive::PseudoPolar, Measure::PseudoPolar)), 208);
    // The hydrogel skin: opposite drive, adjacent measurement.
    assert_eq!(count(&spec(Drive::Opposite, Measure::Adjacent)), 192);
    let piezo = ProtocolSpec {
        electrode_count: 64,
        driven: Driven::Keep,
        ..spec(Drive::Adjacent, Measure::SingleEnded(Reference::Mean))
    };
    assert_eq!(count(&piezo), 4096);
    assert_eq!(Protocol::generate(&spec(Drive::Trigonometric, Measure::Adjacent)).unwrap_err(), ProtocolError::Empty);
    let trigonometric = ProtocolSpec { driven: Driven::Keep, ..spec(Drive::Trigonometric, Measure::Adjacent) };
    assert_eq!(count(&trigonometric), 15 * 16);
}

#[test]
fn signs_follow_eidors() {
    let protocol = Protocol::generate(&spec(Drive::Adjacent, Measure::Adjacent)).unwrap();
    assert_eq!(protocol.stimulation_of(0).entries(), &[(0, -1e-3), (1, 1e-3)]);
    assert_eq!(protocol.pattern_of(0).entries(), &[(2, 1.0), (3, -1.0)]);
}

#[test]
fn rotating_order_starts_after_the_drive() {
    let rotating = ProtocolSpec { order: Order::Rotating, ..spec(Drive::Adjacent, Measure::Adjacent) };
    let protocol = Protocol::generate(&rotating).unwrap();
    assert_eq!(protocol.channel_label(13), "2-3 > 4-5");
    let absolute = Protocol::generate(&spec(Drive::Adjacent, Measure::Adjacent)).unwrap();
    assert_eq!(absolute.channel_label(13), "2-3 > 4-5");
    assert_eq!(absolute.channel_label(26), "3-4 > 1-2");
    // The wrapping pair keeps its order: the reading is U16 - U1, and the last drive's current enters at electrode 1.
    let channels = || 0..absolute.channel_count();
    let wraps = channels().filter(|&channel| absolute.channel_label(channel).ends_with("> 16-1")).count();
    assert_eq!(wraps, 13);
    assert!(channels().any(|channel| absolute.channel_label(channel).starts_with("16-1 >")));
    for channel in channels() {
        let label = absolute.channel_label(channel);
        let (_, measured) = label.split_once(" > ").unwrap();
        let (plus, _) = measured.split_once('-').unwrap();
        let entries = absolute.pattern_of(channel).entries();
        assert!(entries.iter().any(|(e, w)| (e + 1).to_string() == plus && *w > 0.0), "{label}: {entries:?}");
    }
    assert_eq!(protocol.channel_label(26), "3-4 > 5-6");
}

#[test]
fn bad_requests_are_refused_with_the_expectation() {
    let odd = ProtocolSpec { electrode_count: 7, ..spec(Drive::Opposite, Measure::Adjacent) };
    let text = Protocol::generate(&odd).unwrap_err().to_string();
    assert_eq!(text, "opposite drive needs at least 4 electrodes and an even number, got 7");
    let outside = spec(Drive::Pairs(vec![(0, 99)]), Measure::Adjacent);
    assert!(Protocol::generate(&outside).unwrap_err().to_string().contains("electrode index 99"));
    let same = spec(Drive::Pairs(vec![(3, 3)]), Measure::Adjacent);
    assert!(matches!(Protocol::generate(&same).unwrap_err(), ProtocolError::Unbalanced { index: 0, .. }));
}
