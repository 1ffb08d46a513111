//! Touches placed by the forward model, on twins whose mesh and physics differ from the model's.

use dermis_lab::twin_bench::Rig;
use dermis_live::imager::Imager;
use dermis_live::prepare::Prepared;
use dermis_live::reference::Reference;
use dermis_live::stages::refinement::Refinement;
use dermis_live::stages::spot_model::spot_model;
use dermis_live::stages::touches::TouchStage;
use dermis_skin::Skin;
use dermis_tomo::mesh::distance;
use dermis_twin::TwinKit;
use dermis_twin::mechanics::{Indenter, Load, Shape};

/// Mean and maximum, millimetres.
fn figures(errors_mm: &[f64]) -> (f64, f64) {
    let sum: f64 = errors_mm.iter().sum();
    (sum / errors_mm.len() as f64, errors_mm.iter().copied().fold(0.0, f64::max))
}

fn distance_mm(a: [f64; 2], b: [f64; 2]) -> f64 {
    1e3 * distance(a, b)
}

fn press(centre_m: [f64; 2], radius_m: f64, force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m }, load: Load::ForceN(force_n) }
}

struct Errors {
    /// Errors of the image's centroid.
    image_mm: Vec<f64>,
    /// Errors of the fitted position.
    refined_mm: Vec<f64>,
    /// Errors of the position fitted to a noise-free frame: the model error.
    model_mm: Vec<f64>,
    /// Lower bounds at the instrument's noise.
    bound_mm: Vec<f64>,
}

/// Presses like those of experiment I2: three radii, four directions, several forces.
fn errors(name: &str, radius_m: f64, forces_n: &[f64]) -> Errors {
    let mut rig = Rig::new(name).unwrap();
    let skin = Skin::open(name).unwrap();
    let half = rig.prepared().half_width_m();
    let model = spot_model(rig.prepared(), &rig.reference().noise).unwrap();
    let mut scratch = model.scratch();
    let (mut clean_twin, _, _) = TwinKit::of(&skin).unwrap().twin.into_parts();
    let mut rest = vec![0.0; clean_twin.channel_count()];
    clean_twin.voltages(&[], 0.1, &mut rest).unwrap();
    let scale = rig.reference().scale.clone();
    let mut plain = TouchStage::new(rig.prepared(), rig.noise_image()).unwrap();
    let mut all = Errors { image_mm: Vec::new(), refined_mm: Vec::new(), model_mm: Vec::new(), bound_mm: Vec::new() };
    let mut time_ns = 0;
    for (ring, direction) in [0.0, 0.34, 0.69].iter().flat_map(|ring| (0..4).map(move |k| (*ring, k))) {
        let angle = 0.4 + 1.7 * f64::from(direction);
        let place = [half * ring * angle.cos(), half * ring * angle.sin()];
        for &force_n in forces_n {
            let indenter = press(place, radius_m, force_n);
            let frame = rig.mean_frame(&[indenter], 1).unwrap();
            let image = rig.image(&frame).unwrap();
            time_ns += 1_000_000_000;
            plain.forget(time_ns);
            plain.process(time_ns, &image, None).unwrap();
            let seen = plain.contacts()[0].centroid_m;
            let refined = rig.touches(&image).unwrap()[0];
            // A press across patches may keep the image's position.
            assert!(refined.radius_m.is_some() || name.starts_with("piezo"), "{name}: not refined at {place:?}");
            all.image_mm.push(distance_mm(seen, place));
            all.refined_mm.push(distance_mm(refined.centroid_m, place));
            let mut clean = vec![0.0; rest.len()];
            clean_twin.voltages(&[indenter], 0.1, &mut clean).unwrap();
            let difference: Vec<f64> = (0..clean.len()).map(|c| scale[c] * (clean[c] - rest[c])).collect();
            let outcome = model.fit(&difference, &[seen], &mut scratch).unwrap();
            let spot = scratch.spots()[0];
            all.model_mm.push(distance_mm(spot.position_m, place));
            let variance = (spot.covariance[0][0] + spot.covariance[1][1]) / outcome.residual.max(1.0);
            all.bound_mm.push(1e3 * variance.sqrt());
            clean_twin.voltages(&[], 1e3, &mut clean).unwrap();
        }
        rig.frames(&[], 30).unwrap();
    }
    println!(
        "{name}: image {:.2?}, refined {:.2?}, model {:.2?}, bound {:.2?} mm (mean, largest)",
        figures(&all.image_mm),
        figures(&all.refined_mm),
        figures(&all.model_mm),
        figures(&all.bound_mm)
    );
    all
}

/// Checks that the mean error is at most twice the combined effect of noise and model, and at most the given share of
/// the image's own error.
fn check(name: &str, radius_m: f64, forces_n: &[f64], share: f64) {
    let all = errors(name, radius_m, forces_n);
    let expected: Vec<f64> = all.model_mm.iter().zip(&all.bound_mm).map(|(m, b)| m.hypot(*b)).collect();
    let (mean, largest) = figures(&all.refined_mm);
    assert!(mean <= 2.0 * figures(&expected).0, "{name}: {mean} mm, expected {:?}", figures(&expected));
    let (image_mean, image_largest) = figures(&all.image_mm);
    assert!(mean <= share * image_mean && largest <= share.max(0.9) * image_largest, "{name}: {mean} {largest}");
}

#[test]
fn the_liquid_disc_places_presses_four_times_as_well_as_its_image() {
    // Measured: from 1.97 to 0.31 mm on average, from 4.2 to 1.4 mm at most. The model error was 0.33 mm with the
    // linear model and is now 0.09 mm.
    check("ionic-disc", 0.01, &[0.128, 0.255, 0.57], 0.25);
}

#[test]
fn the_sandwich_places_presses_four_times_as_well_as_its_image() {
    // Measured: from 0.77 to 0.17 mm on average, from 1.4 to 1.1 mm at most.
    check("healing-square", 0.01, &[8.0, 25.0], 0.25);
}

#[test]
fn the_force_of_a_press_under_a_membrane_does_not_depend_on_its_radius() {
    // A narrow press makes a deeper dent for its force, and the response to large dents is nonlinear. Measured: 2.5 to
    // 5 % too low, since 5 % of a load acts late.
    let mut rig = Rig::new("ionic-disc").unwrap();
    for (radius_m, force_n) in [(0.005, 0.2), (0.01, 0.4), (0.01, 1.0), (0.02, 1.0)] {
        let frame = rig.mean_frame(&[press([0.02, -0.03], radius_m, force_n)], 1).unwrap();
        let image = rig.image(&frame).unwrap();
        let found_n = rig.touches(&image).unwrap()[0].force.and_then(|force| force.nearest_n()).unwrap();
        println!("{force_n} N on {radius_m} m: {found_n:.3} N");
        assert!((found_n / force_n - 1.0).abs() < 0.07, "{force_n} N on {radius_m} m: {found_n} N");
        rig.frames(&[], 30).unwrap();
    }
}

#[test]
fn patches_are_placed_no_worse() {
    // A 10 mm patch conducts as a whole, so its centre isn't the indenter's. A fit of a smooth spot cannot know this.
    check("piezo-disc", 0.011, &[0.3, 1.0], 1.1);
}

#[test]
fn frame_faults_contain_no_press() {
    let prepared = Prepared::new(Skin::open("piezo-square").unwrap()).unwrap();
    let reference = Reference::from_baseline(&prepared, &prepared.voltages, None).unwrap();
    let mut imager = Imager::new(&prepared, &reference, &[]).unwrap();
    let touched: Vec<f64> = prepared.signatures(&[[0.02, 0.01]]).iter().map(|v| 0.2 * v).collect();
    let mut image = vec![f32::NAN; prepared.map.grid().len()];
    let mut stage = TouchStage::new(&prepared, imager.noise_image()).unwrap();
    let mut refinement = Refinement::new(&prepared, &reference.noise).unwrap();
    let mut places = |difference: &[f64], time_s: u64| -> Vec<[f64; 2]> {
        let time_ns = time_s * 1_000_000_000;
        imager.image(difference, &mut image).unwrap();
        stage.find_contacts(&image, None).unwrap();
        refinement.refine(time_ns, &imager, &image, stage.contacts_mut()).unwrap();
        stage.track_contacts(time_ns).unwrap();
        assert!(stage.contacts().iter().all(|contact| contact.radius_m.is_some()));
        stage.contacts().iter().map(|contact| contact.centroid_m).collect()
    };
    let found = places(&touched, 1);
    assert!(found.len() == 1 && distance_mm(found[0], [0.02, 0.01]) < 0.1, "{found:?}");
    let channels = prepared.channels();
    let odd = [vec![0.0; channels], vec![1e6; channels], touched.iter().map(|v| -v).collect()];
    for (k, difference) in odd.iter().enumerate() {
        let found = places(difference, 2 + k as u64);
        assert!(found.is_empty(), "{k}: {found:?}");
    }
    assert_eq!(places(&touched, 9).len(), 1, "a touch after odd frames");
}
