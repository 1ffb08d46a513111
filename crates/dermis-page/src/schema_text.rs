//! Types of messages as TypeScript, from their JSON schemas. Used only by tests.

use std::fmt::Write as _;

use serde_json::{Map, Value};

/// Schemas by name.
pub type Definitions = Map<String, Value>;

/// Interfaces and types of the roots and of everything they refer to, in the order of first mention.
pub fn typescript(definitions: &Definitions, roots: &[&str]) -> String {
    let mut text = String::new();
    for (name, schema) in in_order(definitions, roots) {
        let docs = docs_of(schema).map_or_else(String::new, |docs| format!("/** {docs} */\n"));
        let _ = match fields(schema) {
            Some(fields) => {
                let lines: String = fields.iter().map(|field| field.line("  ")).collect();
                write!(text, "\n{docs}export interface {name} {{\n{lines}}}\n")
            }
            None => write!(text, "\n{docs}export type {name} =\n{};\n", variants(schema).join("\n")),
        };
    }
    text
}

/// A field of an object.
struct Field {
    name: String,
    type_: String,
    docs: String,
    is_required: bool,
}

impl Field {
    fn line(&self, indent: &str) -> String {
        let docs = if self.docs.is_empty() { String::new() } else { format!("{indent}/** {} */\n", self.docs) };
        let mark = if self.is_required { "" } else { "?" };
        format!("{docs}{indent}{}{mark}: {};\n", self.name, self.type_)
    }
}

/// The types in the order of first mention, a type after the one that mentions it.
fn in_order<'a>(definitions: &'a Definitions, roots: &[&'a str]) -> Vec<(&'a str, &'a Value)> {
    fn mentioned<'a>(value: &'a Value, found: &mut Vec<&'a str>) {
        match value {
            Value::Object(map) => {
                found.extend(map.get("$ref").and_then(Value::as_str).and_then(|path| path.rsplit('/').next()));
                let (properties, order) = (map.get("properties"), required(value));
                order.iter().filter_map(|name| properties?.get(name)).for_each(|value| mentioned(value, found));
                map.values().for_each(|value| mentioned(value, found));
            }
            Value::Array(items) => items.iter().for_each(|value| mentioned(value, found)),
            _ => {}
        }
    }
    let mut names: Vec<&str> = roots.to_vec();
    let mut at = 0;
    while at < names.len() {
        let mut found = Vec::new();
        mentioned(&definitions[names[at]], &mut found);
        // Right behind the type that mentions them.
        let mut place = at + 1;
        for name in found {
            if !names.contains(&name) {
                names.insert(place, name);
                place += 1;
            }
        }
        at += 1;
    }
    names.into_iter().map(|name| (name, &definitions[name])).collect()
}

fn required(schema: &Value) -> Vec<&str> {
    schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str).collect()
}

/// The fields of an object in the order of their declaration: that of `required`, since `properties` may be sorted.
fn fields(schema: &Value) -> Option<Vec<Field>> {
    let properties = schema.get("properties")?.as_object()?;
    let required = required(schema);
    let optional = properties.keys().map(String::as_str).filter(|name| !required.contains(name));
    let field = |name: &str| Field {
        name: name.to_owned(),
        type_: type_of(&properties[name]),
        docs: docs_of(&properties[name]).unwrap_or_default(),
        is_required: required.contains(&name),
    };
    Some(required.iter().copied().chain(optional).map(field).collect())
}

/// The description on one line, without links to other items. Numbers that are NaN here are null in JSON.
fn docs_of(schema: &Value) -> Option<String> {
    let docs = schema.get("description")?.as_str()?.split_whitespace().collect::<Vec<_>>().join(" ");
    let in_json = docs.replace("`None`", "`null`").replace("NaN", "`null`");
    Some(in_json.replace("[`", "`").replace("`]", "`"))
}

fn variants(schema: &Value) -> Vec<String> {
    let Some(all) = schema["oneOf"].as_array() else { return vec![format!("  {}", type_of(schema))] };
    let variant = |one: &Value| {
        let docs = docs_of(one).map_or_else(String::new, |docs| format!("  /** {docs} */\n"));
        format!("{docs}  | {}", type_of(one))
    };
    all.iter().map(variant).collect()
}

/// The TypeScript type of a schema.
fn type_of(schema: &Value) -> String {
    let alternatives = |all: &Value| all.as_array().map(|all| all.iter().map(type_of).collect::<Vec<_>>().join(" | "));
    if let Some(path) = schema["$ref"].as_str() {
        return path.rsplit('/').next().unwrap_or(path).to_owned();
    }
    if let Some(value) = schema.get("const") {
        return value.to_string();
    }
    if let Some(words) = schema["enum"].as_array() {
        return words.iter().map(Value::to_string).collect::<Vec<_>>().join(" | ");
    }
    if let Some(all) = alternatives(&schema["anyOf"]).or_else(|| alternatives(&schema["oneOf"])) {
        return all;
    }
    if let Some(types) = schema["type"].as_array() {
        let one = |name: &Value| {
            let mut schema = schema.clone();
            schema["type"] = name.clone();
            type_of(&schema)
        };
        return types.iter().map(one).collect::<Vec<_>>().join(" | ");
    }
    match schema["type"].as_str() {
        Some("integer" | "number") => "number".to_owned(),
        Some("array") => array_type(schema),
        Some("object") => {
            let fields = fields(schema).unwrap_or_default();
            format!("{{ {} }}", fields.iter().map(inline).collect::<Vec<_>>().join("; "))
        }
        Some(other) => other.to_owned(),
        None => "unknown".to_owned(),
    }
}

fn inline(field: &Field) -> String {
    let plain = field.name.chars().all(|letter| letter.is_alphanumeric() || letter == '_');
    let name = if plain { field.name.clone() } else { format!("\"{}\"", field.name) };
    format!("{name}{}: {}", if field.is_required { "" } else { "?" }, field.type_)
}

/// A tuple if the length is fixed.
fn array_type(schema: &Value) -> String {
    let item = type_of(&schema["items"]);
    match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
        (Some(least), Some(most)) if least == most => format!("[{}]", vec![item; least as usize].join(", ")),
        _ if item.contains(" | ") => format!("({item})[]"),
        _ => format!("{item}[]"),
    }
}
