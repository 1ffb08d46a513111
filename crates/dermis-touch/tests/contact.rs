//! Measurements of the contact finder, and what it splits and ignores.

mod common;

use common::{Noise, bell, cut_disc, distance_mm, paint, square};
use dermis_touch::{
    CentroidWeight, Contact, ContactFinder, ContactParams, ContactSign, ContactSigns, ContactStrength, PixelNoise,
    TouchError,
};
use proptest::prelude::*;

fn find_with(params: ContactParams, image: &[f32], sigma: f32) -> Vec<Contact> {
    let mut contacts = Vec::new();
    let mut finder = ContactFinder::new(square(), params).unwrap();
    finder.find(image, PixelNoise::Uniform(sigma), &mut contacts).unwrap();
    contacts
}

fn find(image: &[f32], sigma: f32) -> Vec<Contact> {
    find_with(ContactParams::default(), image, sigma)
}

#[test]
fn a_bell_is_measured() {
    let contacts = find(&paint(&square(), &[bell(12.3, -20.7, 8.0, 2.0)]), 0.01);
    assert_eq!(contacts.len(), 1);
    let touch = contacts[0];
    // A quadratic through pixels of a quarter sigma misses a Gaussian's peak by less than a hundredth of a pixel, and
    // the centroid of a pixelated half-height region by less than a tenth.
    assert!(distance_mm(touch.peak_m, [0.0123, -0.0207]) < 0.02, "{:?}", touch.peak_m);
    assert!(distance_mm(touch.centroid_m, [0.0123, -0.0207]) < 0.2, "{:?}", touch.centroid_m);
    assert!((touch.peak_value - 2.0).abs() < 1e-3);
    // The region above one half of exp(-r^2 / (2 s^2)) is a disc of area 2 ln 2 pi s^2, counted in pixels of 4 mm^2.
    let area = 2.0 * std::f64::consts::LN_2 * std::f64::consts::PI * 64e-6;
    assert!((touch.area_m2 / area - 1.0).abs() < 0.05, "{}", touch.area_m2 / area);
    // Half of a Gaussian's volume 2 pi s^2 h is above half its height.
    let volume = std::f64::consts::PI * 64e-6 * 2.0;
    assert!((touch.volume / volume - 1.0).abs() < 0.05, "{}", touch.volume / volume);
    assert_eq!(touch.strength, ContactStrength::Strong);
    assert!((touch.significance - 200.0).abs() < 2.0);
}

#[test]
fn all_centroid_weights_agree_on_a_symmetric_touch() {
    let image = paint(&square(), &[bell(5.0, 7.0, 8.0, 1.0)]);
    for centroid in [CentroidWeight::Uniform, CentroidWeight::Value, CentroidWeight::Excess] {
        let contacts = find_with(ContactParams { centroid, ..Default::default() }, &image, 0.01);
        // Within a tenth of a pixel.
        assert!(distance_mm(contacts[0].centroid_m, [0.005, 0.007]) < 0.2, "{centroid:?}");
    }
}

#[test]
fn thresholds_follow_the_noise() {
    let image = paint(&square(), &[bell(0.0, 0.0, 8.0, 1.0)]);
    let strength = |sigma: f32| find(&image, sigma).first().map(|contact| contact.strength);
    assert_eq!(strength(0.19), Some(ContactStrength::Strong));
    assert_eq!(strength(0.21), Some(ContactStrength::Weak));
    assert_eq!(strength(0.34), None);
}

#[test]
fn side_lobes_are_ignored_and_real_neighbours_are_not() {
    let peaks =
        |height: f64| find(&paint(&square(), &[bell(-30.0, 0.0, 8.0, 1.0), bell(30.0, 0.0, 8.0, height)]), 0.001);
    assert_eq!(peaks(0.1).len(), 1);
    let weak: Vec<_> = peaks(0.2).iter().map(|contact| contact.strength).collect();
    assert_eq!(weak, [ContactStrength::Strong, ContactStrength::Weak]);
    assert!(peaks(0.4).iter().all(|contact| contact.strength == ContactStrength::Strong));
}

#[test]
fn two_touches_part_at_their_saddle() {
    let count = |gap_mm: f64| {
        let touches = [bell(-gap_mm / 2.0, 1.0, 8.0, 1.0), bell(gap_mm / 2.0, 1.0, 8.0, 0.9)];
        find(&paint(&square(), &touches), 0.01).len()
    };
    assert_eq!(count(14.0), 1);
    assert_eq!(count(18.0), 1); // The saddle is still above three quarters.
    assert_eq!(count(26.0), 2);
    let near = ContactParams { min_separation_m: 0.03, ..Default::default() };
    let touches = [bell(-13.0, 1.0, 8.0, 1.0), bell(13.0, 1.0, 8.0, 0.9)];
    assert_eq!(find_with(near, &paint(&square(), &touches), 0.01).len(), 1);
}

#[test]
fn four_touches_are_located() {
    let touches =
        [bell(30.0, 30.0, 6.0, 1.0), bell(-30.0, 30.0, 6.0, 0.8), bell(0.0, -30.0, 6.0, 0.6), bell(0.0, 5.0, 6.0, 0.5)];
    let contacts = find(&paint(&square(), &touches), 0.01);
    assert_eq!(contacts.len(), 4);
    for (contact, touch) in contacts.iter().zip(&touches) {
        // Tails of the neighbours shift a centroid by less than half a millimetre here.
        assert!(distance_mm(contact.centroid_m, [touch.x_m, touch.y_m]) < 0.5);
    }
}

#[test]
fn the_border_cuts_a_touch_without_harm() {
    let geometry = square();
    let mut image = paint(&geometry, &[bell(58.0, 0.0, 8.0, 1.0)]);
    cut_disc(&geometry, &mut image, 0.06);
    let contacts = find(&image, 0.01);
    assert_eq!(contacts.len(), 1);
    let touch = contacts[0];
    // The peak is 2 mm from the border and found to within a pixel. The missing part pulls the centroid inwards.
    assert!(distance_mm(touch.peak_m, [0.058, 0.0]) < 2.0);
    assert!(touch.centroid_m[0] < 0.058 && touch.centroid_m[0] > 0.048);
    assert!(touch.centroid_m[1].abs() < 1e-4);
    assert!(touch.covariance_m2.iter().flatten().all(|value| value.is_finite()));
}

#[test]
fn both_signs_are_found_when_asked_for() {
    let image = paint(&square(), &[bell(-30.0, 0.0, 8.0, 1.0), bell(30.0, 0.0, 8.0, -0.7)]);
    assert_eq!(find(&image, 0.01).len(), 1);
    let both = find_with(ContactParams { signs: ContactSigns::Both, ..Default::default() }, &image, 0.01);
    assert_eq!(both.iter().map(|c| c.sign).collect::<Vec<_>>(), [ContactSign::Positive, ContactSign::Negative]);
    assert!((both[1].peak_value + 0.7).abs() < 1e-3 && both[1].amplitude > 0.0 && both[1].volume > 0.0);
    assert!(distance_mm(both[1].centroid_m, [0.03, 0.0]) < 0.2);
}

#[test]
fn noisy_pixels_are_judged_by_their_own_noise() {
    let geometry = square();
    let image = paint(&geometry, &[bell(-30.0, 0.0, 8.0, 1.0), bell(30.0, 0.0, 8.0, 1.0)]);
    let sigma: Vec<f32> =
        (0..geometry.len()).map(|i| if geometry.pixel_centre_m(i)[0] > 0.0 { 0.5 } else { 0.01 }).collect();
    let mut finder = ContactFinder::new(geometry, ContactParams::default()).unwrap();
    let mut contacts = Vec::new();
    finder.find(&image, PixelNoise::PerPixel(&sigma), &mut contacts).unwrap();
    assert_eq!(contacts.len(), 1);
    assert!(contacts[0].centroid_m[0] < 0.0);
}

/// Ratio of the centroid's scatter over noisy images to the standard deviation that the finder states.
fn scatter_over_predicted(correlation_pixels: f64, centroid: CentroidWeight) -> f64 {
    let geometry = square();
    let clean = paint(&geometry, &[bell(3.1, -4.3, 8.0, 1.0)]);
    let correlation_length_m = correlation_pixels * geometry.pixel_m;
    let params = ContactParams { correlation_length_m, centroid, ..Default::default() };
    let mut finder = ContactFinder::new(geometry, params).unwrap();
    let (mut noise, mut contacts) = (Noise::new(7), Vec::new());
    let (mut squares, mut predicted) = (0.0, 0.0);
    let reference = find_with(params, &clean, 0.02)[0].centroid_m;
    for _ in 0..300 {
        let field = correlated_field(&mut noise, 64, correlation_pixels);
        let image: Vec<f32> = clean.iter().zip(&field).map(|(a, b)| a + 0.02 * *b as f32).collect();
        finder.find(&image, PixelNoise::Uniform(0.02), &mut contacts).unwrap();
        squares +=
            (contacts[0].centroid_m[0] - reference[0]).powi(2) + (contacts[0].centroid_m[1] - reference[1]).powi(2);
        predicted += contacts[0].covariance_m2[0][0] + contacts[0].covariance_m2[1][1];
    }
    (squares / predicted).sqrt()
}

/// Unit noise with correlation exp(-d^2 / (2 l^2)): white noise smoothed by a Gaussian of l / sqrt 2 along both axes.
fn correlated_field(noise: &mut Noise, size: usize, length: f64) -> Vec<f64> {
    let mut field: Vec<f64> = (0..size * size).map(|_| noise.normal()).collect();
    if length == 0.0 {
        return field;
    }
    let kernel: Vec<f64> = (-12i32..=12).map(|k| (-f64::from(k * k) / (length * length)).exp()).collect();
    let norm = kernel.iter().map(|k| k * k).sum::<f64>().sqrt();
    for step in [1, size] {
        let before = field.clone();
        for index in 0..size * size {
            let along = index / step % size;
            field[index] = (0..25)
                .map(|k| {
                    let shifted = (along + k + size - 12) % size;
                    kernel[k] / norm * before[index - along * step + shifted * step]
                })
                .sum();
        }
    }
    field
}

#[test]
fn the_covariance_is_the_scatter() {
    // 300 images give the scatter to 3 % (1 sigma); the rest is second order.
    for correlation in [0.0, 2.0, 5.0] {
        let ratio = scatter_over_predicted(correlation, CentroidWeight::Excess);
        assert!((0.88..1.12).contains(&ratio), "correlation {correlation} px: scatter over predicted is {ratio}");
    }
    // For the other weights the covariance ignores pixels that cross half height, and is only a lower bound.
    assert!(scatter_over_predicted(0.0, CentroidWeight::Value) > 1.0);
}

#[test]
fn noise_alone_begins_nothing() {
    let mut noise = Noise::new(3);
    for _ in 0..50 {
        let image: Vec<f32> = (0..64 * 64).map(|_| noise.normal() as f32).collect();
        // 200,000 Gaussian draws exceed 5 sigma with probability 0.06; this seed has none.
        assert!(find(&image, 1.0).iter().all(|contact| contact.strength == ContactStrength::Weak));
    }
}

#[test]
fn bad_input_is_named() {
    let mut finder = ContactFinder::new(square(), ContactParams::default()).unwrap();
    let mut contacts = Vec::new();
    let error = finder.find(&[0.0; 3], PixelNoise::Uniform(1.0), &mut contacts).unwrap_err();
    assert_eq!(error.to_string(), "image: expected 4096 values, got 3");
    let image = vec![0.0; 4096];
    assert!(finder.find(&image, PixelNoise::Uniform(-1.0), &mut contacts).is_err());
    assert!(finder.find(&image, PixelNoise::PerPixel(&[1.0]), &mut contacts).is_err());
    let error = ContactFinder::new(square(), ContactParams { k_on: 2.0, ..Default::default() }).unwrap_err();
    assert_eq!(error, TouchError::Parameter { name: "k_on", value: 2.0, expected: "finite and at least k_off" });
}

#[test]
fn parameters_come_from_text() {
    let params: ContactParams = serde_json::from_str(r#"{"k_on": 6.5, "signs": "both"}"#).unwrap();
    assert_eq!((params.k_on, params.k_off, params.signs), (6.5, 3.0, ContactSigns::Both));
    assert!(serde_json::from_str::<ContactParams>(r#"{"k_onn": 6.5}"#).is_err());
}

proptest! {
    #[test]
    fn any_image_gives_sound_contacts(
        image in proptest::collection::vec(
            prop_oneof![8 => -1.0f32..1.0, 1 => Just(f32::NAN), 1 => any::<f32>()], 12 * 9),
        sigma in prop_oneof![Just(0.0f32), 0.001f32..0.5],
        correlation_length_m in prop_oneof![Just(0.0), 0.0..0.03f64],
        min_separation_m in prop_oneof![Just(0.0), 0.0..0.01f64],
    ) {
        let geometry = dermis_touch::GridGeometry::centred(12, 9, 0.002);
        let params = ContactParams {
            signs: ContactSigns::Both, correlation_length_m, min_separation_m, max_contacts: 5, ..Default::default()
        };
        let mut finder = ContactFinder::new(geometry, params).unwrap();
        let mut contacts = Vec::new();
        finder.find(&image, PixelNoise::Uniform(sigma), &mut contacts).unwrap();
        prop_assert!(contacts.len() <= 5);
        prop_assert!(contacts.windows(2).all(|pair| pair[0].amplitude >= pair[1].amplitude));
        for contact in &contacts {
            let [x, y] = contact.centroid_m;
            prop_assert!(x.abs() <= 0.012 && y.abs() <= 0.009, "{contact:?}");
            prop_assert!(contact.peak_m[0].abs() <= 0.012 && contact.peak_m[1].abs() <= 0.009);
            prop_assert!(contact.amplitude > 0.0 && contact.area_m2 >= 4e-6 * 0.999);
            let [[xx, xy], [_, yy]] = contact.covariance_m2;
            prop_assert!(xx >= 0.0 && yy >= 0.0 && xy * xy <= xx * yy * (1.0 + 1e-9), "{contact:?}");
        }
    }

    #[test]
    fn moving_by_a_pixel_moves_the_contact_by_a_pixel(x in -20.0..20.0f64, y in -20.0..20.0f64) {
        let at = |x: f64, y: f64| find(&paint(&square(), &[bell(x, y, 7.0, 1.0)]), 0.01)[0];
        let (here, there) = (at(x, y), at(x + 2.0, y - 2.0));
        // Rounding of single-precision images.
        prop_assert!((there.centroid_m[0] - here.centroid_m[0] - 0.002).abs() < 1e-6);
        prop_assert!((there.centroid_m[1] - here.centroid_m[1] + 0.002).abs() < 1e-6);
        prop_assert_eq!(here.area_m2, there.area_m2);
    }
}
