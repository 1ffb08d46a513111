//! The schemas that make a recording describe itself: a Protocol Buffers `FileDescriptorSet` for frames and baselines and
//! JSON schemas for touches and events.

use super::wire::{push_bytes, push_number};

/// Topics.
pub(super) const FRAMES: &str = "/dermis/frames";
pub(super) const BASELINES: &str = "/dermis/baselines";
pub(super) const TOUCHES: &str = "/dermis/touches";
pub(super) const EVENTS: &str = "/dermis/events";

/// Schema of touches.
pub(super) const TOUCHES_JSON: &str = r#"{
  "type": "object",
  "title": "dermis.Touches",
  "properties": {
    "sequence": {"type": "integer", "description": "frame number"},
    "time_s": {"type": "number", "description": "host monotonic clock"},
    "touches": {
      "type": "array",
      "items": {
        "type": "object",
        "properties": {
          "id": {"type": "integer"},
          "phase": {"type": "string", "enum": ["begin", "move", "end"]},
          "x_mm": {"type": "number"},
          "y_mm": {"type": "number"},
          "amplitude": {"type": "number"},
          "area_mm2": {"type": "number"},
          "sigma_x_mm": {"type": "number"},
          "sigma_y_mm": {"type": "number"}
        }
      }
    }
  }
}"#;

/// Schema of events.
pub(super) const EVENT_JSON: &str = r#"{
  "type": "object",
  "title": "dermis.Event",
  "properties": {
    "event": {"type": "string"},
    "detail": {"type": "string"}
  }
}"#;

/// A field of a message, in the words of `descriptor.proto`.
enum Field {
    Fixed64,
    Text,
    PackedDoubles,
}

impl Field {
    /// `FieldDescriptorProto.Type`.
    fn type_number(&self) -> u64 {
        match self {
            Self::PackedDoubles => 1,
            Self::Fixed64 => 6,
            Self::Text => 9,
        }
    }

    /// `FieldDescriptorProto.Label`: optional or repeated.
    fn label(&self) -> u64 {
        match self {
            Self::PackedDoubles => 3,
            Self::Fixed64 | Self::Text => 1,
        }
    }
}

/// The `FileDescriptorSet` of `dermis.Frame` and `dermis.Baseline` (proto2, where absent fields can be told from zero).
pub(super) fn descriptor_set() -> Vec<u8> {
    let frame = message(
        "Frame",
        &[
            ("sequence", Field::Fixed64),
            ("device_time_ns", Field::Fixed64),
            ("host_monotonic_ns", Field::Fixed64),
            ("host_wall_ns", Field::Fixed64),
            ("values", Field::PackedDoubles),
            ("imaginary", Field::PackedDoubles),
        ],
    );
    let baseline = message(
        "Baseline",
        &[
            ("time_ns", Field::Fixed64),
            ("frames", Field::Fixed64),
            ("origin", Field::Text),
            ("reason", Field::Text),
            ("values", Field::PackedDoubles),
        ],
    );
    let mut file = Vec::new();
    push_bytes(&mut file, 1, b"dermis.proto");
    push_bytes(&mut file, 2, b"dermis");
    push_bytes(&mut file, 4, &frame);
    push_bytes(&mut file, 4, &baseline);
    let mut set = Vec::new();
    push_bytes(&mut set, 1, &file);
    set
}

/// A `DescriptorProto` whose fields are numbered from 1 in the order given.
fn message(name: &str, fields: &[(&str, Field)]) -> Vec<u8> {
    let mut out = Vec::new();
    push_bytes(&mut out, 1, name.as_bytes());
    for (number, (name, field)) in (1..).zip(fields) {
        let mut descriptor = Vec::new();
        push_bytes(&mut descriptor, 1, name.as_bytes());
        push_number(&mut descriptor, 3, number);
        push_number(&mut descriptor, 4, field.label());
        push_number(&mut descriptor, 5, field.type_number());
        if matches!(field, Field::PackedDoubles) {
            // FieldOptions.packed = true.
            push_bytes(&mut descriptor, 8, &[2 << 3, 1]);
        }
        push_bytes(&mut out, 2, &descriptor);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_schemas_are_json() {
        for text in [TOUCHES_JSON, EVENT_JSON] {
            let schema: serde_json::Value = serde_json::from_str(text).unwrap();
            assert_eq!(schema["type"], "object");
        }
    }
}
