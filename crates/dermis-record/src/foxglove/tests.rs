//! The channels match those of recordings, and the layout names only served topics.

use std::collections::BTreeSet;
use std::net::TcpListener;

use ::foxglove::{Context, RawChannel};
use dermis_skin::GuardSettings;
use serde_json::Value;

use super::channels::{CommonChannels, PatchChannels};
use super::*;
use crate::{Error, schema};

fn all(patch: Option<&str>) -> Vec<(String, String, String, String)> {
    let context = Context::new();
    let channels = PatchChannels::open(&context, patch).unwrap();
    let common = CommonChannels::open(&context, patch.is_some()).unwrap();
    let describe = |channel: &RawChannel| {
        let schema = channel.schema().unwrap();
        (
            channel.topic().to_owned(),
            schema.name.clone(),
            schema.encoding.clone(),
            channel.message_encoding().to_owned(),
        )
    };
    let PatchChannels { frames, baselines, touches, events, image, points, touch_points, scene } = &channels;
    let mut found: Vec<_> =
        [frames, touches, events, image, points, touch_points, &common.log].map(|channel| describe(channel)).into();
    found.extend([baselines, scene, &common.transforms].map(|kept| describe(kept.channel())));
    found.extend(common.joints.iter().map(|kept| describe(kept.channel())));
    found.sort();
    found
}

#[test]
fn topics_names_and_encodings_match_recordings() {
    for patch in [None, Some("palm")] {
        let found = all(patch);
        let recorded = schema::OWN.iter().chain(&schema::STANDARD).chain(patch.is_some().then_some(&schema::JOINTS));
        let of_recording = |schema: &schema::Schema| {
            (schema::topic_of(schema.topic, patch), schema.name.to_owned(), "ros2msg".to_owned(), "cdr".to_owned())
        };
        let mut expected: Vec<_> = recorded.map(of_recording).collect();
        let scene = schema::topic_of("/dermis/scene", patch);
        for (topic, name) in [
            (scene.as_str(), "foxglove.SceneUpdate"),
            ("/dermis/transforms", "foxglove.FrameTransforms"),
            ("/dermis/log", "foxglove.Log"),
        ] {
            expected.push((topic.to_owned(), name.to_owned(), "protobuf".to_owned(), "protobuf".to_owned()));
        }
        expected.sort();
        assert_eq!(found, expected);
    }
}

/// All texts in a JSON value that begin with a slash, up to the first field of a message path.
fn topics_in(value: &Value, found: &mut BTreeSet<String>) {
    let mut keep = |text: &str| {
        if text.starts_with('/') {
            found.insert(text.split(['.', '[']).next().unwrap_or_default().to_owned());
        }
    };
    match value {
        Value::String(text) => keep(text),
        Value::Array(values) => values.iter().for_each(|value| topics_in(value, found)),
        Value::Object(fields) => {
            fields.keys().for_each(|key| keep(key));
            fields.values().for_each(|value| topics_in(value, found));
        }
        _ => {}
    }
}

#[test]
fn the_layout_uses_only_channels_of_a_single_skin_and_places_every_panel() {
    let layout: Value = serde_json::from_str(LAYOUT).unwrap();
    let mut named = BTreeSet::new();
    topics_in(&layout, &mut named);
    let served: BTreeSet<String> =
        all(None).into_iter().map(|(topic, ..)| topic).chain(["/dermis/tare".to_owned()]).collect();
    assert!(named.is_subset(&served), "{:?}", named.difference(&served));
    for topic in ["/dermis/scene", "/dermis/points", "/dermis/image", "/dermis/frames", "/dermis/log", "/dermis/tare"] {
        assert!(named.contains(topic), "{topic}");
    }

    fn places(node: &Value, found: &mut BTreeSet<String>) {
        match node {
            Value::String(panel) => assert!(found.insert(panel.clone()), "{panel} twice"),
            _ => ["first", "second"].iter().for_each(|side| places(&node[side], found)),
        }
    }
    let mut placed = BTreeSet::new();
    places(&layout["layout"], &mut placed);
    let panels: BTreeSet<String> = layout["configById"].as_object().unwrap().keys().cloned().collect();
    assert_eq!(placed, panels);
}

#[test]
fn an_address_in_use_is_named_with_advice() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let error = FoxgloveServer::open(&address.parse().unwrap(), "palm", false).unwrap_err();
    assert!(matches!(error, Error::Listen { .. }));
    let message = error.to_string();
    assert!(message.starts_with(&format!("cannot listen on {address}: ")), "{message}");
    assert!(message.ends_with("another program uses this port: choose another one, or 0 for a free one"), "{message}");
}

#[test]
fn the_guards_limits_are_parameters_if_set() {
    let guard = GuardSettings { force_n: Some(3.0), ..GuardSettings::default() };
    let found = parameters::of_guard("palm.", &guard);
    let names: Vec<&str> = found.iter().map(|parameter| parameter.name.as_str()).collect();
    let expected = ["force_n", "any_touch", "damage", "hold_ms", "most_left_out_percent"];
    assert_eq!(names, expected.map(|name| format!("palm.guard.{name}")));
}
