"""Reads numeric arrays from MATLAB files of version 5 to 7, compressed or not. Only needs NumPy and the standard library.

Layout: "MAT-File Format", The MathWorks, chapter 1. Structures, cells and text are skipped.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
MATRIX, COMPRESSED = 14, 15
# Classes of numeric arrays: double to uint64.
NUMERIC = range(6, 16)
# Maximum size of an array, in bytes.
LARGEST = 1 << 30


class MatError(ValueError):
    """The file isn't a MATLAB file of version 5 to 7, or is truncated."""


def elements(data, order, start=0):
    """Yields type and content of the data elements from `start` on."""
    while start + 8 <= len(data):
        kind, size = struct.unpack_from(order + "II", data, start)
        if kind >> 16:  # A small element: type and size share four bytes.
            kind, size, begin, step = kind & 0xFFFF, kind >> 16, start + 4, 8
        else:
            begin, step = start + 8, 8 + (size if kind == COMPRESSED else -(-size // 8) * 8)
        if begin + size > len(data):
            raise MatError(f"cut off: an element of {size} bytes at {start}, {len(data) - begin} are left")
        yield kind, data[begin : begin + size]
        start += step


def matrix(content, order):
    """Name and values of an array. The values are None unless it is numeric, real and dense."""
    parts = list(elements(content, order))
    if len(parts) < 3:
        return None, None
    flags = struct.unpack_from(order + "I", parts[0][1])[0]
    if flags & 0xFF not in NUMERIC:
        return None, None
    shape = tuple(int(size) for size in np.frombuffer(parts[1][1], order + "i4"))
    name = parts[2][1].decode("latin-1")
    if flags & 0x800 or len(parts) < 4 or parts[3][0] not in TYPES:
        return name, None
    values = np.frombuffer(parts[3][1], order + TYPES[parts[3][0]])
    if values.size != np.prod(shape):
        raise MatError(f"array {name}: {values.size} values, its size says {shape}")
    return name, values.reshape(shape, order="F").astype(float)


def load(path):
    """Numeric arrays of a file, by name.

    Raises MatError if the file isn't of this format, and OSError if it can't be read.
    """
    data = Path(path).read_bytes()
    if len(data) < 128 or data[126:128] not in (b"IM", b"MI"):
        raise MatError(f"{path}: not a MATLAB file of version 5 to 7 (version 7.3 is HDF5: save it with -v7)")
    order = "<" if data[126:128] == b"IM" else ">"
    found = {}
    for kind, content in elements(data, order, 128):
        if kind == COMPRESSED:
            try:
                whole = zlib.decompressobj().decompress(content, LARGEST)
            except zlib.error as error:
                raise MatError(f"{path}: {error}") from error
            inner = list(elements(whole, order))
            kind, content = inner[0] if inner else (0, b"")
        if kind == MATRIX:
            name, values = matrix(content, order)
            if values is not None:
                found[name] = values
    return found
