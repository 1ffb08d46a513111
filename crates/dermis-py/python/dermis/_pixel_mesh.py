"""The pixels of an image as a mesh on the skin's surface, and their colours."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _surface
from ._dermis import Skin

_SURFACE = np.array([235, 235, 235], dtype=np.float64)
_ABOVE = np.array([200, 30, 30], dtype=np.float64)
_BELOW = np.array([30, 60, 200], dtype=np.float64)


class PixelMesh:
    """The pixels of an image on the skin's surface: vertices at their corners, shared by neighbours."""

    def __init__(self, inside: NDArray[np.bool_], extent_mm: Any, skin: Skin) -> None:
        rows, columns = inside.shape
        left, right, bottom, top = extent_mm
        row, column = np.nonzero(inside)
        across, down = np.array([0, 1, 1, 0])[:, None], np.array([0, 0, 1, 1])[:, None]
        corners = (row + down) * (columns + 1) + column + across
        used, numbers = np.unique(corners, return_inverse=True)
        a, b, c, d = numbers.reshape(4, -1)
        # Counter-clockwise as seen from outside, with row 0 at the top.
        self.triangles = np.concatenate([np.stack([a, d, c], axis=1), np.stack([a, c, b], axis=1)]).astype(np.uint32)
        x = left + (right - left) * (used % (columns + 1)) / columns
        y = top + (bottom - top) * (used // (columns + 1)) / rows
        sheet_m = 1e-3 * np.column_stack([x, y])
        # Pixels on the rim reach beyond it.
        beyond = ~skin.contains(sheet_m)
        sheet_m[beyond] = _nearest(skin.outline, sheet_m[beyond])
        radius_m = skin.cylinder_radius_m
        self.positions_m = _surface.points(radius_m, sheet_m)
        self.normals = _surface.normals(radius_m, sheet_m[:, 0])
        self._inside = (row, column)
        self._numbers = numbers.ravel()
        self._weights = 1.0 / np.bincount(self._numbers)

    def at_vertices(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        """Mean of the pixels around each vertex; missing ones count as 0."""
        values = np.tile(np.nan_to_num(image[self._inside]), 4)
        return self._weights * np.bincount(self._numbers, weights=values)


def colours_of(values: NDArray[np.float64], scale: float) -> NDArray[np.uint8]:
    """Red above zero, blue below, grey at zero, shape (n, 3)."""
    share = np.clip(values / scale if scale > 0.0 else 0.0 * values, -1.0, 1.0)[:, None]
    mixed = _SURFACE + np.abs(share) * (np.where(share > 0.0, _ABOVE, _BELOW) - _SURFACE)
    return mixed.round().astype(np.uint8)


def _nearest(rim: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """The points of a closed line nearest to these, or these if they lie in one of its holes."""
    along = np.roll(rim, -1, axis=0) - rim
    off = points[:, None] - rim
    share = np.clip(np.einsum("nkd,kd->nk", off, along) / np.maximum((along**2).sum(axis=1), 1e-30), 0.0, 1.0)
    on = rim + share[:, :, None] * along
    nearest = np.argmin(((points[:, None] - on) ** 2).sum(axis=2), axis=1)
    return on[np.arange(len(points)), nearest]
