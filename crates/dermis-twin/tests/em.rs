//! The EM-skins as a whole: what a press does to which pairs of coils, symmetry, and what is refused.

use std::time::Instant;

use dermis_tomo::mit::CoilArray;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{EmOptions, EmSkin, Frontend, Twin};

fn even(options: EmOptions) -> EmSkin {
    EmSkin::new(&EmOptions { tolerance_m: 0.0, memory: None, ..options }).unwrap()
}

fn press(centre_m: [f64; 2], force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m: 0.005 }, load: Load::ForceN(force_n) }
}

fn frame(skin: &mut EmSkin, indenters: &[Indenter]) -> Vec<f64> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.1, &mut frame).unwrap();
    frame
}

#[test]
fn look() {
    for options in [EmOptions::em_8(), EmOptions::em_16_circular(), EmOptions::em_16_square()] {
        let start = Instant::now();
        let mut skin = even(options.clone());
        println!("{:?} made in {:?}", options.array, start.elapsed());
        let rest = frame(&mut skin, &[]);
        let start = Instant::now();
        let at = skin.places_m()[options.per_side + 1];
        let pressed = frame(&mut skin, &[press(at, 2.0)]);
        println!("frame {:?}, travel {:?}", start.elapsed(), skin.travel_m()[options.per_side + 1]);
        let least = rest.iter().copied().fold(f64::INFINITY, f64::min);
        let most = rest.iter().copied().fold(0.0, f64::max);
        let mut relative: Vec<f64> = rest.iter().zip(&pressed).map(|(r, p)| p / r - 1.0).collect();
        relative.sort_by(|a, b| b.abs().total_cmp(&a.abs()));
        println!("rest {least:.2e} to {most:.2e} V, relative changes {:?}", &relative[..10]);
        println!("noise {:e}", options.instrument.noise.proportional);
    }
    let _ = CoilArray::em_8();
    let _ = Twin::em(&EmOptions::em_8());
}
