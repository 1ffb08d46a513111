//! `dermis twin serve`: a skin's digital twin behind the wire that real instruments speak, for whoever connects.

use std::io::{BufRead, Write};
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis::serve::{Door, WORDS, command_of, device_info, serve};
use dermis::skin::Skin;
use dermis::twin_source::{TwinCommand, TwinSource};
use dermis::twins::PressRange;

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis twin serve healing-square --tcp 127.0.0.1:0 --frames 10
  dermis twin serve piezo-disc --pty --frames 2

A twin answers and streams as an instrument on a cable does. The address is printed, and how to run the skin from it; port 0
takes a free one. With --pty it stands at a pseudo-terminal, as a board at a serial port. The twin begins to measure when the
first host asks for frames, and goes on when hosts come and go.

Lines on standard input press it and break it while it runs (X right, Y up, from the middle):
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
    /// Let programs connect to a twin as to an instrument.
    Serve(Serve),
}

#[derive(clap::Args)]
#[command(after_help = format!("{EXAMPLE}{WORDS}"))]
struct Serve {
    /// Built-in skin or skin file.
    #[arg(default_value = "healing-square", value_name = "SKIN")]
    skin: String,
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1:7879", value_name = "ADDRESS:PORT")]
    tcp: SocketAddr,
    /// Stand at a pseudo-terminal, as at a serial port.
    #[arg(long, conflicts_with = "tcp")]
    pty: bool,
    /// Without the touches that the twin shows by itself.
    #[arg(long)]
    no_demo: bool,
    /// Allow an address that others on the network reach; there is no password.
    #[arg(long)]
    to_network: bool,
    /// Stop after so many frames, which are taken whether or not anyone connects.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
}

impl Arguments {
    /// Serves until told to stop.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let Action::Serve(arguments) = self.action;
        arguments.run(out)
    }
}

impl Serve {
    fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        if !self.tcp.ip().is_loopback() && !self.to_network {
            let text = format!("--tcp {}: others could connect; say --to-network if they may", self.tcp);
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
        let stop = Arc::new(AtomicBool::new(false));
        let raised = stop.clone();
        ctrlc::set_handler(move || raised.store(true, Ordering::Relaxed))?;
        let press = twin.press_range();
        std::thread::spawn(move || obey_lines(&commands, &press));
        let served = serve(&mut door, twin, info, self.frames, &stop)?;
        writeln!(out, "{} frames, {} skipped, {} hosts", served.frames, served.skipped, served.hosts)?;
        Ok(if served.skipped > 0 { Outcome::DataLost } else { Outcome::Done })
    }

    /// Where hosts come in, and what they write as `--source`.
    fn door(&self) -> anyhow::Result<(Door, String)> {
        if self.pty {
            return pty();
        }
        let failed = |source| dermis::Error::Io { file: self.tcp.to_string().into(), source };
        let listener = TcpListener::bind(self.tcp).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        Ok((Door::tcp(listener).map_err(failed)?, format!("tcp:{address}")))
    }
}

#[cfg(unix)]
fn pty() -> anyhow::Result<(Door, String)> {
    let failed = |source| dermis::Error::Io { file: "pseudo-terminal".into(), source };
    let pty = dermis_device::stream::Pty::open().map_err(failed)?;
    let selector = format!("serial:{}", pty.path());
    Ok((Door::Pty(pty), selector))
}

#[cfg(not(unix))]
fn pty() -> anyhow::Result<(Door, String)> {
    Err(UsageError("--pty: this system has no pseudo-terminals; use --tcp".to_owned()).into())
}

/// Hands on what standard input says, until it ends or the twin does.
fn obey_lines(commands: &crossbeam_channel::Sender<TwinCommand>, press: &PressRange) {
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        match command_of(&line, press) {
            Ok(None) => {}
            Ok(Some(command)) if commands.send(command).is_ok() => {}
            Ok(Some(_)) => return,
            Err(problem) => tracing::warn!("{problem}"),
        }
    }
}
