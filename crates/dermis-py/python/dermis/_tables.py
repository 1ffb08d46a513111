"""Touches as structured arrays and tables, and the display of results in notebooks."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as _pandas
    import pyarrow as _pyarrow
    import xarray as _xarray
    from typing_extensions import disjoint_base
else:

    def disjoint_base(cls):
        """Marks a class whose instances have a layout of their own, for type checkers."""
        return cls


_FIELDS = (
    *("x_mm", "y_mm", "force_n", "amplitude", "area_mm2", "sigma_x_mm", "sigma_y_mm", "radius_mm"),
    *("other_x_mm", "other_y_mm", "other_probability"),
)

touch_dtype = np.dtype([("id", "u8"), ("phase", "U5"), *((name, "f8") for name in _FIELDS)])
"""Fields of a touch: identity, `begin`, `move` or `end`, and numbers whose names end in their units (NaN where unknown)."""

_recorded_dtype = np.dtype([("sequence", "u8"), ("wall_ns", "i8"), *touch_dtype.descr])


@disjoint_base
class FileFrames(tuple[NDArray[np.float64], NDArray[np.float64] | None]):
    """Frames of a file and their times, with further attributes of the file."""

    frames: NDArray[np.float64]
    times_s: NDArray[np.float64] | None
    sequences: NDArray[np.uint64] | None
    wall_ns: NDArray[np.int64] | None
    understood: str

    def __new__(cls, frames: Any, times_s: Any, sequences: Any, wall_ns: Any, understood: str) -> FileFrames:
        """Makes a pair of frames and times, with attributes."""
        pair = super().__new__(cls, (frames, times_s))
        pair.frames, pair.times_s, pair.sequences, pair.wall_ns = frames, times_s, sequences, wall_ns
        pair.understood = understood
        return pair


def touches(ids: Any, phases: list[str], values: Any) -> np.recarray:
    """Combines columns into a structured array."""
    table = np.empty(len(phases), touch_dtype)
    table["id"] = ids
    table["phase"] = phases
    for column, name in enumerate(_FIELDS):
        table[name] = values[:, column]
    return table.view(np.recarray)


def recorded_touches(sequences: Any, wall_ns: Any, table: np.recarray) -> np.recarray:
    """The same, with the frame in which each touch was seen."""
    whole = np.empty(len(table), _recorded_dtype)
    whole["sequence"], whole["wall_ns"] = sequences, wall_ns
    for name in touch_dtype.names or ():
        whole[name] = table[name]
    return whole.view(np.recarray)


def touches_html(table: np.recarray) -> str:
    """Touches as a table for a notebook."""
    names = table.dtype.names or ()
    head = "".join(f"<th>{html.escape(name)}</th>" for name in names)
    rows = []
    for row in table:
        cells = (f"{row[name]:.4g}" if isinstance(row[name], float) else html.escape(str(row[name])) for name in names)
        rows.append("<tr>" + "".join(f"<td>{cell}</td>" for cell in cells) + "</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table>"


def image_svg(image: Any, width_px: int = 240) -> str:
    """An image as SVG: blue below zero, red above, one rectangle per pixel, and nothing outside the skin."""
    image = np.asarray(image, float)
    rows, columns = image.shape
    finite = np.isfinite(image)
    most = float(np.abs(image[finite]).max()) if finite.any() else 0.0
    parts = []
    for row, column in zip(*np.nonzero(finite)):
        share = image[row, column] / most if most > 0.0 else 0.0
        fade = round(255 * (1.0 - abs(share)))
        colour = f"#ff{fade:02x}{fade:02x}" if share > 0.0 else f"#{fade:02x}{fade:02x}ff"
        parts.append(f'<rect x="{column}" y="{row}" width="1.05" height="1.05" fill="{colour}"/>')
    height_px = round(width_px * rows / max(columns, 1))
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" height="{height_px}" '
        f'viewBox="0 0 {columns} {rows}">{"".join(parts)}</svg>'
    )


def result_html(result: Any) -> str:
    """A result for a notebook: its image and its touches."""
    said = html.escape(repr(result))
    return f"<div>{said}</div>{image_svg(result.image)}{touches_html(result.touches)}"


def session_arrays(session: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Runs a session to its end: times (n,) in seconds, readings (n, k), and images (n, rows, columns)."""
    times, readings, images = [], [], []
    for result in session:
        times.append(result.time_s)
        readings.append(result.raw)
        images.append(result.image)
    if not times:
        return np.empty(0), np.empty((0, session.skin.channel_count)), np.empty((0, 0, 0), np.float32)
    return np.array(times), np.stack(readings), np.stack(images)


def to_pandas(recording: Any) -> _pandas.DataFrame:
    """Frames of a recording as a ``pandas.DataFrame``, with one column per channel and the host's wall clock as
    index."""
    import pandas

    _, wall_ns, sequences = recording.times()
    index = pandas.to_datetime(wall_ns, unit="ns", utc=True).rename("time")
    frame = pandas.DataFrame(recording.frames(), index=index, columns=recording.channel_labels)
    frame.insert(0, "sequence", sequences)
    return frame


def to_arrow(recording: Any) -> _pyarrow.Table:
    """Frames of a recording as a ``pyarrow.Table``: `sequence`, `time_ns` and one column per channel."""
    import pyarrow

    _, wall_ns, sequences = recording.times()
    frames = recording.frames()
    columns = {"sequence": pyarrow.array(sequences), "time_ns": pyarrow.array(wall_ns)}
    for number, label in enumerate(recording.channel_labels):
        columns[label] = pyarrow.array(frames[:, number])
    return pyarrow.table(columns)


def to_xarray(recording: Any) -> _xarray.DataArray:
    """Frames of a recording as an ``xarray.DataArray`` over `time_s` and `channel`."""
    import xarray

    times_s, wall_ns, sequences = recording.times()
    coordinates = {
        "time_s": times_s,
        "wall_ns": ("time_s", wall_ns),
        "sequence": ("time_s", sequences),
        "channel": recording.channel_labels,
    }
    attributes = {"skin": recording.skin.name, "units": "V"}
    return xarray.DataArray(
        recording.frames(), coords=coordinates, dims=("time_s", "channel"), name="readings", attrs=attributes
    )
