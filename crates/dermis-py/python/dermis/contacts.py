"""Contacts of a simulator on a skin: point contacts in, frames and touches out.

Rigid-body simulators report contact points with forces. :func:`contacts_to_frame` presses them into the twin of a
skin: the layer turns force into pressure, and the simulated instrument reads the frame, with its noise.
:class:`SimulatedSkin` adds the pipeline and a clock. Nothing here depends on a simulator; :mod:`dermis.mujoco` collects
the contacts of MuJoCo.

Positions are in the patch's frame: x right, y up, z out of the skin, with the origin in the middle of the sheet. Forces
act on the sensor, so pressing on a flat skin is a force towards -z.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _surface
from ._checks import check_positive
from ._dermis import Calibration, Frame, Model, Pipeline, Result, Skin, Twin
from .errors import InputError, SourceError

__all__ = ["Carried", "SimulatedSkin", "SkinReading", "SpatialTouches", "carried", "contacts_to_frame", "spatial"]

_REACH_MM = 5.0
"""Default distance from the skin within which a contact presses it. Soft contacts of simulators sink in by less."""

_MOST_WARM_UP = 1000
"""Frames after which to give up waiting for a baseline; pipelines take 32."""

_REST_S = 120.0
"""Time at rest on a reset: six time constants of the slowest layer among the built-in skins (20 s)."""


@dataclass(frozen=True)
class Carried:
    """The contacts that a skin carries, on the sheet laid flat.

    Parameters
    ----------
    index : numpy.ndarray
        Shape (m,). Numbers of these contacts among those given.
    x_mm, y_mm : numpy.ndarray
        Shape (m,). Positions on the sheet laid flat.
    height_mm : numpy.ndarray
        Shape (m,). Distances from the skin's surface, positive outside.
    force_n : numpy.ndarray
        Shape (m,). Forces into the skin, above 0. Friction is ignored.
    """

    index: NDArray[np.intp]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    height_mm: NDArray[np.float64]
    force_n: NDArray[np.float64]


def carried(
    skin: Skin, positions_mm: ArrayLike, forces_n: ArrayLike, *, reach_mm: float = _REACH_MM
) -> Carried:
    """Selects the contacts that press a skin, and lays them on its sheet.

    Contacts off the outline or in a hole, farther from the surface than `reach_mm`, or pulling do not press.

    Parameters
    ----------
    skin : Skin
        The skin.
    positions_mm : array_like
        Shape (n, 3), in the patch's frame; or (n, 2), on the sheet laid flat.
    forces_n : array_like
        Shape (n, 3): forces on the sensor, in the patch's frame. Or (n,): forces into the skin.
    reach_mm : float
        Largest distance between a contact and the skin's surface.

    Returns
    -------
    Carried
        The contacts that press.

    Raises
    ------
    InputError
        Shapes don't match, or a number is not finite.

    Examples
    --------
    >>> import dermis
    >>> from dermis.contacts import carried
    >>> pressing = carried(dermis.Skin("ionic-disc"), [[10, 0, -0.5], [500, 0, 0]], [[0.1, 0, -0.4], [0, 0, -1]])
    >>> print(pressing.index, pressing.x_mm, pressing.force_n)
    [0] [10.] [0.4]
    """
    positions = _numbers("positions_mm", positions_mm, (2, 3))
    forces = _numbers("forces_n", forces_n, (3,), scalars=True)
    if len(positions) != len(forces):
        raise InputError(f"forces_n: expected one for each of {len(positions)} positions, got {len(forces)}")
    check_positive("reach_mm", reach_mm, "millimetres")
    radius = _radius_mm(skin)
    flat = positions.shape[1] == 2
    sheet, height = (positions, np.zeros(len(positions))) if flat else _surface.laid_flat(radius, positions)
    if forces.ndim == 1:
        pressing = forces
    else:
        pressing = -np.einsum("ij,ij->i", forces, _surface.normals(radius, sheet[:, 0]))
    felt = (pressing > 0.0) & (np.abs(height) <= reach_mm)
    if felt.any():
        felt &= skin.contains(1e-3 * sheet)
    index = np.flatnonzero(felt)
    return Carried(index, sheet[index, 0], sheet[index, 1], height[index], pressing[index])


def contacts_to_frame(
    twin: Twin,
    positions_mm: ArrayLike,
    forces_n: ArrayLike,
    *,
    radius_mm: float | None = None,
    reach_mm: float = _REACH_MM,
    dt_s: float | None = None,
) -> Frame:
    """The next frame of a twin under exactly these contacts.

    Each contact presses a disc of the given radius with its normal force. The twin's mechanics spread the load under
    the cover; its fields and instrument make the frame. Make the twin with ``fade_s=0``, otherwise loads fade in and
    out over 80 ms.

    Parameters
    ----------
    twin : Twin
        The twin of the skin.
    positions_mm, forces_n : array_like
        Shape (n, 3), or as in :func:`carried`. No contacts: shape (0, 3).
    radius_mm : float, optional
        Radius of the disc pressed by each contact; default: the skin's usual press. A point has no area, and the
        pressure depends on it.
    reach_mm : float
        Largest distance between a contact and the skin's surface.
    dt_s : float, optional
        Time until the following frame; default: the twin's period.

    Returns
    -------
    Frame
        The frame.

    Raises
    ------
    InputError
        Shapes don't match, a number is not finite, or the disc is larger than the skin.

    Examples
    --------
    >>> import dermis
    >>> from dermis.contacts import contacts_to_frame
    >>> twin = dermis.Twin("healing-square", seed=1, fade_s=0)
    >>> rest = contacts_to_frame(twin, [], [])
    >>> pressed = contacts_to_frame(twin, [[10, -5, 0]], [[0, 0, -20]])
    >>> bool(abs(pressed.values - rest.values).max() > 1e-3)
    True
    """
    return _frame_under(twin, carried(twin.skin, positions_mm, forces_n, reach_mm=reach_mm), radius_mm, dt_s)


def _frame_under(twin: Twin, pressing: Carried, radius_mm: float | None, dt_s: float | None) -> Frame:
    if radius_mm is not None:
        check_positive("radius_mm", radius_mm, "millimetres")
    twin.release()
    loads = zip(pressing.x_mm.tolist(), pressing.y_mm.tolist(), pressing.force_n.tolist())
    for pointer, (x_mm, y_mm, force_n) in enumerate(loads):
        twin.press(x_mm, y_mm, radius_mm, force_n, pointer=pointer)
    return twin.step(dt_s)


@dataclass(frozen=True)
class SpatialTouches:
    """Touches in space, in the frame of a patch, a link or the world.

    Parameters
    ----------
    id : numpy.ndarray
        Shape (n,). Identities.
    position_mm : numpy.ndarray
        Shape (n, 3). Positions on the skin's surface.
    normal : numpy.ndarray
        Shape (n, 3). Outward unit normals of the skin.
    force_n : numpy.ndarray
        Shape (n, 3). Forces on the sensor, against the normals; NaN where unknown.
    covariance_mm2 : numpy.ndarray
        Shape (n, 3, 3). Covariances of the positions, within the surface.
    """

    id: NDArray[np.uint64]
    position_mm: NDArray[np.float64]
    normal: NDArray[np.float64]
    force_n: NDArray[np.float64]
    covariance_mm2: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.id)

    def in_frame(self, rotation: ArrayLike, origin_mm: ArrayLike) -> SpatialTouches:
        """The touches in the outer frame of a transform.

        Parameters
        ----------
        rotation : array_like
            Shape (3, 3): from the inner frame to the outer.
        origin_mm : array_like
            Shape (3,): the inner frame's origin in the outer.

        Returns
        -------
        SpatialTouches
            The same touches.
        """
        turn, origin = np.asarray(rotation, float), np.asarray(origin_mm, float)
        return SpatialTouches(
            self.id,
            self.position_mm @ turn.T + origin,
            self.normal @ turn.T,
            self.force_n @ turn.T,
            turn @ self.covariance_mm2 @ turn.T,
        )


def spatial(skin: Skin, touches: Any) -> SpatialTouches:
    """Places touches in the patch's frame; a bent skin's touches lie on its cylinder.

    Parameters
    ----------
    skin : Skin
        The skin.
    touches : numpy.ndarray
        Shape (n,), of ``dermis.touch_dtype``: ``result.touches``. Those that ended are left out.

    Returns
    -------
    SpatialTouches
        The touches in space.
    """
    live = touches[touches["phase"] != "end"]
    radius = _radius_mm(skin)
    position_mm = _surface.points(radius, np.column_stack([live["x_mm"], live["y_mm"]]))
    normal = _surface.normals(radius, live["x_mm"])
    # Unit vectors along x and y of the sheet.
    along_x = np.column_stack([normal[:, 2], np.zeros(len(normal)), -normal[:, 0]])
    along = np.stack([along_x, np.broadcast_to([0.0, 1.0, 0.0], along_x.shape)], axis=1)
    variances = np.column_stack([live["sigma_x_mm"], live["sigma_y_mm"]]) ** 2
    covariance = np.einsum("nki,nk,nkj->nij", along, variances, along)
    return SpatialTouches(
        np.array(live["id"]), position_mm, normal, -normal * np.asarray(live["force_n"])[:, None], covariance
    )


@dataclass(frozen=True)
class SkinReading:
    """One frame of a simulated skin.

    Parameters
    ----------
    patch : str
        Name of the patch.
    time_s : float
        Time of the frame on the simulator's clock.
    frame : Frame
        The frame, as an instrument would send it.
    result : Result
        The pipeline's result: image, touches, health.
    contacts : Carried
        The contacts that pressed: the ground truth.
    """

    patch: str
    time_s: float
    frame: Frame
    result: Result
    contacts: Carried


class SimulatedSkin:
    """A skin in a simulator: twin, pipeline and clock. Learns its baseline at rest when it is made.

    Parameters
    ----------
    skin : Skin, Model or str
        The skin. Skins of one model share its mesh and operator.
    name : str, optional
        Name in readings; default: the skin's.
    seed : int, optional
        Seed of the instrument's noise.
    radius_mm : float, optional
        Radius of the disc pressed by each contact; default: the skin's usual press.
    reach_mm : float
        Largest distance between a contact and the skin's surface.
    calibration, forces : str or os.PathLike, optional
        As for :class:`dermis.Pipeline`.

    Raises
    ------
    SkinError
        The skin is unknown, or cannot be built.
    InputError
        A number is out of range.

    Examples
    --------
    >>> from dermis.contacts import SimulatedSkin
    >>> skin = SimulatedSkin("healing-square", seed=1)
    >>> for _ in range(20):
    ...     reading = skin.step([[10, -5, 0]], [[0, 0, -20]])
    >>> print(len(reading.result.touches))
    1
    """

    def __init__(
        self,
        skin: Skin | Model | str | PathLike[str],
        *,
        name: str | None = None,
        seed: int | None = None,
        radius_mm: float | None = None,
        reach_mm: float = _REACH_MM,
        calibration: Calibration | str | PathLike[str] | None = None,
        forces: str | PathLike[str] | None = None,
    ) -> None:
        check_positive("reach_mm", reach_mm, "millimetres")
        if radius_mm is not None:
            check_positive("radius_mm", radius_mm, "millimetres")
        self.skin: Skin = skin.skin if isinstance(skin, Model) else Skin(skin)
        self.name = self.skin.name if name is None else name
        self.radius_mm, self.reach_mm = radius_mm, reach_mm
        self.twin = Twin(self.skin, seed, fade_s=0.0)
        self.pipeline = Pipeline(skin if isinstance(skin, Model) else self.skin, calibration=calibration, forces=forces)
        if radius_mm is not None:
            # Refuse a disc that is too large now rather than at the first contact.
            self.twin.press(*self._a_place_mm(), radius_mm, 0.0)
            self.twin.release()
        self._settle()

    @property
    def period_s(self) -> float:
        """Time between frames, seconds."""
        return self.twin.period_s

    def step(self, positions_mm: ArrayLike, forces_n: ArrayLike, *, time_s: float | None = None) -> SkinReading:
        """The next frame under these contacts, processed.

        Parameters
        ----------
        positions_mm, forces_n : array_like
            Shape (n, 3), or as in :func:`carried`.
        time_s : float, optional
            Time to state in the reading; default: the twin's.

        Returns
        -------
        SkinReading
            Frame, result and true contacts.
        """
        return self.press(carried(self.skin, positions_mm, forces_n, reach_mm=self.reach_mm), time_s=time_s)

    def press(self, contacts: Carried, *, time_s: float | None = None) -> SkinReading:
        """As :meth:`step`, with contacts that are already on the sheet.

        Parameters
        ----------
        contacts : Carried
            Made by :func:`carried` for this skin.
        time_s : float, optional
            Time to state in the reading; default: the twin's.

        Returns
        -------
        SkinReading
            Frame, result and true contacts.
        """
        frame = _frame_under(self.twin, contacts, self.radius_mm, None)
        result = self.pipeline.process(frame)
        return SkinReading(self.name, frame.time_s if time_s is None else time_s, frame, result, contacts)

    def reset(self) -> None:
        """Lets the layer rest for two minutes of its own time, and learns the baseline again."""
        self.twin.release()
        self.twin.step(_REST_S)
        self.pipeline.tare(force=True)
        self._settle()

    def _settle(self) -> None:
        """Steps at rest until the pipeline has its baseline, for a few frames more than it averages."""
        frames = 0
        while not self.pipeline.ready or frames < 34:
            if frames == _MOST_WARM_UP:
                raise SourceError(f"{self.name}: no baseline after {frames} frames at rest")
            self.pipeline.process(self.twin.step())
            frames += 1

    def _a_place_mm(self) -> tuple[float, float]:
        """A point on the skin."""
        if self.skin.contains([[0.0, 0.0]])[0]:
            return 0.0, 0.0
        corner = 1e3 * self.skin.outline[0]
        return float(corner[0]), float(corner[1])


def _radius_mm(skin: Skin) -> float | None:
    """Radius of the cylinder that a skin is bent around."""
    radius_m = skin.cylinder_radius_m
    return None if radius_m is None else 1e3 * radius_m


def _numbers(name: str, values: ArrayLike, columns: tuple[int, ...], *, scalars: bool = False) -> NDArray[np.float64]:
    """An array of finite rows; an empty list is zero rows."""
    wanted = " or ".join(f"(n, {count})" for count in columns) + (" or (n,)" if scalars else "")
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name}: expected numbers of shape {wanted}, got {type(values).__name__}") from None
    if array.size == 0 and array.ndim <= 2:
        return np.zeros((0, columns[-1]))
    fits = array.ndim == 2 and array.shape[1] in columns or scalars and array.ndim == 1
    if not fits:
        raise InputError(f"{name}: expected shape {wanted}, got shape {array.shape}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        place = "".join(f"[{index}]" for index in bad[0])
        raise InputError(f"{name}{place} = {array[tuple(bad[0])]}: expected finite numbers")
    return array
