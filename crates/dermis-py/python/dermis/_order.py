"""The order and sign in which an instrument delivers its channels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ._dermis import Model, Skin, search_order
from .errors import InputError


@dataclass(frozen=True)
class Order:
    """Match of a measured baseline with a skin, as found by ``dermis order``.

    Parameters
    ----------
    correlation : float
        Correlation of the baseline with the model in the best order.
    description : str
        The best order in words.
    is_stated : bool
        True if this is the order of the skin file.
    is_clear : bool
        True if it fits, and clearly better than any other.
    verdict : str
        The result in a sentence: "nothing fits" if no order does.
    lines : str
        Lines for ``[backend]`` of a skin file that reads such frames unchanged; empty if nothing fits.
    candidates : list of (float, str)
        Correlations and descriptions, best first.
    source : numpy.ndarray or None
        Shape (k,): entry `i` of a measured frame is channel `source[i]` of the skin; None if the frames hold other
        channels than the skin.
    sign : numpy.ndarray or None
        Shape (k,): the factor for entry `i`, +1 or -1.
    """

    correlation: float
    description: str
    is_stated: bool
    is_clear: bool
    verdict: str
    lines: str
    candidates: list[tuple[float, str]]
    source: np.ndarray | None
    sign: np.ndarray | None

    def to_skin(self, frames: Any) -> np.ndarray:
        """Puts frames, shape (k,) or (n, k), into the skin's order and sign.

        Raises
        ------
        InputError
            The order is not clear, the frames hold other channels than the skin's, or the shape is wrong.
        """
        if not self.is_clear:
            raise InputError(f"order: expected one that is clear, got none: {self.verdict}")
        if self.source is None or self.sign is None:
            raise InputError(
                f"order: expected the skin's channels, got others ({self.description}); a skin file with these lines in "
                f"[backend] reads them:\n{self.lines}"
            )
        frames = np.asarray(frames, dtype=float)
        if frames.ndim not in (1, 2) or frames.shape[-1] != len(self.source):
            raise InputError(f"frames: expected shape (n, {len(self.source)}), got shape {frames.shape}")
        ordered = np.empty_like(frames)
        ordered[..., self.source] = self.sign * frames
        return ordered


def find_order(skin: Skin | Model | str, baseline: Any) -> Order:
    """Finds the order and sign of the channels of a measured baseline, like ``dermis order``.

    Every protocol with the right number of readings is tried, with every order of its lists, either nesting, either
    sign, and electrodes counted from any of them in either direction.

    Parameters
    ----------
    skin : Skin, Model or str
        The skin that was measured.
    baseline : array_like
        Shape (k,) or (n, k): readings of the untouched skin; several frames are averaged, ignoring NaN.

    Returns
    -------
    Order
        The best order, and whether it is clear.
    """
    return Order(**search_order(skin.skin if isinstance(skin, Model) else skin, baseline))
