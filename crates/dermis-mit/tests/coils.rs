//! Descriptions of coils: the published arrays keep their values, other arrays are valid, and invalid ones are
//! refused.

use dermis_mit::{
    Coil, CoilArray, CoilGrid, CoilShape, CoilSpec, Conductor, EM_8, EM_16_CIRCULAR, EM_16_SQUARE, MU0, MitError,
    PublishedArray, Ring, complete_elliptic,
};

const MM: f64 = 1e-3;
/// Tolerance for another math library, which may change the last bits of sums over thousands of filaments.
const LAST_BITS: f64 = 1e-13;

/// Bits of the mutual inductances between coil 1 and the others.
const EM_8_H: [u64; 7] = [
    0xbed5_e987_d953_12f5,
    0xbe9c_24ac_dc2c_9f92,
    0xbed5_e987_d953_12f4,
    0xbe93_b581_471a_98e1,
    0xbe9c_24ac_dc2c_9f8e,
    0xbe93_b581_471a_98de,
    0xbe82_e11d_7f4b_8f06,
];
const EM_8_SHIELD_H: [u64; 7] = [
    0xbec8_dd2a_5750_58cd,
    0xbe64_b45d_c5d8_883b,
    0xbec8_dd2a_5750_58cb,
    0xbe56_8998_5a37_ba0f,
    0xbe64_b45d_c5d8_8851,
    0xbe56_8998_5a37_b9f1,
    0xbe39_dd5c_d035_8d00,
];
/// Bits of the mutual inductances between coil 1 and the others.
const CIRCULAR_H: [u64; 15] = [
    0xbed1_c0e2_07e1_b756,
    0xbe98_ef59_6792_282e,
    0xbe7c_2d75_2201_fbae,
    0xbed1_c0e2_07e1_b756,
    0xbeb3_669e_82ef_1e68,
    0xbe91_881f_0c0c_5f97,
    0xbe77_f864_a838_6ee4,
    0xbe98_ef59_6792_2827,
    0xbe91_881f_0c0c_5f96,
    0xbe80_e39d_5289_0d03,
    0xbe70_0ccb_66c9_6af8,
    0xbe7c_2d75_2201_fba4,
    0xbe77_f864_a838_6ee0,
    0xbe70_0ccb_66c9_6af6,
    0xbe63_90e5_76a7_ded4,
];
const CIRCULAR_SHIELD_H: [u64; 15] = [
    0xbeb1_b126_f014_c91d,
    0xbe4a_5dea_fa8c_37c0,
    0xbe18_77a9_0c0a_a127,
    0xbeb1_b126_f014_c921,
    0xbe78_34a4_3e89_13a4,
    0xbe3c_cd31_4eec_81b1,
    0xbe12_9ece_0147_b1b3,
    0xbe4a_5dea_fa8c_373c,
    0xbe3c_cd31_4eec_81b1,
    0xbe20_9fc4_eb4d_cf27,
    0xbe02_f216_0a01_642e,
    0xbe18_77a9_0c0a_9fdb,
    0xbe12_9ece_0147_b1f6,
    0xbe02_f216_0a01_64b3,
    0xbdf0_7e53_1aaf_d0de,
];
/// Bits of the mutual inductances between coil 1 and the others.
const SQUARE_H: [u64; 15] = [
    0xbede_6c90_8e3f_7cb7,
    0xbea2_a823_7663_9136,
    0xbe84_bcd4_59ec_0409,
    0xbede_6c90_8e3f_7cbb,
    0xbebf_bf69_a758_8298,
    0xbe9a_2cf6_c155_12ab,
    0xbe81_a072_b551_3736,
    0xbea2_a823_7663_9134,
    0xbe9a_2cf6_c155_128f,
    0xbe88_f43f_9f89_ec58,
    0xbe77_8bb1_011d_44ff,
    0xbe84_bcd4_59ec_0416,
    0xbe81_a072_b551_3728,
    0xbe77_8bb1_011d_44d7,
    0xbe6c_9fe8_fd2e_e60b,
];
const SQUARE_SHIELD_H: [u64; 15] = [
    0xbec3_0b8f_6b5b_f383,
    0xbe53_42b0_c4b2_2924,
    0xbe21_0c3e_d478_2333,
    0xbec3_0b8f_6b5b_f38d,
    0xbe89_9d26_be62_7d79,
    0xbe44_fb82_f67e_9860,
    0xbe19_e609_ecae_30fc,
    0xbe53_42b0_c4b2_29a2,
    0xbe44_fb82_f67e_9292,
    0xbe27_77b7_2dba_2954,
    0xbe0a_2afc_a288_9658,
    0xbe21_0c3e_d478_2275,
    0xbe19_e609_ecae_1eb4,
    0xbe0a_2afc_a288_7639,
    0xbdf6_9904_090f_77d7,
];

fn first_row(array: &CoilArray) -> Vec<f64> {
    array.mutuals_h().into_iter().take(array.coils().len() - 1).collect()
}

#[test]
fn published_arrays_have_not_changed() {
    let arrays: [(PublishedArray, &[u64], &[u64]); 3] = [
        (EM_8, &EM_8_H, &EM_8_SHIELD_H),
        (EM_16_CIRCULAR, &CIRCULAR_H, &CIRCULAR_SHIELD_H),
        (EM_16_SQUARE, &SQUARE_H, &SQUARE_SHIELD_H),
    ];
    for (published, bare, shielded) in arrays {
        let array = published.coils().unwrap();
        let over_shield = array.clone().with_shield(-6.0 * MM).unwrap();
        for (array, expected) in [(array, bare), (over_shield, shielded)] {
            let found = first_row(&array);
            assert_eq!(found.len(), expected.len());
            let mut same = 0;
            for (found, expected) in found.iter().zip(expected) {
                let expected = f64::from_bits(*expected);
                same += usize::from(*found == expected);
                assert!((found / expected - 1.0).abs() < LAST_BITS, "{found:e} {expected:e}");
            }
            println!("{same} of {} to the last bit", expected.len());
        }
    }
}

#[test]
fn descriptions_make_the_same_wire_as_the_windings_that_they_name() {
    let solenoid = Coil::solenoid([0.0; 3], 0.034, 0.0005, 6, 6).unwrap().calibrated_to(150e-6).unwrap().0;
    let circular = Coil::circular_spiral([0.0; 3], 0.03, 0.07, 51).unwrap().calibrated_to(155e-6).unwrap().0;
    let square = Coil::square_spiral([0.0; 3], 0.025, 0.075, 51).unwrap().calibrated_to(157e-6).unwrap().0;
    for (published, coil) in [(EM_8, solenoid), (EM_16_CIRCULAR, circular), (EM_16_SQUARE, square)] {
        // Identical bit for bit: the arithmetic is the same.
        assert_eq!(published.spec.coil([0.0; 3]).unwrap(), coil);
        let array = published.coils().unwrap();
        let expected: Vec<Coil> =
            published.grid().places_m().unwrap().into_iter().map(|p| coil.clone().moved(p)).collect();
        assert_eq!(array.coils(), expected);
    }
}

/// Maxwell's formula for two coaxial loops, henries.
fn coaxial_h(a: f64, b: f64, distance_m: f64) -> f64 {
    let parameter = 4.0 * a * b / ((a + b).powi(2) + distance_m * distance_m);
    let ((k, e), root) = (complete_elliptic(1.0 - parameter), parameter.sqrt());
    MU0 * (a * b).sqrt() * ((2.0 / root - root) * k - 2.0 / root * e)
}

#[test]
fn three_rows_of_four_single_turns_are_rings() {
    let spec = CoilSpec::single_turn(CoilShape::Round, 30.0 * MM, 0.4 * MM);
    let grid = CoilGrid { rows: 3, columns: 4, pitch_m: [35.0 * MM, 32.0 * MM], left_out: vec![] };
    let array = CoilArray::new(&spec, &grid.places_m().unwrap()).unwrap();
    assert_eq!((array.coils().len(), array.pairs().len()), (12, 66));
    for (k, expected) in [(0, [-0.0525, -0.032, 0.0]), (11, [0.0525, 0.032, 0.0])] {
        let centre = array.coils()[k].centre_m;
        assert!((0..3).all(|axis| (centre[axis] - expected[axis]).abs() < 1e-15), "{centre:?}");
    }
    let ring = |k: usize| Ring::flat(array.coils()[k].centre_m, 15.0 * MM);
    for (&[a, b], mutual) in array.pairs().iter().zip(array.mutuals_h()) {
        // The centre line's radius is computed from widths given as rounded decimals; the integral is accurate to
        // 1e-14.
        assert!((mutual / ring(a).mutual_h(&ring(b)) - 1.0).abs() < 1e-11, "{a} {b}");
        let back = array.coils()[b].mutual_h(&array.coils()[a]);
        assert!((mutual / back - 1.0).abs() < 1e-11, "{a} {b}: {mutual:e} {back:e}");
    }
    // Round wire: mu0 R (ln(8R/(e^(-1/4) d/2)) - 2).
    let expected = MU0 * 15.0 * MM * ((8.0 * 15.0 / (0.2 * (-0.25_f64).exp())).ln() - 2.0);
    assert!((array.coils()[3].self_inductance_h() / expected - 1.0).abs() < 1e-12);
    let stacked = CoilArray::new(&spec, &[[0.0; 3], [0.0, 0.0, 5.0 * MM], [0.0, 0.0, 20.0 * MM]]).unwrap();
    for (found, distance) in stacked.mutuals_h().into_iter().zip([5.0, 20.0, 15.0]) {
        let expected = coaxial_h(15.0 * MM, 15.0 * MM, distance * MM);
        assert!((found / expected - 1.0).abs() < 1e-11, "{distance}: {found:e} {expected:e}");
    }
    let outlines = array.outlines();
    assert!(outlines.iter().all(|o| o.shape == CoilShape::Round && (o.outer_m - 30.4 * MM).abs() < 1e-12));
    assert_eq!(outlines[5].centre_m, array.coils()[5].centre_m);
}

#[test]
fn listed_places_may_be_irregular_and_in_layers() {
    let conductor = Conductor::Track { width_m: 0.2 * MM, thickness_m: 0.035 * MM };
    let spec = CoilSpec {
        shape: CoilShape::Square,
        inner_m: 6.0 * MM,
        outer_m: 20.0 * MM,
        turns: 32,
        layers: 2,
        layer_pitch_m: 0.4 * MM,
        conductor,
        inductance_h: None,
    };
    let places = [[0.0; 3], [21.0 * MM, 3.0 * MM, 0.0], [-4.0 * MM, 26.0 * MM, 0.0], [8.0 * MM, 4.0 * MM, -MM]];
    let array = CoilArray::new(&spec, &places).unwrap();
    assert_eq!(array.coils()[0].filaments().len(), 4 * 32);
    assert!(array.outlines().iter().zip(places).all(|(o, p)| o.shape == CoilShape::Square && o.centre_m == p));
    for (&[a, b], mutual) in array.pairs().iter().zip(array.mutuals_h()) {
        let back = array.coils()[b].mutual_h(&array.coils()[a]);
        // Sums of closed forms of opposite sides, which cancel some digits.
        assert!((mutual / back - 1.0).abs() < 1e-9, "{a} {b}: {mutual:e} {back:e}");
    }
    // For coils side by side, flux returns through the neighbour; for stacked coils, it is shared.
    let mutuals = array.mutuals_h();
    assert!(mutuals[0] < 0.0 && mutuals[2] > 0.0, "{mutuals:?}");
    // Two tight layers have almost four times the inductance of one.
    let one = CoilSpec { turns: 16, layers: 1, ..spec }.coil([0.0; 3]).unwrap().self_inductance_h();
    let two = array.coils()[0].self_inductance_h();
    assert!((3.5..4.0).contains(&(two / one)), "{}", two / one);
}

#[test]
fn many_turns_are_lumped_without_a_change_that_matters() {
    let conductor = Conductor::Wire { diameter_m: 0.25 * MM };
    let spec = CoilSpec {
        shape: CoilShape::Round,
        inner_m: 20.0 * MM,
        outer_m: 30.0 * MM,
        turns: 400,
        layers: 20,
        layer_pitch_m: 0.25 * MM,
        conductor,
        inductance_h: None,
    };
    let (lumped, every) = (spec.coil([0.0; 3]).unwrap(), Coil::solenoid([0.0; 3], 0.02, 0.00025, 20, 20).unwrap());
    assert!(lumped.filaments().len() <= 128 && every.filaments().len() == 400);
    let turns = lumped.scale() * lumped.filaments().len() as f64;
    assert!((turns - 400.0).abs() < 1e-9, "{turns}");
    // A block of turns uses the mean distance of a rectangle. Round wire leaves the corners empty, half a per cent
    // here.
    let share = lumped.self_inductance_h() / every.self_inductance_h();
    assert!((share - 1.0).abs() < 0.005, "{share}");
    let beside = |coil: &Coil| coil.mutual_h(&coil.clone().moved([0.032, 0.0, 0.0]));
    // Filaments 0.6 mm apart at a distance of 32 mm: the square of one or two hundredths.
    assert!((beside(&lumped) / beside(&every) - 1.0).abs() < 1e-3);
    let most = CoilSpec { turns: 10_000, layers: 1, conductor: Conductor::PitchShare(0.8), ..spec };
    assert_eq!(most.coil([0.0; 3]).unwrap().filaments().len(), 128);
}

#[test]
fn grids_leave_places_out() {
    let grid = CoilGrid { rows: 2, columns: 3, pitch_m: [0.1, 0.2], left_out: vec![1, 5] };
    let places = grid.places_m().unwrap();
    assert_eq!(places, [[0.0, -0.1, 0.0], [0.1, -0.1, 0.0], [-0.1, 0.1, 0.0], [0.1, 0.1, 0.0]]);
    for (broken, field) in [
        (CoilGrid { rows: 0, ..grid.clone() }, "rows = 0"),
        (CoilGrid { columns: 65, ..grid.clone() }, "columns = 65"),
        (CoilGrid { pitch_m: [0.1, f64::NAN], ..grid.clone() }, "pitch_m along y = NaN"),
        (CoilGrid { left_out: vec![7], ..grid.clone() }, "left_out = 7"),
        (CoilGrid { left_out: vec![2, 2], ..grid }, "left_out = 2: expected each place once"),
    ] {
        let error = broken.places_m().unwrap_err().to_string();
        assert!(error.contains(field), "{error}");
    }
}

#[test]
fn impossible_coils_are_refused_with_field_value_and_expectation() {
    let spec = CoilSpec::spiral(CoilShape::Round, 10.0 * MM, 20.0 * MM, 10);
    let two = CoilSpec { layers: 2, layer_pitch_m: 1.0 * MM, ..spec };
    let wire = |diameter_m: f64| Conductor::Wire { diameter_m };
    for (broken, words) in [
        (CoilSpec { inner_m: -1.0, ..spec }, "inner_m = -1: expected positive"),
        (CoilSpec { outer_m: f64::INFINITY, ..spec }, "outer_m = inf"),
        (CoilSpec { outer_m: 0.01, ..spec }, "outer_m = 0.01: expected above inner_m"),
        (CoilSpec { turns: 0, ..spec }, "turns = 0: expected 1 to 10,000"),
        (CoilSpec { turns: 10_001, ..spec }, "turns = 10001"),
        (CoilSpec { layers: 0, ..spec }, "layers = 0"),
        (CoilSpec { layers: 3, ..two }, "layers = 3: expected 1 or more, and turns to be a multiple"),
        (CoilSpec { layer_pitch_m: 0.0, ..two }, "layer_pitch_m = 0"),
        (CoilSpec { layer_pitch_m: 0.5 * MM, ..two }, "layer_pitch_m = 0.0005: expected at least the height"),
        (CoilSpec { conductor: Conductor::PitchShare(1.1), ..spec }, "= 1.1: expected above 0, at most 1"),
        (CoilSpec { conductor: wire(0.6 * MM), ..spec }, "diameter_m = 0.0006"),
        (CoilSpec { conductor: wire(f64::NAN), ..spec }, "diameter_m = NaN"),
        (spec.with_inductance(0.0), "inductance_h = 0"),
    ] {
        let error = broken.coil([0.0; 3]).unwrap_err().to_string();
        assert!(error.contains(words), "{error}, not {words}");
    }
    assert!(spec.coil([0.0, f64::NAN, 0.0]).is_err());
    let at = |x: f64, z: f64| [x * MM, 0.0, z * MM];
    let array = |places: &[[f64; 3]]| CoilArray::new(&spec, places);
    let refused = |places: &[[f64; 3]]| array(places).unwrap_err();
    assert!(refused(&[at(0.0, 0.0)]).to_string().contains("number of coils = 1: expected 2 to 64"));
    let many: Vec<[f64; 3]> = (0..65).map(|k| at(25.0 * f64::from(k), 0.0)).collect();
    assert!(refused(&many).to_string().contains("number of coils = 65"));
    assert_eq!(refused(&[at(0.0, 0.0), at(f64::NAN, 0.0)]).to_string(), "place of coil 2: NaN m, expected finite");
    assert!(matches!(refused(&[at(0.0, 0.0), at(19.9, 0.0)]), MitError::CoilsOverlap { first: 1, second: 2, .. }));
    assert!(matches!(refused(&[at(0.0, 0.0), at(5.0, 0.2)]), MitError::CoilsOverlap { .. }));
    assert!(array(&[at(0.0, 0.0), at(5.0, 0.5)]).is_ok() && array(&[at(0.0, 0.0), at(20.0, 0.0)]).is_ok());
    // Squares reach into their corners; circles do not.
    let diagonal = [[0.0; 3], [16.0 * MM, 16.0 * MM, 0.0]];
    let square = CoilSpec { shape: CoilShape::Square, ..spec };
    assert!(array(&diagonal).is_ok() && CoilArray::new(&square, &diagonal).is_err());
    let mixed = vec![spec.coil(diagonal[0]).unwrap(), square.coil(diagonal[1]).unwrap()];
    assert!(CoilArray::of_coils(mixed.clone()).unwrap_err().to_string().contains("overlap"));
    assert!(CoilArray::of_coils(vec![mixed[0].clone(), mixed[1].clone().moved([2.0 * MM, 2.0 * MM, 0.0])]).is_ok());
    let pair = array(&[at(0.0, 0.0), at(25.0, 0.0)]).unwrap();
    for z_m in [0.0, -0.1 * MM, 1.0, f64::NAN, f64::NEG_INFINITY] {
        let error = pair.clone().with_shield(z_m).unwrap_err();
        assert!(matches!(error, MitError::ShieldNotBelow { .. }), "{error}");
    }
    assert!(pair.with_shield(-0.5 * MM).is_ok());
}

#[test]
fn mutual_inductances_of_arrays_equal_those_of_pairs() {
    // Round and square coils, one of them in a layer above, over a shield.
    let round = |x: f64, y: f64, z: f64| Coil::circular_spiral([x, y, z], 0.012, 0.036, 6).unwrap();
    let square = |x: f64, y: f64| Coil::square_spiral([x, y, 0.0], 0.012, 0.036, 6).unwrap();
    let coils = vec![
        round(0.0, 0.0, 0.0),
        round(0.04, 0.0, 0.0),
        round(0.08, 0.0, 0.0),
        round(0.0, 0.04, 0.0),
        round(0.0, 0.0, 0.01),
        square(0.04, 0.04),
        square(0.08, 0.04),
        square(0.12, 0.04),
        square(0.08, 0.08),
    ];
    let array = CoilArray::of_coils(coils).unwrap().with_shield(-0.02).unwrap();
    let found = array.mutuals_h();
    for (&[a, b], found) in array.pairs().iter().zip(&found) {
        let direct = array.coils()[a].mutual_h(&array.coils()[b]);
        // Reciprocal pairs integrate along the other coil's wire.
        assert!((found - direct).abs() < 1e-9 * direct.abs().max(1e-9), "{a} {b}: {found:e} {direct:e}");
    }
}
