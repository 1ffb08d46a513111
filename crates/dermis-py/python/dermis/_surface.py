"""The sheet of a skin in space: flat in the plane z = 0, or bent around a cylinder along y, one radius behind it.

All lengths of a call are in one unit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]


def points(radius: float | None, sheet: _Floats) -> _Floats:
    """Points of the sheet laid flat, shape (n, 2), on the surface, shape (n, 3)."""
    x, y = sheet[:, 0], sheet[:, 1]
    if radius is None:
        return np.column_stack([x, y, np.zeros(len(x))])
    return np.column_stack([radius * np.sin(x / radius), y, radius * (np.cos(x / radius) - 1.0)])


def normals(radius: float | None, x: _Floats) -> _Floats:
    """Outward unit normals where the sheet laid flat has these x, shape (n, 3)."""
    angle = np.zeros(len(x)) if radius is None else np.asarray(x) / radius
    return np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])


def laid_flat(radius: float | None, positions: _Floats) -> tuple[_Floats, _Floats]:
    """Nearest points of the sheet laid flat, shape (n, 2), and distances from the surface, positive outside."""
    if radius is None:
        return positions[:, :2], positions[:, 2]
    behind = positions[:, 2] + radius
    sheet = np.column_stack([radius * np.arctan2(positions[:, 0], behind), positions[:, 1]])
    return sheet, np.hypot(positions[:, 0], behind) - radius


def turns(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quaternions (x, y, z, w) about y that take z to each normal of a cylinder along y, shape (n, 4)."""
    half = 0.5 * np.arctan2(normals[:, 0], normals[:, 2])
    none = np.zeros(len(half))
    return np.column_stack([none, np.sin(half), none, np.cos(half)])
