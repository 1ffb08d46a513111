//! One file per command. To add one: a file with `Arguments` and their `run`, and a variant below.

mod acquired;
mod bench;
mod body;
mod calibrate;
mod circuit;
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

/// Where frames come from, by what the user wrote.
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

/// What can be asked for.
#[derive(clap::Subcommand)]
pub enum Command {
    /// Run a skin live: acquire, reconstruct, show a page in the browser.
    Run(run::Arguments),
    /// Check or draw the skins on a robot, or write a demonstration.
    Body(body::Arguments),
    /// Record a skin into a file.
    Record(record::Arguments),
    /// Run a recording through the pipeline again, as it was or with another prior.
    Replay(replay::Arguments),
    /// Say what a recording holds, and what it lacks.
    Info(info::Arguments),
    /// Make a whole recording of what is left of a broken one.
    Recover(recover::Arguments),
    /// Turn parts of a recording into tables for other programs.
    Export(export::Arguments),
    /// Solve a forward problem or make a difference image from a case file.
    Solve(solve::Arguments),
    /// Make images and touches of recorded frames.
    Reconstruct(reconstruct::Arguments),
    /// Label recorded frames: lowered or raised conductivity.
    Segment(segment::Arguments),
    /// Simulate samples for a network to learn from.
    TrainSet(train_set::Arguments),
    /// Train a network.
    Train(train::Arguments),
    /// Fit a calibration to pokes at known positions.
    Calibrate(calibrate::Arguments),
    /// Find out which order the numbers of an unknown file are in.
    Order(order::Arguments),
    /// Find a sheet's conductance in siemens from frames of one state, without a baseline.
    Conductance(conductance::Arguments),
    /// Begin a skin of your own: a commented skin file and its drawing.
    New(new::Arguments),
    /// List, show or draw skins.
    Skins(skins::Arguments),
    /// Signal-to-noise ratio of frames of an untouched skin.
    Snr(snr::Arguments),
    /// Say what skins will be able to do before they are built, and search for better protocols.
    Design(design::Arguments),
    /// Replay the experiments of the published skins on their twins.
    Reproduce(reproduce::Arguments),
    /// Run dermis on measurements that others published, beside plain methods, and write the tables.
    Evidence(evidence::Arguments),
    /// List serial ports and what answers at them.
    Devices(devices::Arguments),
    /// Examine an instrument and its skin, and say what to do about what is wrong.
    Doctor(doctor::Arguments),
    /// Ask one instrument who it is, set it, have it test itself or measure once.
    Device(device::Arguments),
    /// Let programs connect to a skin's twin as to an instrument.
    Twin(twin::Arguments),
    /// Time the numerical work on this machine.
    Bench(bench::Arguments),
    /// Completions for a shell, or manual pages.
    Completions(completions::Arguments),
}

impl Command {
    /// Runs it; results go to `out`.
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
