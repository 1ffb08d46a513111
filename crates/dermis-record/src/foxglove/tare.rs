//! The service that tares a skin: JSON in, JSON out.

use ::foxglove::Schema;
use ::foxglove::websocket::service::{Request, Responder, Service, ServiceSchema};
use crossbeam_channel::Sender;
use serde::Deserialize;
use serde_json::json;

use super::parameters::ASKED;
use crate::schema::topic_of;
use crate::{LiveCommand, LiveRequest};

/// Name of the service of a single skin.
const TARE: &str = "/dermis/tare";

const REQUEST: &str = r#"{"type": "object", "title": "dermis.TareRequest", "properties": {"force": {"type": "boolean",
"description": "also while something touches the skin", "default": false}}}"#;
const REPLY: &str = r#"{"type": "object", "title": "dermis.TareReply", "properties": {"success": {"type": "boolean"},
"message": {"type": "string", "description": "what was done, or why it was refused"}}}"#;

/// The content of a request.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Wanted {
    #[serde(default)]
    force: bool,
}

/// The service of a patch, or of a single skin. Its requests go to the pipeline that reads `requests`.
pub(super) fn service(patch: Option<&str>, requests: Sender<LiveRequest>) -> Service {
    let json = |name: &str, text: &'static str| Schema::new(name, "jsonschema", text.as_bytes());
    let schema = ServiceSchema::new("dermis.Tare")
        .with_request("json", json("dermis.TareRequest", REQUEST))
        .with_response("json", json("dermis.TareReply", REPLY));
    let handler = Tare { requests };
    Service::builder(topic_of(TARE, patch), schema).handler(handler)
}

struct Tare {
    requests: Sender<LiveRequest>,
}

impl ::foxglove::websocket::service::Handler for Tare {
    fn call(&self, request: Request, responder: Responder) {
        let force = match wanted(request.payload()) {
            Ok(Wanted { force }) => force,
            Err(reason) => return responder.respond_err(reason),
        };
        let request = LiveRequest::new(LiveCommand::Tare { force }, ASKED, move |done| {
            let (success, message) = match done {
                Ok(text) => (true, text),
                Err(text) => (false, text),
            };
            responder.respond_ok(json!({ "success": success, "message": message }).to_string());
        });
        if let Err(refused) = self.requests.try_send(request) {
            refused.into_inner().refuse("too many requests at once");
        }
    }
}

/// Reads a request; an empty one is the default.
fn wanted(payload: &[u8]) -> Result<Wanted, String> {
    if payload.is_empty() {
        return Ok(Wanted { force: false });
    }
    serde_json::from_slice(payload).map_err(|error| format!("expected {{}} or {{\"force\": true}}: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_are_read_and_mistakes_named() {
        let force = |text: &str| wanted(text.as_bytes()).map(|wanted| wanted.force);
        for (text, expected) in [("", false), ("{}", false), ("{\"force\": true}", true)] {
            assert_eq!(force(text), Ok(expected), "{text}");
        }
        for text in ["{\"forced\": true}", "{\"force\": 1}", "x", "[]x", "\u{0}"] {
            let message = force(text).unwrap_err();
            assert!(message.starts_with("expected {} or {\"force\": true}: "), "{message}");
        }
        for schema in [REQUEST, REPLY] {
            assert!(serde_json::from_str::<serde_json::Value>(schema).is_ok(), "{schema}");
        }
    }
}
