//! `dermis twin`: serves a skin's digital twin over the wire protocol of real instruments, or presses it according to
//! a table.

use std::io::{BufRead, Read, Write};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};

use dermis_lab::serve::{Door, WORDS, command_of, device_info, serve};
use dermis_lab::twin_commands::CommandRefused;
use dermis_lab::twin_sample::{SampleRequest, random_presses, read_presses, sample};
use dermis_lab::twin_source::{TwinCommands, TwinSource};
use dermis_skin::{DEFAULT_NAME, FileError, Skin};
use dermis_twin::PressRange;

use crate::exit::{Outcome, UsageError};
use crate::interrupt;

const EXAMPLE: &str = "\
Examples:
  dermis twin serve healing-square --tcp 127.0.0.1:0 --frames 10
  dermis twin serve piezo-disc --pty --frames 2

A twin answers and streams like an instrument on a cable. The address is printed with the command that runs the skin \
from it; port 0 takes a free one. With --pty it serves on a pseudo-terminal, like a board at a serial port. The twin \
starts measuring when the first host asks for frames, and continues as hosts come and go.

Lines on standard input press it and break it while it runs (X right, Y up, from the centre):
";

/// Arguments of `dermis twin`.
#[derive(clap::Args)]
#[command(after_help = format!("{EXAMPLE}{WORDS}"))]
pub struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Serve a twin to programs as if it were an instrument.
    Serve(Serve),
    /// Press a twin according to a table and write its frames: labelled data for a skin that need not exist.
    Sample(Sample),
}

const SAMPLE_EXAMPLE: &str = "\
Examples:
  dermis twin sample ionic-disc --presses random:5 --baseline rest.npy \\
      --frames presses.npy --truth truth.csv
  dermis twin sample piezo-disc --presses random:2 --baseline rest.csv \\
      --frames frames.csv --repeats 5

A table of presses has the columns x_mm, y_mm, one of force_n and pressure_kpa, and optionally radius_mm and group: \
rows of the same group press together. Each press is held for a second; frames include the instrument's noise. \
`dermis reconstruct` and `dermis calibrate` read the frames, and the truth as positions.";

#[derive(clap::Args)]
#[command(after_help = SAMPLE_EXAMPLE)]
struct Sample {
    /// Built-in skin or skin file.
    #[arg(value_name = "SKIN")]
    skin: String,
    /// A CSV table of presses, or `random:N` single presses of the skin's usual size within 85 % of its outline.
    #[arg(long, value_name = "FILE.csv|random:N")]
    presses: String,
    /// Output file for 32 frames of the untouched skin.
    #[arg(long, value_name = "FILE.csv|FILE.npy")]
    baseline: PathBuf,
    /// Output file for the frames of the presses, in order.
    #[arg(long, value_name = "FILE.csv|FILE.npy")]
    frames: PathBuf,
    /// Output file for the true presses in each frame.
    #[arg(long, value_name = "FILE.csv")]
    truth: Option<PathBuf>,
    /// Seed of the noise and of random presses.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Give the twin random errors within the file's `[tolerances]`; each number gives different ones. Without this the
    /// twin matches its file exactly.
    #[arg(long, value_name = "N")]
    built: Option<u64>,
    /// Frames per press.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeats: u32,
}

impl Sample {
    fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let skin = Skin::open(&self.skin)?;
        let usual = dermis_twin::from_skin::press_range(&skin);
        let presses = match self.presses.strip_prefix("random:") {
            Some(count) => {
                let count: usize =
                    count.parse().ok().filter(|count| (1..=1_000_000).contains(count)).ok_or_else(|| {
                        UsageError(format!("--presses {}: expected random:N with N from 1 to 1000000", self.presses))
                    })?;
                random_presses(&skin.outline(), &usual, count, self.seed.unwrap_or(1))?
            }
            None => read_presses(Path::new(&self.presses), &usual)?,
        };
        let (baseline, frames, truth) = (self.baseline, self.frames, self.truth);
        let repeats = self.repeats as usize;
        let request =
            SampleRequest { skin, presses, baseline, frames, truth, seed: self.seed, built: self.built, repeats };
        let bar = super::progress_bar("presses");
        let made = sample(&request, |done, all| {
            bar.set_length(all as u64);
            bar.set_position(done as u64);
        })?;
        bar.finish_and_clear();
        writeln!(
            out,
            "{} frames of {} presses, {} channels, to {}",
            made.frames,
            made.presses,
            made.channels,
            request.frames.display()
        )?;
        if made.outside_validity > 0 {
            writeln!(out, "{} presses are beyond the model's validity: see the skin's chapter", made.outside_validity)?;
        }
        Ok(Outcome::Done)
    }
}

#[derive(clap::Args)]
#[command(after_help = format!("{EXAMPLE}{WORDS}"))]
struct Serve {
    /// Built-in skin or skin file.
    #[arg(default_value = DEFAULT_NAME, value_name = "SKIN")]
    skin: String,
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1:7879", value_name = "ADDRESS:PORT")]
    tcp: SocketAddr,
    /// Serve on a pseudo-terminal, like a serial port.
    #[arg(long, conflicts_with = "tcp")]
    pty: bool,
    /// Switch off the demonstration, touches that the twin shows when nothing presses it.
    #[arg(long)]
    no_demo: bool,
    /// Allow an address that others on the network can reach; there is no password.
    #[arg(long)]
    to_network: bool,
    /// Stop after this many frames, which are counted even if no host connects.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
}

impl Arguments {
    /// Runs the selected action; serving continues until stopped.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match self.action {
            Action::Serve(arguments) => arguments.run(out),
            Action::Sample(arguments) => arguments.run(out),
        }
    }
}

impl Serve {
    fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if !self.tcp.ip().is_loopback() && !self.to_network {
            let text = format!("--tcp {}: others could connect; --to-network allows them to", self.tcp);
            return Err(UsageError(text).into());
        }
        let skin = Skin::open(&self.skin)?;
        let info = device_info(&skin)?;
        let (mut twin, commands) = TwinSource::new(&skin)?;
        if self.no_demo {
            twin = twin.undemonstrated();
        }
        let (mut door, selector) = self.door()?;
        writeln!(out, "serving: dermis run {} --source {selector}", self.skin)?;
        out.flush()?;
        let stop = interrupt::begin();
        let press = twin.press_range();
        std::thread::spawn(move || obey_lines(&commands, &press));
        let served = serve(&mut door, twin, info, self.frames, stop)?;
        writeln!(out, "{} frames, {} skipped, {} hosts", served.frames, served.skipped, served.hosts)?;
        Ok(if served.skipped > 0 { Outcome::DataLost } else { Outcome::Done })
    }

    /// Opens the port for hosts, and returns what they should give as `--source`.
    fn door(&self) -> anyhow::Result<(Door, String)> {
        if self.pty {
            return pty();
        }
        let failed = |source| dermis_live::Error::Io(FileError { file: self.tcp.to_string().into(), source });
        let listener = TcpListener::bind(self.tcp).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok((Door::tcp(listener).map_err(failed)?, format!("tcp:{address}")))
    }
}

#[cfg(unix)]
fn pty() -> anyhow::Result<(Door, String)> {
    let failed = |source| dermis_live::Error::Io(FileError { file: "pseudo-terminal".into(), source });
    let pty = dermis_device::stream::Pty::open().map_err(failed)?;
    let selector = format!("serial:{}", pty.path());
    Ok((Door::Pty(pty), selector))
}

#[cfg(not(unix))]
fn pty() -> anyhow::Result<(Door, String)> {
    Err(UsageError("--pty: this system has no pseudo-terminals; use --tcp".to_owned()).into())
}

/// Longest line of standard input, bytes.
const MOST_LINE: u64 = 64 * 1024;

/// Passes commands from standard input to the twin until either ends.
fn obey_lines(commands: &TwinCommands, press: &PressRange) {
    let mut input = std::io::stdin().lock();
    let mut line = Vec::new();
    loop {
        line.clear();
        match input.by_ref().take(MOST_LINE).read_until(b'\n', &mut line) {
            Ok(0) | Err(_) => return,
            Ok(_) => {}
        }
        if line.len() as u64 == MOST_LINE && line.last() != Some(&b'\n') {
            tracing::warn!("a line of more than {MOST_LINE} bytes was skipped");
            if input.skip_until(b'\n').is_err() {
                return;
            }
            continue;
        }
        match command_of(&String::from_utf8_lossy(&line), press) {
            Ok(None) => {}
            Ok(Some(command)) => match commands.send(command) {
                Ok(()) => {}
                Err(CommandRefused::Ended) => return,
                Err(refused) => tracing::warn!("refused: {refused}"),
            },
            Err(problem) => tracing::warn!("{problem}"),
        }
    }
}
