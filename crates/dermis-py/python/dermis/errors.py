"""What can go wrong, as exceptions with the words of the command.

All are kinds of :class:`Error`; those about arguments are `ValueError` too, and those about files `OSError`.
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
    """Why something could not be done."""


class SkinError(Error, ValueError):
    """A skin file that makes no sense, or a skin that there is none of."""


class InputError(Error, ValueError):
    """An argument that does not fit: the message says what was expected and what came."""


class FileError(Error, OSError):
    """A file that cannot be read or written, or that holds something else."""


class SourceError(Error):
    """An instrument, or another source of frames, that can deliver none."""


class SolverError(Error, ArithmeticError):
    """Equations that could not be solved."""


class SessionError(Error, RuntimeError):
    """A session that is closed, or that another process opened."""


class InternalError(Error, RuntimeError):
    """A fault of dermis itself."""
