"""Reads the measured sets. Every set is optional: a reader returns None if its files are missing."""

import functools
from pathlib import Path

import numpy as np

from . import mat5

# Largest file that is read, in bytes.
LARGEST = 1 << 28


class DataError(ValueError):
    """A file exists but doesn't have the required content."""


def table(path, columns=None, head=0):
    """Numbers of a CSV file. Raises DataError with file, line and what was expected."""
    path = Path(path)
    if path.stat().st_size > LARGEST:
        raise DataError(f"{path}: {path.stat().st_size} bytes, at most {LARGEST} are read")
    rows = []
    for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if line <= head or not text.strip() or text.startswith("#"):
            continue
        try:
            row = [float(cell) for cell in text.split(",")]
        except ValueError:
            raise DataError(f"{path}:{line}: {text[:40]!r} is not a row of numbers") from None
        if rows and len(row) != len(rows[0]):
            raise DataError(f"{path}:{line}: {len(row)} values, the first row has {len(rows[0])}")
        rows.append(row)
    if not rows:
        raise DataError(f"{path}: no row of numbers")
    values = np.array(rows)
    if columns and values.shape[1] != columns:
        raise DataError(f"{path}: {values.shape[1]} columns, expected {columns}")
    if not np.isfinite(values).all():
        line = int(np.argwhere(~np.isfinite(values))[0][0]) + 1 + head
        raise DataError(f"{path}:{line}: a value is not finite")
    return values


@functools.cache
def skin(folder):
    """Differences (n x channels) and positions (n x 3: x, y, depth in m) of a pressed skin, or None."""
    folder = Path(folder)
    if (folder / "differences.csv").is_file() and (folder / "positions.csv").is_file():
        frames = table(folder / "differences.csv")
        places = table(folder / "positions.csv", 3, head=1)
    elif (folder / "ohmc16_pressed.csv").is_file():
        rest, frames, places = hydrogel(folder)
        frames = frames - rest
    else:
        return None
    if len(frames) != len(places):
        raise DataError(f"{folder}: {len(frames)} frames and {len(places)} positions")
    return frames, places


@functools.cache
def hydrogel(folder):
    """Frames before and during each press (500 x 192 magnitudes), and positions, for the gel disc."""
    folder = Path(folder)
    rest, pressed = table(folder / "ohmc16_before.csv"), table(folder / "ohmc16_pressed.csv")
    if rest.shape != pressed.shape:
        raise DataError(f"{folder}: before is {rest.shape}, pressed {pressed.shape}")
    return rest, pressed, table(folder / "ohmc16_positions.csv", 3, head=1)


def skins(data):
    """Names of the pressed skins in a data folder: folders with differences and positions, and the gel disc."""
    data = Path(data)
    found = [path.parent for path in data.glob("*/*/differences.csv") if (path.parent / "positions.csv").is_file()]
    names = sorted(str(path.relative_to(data)) for path in found)
    return names + (["hydrogel"] if (data / "hydrogel" / "ohmc16_pressed.csv").is_file() else [])


def six_points(data, batch):
    """Differences, patterns (n x 6 of 0 and 1) and frames before each press of a batch, or None."""
    path = Path(data) / "six-points" / f"Batch{batch}.mat"
    if not path.is_file():
        return None
    arrays = mat5.load(path)
    missing = [name for name in ("befores", "afters", "patterns") if name not in arrays]
    if missing:
        raise DataError(f"{path}: no array {missing[0]!r}; there are {', '.join(arrays)}")
    # Columns 1 to 1,680: every ordered pair drives and every ordered pair of the other six reads, magnitudes.
    befores, afters = arrays["befores"][:, :1680], arrays["afters"][:, :1680]
    return afters - befores, arrays["patterns"].astype(int), befores


def board(data):
    """Electrodes (source, sink, plus, minus, from 0) of the 192 channels of the gel disc's board."""
    lines = table(Path(data) / "hydrogel" / "lookup192.csv", 4, head=1)
    return (lines // 2).astype(int)
