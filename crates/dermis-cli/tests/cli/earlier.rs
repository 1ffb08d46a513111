//! Files written by an early version of the command, whose twins were not yet derived from skin files, stay readable
//! and give the same touches.

use std::fs;

use dermis_testdata::{earlier, earlier_unpacked};
use serde_json::Value;

use super::Desk;

fn lines(text: &str) -> Vec<Value> {
    text.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect()
}

#[test]
fn a_replay_finds_the_touches_that_the_version_that_recorded_them_found() {
    let desk = Desk::with(&[]);
    // Known differences since then. Priors no longer drop anything beyond six correlation lengths: images differ by
    // 2e-8, and fits end up to 1e-5 mm elsewhere. A liquid's weight now counts in addition to its membrane's tension,
    // and dents are fitted beyond the linear range: positions on the ionic disc have moved by up to a millimetre. The
    // noise is estimated from all channels together: travels of elements, which are weighted by it, have changed by
    // up to 4 %, and an element that starts to move may be seen one frame earlier. Everything else is the same.
    for (skin, frames, place_mm, amplitude) in [("ionic-disc", 70_usize, 1.5, 1e-4), ("em-8", 70, 1e-3, 0.03)] {
        let recording = earlier(&format!("{skin}.mcap")).display().to_string();
        let info: Value = serde_json::from_str(&desk.done(&["info", &recording, "--json"])).expect("JSON");
        assert_eq!((&info["frames"], &info["whole"]), (&Value::from(frames), &Value::from(true)), "{info}");
        let now = lines(&desk.done(&["replay", &recording, "--only-touches"]));
        let then = lines(&fs::read_to_string(earlier(&format!("{skin}.touches.jsonl"))).expect("what it printed"));
        assert_eq!(now.len(), then.len(), "{skin}");
        let mut began_earlier = 0;
        for (now, then) in now.iter().zip(&then) {
            assert_eq!((&now["sequence"], &now["time_s"]), (&then["sequence"], &then["time_s"]), "{skin}");
            let touches = |line: &Value| line["touches"].as_array().cloned().unwrap_or_default();
            let is_new = |touch: &&Value| touch["phase"] == "begin";
            let (seen, known) = (touches(now), touches(then));
            let earlier = seen.iter().filter(is_new).count().saturating_sub(known.iter().filter(is_new).count());
            assert_eq!(seen.len(), known.len() + earlier, "{skin}: {now} {then}");
            began_earlier += earlier;
            // Standard deviations now include the model error, so they are not compared.
            for then in &known {
                let now = seen.iter().find(|now| now["id"] == then["id"]).expect("the same touch");
                let has_begun = then["phase"] == "begin" && now["phase"] == "move";
                assert!(now["phase"] == then["phase"] || has_begun, "{skin}: {now} {then}");
                assert_eq!(now["area_mm2"], then["area_mm2"], "{skin}");
                for (key, tolerance) in [("x_mm", place_mm), ("y_mm", place_mm), ("amplitude", amplitude)] {
                    let [now, then] = [now, then].map(|touch| touch[key].as_f64().expect("a number"));
                    assert!((now - then).abs() < tolerance, "{skin}, {key}: {now} and {then}");
                }
            }
        }
        assert!(began_earlier <= 1, "{skin}: {began_earlier}");
        desk.done(&["export", &recording, "--out", "frames.csv"]);
        let table = fs::read_to_string(desk.path("frames.csv")).expect("a table");
        assert_eq!(table.lines().count(), 1 + frames, "{skin}");
        fs::remove_file(desk.path("frames.csv")).expect("a file");
    }
}

#[test]
fn calibrations_of_the_first_version_still_place_touches_and_read_forces() {
    let desk = Desk::with(&[]);
    fs::write(desk.path("em-8.json"), earlier_unpacked("em-8.calibration.json")).expect("a file");
    let [rest, pokes, forces] =
        ["em-8.rest.csv", "em-8.pokes.csv", "ionic-disc.forces.json"].map(|name| earlier(name).display().to_string());
    let files = ["--baseline", &rest, "--frames", &pokes, "--calibration", "em-8.json", "--touches", "t.csv"];
    desk.done(&[&["reconstruct", "em-8"], &files[..]].concat());
    let table = fs::read_to_string(desk.path("t.csv")).expect("a table");
    assert_eq!(table.lines().count(), 1 + 9, "{table}");
    let recording = earlier("ionic-disc.mcap").display().to_string();
    let run = ["run", "ionic-disc", "--source", &recording, "--speed", "0", "--headless", "--forces", &forces];
    let pressed: Vec<Value> =
        lines(&desk.done(&run)).into_iter().filter(|line| line["touches"][0].is_object()).collect();
    assert_eq!(pressed.len(), 18);
    assert!(pressed.iter().all(|line| line["touches"][0]["force_n"].as_f64().is_some_and(|force| force > 0.0)));
}
