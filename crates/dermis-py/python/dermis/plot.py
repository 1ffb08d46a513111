"""Drawings on matplotlib axes. matplotlib is imported only here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ._dermis import Maps, Model, Result, Skin


def _axes(axes: Axes | None) -> Axes:
    if axes is None:
        import matplotlib.pyplot as plt

        axes = plt.figure(constrained_layout=True).add_subplot()
    axes.set_aspect("equal")
    axes.set_xlabel("x (mm)")
    axes.set_ylabel("y (mm)")
    return axes


def skin(of: Skin | Model, axes: Axes | None = None, *, mesh: bool = False) -> Axes:
    """Draws a skin: its rim, and its electrodes numbered from 1 as in its file.

    Parameters
    ----------
    of : Skin or Model
        The skin or model to draw.
    axes : matplotlib.axes.Axes, optional
        Axes to draw on; default: a new figure's.
    mesh : bool
        Draw the elements.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in millimetres.
    """
    model = of.model() if hasattr(of, "model") else of
    axes = _axes(axes)
    nodes = 1e3 * np.asarray(model.nodes)[:, :2]
    if mesh:
        axes.triplot(nodes[:, 0], nodes[:, 1], model.elements, lw=0.2, color="0.7")
    rim = 1e3 * model.skin.outline
    axes.plot(*np.vstack([rim, rim[:1]]).T, color="0.2", lw=1)
    for number, electrode in enumerate(model.electrodes, start=1):
        parts = electrode.parts
        if electrode.kind == "edges":
            for edge in parts:
                axes.plot(*nodes[edge].T, color="tab:orange", lw=3, solid_capstyle="butt")
            middle = nodes[parts].reshape(-1, 2).mean(axis=0)
        elif electrode.kind == "elements":
            for element in parts:
                axes.fill(*nodes[model.elements[element]].T, color="tab:orange", lw=0)
            middle = nodes[model.elements[parts]].reshape(-1, 2).mean(axis=0)
        else:
            middle = nodes[parts[0]]
            axes.plot(*middle, ".", color="tab:orange")
        axes.annotate(str(number), middle, ha="center", va="center", fontsize=7)
    axes.set_title(model.skin.title or model.skin.name)
    return axes


def image(
    values: Any, extent_mm: Any, axes: Axes | None = None, *, label: str = "", symmetric: bool = True
) -> Axes:
    """Draws an image with its colour bar; both axes are in millimetres.

    Parameters
    ----------
    values : array_like
        Shape (rows, columns), row 0 at the top, NaN outside.
    extent_mm : sequence of float
        Left, right, bottom and top, millimetres.
    axes : matplotlib.axes.Axes, optional
        Axes to draw on; default: a new figure's.
    label : str
        Label of the colour bar.
    symmetric : bool
        Put zero in the middle of the colours.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in millimetres.
    """
    axes = _axes(axes)
    values = np.asarray(values)
    finite = values[np.isfinite(values)]
    most = float(np.abs(finite).max()) if finite.size else 1.0
    limits = {"vmin": -most, "vmax": most, "cmap": "RdBu_r"} if symmetric else {"cmap": "viridis"}
    shown = axes.imshow(values, extent=extent_mm, origin="upper", **limits)
    axes.figure.colorbar(shown, ax=axes, label=label)
    return axes


def result(of: Result, axes: Axes | None = None) -> Axes:
    """Draws a result's image, with its touches as crosses of one standard deviation and their ids.

    Parameters
    ----------
    of : Result
        The result to draw.
    axes : matplotlib.axes.Axes, optional
        Axes to draw on; default: a new figure's.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in millimetres.
    """
    axes = image(of.image, of.extent_mm, axes, label=of.image_quantity)
    for touch in of.touches:
        if touch.phase == "end":
            continue
        axes.errorbar(touch.x_mm, touch.y_mm, xerr=touch.sigma_x_mm, yerr=touch.sigma_y_mm, color="k", capsize=3)
        axes.annotate(f" {touch.id}", (touch.x_mm, touch.y_mm))
    axes.set_title(f"frame {of.sequence}, {of.time_s:.2f} s")
    return axes


def maps(of: Maps, axes: Axes | None = None, *, what: str = "position_bound_mm") -> Axes:
    """Draws a map of a design.

    Parameters
    ----------
    of : Maps
        The maps to draw from.
    axes : matplotlib.axes.Axes, optional
        Axes to draw on; default: a new figure's.
    what : str
        One of `position_bound_mm`, `sensitivity`, `smallest_change`, `amplitude_bound` and `spread_mm`.

    Returns
    -------
    matplotlib.axes.Axes
        The axes, in millimetres.
    """
    axes = image(getattr(of, what), of.extent_mm, axes, label=what.replace("_", " "), symmetric=False)
    axes.set_title(of.skin.title or of.skin.name)
    return axes
