//! Elements over coils as a whole, on the published EM-skins: effect of a press on the pairs of coils, symmetry,
//! heights recovered with a coarser model, and refusals.

mod published;

use dermis_mit::{CoilTables, Coupling, LiftOff, LiftOffFit, LiftOffOptions, MultipoleArray};
use dermis_twin::instrument::Instrument;
use dermis_twin::mechanics::{Indenter, Load, Shape};
use dermis_twin::{ElementOptions, ElementSkin, Frontend, TwinError};
use published::{em_8, em_twin};

fn even(options: ElementOptions) -> ElementSkin {
    ElementSkin::new(ElementOptions { tolerance_m: 0.0, memory: None, ..options }).unwrap()
}

fn press(centre_m: [f64; 2], force_n: f64) -> Indenter {
    Indenter { centre_m, shape: Shape::Disc { radius_m: 0.005 }, load: Load::ForceN(force_n) }
}

fn frame(skin: &mut ElementSkin, indenters: &[Indenter]) -> Vec<f64> {
    let mut frame = vec![0.0; skin.channel_count()];
    skin.voltages(indenters, 0.1, &mut frame).unwrap();
    frame
}

/// Relative change of every pair.
fn change(skin: &mut ElementSkin, indenters: &[Indenter]) -> Vec<f64> {
    let rest = frame(skin, &[]);
    frame(skin, indenters).iter().zip(&rest).map(|(now, rest)| now / rest - 1.0).collect()
}

#[test]
fn readings_change_ever_less_as_the_sponge_stiffens_and_element_by_element() {
    let mut skin = even(em_8());
    let place = skin.places_m()[6];
    let size = |force_n: f64, skin: &mut ElementSkin| {
        change(skin, &[press(place, force_n)]).iter().map(|c| c * c).sum::<f64>().sqrt()
    };
    let curve: Vec<f64> = (0..14).map(|k| size(f64::from(k), &mut skin)).collect();
    assert!(curve[0] == 0.0 && curve.windows(2).all(|w| w[1] > w[0]), "{curve:?}");
    // The field grows towards the coils and the sponge saturates: the last of 13 N adds less than a fifth of the
    // second.
    assert!(curve[13] - curve[12] < 0.2 * (curve[2] - curve[1]), "{curve:?}");
    assert!(skin.travel_m()[6] < 0.011 && skin.travel_m()[6] > 0.010, "{:?}", skin.travel_m()[6]);
    // Neighbours on sponge are dragged along slightly; the far corner stays.
    assert!(skin.travel_m()[7] > 0.1e-3 && skin.travel_m()[7] < 0.1 * skin.travel_m()[6] && skin.travel_m()[24] < 1e-5);
}

#[test]
fn a_press_changes_most_the_pair_of_coils_around_it_and_mirrors() {
    let mut skin = even(em_8());
    let places = skin.places_m().to_vec();
    let strongest = |change: &[f64]| (0..28).max_by(|a, b| change[*a].abs().total_cmp(&change[*b].abs())).unwrap();
    // Element 22 of 25 (from 0) is at (0, 40 mm), above coil 7 of 8 at (0, 45 mm): it mostly affects pairs of that
    // coil (index 6).
    let over = change(&mut skin, &[press(places[22], 2.0)]);
    assert!(skin.pairs()[strongest(&over)].contains(&6), "{:?}", skin.pairs()[strongest(&over)]);
    // At (-20, -40) mm, between coils 1 and 2 at (-45, -45) and (0, -45), it affects that pair.
    let between = change(&mut skin, &[press(places[1], 2.0)]);
    assert_eq!(skin.pairs()[strongest(&between)], [0, 1]);
    // Mirroring about x = 0 swaps elements 1 and 3, the coils as given here, and the readings accordingly.
    let mirrored = change(&mut skin, &[press(places[3], 2.0)]);
    let mirror = [2, 1, 0, 4, 3, 7, 6, 5];
    for (k, [m, n]) in skin.pairs().iter().enumerate() {
        let (m, n) = (mirror[*m].min(mirror[*n]), mirror[*m].max(mirror[*n]));
        let other = skin.pairs().iter().position(|pair| *pair == [m, n]).unwrap();
        // Expansions by quadrature are accurate to 1e-8 of fields that are 1e4 times these changes.
        assert!((between[k] - mirrored[other]).abs() < 1e-8, "{k}: {} {}", between[k], mirrored[other]);
    }
}

#[test]
fn hysteresis_is_thin_and_readings_are_noisy_as_published() {
    let options = em_8();
    let mut skin = ElementSkin::new(options.clone()).unwrap();
    let at = skin.places_m()[12];
    let loop_of = |skin: &mut ElementSkin, forces: &[f64]| -> Vec<f64> {
        forces
            .iter()
            .map(|f| {
                frame(skin, &[press(at, *f)]);
                skin.travel_m()[12]
            })
            .collect()
    };
    let up = loop_of(&mut skin, &[0.0, 0.5, 1.0, 1.5, 2.0]);
    let down = loop_of(&mut skin, &[1.5, 1.0, 0.5, 0.0]);
    for (rise, fall) in up.iter().zip(down.iter().rev()) {
        assert!(fall > rise && fall - rise < 0.06 * up[4], "{up:?} {down:?}");
    }
    let mut rest = vec![0.0; 28];
    let (mut skin, mut instrument, _) = em_twin(options.clone(), 83.0).unwrap().into_parts();
    let mut scatter = Vec::new();
    for _ in 0..400 {
        skin.voltages(&[], 0.1, &mut rest).unwrap();
        let truth = rest.clone();
        instrument.read(0.1, &mut rest);
        scatter.extend(rest.iter().zip(&truth).map(|(v, t)| (v / t - 1.0).powi(2)));
    }
    let snr_db = -10.0 * (scatter.iter().sum::<f64>() / scatter.len() as f64).log10();
    // The ratio of 11,200 readings is known to 0.06 dB; the converter's rounding adds 0.1 dB.
    assert!((snr_db - 83.0).abs() < 0.4, "{snr_db}");
}

/// A coarser model than the twin's: degree 2, neighbours as dipoles in one sweep, uniform heights.
fn model(options: &ElementOptions) -> LiftOff {
    let skin = even(options.clone());
    let coils = options.coils.clone();
    let body = options.body().unwrap().truncated(2);
    let limit = options.springs.limit_m;
    let tables =
        CoilTables::new(&coils, skin.places_m(), [options.rest_m - limit, options.rest_m], body.radius_m).unwrap();
    let count = skin.places_m().len();
    let coupling = Some(Coupling { degree: 1, reach_m: 1.5 * options.cell_m[0], sweeps: 1 });
    let bodies = MultipoleArray::new(vec![body; count], tables, coupling).unwrap();
    LiftOff::new(bodies, coils.mutuals_h(), vec![options.rest_m; count], limit).unwrap()
}

/// Number of frames averaged: one second.
const FRAMES: usize = 10;

/// Travels found from one second of noisy readings, and the true ones.
fn recover(
    skin: &mut ElementSkin,
    instrument: &mut Instrument,
    heights: &mut LiftOff,
    pressed: &[(usize, f64)],
) -> (LiftOffFit, Vec<f64>) {
    let read = |skin: &mut ElementSkin, instrument: &mut Instrument, indenters: &[Indenter]| {
        let mut values = frame(skin, indenters);
        instrument.read(0.1, &mut values);
        values
    };
    let mut rest = vec![0.0; skin.channel_count()];
    for _ in 0..100 {
        read(skin, instrument, &[]).iter().zip(&mut rest).for_each(|(v, sum)| *sum += 0.01 * v);
    }
    let places = skin.places_m().to_vec();
    let indenters: Vec<Indenter> = pressed.iter().map(|(k, force)| press(places[*k], *force)).collect();
    let mut now = vec![0.0; skin.channel_count()];
    for _ in 0..FRAMES {
        read(skin, instrument, &indenters).iter().zip(&mut now).for_each(|(v, sum)| *sum += v / FRAMES as f64);
    }
    // Relative changes times the model's own readings, so that the channels' gains cancel.
    let share = instrument.options().noise.proportional / (FRAMES as f64).sqrt();
    let differences: Vec<f64> =
        now.iter().zip(&rest).zip(heights.rest_h()).map(|((now, rest), model)| (now / rest - 1.0) * model).collect();
    let deviations: Vec<f64> = heights.rest_h().iter().map(|model| share * model).collect();
    let fit = heights.solve(&differences, &deviations, &LiftOffOptions::default()).unwrap();
    (fit, skin.travel_m().to_vec())
}

#[test]
fn heights_of_one_to_four_elements_by_a_coarser_model() {
    let options = em_8();
    let (mut skin, mut instrument, _) = em_twin(options.clone(), 83.0).unwrap().into_parts();
    let mut heights = model(&options);
    let cases: [&[(usize, f64)]; 6] = [
        &[(12, 2.0)],
        &[(0, 1.0)],
        &[(6, 2.0), (7, 1.0)],
        &[(1, 2.0), (13, 2.0), (20, 1.0)],
        &[(11, 1.0), (12, 2.0), (13, 1.5)],
        &[(0, 2.0), (4, 1.0), (18, 2.0), (22, 1.5)],
    ];
    for pressed in cases {
        let (fit, truth) = recover(&mut skin, &mut instrument, &mut heights, pressed);
        let errors: Vec<f64> = fit.travel_m.iter().zip(&truth).map(|(f, t)| 1e3 * (f - t)).collect();
        let worst = errors.iter().map(|e| e.abs()).fold(0.0, f64::max);
        println!(
            "{pressed:?}: worst {worst:.3} mm, of {:.2?} mm, misfit {:.2}, {} steps, deviations {:.3?} mm",
            pressed.iter().map(|(k, _)| 1e3 * truth[*k]).collect::<Vec<_>>(),
            fit.misfit,
            fit.steps,
            pressed.iter().map(|(k, _)| 1e3 * fit.deviation_m[*k]).collect::<Vec<_>>()
        );
        // Two standard deviations of the least well determined element; they vary with the noise.
        assert!(worst < 0.35, "{pressed:?}: {errors:.2?} mm");
    }
}

#[test]
fn impossible_input_is_refused_and_presses_off_the_skin_do_nothing() {
    let mut skin = even(em_8());
    let rest = frame(&mut skin, &[]);
    assert_eq!(frame(&mut skin, &[press([0.09, 0.0], 5.0)]), rest);
    let mut values = vec![0.0; 28];
    assert!(skin.read_at(&[0.0; 24], &mut values).is_err());
    assert!(skin.read_at(&[0.02; 25], &mut values).is_err());
    let refused = |options: ElementOptions| ElementSkin::new(options).unwrap_err();
    assert!(matches!(refused(ElementOptions { current_a: 0.0, ..em_8() }), TwinError::Value { .. }));
    assert!(matches!(refused(ElementOptions { rest_m: 0.016, ..em_8() }), TwinError::Magnetic(_)));
    assert!(matches!(
        refused(ElementOptions { places_m: published::grid(5, 0.01), cell_m: [0.01; 2], ..em_8() }),
        TwinError::Magnetic(_)
    ));
    assert!(matches!(refused(ElementOptions { frequency_hz: 5e6, ..em_8() }), TwinError::Magnetic(_)));
}
