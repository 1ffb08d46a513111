//! The files of the pages, embedded in the command.

/// A file with its name relative to its page's address; the page itself has none.
pub(super) struct Asset {
    pub(super) name: &'static str,
    pub(super) kind: &'static str,
    pub(super) bytes: &'static [u8],
}

const HTML: &str = "text/html; charset=utf-8";
const SCRIPT: &str = "text/javascript; charset=utf-8";
const STYLE: &str = "text/css; charset=utf-8";

const ICON: Asset = Asset { name: "icon.svg", kind: "image/svg+xml", bytes: include_bytes!("../../assets/icon.svg") };

/// The page of a skin.
pub(super) const SKIN: [Asset; 4] = [
    Asset { name: "", kind: HTML, bytes: include_bytes!("../../assets/index.html") },
    Asset { name: "page.js", kind: SCRIPT, bytes: include_bytes!("../../assets/page.js") },
    Asset { name: "page.css", kind: STYLE, bytes: include_bytes!("../../assets/page.css") },
    ICON,
];

/// The page of a body.
pub(super) const BODY: [Asset; 4] = [
    Asset { name: "", kind: HTML, bytes: include_bytes!("../../assets/body.html") },
    Asset { name: "body.js", kind: SCRIPT, bytes: include_bytes!("../../assets/body.js") },
    Asset { name: "body.css", kind: STYLE, bytes: include_bytes!("../../assets/body.css") },
    ICON,
];
