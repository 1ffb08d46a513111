//! Firmware for tomographic backends: a scan engine that measures any list of electrode quadruples and speaks the
//! wire protocol, and boards described by the chips on their buses. It needs a microcontroller with SPI, I2C, a
//! serial line and 32 KiB of RAM, all driven through embedded-hal 1.0 and embedded-io.
//!
//! A main loop only has to call [`Engine::poll`]. [`mux64::Mux64`] is the resistance backend with a 64-channel
//! multiplexer; [`magnitude::Magnitude`] is the induction backend with a rectifier. Another board implements
//! [`Board`]; the book's chapter on firmware explains how, with wiring and timing.

#![no_std]

pub mod board;
mod command;
pub mod converter;
mod engine;
pub mod magnitude;

pub mod mux64;
pub mod protocol;
mod scan;

pub use board::{Board, Facts, Failure, Reading};
pub use engine::{Clock, Engine, Identity, STATE_BUDGET};
pub use protocol::{MOST_ELECTRODES, Named, Protocol};
pub use scan::PART_READINGS;
