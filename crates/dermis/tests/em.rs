//! The EM-skins from file to touches: their files and twins agree, single presses are found under model and measured
//! Jacobian.

use dermis::experiments::Rig;
use dermis_twin::mechanics::{Indenter, Load, Shape};

fn press(centre_m: [f64; 2], radius_m: f64, force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m }, load: Load::ForceN(force_n) }
}

#[test]
fn look() {
    let name = std::env::var("SKIN").unwrap_or("em-8".into());
    let (n, pitch, force) = if name == "em-8" { (5, 0.02, 2.0) } else { (8, 0.035, 4.0) };
    let mut rig = Rig::new(&name).unwrap();
    for k in 0..n * n {
        let at = |i: usize| (i as f64 - 0.5 * (n as f64 - 1.0)) * pitch;
        let place = [at(k % n), at(k / n)];
        let frame = rig.mean_frame(&[press(place, 0.005, force)], 1).unwrap();
        let image = rig.image(&frame).unwrap();
        let (peak, value) = rig.peak(&image);
        let found = rig.touches(&image).unwrap();
        let error = found.first().map(|c| 1e3 * (c.centroid_m[0] - place[0]).hypot(c.centroid_m[1] - place[1]));
        let off = 1e3 * (peak[0] - place[0]).hypot(peak[1] - place[1]);
        println!("{k} peak {value:.3} off {off:.1} mm, touches {} off {error:.1?}", found.len());
    }
}
