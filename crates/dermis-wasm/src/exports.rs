//! The functions of the module, called by `web/src/engine.ts`. Messages pass through two buffers in the module's
//! memory: the page writes what it says into the one that `dermis_input` makes room in, and reads from the other what
//! `dermis_next` has put there. A panic leaves its text there too, before the module traps.

// Names that JavaScript calls by, and one that it gives: nothing else here is unsafe, and no pointer is followed.
#![allow(unsafe_code)]

use std::cell::RefCell;
use std::panic;
use std::time::Duration;

use dermis_live::instant::set_clock;

use crate::engine::{Engine, Message};

/// What `dermis_next` found.
const NOTHING: u32 = 0;
const TEXT: u32 = 1;
const BINARY: u32 = 2;

/// The skin in the page.
const SKIN: &str = "ionic-disc";

thread_local! {
    static ENGINE: RefCell<Option<Engine>> = const { RefCell::new(None) };
    static INPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static OUTPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

unsafe extern "C" {
    /// Milliseconds since any moment, never less than before.
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

/// Makes the twin and its pipeline; false where that failed, and why is in the output.
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

/// Says that it lives, without a frame.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_rest() {
    with_engine(Engine::rest);
}

/// Where the page writes what it says, so many bytes of UTF-8.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_input(bytes: usize) -> *mut u8 {
    INPUT.with(|input| {
        let mut input = input.borrow_mut();
        input.clear();
        input.resize(bytes, 0);
        input.as_mut_ptr()
    })
}

/// Takes what the page has written.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_hear() {
    let text = INPUT.with(|input| String::from_utf8_lossy(&input.borrow()).into_owned());
    with_engine(|engine| engine.hear(&text));
}

/// Puts the next message into the output: 0 none, 1 text, 2 binary.
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

/// Where the output is.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_output() -> *const u8 {
    OUTPUT.with(|output| output.borrow().as_ptr())
}

/// How many bytes it has.
#[unsafe(no_mangle)]
pub extern "C" fn dermis_output_bytes() -> usize {
    OUTPUT.with(|output| output.borrow().len())
}
