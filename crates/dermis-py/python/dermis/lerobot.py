"""Touch for learning: windows of readings at the skin's own rate, one for each camera image or action.

A camera takes 30 images per second and a skin 50 to 1,000 frames. :func:`windows` keeps the skin's rate: each image
gets the last few slots of readings, and a slot without a frame is NaN rather than a copy of its neighbour.
:func:`features` describes the result for a `LeRobotDataset`. Nothing here imports lerobot.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["features", "points", "windows"]

_MOST_BYTES = 8 << 30
"""Maximum size of a result in bytes; split longer recordings into episodes."""

_TIE_S = 1e-9
"""Times within a nanosecond count as equal, so that a frame on the edge of a slot belongs to the slot that ends
there."""


def windows(
    readings: ArrayLike,
    time_s: ArrayLike,
    at_s: ArrayLike,
    *,
    slots: int,
    rate_hz: float,
    sequence: ArrayLike | None = None,
) -> NDArray[np.float64]:
    """Windows of readings before given moments, in slots of one skin period.

    Slot `s` of `slots` covers `(at - (slots - s) / rate_hz, at - (slots - s - 1) / rate_hz]`: the last one ends at
    the moment itself, and no slot looks into the future. If a slot has several frames, the last one counts. A slot
    without a frame is NaN, and so is a missing reading.

    Parameters
    ----------
    readings : array_like
        Shape (n, ...). One row per frame: channels, taxels, or images.
    time_s : array_like
        Shape (n,). Time of each frame, seconds, on the clock of `at_s`. It may have gaps, but must not decrease.
    at_s : array_like
        Shape (m,). Moments to make windows for, seconds, in any order: times of camera images or of actions.
    slots : int
        Number of slots in a window.
    rate_hz : float
        Frame rate of the skin; a slot is ``1 / rate_hz`` long.
    sequence : array_like, optional
        Shape (n,). Sequence number of each frame, as in :meth:`dermis.Recording.times`. A frame with the same number
        as the previous one is a copy and is left out.

    Returns
    -------
    numpy.ndarray
        Shape (m, slots, ...). In the unit of the readings.

    Raises
    ------
    InputError
        Shapes don't match; times are not finite or decrease (the message names the first such frame); the rate or the
        number of slots is not positive; or the result would exceed 8 GiB.

    Examples
    --------
    >>> import numpy as np
    >>> from dermis import lerobot
    >>> lerobot.windows(np.arange(6.0).reshape(3, 2), [0.00, 0.01, 0.03], at_s=[0.03], slots=3, rate_hz=100)[0]
    array([[ 2.,  3.],
           [nan, nan],
           [ 4.,  5.]])
    """
    values = np.asarray(readings, dtype=np.float64)
    times, moments = _times("time_s", time_s), _times("at_s", at_s)
    if values.ndim < 2 or len(values) != len(times):
        raise _input_error(
            f"readings of shape {values.shape} with {len(times)} times: expected one row per time, frames x channels"
        )
    if not (isinstance(slots, (int, np.integer)) and not isinstance(slots, bool) and slots > 0):
        raise _input_error(f"slots = {slots!r}: expected a whole number above 0")
    if not (np.isfinite(rate_hz) and rate_hz > 0):
        raise _input_error(f"rate_hz = {rate_hz!r}: expected a number above 0")
    needed = 8 * len(moments) * int(slots) * int(np.prod(values.shape[1:]))
    if needed > _MOST_BYTES:
        raise _input_error(
            f"windows of {needed / 2**30:.1f} GiB: expected at most {_MOST_BYTES >> 30}, fewer moments at a time"
        )
    if sequence is not None:
        numbers = np.asarray(sequence)
        if numbers.shape != times.shape:
            raise _input_error(
                f"sequence of shape {numbers.shape} with {len(times)} frames: expected one number per frame"
            )
        own = np.r_[True, numbers[1:] != numbers[:-1]] if len(numbers) else np.zeros(0, bool)
        values, times = values[own], times[own]
    back = np.flatnonzero(np.diff(times) < 0)
    if len(back):
        n = int(back[0]) + 1
        raise _input_error(
            f"time_s[{n}] = {float(times[n])!r} after {float(times[n - 1])!r}: expected times that do not decrease"
        )
    edges = moments[:, None] - np.arange(slots, -1, -1) / rate_hz
    # Count the frames up to each edge. The last one before the end of a slot belongs to it, if it lies after its
    # beginning.
    counts = np.searchsorted(times, edges + _TIE_S, side="right")
    last, before = counts[:, 1:], counts[:, :-1]
    result = np.full((len(moments), int(slots), *values.shape[1:]), np.nan)
    there = last > before
    result[there] = values[last[there] - 1]
    return result


def points(touches: ArrayLike, most: int) -> NDArray[np.float64]:
    """Touches as a point set of fixed size: `most` x 6, `x y z fx fy fz` in metres and newtons, strongest first.

    Parameters
    ----------
    touches : array_like
        Shape (n, 6). Touches in the same column order, in any frame of reference.
    most : int
        Number of rows in the result. Excess touches are left out: first those of unknown force, then the weakest.

    Returns
    -------
    numpy.ndarray
        Shape (most, 6). Rows without a touch are NaN.

    Raises
    ------
    InputError
        The shape is not n x 6, or the size is not positive.
    """
    given = np.asarray(touches, dtype=np.float64)
    if given.size and (given.ndim > 2 or given.shape[-1:] != (6,)):
        raise _input_error(f"touches of shape {given.shape}: expected n x 6: x, y, z, fx, fy, fz")
    rows = given.reshape(-1, 6)
    if not (isinstance(most, (int, np.integer)) and most > 0):
        raise _input_error(f"most = {most!r}: expected a whole number above 0")
    force = np.nan_to_num(np.linalg.norm(rows[:, 3:], axis=1), nan=-1.0)
    result = np.full((int(most), 6), np.nan)
    chosen = rows[np.argsort(-force, kind="stable")[:most]]
    result[: len(chosen)] = chosen
    return result


def features(name: str, *, slots: int, channels: int, unit: str) -> dict[str, dict[str, object]]:
    """The entry for windows of one skin in a `LeRobotDataset`'s features.

    Parameters
    ----------
    name : str
        Name of the skin: the feature is called ``observation.tactile.NAME``.
    slots : int
        Number of slots in a window.
    channels : int
        Number of channels.
    unit : str
        Unit of the readings.

    Returns
    -------
    dict
        One feature, float32.

    Examples
    --------
    >>> from dermis import lerobot
    >>> lerobot.features("palm", slots=5, channels=8, unit="V")
    {'observation.tactile.palm': {'dtype': 'float32', 'shape': (5, 8), 'names': ['slot', 'channel_V']}}
    """
    names = ["slot", f"channel_{unit}"]
    return {f"observation.tactile.{name}": {"dtype": "float32", "shape": (slots, channels), "names": names}}


def _times(name: str, values: ArrayLike) -> NDArray[np.float64]:
    times = np.asarray(values, dtype=np.float64)
    if times.ndim != 1:
        raise _input_error(f"{name} of shape {times.shape}: expected a one-dimensional array")
    bad = np.flatnonzero(~np.isfinite(times))
    if len(bad):
        raise _input_error(f"{name}[{bad[0]}] = {times[bad[0]]}: expected finite seconds")
    return times


def _input_error(message: str) -> Exception:
    from .errors import InputError

    return InputError(message)
