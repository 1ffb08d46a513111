//! `dermis twin serve`: a skin's digital twin behind the wire that real instruments speak, for whoever connects.

use std::io::Write;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use dermis::serve::{device_info, serve};
use dermis::skin::Skin;
use dermis::twin_source::TwinSource;

use crate::exit::{Outcome, UsageError};

const EXAMPLE: &str = "\
Examples:
  dermis twin serve healing-square --tcp 127.0.0.1:0 --frames 10

A twin answers and streams as an instrument on a cable does. The address is printed, and how to run the skin from it; port 0
takes a free one. The twin begins to measure when the first host asks for frames, and goes on when hosts come and go.";

/// Arguments of `dermis twin`.
#[derive(clap::Args)]
#[command(after_help = EXAMPLE)]
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
#[command(after_help = EXAMPLE)]
struct Serve {
    /// Built-in skin or skin file.
    #[arg(default_value = "healing-square", value_name = "SKIN")]
    skin: String,
    /// Address to listen on.
    #[arg(long, default_value = "127.0.0.1:7879", value_name = "ADDRESS:PORT")]
    tcp: SocketAddr,
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
        let (twin, _commands) = TwinSource::new(&skin)?;
        let socket = |source| dermis::Error::Io { file: self.tcp.to_string().into(), source };
        let listener = TcpListener::bind(self.tcp).map_err(socket)?;
        let address = listener.local_addr().map_err(socket)?;
        writeln!(out, "serving: dermis run {} --source tcp:{address}", self.skin)?;
        out.flush()?;
        let stop = Arc::new(AtomicBool::new(false));
        let raised = stop.clone();
        ctrlc::set_handler(move || raised.store(true, Ordering::Relaxed))?;
        let served = serve(&listener, twin, info, self.frames, &stop)?;
        writeln!(out, "{} frames, {} skipped, {} hosts", served.frames, served.skipped, served.hosts)?;
        Ok(if served.skipped > 0 { Outcome::DataLost } else { Outcome::Done })
    }
}
