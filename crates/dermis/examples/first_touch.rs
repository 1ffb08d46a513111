//! A first touch: reads a skin's twin and prints the touches. `cargo run --release -p dermis --example first_touch`

use dermis::{Error, Session, Skin, TouchPhase};

/// Prints the touches of a skin's twin.
pub fn main() -> Result<(), Error> {
    let skin = Skin::open("healing-square")?;
    // For a real skin, open its own file above and use "tcp:10.0.0.5:4000", "serial:/dev/ttyACM0", a recording or a
    // CSV file here.
    let source = "twin";
    let mut begun = 0;
    // The first 32 frames make the baseline. Don't touch a real skin during that time.
    for frame in Session::open(source, skin)?.take(200) {
        let frame = frame?;
        for touch in frame.touches.iter().chain(frame.ended.iter()) {
            let [x, y] = touch.position_m.map(|m| 1e3 * m);
            match touch.phase {
                TouchPhase::Begin => {
                    begun += 1;
                    println!("{:.2} s: touch {} begins at ({x:.1}, {y:.1}) mm", frame.time_s, touch.id);
                }
                TouchPhase::End => println!("{:.2} s: touch {} ends", frame.time_s, touch.id),
                TouchPhase::Move => {}
            }
        }
    }
    println!("{begun} touches");
    assert!(begun > 0, "the twin demonstrates touches by itself");
    Ok(())
}
