//! Exit codes and error messages. Errors map to codes by type, not by text.

use std::io;

use dermis_device::DeviceError;
use dermis_device::acquire::AcquisitionCounters;
use dermis_learn::LearnError;
use dermis_skin::FileError;
use dermis_tomo::eit::EitError;
use dermis_tomo::inverse::InverseError;
use dermis_twin::TwinError;

use crate::terminal::plain;

const FAILED: u8 = 1;
pub const BAD_INPUT: u8 = 2;
const DATA_LOST: u8 = 3;

/// How a command ended, if it didn't fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// Everything requested was done.
    Done,
    /// It looked for problems and reported some.
    ProblemsFound,
    /// It ran to its end, but frames were lost or damaged on the way; the number has been reported.
    DataLost,
}

impl Outcome {
    /// Data loss if any frame was lost by the source, on the way, or by a recording, or if the recording failed. Logs
    /// the counts. `incomplete` describes the part of the source that could not be read.
    pub fn of_frames(
        counters: AcquisitionCounters,
        incomplete: Option<&str>,
        not_recorded: u64,
        recording_failed: bool,
    ) -> Self {
        if let Some(incomplete) = incomplete {
            tracing::error!("{incomplete}");
        }
        if counters.repeated > 0 {
            tracing::warn!(repeated = counters.repeated, "duplicate frames were left out");
        }
        if counters.total() + not_recorded == 0 {
            return if recording_failed || incomplete.is_some() { Outcome::DataLost } else { Outcome::Done };
        }
        let AcquisitionCounters { dropped, lost, bad: damaged, .. } = counters;
        tracing::error!(dropped, lost, damaged, not_recorded, "frames were lost");
        Outcome::DataLost
    }

    /// Removes frames of a twin that a busy computer skipped, which are not lost data, from the count, and logs their
    /// number.
    pub fn without_twins_frames(counters: AcquisitionCounters) -> AcquisitionCounters {
        if counters.dropped > 0 {
            tracing::warn!(frames = counters.dropped, "the computer was too busy for some frames of the twin");
        }
        AcquisitionCounters { dropped: 0, ..counters }
    }

    /// The exit code.
    pub fn code(self) -> u8 {
        match self {
            Outcome::Done => 0,
            Outcome::ProblemsFound => FAILED,
            Outcome::DataLost => DATA_LOST,
        }
    }
}

/// Arguments that are valid one by one but not together, or that name something impossible.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Prints `error: ...`, then one line for each cause that the message doesn't contain already.
pub fn report(error: &anyhow::Error) {
    let mut said = plain(&error.to_string());
    eprintln!("error: {said}");
    for cause in error.chain().skip(1).map(|cause| plain(&cause.to_string())) {
        if !said.contains(&cause) {
            eprintln!("  caused by: {cause}");
            said = cause;
        }
    }
    if let Some(hint) = error.chain().find_map(hint_of) {
        eprintln!("hint: {hint}");
    }
}

/// Advice on the errors that users meet first.
fn hint_of(cause: &(dyn std::error::Error + 'static)) -> Option<&'static str> {
    if let Some(error) = cause.downcast_ref() {
        return hint_of_dermis(error);
    }
    if let Some(error) = cause.downcast_ref() {
        return hint_of_lab(error);
    }
    if let Some(dermis_record::Error::Live(error)) = cause.downcast_ref() {
        return hint_of_live(error);
    }
    let of_live = cause.downcast_ref().and_then(hint_of_live);
    of_live
        .or_else(|| cause.downcast_ref().and_then(hint_of_skin))
        .or_else(|| cause.downcast_ref().and_then(hint_of_device))
}

fn hint_of_dermis(error: &dermis::Error) -> Option<&'static str> {
    match error {
        dermis::Error::Lab(error) => hint_of_lab(error),
        dermis::Error::Skin(error) => hint_of_skin(error),
        dermis::Error::Live(error) => hint_of_live(error),
        dermis::Error::Record(error) => hint_of(error),
        dermis::Error::Device(error) => hint_of_device(error),
        dermis::Error::Patch { source, .. } => hint_of_dermis(source),
        _ => None,
    }
}

fn hint_of_lab(error: &dermis_lab::Error) -> Option<&'static str> {
    match error {
        dermis_lab::Error::Live(error) => hint_of_live(error),
        dermis_lab::Error::Record(error) => hint_of(error),
        _ => None,
    }
}

fn hint_of_skin(error: &dermis_skin::Error) -> Option<&'static str> {
    let is_unknown = matches!(error, dermis_skin::Error::UnknownSkin { .. });
    is_unknown.then_some("`dermis skins list` lists the built-in skins, `dermis new NAME` creates your own")
}

fn hint_of_live(error: &dermis_live::Error) -> Option<&'static str> {
    match error {
        dermis_live::Error::Skin(error) => hint_of_skin(error),
        dermis_live::Error::Device(error) => hint_of_device(error),
        dermis_live::Error::Frames { expected, .. } if expected.ends_with("channels") => {
            Some("`dermis order --baseline FILE` finds a protocol with this number of readings, for the skin file")
        }
        _ => None,
    }
}

fn hint_of_device(error: &DeviceError) -> Option<&'static str> {
    match error {
        DeviceError::SourceFailed { .. } => {
            Some("`dermis doctor SKIN --source SOURCE` explains what is wrong, `dermis devices` lists the ports")
        }
        DeviceError::Foreign { found, .. } if found.contains("Parquet") => {
            Some("`dermis export FILE.mcap --format csv` or npy writes tables that can be read here")
        }
        DeviceError::Foreign { .. } => {
            Some("frames are read from CSV, NumPy, recordings (.mcap), Sciospec .eit and others: see --format")
        }
        _ => None,
    }
}

/// True if the reader of our output closed it, as `head` does; that is not a failure.
pub fn reader_has_gone(error: &anyhow::Error) -> bool {
    error.downcast_ref::<io::Error>().is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// 2 if the input is to blame, 1 if the machine is.
pub fn code_of(error: &anyhow::Error) -> u8 {
    error.chain().find_map(code_of_cause).unwrap_or(FAILED)
}

fn code_of_cause(cause: &(dyn std::error::Error + 'static)) -> Option<u8> {
    if cause.is::<UsageError>() {
        return Some(BAD_INPUT);
    }
    cause
        .downcast_ref()
        .map(code_of_dermis)
        .or_else(|| cause.downcast_ref().map(code_of_lab))
        .or_else(|| cause.downcast_ref().map(code_of_body))
        .or_else(|| cause.downcast_ref().map(code_of_skin))
        .or_else(|| cause.downcast_ref().map(code_of_live))
        .or_else(|| cause.downcast_ref().map(code_of_record))
        .or_else(|| cause.downcast_ref().map(code_of_learn))
        .or_else(|| cause.downcast_ref().map(code_of_device))
        .or_else(|| cause.downcast_ref().map(code_of_io))
}

fn code_of_dermis(error: &dermis::Error) -> u8 {
    use dermis::Error;
    match error {
        Error::Skin(error) => code_of_skin(error),
        Error::Device(error) => code_of_device(error),
        Error::Live(error) => code_of_live(error),
        Error::Record(error) | Error::Guard { source: error } | Error::Foxglove { source: error } => {
            code_of_record(error)
        }
        Error::Lab(error) => code_of_lab(error),
        Error::Twin(TwinError::Skin(error)) => code_of_skin(error),
        Error::Body(error) => code_of_body(error),
        Error::Learn(error) => code_of_learn(error),
        Error::Forward(error) => code_of_forward(error),
        Error::Inverse(error) => code_of_inverse(error),
        Error::Patch { source, .. } => code_of_dermis(source),
        Error::Io(FileError { source, .. }) | Error::Joints { source, .. } => code_of_io(source),
        Error::Touch(_) | Error::Mesh(_) | Error::Protocol(_) | Error::Value { .. } | Error::NotATwin { .. } => {
            BAD_INPUT
        }
        _ => FAILED,
    }
}

fn code_of_lab(error: &dermis_lab::Error) -> u8 {
    match error {
        dermis_lab::Error::Live(error) => code_of_live(error),
        dermis_lab::Error::Record(error) => code_of_record(error),
        // For example a skin whose twin would cost too much.
        dermis_lab::Error::Twin(TwinError::Skin(error)) => code_of_skin(error),
        _ => FAILED,
    }
}

fn code_of_body(error: &dermis_body::Error) -> u8 {
    match error {
        dermis_body::Error::Io(FileError { source, .. }) => code_of_io(source),
        dermis_body::Error::Skin { source, .. } => code_of_skin(source),
        _ => BAD_INPUT,
    }
}

fn code_of_skin(error: &dermis_skin::Error) -> u8 {
    match error {
        dermis_skin::Error::Io(FileError { source, .. }) => code_of_io(source),
        _ => BAD_INPUT,
    }
}

fn code_of_live(error: &dermis_live::Error) -> u8 {
    use dermis_live::Error;
    match error {
        Error::Skin(error) => code_of_skin(error),
        Error::Content { .. } | Error::Frames { .. } | Error::Mesh { .. } | Error::Protocol { .. } => BAD_INPUT,
        Error::OtherSkin { .. } => BAD_INPUT,
        Error::Touch(_) => BAD_INPUT,
        Error::Io(FileError { source, .. }) => code_of_io(source),
        Error::Device(error) => code_of_device(error),
        Error::Learn(error) => code_of_learn(error),
        Error::Forward(error) => code_of_forward(error),
        Error::Inverse(error) => code_of_inverse(error),
        _ => FAILED,
    }
}

fn code_of_record(error: &dermis_record::Error) -> u8 {
    match error {
        dermis_record::Error::Live(error) => code_of_live(error),
        _ => FAILED,
    }
}

fn code_of_forward(error: &EitError) -> u8 {
    if matches!(error, EitError::System(_)) { FAILED } else { BAD_INPUT }
}

fn code_of_inverse(error: &InverseError) -> u8 {
    if matches!(error, InverseError::Singular { .. }) { FAILED } else { BAD_INPUT }
}

fn code_of_learn(error: &LearnError) -> u8 {
    match error {
        LearnError::Io { source, .. } => code_of_io(source),
        _ => BAD_INPUT,
    }
}

fn code_of_device(error: &DeviceError) -> u8 {
    match error {
        DeviceError::Io { source, .. } => code_of_io(source),
        DeviceError::SourceFailed { .. } => FAILED,
        _ => BAD_INPUT,
    }
}

/// A path that leads nowhere is a typing error; any other I/O error is the machine's fault.
fn code_of_io(error: &io::Error) -> u8 {
    use io::ErrorKind::{InvalidData, InvalidInput, IsADirectory, NotADirectory, NotFound};
    let is_input = matches!(error.kind(), NotFound | IsADirectory | NotADirectory | InvalidInput | InvalidData);
    if is_input { BAD_INPUT } else { FAILED }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn io_error(kind: io::ErrorKind) -> dermis::Error {
        dermis::Error::Io(FileError { file: "x".into(), source: kind.into() })
    }

    #[test]
    fn codes_follow_the_kind_of_error() {
        let foreign = DeviceError::Foreign { file: "x".into(), expected: "a table", found: "a PNG image".into() };
        let singular = InverseError::Singular { what: "the system", hint: "raise it" };
        let cases: [(anyhow::Error, u8); 7] = [
            (UsageError("no".into()).into(), BAD_INPUT),
            (dermis::Error::Device(foreign).into(), BAD_INPUT),
            (io_error(io::ErrorKind::NotFound).into(), BAD_INPUT),
            (io_error(io::ErrorKind::AddrInUse).into(), FAILED),
            (io_error(io::ErrorKind::StorageFull).into(), FAILED),
            (dermis::Error::Inverse(singular).into(), FAILED),
            (anyhow::anyhow!("something else"), FAILED),
        ];
        for (error, expected) in cases {
            let context = format!("{error:?}");
            assert_eq!(code_of(&error), expected, "{context}");
            assert_eq!(code_of(&error.context("while reading")), expected, "{context}");
        }
    }

    #[test]
    fn a_closed_pipe_is_no_failure() {
        assert!(reader_has_gone(&io::Error::from(io::ErrorKind::BrokenPipe).into()));
        assert!(!reader_has_gone(&io::Error::from(io::ErrorKind::StorageFull).into()));
    }
}
