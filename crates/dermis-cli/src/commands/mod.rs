//! One file per command. To add one, write a file with `Arguments` and their `run`, and add a variant below.

mod acquired;
mod bench;
mod body;
mod calibrate;
mod completions;
mod conductance;
mod design;
mod device;
mod devices;
mod doctor;
mod evidence;
mod export;
mod extent;
mod info;
mod live_page;
mod new;
mod order;
mod printing;
mod progress;
mod reading;
mod reconstruct;
mod record;
mod recorded;
mod recover;
mod replay;
mod reproduce;
mod run;
mod segment;
mod skin_word;
mod skins;
mod snr;
mod solve;
mod tolerance_page;
mod train;
mod train_set;
mod twin;

/// Opens sources of frames from the text that the user wrote.
pub mod sources {
    pub use super::run::source::{Opened, open, open_of};
    pub use dermis::source::{SourceOptions, TwinControl};
}

use std::io::Write;

use crate::exit::Outcome;
pub use live_page::LivePage;
pub(crate) use printing::{escaped, hint, listed, print_json};
pub(crate) use progress::{busy, progress_bar, spinner, with_progress};
pub use skins::skin_svg;

/// The commands.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Run a skin live: acquire, reconstruct, show a page in the browser.
    Run(run::Arguments),
    /// Check or draw the skins on a robot, or write a demonstration.
    Body(body::Arguments),
    /// Record a skin into a file.
    Record(record::Arguments),
    /// Run a recording through the pipeline again, unchanged or with another prior.
    Replay(replay::Arguments),
    /// Show what a recording holds and what is missing.
    Info(info::Arguments),
    /// Rebuild a complete recording from a broken one.
    Recover(recover::Arguments),
    /// Export parts of a recording as tables for other programs.
    Export(export::Arguments),
    /// Solve a forward problem or make a difference image from a case file.
    Solve(solve::Arguments),
    /// Turn recorded frames into images and touches.
    Reconstruct(reconstruct::Arguments),
    /// Label recorded frames: lowered or raised conductivity.
    Segment(segment::Arguments),
    /// Simulate samples for a network to learn from.
    TrainSet(train_set::Arguments),
    /// Train a network.
    Train(train::Arguments),
    /// Fit a calibration to pokes at known positions.
    Calibrate(calibrate::Arguments),
    /// Find the channel order of an unknown file.
    Order(order::Arguments),
    /// Find a sheet's conductance in siemens from frames of a single state, without a baseline.
    Conductance(conductance::Arguments),
    /// Start a skin of your own: a commented skin file and its drawing.
    New(new::Arguments),
    /// List, show or draw skins.
    Skins(skins::Arguments),
    /// Signal-to-noise ratio of frames of an untouched skin.
    Snr(snr::Arguments),
    /// Predict what skins will be able to do before they are built, and search for better protocols.
    Design(design::Arguments),
    /// Replay the experiments of the published skins on their twins.
    Reproduce(reproduce::Arguments),
    /// Run dermis and plain methods on measurements published by others, and write the tables.
    Evidence(evidence::Arguments),
    /// List serial ports and the instruments that answer on them.
    Devices(devices::Arguments),
    /// Examine an instrument and its skin, and advise on any faults.
    Doctor(doctor::Arguments),
    /// Identify and configure one instrument, run its self-test or take one measurement.
    Device(device::Arguments),
    /// Serve a skin's twin to programs as if it were an instrument.
    Twin(twin::Arguments),
    /// Time the numerical work on this machine.
    Bench(bench::Arguments),
    /// Print completions for a shell, or write manual pages.
    Completions(completions::Arguments),
}

impl Command {
    /// Runs the command; results go to `out`.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match self {
            Command::Run(arguments) => arguments.run(out),
            Command::Body(arguments) => arguments.run(out),
            Command::Record(arguments) => arguments.run(out),
            Command::Replay(arguments) => arguments.run(out),
            Command::Info(arguments) => arguments.run(out),
            Command::Recover(arguments) => arguments.run(out),
            Command::Export(arguments) => arguments.run(out),
            Command::Reconstruct(arguments) => arguments.run(out),
            Command::Segment(arguments) => arguments.run(out),
            Command::TrainSet(arguments) => arguments.run(out),
            Command::Train(arguments) => arguments.run(out),
            Command::Calibrate(arguments) => arguments.run(out),
            Command::Reproduce(arguments) => arguments.run(out),
            Command::Evidence(arguments) => arguments.run(out),
            Command::Design(arguments) => arguments.run(out),
            Command::Devices(arguments) => arguments.run(out),
            Command::Doctor(arguments) => arguments.run(out),
            Command::Device(arguments) => arguments.run(out),
            Command::Twin(arguments) => arguments.run(out),
            Command::Bench(arguments) => arguments.run(out),
            Command::Completions(arguments) => arguments.run(out),
            Command::Solve(arguments) => arguments.run(out),
            Command::Skins(arguments) => arguments.run(out),
            Command::Conductance(arguments) => arguments.run(out),
            Command::Order(arguments) => arguments.run(out),
            Command::New(arguments) => arguments.run(out),
            Command::Snr(arguments) => arguments.run(out),
        }
    }
}
