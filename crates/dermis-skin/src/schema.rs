//! JSON Schema of the skin file, generated from the types, so that editors can complete and check skin files.

use crate::skin::Skin;

/// The schema as JSON. `frontend` and `backend` may also be the path of a file that contains the table.
pub fn json_schema() -> serde_json::Value {
    let mut schema = schemars::schema_for!(Skin).to_value();
    for part in ["frontend", "backend"] {
        if let Some(property) = schema.pointer_mut(&format!("/properties/{part}")) {
            let table = property.take();
            *property = serde_json::json!({
                "anyOf": [table, { "type": "string", "description": "Path of a TOML file that holds the table, within the skin file's folder." }],
            });
        }
    }
    schema
}
