//! Recordings as a script sees them: replayed exactly, killed and recovered, on a full disk, exported.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use dermis_device::instruments::npy;
use serde_json::Value;

fn dermis(directory: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dermis"));
    command.args(arguments).current_dir(directory).env_remove("DERMIS_LOG").output().expect("the command starts")
}

fn message(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

fn done(directory: &Path, arguments: &[&str]) -> String {
    let output = dermis(directory, arguments);
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", message(&output));
    text(&output)
}

/// The output of `info --json`.
fn info(directory: &Path, file: &str) -> Value {
    serde_json::from_str(&done(directory, &["info", file, "--json"])).expect("JSON")
}

/// The twin's demonstration at full speed.
const QUICK: [&str; 4] = ["--speed", "0", "--frames", "120"];

#[test]
fn a_replay_prints_what_the_run_printed() {
    let desk = tempfile::tempdir().expect("a directory");
    let live = done(desk.path(), &[&["run", "--headless", "--record", "a.mcap"], &QUICK[..]].concat());
    assert!(live.lines().count() == 120 && live.contains("\"id\":1"), "{live}");
    // The monotonic times of two processes can't be compared.
    let live: String = live
        .lines()
        .map(|line| {
            let (before, after) = line.split_once("\"monotonic_ns\":").expect("a clock");
            let (number, after) = after.split_once(',').expect("further fields");
            assert!(number.parse::<u64>().is_ok(), "{line}");
            format!("{before}\"monotonic_ns\":null,{after}\n")
        })
        .collect();
    assert_eq!(done(desk.path(), &["replay", "a.mcap"]), live);
    let quiet = done(desk.path(), &["replay", "a.mcap", "--only-touches"]);
    assert!(quiet.lines().count() < 120 && quiet.lines().all(|line| live.contains(line)));
    let found = info(desk.path(), "a.mcap");
    assert_eq!((&found["frames"], &found["whole"], &found["dropped"]), (&120.into(), &true.into(), &0.into()));
    assert_eq!(found["skin"], "healing-square");
    // At 25 frames/s and at most 10 images/s, every third of the 88 frames after the baseline has an image. A busy
    // machine skips some.
    let images = found["messages"]["/dermis/image"].as_u64().expect("a count");
    assert!((1..=30).contains(&images), "{images} images");

    let imaged = ["replay", "a.mcap", "--prior", "laplace", "--hyperparameter", "1e-3", "--images", "i.npy"];
    assert_eq!(done(desk.path(), &imaged), "");
    assert_eq!(npy::read(&desk.path().join("i.npy")).expect("an array").shape[0], 120);
    let refused = dermis(desk.path(), &["replay", "a.mcap", "--prior", "smooth"]);
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));
}

#[test]
fn tables_hold_the_readings_exactly() {
    let desk = tempfile::tempdir().expect("a directory");
    done(desk.path(), &[&["record", "--out", "a.mcap"], &QUICK[..]].concat());
    done(desk.path(), &["export", "a.mcap", "--format", "npy", "--out", "f.npy"]);
    let said = done(desk.path(), &["export", "a.mcap", "--out", "f.csv"]);
    assert_eq!(said, "f.csv: 120 rows of 212 columns\n");
    let array = npy::read(&desk.path().join("f.npy")).expect("an array");
    assert_eq!(array.shape, [120, 208]);
    let csv = std::fs::read_to_string(desk.path().join("f.csv")).expect("a table");
    let cells = |line: &str| line.rsplit(',').take(208).map(str::to_owned).collect::<Vec<_>>();
    for (row, line) in array.values.chunks(208).zip(csv.lines().skip(1)) {
        let found: Vec<f64> = cells(line).iter().rev().map(|cell| cell.parse().expect("a number")).collect();
        assert!(found.iter().zip(row).all(|(a, b)| a.to_bits() == b.to_bits()));
    }
    let events = done(desk.path(), &["export", "a.mcap", "--table", "baselines", "--out", "b.csv"]);
    assert_eq!(events, "b.csv: 1 rows of 7 columns\n");
    let refused = dermis(desk.path(), &["export", "a.mcap", "--table", "touches", "--format", "npy", "--out", "t.npy"]);
    assert_eq!(refused.status.code(), Some(2), "{}", message(&refused));
}

/// A process that is killed on drop.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Runs and records the twin in real time, kills it once it has printed `lines` lines, and returns the last line's
/// sequence number.
fn killed(directory: &Path, lines: usize) -> u64 {
    let child = Command::new(env!("CARGO_BIN_EXE_dermis"))
        .args(["run", "--headless", "--record", "k.mcap"])
        .current_dir(directory)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn();
    let mut running = Running(child.expect("the command starts"));
    let output = BufReader::new(running.0.stdout.take().expect("a pipe"));
    let last = output.lines().take(lines).last().expect("a line").expect("text");
    running.0.kill().expect("it runs");
    running.0.wait().expect("it ends");
    let line: Value = serde_json::from_str(&last).expect("JSON");
    line["sequence"].as_u64().expect("a number")
}

#[test]
fn a_run_that_is_killed_loses_at_most_its_last_second() {
    // Moments spread over more than two flushes, at 25 frames/s: 1.0 to 2.5 s after the first frame; `DERMIS_KILLS`
    // adds more.
    let more: usize = std::env::var("DERMIS_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(0);
    let anywhere = (0..more).map(|k| 26 + (k * 37) % 60);
    for lines in [26, 35, 44, 60].into_iter().chain(anywhere) {
        let desk = tempfile::tempdir().expect("a directory");
        let printed = killed(desk.path(), lines);
        let partial = info(desk.path(), "k.partial.mcap");
        assert_eq!((&partial["whole"], &partial["cut_off"]), (&false.into(), &true.into()));
        let said = done(desk.path(), &["recover", "k.partial.mcap", "--out", "k.mcap"]);
        assert!(said.contains("at most its last second"), "{said}");
        let recovered = info(desk.path(), "k.mcap");
        assert_eq!((&recovered["whole"], &recovered["frames"]), (&true.into(), &partial["frames"]));
        // No duplicates: every number from first to last is either present or in a gap.
        let count = |key: &str| recovered[key].as_u64().expect("a count");
        assert_eq!(count("last") - count("first") + 1, count("frames") + count("missing"), "{recovered}");
        // The twin numbers its frames by the clock, 25 per second, whether or not this machine keeps up.
        let saved = recovered["last"].as_u64().expect("frames survive");
        println!("killed after {lines} lines: the last {} ms are missing", 40 * printed.saturating_sub(saved));
        assert!(printed.saturating_sub(saved) < 25, "frame {printed} was printed, {saved} is the last saved");
    }
}

/// Runs the command with file size limited to `kib` KiB, as on a disk that fills up.
fn on_a_small_disk(directory: &Path, kib: u32, arguments: &[&str]) -> Output {
    // The shell counts in blocks of 512 bytes. With the signal ignored, the write fails instead.
    let limit = format!("trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"", 2 * kib);
    Command::new("sh")
        .args(["-c", &limit, env!("CARGO_BIN_EXE_dermis")])
        .args(arguments)
        .current_dir(directory)
        .env_remove("DERMIS_LOG")
        .output()
        .expect("a shell")
}

/// A recording of the skin at rest with an instrument's noise, `frames` frames that don't compress.
fn resting(path: &Path, frames: u64) {
    let skin = dermis_skin::Skin::open("healing-square").expect("a built-in skin");
    let prepared = dermis_live::prepare::Prepared::new(skin).expect("a skin that meshes");
    let layout = dermis_device::Layout::Channels { count: prepared.channels() };
    let head = dermis_record::RecordingHead::of(&prepared, layout, "test");
    let mut recorder = dermis_record::Recorder::create(path, &head).expect("a recording");
    let mut state = 1_u64;
    let mut noise = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        1e-5 * ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5)
    };
    for sequence in 0..frames {
        let values = prepared.voltages.iter().map(|volts| volts * (1.0 + noise())).collect();
        let device_time_ns = Some(sequence * 1_000_000);
        let frame = dermis_device::Frame { sequence, device_time_ns, values, ..Default::default() };
        recorder.write_frame(&frame).expect("a frame");
    }
    recorder.finish(0).expect("a file");
}

#[cfg(unix)]
#[test]
fn a_full_disk_stops_the_recording_and_not_the_stream() {
    let desk = tempfile::tempdir().expect("a directory");
    resting(&desk.path().join("rest.mcap"), 3000);
    let source = ["--source", "rest.mcap", "--speed", "0"];
    // Five megabytes of readings, in chunks of one megabyte.
    let output =
        on_a_small_disk(desk.path(), 2500, &[&["run", "--headless", "--record", "a.mcap"], &source[..]].concat());
    let said = message(&output);
    assert_eq!(output.status.code(), Some(3), "{said}");
    assert_eq!(text(&output).lines().count(), 3000, "every frame has its line");
    assert!(said.contains("the recording has stopped: a.mcap: "), "{said}");
    let saved = info(desk.path(), "a.partial.mcap")["frames"].as_u64().expect("a count");
    assert!(saved > 100, "what fitted is there: {saved}");
    let stopped = info(desk.path(), "a.partial.mcap")["stopped"].as_str().map(str::to_owned);
    assert!(stopped.as_ref().is_some_and(|reason| reason.starts_with("a.mcap: ")), "{stopped:?}");
    let recovered = done(desk.path(), &["recover", "a.partial.mcap", "--out", "r.mcap"]);
    assert!(recovered.contains("stopped early") && !recovered.contains("killed"), "{recovered}");
    assert!(said.contains(&format!("not_recorded={}", 3000 - saved)), "{saved} saved: {said}");
    assert!(!desk.path().join("a.mcap").exists());

    // A command that only records has nothing left to do and stops.
    let output = on_a_small_disk(desk.path(), 2500, &[&["record", "--out", "b.mcap"], &source[..]].concat());
    assert_eq!(output.status.code(), Some(3), "{}", message(&output));
    assert!(message(&output).contains("frames were lost") && text(&output).contains("lost"), "{}", message(&output));
}

#[test]
fn every_command_that_reads_a_damaged_recording_reports_it_and_exits_with_3() {
    let desk = tempfile::tempdir().expect("a directory");
    resting(&desk.path().join("whole.mcap"), 1500);
    let whole = std::fs::read(desk.path().join("whole.mcap")).expect("a file");
    std::fs::write(desk.path().join("cut.mcap"), &whole[..whole.len() / 2]).expect("a file");
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 4;
    std::fs::write(desk.path().join("flipped.mcap"), flipped).expect("a file");
    for (file, code) in [("whole.mcap", 0), ("cut.mcap", 3), ("flipped.mcap", 3)] {
        for command in [
            &["run", "--headless", "--only-touches", "--speed", "0", "--source", file][..],
            &["record", "--speed", "0", "--out", "again.mcap", "--source", file],
            &["replay", file, "--only-touches"],
            &["export", file, "--out", "table.csv"],
        ] {
            let output = dermis(desk.path(), command);
            let said = message(&output);
            assert_eq!(output.status.code(), Some(code), "{command:?}: {said}");
            assert!(code == 0 || said.contains("ERROR"), "{command:?}: {said}");
            let is_named = said.contains(&format!("{file}: parts could not be read"));
            assert!(code == 0 || command[0] == "replay" || is_named, "{command:?}: {said}");
            for made in ["again.mcap", "table.csv"] {
                // Each of the commands makes only one of these files.
                let _ = std::fs::remove_file(desk.path().join(made));
            }
        }
    }
}

#[test]
fn a_recording_of_another_skin_is_refused_with_both_names_by_every_command() {
    let desk = tempfile::tempdir().expect("a directory");
    resting(&desk.path().join("h.mcap"), 40);
    let shown = dermis(desk.path(), &["skins", "show", "healing-square"]);
    let doubled = text(&shown).replace("side_mm = 100.0", "side_mm = 200.0").replace("healing-square", "doubled");
    std::fs::write(desk.path().join("doubled.toml"), doubled).expect("a file");
    let run = ["--headless", "--speed", "0", "--only-touches", "--source", "h.mcap"];
    let reconstruct = ["--baseline", "h.mcap", "--frames", "h.mcap", "--touches", "t.csv"];
    for skin in ["ionic-disc", "doubled.toml"] {
        let name = skin.trim_end_matches(".toml");
        for command in
            [[&["run", skin][..], &run[..]].concat(), [&["reconstruct", skin][..], &reconstruct[..]].concat()]
        {
            let output = dermis(desk.path(), &command);
            let said = message(&output);
            assert!(matches!(output.status.code(), Some(1 | 2)), "{command:?}: {said}");
            assert!(said.contains("healing-square") && said.contains(name), "{command:?}: {said}");
            assert!(said.contains("--as-skin") && said.contains("differ"), "{command:?}: {said}");
        }
    }
    // Both have 208 channels, so the frames can be read as the other skin's on request.
    let insisted = [&["run", "doubled.toml", "--as-skin"][..], &run[..]].concat();
    let output = dermis(desk.path(), &insisted);
    assert_eq!(output.status.code(), Some(0), "{}", message(&output));
    for command in [[&["run", "healing-square"][..], &run[..]].concat(), [&["run"][..], &run[..]].concat()] {
        let output = dermis(desk.path(), &command);
        assert_eq!(output.status.code(), Some(0), "{command:?}: {}", message(&output));
    }
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_is_full_from_the_start_is_refused() {
    let desk = tempfile::tempdir().expect("a directory");
    let output = dermis(desk.path(), &["record", "--frames", "1", "--out", "/dev/full"]);
    assert_eq!(output.status.code(), Some(1), "{}", message(&output));
    assert!(message(&output).contains("/dev/full: "), "{}", message(&output));
}

#[test]
fn the_replay_counts_the_sources_losses() {
    let desk = tempfile::tempdir().expect("a directory");
    let skin = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../dermis-skin/skins/healing-square.toml");
    let skin = std::fs::read_to_string(skin).expect("a skin file");
    std::fs::write(desk.path().join("lossy.toml"), lossy(&skin)).expect("a file");
    let recorded = dermis(desk.path(), &[&["record", "lossy.toml", "--out", "a.mcap"], &QUICK[..]].concat());
    assert_eq!(recorded.status.code(), Some(3), "{}", message(&recorded));
    let found = info(desk.path(), "a.mcap");
    let missing = found["missing"].as_u64().expect("a count");
    assert!(missing > 0 && found["events"].to_string().contains("gap"), "{found}");
    let replay = dermis(desk.path(), &["replay", "a.mcap"]);
    assert_eq!(replay.status.code(), Some(3), "{}", message(&replay));
    assert!(message(&replay).contains(&format!("lost={missing}")), "{}", message(&replay));
}

/// The skin with a twin that loses frames.
fn lossy(skin: &str) -> String {
    skin.replacen("[twin]\n", "[twin]\nfaults = [{ dropped_share = 0.1 }]\n", 1)
}

/// Sends a running command the signal that Ctrl-C sends.
#[cfg(unix)]
fn interrupt(running: &Running) {
    let sent = Command::new("kill").args(["-INT", &running.0.id().to_string()]).status();
    assert!(sent.expect("a kill command").success());
}

#[cfg(unix)]
fn recording(directory: &Path, seconds: &str) -> Running {
    let child = Command::new(env!("CARGO_BIN_EXE_dermis"))
        .args(["record", "--seconds", seconds, "--out", "a.mcap"])
        .current_dir(directory)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    Running(child.expect("the command starts"))
}

#[cfg(unix)]
fn wait_for(file: &Path) {
    for _ in 0..3000 {
        if file.exists() {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    panic!("{} never came", file.display());
}

#[cfg(unix)]
#[test]
fn a_file_that_appears_in_the_meantime_is_not_replaced() {
    let desk = tempfile::tempdir().expect("a directory");
    let mut running = recording(desk.path(), "3");
    wait_for(&desk.path().join("a.partial.mcap"));
    std::fs::write(desk.path().join("a.mcap"), "another program's").expect("a file");
    let ended = running.0.wait().expect("it ends");
    assert_eq!(ended.code(), Some(3));
    let mut said = String::new();
    std::io::Read::read_to_string(&mut running.0.stderr.take().expect("a pipe"), &mut said).expect("text");
    assert!(said.contains("not replaced") && said.contains("a.partial.mcap"), "{said}");
    assert_eq!(std::fs::read(desk.path().join("a.mcap")).expect("a file"), b"another program's");
    let kept = info(desk.path(), "a.partial.mcap");
    assert_eq!((&kept["whole"], &kept["stopped"]), (&true.into(), &Value::Null));
}

#[cfg(unix)]
#[test]
fn an_interruption_at_any_moment_leaves_a_complete_recording_or_none() {
    for milliseconds in [1, 60, 150, 300, 500, 1200] {
        let desk = tempfile::tempdir().expect("a directory");
        let mut running = recording(desk.path(), "20");
        std::thread::sleep(std::time::Duration::from_millis(milliseconds));
        interrupt(&running);
        let ended = running.0.wait().expect("it ends");
        // If the command hasn't installed its handler yet, the signal kills it; nothing has been written then either.
        assert!(matches!(ended.code(), Some(0 | 130) | None), "after {milliseconds} ms: {ended:?}");
        assert!(!desk.path().join("a.partial.mcap").exists(), "after {milliseconds} ms a partial file is left");
        if desk.path().join("a.mcap").exists() {
            assert_eq!(info(desk.path(), "a.mcap")["whole"], true);
        }
    }
}

#[cfg(unix)]
#[test]
fn the_second_interruption_ends_it_with_the_recording_whole() {
    let desk = tempfile::tempdir().expect("a directory");
    let mut running = recording(desk.path(), "60");
    wait_for(&desk.path().join("a.partial.mcap"));
    std::thread::sleep(std::time::Duration::from_millis(300));
    interrupt(&running);
    interrupt(&running);
    let ended = running.0.wait().expect("it ends");
    assert!(matches!(ended.code(), Some(0 | 130)), "{ended:?}");
    assert_eq!(info(desk.path(), "a.mcap")["whole"], true);
}
