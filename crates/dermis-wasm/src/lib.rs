//! A skin's twin, its live pipeline and the messages of the live page in one piece, without server, threads, files or
//! clock. This runs inside the book's first page. `scripts/wasm-demo` builds it as a WebAssembly module with the
//! functions in `exports.rs`; `web/src/engine.ts` calls them in a worker and passes the messages to the same page
//! that `dermis run` serves.
//!
//! ```
//! use dermis_wasm::{Engine, Message};
//!
//! let mut engine = Engine::new("ionic-disc", 25.0)?;
//! engine.step(0);
//! let Some(Message::Text(scene)) = engine.take() else { panic!("the scene comes first") };
//! assert!(scene.contains(r#""skin":"ionic-disc""#));
//! let Some(Message::Binary(image)) = engine.take() else { panic!("then the image") };
//! assert_eq!(&image[..4], b"DRMS");
//! # Ok::<(), String>(())
//! ```

mod engine;
#[cfg(all(target_arch = "wasm32", target_os = "unknown"))]
mod exports;
mod pressed_twin;

pub use engine::{Engine, Message};
