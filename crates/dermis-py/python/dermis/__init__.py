"""Tomographic tactile skins: design, simulate, run and record them.

A *skin file* describes a conductive sheet with its electrodes and the instrument that reads it. A forward model
(:meth:`Skin.model`), a digital twin (:class:`Twin`), and a pipeline from frames to touches (:class:`Pipeline`,
:func:`open`) follow from it.

>>> import dermis
>>> skin = dermis.Skin("healing-square")
>>> skin.model().voltages().shape
(208,)

Units are SI; every name with another unit states it. In a skin's frame x points right and y up, seen from the side
that is touched. Images have row 0 at the top (+y) and NaN outside the skin.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING

from . import errors
from ._dermis import (
    Calibration,
    Frame,
    Grid,
    Maps,
    Model,
    Network,
    Pipeline,
    Recording,
    Result,
    Session,
    Skin,
    Twin,
    __version__,
    calibrate,
    design,
    open,
    read_frames,
)
from ._conductance import Conductance, conductance
from ._order import Order, find_order
from ._tables import touch_dtype
from .errors import (
    Error,
    FileError,
    InputError,
    InternalError,
    SessionError,
    SkinError,
    SolverError,
    SourceError,
)

if _TYPE_CHECKING:
    from . import contacts, eit, gymnasium, jax, lerobot, mit, mujoco, plot, ray, rerun, torch

__all__ = [
    "Calibration",
    "Conductance",
    "Error",
    "FileError",
    "Frame",
    "Grid",
    "InputError",
    "InternalError",
    "Maps",
    "Model",
    "Network",
    "Order",
    "Pipeline",
    "Recording",
    "Result",
    "Session",
    "SessionError",
    "Skin",
    "SkinError",
    "SolverError",
    "SourceError",
    "Twin",
    "__version__",
    "calibrate",
    "conductance",
    "design",
    "errors",
    "find_order",
    "open",
    "read_frames",
    "touch_dtype",
]

_SUBMODULES = ("contacts", "eit", "gymnasium", "jax", "lerobot", "mit", "mujoco", "plot", "ray", "rerun", "torch")


def __getattr__(name: str):
    if name in _SUBMODULES:
        return _import_module(f".{name}", __name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*__all__, *_SUBMODULES])


def _model_of(skin: Skin) -> Model:
    """Restores a pickled model from its skin."""
    return skin.model()
