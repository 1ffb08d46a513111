"""Skins in Gymnasium environments that run on MuJoCo: observations of frames, taxels or touches.

Gymnasium and MuJoCo are imported only here. :mod:`dermis.contacts` serves simulators of other kinds.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from .errors import InputError
from .mujoco import Patch, SkinSensor

__all__ = ["SkinObservation"]

_KINDS = ("frame", "change", "taxels", "touches")


class SkinObservation(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Adds the readings of skin patches to the observations of a MuJoCo environment.

    Observations become a dictionary: those of the environment under ``state`` (or its own keys, if it has a dictionary
    already), and for each patch a dictionary under ``skin``:

    ``frame``
        Shape (k,). Readings of the instrument, as it sends them.
    ``change``
        Shape (k,). Readings minus the baseline.
    ``taxels``
        Shape (m,). The image's pixels on the skin; `taxels_mm` has their positions.
    ``touches``
        Shape (most_touches, 7). 1 for a touch and 0 for none, then x, y, z (mm) and fx, fy, fz (N, on the sensor) in
        the patch's frame, strongest first. Rows without a touch are 0, and so are unknown forces.

    The skin makes frames at its own rate; between them the last one is repeated. `sensor` is the
    :class:`dermis.mujoco.SkinSensor`.

    Parameters
    ----------
    env : gymnasium.Env
        An environment whose ``unwrapped`` has the attributes ``model`` and ``data`` of MuJoCo.
    patches : Patch or iterable of Patch
        The patches of skin.
    observe : str or iterable of str
        What to observe: any of ``frame``, ``change``, ``taxels`` and ``touches``.
    most_touches : int
        Number of rows of ``touches``.
    seed : int
        Seed of the instruments' noise.

    Raises
    ------
    InputError
        The environment isn't MuJoCo's, a patch is invalid, or `observe` has an unknown word.
    """

    def __init__(
        self,
        env: gymnasium.Env[Any, Any],
        patches: Patch | Iterable[Patch],
        *,
        observe: str | Iterable[str] = "touches",
        most_touches: int = 5,
        seed: int = 0,
    ) -> None:
        super().__init__(env)
        model, data = (getattr(env.unwrapped, name, None) for name in ("model", "data"))
        if model is None or data is None:
            raise InputError(f"env: expected one with MuJoCo's model and data, got {type(env.unwrapped).__name__}")
        self.observe = (observe,) if isinstance(observe, str) else tuple(observe)
        unknown = [word for word in self.observe if word not in _KINDS]
        if unknown or not self.observe:
            raise InputError(f"observe = {observe!r}: expected any of {', '.join(_KINDS)}")
        if not (isinstance(most_touches, int) and not isinstance(most_touches, bool) and most_touches > 0):
            raise InputError(f"most_touches = {most_touches!r}: expected a whole number above 0")
        self.most_touches = most_touches
        self.sensor = SkinSensor(model, data, patches, seed=seed)
        self.sensor.update()
        self._inside = {patch.name: self._inside_of(patch.name) for patch in self.sensor.patches}
        felt: dict[str, spaces.Space[Any]] = {patch.name: self._space_of(patch.name) for patch in self.sensor.patches}
        before = env.observation_space
        parts = dict(before.spaces) if isinstance(before, spaces.Dict) else {"state": before}
        if "skin" in parts:
            raise InputError("env: expected observations without the key 'skin'")
        self._has_keys = isinstance(before, spaces.Dict)
        self.observation_space = spaces.Dict({**parts, "skin": spaces.Dict(felt)})

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Resets the environment, and the skins to rest.

        Parameters
        ----------
        seed : int, optional
            Seed of the environment.
        options : dict, optional
            Options of the environment.

        Returns
        -------
        observation : dict
            The first observation.
        info : dict
            Info from the environment.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self.sensor.reset()
        self.sensor.update()
        return self._with_skin(observation), info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """A step of the environment, and the frames that have become due.

        Parameters
        ----------
        action : object
            The environment's action.

        Returns
        -------
        tuple
            Observation, reward, terminated, truncated, info.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        self.sensor.update()
        return self._with_skin(observation), reward, terminated, truncated, info

    def taxels_mm(self, patch: str) -> NDArray[np.float64]:
        """Positions of a patch's taxels on the sheet laid flat.

        Parameters
        ----------
        patch : str
            Name of the patch.

        Returns
        -------
        numpy.ndarray
            Shape (m, 2), in the order of the observation.
        """
        inside = self._inside_of(patch)
        left, right, bottom, top = self.sensor.reading(patch).result.extent_mm
        rows, columns = inside.shape
        row, column = np.nonzero(inside)
        x = left + (right - left) * (column + 0.5) / columns
        y = top + (bottom - top) * (row + 0.5) / rows
        return np.column_stack([x, y])

    def _inside_of(self, patch: str) -> NDArray[np.bool_]:
        return np.isfinite(self.sensor.reading(patch).result.image)

    def _space_of(self, patch: str) -> spaces.Dict:
        reading = self.sensor.reading(patch)
        channels = len(reading.frame)
        shapes = {
            "frame": (channels,),
            "change": (channels,),
            "taxels": (int(self._inside[patch].sum()),),
            "touches": (self.most_touches, 7),
        }
        types = {"frame": np.float64, "change": np.float64, "taxels": np.float32, "touches": np.float64}
        return spaces.Dict({kind: spaces.Box(-np.inf, np.inf, shapes[kind], types[kind]) for kind in self.observe})

    def _with_skin(self, observation: Any) -> dict[str, Any]:
        parts = dict(observation) if self._has_keys else {"state": observation}
        return {**parts, "skin": {patch.name: self._felt(patch.name) for patch in self.sensor.patches}}

    def _felt(self, patch: str) -> dict[str, NDArray[Any]]:
        reading = self.sensor.reading(patch)
        result: dict[str, NDArray[Any]] = {}
        for kind in self.observe:
            if kind == "frame":
                result[kind] = np.nan_to_num(reading.frame.values)
            elif kind == "change":
                result[kind] = np.nan_to_num(reading.result.compensated)
            elif kind == "taxels":
                # Without an image, for instance during a fault of whole frames, all taxels are 0.
                result[kind] = np.nan_to_num(reading.result.image[self._inside[patch]])
            else:
                result[kind] = self._touches(patch)
        return result

    def _touches(self, patch: str) -> NDArray[np.float64]:
        touches = self.sensor.touches(patch, "patch")
        forces = np.nan_to_num(touches.force_n)
        order = np.argsort(-np.linalg.norm(forces, axis=1), kind="stable")[: self.most_touches]
        rows = np.zeros((self.most_touches, 7))
        rows[: len(order), 0] = 1.0
        rows[: len(order), 1:4] = touches.position_mm[order]
        rows[: len(order), 4:] = forces[order]
        return rows
