//! Converts errors of dermis to Python exceptions, with the same text as the command: the message, followed by the
//! causes that it doesn't contain already. The classes are defined in Python (`dermis/errors.py`), so that they can
//! be subclasses of `ValueError` and `OSError`.

use std::io;

use dermis_lab::Error as LabError;
use dermis_live::Error as LiveError;
use dermis_record::Error as RecordError;
use dermis_skin::{Error as SkinError, FileError};
use pyo3::prelude::*;
use pyo3::types::PyType;

/// Longest message, and longest argument quoted in it, characters.
const MOST_SHOWN: usize = 2000;
const MOST_ECHOED: usize = 200;

/// The exception that represents an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A skin file or something derived from it.
    Skin,
    /// Arguments: arrays, numbers, names.
    Input,
    /// A file that cannot be read, or has other content.
    File,
    /// An instrument or another source.
    Source,
    /// Equations that could not be solved.
    Solver,
    /// A session that is closed, or belongs to another process.
    Session,
    /// A bug in dermis.
    Internal,
    /// None of these.
    Other,
}

impl Kind {
    fn class(self) -> &'static str {
        match self {
            Self::Skin => "SkinError",
            Self::Input => "InputError",
            Self::File => "FileError",
            Self::Source => "SourceError",
            Self::Solver => "SolverError",
            Self::Session => "SessionError",
            Self::Internal => "InternalError",
            Self::Other => "Error",
        }
    }
}

/// An error on its way to Python. It is made without the interpreter, so that detached work can return it.
#[derive(Debug)]
pub struct Fault {
    kind: Kind,
    message: String,
}

impl Fault {
    /// A fault of this kind with this message.
    pub fn new(kind: Kind, message: impl Into<String>) -> Self {
        Self { kind, message: shown(&message.into(), MOST_SHOWN) }
    }

    /// An invalid argument.
    pub fn input(what: &str, expected: impl std::fmt::Display, got: impl std::fmt::Display) -> Self {
        let got = shown(&got.to_string(), MOST_ECHOED);
        Self::new(Kind::Input, format!("{what}: expected {expected}, got {got}"))
    }

    /// Prefixes the message with the place of the fault.
    #[must_use]
    pub fn at(mut self, place: &str) -> Self {
        self.message = format!("{place}: {}", self.message);
        self
    }

    fn of(kind: Kind, error: &(dyn std::error::Error + 'static)) -> Self {
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(next) = cause {
            let said = next.to_string();
            if !message.contains(&said) {
                message = format!("{message}\n  caused by: {said}");
            }
            cause = next.source();
        }
        Self::new(kind, message)
    }
}

/// Text for a message: control characters except line ends are escaped, and the middle of long text is left out.
fn shown(text: &str, most: usize) -> String {
    let count = text.chars().count();
    let escaped = |text: &mut dyn Iterator<Item = char>| -> String {
        let mut shown = String::new();
        for letter in text {
            if letter.is_control() && letter != '\n' {
                shown.extend(letter.escape_default());
            } else {
                shown.push(letter);
            }
        }
        shown
    };
    if count <= most {
        return escaped(&mut text.chars());
    }
    let half = most / 2;
    let (head, tail) = (escaped(&mut text.chars().take(half)), escaped(&mut text.chars().skip(count - half)));
    format!("{head} ... ({} characters left out) ... {tail}", count - 2 * half)
}

impl From<Fault> for PyErr {
    fn from(fault: Fault) -> Self {
        Python::attach(|py| {
            let class = py.import("dermis.errors").and_then(|module| module.getattr(fault.kind.class()));
            match class.and_then(|class| Ok(class.cast_into::<PyType>()?)) {
                Ok(class) => PyErr::from_type(class, fault.message),
                Err(error) => error,
            }
        })
    }
}

fn kind_of_io(error: &io::Error) -> Kind {
    match error.kind() {
        io::ErrorKind::InvalidInput => Kind::Input,
        _ => Kind::File,
    }
}

fn kind_of_forward(error: &dermis_tomo::eit::EitError) -> Kind {
    if matches!(error, dermis_tomo::eit::EitError::System(_)) { Kind::Solver } else { Kind::Input }
}

fn kind_of_inverse(error: &dermis_tomo::inverse::InverseError) -> Kind {
    if matches!(error, dermis_tomo::inverse::InverseError::Singular { .. }) { Kind::Solver } else { Kind::Input }
}

fn kind_of_device(error: &dermis_device::DeviceError) -> Kind {
    use dermis_device::DeviceError;
    match error {
        DeviceError::Io { source, .. } => kind_of_io(source),
        DeviceError::SourceFailed { .. } => Kind::Source,
        _ => Kind::File,
    }
}

fn kind_of_learn(_: &dermis_learn::LearnError) -> Kind {
    Kind::File
}

fn kind_of_skin(error: &SkinError) -> Kind {
    match error {
        SkinError::Io(FileError { source, .. }) => kind_of_io(source),
        _ => Kind::Skin,
    }
}

fn kind_of_live(error: &LiveError) -> Kind {
    match error {
        LiveError::Skin(error) => kind_of_skin(error),
        LiveError::Io(FileError { source, .. }) => kind_of_io(source),
        LiveError::Content { .. } => Kind::File,
        LiveError::OtherSkin { .. } => Kind::Input,
        LiveError::Frames { .. } | LiveError::Touch(_) | LiveError::Locator(_) | LiveError::Quality(_) => Kind::Input,
        LiveError::Mesh { .. } | LiveError::Protocol { .. } | LiveError::Magnetic(_) => Kind::Skin,
        LiveError::Forward(error) => kind_of_forward(error),
        LiveError::Inverse(error) => kind_of_inverse(error),
        LiveError::Device(error) => kind_of_device(error),
        LiveError::Learn(error) => kind_of_learn(error),
        LiveError::Equations(_) => Kind::Solver,
        _ => Kind::Other,
    }
}

fn kind_of_record(error: &RecordError) -> Kind {
    match error {
        RecordError::Live(error) => kind_of_live(error),
        _ => Kind::Other,
    }
}

fn kind_of_lab(error: &LabError) -> Kind {
    match error {
        LabError::Live(error) => kind_of_live(error),
        LabError::Record(error) => kind_of_record(error),
        LabError::Twin(error) => kind_of_twin(error),
        _ => Kind::Other,
    }
}

fn kind_of_facade(error: &dermis::Error) -> Kind {
    use dermis::Error;
    match error {
        Error::Skin(error) => kind_of_skin(error),
        Error::Device(error) => kind_of_device(error),
        Error::Live(error) => kind_of_live(error),
        Error::Record(error) => kind_of_record(error),
        Error::Lab(error) => kind_of_lab(error),
        Error::Twin(error) => kind_of_twin(error),
        Error::Learn(error) => kind_of_learn(error),
        Error::Forward(error) => kind_of_forward(error),
        Error::Inverse(error) => kind_of_inverse(error),
        Error::Mesh(_) | Error::Protocol(_) | Error::Magnetic(_) => Kind::Skin,
        Error::Touch(_) | Error::Locator(_) | Error::Quality(_) | Error::Value { .. } => Kind::Input,
        Error::Io(FileError { source, .. }) => kind_of_io(source),
        _ => Kind::Other,
    }
}

fn kind_of_twin(error: &dermis_twin::TwinError) -> Kind {
    match error {
        dermis_twin::TwinError::Skin(error) => kind_of_skin(error),
        _ => Kind::Input,
    }
}

/// The kind of an error by its type, or the kind of its first cause that has one.
fn kind_of(cause: &(dyn std::error::Error + 'static)) -> Option<Kind> {
    None.or_else(|| cause.downcast_ref().map(kind_of_facade))
        .or_else(|| cause.downcast_ref().map(kind_of_lab))
        .or_else(|| cause.downcast_ref().map(kind_of_live))
        .or_else(|| cause.downcast_ref().map(kind_of_record))
        .or_else(|| cause.downcast_ref().map(kind_of_skin))
        .or_else(|| cause.downcast_ref().map(kind_of_twin))
        .or_else(|| cause.downcast_ref().map(kind_of_device))
        .or_else(|| cause.downcast_ref().map(kind_of_forward))
        .or_else(|| cause.downcast_ref().map(kind_of_inverse))
        .or_else(|| cause.downcast_ref().map(kind_of_learn))
        .or_else(|| cause.downcast_ref::<dermis_tomo::mesh::MeshError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis_tomo::eit::ProtocolError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis_tomo::quality::QualityError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis_mit::MitError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref().map(kind_of_io))
}

macro_rules! faults {
    ($($error:ty),* $(,)?) => {$(
        impl From<$error> for Fault {
            fn from(error: $error) -> Self {
                Self::of(kind_of(&error).unwrap_or(Kind::Other), &error)
            }
        }
    )*};
}

faults!(
    LabError,
    LiveError,
    RecordError,
    SkinError,
    dermis_twin::TwinError,
    dermis_device::DeviceError,
    dermis_learn::LearnError,
    dermis_tomo::eit::EitError,
    dermis_tomo::eit::ProtocolError,
    dermis_tomo::inverse::InverseError,
    dermis_tomo::mesh::MeshError,
    dermis_tomo::quality::QualityError,
    dermis_mit::MitError,
    io::Error,
);

impl From<anyhow::Error> for Fault {
    fn from(error: anyhow::Error) -> Self {
        let kind = error.chain().find_map(kind_of).unwrap_or(Kind::Input);
        Self::of(kind, &*error)
    }
}
