//! Every number in a skin file has a range. Impossible values are refused before any work starts, with the key's
//! name. The keys come from the JSON Schema, which is generated from the types, so none is missed.

use std::collections::BTreeSet;

use dermis_skin::{Skin, json_schema};
use serde_json::Value as Json;
use toml::{Table, Value};

/// Skins that contain every number between them: a built-in skin and values for some of its keys.
const SKINS: &[(&str, &[(&str, &str)])] = &[
    (
        "healing-square",
        &[
            ("frontend.layer.shortcut_s", "2000.0"),
            ("frontend.layer.smoothing_mm", "1.0"),
            ("frontend.layer.memory", "{ share = 0.1, time_constant_s = 1.0 }"),
            (
                "frontend.layer.contact",
                "{ threshold_kpa = 3.0, reference_kpa = 60.0, exponent = 1.5, saturation_s_per_m2 = 1500.0 }",
            ),
            ("frontend.bend", "{ cylinder = { diameter_mm = 200.0 } }"),
            (
                "backend.electronics",
                "{ noise_uv = 1.0, noise_share = 1e-3, converter_bits = 16, full_scale_mv = 100.0, gain_ranges = 2, \
                 current_step_ua = 1.0, largest_current_ua = 400.0, on_resistance_ohm = 1.0, input_resistance_mohm = 1.0, \
                 input_capacitance_pf = 1.0, crosstalk = 0.01, settling_us = 1.0, conversion_us = 1.0, \
                 drift_per_sqrt_s = 1e-4, channel_drift_per_sqrt_s = 1e-4, mains_uv = 1.0, mains_hz = 50.0 }",
            ),
            ("backend.circuit", "{ load = 0.1, idle = 0.1, reading = [1.0, -1.0, 0.1] }"),
            ("imaging.prior", "{ mixture = [{ weight = 1.0, prior = { noser = 0.5 } }] }"),
            ("imaging.hyperparameter", "{ noise-figure = 0.5 }"),
            ("health", "{ full_scale_mv = 100.0, recover_frames = 9 }"),
            ("damage", "{ begin_sigma = 8.0, smallest_depth = 0.05, confirm_s = 1.5, healed_scar_mm = 8.7 }"),
            ("touch.model_error_mm", "1.0"),
            ("twin.seed", "1"),
            ("twin.phase_error_deg", "1.0"),
            (
                "twin.healing",
                "{ temperature_c = 90.0, hours = 2.0, room_c = 25.0, activation_kj_per_mol = 90.0, peak_rise = 0.3, \
                 lasting_rise = 0.05, relaxation_hours = 12.0, scar_mm = 8.0, pad_rim_mm = 4.0 }",
            ),
            (
                "twin.faults",
                "[{ from_s = 1.0, until_s = 2.0, open_electrodes = [1], shorted_pairs = [[1, 2]], dropped_share = 0.1, \
                 repeated_share = 0.1, stuck_channels = [{ channel = 1, value_mv = 1.0 }], noisy_channels = [{ channel = 1, \
                 noise_mv = 1.0 }] }]",
            ),
            (
                "twin.treatments",
                "[{ at_s = 1.0, action = { cut = { from_mm = [1.0, 2.0], to_mm = [9.0, 2.0] } } }, { at_s = 2.0, action = { \
                 heal = { at_mm = [0.0, 0.0], radius_mm = 9.0, temperature_c = 90.0, hours = 2.0 } } }]",
            ),
        ],
    ),
    (
        "healing-square",
        &[
            ("frontend.shape", "{ rectangle = { width_mm = 100.0, height_mm = 110.0 } }"),
            (
                "frontend.layer",
                "{ kind = \"sheet\", thickness_mm = 1.0, conductivity_s_per_m = 1.0, pressure_percent_per_kpa = 1.0, \
              gauge_factor = 2.0, modulus_kpa = 50.0, smoothing_mm = 0.5 }",
            ),
            (
                "frontend.electrodes",
                "{ rim-list = [{ at_deg = 0.0, width_mm = 5.0 }, { at_deg = 90.0, width_mm = 5.0 }, \
              { at_deg = 180.0, width_mm = 5.0 }, { at_deg = 270.0, width_mm = 5.0 }] }",
            ),
            ("backend.drive", "{ skip = 0 }"),
            ("backend.measure", "{ skip = 0 }"),
            ("imaging.prior", "{ noser = 0.5 }"),
            ("imaging.hyperparameter", "{ known-noise = 1.0 }"),
            ("imaging.weights", "{ measured = { floor = 0.01 } }"),
            (
                "twin",
                "{ treatments = [{ at_s = 1.0, action = { time-lapse = 2.0 } }, { at_s = 2.0, action = { \
              drift-percent-per-min = 1.0 } }] }",
            ),
        ],
    ),
    (
        "healing-square",
        &[
            (
                "frontend.shape",
                "{ polygon = { outer_mm = [[-50.0, -50.0], [50.0, -51.0], [50.0, 50.0], [-50.0, 50.0]], \
              holes_mm = [[[10.0, 10.0], [30.0, 10.0], [30.0, 30.0]]] } }",
            ),
            (
                "frontend.electrodes",
                "{ pads = [{ circle = { centre_mm = [-20.0, -20.0], diameter_mm = 3.0 } }, { rectangle = { \
              centre_mm = [40.0, -20.0], width_mm = 3.0, height_mm = 3.0 } }, { point = { at_mm = [40.0, 40.0] } }, { point = \
              { at_mm = [-20.0, 40.0] } }] }",
            ),
            ("backend.drive", "{ pairs = [[1, 2], [2, 3]] }"),
            ("backend.measure", "{ single-ended = { electrode = 4 } }"),
            ("imaging.hyperparameter", "{ number = 0.5 }"),
            ("imaging.weights", "{ reciprocity = { floor = 0.01 } }"),
            ("imaging.refinement", "{ steps = 2, largest_step = 1.0, limit = 2.0, soft_threshold = 0.5 }"),
        ],
    ),
    (
        "piezo-disc",
        &[
            (
                "frontend.electrodes",
                "{ pad-rings = { rings = [{ count = 8, radius_mm = 20.0, start_deg = 10.0 }], diameter_mm = 3.0 } }",
            ),
            ("frontend.layer.cells_per_side", "3"),
        ],
    ),
    ("piezo-square", &[]),
    (
        "healing-square",
        &[
            ("mount", "{ link = \"palm\", xyz_mm = [1.0, 2.0, 3.0], rpy_deg = [10.0, 20.0, 30.0] }"),
            (
                "frontend.electrodes",
                "{ rim-places = { places_mm = [[-50.0, 0.0], [0.0, 50.0], [50.0, 0.0], [0.0, -50.0]], width_mm = 5.0 } }",
            ),
            ("backend.channels", "[[1, 2, 3, 4], [2, 3, 4, 1]]"),
            (
                "tolerances",
                "{ electrode_place_mm = 1.0, electrode_width_percent = 5.0, contact_impedance_factor = 1.5, \
                 conductivity_percent = 5.0, conductivity_length_share = 0.3, thickness_percent = 5.0, \
                 contact_law_percent = 5.0, gain_percent = 0.5, noise_percent = 10.0, coil_place_mm = 0.2, \
                 element_height_mm = 0.2, stiffness_percent = 5.0 }",
            ),
        ],
    ),
    ("ionic-disc", &[("frontend.layer.gravity_m_per_s2", "[0.0, 0.0, -9.8]")]),
    (
        "em-8",
        &[
            ("frontend.layer.relative_permeability", "1.0"),
            ("frontend.layer.sharpness", "2.0"),
            ("frontend.layer.height_tolerance_mm", "0.2"),
            ("frontend.coils.shield_mm", "-20.0"),
            ("twin.faults", "[{ dead_coils = [1] }]"),
        ],
    ),
    (
        "em-8",
        &[
            ("frontend.coils.places", "{ list = [[-40.0, 0.0, 0.0], [40.0, 0.0, 0.0]] }"),
            ("frontend.coils.conductor", "{ track = { width_mm = 0.1, thickness_mm = 0.1 } }"),
            ("frontend.elements.places", "{ list = { at_mm = [[0.0, 0.0]], cell_mm = 20.0 } }"),
            ("frontend.elements.shape", "{ plate = { side_mm = 10.0, height_mm = 2.0 } }"),
        ],
    ),
    (
        "em-8",
        &[
            ("frontend.coils.conductor", "{ pitch-share = 0.5 }"),
            ("frontend.elements.shape", "{ sphere = { diameter_mm = 10.0 } }"),
            (
                "guard",
                "{ force_n = 5.0, pressure_kpa = 50.0, stale_after_ms = 100.0, hold_ms = 50.0, most_left_out_percent = 20.0 }",
            ),
        ],
    ),
];

/// A built-in skin's file with some values replaced.
fn skin(name: &str, changes: &[(&str, &str)]) -> Value {
    let mut whole = Value::Table(Skin::open(name).expect("a built-in skin").to_toml().parse().expect("TOML"));
    for (key, text) in changes {
        let value: Table = format!("value = {text}").parse().unwrap_or_else(|error| panic!("{key}: {error}"));
        let (way, last) = key.rsplit_once('.').unwrap_or(("", key));
        let mut table = whole.as_table_mut().expect("a table");
        for step in way.split('.').filter(|step| !step.is_empty()) {
            let next = table.entry(step).or_insert_with(|| Value::Table(Table::new()));
            table = next.as_table_mut().expect("a table");
        }
        table.insert(last.to_owned(), value["value"].clone());
    }
    whole
}

/// Called for each number with its keys and a function that builds the file with another value.
type Put<'a> = &'a mut dyn FnMut(&[String], &dyn Fn(Value) -> Value);

/// Visits every number of a file, with its keys and a function that replaces it.
fn numbers(value: &Value, keys: &[String], put: Put<'_>) {
    match value {
        Value::Table(table) => {
            for (name, inner) in table {
                let keys = [keys, std::slice::from_ref(name)].concat();
                numbers(inner, &keys, &mut |keys, build| {
                    put(keys, &|new| {
                        let mut changed = table.clone();
                        changed.insert(name.clone(), build(new));
                        Value::Table(changed)
                    });
                });
            }
        }
        Value::Array(list) => {
            // Test only the first and the last entry.
            let ends = BTreeSet::from([0, list.len().saturating_sub(1)]);
            for index in ends.into_iter().filter(|index| *index < list.len()) {
                numbers(&list[index], keys, &mut |keys, build| {
                    put(keys, &|new| {
                        let mut changed = list.clone();
                        changed[index] = build(new);
                        Value::Array(changed)
                    });
                });
            }
        }
        Value::Integer(_) | Value::Float(_) => put(keys, &|new| new),
        Value::String(_) | Value::Boolean(_) | Value::Datetime(_) => {}
    }
}

/// Names of all keys whose schema is a number or a list of numbers.
fn names_of_numbers(schema: &Json, root: &Json, names: &mut BTreeSet<String>) {
    if let Json::Object(object) = schema {
        if let Some(Json::Object(properties)) = object.get("properties") {
            let are_numbers = |(name, property): (&String, &Json)| is_number(property, root).then(|| name.clone());
            names.extend(properties.iter().filter_map(are_numbers));
        }
        object.values().for_each(|inner| names_of_numbers(inner, root, names));
    } else if let Json::Array(list) = schema {
        list.iter().for_each(|inner| names_of_numbers(inner, root, names));
    }
}

fn is_number(schema: &Json, root: &Json) -> bool {
    let is_named = |kind: &Json| kind == "number" || kind == "integer";
    let of_type = match &schema["type"] {
        Json::Array(kinds) => kinds.iter().any(is_named),
        kind => is_named(kind),
    };
    let target = schema["$ref"].as_str().and_then(|way| root.pointer(way.trim_start_matches('#')));
    let any_of = |list: &Json| list.as_array().is_some_and(|list| list.iter().any(|one| is_number(one, root)));
    of_type
        || target.is_some_and(|target| is_number(target, root))
        || any_of(&schema["anyOf"])
        || any_of(&schema["prefixItems"])
        || (schema["items"].is_object() && is_number(&schema["items"], root))
}

#[test]
fn numbers_that_are_not_finite_or_out_of_range_are_refused() {
    let mut seen = BTreeSet::new();
    let mut tried = 0;
    for (name, changes) in SKINS {
        let whole = skin(name, changes);
        numbers(&whole, &[], &mut |keys, build| {
            let way = keys.join(".");
            seen.insert(keys.last().expect("a key").clone());
            let parse =
                |value: f64| Skin::parse(&toml::to_string(&build(Value::Float(value))).expect("TOML"), "made.toml");
            // A seed may be any whole number, but nothing else.
            for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300] {
                let error = parse(value).err().unwrap_or_else(|| panic!("{name}: {way} = {value} was taken"));
                assert!(error.to_string().starts_with("made.toml: "), "{name}: {way} = {value}: {error}");
                tried += 1;
            }
            // A value close to zero is accepted only if zero is.
            assert!(parse(1e-300).is_err() || parse(0.0).is_ok(), "{name}: {way} = 1e-300 was taken, and 0 is not");
        });
    }
    let schema = json_schema();
    let mut names = BTreeSet::new();
    names_of_numbers(&schema, &schema, &mut names);
    let missing: Vec<&String> = names.difference(&seen).collect();
    assert!(names.len() > 100 && missing.is_empty(), "of {} keys these are in no skin above: {missing:?}", names.len());
    assert!(tried > 1000, "{tried} values tried");
}

#[test]
fn inductances_agree_with_the_coils() {
    let with = |uh: &str| {
        let text = toml::to_string(&skin("em-8", &[("frontend.coils.inductance_uh", uh)])).expect("TOML");
        Skin::parse(&text, "made.toml").map(|_| ()).map_err(|error| error.to_string())
    };
    assert_eq!(with("0.001"), Ok(()));
    let expected = "made.toml: frontend.coils.inductance_uh = 0.0009: expected 0.001 to 1e9";
    assert_eq!(with("0.0009"), Err(expected.to_owned()));
    assert!(with("1e-300").is_err_and(|error| error.contains("frontend.coils.inductance_uh")));
}
