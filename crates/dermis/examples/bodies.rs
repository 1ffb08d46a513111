//! Makes `crates/dermis-mit/bodies.json`, the responses of the built-in skins' elements, with edge elements: `cargo
//! run --release -p dermis --example bodies > crates/dermis-mit/bodies.json`. Times go to standard error.

use std::time::Instant;

use dermis_mit::catalogue::SWEEP_HZ;
use dermis_skin::Skin;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    println!("[");
    let last = SWEEP_HZ.len() - 1;
    for (name, end) in [("em-8", ","), ("em-16-circular", "")] {
        let element = Skin::open(name)?.element().ok_or("a skin without elements")?;
        for (k, frequency_hz) in SWEEP_HZ.into_iter().enumerate() {
            let start = Instant::now();
            let record = dermis_mit::catalogue::compute(&element, frequency_hz)?;
            let comma = if k == last { end } else { "," };
            println!("{}{comma}", serde_json::to_string(&record)?);
            eprintln!("{name} {frequency_hz} Hz: {:.2} s", start.elapsed().as_secs_f64());
        }
    }
    println!("]");
    Ok(())
}
