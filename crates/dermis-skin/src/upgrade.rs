//! Upgrade of skin files from earlier versions of the format: lists the keys that have moved and rewrites the file,
//! keeping its comments.

use toml_edit::{Array, DocumentMut, InlineTable, Item, TableLike, Value};

/// A file converted to the current format.
#[derive(Clone, Debug, PartialEq)]
pub struct Upgraded {
    /// The new text.
    pub text: String,
    /// Changes made, for display: one sentence per key.
    pub moved: Vec<String>,
}

/// Former keywords for a bare conductor and for a tank.
const SHEETS: [&str; 6] = ["gel", "hydrogel", "carbon", "fabric", "rubber", "foam"];
const TANKS: [&str; 4] = ["water", "saline", "agar", "tank"];

/// A coil array formerly known by name.
struct NamedArray {
    name: &'static str,
    round: bool,
    inner_mm: f64,
    outer_mm: f64,
    turns: i64,
    layers: i64,
    layer_pitch_mm: f64,
    wire_mm: Option<f64>,
    inductance_uh: f64,
    per_side: i64,
    pitch_mm: f64,
    left_out: Option<i64>,
    stiffness_n_per_m: f64,
    coupling_n_per_m: f64,
    memory_share: f64,
}

const ARRAYS: [NamedArray; 3] = [
    NamedArray {
        name: concat!("em", "-8"),
        round: true,
        inner_mm: 34.0,
        outer_mm: 40.0,
        turns: 36,
        layers: 6,
        layer_pitch_mm: 0.5,
        wire_mm: Some(0.5),
        inductance_uh: 150.0,
        per_side: 3,
        pitch_mm: 45.0,
        left_out: Some(5),
        stiffness_n_per_m: 400.0,
        coupling_n_per_m: 12.0,
        memory_share: 0.04,
    },
    NamedArray {
        name: concat!("em", "-16-circular"),
        round: true,
        inner_mm: 30.0,
        outer_mm: 70.0,
        turns: 51,
        layers: 1,
        layer_pitch_mm: 0.0,
        wire_mm: None,
        inductance_uh: 155.0,
        per_side: 4,
        pitch_mm: 75.0,
        left_out: None,
        stiffness_n_per_m: 300.0,
        coupling_n_per_m: 0.0,
        memory_share: 0.02,
    },
    NamedArray {
        name: concat!("em", "-16-square"),
        round: false,
        inner_mm: 25.0,
        outer_mm: 75.0,
        turns: 51,
        layers: 1,
        layer_pitch_mm: 0.0,
        wire_mm: None,
        inductance_uh: 157.0,
        per_side: 4,
        pitch_mm: 78.0,
        left_out: None,
        stiffness_n_per_m: 300.0,
        coupling_n_per_m: 0.0,
        memory_share: 0.02,
    },
];

/// Rewrites a file of an earlier version. Returns `None` if the text is not TOML or nothing in it has moved. The
/// result may still be refused for other reasons.
pub fn upgrade(text: &str) -> Option<Upgraded> {
    let mut document: DocumentMut = text.parse().ok()?;
    let mut moved = Vec::new();
    if let Some(frontend) = document.get_mut("frontend").and_then(Item::as_table_like_mut) {
        let array = coils(frontend, &mut moved);
        elements(frontend, &mut moved);
        layer(frontend, array, &mut moved);
    }
    let solve = document.get_mut("imaging").and_then(Item::as_table_like_mut).and_then(|table| table.get_mut("solve"));
    if let Some(solve) = solve.filter(|solve| solve.as_str() == Some("heights")) {
        set(solve, Value::from("lift-off"));
        moved.push("imaging.solve = \"heights\" is now \"lift-off\"".to_string());
    }
    (!moved.is_empty()).then(|| Upgraded { text: document.to_string(), moved })
}

/// Replaces a value and keeps the formatting around it.
fn set(item: &mut Item, value: Value) {
    let decor = item.as_value().map(|old| old.decor().clone());
    let mut value = value;
    if let Some(decor) = decor {
        *value.decor_mut() = decor;
    }
    *item = Item::Value(value);
}

fn rename(table: &mut dyn TableLike, from: &str, to: &str) {
    if let Some(value) = table.remove(from) {
        table.insert(to, value);
    }
}

fn layer(frontend: &mut dyn TableLike, array: Option<&NamedArray>, moved: &mut Vec<String>) {
    let Some(layer) = frontend.get_mut("layer").and_then(Item::as_table_like_mut) else { return };
    let Some(kind) = layer.get("kind").and_then(Item::as_str).map(str::to_string) else { return };
    let has_thickness = layer.contains_key("thickness_mm");
    if SHEETS.contains(&kind.as_str()) {
        if let Some(item) = layer.get_mut("kind") {
            set(item, Value::from("sheet"));
        }
        moved.push(format!("frontend.layer.kind = \"{kind}\" is now \"sheet\""));
    } else if TANKS.contains(&kind.as_str()) {
        if let Some(item) = layer.get_mut("kind") {
            set(item, Value::from("liquid"));
        }
        rename(layer, "thickness_mm", "depth_mm");
        layer.insert("tension_n_per_m", Item::Value(Value::from(0.0)));
        moved.push(format!(
            "frontend.layer.kind = \"{kind}\" is now \"liquid\" with tension_n_per_m = 0 and depth_mm for thickness_mm"
        ));
    } else if kind == "liquid" && has_thickness {
        rename(layer, "thickness_mm", "depth_mm");
        moved.push("frontend.layer.thickness_mm of a liquid is now depth_mm".to_string());
    } else if kind == "elements" && (has_thickness || !layer.contains_key("stiffness_n_per_m")) {
        if layer.remove("thickness_mm").is_some() {
            moved.push("frontend.layer.thickness_mm of elements is gone: elements.shape has their height".to_string());
        }
        if !layer.contains_key("stiffness_n_per_m") {
            let springs = array.unwrap_or(&ARRAYS[0]);
            layer.insert("stiffness_n_per_m", Item::Value(Value::from(springs.stiffness_n_per_m)));
            layer.insert("coupling_n_per_m", Item::Value(Value::from(springs.coupling_n_per_m)));
            let mut memory = InlineTable::new();
            memory.insert("share", springs.memory_share.into());
            memory.insert("time_constant_s", 0.3.into());
            layer.insert("memory", Item::Value(Value::InlineTable(memory)));
            moved.push("frontend.layer of elements has stiffness_n_per_m, coupling_n_per_m and memory".to_string());
        }
    }
}

fn coils(frontend: &mut dyn TableLike, moved: &mut Vec<String>) -> Option<&'static NamedArray> {
    let coils = frontend.get_mut("coils").and_then(Item::as_table_like_mut)?;
    let name = coils.get("array").and_then(Item::as_str)?.to_string();
    let array = ARRAYS.iter().find(|array| array.name == name)?;
    coils.remove("array");
    let mut grid = InlineTable::new();
    grid.insert("rows", array.per_side.into());
    grid.insert("columns", array.per_side.into());
    grid.insert("pitch_mm", array.pitch_mm.into());
    if let Some(place) = array.left_out {
        let mut left_out = Array::new();
        left_out.push(place);
        grid.insert("left_out", Value::Array(left_out));
    }
    let mut places = InlineTable::new();
    places.insert("grid", Value::InlineTable(grid));
    let mut put = |key: &str, value: Value| coils.insert(key, Item::Value(value));
    put("places", Value::InlineTable(places));
    put("shape", Value::from(if array.round { "round" } else { "square" }));
    put("inner_mm", array.inner_mm.into());
    put("outer_mm", array.outer_mm.into());
    put("turns", array.turns.into());
    if array.layers > 1 {
        put("layers", array.layers.into());
        put("layer_pitch_mm", array.layer_pitch_mm.into());
    }
    if let Some(diameter_mm) = array.wire_mm {
        let mut wire = InlineTable::new();
        wire.insert("diameter_mm", diameter_mm.into());
        let mut conductor = InlineTable::new();
        conductor.insert("wire", Value::InlineTable(wire));
        put("conductor", Value::InlineTable(conductor));
    }
    put("inductance_uh", array.inductance_uh.into());
    moved.push(format!("frontend.coils.array = \"{name}\" is now places, shape, turns and sizes of the coils"));
    Some(array)
}

fn elements(frontend: &mut dyn TableLike, moved: &mut Vec<String>) {
    let Some(elements) = frontend.get_mut("elements").and_then(Item::as_table_like_mut) else { return };
    let Some(per_side) = elements.get("per_side").and_then(Item::as_integer) else { return };
    let pitch = elements.remove("pitch_mm").and_then(|item| item.into_value().ok());
    elements.remove("per_side");
    let mut grid = InlineTable::new();
    grid.insert("rows", per_side.into());
    grid.insert("columns", per_side.into());
    if let Some(mut pitch) = pitch {
        pitch.decor_mut().clear();
        grid.insert("pitch_mm", pitch);
    }
    let mut places = InlineTable::new();
    places.insert("grid", Value::InlineTable(grid));
    elements.insert("places", Item::Value(Value::InlineTable(places)));
    moved.push(
        "frontend.elements.per_side and pitch_mm are now places = { grid = { rows, columns, pitch_mm } }".to_string(),
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Error, Skin, builtin_text};

    #[test]
    fn what_is_of_today_is_left_alone() {
        for name in crate::BUILTIN_NAMES {
            assert_eq!(upgrade(builtin_text(name).unwrap()), None, "{name}");
        }
    }

    #[test]
    fn earlier_files_are_told_as_such_and_rewritten_with_their_comments() {
        let text = r#"name = "my-gel"
modality = "eit"

[frontend]
shape = { disc = { diameter_mm = 120.0 } } # measured
layer = { kind = "gel", thickness_mm = 5.0, conductivity_s_per_m = 0.3 }
electrodes = { rim = { count = 16, width_mm = 6.0, start_deg = 90.0 } }
contact_impedance_ohm_m2 = 1e-4

[backend]
current_ma = 1.0
drive = "adjacent"
measure = "adjacent"
"#;
        let error = Skin::parse(text, "my-gel.toml").unwrap_err();
        assert!(matches!(error, Error::OldFormat { .. }), "{error}");
        let said = error.to_string();
        assert!(
            said.contains("\"gel\" is now \"sheet\"") && said.contains("dermis skins upgrade my-gel.toml"),
            "{said}"
        );
        let upgraded = upgrade(text).unwrap();
        assert!(upgraded.text.contains("# measured"), "{}", upgraded.text);
        let skin = Skin::parse(&upgraded.text, "my-gel.toml").unwrap();
        assert_eq!(Skin::parse_any_version(text, "my-gel.toml").unwrap(), skin);
        assert_eq!(skin.frontend.layer.kind(), "sheet");
    }

    #[test]
    fn files_that_were_built_in_before_are_read_as_they_are() {
        // Built-in skins from before layers had their own parameters.
        let earlier = [
            (concat!("ionic", "-disc"), include_str!("upgrade/earlier-ionic-disc.toml")),
            (concat!("em", "-8"), include_str!("upgrade/earlier-em-8.toml")),
            (concat!("hydrogel", "-disc"), include_str!("upgrade/earlier-hydrogel-disc.toml")),
            (concat!("golfball", "-tank"), include_str!("upgrade/earlier-golfball-tank.toml")),
        ];
        for (name, text) in earlier {
            assert!(Skin::parse(text, name).is_err(), "{name}");
            let skin = Skin::parse_any_version(text, name).unwrap();
            let today = Skin::parse(builtin_text(name).unwrap(), name).unwrap();
            assert_eq!(skin.name, name);
            assert_eq!(skin.frontend.layer.kind(), today.frontend.layer.kind(), "{name}");
            assert_eq!(skin.outline(), today.outline(), "{name}");
            assert_eq!(skin.protocol().unwrap(), today.protocol().unwrap(), "{name}");
        }
    }

    #[test]
    fn coils_that_had_names_become_descriptions() {
        let new = builtin_text(concat!("em", "-8")).unwrap();
        let head = new.split("[frontend]").next().unwrap();
        let rest = &new[new.find("[backend]").unwrap()..];
        let old = format!(
            "{head}[frontend]\nshape = {{ square = {{ side_mm = 140.0 }} }}\nlayer = {{ kind = \"elements\", thickness_mm = 10.0, \
             conductivity_s_per_m = 3.5e7 }}\ncoils = {{ array = \"{}\" }}\nelements = {{ per_side = 5, pitch_mm = 20.0, rest_mm = \
             23.0, travel_mm = 11.0, shape = {{ cylinder = {{ diameter_mm = 10.0, height_mm = 10.0 }} }} }}\n\n{}",
            concat!("em", "-8"),
            rest.replace("lift-off", "heights")
        );
        let skin = Skin::parse_any_version(&old, "old").unwrap();
        assert_eq!(skin, Skin::parse(new, "new").unwrap());
    }
}
