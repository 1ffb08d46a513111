"""Exceptions, with the same messages as the command.

All are kinds of :class:`Error`; those about arguments are also `ValueError`, and those about files `OSError`.
"""

__all__ = [
    "Error",
    "FileError",
    "InputError",
    "InternalError",
    "SessionError",
    "SkinError",
    "SolverError",
    "SourceError",
]


class Error(Exception):
    """Base class of all errors of dermis."""


class SkinError(Error, ValueError):
    """An invalid skin file, or an unknown skin."""


class InputError(Error, ValueError):
    """An invalid argument; the message says what was expected and what was given."""


class FileError(Error, OSError):
    """A file that cannot be read or written, or has other content."""


class SourceError(Error):
    """An instrument, or another source of frames, that cannot deliver any."""


class SolverError(Error, ArithmeticError):
    """Equations that could not be solved."""


class SessionError(Error, RuntimeError):
    """A session that is closed, or that was opened by another process."""


class InternalError(Error, RuntimeError):
    """A bug in dermis."""
