"""A sheet's conductance in siemens, from frames of one state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ._dermis import Model, Skin, estimate_conductance


@dataclass(frozen=True)
class Conductance:
    """A sheet's conductance: what ``dermis conductance`` finds.

    Parameters
    ----------
    sheet_s, sheet_sigma_s : float
        Median sheet conductance and its standard deviation, siemens (the inverse of ohms a square).
    uniform_s : float
        Conductance of the uniform sheet that fits best, siemens.
    misfit : float
        Root mean square of what stays unexplained, in standard deviations of the readings; about 1 where noise and model
        are as assumed.
    regions : numpy.ndarray
        Shape (r, 5): places that differ by more than three standard deviations: x and y of the middle and radius, metres,
        conductance and its standard deviation, siemens. The one that differs most is first.
    image_s, sigma_s : numpy.ndarray
        Shape (rows, columns): sheet conductance and its standard deviation, siemens, row 0 at the top, NaN outside.
    """

    sheet_s: float
    sheet_sigma_s: float
    uniform_s: float
    misfit: float
    regions: np.ndarray
    image_s: np.ndarray
    sigma_s: np.ndarray


def conductance(skin: Skin | Model | str, frames: Any) -> Conductance:
    """Estimates a sheet's conductance from frames of one state, without a baseline.

    Current, electrodes and contact impedance are those of the skin; its conductivity is where the search begins and
    matters no further.

    Parameters
    ----------
    skin : Skin, Model or str
        What was measured.
    frames : array_like
        Shape (k,) or (n, k), volts; several frames are averaged, NaN is left out.

    Returns
    -------
    Conductance
        In siemens, with standard deviations.

    Raises
    ------
    InputError
        Frames that are not of this skin, or whose channels are in another order.
    """
    return Conductance(**estimate_conductance(skin.skin if isinstance(skin, Model) else skin, frames))
