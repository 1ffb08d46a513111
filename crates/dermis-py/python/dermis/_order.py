"""In which order, and with which sign, an instrument delivers its channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ._dermis import Model, Skin


@dataclass(frozen=True)
class Order:
    """How a measured baseline fits a skin's model.

    Parameters
    ----------
    correlation : float
        Correlation with the model in the order of the skin file.
    description : str
        The order that fits clearly better, in words; empty where the stated order is the best.
    better_correlation : float
        Correlation in that order.
    source : numpy.ndarray
        Shape (k,): entry `i` of a measured frame is channel `source[i]` of the skin.
    sign : float
        +1 or -1, common to all channels.
    """

    correlation: float
    description: str
    better_correlation: float
    source: np.ndarray
    sign: float

    def to_skin(self, frames: Any) -> np.ndarray:
        """Puts frames, shape (k,) or (n, k), into the skin's order and sign."""
        frames = np.asarray(frames, dtype=float)
        if frames.ndim not in (1, 2) or frames.shape[-1] != len(self.source):
            from .errors import InputError

            raise InputError(f"frames: expected shape (n, {len(self.source)}), got shape {frames.shape}")
        ordered = np.empty_like(frames)
        ordered[..., self.source] = self.sign * frames
        return ordered


def find_order(skin: Skin | Model | str, baseline: Any) -> Order:
    """Finds the order and sign of the channels of a measured baseline.

    Parameters
    ----------
    skin : Skin, Model or str
        What was measured.
    baseline : array_like
        Shape (k,) or (n, k): readings of the untouched skin; several frames are averaged, NaN is left out.

    Returns
    -------
    Order
        The order that fits best: a rearrangement is preferred to the stated one only where it fits clearly better.
    """
    model = skin if isinstance(skin, Model) else (skin if isinstance(skin, Skin) else Skin(skin)).model()
    baseline = np.asarray(baseline, dtype=float)
    if baseline.ndim == 2 and len(baseline):
        counted = np.isfinite(baseline)
        sums = np.where(counted, baseline, 0.0).sum(axis=0)
        baseline = np.where(counted.any(axis=0), sums / np.maximum(counted.sum(axis=0), 1), np.nan)
    found = model.order(baseline)
    count = len(baseline)
    return Order(
        correlation=found["correlation"],
        description=found.get("description", ""),
        better_correlation=found.get("better_correlation", found["correlation"]),
        source=found.get("source", np.arange(count)),
        sign=found.get("sign", 1.0),
    )
