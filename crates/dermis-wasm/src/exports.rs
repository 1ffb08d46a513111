//! The functions of the module, called by `web/src/engine.ts`. Messages pass through two buffers in the module's
//! memory. The page writes into the buffer returned by `dermis_input` and reads from the buffer filled by
//! `dermis_next`. A panic leaves its text in the latter before the module traps.

// Only the exported names and one import are unsafe here; no pointer is dereferenced.
#![allow(unsafe_code)]

use std::cell::RefCell;
use std::panic;
use std::time::Duration;

use dermis_live::instant::set_clock;

use crate::engine::{Engine, Message};

/// Result of `dermis_next`: no message.
const NOTHING: u32 = 0;
/// Result of `dermis_next`: a text message.
const TEXT: u32 = 1;
/// Result of `dermis_next`: a binary message.
const BINARY: u32 = 2;

/// Skin shown in the page.
const SKIN: &str = "ionic-disc";

thread_local! {
    static ENGINE: RefCell<Option<Engine>> = const { RefCell::new(None) };
    static INPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static OUTPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

unsafe extern "C" {
    /// Milliseconds since an arbitrary origin, monotonic.
    safe fn dermis_now_ms() -> f64;
}

fn now() -> Duration {
    Duration::from_secs_f64((dermis_now_ms() * 1e-3).max(0.0))
}

fn now_ns() -> u64 {
    now().as_nanos() as u64
}

fn put(bytes: Vec<u8>) {
    OUTPUT.with(|output| *output.borrow_mut() = bytes);
}

fn with_engine(action: impl FnOnce(&mut Engine)) {
    ENGINE.with(|engine| engine.borrow_mut().as_mut().map(action));
}

/// Creates the twin and its pipeline. Returns false on failure, with the reason in the output.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_start(frames_per_s: f64) -> bool {
    panic::set_hook(Box::new(|info| put(info.to_string().into_bytes())));
    set_clock(now);
    match Engine::new(SKIN, frames_per_s) {
        Ok(made) => {
            ENGINE.with(|engine| *engine.borrow_mut() = Some(made));
            true
        }
        Err(error) => {
            put(error.into_bytes());
            false
        }
    }
}

/// Runs one frame.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_step() {
    with_engine(|engine| engine.step(now_ns()));
}

/// Reports that the engine is alive, without running a frame.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_rest() {
    with_engine(Engine::rest);
}

/// Buffer for the page to write `bytes` bytes of UTF-8 into.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_input(bytes: usize) -> *mut u8 {
    INPUT.with(|input| {
        let mut input = input.borrow_mut();
        input.clear();
        input.resize(bytes, 0);
        input.as_mut_ptr()
    })
}

/// Handles the message that the page has written.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_hear() {
    let text = INPUT.with(|input| String::from_utf8_lossy(&input.borrow()).into_owned());
    with_engine(|engine| engine.hear(&text));
}

/// Puts the next message into the output. Returns 0 for none, 1 for text, 2 for binary.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_next() -> u32 {
    let mut kind = NOTHING;
    with_engine(|engine| {
        let (of, bytes) = match engine.take() {
            None => return,
            Some(Message::Text(text)) => (TEXT, text.into_bytes()),
            Some(Message::Binary(bytes)) => (BINARY, bytes.into()),
        };
        put(bytes);
        kind = of;
    });
    kind
}

/// Address of the output.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_output() -> *const u8 {
    OUTPUT.with(|output| output.borrow().as_ptr())
}

/// Length of the output, bytes.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_output_bytes() -> usize {
    OUTPUT.with(|output| output.borrow().len())
}
