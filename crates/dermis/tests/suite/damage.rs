//! Damage distinguished from touch on the sandwich's twin, whose mesh, physics and noise differ from the model's:
//! cuts are found and remembered, touches work next to them, drift and slow presses are distinguished, and no baseline
//! hides a damage.

use dermis_device::{Frame, HostStamp, Layout};
use dermis_live::pipeline::Pipeline;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_live::stages::damage::{Crack, CrackModel, CrackScratch, ProposalReason, estimate_cut};
use dermis_skin::Skin;
use dermis_touch::damage::{Damage, DamageEvent, DamageShape, DamageState};
use dermis_touch::{ReferenceOrigin, Touch};
use dermis_twin::physics::Cut;
use dermis_twin::{AnyTwin, TwinKit};
use dermis_twin::{Frontend, Heating, Treatment};

/// A twin and the pipeline that follows it.
struct Line {
    twin: AnyTwin,
    pipeline: Pipeline,
    ticks: u64,
    frame_s: f64,
    events: Vec<DamageEvent>,
}

impl Line {
    fn new() -> Self {
        let mut line = Self::without_baseline();
        line.run(40);
        line
    }

    /// A line whose cut has been found and included in the baseline. From here on frames are slow.
    fn with_a_known_cut() -> Self {
        let mut line = Self::new();
        line.cut(FROM_MM, TO_MM);
        line.run(60);
        line.frame_s = 0.2;
        line.run(10);
        line
    }

    fn without_baseline() -> Self {
        let skin = Skin::open("healing-square").unwrap();
        let prepared = Prepared::new(skin.clone()).unwrap();
        let layout = Layout::Channels { count: prepared.channels() };
        let frame_s = 1.0 / skin.backend.frames_per_s.unwrap();
        let twin = TwinKit::of(&skin).unwrap().twin;
        let pipeline = Pipeline::new(prepared, &layout, None).unwrap();
        Self { twin, pipeline, ticks: 0, frame_s, events: Vec::new() }
    }

    /// Runs this many frames and returns the touches of the last.
    fn run(&mut self, frames: usize) -> Vec<Touch> {
        let mut touches = Vec::new();
        let mut values = Vec::new();
        for _ in 0..frames {
            let time_s = self.ticks as f64 * self.frame_s;
            self.twin.step(time_s, &mut values).unwrap();
            let time_ns = (time_s * 1e9) as u64;
            let mut frame = Frame::default();
            frame.refill(self.ticks, HostStamp { monotonic_ns: time_ns, wall_ns: 0 }, &values, &[]);
            frame.device_time_ns = Some(time_ns);
            self.ticks += 1;
            let output = self.pipeline.process(&frame, time_ns).unwrap();
            self.events.extend_from_slice(&output.damage.events);
            touches.clear();
            touches.extend_from_slice(&output.touches);
        }
        touches
    }

    fn treat(&mut self, treatment: Treatment) {
        self.twin.frontend_mut().treat(&treatment).unwrap();
    }

    fn cut(&mut self, from_mm: [f64; 2], to_mm: [f64; 2]) {
        let metres = |p: [f64; 2]| p.map(|mm| 1e-3 * mm);
        self.treat(Treatment::Cut(Cut::open(metres(from_mm), metres(to_mm))));
    }

    fn press(&mut self, x_mm: f64, y_mm: f64) {
        self.twin.scene_mut().press(1, 1e-3 * x_mm, 1e-3 * y_mm, 0.01, 80e3).unwrap();
    }

    fn release(&mut self) {
        self.twin.scene_mut().release(1);
    }

    fn names(&self) -> Vec<&'static str> {
        self.events.iter().map(DamageEvent::name).collect()
    }

    fn damages(&self) -> Vec<Damage> {
        self.pipeline.damage().damages.to_vec()
    }
}

/// The cut in the paper's figure: 20 mm in the first quadrant.
const FROM_MM: [f64; 2] = [15.0, 18.0];
const TO_MM: [f64; 2] = [31.0, 30.0];
const MIDDLE_MM: [f64; 2] = [23.0, 24.0];

/// As published: 90 C for two hours.
fn heated(centre_m: [f64; 2], radius_m: f64) -> Treatment {
    Treatment::Heat(Heating { centre_m, radius_m, temperature_c: 90.0, duration_s: 7200.0 })
}

#[test]
fn a_cut_is_found_covered_by_a_press_and_found_again() {
    let mut line = Line::new();
    line.cut(FROM_MM, TO_MM);
    let touches = line.run(80);
    println!("{:?} {:#?} touches {touches:?}", line.names(), line.damages());
    assert!(touches.is_empty(), "lobes of the cut are no touches");
    assert_eq!(line.names(), ["begin"]);
    assert!(line.pipeline.health().is_sound(), "a cut is no fault of a channel");
    let before = line.damages()[0];
    let [x, y] = before.shape.centre_m;
    let off_mm = 1e3 * (x - 1e-3 * MIDDLE_MM[0]).hypot(y - 1e-3 * MIDDLE_MM[1]);
    println!("off {off_mm:.2} mm, length {:.2} mm", 1e3 * before.shape.length_m);
    assert!(off_mm < 0.5 && (before.shape.length_m - 0.02).abs() < 1e-3, "{off_mm:.2} mm: {:?}", before.shape);
    // A press on the cut: one touch, and the damage is covered.
    line.press(MIDDLE_MM[0], MIDDLE_MM[1]);
    let touches = line.run(60);
    println!("on cut {touches:?} {:?}", line.names());
    assert_eq!(touches.len(), 1);
    assert_eq!(line.damages()[0].state, DamageState::Covered);
    line.release();
    assert!(line.run(60).is_empty());
    println!("{:?} {:?}", line.names(), line.damages());
    assert_eq!(line.names(), ["begin", "covered", "uncovered"]);
    let after = line.damages()[0];
    assert_eq!((after.id, after.state, after.since_ns), (before.id, DamageState::Confirmed, before.since_ns));
    assert!(after.confirmed_ns > before.confirmed_ns);
    assert_eq!(line.damages().len(), 1);
}

#[test]
fn touches_next_to_a_cut_are_placed_as_well_as_before() {
    let places = [[-25.0, 0.0], [0.0, -25.0], [-20.0, -20.0], [25.0, -15.0], [-12.0, 28.0], [0.0, 0.0]];
    let mut line = Line::new();
    let errors = |line: &mut Line| {
        let found: Vec<f64> = places
            .iter()
            .map(|&[x, y]| {
                line.press(x, y);
                let touches = line.run(15);
                line.release();
                line.run(15);
                assert_eq!(touches.len(), 1, "at {x}, {y} mm: {touches:?}");
                (1e3 * touches[0].position_m[0] - x).hypot(1e3 * touches[0].position_m[1] - y)
            })
            .collect();
        println!("errors {found:.2?}");
        found.iter().sum::<f64>() / found.len() as f64
    };
    let intact = errors(&mut line);
    line.cut(FROM_MM, TO_MM);
    line.run(80);
    let cut = errors(&mut line);
    println!("intact {intact:.3} cut {cut:.3} mm; {:?}", line.names());
    // Below a tenth of a millimetre the mean of six presses is dominated by noise, and so is the ratio of two such
    // means.
    assert!(cut <= 1.3 * intact.max(0.1), "{cut:.2} mm with the cut, {intact:.2} mm without");
}

#[test]
fn a_tare_hides_no_damage_and_every_baseline_is_kept() {
    let mut line = Line::new();
    line.cut(FROM_MM, TO_MM);
    line.run(80);
    line.pipeline.tare(false, "a test").unwrap();
    line.run(100);
    let origins: Vec<ReferenceOrigin> = line.pipeline.baseline_records().iter().map(|record| record.origin).collect();
    assert_eq!(origins, [ReferenceOrigin::Startup, ReferenceOrigin::Damage, ReferenceOrigin::Tare]);
    let view = line.pipeline.damage();
    println!("{:?}", view.damages);
    assert_eq!((view.intact, view.damages.len(), view.damages[0].state), (Some(0), 1, DamageState::Confirmed));
    assert!(view.damages[0].share > 0.9);
    // Without damage, the new baseline becomes the reference for damage.
    let mut sound = Line::new();
    sound.pipeline.tare(false, "a test").unwrap();
    sound.run(60);
    assert_eq!(sound.pipeline.damage().intact, Some(1));
}

#[test]
fn releasing_a_touch_in_the_first_baseline_is_no_damage_but_a_cut_there_is() {
    for place_mm in [MIDDLE_MM, [-20.0, -5.0]] {
        let mut line = Line::without_baseline();
        line.press(place_mm[0], place_mm[1]);
        line.run(40);
        line.release();
        line.run(80);
        let view = line.pipeline.damage();
        println!("{place_mm:?}: {:?} {:?} {:?}", line.names(), view.damages, view.proposal);
        assert!(line.events.is_empty() && view.damages.is_empty(), "{:?}", view.damages);
        assert_eq!(view.proposal.map(|proposal| proposal.reason), Some(ProposalReason::Touched));
        assert_eq!(line.pipeline.baseline_records().len(), 1, "nothing is taken without being told");
        if place_mm == MIDDLE_MM {
            line.pipeline.tare(false, "proposed").unwrap();
            line.run(40);
            assert_eq!((line.pipeline.damage().proposal, line.pipeline.damage().intact), (None, Some(1)));
        }
        // Damage is found in the right place with and without the proposed baseline. A cut may leave lobes, which are
        // recorded too.
        let half = [8.0, 6.0];
        line.cut([place_mm[0] - half[0], place_mm[1] - half[1]], [place_mm[0] + half[0], place_mm[1] + half[1]]);
        line.run(80);
        let off_mm = |damage: &Damage| {
            let [x, y] = damage.shape.centre_m;
            (1e3 * x - place_mm[0]).hypot(1e3 * y - place_mm[1])
        };
        let damages = line.damages();
        let nearest = damages.iter().filter(|damage| damage.is_open()).map(off_mm).fold(f64::INFINITY, f64::min);
        println!("off {nearest:.2} mm: {damages:?}");
        assert!(line.names().contains(&"begin") && nearest < 3.0, "{nearest} mm off: {damages:?}");
    }
}

#[test]
fn warmth_of_a_small_pad_hides_no_healing() {
    let mut line = Line::with_a_known_cut();
    let centre_m = MIDDLE_MM.map(|mm| 1e-3 * mm);
    line.treat(Treatment::TimeLapse(720.0));
    line.treat(heated(centre_m, 0.015));
    for _ in 0..10 {
        let touches = line.run(25);
        let view = line.pipeline.damage();
        println!(
            "{:?} {:?} {:?} {:?}",
            line.names(),
            view.damages.first().map(|d| (d.state, d.share)),
            view.healing,
            touches
        );
    }
    let state = line.pipeline.damage().healing[0];
    assert!(state.joined > 0.9, "the heat is off for 40 s: {state:?}");
    line.pipeline.tare(false, "a test").unwrap();
}

#[test]
fn drift_of_the_whole_sheet_is_followed_and_a_slow_press_is_not() {
    let mut line = Line::new();
    // Drift of 2 % in 10 minutes; the press builds up over two minutes.
    line.frame_s = 2.0;
    line.treat(Treatment::Warm(0.02 / 600.0));
    assert!(line.run(150).is_empty(), "5 minutes of drift are no touch");
    let drift = line.pipeline.damage().drift;
    println!("drift {drift}");
    // Voltages fall by 1 % in 5 minutes, and the baseline lags by a minute's worth.
    assert!((-0.0105..-0.0070).contains(&drift), "{drift}");
    let mut touched_s = None;
    for step in 0..60 {
        let pressure = 80e3 * f64::from(step + 1) / 60.0;
        line.twin.scene_mut().press(1, -0.02, 0.01, 0.01, pressure).unwrap();
        if !line.run(1).is_empty() {
            touched_s.get_or_insert(f64::from(step) * 2.0);
        }
    }
    let touches = line.run(60);
    println!("touched after {touched_s:?} s; {touches:?}");
    assert_eq!(touches.len(), 1, "held for two minutes it is still there");
    let [x, y] = touches[0].position_m;
    assert!((x + 0.02).hypot(y - 0.01) < 5e-4, "{:?}", touches[0].position_m);
    assert!(touches[0].amplitude > 0.2, "{}", touches[0].amplitude);
    line.release();
    assert!(line.run(40).is_empty());
    assert!(line.events.is_empty() && line.damages().is_empty(), "{:?}", line.damages());
}

#[test]
fn a_new_baseline_is_proposed_once_the_skin_rests_at_a_new_level() {
    let mut line = Line::new();
    line.frame_s = 0.2;
    line.run(200);
    assert!(line.pipeline.damage().proposal.is_none(), "{:?}", line.pipeline.damage().proposal);
    // A faint cut: too small to count as damage, but the baseline no longer fits.
    line.cut([-22.5, -20.0], [-17.5, -20.0]);
    line.run(100);
    assert!(line.pipeline.damage().proposal.is_none(), "20 s are not enough");
    line.run(100);
    let view = line.pipeline.damage();
    let proposal = view.proposal.unwrap_or_else(|| panic!("no proposal; {:?} {:?}", view.damages, line.names()));
    println!("{proposal:?} {:?}", line.damages());
    assert_eq!(proposal.reason, ProposalReason::Offset);
    line.pipeline.tare(false, "proposed").unwrap();
    line.run(220);
    assert!(line.pipeline.damage().proposal.is_none(), "{:?}", line.pipeline.damage().proposal);
}

#[test]
fn cuts_are_measured_by_their_fields() {
    let skin = Skin::open("healing-square").unwrap();
    let prepared = Prepared::new(skin.clone()).unwrap();
    let model = CrackModel::new(&prepared).unwrap();
    let mut twin = TwinKit::of(&skin).unwrap().twin;
    let mut ticks = 0;
    let mut frames = |twin: &mut AnyTwin, count: usize| -> Vec<Vec<f64>> {
        let mut step = || {
            let mut values = Vec::new();
            twin.step(f64::from(ticks) * 0.04, &mut values).unwrap();
            ticks += 1;
            values
        };
        (0..count).map(|_| step()).collect()
    };
    let reference = Reference::of(&prepared, &frames(&mut twin, 32)).unwrap();
    let cuts = [
        ([23.0, 24.0], 20.0, 37.0),
        ([-20.0, 10.0], 20.0, -60.0),
        ([22.5, 1.8], 6.9, -73.0),
        ([-12.1, 6.3], 12.0, -61.0),
        ([-4.3, -7.8], 17.1, -88.0),
        ([0.1, -19.1], 22.7, -3.0),
        ([-24.5, -18.1], 24.6, 47.0),
        ([-20.6, 28.5], 29.9, -47.0),
        ([0.7, 20.4], 33.2, -26.0),
    ];
    for (middle_mm, length_mm, degrees) in cuts {
        let (sin, cos) = f64::to_radians(degrees).sin_cos();
        let end = |sign: f64| {
            [1e-3 * (middle_mm[0] + sign * 0.5 * length_mm * cos), 1e-3 * (middle_mm[1] + sign * 0.5 * length_mm * sin)]
        };
        twin.frontend_mut().treat(&Treatment::Renew).unwrap();
        twin.frontend_mut().treat(&Treatment::Cut(Cut::open(end(-1.0), end(1.0)))).unwrap();
        let after = frames(&mut twin, 25);
        let mean: Vec<f64> = (0..208).map(|c| after.iter().map(|frame| frame[c]).sum::<f64>() / 25.0).collect();
        // The centre found in the image is off by up to a centimetre.
        let centre_m = [1e-3 * (middle_mm[0] * 1.25 + 4.0), 1e-3 * (middle_mm[1] * 1.25 - 3.0)];
        let start = DamageShape { centre_m, length_m: 0.03, width_m: 0.0, direction_rad: 0.0, deviations: None };
        let difference = reference.difference(&mean, None);
        let estimate = estimate_cut(&prepared, &model, &difference, &reference.noise, &start).unwrap().unwrap();
        let found = estimate.crack;
        let off_mm = 1e3 * (found.centre_m[0] - 1e-3 * middle_mm[0]).hypot(found.centre_m[1] - 1e-3 * middle_mm[1]);
        let longer_mm = 1e3 * found.length_m - length_mm;
        println!(
            "{middle_mm:?} {length_mm} mm {degrees}: off {off_mm:.2} mm, longer {longer_mm:.2} mm, direction {:.1}, explained {:.4}, dev {:?} uniform {:.1e}",
            found.direction_rad.to_degrees(),
            estimate.explained,
            estimate.deviations(),
            estimate.uniform
        );
        // A tenth of the required accuracy. The model neglects the rim's response, which lengthens long cuts by 3 %.
        let most_mm = 0.4_f64.max(0.04 * length_mm);
        assert!(
            off_mm < 0.3 && longer_mm.abs() < most_mm,
            "{middle_mm:?}: off {off_mm:.2} mm, {longer_mm:.2} mm longer"
        );
    }
}

#[test]
fn cuts_near_a_round_rim_have_an_effect() {
    let prepared = Prepared::new(Skin::open("ionic-disc").unwrap()).unwrap();
    assert!(CrackModel::applies_to(&prepared));
    let model = CrackModel::new(&prepared).unwrap();
    let (mut scratch, mut response) = (CrackScratch::default(), vec![0.0; model.channel_count()]);
    let mut inside = 0;
    for k in 0..360 {
        let (sin, cos) = f64::to_radians(f64::from(k)).sin_cos();
        let at_m = prepared.half_width_m() * (0.9 + 0.0003 * f64::from(k));
        let (centre_m, direction_rad) = ([at_m * cos, at_m * sin], f64::from(k));
        let crack = Crack { centre_m, length_m: 4e-3, direction_rad, joined_per_m: 0.0 };
        if model.respond(&crack, &mut scratch, &mut response) {
            inside += 1;
            assert!(response.iter().all(|value| value.is_finite()), "{crack:?}");
        }
    }
    // The rest leaves the skin.
    assert!((100..360).contains(&inside), "{inside}");
}

#[test]
fn healing_is_followed_and_ends_with_a_new_baseline() {
    let mut line = Line::with_a_known_cut();
    let centre_m = MIDDLE_MM.map(|mm| 1e-3 * mm);
    line.treat(heated(centre_m, 0.025));
    line.treat(Treatment::TimeLapse(200.0));
    let mut course = Vec::new();
    for _ in 0..10 {
        line.run(25);
        let truth = line.twin.frontend().wounds()[0].healed;
        let state = line.pipeline.damage().healing[0];
        println!("truth {truth:.3} {state:?}");
        course.push((truth, state.joined.min(1.0)));
    }
    // The rise of the sheet around the cut and the remaining cut have similar effects on the readings, and the
    // readings are means over a few frames, so allow for some error.
    assert!(course.iter().all(|(truth, joined)| (truth - joined).abs() < 0.15), "{course:?}");
    assert!(course.windows(2).all(|pair| pair[1].1 >= pair[0].1 - 0.1), "{course:?}");
    assert!(course[9].1 > 0.9, "{course:?}");
    assert_eq!(line.damages().len(), 1, "the record stays");
}

#[test]
fn a_cut_anywhere_is_one_damage() {
    // Images of thin cuts have lobes as high as the cut is deep, which are not touches, and lobes at the rim, which
    // are not damage. Cuts are tried along and across the lines between electrodes, at the rim, in the centre, long
    // and short.
    for (middle_mm, length_mm, degrees) in [
        ([-20.0, -5.0], 20.0, 37.0_f64),
        ([-20.0, -5.0], 20.0, 90.0),
        ([5.0, -28.0], 20.0, 0.0),
        ([5.0, -36.0], 20.0, 10.0),
        ([30.0, -28.0], 12.0, 45.0),
        ([0.0, 0.0], 40.0, 20.0),
        ([20.0, 0.0], 20.0, 5.0),
        ([33.0, 10.0], 20.0, 100.0),
    ] {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let end = |along_mm: f64| [middle_mm[0] + along_mm * cos, middle_mm[1] + along_mm * sin];
        let mut line = Line::new();
        line.cut(end(-0.5 * length_mm), end(0.5 * length_mm));
        let touches = line.run(80);
        let found = line.damages();
        assert_eq!((touches.len(), line.names().len(), found.len()), (0, 1, 1), "{middle_mm:?}: {found:?}");
        let shape = &found[0].shape;
        let off_mm = (1e3 * shape.centre_m[0] - middle_mm[0]).hypot(1e3 * shape.centre_m[1] - middle_mm[1]);
        let longer_mm = 1e3 * shape.length_m - length_mm;
        let turned = (shape.direction_rad.to_degrees() - degrees + 90.0).rem_euclid(180.0) - 90.0;
        println!(
            "{middle_mm:?} {length_mm} mm {degrees}: off {off_mm:.2} mm, longer {longer_mm:.2} mm, turned {turned:.1}"
        );
        // The requirements are 3 mm and 4 mm. The largest errors are 0.33 mm, 1.2 mm (of 40) and 0.6 degrees.
        assert!(off_mm < 1.0 && longer_mm.abs() < 0.05 * length_mm && turned.abs() < 2.0, "{middle_mm:?}: {shape:?}");
    }
}

#[test]
fn the_second_cut_is_found_next_to_the_first() {
    let mut line = Line::new();
    line.cut(FROM_MM, TO_MM);
    line.run(80);
    line.cut([-30.0, -5.0], [-12.0, -14.0]);
    line.run(80);
    let found = line.damages();
    println!("{found:#?}");
    assert_eq!((line.names(), found.len()), (vec!["begin", "begin"], 2));
    let [x, y] = found[1].shape.centre_m.map(|m| 1e3 * m);
    // The requirements are 3 mm and 4 mm; the errors are 0.13 mm, 0.2 mm and half a degree.
    assert!((x + 21.0).hypot(y + 9.5) < 0.5 && (1e3 * found[1].shape.length_m - 20.1).abs() < 1.0, "{:?}", found[1]);
    let turned = found[1].shape.direction_rad.to_degrees() + f64::to_degrees((9.0_f64 / 18.0).atan());
    assert!(turned.abs() < 2.0, "{turned} degrees");
    // Touches are placed on the sheet with both cuts, which is in use three seconds later.
    line.run((3.0 / line.frame_s) as usize);
    line.press(0.0, -30.0);
    let touches = line.run(40);
    assert_eq!(touches.len(), 1);
    let [x, y] = touches[0].position_m.map(|m| 1e3 * m);
    assert!(x.hypot(y + 30.0) < 0.6, "{x} {y}");
}
