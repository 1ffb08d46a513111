//! The page of a body: its scene and state, images that are sent once, commands that reach the right patch, and the
//! pages of the patches below it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use axum::body::Bytes;
use crossbeam_channel::{Receiver, bounded};
use dermis_cli::page::{
    Binding, BodyFeed, BodyPage, Command, Hub, Level, PageOptions, PatchImage, Request, ServerHandle, SkinPage,
};
use dermis_page::{BodyScene, BodyState, PatchStateView, PatchView, protocol};
use serde_json::json;
use tokio_tungstenite::tungstenite::Message;

use super::{LOOPBACK, ask, get, next, next_json, open_at, press, refused_with, request, say, scene, status, update};

/// A body whose second patch has a new image whenever `version` changes.
#[derive(Default)]
struct Feed {
    version: AtomicU64,
    joints: Mutex<BTreeMap<String, f64>>,
}

impl BodyFeed for Feed {
    fn now(&self) -> (BodyState, Vec<PatchImage>) {
        let patch = |state| PatchStateView { state, latency_p99_ms: f64::NAN, ..PatchStateView::default() };
        let patches = vec![patch("failed"), patch("running")];
        let version = self.version.load(Ordering::Relaxed);
        let message = protocol::patch_image(1, version, 9, &[version as f32; 4]);
        (BodyState { patches, ..BodyState::default() }, vec![PatchImage { patch: 1, version, message }])
    }

    fn set_joints(&self, values: &BTreeMap<String, f64>) -> Result<(), String> {
        if values.contains_key("knee") {
            return Err("joint \"knee\" refused".into());
        }
        self.joints.lock().expect("no panic").extend(values.clone());
        Ok(())
    }
}

struct Served {
    server: ServerHandle,
    feed: Arc<Feed>,
    hub: Hub,
    patch_hub: Hub,
    requests: Receiver<Request>,
}

fn serve() -> Served {
    let patch = |name: &str| PatchView { name: name.into(), ..PatchView::default() };
    let body = BodyScene { body: "arm".into(), patches: vec![patch("back"), patch("chest")], ..BodyScene::default() };
    let (commands, requests) = bounded(64);
    let (hub, patch_hub, feed) = (Hub::new(), Hub::new(), Arc::new(Feed::default()));
    feed.version.store(1, Ordering::Relaxed);
    let skin = SkinPage { hub: patch_hub.clone(), scene: scene(true), commands };
    let page = BodyPage {
        hub: hub.clone(),
        scene: body,
        feed: feed.clone(),
        patches: vec![None, Some(skin)],
        meshes: vec![Bytes::from_static(b"corners")],
    };
    let binding = Binding::new(LOOPBACK, PageOptions::default()).expect("a free port");
    let server = binding.serve_body(page).expect("a thread");
    Served { server, feed, hub, patch_hub, requests }
}

#[tokio::test]
async fn a_page_gets_the_scene_first_and_every_image_once() {
    let served = serve();
    let address = served.server.local_addr();
    let mut socket = open_at(address, "/ws").await;
    let first = next_json(&mut socket, "body_scene").await;
    assert_eq!((&first["body"], &first["patches"][1]["name"]), (&json!("arm"), &json!("chest")));
    assert!(first["patches"][0]["running"].is_null());
    let (mut images, mut states) = (Vec::new(), 0);
    while images.len() < 2 {
        match next(&mut socket).await {
            Message::Binary(bytes) if bytes[6] == 5 => images.push(bytes),
            Message::Text(text) if text.contains(r#""type":"body_state""#) => {
                let state: serde_json::Value = serde_json::from_str(&text).expect("JSON");
                assert_eq!(state["patches"][0]["state"], "failed");
                assert!(state["patches"][1]["latency_p99_ms"].is_null());
                states += 1;
                say(&mut socket, json!({"v": 1, "ack": state["sequence"]})).await;
                if states == 5 {
                    assert_eq!(images.len(), 1, "an image that hasn't changed is not sent again");
                    served.feed.version.store(2, Ordering::Relaxed);
                }
            }
            _ => {}
        }
    }
    assert_eq!((&images[1][24..28], &images[1][32..36]), (&1u32.to_le_bytes()[..], &2f32.to_le_bytes()[..]));
    served.hub.announce(Level::Warning, "chest: clock jumped");
    assert_eq!(next_json(&mut socket, "notice").await["text"], "chest: clock jumped");
}

#[tokio::test]
async fn without_acknowledgements_a_page_gets_no_more_than_the_window() {
    let served = serve();
    let mut socket = open_at(served.server.local_addr(), "/ws").await;
    let mut last = 0;
    // Two signs of life, one second each, leave time for many more than 8 updates.
    let mut signs = 0;
    while signs < 3 {
        if let Message::Text(text) = next(&mut socket).await {
            let message: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            last += u64::from(message["type"] == "body_state");
            signs += u64::from(message["type"] == "alive");
        }
    }
    assert!(last <= 8, "{last} states");
}

#[tokio::test]
async fn commands_reach_the_patch_they_name_and_joints_the_body() {
    let served = serve();
    let mut socket = open_at(served.server.local_addr(), "/ws").await;
    let to = |number: u64, command: serde_json::Value| json!({"patch": {"number": number, "command": command}});
    ask(&mut socket, 1, to(1, press(7, 2.0))).await;
    let Command::Press(pressed) = request(&served.requests).await.command else { panic!("expected a press") };
    assert_eq!(pressed.x_mm, 2.0);
    ask(&mut socket, 2, json!({"joints": {"elbow": 0.5}})).await;
    for (id, command, hint) in [
        (3, to(0, press(7, 0.0)), "patch 0 is not running"),
        (4, to(9, press(7, 0.0)), "patch 9 refused: expected a number below 2"),
        (5, to(1, press(8, 1e6)), "x_mm is 1000000, expected -100 to 100"),
        (6, to(1, press(7, 0.0)), "pointer_id 7 is already pressing"),
        (7, json!({"joints": {"knee": 0.5}}), "knee"),
    ] {
        ask(&mut socket, id, command).await;
        let answer = next_json(&mut socket, "answer").await;
        assert_eq!((&answer["id"], &answer["ok"]), (&json!(id), &json!(false)), "{answer}");
        assert!(answer["text"].as_str().is_some_and(|text| text.contains(hint)), "{answer}");
    }
    assert_eq!(served.feed.joints.lock().expect("no panic").get("elbow"), Some(&0.5));
    assert!(served.requests.is_empty());
    drop(socket);
    assert_eq!(request(&served.requests).await.command, Command::Release { pointer_id: pressed.pointer_id });
}

#[tokio::test]
async fn a_patch_has_a_page_of_its_own_below_the_bodys() {
    let served = serve();
    let address = served.server.local_addr();
    for (path, expected) in [
        ("/", 200),
        ("/body.js", 200),
        ("/page.js", 404),
        ("/patch/chest/", 200),
        ("/patch/chest/page.js", 200),
        ("/patch/chest/body.js", 404),
        ("/patch/back/", 404),
        ("/mesh/0", 200),
        ("/mesh/1", 404),
        ("/patch/nobody/", 404),
        ("/patch/../Cargo.toml", 404),
    ] {
        assert_eq!(status(&get(address, path, &[])), expected, "{path}");
    }
    assert!(get(address, "/patch/chest/", &[]).contains("page.js") && get(address, "/", &[]).contains("body.js"));
    served.patch_hub.publish(&update(42, 2)).expect("well formed");
    let mut socket = open_at(address, "/patch/chest/ws").await;
    assert_eq!(next_json(&mut socket, "scene").await["skin"], "test");
    assert_eq!(next_json(&mut socket, "state").await["frame"], 42);
    ask(&mut socket, 1, json!({"tare": {"force": false}})).await;
    assert_eq!(request(&served.requests).await.command, Command::Tare { force: false });
}

#[tokio::test]
async fn the_sockets_of_patches_are_guarded_like_the_bodys() {
    let served = serve();
    let address = served.server.local_addr();
    for path in ["/ws", "/patch/chest/ws"] {
        for origin in [None, Some("http://evil.example")] {
            assert_eq!(refused_with(super::open_with_at(address, path, origin, None).await), 403, "{path} {origin:?}");
        }
    }
    let own = format!("http://{address}");
    assert_eq!(refused_with(super::open_with_at(address, "/patch/back/ws", Some(&own), None).await), 404);
}
