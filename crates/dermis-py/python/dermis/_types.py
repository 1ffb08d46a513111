"""Types of dictionaries and arguments of the compiled half, by the names that its stubs use.

Everything else in the stubs is written by ``scripts/stubs.py``, from the types in the Rust code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from os import PathLike
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
from numpy.typing import ArrayLike, NDArray

AnyArray: TypeAlias = NDArray[Any]
Touches: TypeAlias = np.recarray[Any, np.dtype[np.void]]

# None is a frame that isn't there yet; a pair is a time in seconds with its frame.
_Taken: TypeAlias = ArrayLike | tuple[float, ArrayLike] | None
Source: TypeAlias = str | PathLike[str] | Iterable[_Taken] | Callable[[], _Taken]

PriorChoice: TypeAlias = str | dict[str, object]
HyperparameterChoice: TypeAlias = float | str | dict[str, object]
Rule: TypeAlias = float | Literal["l-curve", "gcv"] | tuple[Literal["relative", "noise-figure", "known-noise"], float]


class Health(TypedDict):
    """Faults of frames, channels and electrodes."""

    sound: bool
    frame: Literal["frozen", "saturated", "flipped", "out-of-range", "blank"] | None
    channels: dict[int, str]
    electrodes: list[int]


class Guard(TypedDict):
    """The guard's verdict and its reasons."""

    verdict: Literal["ok", "stale", "stop"]
    reasons: list[str]
    safety_rated: Literal[False]


class Damage(TypedDict):
    """A place that seems to be damaged."""

    id: int
    state: str
    x_mm: float
    y_mm: float
    length_mm: float
    width_mm: float
    direction_deg: float
    depth: float
    share: float


class DamageWatch(TypedDict):
    """Damage found on a monitored skin."""

    watched: bool
    damages: list[Damage]
    proposal: str | None


class Baseline(TypedDict):
    """A baseline of a recording."""

    wall_ns: int
    reason: str
    values: NDArray[np.float64]
    noise_std: NDArray[np.float64]


class Event(TypedDict):
    """An event of a recording."""

    wall_ns: int
    event: str
    detail: str
    values: NDArray[np.float64]


class FoundOrder(TypedDict):
    """A search for the order of channels: the arguments of :class:`dermis.Order`."""

    correlation: float
    description: str
    lines: str
    verdict: str
    is_clear: bool
    is_stated: bool
    candidates: list[tuple[float, str]]
    source: NDArray[np.int64] | None
    sign: NDArray[np.float64] | None


class FoundConductance(TypedDict):
    """An estimate of a conductance: the arguments of :class:`dermis.Conductance`."""

    sheet_s: float
    sheet_sigma_s: float
    uniform_s: float
    misfit: float
    regions: NDArray[np.float64]
    image_s: NDArray[np.float64]
    sigma_s: NDArray[np.float64]
