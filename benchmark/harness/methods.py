"""The methods in `methods.txt` and from `--method`: their names and functions."""

import importlib
from pathlib import Path
from types import SimpleNamespace

FILE = Path(__file__).resolve().parent.parent / "methods.txt"
FUNCTIONS = ("regress", "unlabelled", "segment", "watch")


class MethodError(ValueError):
    """The method can't be loaded."""


def load(name, where):
    """Loads a method from a module, or from a single function for the tasks with labels."""
    module, _, function = where.partition(":")
    try:
        found = importlib.import_module(module)
    except ImportError as error:
        raise MethodError(f"method {name}: {module} cannot be imported: {error}") from error
    if function and not callable(getattr(found, function, None)):
        raise MethodError(f"method {name}: {module} has no function {function!r}")
    functions = {"regress": getattr(found, function)} if function else {key: getattr(found, key, None) for key in FUNCTIONS}
    if not any(functions.values()):
        raise MethodError(f"method {name}: {module} has none of {', '.join(FUNCTIONS)}")
    return SimpleNamespace(
        name=name,
        missing=getattr(found, "missing", lambda: None)(),
        handles_sessions=getattr(found, "HANDLES_SESSIONS", False),
        told=getattr(found, "TOLD", ""),
        **{key: functions.get(key) for key in FUNCTIONS},
    )


def listed(file=FILE):
    """Names and locations of the methods in a list file."""
    rows = []
    for line, text in enumerate(Path(file).read_text(encoding="utf-8").splitlines(), 1):
        cells = text.split("#")[0].split()
        if not cells:
            continue
        if len(cells) != 2 or "/" in cells[0]:
            raise MethodError(f"{file}:{line}: {text!r}, expected a name and a module or module:function")
        rows.append(tuple(cells))
    return rows


def given(where):
    """Name and location of a method from the command line: [name=]module[:function]."""
    name, _, place = where.rpartition("=")
    return (name or place.replace(":", "."), place)
