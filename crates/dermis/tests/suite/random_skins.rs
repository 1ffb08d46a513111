//! Skins that nobody has tuned: outline, size, layer, electrodes, protocol and presses are drawn from a seed, and
//! frames are read with the skin file as it is. The assertions hold over the whole draw.

use dermis_lab::twin_sample::random_presses;
use dermis_skin::Skin;
use dermis_tomo::mesh::distance;
use dermis_twin::from_skin::press_range;
use dermis_twin::mechanics::{Indenter, Shape};
use rand::rngs::StdRng;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};

use crate::bench::Bench;
use crate::sigmas::pressed_and_read;

const SKINS: usize = 12;
const SINGLES: usize = 12;
const PAIRS: usize = 6;
/// Relative tolerance on the distance between the presses of a pair, which is a quarter of the longer side.
const SLACK: f64 = 0.1;

/// Layers as written by `dermis new`.
pub const LAYERS: [&str; 4] = [
    "{ kind = \"sheet\", thickness_mm = 5.0, conductivity_s_per_m = 0.2, gauge_factor = 1.0, modulus_kpa = 60.0 }",
    "{ kind = \"sheet\", thickness_mm = 5.0, conductivity_s_per_m = 0.5, gauge_factor = 0.0, \
     pressure_percent_per_kpa = 1.0 }",
    "{ kind = \"sandwich\", thickness_mm = 1.0, conductivity_s_per_m = 5.0 }",
    "{ kind = \"liquid\", depth_mm = 10.0, conductivity_s_per_m = 0.1 }",
];

const PATCHES: &str =
    "{ kind = \"patches\", thickness_mm = 1.0, conductivity_s_per_m = 5.0, pitch_mm = 10.0, gap_mm = 1.0 }";

fn random_skin(random: &mut StdRng) -> Skin {
    let side = random.random_range(60.0..200.0_f64).round();
    let (shape, rim_mm) = match random.random_range(0..3) {
        0 => (format!("{{ disc = {{ diameter_mm = {side:?} }} }}"), 3.1 * side),
        1 => {
            let height = (side / random.random_range(1.0..2.0)).round();
            (format!("{{ rectangle = {{ width_mm = {side:?}, height_mm = {height:?} }} }}"), 2.0 * (side + height))
        }
        _ => {
            let (corners, turn) = (random.random_range(5..9), random.random_range(0.0..1.0));
            let corner = |k: usize| {
                let angle = std::f64::consts::TAU * (k as f64 + turn) / corners as f64;
                [0.5 * side * angle.cos(), 0.5 * side * angle.sin()]
            };
            let outer: Vec<[f64; 2]> = (0..corners).map(corner).collect();
            (format!("{{ polygon = {{ outer_mm = {outer:?} }} }}"), 2.9 * side)
        }
    };
    let layer = LAYERS.choose(random).unwrap();
    let count = *[12, 16, 20, 24].choose(random).unwrap();
    let skip = random.random_range(0..3);
    let width_mm = (0.4 * rim_mm / f64::from(count)).min(10.0);
    let gain = if layer.contains("liquid") { "gain = \"channel\"" } else { "" };
    written(&shape, layer, (count, width_mm), skip, gain)
}

/// A skin as written by `dermis new`: with electrodes (number and width in mm) along the rim, `skip` of them between
/// those of a pair, and a line of image settings.
pub fn written(shape: &str, layer: &str, electrodes: (u32, f64), skip: u32, imaging: &str) -> Skin {
    let (count, width_mm) = electrodes;
    let text = format!(
        "name = \"drawn\"\ntitle = \"drawn\"\nmodality = \"eit\"\n[frontend]\nshape = {shape}\nlayer = {layer}\n\
         electrodes = {{ rim = {{ count = {count}, width_mm = {width_mm:?} }} }}\ncontact_impedance_ohm_m2 = 1e-4\n\
         [backend]\ncurrent_ma = 1.0\ndrive = {{ skip = {skip} }}\nmeasure = {{ skip = {skip} }}\nframes_per_s = 25.0\n\
         [imaging]\ngrid = 48\nhyperparameter = {{ relative = 0.03 }}\n{imaging}\n"
    );
    Skin::parse(&text, "drawn.toml").unwrap_or_else(|error| panic!("{error}\n{text}"))
}

#[test]
fn presses_on_random_skins_are_found_counted_and_within_their_sigmas() {
    let (mut shares, mut inside, mut missed, mut split, mut singles) = (Vec::new(), [0, 0], 0, 0, 0);
    let (mut right, mut pairs) = (0, 0);
    let mut told = String::new();
    for seed in 0..SKINS as u64 {
        let mut random = StdRng::seed_from_u64(seed);
        let skin = random_skin(&mut random);
        let (outline, usual) = (skin.outline(), press_range(&skin));
        let (low, high) = outline.bounds_m();
        let sides = [0, 1].map(|axis| high[axis] - low[axis]);
        let places = random_presses(&outline, &usual, 400, seed).unwrap();
        let mut groups: Vec<Vec<Indenter>> = places[..SINGLES].to_vec();
        let apart = 0.25 * sides[0].max(sides[1]);
        let flat: Vec<Indenter> = places.into_iter().flatten().collect();
        let of_pairs = (0..flat.len())
            .flat_map(|b| (0..b).map(move |a| (a, b)))
            .filter(|&(a, b)| (distance(flat[a].centre_m, flat[b].centre_m) / apart - 1.0).abs() < SLACK);
        groups.extend(of_pairs.step_by(41).take(PAIRS).map(|(a, b)| vec![flat[a], flat[b]]));
        let found = pressed_and_read(skin.clone(), groups.clone(), seed);
        let (mut of_skin, before) = (Vec::new(), (missed, split, right));
        for (group, touches) in groups.iter().zip(&found) {
            if group.len() == 2 {
                pairs += 1;
                right += usize::from(touches.len() == 2);
                continue;
            }
            singles += 1;
            missed += usize::from(touches.is_empty());
            split += usize::from(touches.len() > 1);
            let at = |touch: &&Vec<f64>| distance([1e-3 * touch[2], 1e-3 * touch[3]], group[0].centre_m);
            let Some(touch) = touches.iter().min_by(|a, b| at(a).total_cmp(&at(b))) else { continue };
            of_skin.push(at(&touch) / sides[0].min(sides[1]));
            for axis in 0..2 {
                let sigmas = (1e-3 * touch[2 + axis] - group[0].centre_m[axis]).abs() / (1e-3 * touch[6 + axis]);
                inside[0] += usize::from(sigmas <= 1.0);
                inside[1] += usize::from(sigmas <= 2.5);
            }
        }
        of_skin.sort_by(f64::total_cmp);
        let median = of_skin[of_skin.len() / 2];
        let counts = (missed - before.0, split - before.1, right - before.2);
        told += &format!(
            "{seed}: {:?}, median {:.2} %, missed, split, pairs {counts:?}\n",
            skin.frontend.layer,
            1e2 * median
        );
        shares.push(median);
    }
    shares.sort_by(f64::total_cmp);
    let coordinates = 2.0 * (singles - missed) as f64;
    let within = inside.map(|count| count as f64 / coordinates);
    let (median, worst) = (shares[SKINS / 2], shares[SKINS - 1]);
    told += &format!("within {within:?}, missed {missed}, split {split} of {singles}, pairs {right} of {pairs}");
    // Half a per cent of the shorter side at most on the median skin. On the worst one, with few electrodes, noise
    // limits the positions.
    assert!(median <= 0.004 && worst <= 0.02, "{told}");
    assert!(missed == 0 && split * 30 <= singles && right * 20 >= 19 * pairs, "{told}");
    // 288 coordinates scatter by 3 %; the two of one press are not independent.
    assert!((0.57..=0.84).contains(&within[0]) && within[1] >= 0.93, "{told}");
}

/// Meshes have to resolve a finger, not only the skin.
#[test]
fn presses_on_skins_much_larger_than_a_finger_are_found_within_their_sigmas() {
    let skins = [
        ("{ square = { side_mm = 279.0 } }", PATCHES, 12, 0.02),
        ("{ disc = { diameter_mm = 303.0 } }", LAYERS[2], 32, 0.002),
        ("{ rectangle = { width_mm = 435.0, height_mm = 174.0 } }", LAYERS[2], 32, 0.004),
    ];
    for (shape, layer, electrodes, most) in skins {
        let skin = written(shape, layer, (electrodes, 10.0), 0, "");
        let (low, high) = skin.outline().bounds_m();
        let shorter_m = (high[0] - low[0]).min(high[1] - low[1]);
        let groups = random_presses(&skin.outline(), &press_range(&skin), 60, 3).unwrap();
        let found = pressed_and_read(skin, groups.clone(), 3);
        let (mut inside, mut force_inside, mut off_m) = (0, 0, Vec::new());
        for (group, touches) in groups.iter().zip(&found) {
            let [touch] = &touches[..] else { panic!("{shape}: {} touches", touches.len()) };
            let [x_m, y_m] = [2, 3].map(|column| 1e-3 * touch[column]);
            let [right_x, right_y] = group[0].centre_m;
            off_m.push((x_m - right_x).hypot(y_m - right_y));
            let sigmas = [(x_m - right_x) / touch[6], (y_m - right_y) / touch[7]].map(|off| 1e3 * off.abs());
            inside += sigmas.iter().filter(|sigmas| **sigmas <= 2.5).count();
            force_inside += usize::from((touch[8] - group[0].force_n()).abs() <= 2.5 * touch[9]);
        }
        off_m.sort_by(f64::total_cmp);
        let median = off_m[30] / shorter_m;
        println!("{shape}: median {median:.4}, {inside} of 120 coordinates and {force_inside} of 60 forces inside");
        // Before meshes followed the finger, presses on the patches were missed, and 35 of 60 forces on the disc inside.
        assert!(median <= most && inside >= 112 && force_inside >= 54, "{shape}: {median} {inside} {force_inside}");
    }
}

#[test]
fn three_presses_are_counted_with_eight_electrodes() {
    let (mut right, mut triples) = (0, 0);
    for (side_mm, layer) in [(60.0, LAYERS[0]), (100.0, LAYERS[3])] {
        let shape = format!("{{ square = {{ side_mm = {side_mm:?} }} }}");
        let gain = if layer.contains("liquid") { "gain = \"channel\"" } else { "" };
        let skin = written(&shape, layer, (8, 10.0), 0, gain);
        // The counts of a single draw of 40 scatter by 2.
        for seed in 7..11 {
            let places = random_presses(&skin.outline(), &press_range(&skin), 400, seed).unwrap();
            let groups: Vec<_> = triples_apart(&places, 0.25e-3 * side_mm).take(20).collect();
            triples += groups.len();
            let found = pressed_and_read(skin.clone(), groups, seed);
            right += found.iter().filter(|touches| touches.len() == 3).count();
        }
    }
    // Twelve parameters from twenty independent readings.
    assert!(triples == 160 && right >= 136, "{right} of {triples}");
}

/// With eight electrodes, three presses close together look much like a wide one.
#[test]
fn three_presses_close_together_are_not_taken_for_one() {
    let (side_mm, apart_m) = (110.0, 0.0275);
    for (layer, imaging) in [(LAYERS[0], ""), (LAYERS[1], ""), (LAYERS[3], "gain = \"channel\"")] {
        let skin = written(&format!("{{ square = {{ side_mm = {side_mm:?} }} }}"), layer, (8, 10.0), 0, imaging);
        let outline = skin.outline();
        let corner = |middle: &Indenter, turns: f64| {
            let (sine, cosine) = (std::f64::consts::TAU * turns).sin_cos();
            let reach_m = apart_m / 3_f64.sqrt();
            let centre_m = [middle.centre_m[0] + reach_m * cosine, middle.centre_m[1] + reach_m * sine];
            Indenter { centre_m, ..*middle }
        };
        let middles = random_presses(&outline, &press_range(&skin), 200, 11).unwrap().concat();
        let triangle = |(number, middle): (usize, &Indenter)| -> Vec<Indenter> {
            (0..3).map(|k| corner(middle, f64::from(k) / 3.0 + 0.1 * number as f64)).collect()
        };
        let is_inside = |group: &Vec<Indenter>| group.iter().all(|press| outline.inside_by_m(press.centre_m) > 0.0115);
        let groups: Vec<_> = middles.iter().enumerate().map(triangle).filter(is_inside).take(20).collect();
        let found = pressed_and_read(skin.clone(), groups, 11);
        let right = found.iter().filter(|touches| touches.len() == 3).count();
        println!("{layer}: {right} of {}", found.len());
        // As long as errors of the model were taken for those of 32 electrodes, one to three were right.
        assert!(found.len() == 20 && right >= 13, "{layer}: {right} of {}", found.len());
    }
}

/// Presses three at a time, at least this far apart (metres).
fn triples_apart(places: &[Vec<Indenter>], apart_m: f64) -> impl Iterator<Item = Vec<Indenter>> {
    places.chunks_exact(3).map(<[_]>::concat).filter(move |group| {
        let apart = |a: usize, b: usize| distance(group[a].centre_m, group[b].centre_m);
        apart(0, 1).min(apart(0, 2)).min(apart(1, 2)) >= apart_m
    })
}

/// Root mean square by which the baseline has moved, in standard deviations of the noise.
fn moved(bench: &Bench, before: &[f64]) -> f64 {
    let (after, noise) = bench.pipeline.baseline();
    let square = |k: usize| ((after[k] - before[k]) / noise[k]).powi(2);
    ((0..after.len()).map(square).sum::<f64>() / after.len() as f64).sqrt()
}

/// Presses of the last frame that have moved elsewhere at once must not use up the work for the search.
#[test]
fn pairs_on_patches_that_follow_each_other_at_once_are_two_touches_each() {
    let skin = written("{ square = { side_mm = 120.0 } }", PATCHES, (16, 10.0), 0, "");
    let places = random_presses(&skin.outline(), &press_range(&skin), 60, 5).unwrap();
    let are_apart = |group: &&[Vec<Indenter>]| distance(group[0][0].centre_m, group[1][0].centre_m) >= 0.03;
    let mut bench = Bench::of(skin);
    let mut told = Vec::new();
    for group in places.chunks_exact(2).filter(are_apart).take(12) {
        let scene = bench.twin.scene_mut();
        scene.release_all();
        for (pointer, indenter) in (0..).zip(group.concat()) {
            scene.press_with(pointer, indenter).unwrap();
        }
        // The image of the first frames may mix both pairs.
        bench.run(3);
        let counts = (0..6).map(|_| {
            bench.run(1);
            bench.touches.len()
        });
        told.push(counts.filter(|count| *count == 2).count());
    }
    let right = told.iter().filter(|frames| **frames >= 5).count();
    assert!(told.len() == 12 && right >= 11, "frames of six with two touches: {told:?}");
}

#[test]
fn presses_in_quick_succession_leave_the_baseline_as_it_was() {
    let electrodes = (16, 10.0);
    for layer in [LAYERS[0], LAYERS[1], LAYERS[3]] {
        let mut skin = written("{ square = { side_mm = 120.0 } }", layer, electrodes, 0, "");
        // Slow frames seldom show the middle of a release.
        skin.backend.frames_per_s = Some(250.0);
        let places = random_presses(&skin.outline(), &press_range(&skin), 10, 3).unwrap();
        let mut bench = Bench::of(skin);
        let before = bench.pipeline.baseline().0.to_vec();
        for press in places.into_iter().flatten() {
            bench.twin.scene_mut().press_with(0, press).unwrap();
            bench.run(60);
            let [x, y] = press.centre_m;
            let error_mm = bench.error_mm([1e3 * x, 1e3 * y]);
            assert!(bench.touches.len() == 1 && error_mm < 2.0, "{layer}: {error_mm} mm, {:?}", bench.touches);
            bench.release(50);
        }
        let moved = moved(&bench, &before);
        // Baselines of 32 frames are uncertain by a fifth of the noise of one.
        assert!(moved < 0.5, "{layer}: moved by {moved} standard deviations of the noise");
    }
}

/// No electrode sees the corners of a square well. They used to be up to eight times as bright as a press.
#[test]
fn images_of_squares_with_eight_electrodes_are_brightest_under_presses() {
    for layer in [LAYERS[0], LAYERS[1], LAYERS[3]] {
        let skin = written("{ square = { side_mm = 120.0 } }", layer, (8, 10.0), 0, "");
        let places = random_presses(&skin.outline(), &press_range(&skin), 12, 4).unwrap();
        let mut bench = Bench::of(skin);
        let grid = *bench.pipeline.prepared().map.grid();
        let mut away_mm = Vec::new();
        for press in places.into_iter().flatten() {
            bench.twin.scene_mut().press_with(0, press).unwrap();
            bench.run(3);
            away_mm.push(1e3 * distance(grid.centre_m(bench.strongest_pixel), press.centre_m));
            bench.release(30);
        }
        let near = away_mm.iter().filter(|mm| **mm < 20.0).count();
        assert!(near >= 11, "{layer}: brightest pixels {away_mm:.0?} mm from the press");
    }
}

/// A cup or a palm: twice as wide as a fingertip, with the same pressure.
#[test]
fn objects_wider_than_a_fingertip_are_one_touch_each() {
    for layer in [LAYERS[0], LAYERS[1]] {
        let skin = written("{ square = { side_mm = 110.0 } }", layer, (16, 10.0), 0, "");
        let places = random_presses(&skin.outline(), &press_range(&skin), 12, 8).unwrap();
        let mut bench = Bench::of(skin);
        let (mut several, mut away_mm) = (0, Vec::new());
        for mut press in places.into_iter().flatten() {
            let Shape::Disc { radius_m } = press.shape else { panic!("{press:?}") };
            press.shape = Shape::Disc { radius_m: 2.0 * radius_m };
            bench.twin.scene_mut().press_with(0, press).unwrap();
            bench.run(4);
            several += usize::from(bench.touches.len() > 1);
            let away = bench.touches.iter().map(|touch| 1e3 * distance(touch.position_m, press.centre_m));
            away_mm.push(away.fold(f64::INFINITY, f64::min));
            bench.release(30);
        }
        away_mm.sort_by(f64::total_cmp);
        assert!(
            several <= 1 && away_mm[6] < 0.4 && away_mm[10] < 2.0,
            "{layer}: {several} split, {away_mm:.2?} mm off"
        );
    }
}

/// In twelve minutes the whole skin drifts by 2.4 %, and each channel by up to 0.3 %.
#[test]
fn held_presses_keep_identity_and_amplitude_while_the_skin_drifts() {
    const FRAMES: usize = 1440;
    let (mut random, mut changes) = (StdRng::seed_from_u64(12), Vec::new());
    for layer in [LAYERS[0], LAYERS[1], LAYERS[2], LAYERS[3], PATCHES] {
        let mut skin = written("{ rectangle = { width_mm = 130.0, height_mm = 90.0 } }", layer, (16, 10.0), 0, "");
        skin.backend.frames_per_s = Some(2.0);
        let place = random_presses(&skin.outline(), &press_range(&skin), 1, random.random()).unwrap();
        let mut bench = Bench::of(skin);
        let channels = bench.pipeline.baseline().0.len();
        let drifts: Vec<f64> = (0..channels).map(|_| random.random_range(-0.003..0.003) - 0.024).collect();
        bench.twin.scene_mut().press_with(0, place[0][0]).unwrap();
        bench.run(4);
        let id = bench.touches[0].id;
        let mut amplitudes = Vec::with_capacity(FRAMES);
        for frame in 0..FRAMES {
            let part = frame as f64 / FRAMES as f64;
            bench.run_changed(|channel, value| *value *= 1.0 + part * drifts[channel]);
            let ids: Vec<u64> = bench.touches.iter().map(|touch| touch.id).collect();
            assert_eq!(ids, [id], "{layer}, frame {frame}");
            amplitudes.push(bench.touches[0].amplitude);
        }
        let means: Vec<f64> =
            amplitudes.chunks_exact(40).map(|some| some.iter().sum::<f64>() / some.len() as f64).collect();
        changes.push(means.iter().map(|mean| (mean / means[0] - 1.0).abs()).fold(0.0, f64::max));
        bench.twin.scene_mut().release_all();
        for after in 0..20 {
            bench.run_changed(|channel, value| *value *= 1.0 + drifts[channel]);
            // The first frames may show the end of the press.
            assert!(after < 4 || bench.touches.is_empty(), "{layer}: {:?}", bench.touches);
        }
    }
    // On twenty other skins, the median was 0.024 and the largest change 0.05; 0.038 and 0.2 with fits that let
    // positions and radii drift.
    changes.sort_by(f64::total_cmp);
    assert!(changes[2] <= 0.03 && changes[4] <= 0.08, "relative changes of the amplitude: {changes:.3?}");
}

/// A press on two electrodes of a sandwich shorts them, and a press may begin while the baseline is corrected. Three
/// presses at once begin with the second frame.
#[test]
fn triples_on_a_sandwich_leave_its_channels_and_its_baseline_as_they_were() {
    let skin = written("{ square = { side_mm = 120.0 } }", LAYERS[2], (16, 10.0), 0, "");
    let places = random_presses(&skin.outline(), &press_range(&skin), 300, 7).unwrap();
    let mut bench = Bench::of(skin);
    let before = bench.pipeline.baseline().0.to_vec();
    let (mut counts, mut frames) = (Vec::new(), Vec::new());
    for group in triples_apart(&places, 0.03).take(30) {
        for (pointer, indenter) in (0..).zip(group) {
            bench.twin.scene_mut().press_with(pointer, indenter).unwrap();
        }
        let mut first = None;
        for frame in 1..=20 {
            bench.run(1);
            assert!(bench.pipeline.health().is_sound(), "{:?}", bench.pipeline.health());
            if bench.touches.len() == 3 {
                first.get_or_insert(frame);
            }
        }
        counts.push(bench.touches.len());
        frames.push(first);
        bench.release(20);
    }
    let right = counts.iter().filter(|count| **count == 3).count();
    assert!(right >= 28, "{counts:?}");
    // A search for three ends after the first frame. Nine of ten must begin with the second.
    let in_time = frames.iter().filter(|first| first.is_some_and(|frame| frame <= 2)).count();
    assert!(in_time >= 27, "first frames with three touches: {frames:?}");
    let moved = moved(&bench, &before);
    assert!(moved < 0.5, "moved by {moved} standard deviations of the noise");
}
