//! The `dermis` command: see [`dermis_cli::run_command`].

#![forbid(unsafe_code)]

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    ExitCode::from(dermis_cli::run_command(std::env::args_os()))
}
