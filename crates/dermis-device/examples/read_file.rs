//! Reads a file of frames, and prints how it was understood and how long that took:
//! `cargo run --release -p dermis-device --example read_file -- press.csv`.

use std::time::Instant;

use dermis_device::{FileSpec, read};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let name = std::env::args().nth(1).ok_or("expected a file")?;
    let bytes = std::fs::metadata(&name)?.len();
    let begin = Instant::now();
    let frames = read(&FileSpec::all(&name), None)?;
    let elapsed_s = begin.elapsed().as_secs_f64();
    println!("{name}: {}", frames.understood());
    println!("{:.0} MB/s, {elapsed_s:.3} s", 1e-6 * bytes as f64 / elapsed_s);
    Ok(())
}
