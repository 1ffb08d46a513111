//! The library half of the `dermis` command: the live page, kept apart from the commands so that it can be tested and
//! demonstrated without a skin.

#![forbid(unsafe_code)]

pub mod page;
