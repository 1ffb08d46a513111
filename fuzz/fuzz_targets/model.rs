//! Networks: a card, a zero byte, and weights. The card's size and hash are corrected to match the weights, so that the
//! weights are parsed.
#![no_main]

use std::path::Path;

use dermis_learn::{Model, Tensors, sha256};
use libfuzzer_sys::fuzz_target;
use serde_json::Value;

fuzz_target!(|data: &[u8]| {
    let middle = data.iter().position(|byte| *byte == 0).unwrap_or(data.len());
    let (card, weights) = (&data[..middle], data.get(middle + 1..).unwrap_or_default());
    let _ = Tensors::from_bytes(weights, Path::new("fuzzed.safetensors"));
    let Ok(card) = std::str::from_utf8(card) else { return };
    let _ = Model::from_contents(card, weights, "fuzzed.json");
    let Ok(Value::Object(mut card)) = serde_json::from_str(card) else { return };
    card.insert("weights_bytes".into(), weights.len().into());
    card.insert("weights_sha256".into(), sha256(weights).into());
    if let Ok(model) = Model::from_contents(&Value::Object(card).to_string(), weights, "fuzzed.json") {
        let _ = (model.network().is_ok(), model.novelty().is_some());
    }
});
