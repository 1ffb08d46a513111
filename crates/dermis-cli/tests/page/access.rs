//! Access control: which paths, host names, origins and tokens are accepted, and which are not.

use std::net::SocketAddr;

use crossbeam_channel::bounded;
use dermis_cli::page::{self, Hub, PageError, PageOptions, Token};

use super::{get, next_json, open_with, raw, refused_with, scene, serve, serve_with, status};

#[test]
fn the_page_has_headers_that_isolate_it() {
    let served = serve();
    let address = served.server.local_addr();
    assert!(address.ip().is_loopback() && address.port() != 0);
    assert_eq!(served.server.url(), format!("http://{address}/"));
    for (path, kind) in
        [("/", "text/html"), ("/page.js", "text/javascript"), ("/page.css", "text/css"), ("/icon.svg", "image/svg")]
    {
        let answer = get(address, path, &[]);
        assert_eq!(status(&answer), 200, "{path}");
        let lower = answer.to_lowercase();
        assert!(lower.contains(&format!("content-type: {kind}")), "{path}");
        for header in [
            "content-security-policy: default-src 'self'",
            "x-content-type-options: nosniff",
            "x-frame-options: deny",
            "referrer-policy: no-referrer",
        ] {
            assert!(lower.contains(header), "{path} without {header}");
        }
    }
}

#[test]
fn the_page_names_no_other_site() {
    let served = serve();
    for path in ["/", "/page.js", "/page.css"] {
        let answer = get(served.server.local_addr(), path, &[]);
        // XML namespaces look like addresses but are never loaded.
        let others = answer.replace("http://www.w3.org/2000/svg", "").replace("http://www.w3.org/1999/", "");
        for scheme in ["src=\"http", "href=\"http", "url(http", "@import", "fetch(\"http", "import(\"http"] {
            assert!(!others.contains(scheme), "{path} contains {scheme}");
        }
    }
}

#[test]
fn other_paths_and_methods_are_not_answered() {
    let served = serve();
    let address = served.server.local_addr();
    for path in [
        "/../Cargo.toml",
        "/..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "//etc/passwd",
        "/page.js/",
        "/page.js%00",
        "/page.js/../../Cargo.toml",
        "/./page.js",
        "/PAGE.JS",
        "/assets/page.js",
        "/\\..\\..\\etc\\passwd",
    ] {
        let code = status(&get(address, path, &[]));
        assert!(code == 404 || code == 400, "{path} was answered with {code}");
    }
    let posted =
        raw(address, &format!("POST / HTTP/1.1\r\nHost: {address}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"));
    assert_eq!(status(&posted), 405);
}

#[test]
fn a_name_that_is_not_the_servers_is_refused_with_a_hint() {
    let served =
        serve_with(PageOptions { allowed_hosts: vec!["lab-pc.local".into()], ..PageOptions::default() }, true, 1);
    let address = served.server.local_addr();
    for host in ["Host: evil.example", "Host: 127.0.0.1.evil.example", "Host: 192.168.1.7"] {
        let answer = get(address, "/", &[host]);
        assert_eq!(status(&answer), 403, "{host}");
        assert!(answer.contains("--allow-host"), "{answer}");
    }
    assert_eq!(status(&get(address, "/", &[&format!("Host: localhost:{}", address.port())])), 200);
    assert_eq!(status(&get(address, "/", &["Host: lab-pc.local"])), 200);
    let without = raw(address, "GET / HTTP/1.1\r\nConnection: close\r\n\r\n");
    assert!([400, 403].contains(&status(&without)), "{without}");
}

#[tokio::test]
async fn a_socket_from_another_origin_is_refused() {
    let served = serve();
    let address = served.server.local_addr();
    let other_port = format!("http://127.0.0.1:{}", address.port() ^ 1);
    for origin in [Some("http://evil.example"), Some("null"), Some(other_port.as_str()), None] {
        assert_eq!(refused_with(open_with(address, origin, None).await), 403, "{origin:?}");
    }
    assert_eq!(status(&get(address, "/page.js", &["Origin: http://evil.example"])), 403);
}

#[tokio::test]
async fn with_a_token_nothing_is_answered_without_it() {
    let token = Token::random().expect("random bytes");
    let options = PageOptions { token: Some(token.clone()), ..PageOptions::default() };
    let served = serve_with(options, true, 1);
    let address = served.server.local_addr();
    assert_eq!(served.server.url(), format!("http://{address}/?token={}", token.as_str()));
    let wrong = "0".repeat(32);
    for path in ["/", "/page.js", "/icon.svg", &format!("/?token={wrong}"), "/?token=", "/elsewhere"] {
        assert_eq!(status(&get(address, path, &[])), 401, "{path}");
    }
    let own = format!("http://{address}");
    assert_eq!(refused_with(open_with(address, Some(&own), None).await), 401);

    let answer = get(address, &format!("/?token={}", token.as_str()), &[]);
    assert_eq!(status(&answer), 200);
    let cookie_line = answer.lines().find_map(|line| line.strip_prefix("set-cookie: ")).expect("a cookie");
    assert!(cookie_line.contains("HttpOnly") && cookie_line.contains("SameSite=Strict"), "{cookie_line}");
    let cookie = cookie_line.split(';').next().expect("a name and a value");
    assert_eq!(status(&get(address, "/page.js", &[&format!("Cookie: {cookie}")])), 200);
    let mut socket = open_with(address, Some(&own), Some(cookie)).await.expect("the page's own socket");
    next_json(&mut socket, "scene").await;
    assert_eq!(refused_with(open_with(address, Some("http://evil.example"), Some(cookie)).await), 403);
}

#[test]
fn beyond_loopback_it_refuses_to_listen_without_a_token() {
    let (commands, _requests) = bounded(1);
    let everywhere = SocketAddr::from(([0, 0, 0, 0], 0));
    let made = page::serve(everywhere, PageOptions::default(), Hub::new(), scene(true), commands);
    let error = made.expect_err("no token was given");
    assert!(matches!(error, PageError::TokenMissing { .. }));
    assert!(error.to_string().contains("0.0.0.0"), "{error}");
}
