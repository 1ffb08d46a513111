"""A sheet's conductance in siemens, from frames of a single state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ._dermis import Model, Skin, estimate_conductance


@dataclass(frozen=True)
class Conductance:
    """A sheet's conductance, as found by ``dermis conductance``.

    Parameters
    ----------
    sheet_s, sheet_sigma_s : float
        Median sheet conductance and its standard deviation, siemens (the inverse of ohms per square).
    uniform_s : float
        Conductance of the best-fitting uniform sheet, siemens.
    misfit : float
        Root mean square of the residuals, in standard deviations of the readings; about 1 if noise and model error
        are as assumed.
    regions : numpy.ndarray
        Shape (r, 5): regions that differ by more than three standard deviations: x and y of the centre and radius,
        metres, conductance and its standard deviation, siemens. The region that differs most comes first.
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
    """Estimates a sheet's conductance from frames of a single state, without a baseline.

    Current, electrodes and contact impedance are taken from the skin; its conductivity is only used as the starting
    value.

    Parameters
    ----------
    skin : Skin, Model or str
        The skin that was measured.
    frames : array_like
        Shape (k,) or (n, k), volts; several frames are averaged, ignoring NaN.

    Returns
    -------
    Conductance
        The conductance in siemens, with standard deviations.

    Raises
    ------
    InputError
        Frames that don't belong to this skin, or whose channels have another order.
    """
    return Conductance(**estimate_conductance(skin.skin if isinstance(skin, Model) else skin, frames))
