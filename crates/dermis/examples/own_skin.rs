//! A skin of your own in code: a gel of 150 x 60 mm with 20 electrodes, its file, and how accurately presses on its
//! twin are found. `cargo run --release -p dermis --example own_skin`

use dermis::skin::{Layer, SheetLayer};
use dermis::twin::press_range;
use dermis::{Error, Session, Skin};

/// Makes a skin in code and presses its twin.
pub fn main() -> Result<(), Error> {
    let gel = Layer::Sheet(SheetLayer::gel(5.0, 0.2));
    let skin = Skin::rectangle("my-gel", 150.0, 60.0, gel).with_rim_electrodes(20, 5.0).checked()?;
    println!("{}", skin.to_toml());

    let usual = press_range(&skin);
    let mut session = Session::open("twin", skin)?;
    // The baseline: frames of the untouched skin.
    while session.pipeline().reference().is_none() {
        session.next_borrowed()?;
    }
    let mut worst_mm: f64 = 0.0;
    for place in [[0.0, 0.0], [0.05, 0.01], [-0.03, -0.015]] {
        session.press(place, usual.initial_radius_m, usual.initial_pressure_pa)?;
        let held = session.by_ref().take(60).collect::<Result<Vec<_>, _>>()?;
        session.release()?;
        session.by_ref().take(60).try_for_each(|frame| frame.map(|_| ()))?;
        let touches = held.last().map_or(&[][..], |frame| &frame.touches[..]);
        let distance = |p: [f64; 2]| 1e3 * (p[0] - place[0]).hypot(p[1] - place[1]);
        let error_mm = touches.iter().map(|touch| distance(touch.position_m)).fold(f64::INFINITY, f64::min);
        let [x, y] = place.map(|m| 1e3 * m);
        println!("pressed at ({x:.0}, {y:.0}) mm: found within {error_mm:.1} mm");
        worst_mm = worst_mm.max(error_mm);
    }
    assert!(worst_mm < 6.0, "a tenth of the shorter side, with no calibration");
    Ok(())
}
