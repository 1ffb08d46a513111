//! The `dermis` command as a library: [`run_command`] parses arguments and hands them to one module per command, so
//! that the binary and the Python package run the same. Beside it the live page, kept apart from the commands so that
//! it can be tested and demonstrated without a skin, and what opens the sources that `--source` names. Programs of your
//! own build on the crate `dermis`; this one is for those who want its page.
//!
//! ```
//! use dermis_cli::page::{Hub, PageOptions, Scene, Update, serve};
//!
//! let hub = Hub::new();
//! let (commands, requests) = crossbeam_channel::bounded(16);
//! let server = serve(([127, 0, 0, 1], 0).into(), PageOptions::default(), hub.clone(), Scene::default(), commands)?;
//! assert!(server.url().starts_with("http://127.0.0.1:"));
//! hub.publish(&Update::default())?; // To every page that is open.
//! assert!(requests.try_recv().is_err(), "nobody has asked for anything");
//! server.shutdown();
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The module [`page`] is all of the page: the server, what it tells pages ([`page::Update`]), and what they ask
//! ([`page::Command`]).

#![forbid(unsafe_code)]

mod commands;
mod draw;
mod exit;
mod interrupt;
pub mod page;
mod terminal;

use std::ffi::{OsStr, OsString};
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::Parser;
use tracing_subscriber::EnvFilter;

use commands::Command;
pub use commands::{LivePage, sources};

/// Tomographic tactile skins: from a skin file to touches.
#[derive(Parser)]
#[command(name = "dermis", version, propagate_version = true)]
struct Cli {
    /// Say more on stderr; twice for details.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Memory that preparing a skin may use, such as 8GB, however long that takes; three quarters of the machine's
    /// where left out.
    #[arg(long, global = true, value_name = "SIZE", value_parser = dermis::skin::budget::parse_bytes)]
    memory: Option<u64>,
    #[command(subcommand)]
    command: Command,
}

/// Runs a command line, the program's name first, and returns its exit code: 0 done, 1 failed, 2 bad usage or bad file,
/// 3 finished but data was lost. Results go to stdout, messages to stderr.
pub fn run_command(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        Err(error) => {
            // Where even the message cannot be written, the code is all that is left. A message with what was typed in
            // it commands no terminal; colours are for those that hold nothing of the kind.
            let text = error.render().to_string();
            let said = terminal::plain(&text);
            let _ = match (said == text, error.use_stderr()) {
                (true, _) => error.print(),
                (false, true) => io::stderr().write_all(said.as_bytes()),
                (false, false) => io::stdout().write_all(said.as_bytes()),
            };
            return u8::try_from(error.exit_code()).unwrap_or(exit::BAD_INPUT);
        }
    };
    start_logging(cli.verbose);
    hint_at_new_spellings(&arguments);
    if let Some(bytes) = cli.memory {
        dermis::skin::budget::set_memory_limit(bytes);
    }
    interrupt::reset();
    dermis_device::remember(arguments.iter().skip(1).flat_map(|word| named_files(word)));
    // What is written in one go stays together; nothing in it commands a terminal.
    let mut out = io::BufWriter::new(terminal::Plain::new(io::stdout().lock()));
    let result = cli.command.run(&mut out).and_then(|outcome| {
        out.flush()?;
        Ok(outcome)
    });
    match result {
        Ok(outcome) => outcome.code(),
        Err(error) if exit::reader_has_gone(&error) => 0,
        Err(error) => {
            // Results that came before the failure are still results; a second failure has nowhere to be told.
            let _ = out.flush();
            exit::report(&error);
            exit::code_of(&error)
        }
    }
}

/// The skin as a drawing: outline, electrodes and their numbers, as `dermis skins draw` has it.
///
/// # Errors
/// A skin that cannot be meshed.
pub fn skin_svg(skin: &dermis::Skin) -> anyhow::Result<String> {
    commands::skin_svg(skin)
}

/// Options of earlier versions are understood; what they are called now is said.
fn hint_at_new_spellings(arguments: &[OsString]) {
    const RENAMED: [(&str, &str, &str); 2] =
        [("segment", "--reference", "--baseline"), ("train-set", "--noise-db", "--snr-db")];
    let words: Vec<String> = arguments.iter().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    for (command, old, new) in RENAMED {
        let is_old = |word: &String| word == old || word.starts_with(&format!("{old}="));
        if words.iter().any(|word| word == command) && words.iter().any(is_old) {
            commands::hint(&format!("{old} is {new} now"));
        }
    }
}

/// The files that an argument may name: `press.csv` itself, or what stands behind `--out=`.
fn named_files(word: &OsStr) -> impl Iterator<Item = PathBuf> {
    let behind = word.to_str().and_then(|text| text.split_once('=')).map(|(_, file)| PathBuf::from(file));
    [Some(PathBuf::from(word)), behind].into_iter().flatten()
}

/// Log lines go to stderr, so that stdout holds results alone.
fn start_logging(verbose: u8) {
    let level = match verbose {
        0 => "warn,understood=info",
        1 => "info",
        _ => "debug",
    };
    let filter = EnvFilter::try_from_env("DERMIS_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let logging = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_target(false)
        .with_ansi(io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty()));
    // A process that runs a second command logs as for the first.
    let _ = logging.try_init();
}
