//! The book's sketch for EIT kits compiles with stubs of the Arduino headers, speaks the wire protocol, accepts a
//! skin's list of channels, and measures each channel at the electrodes in the list.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use dermis::{Error, Session};
use dermis_skin::{Layer, ListedChannel, Reads, Shape, SheetLayer, Skin};

/// Stops the sketch when the test ends.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// 16 electrodes, with pairs and mixtures in no particular order.
fn skin() -> (Skin, Vec<[u32; 4]>) {
    let four =
        |k: u32| [k * 7 % 16 + 1, (k * 7 + 3 + k % 5) % 16 + 1, (k * 5 + 1) % 16 + 1, (k * 5 + 2 + k % 3) % 16 + 1];
    let list: Vec<[u32; 4]> = (0..120).map(four).filter(|c| c[0] != c[1] && c[2] != c[3]).collect();
    let layer = Layer::Sheet(SheetLayer::gel(5.0, 0.3));
    let mut skin = Skin::new("kit", Shape::Disc { diameter_mm: 120.0 }, layer)
        .with_rim_electrodes(16, 6.0)
        .with_channels(list.iter().copied().map(ListedChannel::Pairs).collect());
    skin.backend.frequency_khz = Some(5.0);
    skin.backend.reads = Reads::Magnitude;
    skin.imaging.elements = 600;
    skin.imaging.grid = 24;
    (skin.checked().unwrap(), list)
}

#[test]
fn the_sketch_of_eit_kits_measures_a_skin_s_own_list() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let folder = tempfile::tempdir().unwrap();
    let program = folder.path().join("eit_kit");
    let stubs = here.join("tests/eit_kit");
    let made = Command::new("g++")
        .args(["-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-I"])
        .arg(&stubs)
        .arg("-I")
        .arg(here.join("../../docs/src/sketches/eit_kit"))
        .arg(stubs.join("main.cpp"))
        .arg("-o")
        .arg(&program)
        .output();
    let Ok(made) = made else {
        return dermis_testdata::skip("this machine has no g++");
    };
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    let mut running = Running(Command::new(&program).stdout(Stdio::piped()).spawn().unwrap());
    let mut port = String::new();
    BufReader::new(running.0.stdout.take().unwrap()).read_line(&mut port).unwrap();
    let (skin, list) = skin();
    let mut session = Session::open(&format!("tcp:127.0.0.1:{}", port.trim()), skin).unwrap();
    let frames = session.by_ref().take(34).collect::<Result<Vec<_>, Error>>().unwrap();
    assert!(frames.windows(2).all(|pair| pair[1].sequence == pair[0].sequence + 1));
    let (rest, _) = session.pipeline().baseline();
    assert_eq!(rest.len(), list.len());
    for (value, [sink, source, plus, minus]) in rest.iter().zip(&list) {
        let [sink, source, plus, minus] = [sink, source, plus, minus].map(|number| f64::from(*number) - 1.0);
        let counts = 100.0 + 40.0 * source + 20.0 * sink + 10.0 * plus + 5.0 * minus;
        // 12 bits, 3.3 V, gain 10. Samples are at most a microsecond late.
        let expected = counts * 3.3 / (4095.0 * 10.0);
        assert!((value.abs() - expected).abs() < 0.02 * expected, "{value} V, expected {expected} V");
    }
}
