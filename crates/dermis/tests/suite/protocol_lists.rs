//! Skins with an explicit list of channels: the forward model agrees with explicit matrices, a twin read through the
//! pipeline has its touches in the right places, an instrument on the wire receives the list, and the search for
//! orders finds layouts that no pair of patterns describes.

use dermis::{Session, SessionOptions};
use dermis_device::{FrameTable, Layout};
use dermis_lab::channel_search::find_order;
use dermis_lab::measured_list::{measured_list, setup_of};
use dermis_lab::twin_sample::{random_presses, sample_tables};
use dermis_live::prepare::Prepared;
use dermis_skin::{AgainstWord, Electrodes, Layer, ListedChannel, Shape, SheetLayer, Skin};
use dermis_tomo::eit::{ForwardModel, Pattern, Protocol};
use dermis_tomo::mesh::distance;
use dermis_twin::from_skin::press_range;

/// A generator of whole numbers (splitmix64), so that every run has the same lists.
struct Dice(u64);

impl Dice {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) % limit as u64) as usize
    }

    fn two_of(&mut self, electrodes: usize) -> [u32; 2] {
        let a = self.below(electrodes);
        let b = (a + 1 + self.below(electrodes - 1)) % electrodes;
        [a as u32 + 1, b as u32 + 1]
    }
}

/// 50 to 400 channels of every kind, in random order.
fn random_list(dice: &mut Dice, electrodes: usize) -> Vec<ListedChannel> {
    let count = 50 + dice.below(351);
    let channel = |_| {
        let ([sink, source], [plus, minus]) = (dice.two_of(electrodes), dice.two_of(electrodes));
        match dice.below(10) {
            0 => ListedChannel::Itself([sink, source]),
            1 => ListedChannel::SingleEnded(sink, source, plus, AgainstWord::Mean),
            2 => ListedChannel::SingleEnded(sink, source, plus, AgainstWord::Sink),
            _ => ListedChannel::Pairs([sink, source, plus, minus]),
        }
    };
    (0..count).map(channel).collect()
}

fn random_skin(dice: &mut Dice) -> Skin {
    let electrodes = 8 + dice.below(25);
    let shape = match dice.below(3) {
        0 => Shape::Disc { diameter_mm: 80.0 + dice.below(100) as f64 },
        1 => Shape::Rectangle { width_mm: 90.0 + dice.below(80) as f64, height_mm: 70.0 + dice.below(60) as f64 },
        _ => Shape::Polygon {
            outer_mm: vec![[-60.0, -40.0], [70.0, -45.0], [55.0, 20.0], [0.0, 60.0], [-65.0, 30.0]],
            holes_mm: vec![],
        },
    };
    let width_mm = 0.3e3 * shape.outline().perimeter_m() / electrodes as f64;
    let mut skin = Skin::new("listed", shape, Layer::Sheet(SheetLayer::gel(5.0, 0.3)))
        .with_rim_electrodes(electrodes, width_mm.min(6.0))
        .with_channels(random_list(dice, electrodes));
    skin.imaging.elements = 900;
    skin.checked().unwrap()
}

/// Dense rows for a channel: current into each electrode in amperes, and weights of the potentials.
fn rows_of(channel: &ListedChannel, electrodes: usize, current_a: f64) -> (Vec<f64>, Vec<f64>) {
    let (mut drive, mut read) = (vec![0.0; electrodes], vec![0.0; electrodes]);
    let at = |number: u32| number as usize - 1;
    let (sink, source) = match *channel {
        ListedChannel::Pairs([sink, source, plus, minus]) => {
            read[at(plus)] += 1.0;
            read[at(minus)] -= 1.0;
            (sink, source)
        }
        ListedChannel::Itself([a, b]) => {
            read[at(b)] += 1.0;
            read[at(a)] -= 1.0;
            (a, b)
        }
        ListedChannel::SingleEnded(sink, source, plus, against) => {
            read[at(plus)] += 1.0;
            match against {
                AgainstWord::Sink => read[at(sink)] -= 1.0,
                AgainstWord::Mean => read.iter_mut().for_each(|weight| *weight -= 1.0 / electrodes as f64),
            }
            (sink, source)
        }
    };
    drive[at(sink)] -= current_a;
    drive[at(source)] += current_a;
    (drive, read)
}

#[test]
fn the_model_of_a_list_equals_that_of_explicit_matrices() {
    let mut dice = Dice(36);
    for round in 0..12 {
        let skin = random_skin(&mut dice);
        let body = skin.body().unwrap().mesh;
        let sigma: Vec<f64> = (0..body.mesh.element_count())
            .map(|k| skin.sheet_conductance_s() * (1.0 + 0.4 * (0.37 * k as f64).sin()))
            .collect();
        let found = ForwardModel::new(body.clone(), skin.protocol().unwrap()).unwrap().voltages(&sigma).unwrap();
        let electrodes = body.electrodes.len();
        // Potentials of all electrodes relative to the first, for a current through each and the first; the rest is
        // matrix algebra.
        let unit: Vec<Pattern> = (1..electrodes as u32).map(|k| Pattern::pair(k, 0, 1.0)).collect();
        let channels =
            (0..unit.len()).flat_map(|drive| (1..electrodes as u32).map(move |e| (Pattern::pair(e, 0, 1.0), drive)));
        let all = Protocol::from_patterns(electrodes, unit, channels.collect()).unwrap();
        let potentials = ForwardModel::new(body, all).unwrap().voltages(&sigma).unwrap();
        let z =
            |e: usize, k: usize| if e == 0 || k == 0 { 0.0 } else { potentials[(k - 1) * (electrodes - 1) + e - 1] };
        let list = skin.backend.channels.as_ref().unwrap().channels();
        assert_eq!(found.len(), list.len());
        let expected: Vec<f64> = list
            .iter()
            .map(|channel| {
                let (drive, read) = rows_of(channel, electrodes, 1e-3 * skin.backend.current_ma);
                (0..electrodes).map(|e| read[e] * (0..electrodes).map(|k| z(e, k) * drive[k]).sum::<f64>()).sum()
            })
            .collect();
        let largest = expected.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
        let apart = found.iter().zip(&expected).fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
        assert!(apart < 1e-10 * largest, "round {round}: {apart:e} of {largest:e} V");
        // Written and read back it is the same skin.
        assert_eq!(Skin::parse(&skin.to_toml(), "again.toml").unwrap(), skin);
    }
}

/// 16 electrodes on a disc, with channels of neighbouring and wider pairs in a shuffled order.
fn mixed_disc() -> Skin {
    let mut dice = Dice(2);
    let mut list: Vec<ListedChannel> = Vec::new();
    for step in [1, 3, 8] {
        for a in 0..16 {
            for k in 0..16 {
                let drive = [a + 1, (a + step) % 16 + 1];
                let read = [k + 1, (k + 1) % 16 + 1];
                if !read.iter().any(|e| drive.contains(e)) && dice.below(2) == 0 {
                    list.push(ListedChannel::Pairs([drive[0], drive[1], read[0], read[1]]));
                }
            }
        }
    }
    for k in (1..list.len()).rev() {
        list.swap(k, dice.below(k + 1));
    }
    let shape = Shape::Disc { diameter_mm: 120.0 };
    let mut skin = Skin::new("mixed", shape, Layer::Sheet(SheetLayer::gel(5.0, 0.3))).with_rim_electrodes(16, 6.0);
    skin.imaging.elements = 2000;
    skin.imaging.grid = 40;
    skin.with_channels(list).checked().unwrap()
}

fn table(rows: &[Vec<f64>]) -> FrameTable {
    FrameTable::new(Layout::Channels { count: rows[0].len() }, rows.concat(), "made").unwrap()
}

#[test]
fn a_twin_of_listed_channels_is_read_through_the_pipeline() {
    let skin = mixed_disc();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("mixed.toml");
    std::fs::write(&file, skin.to_toml()).unwrap();
    let skin = Skin::open(file.to_str().unwrap()).unwrap();
    let presses = random_presses(&skin.outline(), &press_range(&skin), 6, 7).unwrap();
    // Two frames of each press: touches begin with the second.
    let held: Vec<_> = presses.iter().flat_map(|press| [press.clone(), press.clone()]).collect();
    let [rest, pressed] = sample_tables(&skin, &held, Some(3), |_, _| {}).unwrap();
    let write = |name: &str, table: &FrameTable| {
        let text: Vec<String> = table
            .rows()
            .map(|row| row.iter().map(|value| format!("{value:e}")).collect::<Vec<_>>().join(","))
            .collect();
        let path = folder.path().join(name);
        std::fs::write(&path, text.join("\n") + "\n").unwrap();
        path.display().to_string()
    };
    let (rest, pressed) = (write("rest.csv", &rest), write("press.csv", &pressed));
    let options = SessionOptions { baseline: Some(rest.parse().unwrap()), ..SessionOptions::default() };
    let frames: Vec<_> = Session::open_with(&pressed, skin, &options).unwrap().map(Result::unwrap).collect();
    assert_eq!(frames.len(), 12);
    let mut near = 0;
    for (frame, press) in frames.iter().skip(1).step_by(2).zip(&presses) {
        let placed = frame.touches.iter().any(|touch| distance(touch.position_m, press[0].centre_m) < 5e-3);
        near += u32::from(placed);
    }
    assert!(near >= 4, "{near} of 6 presses found");
}

#[test]
fn an_instrument_on_the_wire_gets_the_list() {
    let skin = mixed_disc();
    let list = measured_list(&skin.protocol().unwrap()).unwrap();
    let ListedChannel::Pairs([sink, source, plus, minus]) = skin.backend.channels.as_ref().unwrap().channels()[0]
    else {
        panic!("a pair")
    };
    assert_eq!(list[0], [source, sink, plus, minus].map(|number| number as u8 - 1));
    assert_eq!(setup_of(&skin).unwrap().len(), 2);
    let mean = skin.with_channels(vec![ListedChannel::SingleEnded(1, 2, 3, AgainstWord::Mean)]);
    assert!(setup_of(&mean).unwrap_err().to_string().contains("--as-set"));
}

#[test]
fn a_lists_order_is_found_when_rotated_reversed_or_shifted() {
    let skin = mixed_disc();
    let rest = Prepared::new(skin.clone()).unwrap().voltages;
    let found = find_order(&table(std::slice::from_ref(&rest)), Some(&skin)).unwrap();
    assert!(found.is_clear && found.candidates[0].description.contains("the skin file's list"), "{}", found.verdict());
    let mut late = rest.clone();
    late.rotate_left(17);
    late.iter_mut().for_each(|value| *value = -*value);
    let found = find_order(&table(&[late.clone()]), Some(&skin)).unwrap();
    assert!(found.is_clear, "{}", found.verdict());
    let (source, signs) = found.candidates[0].to_skin(&skin).unwrap().unwrap();
    let mut ordered = vec![0.0; rest.len()];
    (0..rest.len()).for_each(|k| ordered[source[k] as usize] = signs[k] * late[k]);
    // Exactly for a list, whose channels all differ.
    assert!(ordered.iter().zip(&rest).all(|(a, b)| (a - b).abs() < 1e-3 * rest[0].abs().max(b.abs())));
    let read = Prepared::new(found.candidates[0].on(&skin)).unwrap();
    assert!(read.diagnose(&late).correlation > 0.999);
}

/// Changes of layout applied to the readings of 16 drives by 13 measurements.
fn layouts(rest: &[f64]) -> Vec<(&'static str, Vec<f64>)> {
    let at = |drive: usize, read: usize| rest[13 * drive + read];
    let of = |order: &dyn Fn(usize) -> (usize, usize)| -> Vec<f64> {
        (0..208).map(order).map(|(drive, read)| at(drive, read)).collect()
    };
    vec![
        ("measurement-major", of(&|k| (k % 16, k / 16))),
        ("drives backwards", of(&|k| (15 - k / 13, k % 13))),
        ("drives begun at the fifth", of(&|k| ((k / 13 + 4) % 16, k % 13))),
        ("sign", of(&|k| (k / 13, k % 13)).into_iter().map(|value| -value).collect()),
    ]
}

#[test]
fn layouts_without_a_pattern_are_proposed_as_lists() {
    let mut skin = Skin::open("healing-square").unwrap();
    skin.frontend.electrodes = Electrodes::Rim { count: 16, width_mm: 4.0, start_deg: Some(7.0), clockwise: false };
    skin = skin.with_patterns(dermis_skin::DrivePattern::Adjacent, dermis_skin::MeasurePattern::Adjacent);
    let rest = Prepared::new(skin.clone()).unwrap().voltages;
    assert_eq!(rest.len(), 208);
    for (name, file) in layouts(&rest) {
        let found = find_order(&table(std::slice::from_ref(&file)), Some(&skin)).unwrap();
        assert!(found.is_clear, "{name}: {}", found.verdict());
        let read = Prepared::new(found.candidates[0].on(&skin)).unwrap();
        assert!(read.diagnose(&file).correlation > 0.999, "{name}: {}", found.verdict());
        // The lines are valid in a skin file.
        let lines = found.candidates[0].lines();
        assert!(format!("[backend]\n{lines}").parse::<toml::Table>().is_ok(), "{lines}");
    }
    // Mirrored numbering: electrode k of the file is electrode 17 - k of the skin.
    let mut mirrored = skin.clone();
    mirrored.frontend.electrodes = Electrodes::Rim { count: 16, width_mm: 4.0, start_deg: Some(7.0), clockwise: true };
    let file = Prepared::new(mirrored).unwrap().voltages;
    let found = find_order(&table(&[file]), Some(&skin)).unwrap();
    assert!(found.candidates[0].correlation > 0.999, "{}", found.verdict());
}

#[test]
fn shuffled_readings_fit_no_order() {
    let skin = Skin::open("healing-square").unwrap();
    let rest = Prepared::new(skin.clone()).unwrap().voltages;
    let mut dice = Dice(5);
    for _ in 0..3 {
        let mut shuffled = rest.clone();
        for k in (1..shuffled.len()).rev() {
            shuffled.swap(k, dice.below(k + 1));
        }
        let found = find_order(&table(&[shuffled]), Some(&skin)).unwrap();
        assert!(!found.is_clear && found.verdict().starts_with("nothing fits"), "{}", found.verdict());
    }
}

#[test]
fn pairs_that_read_themselves_are_found_without_being_told() {
    let shape = Shape::Disc { diameter_mm: 200.0 };
    let pairs = (1..=8).flat_map(|a| (a + 1..=8).map(move |b| ListedChannel::Itself([a, b])));
    let skin = Skin::new("tank-8", shape, Layer::Sheet(SheetLayer::gel(5.0, 0.3)))
        .with_rim_electrodes(8, 10.0)
        .with_channels(pairs.collect());
    let prepared = Prepared::new(skin.checked().unwrap()).unwrap();
    assert!(prepared.voltages.iter().all(|value| *value > 0.0), "a pair that reads itself reads what it drives");
    let found = find_order(&table(std::slice::from_ref(&prepared.voltages)), Some(&prepared.skin)).unwrap();
    assert!(found.candidates[0].correlation > 0.999, "{}", found.verdict());
}

#[test]
fn invalid_lists_are_refused_by_channel() {
    let text = Skin::open("healing-square").unwrap().to_toml();
    let with = |channels: &str| {
        let text = text.replacen("[backend]\n", &format!("[backend]\nchannels = {channels}\n"), 1);
        Skin::parse(&text, "listed.toml")
            .map(|skin| skin.protocol().unwrap().channel_count())
            .map_err(|e| e.to_string())
    };
    assert_eq!(with("[[1, 2, 3, 4], [5, 6], [1, 2, 7, \"mean\"], [1, 2, 7, \"sink\"]]"), Ok(4));
    let refused = |channels: &str, says: &str| {
        let message = with(channels).unwrap_err();
        assert!(message.contains(says), "{message}");
    };
    refused("[[1, 2, 3, 4], [0, 1, 2, 3]]", "channel 2: expected electrodes 1 to 16, got 0; add 1 to each");
    refused("[[1, 2, 3, 17]]", "expected electrodes 1 to 16, got 17");
    refused("[[2, 2, 3, 4]]", "a drive of two different electrodes");
    refused("[[1, 2, 3, 3]]", "a reading between two different electrodes");
    refused("[]", "1 to 16384 channels");
    refused("[[1, 2, 3]]", "expected a list of [sink, source, plus, minus]");
    refused("\"list.csv\"", "text has no folder");
    refused("\"../list.csv\"", "within the skin file's folder");
}
