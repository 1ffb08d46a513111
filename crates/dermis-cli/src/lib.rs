//! The `dermis` command as a library. [`run_command`] parses arguments and hands them to one module per command, so
//! that the binary and the Python package run the same code. The live page is separate from the commands, so that it
//! can be tested and demonstrated without a skin; also here is the code that opens the sources named by `--source`.
//! Your own programs should build on the crate `dermis`; use this one if you want its page.
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
//! The module [`page`] contains the whole page: the server, the messages to pages ([`page::Update`]), and the pages'
//! requests ([`page::Command`]).

#![forbid(unsafe_code)]

// Doc comments of arguments are printed as help, where brackets mean optional parts rather than links.
#[allow(rustdoc::broken_intra_doc_links)]
mod commands;
mod draw;
mod exit;
mod interrupt;
pub mod page;
mod terminal;

use std::ffi::{OsStr, OsString};
use std::fmt;
use std::io::{self, IsTerminal, Write};
use std::path::PathBuf;

use clap::Parser;
use dermis_record::UNDERSTOOD;
use tracing::{Event, Subscriber};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::fmt::FmtContext;
use tracing_subscriber::fmt::format::{FormatEvent, FormatFields, Writer};
use tracing_subscriber::registry::LookupSpan;

use commands::Command;
pub use commands::{LivePage, sources};

/// Tomographic tactile skins: from a skin file to touches.
#[derive(Parser)]
#[command(name = "dermis", version, propagate_version = true, max_term_width = 100)]
struct Cli {
    /// Print more on stderr; twice for details.
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Memory that preparing a skin may use, such as 8GB, even if it then takes long; default: three quarters of the
    /// machine's.
    #[arg(long, global = true, value_name = "SIZE", value_parser = dermis_skin::budget::parse_bytes)]
    memory: Option<u64>,
    #[command(subcommand)]
    command: Command,
}

/// Runs a command line, starting with the program's name, and returns its exit code: 0 done, 1 failed, 2 bad usage or
/// bad file, 3 finished but data was lost. Results go to stdout, messages to stderr.
pub fn run_command(arguments: impl IntoIterator<Item = OsString>) -> u8 {
    let arguments: Vec<OsString> = arguments.into_iter().collect();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        Err(error) => {
            // If even the message cannot be written, only the exit code is left. A message that quotes input must not
            // send control sequences to the terminal; colours are kept only if it contains none of them.
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
        dermis_skin::budget::set_memory_limit(bytes);
    }
    interrupt::reset();
    dermis_device::remember(arguments.iter().skip(1).flat_map(|word| named_files(word)));
    // Buffered so that output isn't interleaved, and filtered so that it sends no control sequences to a terminal.
    let mut out = io::BufWriter::new(terminal::Plain::new(io::stdout().lock()));
    let result = cli.command.run(&mut out).and_then(|outcome| {
        out.flush()?;
        Ok(outcome)
    });
    match result {
        Ok(outcome) => outcome.code(),
        Err(error) if exit::reader_has_gone(&error) => 0,
        Err(error) => {
            // Results from before the failure are still results. A second failure cannot be reported anywhere.
            let _ = out.flush();
            exit::report(&error);
            exit::code_of(&error)
        }
    }
}

/// A drawing of the skin with outline and numbered electrodes, as made by `dermis skins draw`.
///
/// # Errors
/// The skin cannot be meshed.
pub fn skin_svg(skin: &dermis_skin::Skin) -> anyhow::Result<String> {
    commands::skin_svg(skin)
}

/// Options of earlier versions are still accepted, with a hint at their new names.
fn hint_at_new_spellings(arguments: &[OsString]) {
    const RENAMED: [(&str, &str, &str); 2] =
        [("segment", "--reference", "--baseline"), ("train-set", "--noise-db", "--snr-db")];
    let words: Vec<String> = arguments.iter().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    for (command, old, new) in RENAMED {
        let is_old = |word: &String| word == old || word.starts_with(&format!("{old}="));
        if words.iter().any(|word| word == command) && words.iter().any(is_old) {
            commands::hint(&format!("{old} is now {new}"));
        }
    }
}

/// Files that an argument may name: `press.csv` itself, or the part after `--out=`.
fn named_files(word: &OsStr) -> impl Iterator<Item = PathBuf> {
    let behind = word.to_str().and_then(|text| text.split_once('=')).map(|(_, file)| PathBuf::from(file));
    [Some(PathBuf::from(word)), behind].into_iter().flatten()
}

/// Log lines with time and level, except for the line on how a file was understood, which has neither.
struct Plain<F> {
    format: F,
}

impl<S, N, F> FormatEvent<S, N> for Plain<F>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
    N: for<'a> FormatFields<'a> + 'static,
    F: FormatEvent<S, N>,
{
    fn format_event(&self, context: &FmtContext<'_, S, N>, mut out: Writer<'_>, event: &Event<'_>) -> fmt::Result {
        if event.metadata().target() != UNDERSTOOD {
            return self.format.format_event(context, out, event);
        }
        context.format_fields(out.by_ref(), event)?;
        writeln!(out)
    }
}

/// Log levels without `-v`. From the library behind `--foxglove` they show only viewers that fall behind, because it
/// logs every message to a viewer that has gone as an error.
const QUIET: &str = "warn,understood=info,foxglove=off,foxglove::websocket::connected_client::send_lossy=info";

/// Sends log lines to stderr, so that stdout holds only results.
fn start_logging(verbose: u8) {
    let level = match verbose {
        0 => QUIET,
        1 => "info",
        _ => "debug",
    };
    let filter = EnvFilter::try_from_env("DERMIS_LOG").unwrap_or_else(|_| EnvFilter::new(level));
    let logging = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(io::stderr)
        .with_target(false)
        .with_ansi(io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty()))
        .map_event_format(|format| Plain { format });
    // Fails for a second command in the same process, which then logs as the first did.
    let _ = logging.try_init();
}
