//! Converts errors of dermis to Python exceptions, with the same text as the command: the message, followed by the
//! causes that it doesn't contain already. The classes are defined in Python (`dermis/errors.py`), so that they can
//! be subclasses of `ValueError` and `OSError`.

use std::io;

use dermis::lab::Error as LabError;
use dermis::live::Error as LiveError;
use dermis::record::Error as RecordError;
use dermis::skin::Error as SkinError;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// Longest message, and longest argument quoted in it, characters.
const MOST_SHOWN: usize = 2000;
const MOST_ECHOED: usize = 200;

/// The exception that an error becomes.
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

/// Text for people: control characters except line ends are escaped, and long text is cut in the middle.
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

fn kind_of_forward(error: &dermis::tomo::eit::EitError) -> Kind {
    if matches!(error, dermis::tomo::eit::EitError::System(_)) { Kind::Solver } else { Kind::Input }
}

fn kind_of_inverse(error: &dermis::tomo::inverse::InverseError) -> Kind {
    if matches!(error, dermis::tomo::inverse::InverseError::Singular { .. }) { Kind::Solver } else { Kind::Input }
}

fn kind_of_device(error: &dermis::device::DeviceError) -> Kind {
    use dermis::device::DeviceError;
    match error {
        DeviceError::Io { source, .. } => kind_of_io(source),
        DeviceError::SourceFailed { .. } => Kind::Source,
        _ => Kind::File,
    }
}

fn kind_of_learn(_: &dermis::learn::LearnError) -> Kind {
    Kind::File
}

fn kind_of_skin(error: &SkinError) -> Kind {
    match error {
        SkinError::Io { source, .. } => kind_of_io(source),
        _ => Kind::Skin,
    }
}

fn kind_of_live(error: &LiveError) -> Kind {
    match error {
        LiveError::Skin(error) => kind_of_skin(error),
        LiveError::Io { source, .. } => kind_of_io(source),
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
        RecordError::Skin(error) => kind_of_skin(error),
        RecordError::Io { source, .. } => kind_of_io(source),
        RecordError::Device(error) => kind_of_device(error),
        RecordError::Content { .. } => Kind::File,
        RecordError::Frames { .. } | RecordError::Touch(_) => Kind::Input,
        _ => Kind::Other,
    }
}

fn kind_of_lab(error: &LabError) -> Kind {
    match error {
        LabError::Live(error) => kind_of_live(error),
        LabError::Record(error) => kind_of_record(error),
        LabError::Skin(error) => kind_of_skin(error),
        LabError::Io { source, .. } => kind_of_io(source),
        LabError::Content { .. } => Kind::File,
        LabError::Frames { .. } | LabError::Touch(_) | LabError::Locator(_) | LabError::Quality(_) => Kind::Input,
        LabError::Mesh { .. } | LabError::Protocol { .. } | LabError::Magnetic(_) => Kind::Skin,
        LabError::Forward(error) => kind_of_forward(error),
        LabError::Inverse(error) => kind_of_inverse(error),
        LabError::Device(error) => kind_of_device(error),
        LabError::Learn(error) => kind_of_learn(error),
        LabError::Twin(error) => kind_of_twin(error),
        _ => Kind::Other,
    }
}

fn kind_of_twin(error: &dermis::twin::TwinError) -> Kind {
    match error {
        dermis::twin::TwinError::Skin(error) => kind_of_skin(error),
        _ => Kind::Input,
    }
}

/// The kind of an error by its type, or the kind of its first cause that has one.
fn kind_of(cause: &(dyn std::error::Error + 'static)) -> Option<Kind> {
    None.or_else(|| cause.downcast_ref().map(kind_of_lab))
        .or_else(|| cause.downcast_ref().map(kind_of_live))
        .or_else(|| cause.downcast_ref().map(kind_of_record))
        .or_else(|| cause.downcast_ref().map(kind_of_skin))
        .or_else(|| cause.downcast_ref().map(kind_of_twin))
        .or_else(|| cause.downcast_ref().map(kind_of_device))
        .or_else(|| cause.downcast_ref().map(kind_of_forward))
        .or_else(|| cause.downcast_ref().map(kind_of_inverse))
        .or_else(|| cause.downcast_ref().map(kind_of_learn))
        .or_else(|| cause.downcast_ref::<dermis::tomo::mesh::MeshError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis::tomo::eit::ProtocolError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis::tomo::quality::QualityError>().map(|_| Kind::Input))
        .or_else(|| cause.downcast_ref::<dermis::mit::MitError>().map(|_| Kind::Input))
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
    dermis::twin::TwinError,
    dermis::device::DeviceError,
    dermis::learn::LearnError,
    dermis::tomo::eit::EitError,
    dermis::tomo::eit::ProtocolError,
    dermis::tomo::inverse::InverseError,
    dermis::tomo::mesh::MeshError,
    dermis::tomo::quality::QualityError,
    dermis::mit::MitError,
    io::Error,
);

impl From<anyhow::Error> for Fault {
    fn from(error: anyhow::Error) -> Self {
        let kind = error.chain().find_map(kind_of).unwrap_or(Kind::Input);
        Self::of(kind, &*error)
    }
}
