use super::*;

/// Runs the twin of a built-in skin until it has obeyed the commands, and returns its notices.
fn told(skin: &str, commands: &[TwinCommand]) -> Vec<String> {
    let (source, sender) = TwinSource::new(&Skin::open(skin).unwrap()).unwrap();
    let (mut source, mut frame) = (source.unpaced(), Frame::default());
    let mut step = |command: Option<TwinCommand>| {
        command.map_or(Ok(()), |command| sender.send(command)).unwrap();
        assert_eq!(source.next_frame(&mut frame, Duration::ZERO).unwrap(), SourceEvent::Frame);
        assert!(frame.values.iter().all(|value| value.is_finite()));
    };
    commands.iter().for_each(|command| step(Some(*command)));
    (0..3).for_each(|_| step(None));
    source.notices().try_iter().collect()
}

fn press(pointer: u64, x_m: f64, pressure_pa: f64) -> TwinCommand {
    TwinCommand::Press { pointer, position_m: [x_m, 0.0], radius_m: 0.01, pressure_pa }
}

#[test]
fn invalid_presses_are_reported_and_frames_continue() {
    let bad = [press(1, 0.2, 80e3), press(1, 0.2, 80e3), press(2, 0.0, f64::NAN), press(3, 0.0, -5.0)];
    let told = told("healing-square", &bad);
    assert_eq!(told.len(), 3, "each pointer once: {told:?}");
    assert_eq!(
        told[0],
        "press refused: x of the indenter, m: 0.2 refused; expected no farther out than the skin's rim"
    );
    assert!(told[1].contains("pressure_pa: NaN refused") && told[2].contains("pressure_pa: -5 refused"), "{told:?}");
}

#[test]
fn sheets_are_cut_and_healed_and_other_skins_refuse() {
    let cut = TwinCommand::Treat(Treatment::Cut(dermis_twin::physics::Cut::open([-0.01, 0.0], [0.01, 0.0])));
    assert_eq!(told("healing-square", &[cut, TwinCommand::Treat(Treatment::Renew)]), [""; 0]);
    let nowhere = TwinCommand::Treat(Treatment::TimeLapse(f64::NAN));
    assert!(told("healing-square", &[nowhere])[0].contains("treatment refused: time-lapse: NaN"));
    let refused = told("ionic-disc", &[cut]);
    assert!(refused[0].contains("does not support this treatment"), "{refused:?}");
}

#[test]
fn a_demonstration_that_is_not_wanted_ends_and_may_begin_again() {
    let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
    let (mut source, mut frame) = (source.unpaced(), Frame::default());
    let mut rest = Vec::new();
    let mut changes = |frames: usize| {
        let moved = |values: &[f64], rest: &[f64]| {
            let size = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
            size(&mut values.iter().zip(rest).map(|(a, b)| a - b)) / size(&mut rest.iter().copied())
        };
        let mut largest: f64 = 0.0;
        for _ in 0..frames {
            source.next_frame(&mut frame, Duration::ZERO).unwrap();
            if rest.is_empty() {
                rest.clone_from(&frame.values);
            }
            largest = largest.max(moved(&frame.values, &rest));
        }
        largest
    };
    // Noise is below a thousandth of the readings, a touch far above.
    assert!(changes(30) < 5e-3);
    assert!(changes(120) > 2e-2, "it demonstrates by itself");
    sender.send(TwinCommand::Demonstrate(false)).unwrap();
    changes(50);
    assert!(changes(150) < 5e-3, "nothing touches it any more");
    sender.send(TwinCommand::Demonstrate(true)).unwrap();
    assert!(changes(150) > 2e-2, "it demonstrates again");
}

#[test]
fn equal_cuts_heals_and_cuts_of_any_length_leave_a_skin_that_runs() {
    let cut = |from_m, to_m| TwinCommand::Treat(Treatment::Cut(dermis_twin::physics::Cut::open(from_m, to_m)));
    let middle = cut([0.0, 0.0], [0.02, 0.0]);
    // Both within one frame and in successive frames.
    assert_eq!(told("healing-square", &[middle, middle, middle, middle]), [""; 0]);
    let far = told("healing-square", &[cut([-50.0, 0.0], [50.0, 0.0]), middle]);
    assert!(far.len() == 1 && far[0].contains("no farther from the skin than the skin is long"), "{far:?}");
    let heating = |k: u32| dermis_twin::Heating {
        centre_m: [f64::from(k) * 1e-5, 0.0],
        radius_m: 0.01,
        temperature_c: 90.0,
        duration_s: 7200.0,
    };
    let heats: Vec<TwinCommand> = (0..40).map(|k| TwinCommand::Treat(Treatment::Heat(heating(k)))).collect();
    let told = told("healing-square", &heats);
    assert!(told.iter().all(|text| text.contains("heat pads: 25 refused; expected at most 24")), "{told:?}");
    assert_eq!(told.len(), 16);
}

#[test]
fn bursts_of_cuts_are_prepared_in_the_background() {
    let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
    let (mut source, mut frame) = (source.undemonstrated(), Frame::default());
    for k in 0..12 {
        let y_m = -0.03 + 0.004 * f64::from(k);
        let cut = dermis_twin::physics::Cut::open([-0.01, y_m], [0.01, y_m]);
        sender.send(TwinCommand::Treat(Treatment::Cut(cut))).unwrap();
    }
    let mut during = 0;
    while source.twin.frontend().wounds().is_empty() {
        source.next_frame(&mut frame, Duration::from_millis(100)).unwrap();
        during += u32::from(source.preparing.is_some());
        assert!(during < 100_000, "the cuts never came");
    }
    assert!(during > 0, "the frames waited for the cuts");
    assert_eq!(source.twin.frontend().wounds().len(), 12);
    assert_eq!(source.notices().try_iter().collect::<Vec<_>>(), [""; 0]);
}

#[test]
fn any_number_of_pointers_and_faults_is_handled() {
    let (source, sender) = TwinSource::new(&Skin::open("healing-square").unwrap()).unwrap();
    let (mut source, mut frame) = (source.unpaced(), Frame::default());
    for k in 0..600 {
        let _ = sender.send(press(k, 0.0, 1e3));
        let fault = Fault::NoisyChannel { channel: 0, deviation_v: 1e-6 * k as f64 };
        let _ = sender.send(TwinCommand::Break(fault));
        source.next_frame(&mut frame, Duration::ZERO).unwrap();
    }
    assert_eq!((source.pressing.len(), source.faults.len()), (MOST_POINTERS, MOST_FAULTS));
    let told: Vec<String> = source.notices().try_iter().collect();
    assert!(told.iter().any(|text| text.contains("32 pointers are already pressing")), "{told:?}");
}

#[test]
fn sliding_off_the_skin_releases_silently() {
    let slide = [press(1, 0.04, 80e3), press(1, 0.06, 80e3), press(1, 0.07, 80e3), press(1, 0.0, 80e3)];
    assert_eq!(told("healing-square", &slide), [""; 0]);
}

#[test]
fn a_membrane_on_the_bottom_is_reported_once() {
    let heavy = [press(1, 0.0, 20e3), press(1, 0.01, 20e3), press(1, 0.02, 20e3)];
    let told = told("ionic-disc", &heavy);
    assert_eq!(told.len(), 1, "{told:?}");
    assert!(told[0].starts_with("twin:ionic-disc: the membrane touches the bottom"), "{told:?}");
}
