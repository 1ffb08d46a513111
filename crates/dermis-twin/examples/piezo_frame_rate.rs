//! Prints the time per frame of the piezoresistive skins with two moving touches, and the size of their signals:
//! `cargo run --release -p dermis-twin --example piezo_frame_rate`.

#[path = "../tests/published/mod.rs"]
mod published;

use std::time::Instant;

use dermis_twin::TwinError;
use published::{piezo_disc, piezo_square, piezo_twin};

fn main() -> Result<(), TwinError> {
    for (name, options) in [("square", piezo_square()), ("disc", piezo_disc())] {
        let start = Instant::now();
        let mut twin = piezo_twin(options)?;
        let (elements, cells) = (twin.frontend().body().mesh.element_count(), twin.frontend().cells().len());
        let spent = 1e3 * start.elapsed().as_secs_f64();
        println!("{name}: {elements} elements, {cells} contact cells, prepared in {spent:.0} ms");
        let mut rest = Vec::new();
        twin.step(0.0, &mut rest)?;
        let (mut frame, mut total, mut slowest, mut touching) = (Vec::new(), 0.0, 0.0_f64, 0);
        for step in 0..100 {
            let turn = 0.05 * f64::from(step);
            let (x, y) = (0.035 * turn.cos(), 0.035 * turn.sin());
            twin.scene_mut().press(0, x, y, 0.011, 10e3)?;
            twin.scene_mut().press(1, -x, -y, 0.011, 10e3)?;
            let start = Instant::now();
            twin.step(1.0 + f64::from(step) / 30.0, &mut frame)?;
            let spent = start.elapsed().as_secs_f64();
            (total, slowest, touching) = (total + spent, slowest.max(spent), twin.frontend().sheet().touching());
        }
        println!("two touches, {touching} cells: {:.0} frames/s, slowest frame {:.1} ms", 100.0 / total, 1e3 * slowest);
        let size = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).fold(0.0, f64::max);
        let largest = size(&mut rest.iter().copied());
        let change = size(&mut frame.iter().zip(&rest).map(|(v, v0)| v - v0));
        println!("at rest {:.1} mV at most, changed by {:.2} mV at most", 1e3 * largest, 1e3 * change);
    }
    Ok(())
}
