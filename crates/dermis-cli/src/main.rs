//! The `dermis` command. Arguments are parsed here and handed to one module per command; what a command returns becomes the
//! exit code: 0 done, 1 failed, 2 bad usage or bad file, 3 finished but data was lost.

#![forbid(unsafe_code)]

mod commands;
mod draw;
mod exit;

use std::io::{self, IsTerminal, Write};
use std::process::ExitCode;

use clap::Parser;
use tracing_subscriber::EnvFilter;

use commands::Command;

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Tomographic tactile skins: from a skin file to touches.
#[derive(Parser)]
#[command(name = "dermis", version, propagate_version = true)]
struct Cli {
    /// Say more on stderr; twice for details.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    #[command(subcommand)]
    command: Command,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    start_logging(cli.verbose);
    let mut out = io::BufWriter::new(io::stdout().lock());
    let result = cli.command.run(&mut out).and_then(|outcome| {
        out.flush()?;
        Ok(outcome)
    });
    match result {
        Ok(outcome) => outcome.code(),
        Err(error) if exit::reader_has_gone(&error) => ExitCode::SUCCESS,
        Err(error) => {
            // Results that came before the failure are still results; a second failure has nowhere to be told.
            let _ = out.flush();
            exit::report(&error);
            exit::code_of(&error)
        }
    }
}

/// Log lines go to stderr, so that stdout holds results alone.
fn start_logging(verbose: u8) {
    let level = match verbose {
        0 => "warn",
        1 => "info",
        _ => "debug",
    };
    let filter = EnvFilter::try_from_env("DERMIS_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_target(false)
        .with_ansi(io::stderr().is_terminal())
        .init();
}
