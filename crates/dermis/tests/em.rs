//! The EM-skins from file to touches: their files and twins agree, single presses are found under model and measured
//! Jacobian.

use dermis::experiments::Rig;
use dermis::skin::Skin;
use dermis_twin::mechanics::{Indenter, Load, Shape};

fn press(centre_m: [f64; 2], radius_m: f64, force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m }, load: Load::ForceN(force_n) }
}

#[test]
fn look() {
    let name = std::env::var("SKIN").unwrap_or("em-8".into());
    let force: f64 = std::env::var("FORCE").map_or(2.0, |f| f.parse().unwrap());
    let count: usize = std::env::var("COUNT").map_or(1, |f| f.parse().unwrap());
    let places = Skin::open(&name).unwrap().frontend.elements.unwrap().places_m();
    let mut rig = Rig::new(&name).unwrap();
    let (mut sum, mut worst, mut extra) = (0.0_f64, 0.0_f64, 0);
    for place in &places {
        let frame = rig.mean_frame(&[press(*place, 0.005, force)], count).unwrap();
        let image = rig.image(&frame).unwrap();
        let (peak, value) = rig.peak(&image);
        let found = rig.touches(&image).unwrap();
        let off = found.first().map_or(99.0, |c| 1e3 * (c.centroid_m[0] - place[0]).hypot(c.centroid_m[1] - place[1]));
        print!("{value:.2}/{off:.1}/{} ", found.len());
        let off = 1e3 * (peak[0] - place[0]).hypot(peak[1] - place[1]);
        (sum, worst, extra) = (sum + off, worst.max(off), extra + found.len().abs_diff(1));
    }
    println!("\nRESULT peak off mean {:.2} worst {worst:.2}, extra {extra}", sum / places.len() as f64);
    let pairs = [[0, 1], [6, 7], [6, 8], [0, 2], [11, 13]];
    for pair in pairs {
        let indenters = pair.map(|k| press(places[k], 0.005, force));
        let frame = rig.mean_frame(&indenters, count).unwrap();
        let image = rig.image(&frame).unwrap();
        let at: Vec<_> = rig.touches(&image).unwrap().iter().map(|c| c.centroid_m.map(|v| (1e3 * v).round())).collect();
        println!("pair {:?}: {at:?}", pair.map(|k| places[k].map(|v| 1e3 * v)));
    }
}
